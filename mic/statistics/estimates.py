"""Statistics of Monte Carlo samples with their confidence intervals.

Every estimate takes samples along the first axis of ``x``, (n,) or (n, k), or their :class:`Moments`. Values that are
not finite (failed samples) are excluded and counted. Undefined estimates are NaN: one sample, or samples without
spread, give no interval.

Kinks, jumps and skewed inputs make samples with long tails, of which few samples show too little. So the variance of
each estimate of a spread is that of the samples and of :data:`ADDED` more, as far from the mean as the farthest. An
event that no sample shows cannot be included: :func:`rarest_event` and :func:`confidence` state what the intervals hold
for, by the number of samples. The samples themselves cannot lower the claim: intervals miss where they look harmless.

References
----------
.. [1] P. Hall: On the removal of skewness by transformation, J. R. Stat. Soc. B 54 (1992) 221-228.
.. [2] C. J. Clopper, E. S. Pearson: The use of confidence or fiducial limits illustrated in the case of the binomial,
       Biometrika 26 (1934) 404-413.
.. [3] S. S. Wilks: Determination of sample sizes for setting tolerance limits, Ann. Math. Statist. 12 (1941) 91-96.
.. [4] D. W. Scott: Multivariate Density Estimation, 2nd ed., 2015, section 6.2.
.. [5] F. E. Satterthwaite: An approximate distribution of estimates of variance components, Biometrics Bull. 2 (1946)
       110-114.
.. [6] P. Pébay: Formulas for robust, one-pass parallel computation of covariances and arbitrary-order statistical
       moments, Sandia report SAND2008-6212, 2008.
.. [7] J. Shao, D. Tu: The Jackknife and Bootstrap, 1995, section 2.3 (grouped jackknife).
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, fields
from typing import Any

import numpy as np
from scipy.special import betaincinv, chdtri, stdtrit

__all__ = [
    "ADDED",
    "LEVEL",
    "SEEN",
    "Estimate",
    "Moments",
    "confidence",
    "covered_share",
    "density",
    "grouped_jackknife",
    "jackknife_error",
    "jackknife_interval",
    "maximum",
    "mean",
    "minimum",
    "rarest_event",
    "share",
    "sigma",
    "six_sigma",
    "tails",
]

LEVEL = 0.95
ADDED = 2  # samples as far from the mean as the farthest
SHOWN = 15  # samples that must show an event for the intervals to include it
SEEN = 3  # with surrogates; then 95 of 100 sets of samples show it once or more
CLAIMS = ((50, 0.95), (20, 0.9), (3, 0.8))  # least number of samples, and what 95 % intervals then hold for, at least
EPS = np.finfo(float).eps


@dataclass(frozen=True)
class Estimate:
    """An estimate with its confidence interval.

    Attributes
    ----------
    value, low, high : float or (k,) array
        In the unit of the samples, or 1; NaN where it does not exist.
    used, excluded : int or (k,) int array
        Number of finite samples, and of excluded ones.
    """

    value: np.ndarray
    low: np.ndarray
    high: np.ndarray
    used: np.ndarray
    excluded: np.ndarray

    @classmethod
    def of(cls, x, value, low, high) -> Estimate:
        """An estimate from samples or moments `x`, which give the numbers of samples."""
        moments = Moments.of(x)
        return cls(*(_scalar_or_array(np.asarray(a)) for a in (value, low, high, moments.n, moments.excluded)))

    def at(self, k: int) -> Estimate:
        """The estimate of one of k quantities."""
        return Estimate(*(_scalar_or_array(np.asarray(getattr(self, field.name)[k])) for field in fields(self)))


@dataclass(frozen=True)
class Moments:
    """Number, mean, central moments and extremes of samples; they can be merged without the samples.

    Attributes
    ----------
    n, excluded : int array
        Numbers of finite values and of others, which are excluded.
    mean, rest : array
        Mean, NaN without values, and its rounding error (compensated summation, for means far from 0).
    m2, m3, m4 : array
        ``Σ (x - mean)^p``, p = 2, 3, 4.
    low, high : array
        Smallest and largest value; ∞ and -∞ without values.
    """

    n: np.ndarray
    excluded: np.ndarray
    mean: np.ndarray
    rest: np.ndarray
    m2: np.ndarray
    m3: np.ndarray
    m4: np.ndarray
    low: np.ndarray
    high: np.ndarray

    @classmethod
    def of(cls, x) -> Moments:
        """Moments of samples along the first axis; moments are returned unchanged."""
        if isinstance(x, Moments):
            return x
        x = np.asarray(x, dtype=float)
        finite = np.isfinite(x)
        n = finite.sum(axis=0)
        if not finite.all():
            low = np.where(finite, x, np.inf).min(axis=0, initial=np.inf)
            high = np.where(finite, x, -np.inf).max(axis=0, initial=-np.inf)
            x = np.where(finite, x, 0.0)
        else:
            low, high = x.min(axis=0, initial=np.inf), x.max(axis=0, initial=-np.inf)
        mean = x.sum(axis=0) / np.maximum(n, 1)
        off = np.where(finite, x - mean, 0.0)
        rest = off.sum(axis=0) / np.maximum(n, 1)
        off = np.where(finite, off - rest, 0.0)
        square = off**2
        m2, m3, m4 = square.sum(axis=0), (square * off).sum(axis=0), (square**2).sum(axis=0)
        return cls(n, len(x) - n, np.where(n > 0, mean, np.nan), rest, m2, m3, m4, low, high)

    def merged(self, other: Moments) -> Moments:
        """Moments of the union of both sets of samples [6]_."""
        a, b = self, other
        n = a.n + b.n
        # Floats: n³ overflows 64-bit integers at two million samples.
        p, q = np.asarray(a.n / np.maximum(n, 1)), np.asarray(b.n / np.maximum(n, 1))
        start = np.where(a.n > 0, a.mean, np.where(b.n > 0, b.mean, 0.0))
        d = np.where(b.n > 0, b.mean - start, 0.0) + (b.rest - a.rest)
        weight = n * p * q  # n_a n_b / n; 0 where either has no samples
        step = a.rest + d * q
        mean = start + step
        rest = (start - mean) + step
        m2 = a.m2 + b.m2 + d**2 * weight
        m3 = a.m3 + b.m3 + d**3 * weight * (p - q) + 3 * d * (p * b.m2 - q * a.m2)
        m4 = (
            a.m4
            + b.m4
            + d**4 * weight * (p**2 - p * q + q**2)
            + 6 * d**2 * (p**2 * b.m2 + q**2 * a.m2)
            + 4 * d * (p * b.m3 - q * a.m3)
        )
        low, high = np.minimum(a.low, b.low), np.maximum(a.high, b.high)
        mean = np.where(n > 0, mean, np.nan)
        return Moments(n, a.excluded + b.excluded, mean, rest, m2, m3, m4, low, high)

    def at(self, place) -> Moments:
        """Moments of the quantities at an index of the arrays."""
        return Moments(*(getattr(self, field.name)[place] for field in fields(self)))

    @property
    def deviation(self) -> np.ndarray:
        """Standard deviation (n - 1 in the denominator), NaN for fewer than two values.

        A spread within the rounding error of the values counts as none.
        """
        known = self.n > 1
        size = np.maximum(np.abs(self.low), np.abs(self.high))
        none = known & (np.where(known, self.high, 0.0) - np.where(known, self.low, 0.0) <= 8 * EPS * size)
        return np.where(none, 0.0, np.where(known, np.sqrt(self.m2 / np.maximum(self.n - 1, 1)), np.nan))


def mean(x) -> Estimate:
    """Mean, with Student's t interval corrected for skewness [1]_; NaN without samples, no interval of fewer than 3."""
    moments = Moments.of(x)
    n, m = moments.n, moments.mean
    low, high = (_skewness_corrected(sign * _t_quantile(n), moments) for sign in (1, -1))
    error = _known_spread(moments) / np.sqrt(np.maximum(n, 1))
    return Estimate.of(moments, m, m - low * error, m - high * error)


