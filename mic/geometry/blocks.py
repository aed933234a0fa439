"""Blocks of neighbouring triangles in boxes, which exclude many triangles at once from a search."""

from __future__ import annotations

from functools import cached_property

import numpy as np
from scipy.spatial import cKDTree

from mic.geometry.triangles import dot, length, listed

__all__ = ["Blocks"]

ACROSS = 8.0  # edge of a block over the root of the mean area of a triangle
ROUNDING = 1e-9  # of a radius, which boxes and spheres are larger


class Blocks:
    """Boxes along the principal axes of blocks of triangles, so that those of flat sheets are flat.

    Parameters
    ----------
    corners : (k, 3, 3) array
        Corners of the triangles, mm.
    areas : (k,) array
    """

    def __init__(self, corners: np.ndarray, areas: np.ndarray) -> None:
        cell = np.floor(corners.mean(1) / (ACROSS * np.sqrt(areas.mean())))
        block = np.unique(cell, axis=0, return_inverse=True)[1].ravel()
        order = np.repeat(np.argsort(block, kind="stable"), 3)
        first = 3 * np.flatnonzero(np.diff(block[order[::3]], prepend=-1))
        points, count = corners[order[::3]].reshape(-1, 3), np.diff(first, append=len(order))
        mean = np.add.reduceat(points, first) / count[:, None]
        off = points - np.repeat(mean, count, axis=0)
        spread = np.add.reduceat(off[:, :, None] * off[:, None], first)
        self.axes = np.linalg.eigh(spread)[1]  # (b, 3, 3), one axis in each column
        along = np.einsum("pi,pij->pj", off, np.repeat(self.axes, count, axis=0))
        low, high = np.minimum.reduceat(along, first), np.maximum.reduceat(along, first)
        self.centre = mean + np.einsum("bij,bj->bi", self.axes, (low + high) / 2)
        self.radius = (1 + ROUNDING) * length((high - low) / 2)
        self.half = (high - low) / 2 + ROUNDING * self.radius[:, None]

    @cached_property
    def _tree(self) -> cKDTree:
        return cKDTree(self.centre)

    def behind(self, points: np.ndarray, normals: np.ndarray, reach: np.ndarray) -> np.ndarray:
        """(n,) bool: whether a box within reach (n,) of a point (n, 3) extends behind its plane, of unit normal (n, 3).

        False means that no triangle within reach does.
        """
        row, block = listed(self._tree.query_ball_point(points, reach + self.radius.max()))
        near = length(self.centre[block] - points[row]) <= reach[row] + self.radius[block]
        row, block = row[near], block[near]
        normal = normals[row]
        lowest = dot(self.centre[block] - points[row], normal)
        lowest -= (np.abs(np.einsum("qij,qi->qj", self.axes[block], normal)) * self.half[block]).sum(1)
        some = np.zeros(len(points), dtype=bool)
        some[row[lowest < 0]] = True
        return some
