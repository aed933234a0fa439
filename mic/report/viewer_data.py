"""Data of the interactive views of an assembly and its fields, which ``viewer.html`` passes to Plotly."""

from __future__ import annotations

import base64
import gzip
import json
from collections.abc import Mapping
from typing import Any

import numpy as np
from matplotlib import colormaps
from matplotlib.colors import to_hex

from mic.geometry.surface import Surface
from mic.report.context import Context
from mic.report.mesh_decimation import thinned
from mic.report.space_pictures import ARROW, viewpoint
from mic.report.style import MARK_COLOURS, part_colour, zone_colour
from mic.results.outcome import Outcome
from mic.scene import Scene

__all__ = ["drawable", "packed", "view", "viewer_data"]

NOT_A_NUMBER = 2**16 - 1
PLACES = NOT_A_NUMBER - 1  # steps of a coordinate
SHADES = 2**10  # steps of a field: four for each colour


def viewer_data(outcome: Outcome, context: Context) -> str | None:
    """Parts with their fields, arrows and marked points, as :func:`packed` JSON; None without parts.

    Meshes are decimated (:mod:`mic.report.mesh_decimation`). Arrays are base64 of little-endian bytes: ``triangles``
    (t, 3) 2-byte integers; ``points`` (v, 3) and fields (v,) as ``data``, 2-byte integers i for ``low + i step`` mm,
    65535 for NaN.
    """
    surfaces, scene = context.surfaces, outcome.model.scene
    if not surfaces:
        return None
    data = view(surfaces, scene)
    for part in data["parts"]:
        own = [field for field in context.fields if field.part == part["name"]]
        kept = thinned(surfaces[part["name"]])[0] if own else None
        part["fields"] = {field.law: _field(field, surfaces[field.part], kept) for field in own}
    data["points"] = _zones(scene, outcome.model.contacts) + data["points"]
    data["laws"] = [law for law in outcome.laws if context.fields_of(law)]
    return packed(json.dumps(data))


def view(surfaces: Mapping[str, Surface], scene: Scene) -> dict[str, Any]:
    """Surfaces and placed items of a scene, as :func:`viewer_data` returns them; no contact pairs, no fields."""
    length = ARROW * max(surface.diameter for surface in surfaces.values())
    everything = np.concatenate([surface.points for surface in surfaces.values()])
    low, high = everything.min(axis=0) - length, everything.max(axis=0) + length
    return {
        "scales": {name: _scale(name) for name in ("viridis", "YlOrRd", "RdBu_r")},
        "eye": dict(zip("xyz", 1.9 * viewpoint(surfaces.values()))),
        "arrow": length,
        "range": np.column_stack([low, high]).tolist(),
        "parts": [
            {
                "name": name,
                "colour": part_colour(i),
                "points": _numbers(surface.points[kept]),
                "triangles": _encoded(triangles.astype("<u2")),
                "fields": {},
            }
            for i, (name, surface) in enumerate(surfaces.items())
            for kept, triangles in [thinned(surface)]
        ],
        "arrows": _arrows(scene),
        "points": _marks(scene),
        "laws": [],
    }


def drawable(item: Any) -> bool:
    """Whether the point and direction of an item are known."""
    return item.point is not None and not isinstance(getattr(item, "direction", None), str)


def packed(text: str) -> str:
    """A text for a script element: gzip in base64."""
    return base64.b64encode(gzip.compress(text.encode(), 9, mtime=0)).decode()


def _scale(name):
    """16 steps of a colour map."""
    return [[i / 15, to_hex(colormaps[name](i / 15))] for i in range(16)]


def _field(field, surface, kept):
    values = {
        "mean": np.linalg.norm(field.mean, axis=1),
        "mean_normal": np.einsum("vi,vi->v", field.mean, surface.vertex_normals),
        "six_sigma": field.six_sigma_magnitude,
        "six_sigma_normal": field.six_sigma_normal,
    }
    return {name: _numbers(value[kept], SHADES) for name, value in values.items()}


def _arrows(scene):
    """Items that act along a direction."""
    return [
        {
            "name": f"{kind}s",
            "colour": MARK_COLOURS[kind],
            "items": [{"name": item.name, "head": item.point, "direction": item.direction} for item in items],
        }
        for kind in ("locator", "clamp")
        for items in [[item for item in getattr(scene, f"{kind}s") if drawable(item)]]
        if items
    ]


def _zones(scene, contacts):
    """Contact pairs by zone."""
    groups = []
    for z, zone in enumerate(scene.zones):
        own = contacts.zone == z
        groups.append(
            {
                "name": zone.name,
                "colour": zone_colour(z),
                "size": 2.5,
                "points": contacts.point[own].round(3).tolist(),
                "labels": [f"{zone.name}, contact {k}" for k in np.flatnonzero(own)],
            }
        )
    return [group for group in groups if group["points"]]


def _marks(scene):
    """Welds and measurement points."""
    welds = [(item.name, item.point) for item in scene.welds if item.point is not None]
    measured = [(item.name, point) for item in scene.measurements for _, point in item.places]
    return [
        {
            "name": f"{kind}s",
            "colour": MARK_COLOURS[kind],
            "size": 5,
            "points": [point for _, point in marks],
            "labels": [name for name, _ in marks],
        }
        for kind, marks in (("weld", welds), ("measurement", measured))
        if marks
    ]


def _numbers(values, steps=PLACES):
    """Numbers rounded to a share of their range."""
    known = values[np.isfinite(values)]
    low, high = (float(known.min()), float(known.max())) if known.size else (0.0, 0.0)
    step = (high - low) / steps or 1.0
    whole = np.where(np.isfinite(values), np.round((np.nan_to_num(values) - low) / step), NOT_A_NUMBER)
    return {"low": low, "step": step, "data": _encoded(whole.astype("<u2"))}


def _encoded(array):
    """The bytes of an array in base64."""
    return base64.b64encode(np.ascontiguousarray(array).tobytes()).decode()
