"""Holes of a sheet: rims that the sheet lies around, where a pin may stand."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.sparse import coo_matrix
from scipy.sparse.csgraph import connected_components

from mic.geometry.surface import Patch, Surface

__all__ = ["Hole", "find_holes"]


@dataclass(frozen=True)
class Hole:
    """A closed rim with the sheet around it.

    Attributes
    ----------
    centre : (3,) array
        Mean of the rim, by length, mm: what the mean displacement of the rim under a rigid motion is that of.
    normal : (3,) array
        Unit normal of the plane through the rim, on the side of the sheet's own normals there.
    size : tuple of two float
        Largest extent of the rim in its plane, and the extent across it, mm: of a round hole its diameter, twice.
    uneven : float
        How far the rim leaves its plane, mm.
    rim : Patch
        The rim with equal weight per length.
    """

    centre: np.ndarray
    normal: np.ndarray
    size: tuple[float, float]
    uneven: float
    rim: Patch

    @property
    def round(self) -> bool:
        """Whether the extents agree to a tenth: a polygon of eight corners about a circle does."""
        return self.size[0] <= 1.1 * self.size[1]


def find_holes(surface: Surface) -> list[Hole]:
    """The holes of a surface, in the order of their lowest vertex.

    Each set of border edges that hang together is a rim. It is that of a hole where the sheet lies on its outer side,

        Σ l (s · (x − c)) > 0,        s from an edge of length l and middle x into its triangle, c the rim's centre;

    the sheet's own outline has it on the inner side. A rim that meets another one in a vertex is one with it.
    """
    triangle, opposite = np.nonzero(surface.border)
    if not len(triangle):
        return []
    corners = surface.triangles[triangle]
    rows = np.arange(len(triangle))
    ends = np.column_stack([corners[rows, (opposite + 1) % 3], corners[rows, (opposite + 2) % 3]])
    vertex, local = np.unique(ends, return_inverse=True)
    a, b = local.reshape(-1, 2).T
    links = coo_matrix((np.ones(len(a)), (a, b)), shape=(len(vertex), len(vertex)))
    label = connected_components(links, directed=False)[1]
    found = []
    for rim in range(label.max() + 1):  # numbered by their first vertex
        own = np.flatnonzero(label[a] == rim)
        hole = _hole(surface, triangle[own], opposite[own], ends[own])
        if hole is not None:
            found.append(hole)
    return found


def _hole(surface: Surface, triangle, opposite, ends) -> Hole | None:
    x = surface.points[ends]
    middle, length = x.mean(1), np.linalg.norm(x[:, 1] - x[:, 0], axis=1)
    centre = length @ middle / length.sum()
    inwards = surface.points[surface.triangles[triangle, opposite]] - middle
    inwards /= np.linalg.norm(inwards, axis=1, keepdims=True)
    if length @ np.einsum("ij,ij->i", inwards, middle - centre) <= 0:
        return None
    corners = x.reshape(-1, 3) - centre
    axes = np.linalg.svd(corners, full_matrices=False)[2]
    axes[2] *= np.sign(axes[2] @ (length @ surface.normals[triangle])) or 1.0
    # Two extents that are alike leave the axes open: take them in many directions of the plane, and towards the
    # corners, which tell those of a round hole whatever axes rounding has chosen.
    across = corners @ axes[:2].T
    turn = np.concatenate([np.radians(np.arange(0, 180, 5)), np.arctan2(across[:, 1], across[:, 0])])
    extents, widths = (
        np.ptp(across @ np.array([np.cos(angle), np.sin(angle)]), axis=0) for angle in (turn, turn + np.pi / 2)
    )
    longest = int(np.argmax(extents))
    size = float(extents[longest]), float(widths[longest])
    rim = Patch(*surface.sample_edges(triangle, opposite, float(length.max())))
    rim = Patch(rim.triangle, rim.barycentric, rim.weight / rim.weight.sum())
    return Hole(centre, axes[2], size, float(np.abs(corners @ axes[2]).max()), rim)
