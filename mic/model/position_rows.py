"""Rows that read the growth of other rows as their item moves in its sheet, for ``report.positions``.

A weld, a locator or a clamp at x reads ``ℓ(x)``. Its position row is a central difference along a tangent t,

    a' = (ℓ(x + ε t) - ℓ(x - ε t)) / 2 ε,

with ε a tenth of its radius: the difference that moving the point of the scene would make on the same mesh. Along x, y
and z of the scene it is ``Σ_t (e·t) a'_t`` over two tangents: the component of the axis within the sheet.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import numpy as np

from mic.errors import Problems, SceneError
from mic.geometry.pairing import pair_at
from mic.model.rows import Rows
from mic.model.weld_rows import drawn_gap, weld_terms

__all__ = ["position_rows"]

SHARE, LEAST = 0.1, 0.05  # ε relative to the radius, and its minimum in mm
FLAT = 0.02  # smallest component of an axis within the sheet that gives a row

#: Reads an item at a point: gaps (r,) and, for each of r rows, the terms (part, functional, coefficient).
Read = Callable[[np.ndarray], tuple[np.ndarray, list]]


def position_rows(rows: Rows, problems: Problems) -> np.ndarray:
    """Add the rows that the scene's report needs, kind ``"position"``; their labels are the names of the inputs.

    Parameters
    ----------
    rows : Rows
    problems : Problems
        Collects each :class:`SceneError`: items that are too near an edge of their sheet to move.

    Returns
    -------
    (q,) array
        Growth of the gap read by a weld's row, mm per mm and rad per mm; 0 for other items.
    """
    gaps: list[float] = []
    for kind in ("welds", "locators", "clamps"):
        for item in getattr(rows.scene, kind):
            name = f"{kind}.{item.name}"
            if not {kind, name} & set(rows.scene.report.positions) or getattr(item, "hole", None) is not None:
                continue
            with problems:
                tangents, read = _weld(name, item, rows) if kind == "welds" else _point(name, item, rows)
                gaps += _add(name, item, tangents, read, rows)
    return np.array(gaps)


def _weld(name: str, weld, rows: Rows) -> tuple[np.ndarray, Read]:
    """Tangents at a weld, and its gap and terms at a point."""
    sides = [rows.bodies[part] for part in weld.parts]

    def pair_near(point):
        try:
            return pair_at(point, weld.radius, *sides)
        except ValueError as error:
            raise SceneError(
                f"report.positions: {name!r} cannot move in its sheet: {error}; leave it out, or move the weld"
            ) from None

    here = pair_near(weld.point)

    def read(point):
        pair = pair_near(point)
        # tangents as near to those at the weld as the normal allows
        n = pair.frame[:, 0]
        t1 = here.frame[:, 1] - (here.frame[:, 1] @ n) * n
        t1 /= np.linalg.norm(t1)
        pair = replace(pair, frame=np.column_stack([n, t1, np.cross(n, t1)]))
        return drawn_gap(weld, pair, rows), [terms for _, *terms in weld_terms(weld, pair, rows)]

    return here.frame[:, 1:].T, read


def _point(name: str, item, rows: Rows) -> tuple[np.ndarray, Read]:
    """Tangents at a locator or clamp, and its term at a point; it has no gap."""
    surface = rows.surfaces[item.part]
    n = surface.normals[surface.project(item.point).triangle[0]]
    axis = np.eye(3)[int(np.argmin(np.abs(n)))]
    t1 = axis - (axis @ n) * n
    t1 /= np.linalg.norm(t1)

    def read(point):
        patch = rows.disc(item.part, point, item.radius)
        return np.zeros(1), [[(item.part, rows.functional(item.part, patch, item.direction, f"{name} moved"), 1.0)]]

    return np.array([t1, np.cross(n, t1)]), read


def _add(name: str, item, tangents: np.ndarray, read: Read, rows: Rows) -> list[float]:
    """Add the rows of an item along the scene's axes; returns the growth of the gap that each reads."""
    ε = max(SHARE * item.radius, LEAST)
    differences, gaps = [], []
    for tangent in tangents:
        (gap, up), (other, down) = (read(np.asarray(item.point) + sign * ε * tangent) for sign in (1.0, -1.0))
        gaps.append((gap - other) / (2 * ε))
        signed = [[*a, *((part, at, -share) for part, at, share in b)] for a, b in zip(up, down)]
        differences.append([[(part, at, share / (2 * ε)) for part, at, share in terms] for terms in signed])
    growth = []
    for axis, e in zip("xyz", np.eye(3)):
        shares = [float(e @ tangent) for tangent in tangents]
        if np.linalg.norm(shares) < FLAT:
            continue
        for along_tangents, gap in zip(zip(*differences), np.dot(shares, gaps)):
            terms = [(part, at, share * c) for share, terms in zip(shares, along_tangents) for part, at, c in terms]
            rows.add("position", f"{name}.{axis}", *terms)
            growth.append(float(gap))
    return growth