def sigma(x) -> Estimate:
    """Standard deviation (n - 1 in the denominator).

    The interval is the chi-squared one with ``ν = 2 n / (κ - 3 + 2 n/(n - 1))`` degrees of freedom [5]_, n - 1 for a
    normal population. The kurtosis κ is that of the samples and of :data:`ADDED` more as far as the farthest.
    """
    moments = Moments.of(x)
    low, high = _sigma_factors(moments)
    spread = _known_spread(moments)
    return Estimate.of(moments, moments.deviation, low * spread, high * spread)


def six_sigma(x) -> Estimate:
    """Six standard deviations; interval as :func:`sigma`."""
    s = sigma(x)
    return Estimate(6 * s.value, 6 * s.low, 6 * s.high, s.used, s.excluded)


def minimum(x) -> Estimate:
    """Smallest sample.

    It is an upper bound of the population's minimum; there is no lower bound, see :func:`covered_share`.
    """
    moments = Moments.of(x)
    value = np.where(moments.n > 0, moments.low, np.nan)
    return Estimate.of(moments, value, np.where(moments.n > 0, -np.inf, np.nan), value)


def maximum(x) -> Estimate:
    """Largest sample.

    It is a lower bound of the population's maximum; there is no upper bound, see :func:`covered_share`.
    """
    moments = Moments.of(x)
    value = np.where(moments.n > 0, moments.high, np.nan)
    return Estimate.of(moments, value, value, np.where(moments.n > 0, np.inf, np.nan))


