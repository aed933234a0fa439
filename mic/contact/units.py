"""Units in which a problem's numbers are of order one.

Coulomb's law, its convex neighbour and contact without friction know no units: with ``S = σ S'`` and ``b = β b'``,
``f = β/σ f'`` and ``u = β u'``, dashed quantities obey the same law with the same coefficients. Squares of lengths and
forces enter solvers and certificates, so that numbers beyond :data:`RANGE` would be lost or overflow there.
"""

from __future__ import annotations

import numpy as np

__all__ = ["RANGE", "beyond", "unit"]

#: Smallest and largest number that is taken as it is: a force is a quotient of two such, and its square a number yet.
RANGE = 1e-60, 1e60


def beyond(values: np.ndarray) -> np.ndarray:
    """Whether the largest of the last axis (..., k) lies out of :data:`RANGE`; zeros alone do not."""
    largest = np.abs(values).max(axis=-1, initial=0.0)
    return (largest > 0.0) & ((largest < RANGE[0]) | (largest > RANGE[1]))


def unit(values: np.ndarray) -> np.ndarray:
    """A power of two near the largest of the last axis (..., k), so that dividing by it rounds nothing; 1 for zeros."""
    largest = np.abs(values).max(axis=-1, initial=0.0)
    return np.ldexp(1.0, np.where(largest > 0.0, np.frexp(largest)[1], 0))
