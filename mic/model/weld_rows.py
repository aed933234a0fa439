"""Rows of welds: what a nugget ties, and the nominal gap that it bridges.

A fused nugget is one piece: it ties all relative displacements over its disc up to the linear ones,

    ∫ φ (u_b − u_a) dA / A,        φ = 1, x, y,

with x and y from the centre, in radii. An averaged weld ties the means of displacements and rotations, and so does one
along the edge by which a sheet stands on the other.

Both parts are read at the same point, half of any nominal gap off their facing surfaces: otherwise turning the welded
assembly as a whole would strain the weld.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace

import numpy as np

from mic.errors import Problems, SceneError
from mic.geometry.pairing import ContactPair, pair_at
from mic.model.assembly_types import Contacts
from mic.model.overlap import close_overlap, zone_of_weld
from mic.model.rows import AXES, NORMAL, Rows, on_part
from mic.scene import Scene
from mic.scene.checks import entry

__all__ = ["drawn_gap", "weld_gaps", "weld_rows", "weld_terms"]


def weld_rows(key: str, weld, rows: Rows) -> np.ndarray:
    """Add the rows of a weld; returns the gap as drawn that each of them reads.

    Raises
    ------
    SceneError
        If the weld lies off a part, or its parts do not face each other there.
    """
    for name in weld.parts:
        on_part(f"{key}.point", name, rows.surfaces[name], weld.point, weld.name)
    try:
        pair = pair_at(weld.point, weld.radius, *(rows.bodies[name] for name in weld.parts))
    except ValueError as error:
        raise SceneError(f"{key}.point ({weld.name}): {error}; correct the coordinates") from None
    for label, *terms in weld_terms(weld, pair, rows):
        rows.add("weld", label, *terms)
    return drawn_gap(weld, pair, rows)


def weld_terms(weld, pair: ContactPair, rows: Rows) -> list[tuple]:
    """Retain the functionals of a weld over a pair; for each of its rows the label and the terms of the two parts."""
    moments: dict[str, np.ndarray] = {}
    if weld.fused and weld.moment and pair.offsets is None:
        moments = _moment_weights(pair, rows.surfaces[weld.parts[0]], weld.radius)
    functionals: list[list[int]] = []
    middles = pair.offsets or [
        side * (1 + pair.gap / (2 * rows.bodies[name].half_thickness)) for name, side in zip(weld.parts, pair.sides)
    ]
    for name, patch, middle in zip(weld.parts, pair.patches, middles):
        mean = rows.patch(name, patch)
        readings = [("", mean, False)]
        readings += [(label, rows.patch(name, replace(patch, weight=w)), False) for label, w in moments.items()]
        readings += [("r", mean, True)] * (weld.moment and not moments)
        functionals.append(
            [
                rows.functional(
                    name, at, pair.frame[:, j], f"weld {weld.name} {label}{axis}", rotates, 0.0 if rotates else middle
                )
                for label, at, rotates in readings
                for j, axis in enumerate(AXES)
            ]
        )
    first, second = weld.parts
    labels = [f"{weld.name} {label}{axis}" for label, _, _ in readings for axis in AXES]
    return [(label, (first, a, -1.0), (second, b, 1.0)) for label, a, b in zip(labels, *functionals)]


def _moment_weights(pair: ContactPair, surface, radius) -> dict[str, np.ndarray]:
    """Weights (q,) of a nugget's points for its first moments along t1 and t2."""
    patch = pair.patches[0]
    step = surface.at(patch.triangle, patch.barycentric) - pair.point
    return {f"{axis}-moment ": patch.weight * (step @ pair.frame[:, j]) / radius for j, axis in ((1, "t1"), (2, "t2"))}


def drawn_gap(weld, pair: ContactPair, rows: Rows) -> np.ndarray:
    """(r,) gap g as drawn over the disc, as the rows of a weld read it; 0 for tangential rows.

    The mean gap, mm; for a fused nugget the moments ∫ φ g dA / A, mm, φ = x, y in radii; for an averaged weld the
    rotation of the second sheet against the first about t1, t2 that opens g = g₀ + α x + β y, (β, −α), rad.
    """
    gap_read = np.zeros(3 if not weld.moment else 9 if weld.fused and pair.offsets is None else 6)
    gap_read[0] = pair.gap
    if len(gap_read) == 3 or pair.offsets is not None:
        return gap_read
    first, second = (rows.surfaces[name] for name in weld.parts)
    a, b = pair.patches
    point = first.at(a.triangle, a.barycentric)
    distance = (second.at(b.triangle, b.barycentric) - point) @ pair.frame[:, 0]
    gap = distance - a.weight @ distance / a.weight.sum() + pair.gap
    φ = (point - pair.point) @ pair.frame[:, 1:] / weld.radius
    normal = list(NORMAL[len(gap_read)][1:])
    if weld.fused:
        gap_read[normal] = (a.weight * gap) @ φ
        return gap_read
    φ = np.column_stack([np.ones(len(φ)), φ])
    _, α, β = np.linalg.lstsq(φ.T @ (a.weight[:, None] * φ), φ.T @ (a.weight * gap), rcond=None)[0] / weld.radius
    gap_read[normal] = β, -α
    return gap_read


def weld_gaps(scene: Scene, contacts: Contacts, drawn: Mapping[str, np.ndarray], problems: Problems) -> np.ndarray:
    """(r,) nominal gaps of all weld rows, with overlap closed as at the contact pairs around each weld.

    Parameters
    ----------
    scene : Scene
    contacts : Contacts
    drawn : mapping of str to array
        Gaps as drawn, by the name of the weld; overwritten. Welds with errors are missing.
    problems : Problems
        Collects errors.
    """
    for i, weld in enumerate(scene.welds):
        gaps = drawn.get(weld.name)
        if gaps is None:
            continue
        zone = zone_of_weld(scene.zones, contacts.zone, contacts.point, weld)
        if zone is not None and zone.gap is not None:
            gaps[:] = 0.0
            gaps[0] = zone.gap
            continue
        rule, at = "close" if zone is None else zone.nominal_overlap, np.array([weld.point])
        with problems:
            gap = close_overlap(scene, entry("welds", i, weld), weld, rule, gaps[:1], at)[0]
            if gap != gaps[0]:
                gaps[:] = 0.0  # a closed gap has no tilt
                gaps[0] = gap
    return np.concatenate([np.zeros(0), *drawn.values()])
