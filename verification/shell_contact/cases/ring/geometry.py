"""A ring of radius 30 mm and 20 mm length; x along its axis."""

from __future__ import annotations

import numpy as np

RADIUS, LENGTH = 30.0, 20.0  # mm, of the middle surface
PARTS = ("ring",)
SIZES = {"coarse": 2.5, "medium": 2.5 / 1.5, "fine": 2.5 / 2.25}  # mm


def build(part: str, size: float):
    """Points (n, 3), triangles (k, 3) and their corners' normals (k, 3, 3) of the middle surface, mm."""
    along, around = int(np.ceil(LENGTH / size - 1e-9)), 8 * int(np.ceil(2 * np.pi * RADIUS / 8 / size - 1e-9))
    x, angle = np.meshgrid(np.linspace(0, LENGTH, along + 1), np.arange(around) * 2 * np.pi / around, indexing="ij")
    outward = np.stack([0 * x, np.cos(angle), np.sin(angle)], -1).reshape(-1, 3)
    points = RADIUS * outward + np.outer(x.ravel(), [1, 0, 0])
    i, j = (grid.ravel() for grid in np.meshgrid(np.arange(along), np.arange(around), indexing="ij"))
    a, d = i * around + j, i * around + (j + 1) % around
    b, c = a + around, d + around
    even = ((i + j) % 2 == 0)[:, None]
    first = np.where(even, np.column_stack([a, c, b]), np.column_stack([a, d, b]))
    second = np.where(even, np.column_stack([a, d, c]), np.column_stack([b, d, c]))
    triangles = np.concatenate([first, second])
    return points, triangles, outward[triangles]
