"""Statistics of Monte Carlo samples, each with the uncertainty that a finite number of samples leaves.

Samples run along the first axis of ``x``, (n,) or (n, k); values that are not finite (failed samples) are left out of
every estimate and counted. Where an estimate does not exist it is NaN: no interval can be had from one sample, nor from
samples without spread, which would otherwise pass for certainty.

References
----------
.. [1] G. Casella, R. L. Berger: Statistical Inference, 2nd ed., 2002, section 9.2 (t and chi-squared intervals).
.. [2] C. J. Clopper, E. S. Pearson: The use of confidence or fiducial limits illustrated in the case of the binomial,
       Biometrika 26 (1934) 404-413.
.. [3] S. S. Wilks: Determination of sample sizes for setting tolerance limits, Ann. Math. Statist. 12 (1941) 91-96.
.. [4] D. W. Scott: Multivariate Density Estimation, 2nd ed., 2015, section 6.2.
.. [5] D. G. Bonett: Approximate confidence interval for standard deviation of nonnormal distributions, Comput. Stat.
       Data Anal. 50 (2006) 775-782.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.optimize import brentq
from scipy.special import betaincinv, chdtri, ndtri, stdtrit

__all__ = [
    "LEVEL",
    "Estimate",
    "covered_share",
    "density",
    "maximum",
    "mean",
    "minimum",
    "share",
    "sigma",
    "six_sigma",
    "tails",
]

LEVEL = 0.95


@dataclass(frozen=True)
class Estimate:
    """An estimate with its confidence interval.

    Attributes
    ----------
    value, low, high : float or (k,) array
        In the unit of the samples, or 1; NaN where it does not exist.
    used, excluded : int or (k,) int array
        Samples that the estimate rests on, and samples left out because they were not finite.
    """

    value: np.ndarray
    low: np.ndarray
    high: np.ndarray
    used: np.ndarray
    excluded: np.ndarray

    @classmethod
    def of(cls, x, value, low, high) -> Estimate:
        """The estimate from samples `x`, of which those that are not finite were left out."""
        finite = np.isfinite(np.asarray(x, dtype=float))
        return cls(*(_plain(np.asarray(a)) for a in (value, low, high, finite.sum(axis=0), (~finite).sum(axis=0))))


def mean(x, level: float = LEVEL) -> Estimate:
    """Mean, with the interval of Student's t [1]_; NaN without samples."""
    n, m, s = _moments(x)
    half = _t_quantile(n, level) * np.where(s > 0, s, np.nan) / np.sqrt(np.maximum(n, 1))
    return Estimate.of(x, m, m - half, m + half)


def sigma(x, level: float = LEVEL) -> Estimate:
    """Standard deviation (n - 1 in the denominator).

    Its interval is the chi-squared one of a normal population [1]_ unless the samples show heavier tails than that;
    such an interval would be too narrow, and Bonett's, which takes the kurtosis from the samples, stands in [5]_.
    """
    n, _, s = _moments(x)
    low, high = _sigma_factors(x, level)
    spread = np.where(s > 0, s, np.nan)
    return Estimate.of(x, s, low * spread, high * spread)


def six_sigma(x, level: float = LEVEL) -> Estimate:
    """Six standard deviations: the variation as the industry quotes it; interval as :func:`sigma`."""
    s = sigma(x, level)
    return Estimate(6 * s.value, 6 * s.low, 6 * s.high, s.used, s.excluded)


def minimum(x) -> Estimate:
    """Smallest sample.

    The population's minimum is no larger; nothing bounds it from below, see :func:`covered_share`.
    """
    value = _extreme(x, np.minimum)
    return Estimate.of(x, value, np.where(np.isnan(value), np.nan, -np.inf), value)


def maximum(x) -> Estimate:
    """Largest sample.

    The population's maximum is no smaller; nothing bounds it from above, see :func:`covered_share`.
    """
    value = _extreme(x, np.maximum)
    return Estimate.of(x, value, value, np.where(np.isnan(value), np.nan, np.inf))


def covered_share(n: int, level: float = LEVEL) -> float:
    """Share of the population that lies between the smallest and largest of n samples, with the given confidence [3]_.

    The root p of ``n p^(n-1) - (n-1) p^n = 1 - level``, whatever the distribution; NaN for fewer than two samples.
    """
    if n < 2:
        return float("nan")
    return float(brentq(lambda p: n * p ** (n - 1) - (n - 1) * p**n - (1 - level), 0.0, 1.0, xtol=1e-14))


