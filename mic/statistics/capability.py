"""Capability of key characteristics: Cp and Cpk with confidence intervals, and number of samples outside the limits.

``x`` holds samples along its first axis, or their moments (:mod:`mic.statistics.estimates`).

References
----------
.. [1] A. F. Bissell: How reliable is your capability index?, Applied Statistics 39 (1990) 331-340.
"""

from __future__ import annotations

import numpy as np
from scipy.special import ndtr, ndtri

from mic.statistics.estimates import LEVEL, Estimate, Moments, mean, sigma, six_sigma, tails

__all__ = [
    "capability",
    "cautious_capability",
    "centred_capability",
    "looks_normal",
    "normal_share_outside",
    "outside",
]


LEAST = 50  # samples: with fewer, skewness and kurtosis do not show whether a distribution is normal


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


def cautious_capability(x, lower, upper, level: float = LEVEL) -> Estimate:
    """Cpk as :func:`centred_capability`, with an interval for decisions on samples that are not normal.

    Few samples of a skewed population or of one with long tails show neither, and the interval is too narrow. Here the
    variance of Cpk is that for a skewness and a kurtosis larger by `z` standard errors than those of the samples, and
    at least that of normal samples.
    """
    x = Moments.of(x)
    cpk = centred_capability(x, lower, upper, level)
    z, n = ndtri(0.5 + level / 2), np.maximum(x.n, 2)
    with np.errstate(invalid="ignore"):
        value = np.where(np.isfinite(cpk.value), cpk.value, np.nan)
        sign = np.where(np.asarray(upper, dtype=float) - x.mean <= x.mean - np.asarray(lower, dtype=float), 1, -1)
    skewness, kurtosis, _ = tails(x)
    skewness, kurtosis = sign * skewness + z * np.sqrt(6 / n), kurtosis + z * np.sqrt(24 / n)
    general = (1 / 9 + value**2 * (kurtosis - 1) / 4 + value * skewness / 3) / (n - 1)
    half = z * np.sqrt(np.fmax(general, 1 / (9 * n) + value**2 / (2 * (n - 1))))
    return Estimate.of(x, cpk.value, value - half, value + half)


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


def looks_normal(x, level: float = LEVEL) -> np.ndarray:
    """Whether skewness and kurtosis of samples agree with a normal distribution; False for fewer than 50.

    Parameters
    ----------
    x : (n,) or (n, k) array, or Moments
    level : float
        Probability that all k of normal samples pass.
    """
    x = Moments.of(x)
    skewness, kurtosis, _ = tails(x)
    n = np.maximum(x.n, 1)
    z = ndtri(1 - (1 - level) / (4 * max(np.size(n), 1)))
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
