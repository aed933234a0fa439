"""Coincident sheets: which of two sheets that are meshed at the same position lies on which side.

Preprocessors often mesh the faces where parts touch, so that both meshes coincide. The order of the sheets would then
depend on rounding. It follows from the positions where the sheets separate: they do not intersect, so each lies on the
side of its separated part.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from mic.errors import SceneError
from mic.geometry.pairing import ContactPair, Side
from mic.geometry.triangles import place_text

__all__ = ["COINCIDENT", "offsets", "refuse_coincident"]

COINCIDENT = 0.25  # of the distance between touching mid-surfaces: nearer ones do not determine the order
REACH = 20.0  # thicknesses: parts of a sheet farther from the other one are ignored
SURE = 0.8  # share of the separated area that must lie on one side


def offsets(pair: ContactPair, first: Side, second: Side) -> tuple[tuple[float, float], bool]:
    """Offsets, in thicknesses, that place the two sheets side by side, and whether the shapes determine their signs."""
    normals = [
        patch.weight @ body.surface.normals[patch.triangle] for body, patch in zip((first, second), pair.patches)
    ]
    alike = 1.0 if normals[0] @ normals[1] > 0 else -1.0
    # the side of the first sheet, along its normals, on which the second lies: seen from either sheet
    from_first, from_second = _separated_area(first, second), -alike * _separated_area(second, first)
    total = from_first + from_second
    sure = abs(total) > SURE * (abs(from_first) + abs(from_second)) and from_first * from_second >= 0
    side = 1.0 if total >= 0 else -1.0
    return (-0.5 * side, 0.5 * side * alike), bool(sure and total)


def _separated_area(body: Side, other: Side) -> float:
    """Area, mm², of the other sheet over this one on the side of its normals, minus that on the other side.

    Only area that does not coincide counts; 0 if it lies on both sides.
    """
    surface, distance = body.surface, body.half_thickness + other.half_thickness
    middle = other.surface.corners.mean(axis=1)
    foot = surface.project(middle, reach=REACH * distance)
    found = np.flatnonzero((foot.triangle >= 0) & ~foot.at_border & (foot.distance > COINCIDENT * distance))
    step = middle[found] - foot.point[found]
    along = np.einsum("ij,ij->i", step, surface.normals[foot.triangle[found]])
    over = np.abs(along) > 0.9 * foot.distance[found]  # over a face, not beside a fold
    area = np.bincount((along[over] > 0).astype(int), other.surface.areas[found[over]], 2)
    return float(area[1] - area[0]) if area.max() > SURE * area.sum() else 0.0


def refuse_coincident(key: str, names: Sequence[str], pairs: list[ContactPair], first: Side, second: Side) -> None:
    """Refuse a zone in which only rounding would decide the order of the sheets.

    Parameters
    ----------
    key : str
        Key of the zone in the scene, for messages.
    names : (2,) sequence of str
        Names of the bodies.
    pairs : list of ContactPair
    first, second : Side

    Raises
    ------
    SceneError
        With the offsets that place the sheets side by side.
    """
    touching = first.half_thickness + second.half_thickness
    pair = min(pairs, key=lambda pair: pair.gap, default=None)
    if pair is None or pair.gap + touching >= COINCIDENT * touching:
        return
    shares, sure = offsets(pair, first, second)
    remedy = " and ".join(
        f"offset = {share:+g} for {name}" for share, name, body in zip(shares, names, (first, second)) if not body.rigid
    )
    why = ", which follows from the rest of the sheets" if sure else ", or both with the other sign"
    normals = first.surface.normals[pair.patches[0].triangle]
    upwards = ", ".join(f"{x:.2f}" for x in np.average(normals, axis=0, weights=pair.patches[0].weight))
    raise SceneError(
        f"{key}: {names[0]} and {names[1]} coincide ({abs(pair.gap + touching):.3g} mm apart at "
        f"{place_text(pair.point)}), so it is unknown which of them lies on which side; mesh their mid-surfaces, or "
        f"give {remedy}{why}: offset moves a part by this many thicknesses along its normals, which are ({upwards}) "
        f"for {names[0]} there"
    )