def share(count, n, level: float = LEVEL) -> Estimate:
    """Share ``count / n`` with the exact interval of Clopper and Pearson [2]_.

    Parameters
    ----------
    count, n : int or int array
    """
    count, n = np.broadcast_arrays(np.asarray(count, dtype=float), np.asarray(n, dtype=float))
    a = (1 - level) / 2
    known = n > 0
    low = np.where(count > 0, betaincinv(np.maximum(count, 1), n - count + 1, a), 0.0)
    high = np.where(count < n, betaincinv(count + 1, np.maximum(n - count, 1), 1 - a), 1.0)
    value = count / np.where(known, n, np.nan)
    nothing = np.zeros(n.shape, dtype=int)
    return Estimate(
        _plain(value),
        _plain(np.where(known, low, np.nan)),
        _plain(np.where(known, high, np.nan)),
        _plain(n.astype(int)),
        _plain(nothing),
    )


def density(x, points) -> np.ndarray:
    """Gaussian kernel density of one set of samples, bandwidth by Scott's rule ``σ n^(-1/5)`` [4]_.

    Parameters
    ----------
    x : (n,) array
    points : (p,) array
        Where to evaluate.

    Returns
    -------
    (p,) array
        In 1 / unit of `x`; NaN where the samples have no spread, and so no density.
    """
    x, points = np.asarray(x, dtype=float), np.asarray(points, dtype=float)
    n, _, s = _moments(x)
    if not s > 0:
        return np.full(points.shape, np.nan)
    width = s * n ** (-0.2)
    z = (points[:, None] - x[np.isfinite(x)]) / width
    return np.exp(-0.5 * z**2).sum(axis=1) / (n * width * np.sqrt(2 * np.pi))


def tails(x) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Skewness, kurtosis, and whether the tails are heavy.

    They are where the kurtosis exceeds a normal population's by more than two of its standard errors.

    Returns
    -------
    skewness, kurtosis : (k,) array
        0 and 1 without spread.
    heavy : (k,) bool array
    """
    x = np.asarray(x, dtype=float)
    n, m, s = _moments(x)
    z = np.where(np.isfinite(x), x - m, 0.0) / np.where(s > 0, s, 1.0)
    second = (z**2).sum(axis=0) / np.maximum(n, 1)
    second = np.where(second > 0, second, 1.0)
    skewness = (z**3).sum(axis=0) / np.maximum(n, 1) / second**1.5
    kurtosis = (z**4).sum(axis=0) / np.maximum(n, 1) / second**2
    return skewness, kurtosis, kurtosis - 3 > 2 * np.sqrt(24 / np.maximum(n, 1))


def _moments(x):
    """Number of finite values, their mean and standard deviation, along the first axis.

    A spread within rounding of the values counts as none.
    """
    x = np.asarray(x, dtype=float)
    finite = np.isfinite(x)
    n = finite.sum(axis=0)
    values = np.where(finite, x, 0.0)
    m = np.where(n > 0, values.sum(axis=0) / np.maximum(n, 1), np.nan)
    off = np.where(finite, x - np.where(np.isnan(m), 0.0, m), 0.0) if len(x) else x
    s = np.sqrt((off**2).sum(axis=0) / np.maximum(n - 1, 1))
    size = np.abs(values).max(axis=0, initial=0.0)
    s = np.where(np.abs(off).max(axis=0, initial=0.0) <= 8 * np.finfo(float).eps * size, 0.0, s)
    return n, m, np.where(n > 1, s, np.nan)


def _t_quantile(n, level):
    return np.where(n > 1, stdtrit(np.maximum(n - 1, 1), 0.5 + level / 2), np.nan)


def _sigma_factors(x, level):
    """Ends of the interval of σ, as multiples of the estimate."""
    n, _, _ = _moments(x)
    freedom = np.maximum(n - 1, 1)
    known = np.where(n > 1, 1.0, np.nan)
    _, kurtosis, heavy = tails(x)
    z = ndtri(0.5 + level / 2)
    c = n / np.maximum(n - z, 1)
    spread = z * c * np.sqrt(np.where(heavy, kurtosis - (n - 3) / np.maximum(n, 1), 0.0) / freedom)
    return tuple(
        known * np.where(heavy, np.sqrt(c) * np.exp(sign * spread / 2), np.sqrt(freedom / chdtri(freedom, tail)))
        for sign, tail in ((-1, (1 - level) / 2), (1, (1 + level) / 2))
    )


def _extreme(x, choose):
    x = np.asarray(x, dtype=float)
    worst = np.inf if choose is np.minimum else -np.inf
    value = choose.reduce(np.where(np.isfinite(x), x, worst), axis=0, initial=worst)
    return np.where(np.isfinite(value), value, np.nan)


def _plain(array):
    """Scalars as Python numbers."""
    return array.item() if np.ndim(array) == 0 else array
