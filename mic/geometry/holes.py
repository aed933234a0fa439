"""Holes of a sheet, in which a pin may stand."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from mic.geometry.surface import Patch, Surface
from mic.geometry.triangles import components, unit

__all__ = ["Hole", "find_holes"]


@dataclass(frozen=True)
class Hole:
    """A closed rim surrounded by the sheet.

    Attributes
    ----------
    centre : (3,) array
        Mean of the rim by length, mm. The mean displacement of the rim under a rigid motion is that of this point.
    normal : (3,) array
        Unit normal of the plane through the rim, on the side of the sheet's normals there.
    size : tuple of two float
        Largest extent of the rim in its plane, and the extent perpendicular to it, mm; both the diameter of a round
        hole.
    uneven : float
        Largest distance of the rim from its plane, mm.
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
        """Whether the extents agree to 10 %, as for an octagon about a circle."""
        return self.size[0] <= 1.1 * self.size[1]


def find_holes(surface: Surface) -> list[Hole]:
    """The holes of a surface, in the order of their lowest vertex.

    Each connected set of border edges is a rim. It is the rim of a hole if the sheet lies outside of it,

        Σ l (s · (x − c)) > 0,        s from an edge of length l and middle x into its triangle, c the rim's centre;

    the sheet's outline has the sheet inside. Rims that share a vertex count as one.
    """
    triangle, opposite = np.nonzero(surface.border)
    if not len(triangle):
        return []
    ends = surface.ends(triangle, opposite)
    vertex, local = np.unique(ends, return_inverse=True)
    a, b = local.reshape(-1, 2).T
    count, label = components(a, b, len(vertex))
    rims = [np.flatnonzero(label[a] == rim) for rim in range(count)]  # ordered by their lowest vertex
    holes = [_hole(surface, triangle[rim], opposite[rim], ends[rim]) for rim in rims]
    return [hole for hole in holes if hole is not None]


def _hole(surface: Surface, triangle, opposite, ends) -> Hole | None:
    """The hole of a set of border edges; None for an outline."""
    x = surface.points[ends]
    middle, length = x.mean(1), np.linalg.norm(x[:, 1] - x[:, 0], axis=1)
    centre = length @ middle / length.sum()
    inwards = unit(surface.points[surface.triangles[triangle, opposite]] - middle)
    if length @ np.einsum("ij,ij->i", inwards, middle - centre) <= 0:
        return None
    corners = x.reshape(-1, 3) - centre
    axes = np.linalg.svd(corners, full_matrices=False)[2]
    axes[2] *= np.sign(axes[2] @ (length @ surface.normals[triangle])) or 1.0
    # Equal extents leave the axes undetermined, so extents are measured in many directions of the plane and towards
    # the corners.
    across = corners @ axes[:2].T
    turn = np.concatenate([np.radians(np.arange(0, 180, 5)), np.arctan2(across[:, 1], across[:, 0])])
    extents, widths = (
        np.ptp(across @ np.array([np.cos(angle), np.sin(angle)]), axis=0) for angle in (turn, turn + np.pi / 2)
    )
    longest = int(np.argmax(extents))
    size = float(extents[longest]), float(widths[longest])
    own, barycentric, share = surface.sample_edges(triangle, opposite, float(length.max()))
    rim = Patch(own, barycentric, share / share.sum())
    return Hole(centre, axes[2], size, float(np.abs(corners @ axes[2]).max()), rim)
