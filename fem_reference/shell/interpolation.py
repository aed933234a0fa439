"""Shape functions of a field on a triangle, in barycentric coordinates, and their nodes.

Nodes come in threes, each three ordered like the vertices: vertices, or the midpoints of the edges opposite to them.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

__all__ = ["CROUZEIX_RAVIART", "P1", "P2", "Interpolation"]

VERTICES = np.eye(3)
MIDPOINTS = (1 - np.eye(3)) / 2


@dataclass(frozen=True)
class Interpolation:
    """One field's shape functions, polynomials of at most second degree.

    Attributes
    ----------
    nodes : (n, 3) array
        Barycentric coordinates of the nodes.
    shape : callable
        ``shape(barycentric)`` of points (q, 3) gives the values (q, n) of the shape functions there.
    """

    nodes: np.ndarray
    shape: Callable[[np.ndarray], np.ndarray]

    @property
    def mean(self) -> np.ndarray:
        """(n,) ∫ N dA / A: the share of a uniform load at each node."""
        return self.shape(MIDPOINTS).mean(axis=0)  # exact for quadratics


def _quadratic(barycentric: np.ndarray) -> np.ndarray:
    opposite = barycentric[:, [1, 2, 0]] * barycentric[:, [2, 0, 1]]
    return np.hstack([barycentric * (2 * barycentric - 1), 4 * opposite])


P1 = Interpolation(VERTICES, lambda barycentric: barycentric)
P2 = Interpolation(np.vstack([VERTICES, MIDPOINTS]), _quadratic)
CROUZEIX_RAVIART = Interpolation(MIDPOINTS, lambda barycentric: 1 - 2 * barycentric)
