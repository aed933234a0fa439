"""Scaling of a problem to units in which its numbers are of order one.

Coulomb's law, the associated law and contact without friction are independent of units: with ``S = σ S'``,
``b = β b'``, ``f = β/σ f'`` and ``u = β u'``, the primed quantities obey the same law with the same coefficients.
Solvers and certificates square lengths and forces, so that numbers outside :data:`RANGE` would underflow or overflow.
"""

from __future__ import annotations

import numpy as np

__all__ = ["RANGE", "out_of_range", "unit"]

#: Smallest and largest number used without scaling: the square of a quotient of two such numbers is a double.
RANGE = 1e-60, 1e60


def out_of_range(values: np.ndarray) -> np.ndarray:
    """Whether the largest magnitude on the last axis (..., k) lies outside :data:`RANGE`; False if all are zero."""
    largest = np.abs(values).max(axis=-1, initial=0.0)
    return (largest > 0.0) & ((largest < RANGE[0]) | (largest > RANGE[1]))


def unit(values: np.ndarray) -> np.ndarray:
    """Power of two near the largest magnitude on the last axis (..., k), an exact divisor; 1 for zeros."""
    largest = np.abs(values).max(axis=-1, initial=0.0)
    return np.ldexp(1.0, np.where(largest > 0.0, np.frexp(largest)[1], 0))
