"""How far the point from which a slider's slip is measured lags behind the end of its slip."""

from __future__ import annotations

import numpy as np

from mic.contact.native.kernel import NUMBER, kernel

__all__ = ["lag", "lag_slope"]


@kernel(NUMBER(NUMBER), from_python=True)
def lag(z):
    """``φ(z) = 1/z - 1/(eᶻ - 1)``, a share of a slip of either sign that is z times its compliance times its force."""
    if abs(z) < 1e-3:
        return 0.5 - z / 12.0
    if z > 300.0:
        return 1.0 / z
    return 1.0 / z - 1.0 / np.expm1(z)


@kernel(NUMBER(NUMBER))
def lag_slope(z):
    """``φ'(z)``."""
    if abs(z) < 0.05:
        z2 = z * z
        return -1.0 / 12.0 + z2 * (1.0 / 240.0 - z2 * (1.0 / 6048.0 - z2 / 172800.0))
    if z > 300.0:
        return -1.0 / (z * z)
    below = np.expm1(z)
    return (below + 1.0) / (below * below) - 1.0 / (z * z)
