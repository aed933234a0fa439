"""T joints: a sheet that stands on another one by its free edge, and welds along the edge."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.spatial import cKDTree

from mic.geometry.pairing import standing_edge
from mic.wizard.bodies import NO_POINTS, Body
from mic.wizard.faying import GAP, pieces
from mic.wizard.joints import PITCH, at_pitch

__all__ = ["Standing", "find_standing"]

LEAST = 10.0  # mm of edge: a shorter one is a corner that meets by chance
INSET = 5.0  # mm between a weld and the end of the edge
MOST = 12  # welds along the edges of a pair of parts


@dataclass(frozen=True)
class Standing:
    """A sheet that stands on another one by its edge.

    Attributes
    ----------
    edge, sheet : Body
        The one that stands, and the one on which it stands.
    point : (n, 3) array
        Points of the edge, mm.
    length : float
        Of the edge, mm.
    gap : float
        Mean distance of the edge from the face of the other sheet, mm.
    welds : (w, 3) array
        mm.
    """

    edge: Body
    sheet: Body
    point: np.ndarray
    length: float
    gap: float
    welds: np.ndarray

    @property
    def names(self) -> tuple[str, str]:
        """The names of the sheet and of the one that stands on it."""
        return self.sheet.name, self.edge.name


def find_standing(first: Body, second: Body) -> Standing | None:
    """The edge by which one of two parts stands on the other; None if neither does."""
    both = [found for pair in ((first, second), (second, first)) if (found := _standing(*pair)) is not None]
    return max(both, key=lambda found: found.length, default=None)


def _standing(edge: Body, sheet: Body) -> Standing | None:
    reach = GAP + sheet.thickness / 2
    a, b = edge.surface, sheet.surface
    if (np.maximum(a.points.min(0), b.points.min(0)) - np.minimum(a.points.max(0), b.points.max(0)) > reach).any():
        return None
    spacing = min(edge.element / 2, INSET)
    at = standing_edge(a, b, spacing, reach)
    length = float(at.length[at.standing].sum())
    if length < LEAST:
        return None
    point, rest = at.point[at.standing], at.point[~at.standing]
    depth = cKDTree(rest).query(point)[0] if len(rest) else np.full(len(point), np.inf)
    piece, pitch, welds = pieces(point, 2.5 * spacing), PITCH, NO_POINTS
    while True:
        welds = NO_POINTS
        for number in range(piece.max() + 1):
            own = np.flatnonzero(piece == number)
            inner = own[depth[own] >= min(INSET, depth[own].max())]
            welds = np.concatenate([welds, point[inner[at_pitch(point[inner], pitch)]]])
        if len(welds) <= MOST or pitch > 1e4:
            break
        pitch *= 1.25
    gap = float(np.average(at.height[at.standing], weights=at.length[at.standing])) - sheet.thickness / 2
    return Standing(edge, sheet, point, length, gap, welds)
