"""Structured triangle meshes of simple folded sheets."""

from __future__ import annotations

import numpy as np

__all__ = ["extrude"]


def extrude(profile, start: float, length: float, size: float) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Extrude a polyline of the (y, z) plane along x.

    Parameters
    ----------
    profile : array, shape (m, 2)
        Corners (y, z) in mm; each becomes a fold line, which elements follow.
    start, length : float
        First x and extent along x, mm.
    size : float
        Largest edge along x and along the profile, mm.

    Returns
    -------
    points : ndarray, shape (n, 3)
        mm.
    triangles : ndarray of int, shape (k, 3)
        Diagonals alternate, so the mesh has no preferred direction. Normals point along x cross the direction of the
        profile: up (+z) where the profile runs along +y.
    normals : ndarray, shape (k, 3, 3)
        At the corners of each triangle its own: the sheet is flat between its folds.
    """
    if not 0 < size <= length:
        raise ValueError(f"size must be positive and at most {length:g} mm, not {size}")
    profile = np.asarray(profile, float)
    yz = [profile[:1]]
    for a, b in zip(profile, profile[1:]):
        count = int(np.ceil(np.linalg.norm(b - a) / size - 1e-9))
        yz.append(a + (b - a) * np.arange(1, count + 1)[:, None] / count)
    yz = np.concatenate(yz)
    x = start + np.linspace(0, length, int(np.ceil(length / size - 1e-9)) + 1)

    points = np.column_stack([np.repeat(x, len(yz)), np.tile(yz, (len(x), 1))])
    i, j = (grid.ravel() for grid in np.meshgrid(np.arange(len(x) - 1), np.arange(len(yz) - 1), indexing="ij"))
    a = i * len(yz) + j  # corners of a cell, counter-clockwise in (x, profile)
    b, c, d = a + len(yz), a + len(yz) + 1, a + 1
    even = ((i + j) % 2 == 0)[:, None]
    first = np.where(even, np.column_stack([a, b, c]), np.column_stack([a, b, d]))
    second = np.where(even, np.column_stack([a, c, d]), np.column_stack([b, c, d]))
    triangles = np.concatenate([first, second])
    corner = points[triangles]
    normal = np.cross(corner[:, 1] - corner[:, 0], corner[:, 2] - corner[:, 0])
    normal /= np.linalg.norm(normal, axis=1, keepdims=True)
    return points, triangles, np.repeat(normal[:, None], 3, axis=1)
