"""Element size that varies over a part."""

from __future__ import annotations

from typing import Any

import numpy as np
from scipy.spatial import cKDTree

__all__ = ["GROWTH", "GradedSize"]

GROWTH = 0.3  # mm of size per mm of distance


class GradedSize(float):
    """Largest element size, mm, with smaller sizes around some places.

    It is a float, so a geometry script with a uniform mesh can use it as a number; other scripts evaluate

        h(x) = min(largest size, minᵢ (sizeᵢ + GROWTH ‖x − placeᵢ‖)).

    Attributes
    ----------
    places : (n, 3) array
        mm.
    sizes : (n,) array
        Size at each of them, mm.
    """

    places: np.ndarray
    sizes: np.ndarray

    def __new__(cls, size: float, places: Any, sizes: Any) -> GradedSize:
        graded = super().__new__(cls, size)
        graded.places = np.array(places, dtype=float).reshape(-1, 3)
        graded.sizes = np.minimum(np.array(sizes, dtype=float).ravel(), size)
        return graded

    def at(self, points: np.ndarray) -> np.ndarray:
        """(m,) element size, mm, at points (m, 3)."""
        found = np.full(len(points), float(self))
        for size in np.unique(self.sizes):
            distance = cKDTree(self.places[self.sizes == size]).query(points)[0]
            found = np.minimum(found, size + GROWTH * distance)
        return found

    def times(self, share: float) -> GradedSize:
        """All sizes multiplied by a factor."""
        return GradedSize(share * self, self.places, share * self.sizes)