def covered_share(n: int) -> float:
    """Share of the population between the smallest and largest of n samples, with the given confidence [3]_.

    The root p of ``n p^(n-1) - (n-1) p^n = 1 - LEVEL``, whatever the distribution; NaN for fewer than two samples.
    """
    if n < 2:
        return float("nan")
    from scipy.optimize import brentq  # slow to import, and only reports need it

    return float(brentq(lambda p: n * p ** (n - 1) - (n - 1) * p**n - (1 - LEVEL), 0.0, 1.0, xtol=1e-14))


def share(count, n) -> Estimate:
    """Share ``count / n`` with the exact interval of Clopper and Pearson [2]_, vectorised over arrays.

    Parameters
    ----------
    count, n : int or int array
    """
    count, n = np.broadcast_arrays(np.asarray(count, dtype=float), np.asarray(n, dtype=float))
    a = (1 - LEVEL) / 2
    known = n > 0
    low = np.where(count > 0, betaincinv(np.maximum(count, 1), n - count + 1, a), 0.0)
    high = np.where(count < n, betaincinv(count + 1, np.maximum(n - count, 1), 1 - a), 1.0)
    value = count / np.where(known, n, np.nan)
    low, high = np.where(known, low, np.nan), np.where(known, high, np.nan)
    excluded = np.zeros(n.shape, dtype=int)
    return Estimate(*(_scalar_or_array(a) for a in (value, low, high, n.astype(int), excluded)))


def jackknife_error(without: np.ndarray, added: int = 0) -> np.ndarray:
    """Jackknife standard error ``s² = (R − 1)/R Σ (θ_(r) − θ̄)²`` [7]_.

    Parameters
    ----------
    without : (R, ...) array
        θ_(r): the statistic without group r of the samples.
    added : int
        Further groups as far as the farthest.
    """
    R, square = len(without), (without - without.mean(axis=0)) ** 2
    return np.sqrt((R - 1) / R * (square.sum(axis=0) + added * square.max(axis=0)))


def jackknife_interval(value, without: np.ndarray, added: int = ADDED) -> tuple[Any, Any]:
    """Ends of the interval of a smooth statistic: that of the mean of its pseudo-values ``R θ − (R − 1) θ_(r)`` [7]_.

    Parameters
    ----------
    value : float or array
        θ
    without, added
        As :func:`jackknife_error`, R > 1.
    """
    R, error = len(without), jackknife_error(without, added)
    values = Moments.of(R * value - (R - 1) * without)
    low, high = (_skewness_corrected(sign * _t_quantile(R), values) for sign in (1, -1))
    return value - low * error, value - high * error


def grouped_jackknife(x, group, statistic: Callable, positive: bool = False, added: int = ADDED) -> Estimate:
    """A statistic of samples whose groups are independent, such as those of Latin hypercubes.

    The interval is :func:`jackknife_interval`; NaN if the groups do not differ.

    Parameters
    ----------
    x : (n,) array
        Values that are not finite are excluded.
    group : (n,) int array
    statistic : callable
        Takes samples (n,), returns a float.
    positive : bool
        Whether the statistic is positive, such as a standard deviation: the jackknife takes its logarithm.
    added : int
        As :func:`jackknife_interval`; 0 for a mean.
    """
    x, group = np.asarray(x, dtype=float), np.asarray(group)
    value, groups = statistic(x), np.unique(group[np.isfinite(x)])
    scale, inverse = (np.log, np.exp) if positive else (np.asarray, np.asarray)
    low, high = np.nan, np.nan
    if len(groups) > 1 and np.isfinite(value) and (value > 0 or not positive):
        with np.errstate(divide="ignore", invalid="ignore"):
            without = np.array([scale(statistic(x[group != r])) for r in groups])
            ends = jackknife_interval(scale(value), without, added)
        if np.isfinite(ends).all() and ends[0] < ends[1]:
            low, high = map(inverse, ends)
    return Estimate.of(x, value, low, high)


