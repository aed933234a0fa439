"""Surfaces moved along their normals: meshes that are drawn on a skin of the sheet, made its middle.

A point goes where the sheets that meet in it, each moved by h along its own normal, meet again,

    n_i · d = h        for the normal n_i of every triangle about the point,

in the sense of least squares, the shortest d of all. On a smooth sheet that is d = h n, across a fold with the angle φ
between its normals the mitre of length h / cos(φ/2), and in the corner of a box the corner of the box about it.
"""

from __future__ import annotations

import numpy as np
from scipy.sparse import coo_matrix
from scipy.sparse.csgraph import connected_components

from mic.geometry.surface import Surface

__all__ = ["moved"]

ONE = 0.004  # of the largest eigenvalue: normals within some 7° count as one, for a mitre between them is none
LONGEST = 2.0  # a mitre's length in offsets, that of a fold by 120°; sharper ones are cut off there
ROUNDS = 10  # in which points that fold a triangle up are joined
THIN = 0.05  # a triangle that keeps less of its height has been folded up in a bend


def moved(surface: Surface, distance: float) -> Surface:
    """A surface moved along its normals, its triangles, their numbers and given normals as they are.

    Parameters
    ----------
    surface : Surface
    distance : float
        mm, positive along the normals.

    Raises
    ------
    ValueError
        If three or more triangles meet in an edge, where no side is the upper one, or a bend is tighter than the
        distance.
    """
    if not distance:
        return surface
    triangles, points = surface.triangles, surface.points
    edges = np.sort(triangles[:, [[1, 2], [2, 0], [0, 1]]].reshape(-1, 2), axis=1)
    edge, count = np.unique(edges, axis=0, return_counts=True)
    if (count > 2).any():
        raise ValueError(
            f"it cannot be moved by its offset: three or more of its triangles meet in the edge at "
            f"{_place(points[edge[count > 2][0]].mean(axis=0))}, where no side is the upper one; draw its mid-surface"
        )
    together = np.arange(len(points))
    for _ in range(ROUNDS):
        moving = points + distance * _steps(surface, together)
        folded = _folded(surface, moving)
        if not len(folded):
            return Surface(moving, triangles, surface.given_normals)
        together = _joined(surface, folded, together)
    raise ValueError(
        f"{len(folded)} of its triangles fold up when it is moved by its offset of {distance:.3g} mm, such as that at "
        f"{_place(surface.corners[folded[0]].mean(axis=0))}: the bend is tighter; draw its mid-surface, or turn the "
        "sign of the offset if the sheet lies on the other side"
    )


def _steps(surface: Surface, together: np.ndarray) -> np.ndarray:
    """(n, 3) where the points go, for an offset of 1; those with one number in `together` (n,) go as one."""
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


def _folded(surface: Surface, points: np.ndarray) -> np.ndarray:
    """Triangles that turn over, or are left without height, where the points move."""
    corners = points[surface.triangles]
    across = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    longest = np.linalg.norm(corners - np.roll(corners, 1, axis=1), axis=2).max(axis=1)
    height = np.einsum("ij,ij->i", across, surface.normals) / np.maximum(longest, np.finfo(float).tiny)
    return np.flatnonzero(height < THIN * 2 * surface.areas / surface.edge_lengths.max(axis=1))


def _joined(surface: Surface, folded: np.ndarray, together: np.ndarray) -> np.ndarray:
    """Numbers (n,) of points that go as one, the ends of the shortest side of each folded triangle joined too.

    A mesh that is finer than the offset has triangles across which the steps of two neighbours differ by more than the
    triangle is wide; features of that size are lost a half thickness away.
    """
    shortest = np.argmin(surface.edge_lengths[folded], axis=1)
    ends = np.stack([surface.triangles[folded, (shortest + turn) % 3] for turn in (1, 2)])
    n = len(together)
    links = np.concatenate([ends, np.stack([np.arange(n), together])], axis=1)
    return connected_components(coo_matrix((np.ones(links.shape[1]), links), shape=(n, n)), directed=False)[1]


def _place(x: np.ndarray) -> str:
    return f"({', '.join(f'{value:.1f}' for value in x)})"
