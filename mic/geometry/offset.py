"""Surfaces offset along their normals: from a mesh on a skin of the sheet to its mid-surface.

A point moves to where the sheets that meet in it, each offset by h along its own normal, meet again:

    n_i · d = h        for the normal n_i of every triangle at the point,

in the least-squares sense, with the shortest d. This is d = h n on a smooth sheet, the mitre of length h / cos(φ/2)
across a fold with the angle φ between its normals, and the corner of the offset box at the corner of a box.
"""

from __future__ import annotations

import numpy as np

from mic.geometry.surface import Surface
from mic.geometry.triangles import area_vectors, components, place_text

__all__ = ["moved"]

ONE = 0.004  # of the largest eigenvalue: normals within about 7° count as one, without a mitre
LONGEST = 2.0  # offsets: longest mitre, that of a fold by 120°; sharper ones are truncated
ROUNDS = 10  # attempts to resolve inverted triangles by moving their points together
THIN = 0.05  # share of its height below which a moved triangle counts as inverted


def moved(surface: Surface, distance: float) -> Surface:
    """The surface moved along its normals, with the same triangles and given normals.

    Parameters
    ----------
    surface : Surface
    distance : float
        mm, positive along the normals.

    Raises
    ------
    ValueError
        If three or more triangles share an edge, where no side is the upper one, or a bend is tighter than the
        distance.
    """
    if not distance:
        return surface
    triangles, points = surface.triangles, surface.points
    edge, _, count = surface.sides
    if (count > 2).any():
        place = place_text(points[edge[count > 2][0]].mean(axis=0))
        raise ValueError(
            f"its offset cannot be applied: three or more of its triangles share the edge at {place}, and no side is "
            "the upper one; mesh the mid-surface"
        )
    together = np.arange(len(points))
    for _ in range(ROUNDS):
        moving = points + distance * _steps(surface, together)
        folded = _inverted(surface, moving)
        if not len(folded):
            return Surface(moving, triangles, surface.given_normals)
        together = _merged(surface, folded, together)
    raise ValueError(
        f"its offset of {distance:.3g} mm inverts {len(folded)} of its triangles, such as that at "
        f"{place_text(surface.corners[folded[0]].mean(axis=0))}: the bend is tighter than the offset; mesh its "
        "mid-surface, or change the sign of offset if the sheet lies on the other side"
    )


def _steps(surface: Surface, together: np.ndarray) -> np.ndarray:
    """(n, 3) displacement of the points for a unit offset; points with equal numbers `together` (n,) move as one."""
    corner, normal = together[surface.triangles.ravel()], np.repeat(surface.normals, 3, axis=0)
    sides = surface.corners
    a, b = (np.roll(sides, -turn, axis=1) - sides for turn in (1, 2))
    angle = np.arctan2(np.linalg.norm(np.cross(a, b), axis=2), (a * b).sum(axis=2)).ravel()
    n = len(surface.points)
    share = angle / np.bincount(corner, angle, n)[corner]
    left, right = np.zeros((n, 3, 3)), np.zeros((n, 3))
    np.add.at(left, corner, share[:, None, None] * normal[:, :, None] * normal[:, None, :])
    np.add.at(right, corner, share[:, None] * normal)
    value, axes = np.linalg.eigh(left)
    inverse = np.divide(1.0, value, out=np.zeros_like(value), where=(value > ONE * value[:, -1:]) & (value > 0))
    step = np.einsum("nij,nj,nkj,nk->ni", axes, inverse, axes, right)
    length = np.linalg.norm(step, axis=1, keepdims=True)
    return (step / np.maximum(length / LONGEST, 1.0))[together]


def _inverted(surface: Surface, points: np.ndarray) -> np.ndarray:
    """Triangles that are inverted or lose their height at the moved points."""
    corners = points[surface.triangles]
    longest = np.linalg.norm(corners - np.roll(corners, 1, axis=1), axis=2).max(axis=1)
    height = np.einsum("ij,ij->i", area_vectors(corners), surface.normals) / np.maximum(longest, np.finfo(float).tiny)
    return np.flatnonzero(height < THIN * 2 * surface.areas / surface.edge_lengths.max(axis=1))


def _merged(surface: Surface, folded: np.ndarray, together: np.ndarray) -> np.ndarray:
    """Groups (n,) of points that move together, after joining the ends of the shortest side of each inverted triangle.

    On a mesh finer than the offset the displacements of two neighbours can differ by more than the triangle's width;
    features of that size vanish half a thickness away.
    """
    shortest = np.argmin(surface.edge_lengths[folded], axis=1)
    ends = np.stack([surface.triangles[folded, (shortest + turn) % 3] for turn in (1, 2)])
    n = len(together)
    first, second = np.concatenate([ends, np.stack([np.arange(n), together])], axis=1)
    return components(first, second, n)[1]
