"""Key characteristics against their limits: Cp and Cpk with their confidence intervals, and samples outside.

Samples run along the first axis of ``x``, or their moments stand for them, as in :mod:`mic.statistics.estimates`.

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
    """Cp = (upper - lower) / 6σ, with the interval that belongs to that of 6σ; infinite without spread.

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

    ``Cpk ± z sqrt(1/(9 n) + Cpk²/(2 (n - 1)))`` for samples that look normal. Where they show heavier tails, the
    variance is that of the ratio to first order, ``(1/9 + Cpk² (κ - 1)/4 ± Cpk γ/3) / n`` with skewness γ and kurtosis
    κ, plus towards the upper limit. Without spread it is infinite, of the sign that the mean's place demands.
    """
    x = Moments.of(x)
    centre, s = mean(x, level), np.asarray(sigma(x, level).value)
    n, m = centre.used, centre.value
    above, below = np.asarray(upper, dtype=float) - m, m - np.asarray(lower, dtype=float)
    with np.errstate(divide="ignore", invalid="ignore"):
        value = np.minimum(above, below) / (3 * s)
    known = np.where(np.isfinite(value), value, np.nan)
    skewness, kurtosis, heavy = tails(x)
    towards = np.where(above <= below, 1, -1)
    normal = 1 / (9 * np.maximum(n, 1)) + known**2 / (2 * np.maximum(n - 1, 1))
    general = (1 / 9 + known**2 * (kurtosis - 1) / 4 + towards * known * skewness / 3) / np.maximum(n, 1)
    half = ndtri(0.5 + level / 2) * np.sqrt(np.where(heavy, general, normal))
    return Estimate.of(x, value, known - half, known + half)


def outside(x, lower, upper) -> np.ndarray:
    """How many samples lie outside [lower, upper]; :func:`mic.statistics.estimates.share` makes a share of it.

    Parameters
    ----------
    x : (n,) or (n, k) array
    lower, upper : float or (k,) array
        Limits in the unit of `x`.
    """
    x = np.asarray(x, dtype=float)
    return ((x < lower) | (x > upper)).sum(axis=0)
