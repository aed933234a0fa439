"""Capability of key characteristics: Cp and Cpk with confidence intervals, and number of samples outside the limits.

``x`` holds samples along its first axis, or their moments (:mod:`mic.statistics.estimates`).

References
----------
.. [1] A. F. Bissell: How reliable is your capability index?, Applied Statistics 39 (1990) 331-340.
.. [2] G. Y. Zou, A. Donner: Construction of confidence limits about effect measures: a general approach, Stat. Med. 27
       (2008) 1693-1702.
"""

from __future__ import annotations

import numpy as np
from scipy.special import ndtr, ndtri, stdtrit

from mic.statistics.estimates import LEVEL, Estimate, Moments, sigma, six_sigma, tails

__all__ = [
    "capability",
    "centred_capability",
    "looks_normal",
    "normal_share_outside",
    "outside",
]


LEAST = 50  # samples: with fewer, skewness and kurtosis do not show whether a distribution is normal


def capability(x, lower, upper) -> Estimate:
    """Cp = (upper - lower) / 6σ, with the interval that follows from that of 6σ; infinite without spread.

    Parameters
    ----------
    x : (n,) or (n, k) array, or Moments
    lower, upper : float or (k,) array
        Limits in the unit of `x`.
    """
    x = Moments.of(x)
    spread, width = six_sigma(x), np.asarray(upper, dtype=float) - lower
    with np.errstate(divide="ignore"):
        return Estimate.of(x, width / np.asarray(spread.value), width / spread.high, width / spread.low)


def centred_capability(x, lower, upper) -> Estimate:
    """Cpk = min(upper - mean, mean - lower) / 3σ.

    The interval adds the squares of what the intervals of mean and σ contribute to each of its ends [2]_, and their
    covariance to first order, ``± t² Cpk γ / 3n`` with the skewness γ, plus if the upper limit is the nearer one.
    Without spread, Cpk is +∞ if the mean is within the limits and -∞ otherwise.
    """
    x = Moments.of(x)
    spread, (skewness, _) = sigma(x), tails(x)
    s, n = np.asarray(spread.value), np.maximum(x.n, 2)
    above, below = np.asarray(upper, dtype=float) - x.mean, x.mean - np.asarray(lower, dtype=float)
    with np.errstate(divide="ignore", invalid="ignore"):
        value = np.minimum(above, below) / (3 * s)
        finite = np.where(np.isfinite(value), value, np.nan)
        quantile_square = stdtrit(n - 1, 0.5 + LEVEL / 2) ** 2
        of_mean = quantile_square / n * (1 / 9 + np.where(above <= below, 1, -1) * finite * skewness / 3)
        down, up = (
            np.sqrt(np.maximum(of_mean + (finite * (1 - s / end)) ** 2, 0.0)) for end in (spread.high, spread.low)
        )
    return Estimate.of(x, value, finite - down, finite + up)


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


def looks_normal(x) -> np.ndarray:
    """Whether skewness and kurtosis of samples agree with a normal distribution; False for fewer than 50.

    All k columns of normal samples pass with a probability of 95 %.

    Parameters
    ----------
    x : (n,) or (n, k) array, or Moments
    """
    x = Moments.of(x)
    skewness, kurtosis = tails(x)
    n = np.maximum(x.n, 1)
    z = ndtri(1 - (1 - LEVEL) / (4 * max(np.size(n), 1)))
    near = (np.abs(skewness) <= z * np.sqrt(6 / n)) & (np.abs(kurtosis - 3) <= z * np.sqrt(24 / n))
    return (x.n >= LEAST) & ((x.deviation == 0) | near)


def normal_share_outside(x, lower, upper, level: float = LEVEL) -> Estimate:
    """Share of a normal population outside [lower, upper], from mean and σ of its samples.

    The interval takes the distance d of each limit from the mean, in σ, as ``d ± z sqrt(1/n + d²/(2 (n - 1)))`` [1]_.

    Parameters
    ----------
    x : (n,) or (n, k) array, or Moments
    lower, upper : float or (k,) array
        Limits in the unit of `x`, may be infinite.
    """
    x = Moments.of(x)
    with np.errstate(divide="ignore", invalid="ignore"):
        distance = np.stack([np.asarray(upper, dtype=float) - x.mean, x.mean - np.asarray(lower, dtype=float)])
        distance = distance / x.deviation
        half = ndtri(0.5 + level / 2) * np.sqrt(1 / np.maximum(x.n, 1) + distance**2 / (2 * np.maximum(x.n - 1, 1)))
        near = np.where(np.isfinite(distance), distance - half, distance)
        far = np.where(np.isfinite(distance), distance + half, distance)
    value, low, high = (np.minimum(ndtr(-d).sum(axis=0), 1.0) for d in (distance, far, near))
    return Estimate.of(x, value, low, high)
