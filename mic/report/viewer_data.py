"""Data of the interactive views of an assembly and its fields, which ``viewer.html`` passes to Plotly."""

from __future__ import annotations

import base64
import gzip
import json
from collections.abc import Callable, Mapping, Sequence
from functools import cache
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

__all__ = ["arrow_group", "packed", "plotly_script", "point_group", "view", "viewer_data"]

NOT_A_NUMBER = 2**16 - 1
PLACES = NOT_A_NUMBER - 1  # steps of a coordinate
SHADES = 2**10  # steps of a field: four for each colour


def viewer_data(outcome: Outcome, context: Context) -> str | None:
    """Parts with their fields, arrows and marked points, as :func:`packed` JSON; None without fields.

    ``check.html`` has a view without fields.

    Meshes are decimated (:mod:`mic.report.mesh_decimation`). Arrays are base64 of little-endian bytes: ``triangles``
    (t, 3) 2-byte integers; ``points`` (v, 3) and fields (v,) as ``data``, 2-byte integers i for ``low + i step`` mm,
    65535 for NaN.
    """
    surfaces, scene = context.surfaces, outcome.model.scene
    if not context.fields:
        return None
    data = view(surfaces, scene)
    for part in data["parts"]:
        own = [field for field in context.fields if field.part == part["name"]]
        kept = thinned(surfaces[part["name"]])[0] if own else None
        part["fields"] = {field.law: _field(field, surfaces[field.part], kept) for field in own}
    data["points"] = _zones(scene, outcome.model.contacts) + data["points"]
    data["laws"] = [law for law in outcome.laws if context.fields_of(law)]
    return packed(json.dumps(data))


def view(
    surfaces: Mapping[str, Surface], scene: Scene, describe: Callable[[str, Any], str] = lambda kind, item: item.name
) -> dict[str, Any]:
    """Surfaces and placed items of a scene, as :func:`viewer_data` returns them; no contact pairs, no fields.

    ``describe(kind, item)`` gives the text that a locator or clamp shows under the pointer.
    """
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
        "arrows": [
            *arrow_group("locator", MARK_COLOURS["locator"], scene.locators, describe),
            *arrow_group("clamp", MARK_COLOURS["clamp"], scene.clamps, describe),
        ],
        "points": _marks(scene),
        "laws": [],
    }


def arrow_group(
    kind: str, colour: str, items: Sequence[Any], describe: Callable[[str, Any], str]
) -> list[dict[str, Any]]:
    """A group of items that act along a direction, as far as they are placed; no group if no item is."""
    placed = [
        {"head": item.point, "direction": item.direction, "label": describe(kind, item)}
        for item in items
        if item.point is not None and not isinstance(item.direction, str)
    ]
    return [{"name": f"{kind}s", "colour": colour, "items": placed}] if placed else []


def point_group(
    name: str, colour: str, size: float, points: Sequence[Any], labels: Sequence[str], **more: Any
) -> list[dict[str, Any]]:
    """A group of marked points; no group if there are none."""
    group = {"name": name, "colour": colour, "size": size, "points": points, "labels": labels}
    return [group | more] if points else []


@cache
def plotly_script() -> str:
    """The library of the views, as :func:`packed`."""
    from plotly.offline import get_plotlyjs  # 5 MB, for pages with a view only

    return packed(get_plotlyjs())


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


def _zones(scene, contacts):
    """Contact pairs by zone."""
    groups = []
    for z, zone in enumerate(scene.zones):
        own = np.flatnonzero(contacts.zone == z)
        labels = [f"{zone.name}, contact {k}" for k in own]
        groups += point_group(zone.name, zone_colour(z), 2.5, contacts.point[own].round(3).tolist(), labels)
    return groups


def _marks(scene):
    """Welds and measurement points."""
    welds = [(item.name, item.point) for item in scene.welds if item.point is not None]
    measured = [(item.name, point) for item in scene.measurements for _, point in item.places]
    groups = []
    for kind, marks in (("weld", welds), ("measurement", measured)):
        points, labels = [point for _, point in marks], [name for name, _ in marks]
        groups += point_group(f"{kind}s", MARK_COLOURS[kind], 5, points, labels)
    return groups


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