def density(x, points) -> np.ndarray:
    """Gaussian kernel density estimate, bandwidth by Scott's rule ``σ n^(-1/5)`` [4]_.

    Parameters
    ----------
    x : (n,) array
    points : (p,) array
        Points at which it is evaluated.

    Returns
    -------
    (p,) array
        In 1 / unit of `x`; NaN if the samples have no spread (``scipy.stats.gaussian_kde`` raises an error then).
    """
    x, points = np.asarray(x, dtype=float), np.asarray(points, dtype=float)
    moments = Moments.of(x)
    n, s = moments.n, moments.deviation
    if not s > 0:
        return np.full(points.shape, np.nan)
    width = s * n ** (-0.2)
    z = (points[:, None] - x[np.isfinite(x)]) / width
    return np.exp(-0.5 * z**2).sum(axis=1) / (n * width * np.sqrt(2 * np.pi))


def tails(x) -> tuple[np.ndarray, np.ndarray]:
    """Skewness and kurtosis (k,), 0 and 1 without spread."""
    moments = Moments.of(x)
    n = np.maximum(moments.n, 1)
    varies = moments.deviation > 0
    second = np.where(varies, moments.m2, 1.0) / n
    skewness = np.where(varies, moments.m3 / n / second**1.5, 0.0)
    return skewness, np.where(varies, moments.m4 / n / second**2, 1.0)


def confidence(n) -> np.ndarray:
    """Share of the 95 % intervals of `n` samples that hold, at least, for what :func:`rarest_event` includes.

    NaN for fewer than three samples.
    """
    n = np.asarray(n)
    return np.select([n >= least for least, _ in CLAIMS], [level for _, level in CLAIMS], np.nan)


def rarest_event(n, shown: float = SHOWN) -> np.ndarray:
    """Share of the assemblies that must do something for the intervals of `n` samples to include it.

    About fifteen of the samples show such an event. Rarer jumps, and contacts that close more rarely, may show in
    too few samples, or in none.

    Parameters
    ----------
    n : int or array
    shown : float
        Number of samples; :data:`SEEN` with surrogates.
    """
    return np.minimum(shown / np.maximum(np.asarray(n, dtype=float), 1.0), 1.0)


def _t_quantile(n):
    return np.where(n > 1, stdtrit(np.maximum(n - 1, 1), 0.5 + LEVEL / 2), np.nan)


def _known_spread(moments: Moments) -> np.ndarray:
    """Standard deviation that gives an interval: of three samples or more, and not 0; else NaN."""
    s = moments.deviation
    return np.where((moments.n > 2) & (s > 0), s, np.nan)


def _skewness_corrected(quantile: np.ndarray, moments: Moments) -> np.ndarray:
    """Hall's transformation of a quantile of the studentised mean [1]_."""
    skewness, _ = tails(moments)
    root_n = np.sqrt(np.maximum(moments.n, 1))
    u = quantile - skewness / (6 * root_n)
    root = np.cbrt(1 + skewness / root_n * u)
    return 3 * u / (1 + root + root**2)


def _sigma_factors(moments: Moments) -> tuple[np.ndarray, ...]:
    """Ends of the interval of σ, as multiples of the estimate."""
    n = np.maximum(moments.n, 2)
    varies = moments.deviation > 0
    second = np.where(varies, moments.m2, 1.0)
    farthest = np.where(varies, np.maximum(moments.high - moments.mean, moments.mean - moments.low), 0.0)
    kurtosis = n * (np.where(varies, moments.m4, 0.0) + ADDED * farthest**4) / second**2
    freedom = 2 * n / np.where(varies, kurtosis - 3 + 2 * n / (n - 1), 1.0)
    return tuple(np.sqrt(freedom / chdtri(freedom, tail)) for tail in ((1 - LEVEL) / 2, (1 + LEVEL) / 2))


def _scalar_or_array(array):
    """The array; a Python number if it has no axes."""
    return array.item() if np.ndim(array) == 0 else array
