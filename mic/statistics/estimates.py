"""Statistics of Monte Carlo samples, each with the uncertainty that a finite number of samples leaves.

Every estimate takes samples or their :class:`Moments`. Samples run along the first axis of ``x``, (n,) or (n, k);
values that are not finite (failed samples) are left out of every estimate and counted. Where an estimate does not exist
it is NaN: no interval can be had from one sample, nor from samples without spread, which would otherwise pass for
certainty.

References
----------
.. [1] G. Casella, R. L. Berger: Statistical Inference, 2nd ed., 2002, section 9.2 (t and chi-squared intervals).
.. [2] C. J. Clopper, E. S. Pearson: The use of confidence or fiducial limits illustrated in the case of the binomial,
       Biometrika 26 (1934) 404-413.
.. [3] S. S. Wilks: Determination of sample sizes for setting tolerance limits, Ann. Math. Statist. 12 (1941) 91-96.
.. [4] D. W. Scott: Multivariate Density Estimation, 2nd ed., 2015, section 6.2.
.. [5] D. G. Bonett: Approximate confidence interval for standard deviation of nonnormal distributions, Comput. Stat.
       Data Anal. 50 (2006) 775-782.
.. [6] P. Pébay: Formulas for robust, one-pass parallel computation of covariances and arbitrary-order statistical
       moments, Sandia report SAND2008-6212, 2008.
.. [7] J. Shao, D. Tu: The Jackknife and Bootstrap, 1995, section 2.3 (grouped jackknife).
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, fields

import numpy as np
from scipy.optimize import brentq
from scipy.special import betaincinv, chdtri, ndtri, stdtrit

__all__ = [
    "LEVEL",
    "Estimate",
    "Moments",
    "covered_share",
    "density",
    "grouped",
    "maximum",
    "mean",
    "minimum",
    "share",
    "sigma",
    "six_sigma",
    "tails",
]

LEVEL = 0.95
EPS = np.finfo(float).eps


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
        found = Moments.of(x)
        return cls(*(_plain(np.asarray(a)) for a in (value, low, high, found.n, found.excluded)))


@dataclass(frozen=True)
class Moments:
    """What every estimate rests on: number, mean, central moments and extremes of samples that need not be kept.

    Attributes
    ----------
    n, excluded : int array
        Finite values, and others, which are left out.
    mean, rest : array
        The mean, NaN without values; and what rounding left of it, so that means far from 0 are told apart.
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
        """Those of samples along the first axis; moments pass as they are."""
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
        """Those of both sets of samples together [6]_."""
        a, b = self, other
        n = a.n + b.n
        # As floats: n³ leaves the integers behind at two million samples.
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
        """Those of some of the quantities, by an index into the arrays."""
        return Moments(*(getattr(self, field.name)[place] for field in fields(self)))

    @property
    def deviation(self) -> np.ndarray:
        """Standard deviation (n - 1 in the denominator), NaN for fewer than two values.

        A spread within rounding of the values counts as none.
        """
        known = self.n > 1
        size = np.maximum(np.abs(self.low), np.abs(self.high))
        none = known & (np.where(known, self.high, 0.0) - np.where(known, self.low, 0.0) <= 8 * EPS * size)
        return np.where(none, 0.0, np.where(known, np.sqrt(self.m2 / np.maximum(self.n - 1, 1)), np.nan))


def mean(x, level: float = LEVEL) -> Estimate:
    """Mean, with the interval of Student's t [1]_; NaN without samples."""
    found = Moments.of(x)
    n, m, s = found.n, found.mean, found.deviation
    half = _t_quantile(n, level) * np.where(s > 0, s, np.nan) / np.sqrt(np.maximum(n, 1))
    return Estimate.of(found, m, m - half, m + half)


def sigma(x, level: float = LEVEL) -> Estimate:
    """Standard deviation (n - 1 in the denominator).

    Its interval is the chi-squared one of a normal population [1]_ unless the samples show heavier tails than that;
    such an interval would be too narrow, and Bonett's, which takes the kurtosis from the samples, stands in [5]_.
    """
    found = Moments.of(x)
    s = found.deviation
    low, high = _sigma_factors(found, level)
    spread = np.where(s > 0, s, np.nan)
    return Estimate.of(found, s, low * spread, high * spread)


def six_sigma(x, level: float = LEVEL) -> Estimate:
    """Six standard deviations: the variation as the industry quotes it; interval as :func:`sigma`."""
    s = sigma(x, level)
    return Estimate(6 * s.value, 6 * s.low, 6 * s.high, s.used, s.excluded)


def minimum(x) -> Estimate:
    """Smallest sample.

    The population's minimum is no larger; nothing bounds it from below, see :func:`covered_share`.
    """
    found = Moments.of(x)
    value = np.where(found.n > 0, found.low, np.nan)
    return Estimate.of(found, value, np.where(found.n > 0, -np.inf, np.nan), value)


def maximum(x) -> Estimate:
    """Largest sample.

    The population's maximum is no smaller; nothing bounds it from above, see :func:`covered_share`.
    """
    found = Moments.of(x)
    value = np.where(found.n > 0, found.high, np.nan)
    return Estimate.of(found, value, value, np.where(found.n > 0, np.inf, np.nan))


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


def grouped(x, group, figure: Callable, size: bool = False, level: float = LEVEL) -> Estimate:
    """A figure of samples that are independent only from group to group, as those of a Latin hypercube are.

    Its interval comes from the figure without each of the R groups in turn, the grouped jackknife [7]_:
    ``s² = (R − 1)/R Σ (θ_(r) − θ̄)²``, with Student's t of R − 1 degrees of freedom. NaN where the groups do not differ.

    Parameters
    ----------
    x : (n,) array
        Values that are not finite are left out.
    group : (n,) int array
    figure : callable
        Of samples (n,); returns a float.
    size : bool
        Whether the figure is a positive size, such as a standard deviation, whose logarithm is judged.
    """
    x, group = np.asarray(x, dtype=float), np.asarray(group)
    value, every = figure(x), np.unique(group[np.isfinite(x)])
    scale, back = (np.log, np.exp) if size else (np.asarray, np.asarray)
    R, half = len(every), np.nan
    if R > 1 and np.isfinite(value) and (value > 0 or not size):
        with np.errstate(divide="ignore", invalid="ignore"):
            without = np.array([scale(figure(x[group != r])) for r in every])
            spread = np.sqrt((R - 1) / R * np.sum((without - without.mean()) ** 2))
        half = float(stdtrit(R - 1, 0.5 + level / 2)) * spread if np.isfinite(spread) and spread > 0 else np.nan
    centre = scale(value) if np.isfinite(half) else np.nan
    return Estimate.of(x, value, back(centre - half), back(centre + half))


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
    found = Moments.of(x)
    n, s = found.n, found.deviation
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
    found = Moments.of(x)
    n = np.maximum(found.n, 1)
    spread = found.deviation > 0
    second = np.where(spread, found.m2, 1.0) / n
    skewness = np.where(spread, found.m3 / n / second**1.5, 0.0)
    kurtosis = np.where(spread, found.m4 / n / second**2, 1.0)
    return skewness, kurtosis, kurtosis - 3 > 2 * np.sqrt(24 / n)


def _t_quantile(n, level):
    return np.where(n > 1, stdtrit(np.maximum(n - 1, 1), 0.5 + level / 2), np.nan)


def _sigma_factors(x, level):
    """Ends of the interval of σ, as multiples of the estimate."""
    n = x.n
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


def _plain(array):
    """Scalars as Python numbers."""
    return array.item() if np.ndim(array) == 0 else array
