"""How far the point from which a slider's slip is measured lags behind the end of its slip."""

from __future__ import annotations

import numpy as np
from numba import types

from mic.contact.native.kernel import NUMBER, kernel

__all__ = ["lag", "lag_and_slope"]


@kernel(NUMBER(NUMBER), from_python=True)
def lag(z):
    """``φ(z) = 1/z - 1/(eᶻ - 1)``, a share of a slip of either sign that is z times its compliance times its force."""
    if abs(z) < 1e-3:
        return 0.5 - z / 12.0
    if z > 300.0:
        return 1.0 / z
    return 1.0 / z - 1.0 / np.expm1(z)


@kernel(types.UniTuple(NUMBER, 2)(NUMBER))
def lag_and_slope(z):
    """``φ(z)``, to the last bit for small z too, and ``φ'(z)``."""
    if abs(z) < 0.05:
        z2 = z * z
        value = 0.5 - z * (1.0 / 12.0 - z2 * (1.0 / 720.0 - z2 * (1.0 / 30240.0 - z2 / 1209600.0)))
        return value, -1.0 / 12.0 + z2 * (1.0 / 240.0 - z2 * (1.0 / 6048.0 - z2 / 172800.0))
    value = lag(z)
    if z > 300.0:
        return value, -1.0 / (z * z)
    below = np.expm1(z)
    return value, (below + 1.0) / (below * below) - 1.0 / (z * z)
