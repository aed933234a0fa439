"""Capability of key characteristics: Cp and Cpk with confidence intervals, and number of samples outside the limits.

``x`` holds samples along its first axis, or their moments (:mod:`mic.statistics.estimates`).

References
----------
.. [1] A. F. Bissell: How reliable is your capability index?, Applied Statistics 39 (1990) 331-340.
"""

from __future__ import annotations

import numpy as np
from scipy.special import ndtri

from mic.statistics.estimates import LEVEL, Estimate, Moments, mean, sigma, six_sigma, tails

__all__ = ["capability", "centred_capability", "outside"]


def capability(x, lower, upper, level: float = LEVEL) -> Estimate:
    """Cp = (upper - lower) / 6σ, with the interval that follows from that of 6σ; infinite without spread.

    Parameters
    ----------
    x : (n,) or (n, k) array, or Moments
    lower, upper : float or (k,) array
        Limits in the unit of `x`.
    """
    x = Moments.of(x)
    spread, width = six_sigma(x, level), np.asarray(upper, dtype=float) - lower
    with np.errstate(divide="ignore"):
        return Estimate.of(x, width / np.asarray(spread.value), width / spread.high, width / spread.low)


def centred_capability(x, lower, upper, level: float = LEVEL) -> Estimate:
    """Cpk = min(upper - mean, mean - lower) / 3σ, with Bissell's interval [1]_.

    ``Cpk ± z sqrt(1/(9 n) + Cpk²/(2 (n - 1)))`` for samples without heavy tails. For heavy tails, the variance of the
    ratio is taken to first order: ``(1/9 + Cpk² (κ - 1)/4 ± Cpk γ/3) / n`` with skewness γ and kurtosis κ, plus if the
    upper limit is the nearer one. Without spread, Cpk is +∞ if the mean is within the limits and -∞ otherwise.
    """
    x = Moments.of(x)
    average, s = mean(x, level), np.asarray(sigma(x, level).value)
    n, m = average.used, average.value
    above, below = np.asarray(upper, dtype=float) - m, m - np.asarray(lower, dtype=float)
    with np.errstate(divide="ignore", invalid="ignore"):
        value = np.minimum(above, below) / (3 * s)
    finite = np.where(np.isfinite(value), value, np.nan)
    skewness, kurtosis, heavy = tails(x)
    sign = np.where(above <= below, 1, -1)
    normal = 1 / (9 * np.maximum(n, 1)) + finite**2 / (2 * np.maximum(n - 1, 1))
    general = (1 / 9 + finite**2 * (kurtosis - 1) / 4 + sign * finite * skewness / 3) / np.maximum(n, 1)
    half = ndtri(0.5 + level / 2) * np.sqrt(np.where(heavy, general, normal))
    return Estimate.of(x, value, finite - half, finite + half)


def outside(x, lower, upper) -> np.ndarray:
    """Number of samples outside [lower, upper]; :func:`mic.statistics.estimates.share` converts it to a share.

    Parameters
    ----------
    x : (n,) or (n, k) array
    lower, upper : float or (k,) array
        Limits in the unit of `x`.
    """
    x = np.asarray(x, dtype=float)
    return ((x < lower) | (x > upper)).sum(axis=0)
