"""Data of the interactive view of the assembly and its fields, which ``viewer.html`` hands to Plotly."""

from __future__ import annotations

import base64
import json

import numpy as np
from matplotlib import colormaps
from matplotlib.colors import to_hex

from mic.report.context import Context
from mic.report.space_pictures import ARROW, viewpoint
from mic.report.style import MARK_COLOURS, part_colour, zone_colour
from mic.results.outcome import Outcome

__all__ = ["viewer_data"]


def viewer_data(outcome: Outcome, context: Context) -> str | None:
    """Parts with their fields, arrows and marked points, as JSON that a script element may hold; None without parts.

    Arrays are base64 of little-endian bytes: ``points`` (v, 3) and fields (v,) as 4-byte floats in mm, ``triangles``
    (t, 3) as 4-byte integers.
    """
    surfaces = context.surfaces
    if not surfaces:
        return None
    length = ARROW * max(surface.diameter for surface in surfaces.values())
    everything = np.concatenate([surface.points for surface in surfaces.values()])
    low, high = everything.min(axis=0) - length, everything.max(axis=0) + length
    data = {
        "scales": {name: _scale(name) for name in ("viridis", "YlOrRd", "RdBu_r")},
        "eye": dict(zip("xyz", 1.9 * viewpoint(surfaces.values()))),
        "arrow": length,
        "range": np.column_stack([low, high]).tolist(),
        "parts": [_part(i, name, context) for i, name in enumerate(surfaces)],
        "arrows": _arrows(outcome.model.scene),
        "points": _points(outcome.model.scene, outcome.model.contacts),
        "laws": [law for law in outcome.laws if context.fields_of(law)],
    }
    return json.dumps(data).replace("<", "\\u003c")


def _scale(name):
    """16 steps of a colour map."""
    return [[i / 15, to_hex(colormaps[name](i / 15))] for i in range(16)]


def _part(i, name, context):
    surface = context.surfaces[name]
    return {
        "name": name,
        "colour": part_colour(i),
        "points": _packed(surface.points, "<f4"),
        "triangles": _packed(surface.triangles, "<i4"),
        "fields": {
            field.law: {
                "mean": _packed(np.linalg.norm(field.mean, axis=1), "<f4"),
                "mean_normal": _packed(np.einsum("vi,vi->v", field.mean, surface.vertex_normals), "<f4"),
                "six_sigma": _packed(field.six_sigma_magnitude, "<f4"),
                "six_sigma_normal": _packed(field.six_sigma_normal, "<f4"),
            }
            for field in context.fields
            if field.part == name
        },
    }


def _arrows(scene):
    """What acts along a direction."""
    return [
        {
            "name": f"{kind}s",
            "colour": MARK_COLOURS[kind],
            "items": [{"name": item.name, "head": item.point, "direction": item.direction} for item in items],
        }
        for items, kind in ((scene.locators, "locator"), (scene.clamps, "clamp"))
        if items
    ]


def _points(scene, contacts):
    """Contact pairs by zone, welds and measurement points."""
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
    for items, kind in ((scene.welds, "weld"), (scene.measurements, "measurement")):
        groups.append(
            {
                "name": f"{kind}s",
                "colour": MARK_COLOURS[kind],
                "size": 5,
                "points": [item.point for item in items],
                "labels": [item.name for item in items],
            }
        )
    return [group for group in groups if group["points"]]


def _packed(array, dtype):
    """An array as base64 of its little-endian bytes."""
    return base64.b64encode(np.ascontiguousarray(array, dtype=dtype).tobytes()).decode()
