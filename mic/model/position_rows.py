"""Rows that read by how much other rows grow as their item moves in its sheet, where the scene asks for them.

A weld, a locator or a clamp at x reads ``ℓ(x)``. Its position row is a difference of what it would read a little to
either side along a tangent t,

    a' = (ℓ(x + ε t) - ℓ(x - ε t)) / 2 ε,

with ε a tenth of its radius: the difference that moving the point of the scene would make on the same mesh. Along x, y
and z of the scene it is ``Σ_t (e·t) a'_t`` over two tangents: what of the axis lies in the sheet.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import numpy as np

from mic.errors import SceneError
from mic.geometry.pairing import ContactPair, pair_at
from mic.model.rows import Rows

__all__ = ["position_rows"]

SHARE, LEAST = 0.1, 0.05  # ε of the radius; mm
FLAT = 0.02  # of an axis: what lies in the sheet by less does not

#: Terms of a row, (part, functional, coefficient) each, and its label.
Terms = tuple


def position_rows(
    scene,
    bodies,
    rows: Rows,
    weld_terms: Callable[..., list[Terms]],
    weld_gap: Callable[..., np.ndarray],
) -> np.ndarray:
    """Add the rows that the scene's report asks for, kind ``"position"``; their labels are the inputs' names.

    Parameters
    ----------
    scene : mic.scene.Scene
        Placed on its meshes.
    bodies : mapping of str to Side
    rows : Rows
    weld_terms : callable
        ``weld_terms(weld, pair, rows=rows)``: what a weld reads over a pair.
    weld_gap : callable
        ``weld_gap(weld, pair)``: what these rows read of the gap as drawn, mm and rad.

    Returns
    -------
    (q,) array
        By how much the gap that a weld's row reads grows, mm per mm and rad per mm; 0 for others.

    Raises
    ------
    SceneError
        Where an item stands too near an edge of its sheet to move.
    """
    gaps: list[float] = []
    for kind in ("welds", "locators", "clamps"):
        for item in getattr(scene, kind):
            name = f"{kind}.{item.name}"
            if not {kind, name} & set(scene.report.positions) or getattr(item, "hole", None) is not None:
                continue
            if kind == "welds":
                gaps += _weld(name, item, bodies, rows, weld_terms, weld_gap)
            else:
                gaps += _point(name, item, rows)
    return np.array(gaps)


def _weld(name: str, weld, bodies, rows: Rows, weld_terms, weld_gap) -> list[float]:
    sides = [bodies[part] for part in weld.parts]
    here = pair_at(weld.point, weld.radius, *sides)
    ε = max(SHARE * weld.radius, LEAST)
    moved, gaps = [], []
    for tangent in here.frame[:, 1:].T:
        ends = []
        for sign in (1.0, -1.0):
            try:
                pair = pair_at(np.asarray(weld.point) + sign * ε * tangent, weld.radius, *sides)
            except ValueError as error:
                raise SceneError(
                    f"report.positions: {name!r} cannot move in its sheet: {error}; leave it out, or move the weld"
                ) from None
            turned = _turned(pair, here)
            ends.append((weld_gap(weld, turned), weld_terms(weld, turned, rows=rows)))
        (gap, up), (other, down) = ends
        gaps.append((gap - other) / (2 * ε))
        moved.append([_difference(a, b, ε) for (_, *a), (_, *b) in zip(up, down)])
    return _along(name, here.frame[:, 1:].T, moved, gaps, rows)


def _turned(pair: ContactPair, like: ContactPair) -> ContactPair:
    """The pair with tangents that are as near to another's as its normal allows."""
    n = pair.frame[:, 0]
    t1 = like.frame[:, 1] - (like.frame[:, 1] @ n) * n
    t1 /= np.linalg.norm(t1)
    return replace(pair, frame=np.column_stack([n, t1, np.cross(n, t1)]))


def _point(name: str, item, rows: Rows) -> list[float]:
    surface = rows.surfaces[item.part]
    n = surface.normals[surface.project(item.point).triangle[0]]
    axis = np.eye(3)[int(np.argmin(np.abs(n)))]
    t1 = axis - (axis @ n) * n
    t1 /= np.linalg.norm(t1)
    tangents, ε = [t1, np.cross(n, t1)], max(SHARE * item.radius, LEAST)
    moved = []
    for tangent in tangents:
        ends = []
        for sign in (1.0, -1.0):
            patch = rows.disc(item.part, np.asarray(item.point) + sign * ε * tangent, item.radius)
            ends.append([(item.part, rows.functional(item.part, patch, item.direction, f"{name} moved"), 1.0)])
        moved.append([_difference(ends[0], ends[1], ε)])
    return _along(name, tangents, moved, np.zeros((2, 1)), rows)


def _difference(up, down, ε: float) -> list[tuple[str, int, float]]:
    return [(part, at, share / (2 * ε)) for part, at, share in up] + [
        (part, at, -share / (2 * ε)) for part, at, share in down
    ]


def _along(name: str, tangents, moved, gaps, rows: Rows) -> list[float]:
    """Add the rows along the scene's axes, from those along two tangents."""
    found = []
    for axis, e in zip("xyz", np.eye(3)):
        shares = [float(e @ tangent) for tangent in tangents]
        if np.linalg.norm(shares) < FLAT:
            continue
        for own, gap in zip(zip(*moved), np.dot(shares, gaps)):
            terms = [(part, at, share * c) for share, terms in zip(shares, own) for part, at, c in terms]
            rows.add("position", f"{name}.{axis}", *terms)
            found.append(float(gap))
    return found
