"""Differences between two assemblies evaluated on the same samples, with confidence intervals from the pairs.

Scatter that both assemblies share cancels in the difference, so its interval is narrower than those of the two
statistics. Samples run along the first axis; pairs with a value that is not finite are excluded. Intervals of
statistics that are smooth in the samples are those of the jackknife [1]_ over groups
(:func:`mic.statistics.estimates.jackknife_interval`); independent samples are groups of one.

References
----------
.. [1] J. Shao, D. Tu: The Jackknife and Bootstrap, 1995, sections 1.2 and 2.3.
.. [2] R. G. Newcombe: Improved confidence intervals for the difference between binomial proportions based on paired
       data, Statist. Med. 17 (1998) 2635-2650.
"""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
from scipy.special import ndtri, stdtrit

from mic.statistics.estimates import ADDED, LEVEL, Estimate, jackknife_interval, share

__all__ = [
    "centred_capability_change",
    "jackknife",
    "mean_change",
    "share_change",
    "six_sigma_change",
    "standard_error",
]

#: A statistic as a function of means and standard deviations.
Statistic = Callable[[np.ndarray, np.ndarray], np.ndarray]


def mean_change(a, b, group=None) -> Estimate:
    """Mean of `b` minus mean of `a`.

    Parameters
    ----------
    a, b : (n,) array
        Values on the same samples.
    group : (n,) int array, optional
        Groups of samples of a sampling design; default: independent samples.
    """
    statistic = lambda mean, sigma: mean
    return _difference(a, b, group, statistic, statistic, added=0)


def six_sigma_change(a, b, group=None) -> Estimate:
    """6σ of `b` minus 6σ of `a`; arguments as :func:`mean_change`."""
    statistic = lambda mean, sigma: 6 * sigma
    return _difference(a, b, group, statistic, statistic)


def centred_capability_change(a, b, limits_a, limits_b, group=None) -> Estimate:
    """Cpk of `b` minus Cpk of `a`, each against its own limits.

    Parameters
    ----------
    a, b, group
        As :func:`mean_change`.
    limits_a, limits_b : pair of float
        Lower and upper, in the unit of the samples.
    """

    def capability(limits) -> Statistic:
        lower, upper = limits
        return lambda mean, sigma: np.minimum(upper - mean, mean - lower) / (3 * sigma)

    return _difference(a, b, group, capability(limits_a), capability(limits_b))


def share_change(a, b, group=None) -> Estimate:
    """Share of true samples of `b` minus that of `a`.

    With ``n₀₁`` samples true in `b` only and ``n₁₀`` in `a` only, it is ``(n₀₁ − n₁₀)/n``. Its interval adds the
    squares of those of both shares (Clopper and Pearson) and their covariance [2]_, which is valid even if no sample
    differs; with groups, it is that of :func:`mean_change`.

    Parameters
    ----------
    a, b : (n,) bool array
    group : (n,) int array, optional
    """
    a, b = np.asarray(a, dtype=float), np.asarray(b, dtype=float)
    if group is not None:
        return mean_change(a, b, group)
    n, more, less = len(a), float((b > a).sum()), float((b < a).sum())
    if not n:
        return Estimate.of(a, np.nan, np.nan, np.nan)
    value, of_b, of_a = (more - less) / n, share(more, n), share(less, n)
    covariance = 2 * float(ndtri(0.5 + LEVEL / 2)) ** 2 * of_a.value * of_b.value / n
    down, up = (
        np.sqrt((one.value - one.low) ** 2 + (other.high - other.value) ** 2 + covariance)
        for one, other in ((of_b, of_a), (of_a, of_b))
    )
    return Estimate.of(a, value, max(value - down, -1.0), min(value + up, 1.0))


def standard_error(change: Estimate) -> float:
    """Standard error that corresponds to the width of the interval of a change of independent samples."""
    return float((change.high - change.low) / (2 * stdtrit(change.used - 1, 0.5 + LEVEL / 2)))


def jackknife(y, statistic: Callable[[np.ndarray], float], groups: int = 50, added: int = ADDED) -> Estimate:
    """Any statistic of several columns with its jackknife interval; NaN for fewer than three samples.

    Parameters
    ----------
    y : (n, k) array
        Independent samples, such as the outputs of two assemblies side by side; samples with a value that is not finite
        are excluded.
    statistic : callable
        Takes samples (m, k), returns a number.
    groups : int
        Largest number of groups R; sample i belongs to group i mod R.
    added : int
        As :func:`mic.statistics.estimates.jackknife_interval`; 0 for a mean.
    """
    y = np.asarray(y, dtype=float)
    valid = np.isfinite(y).all(axis=1)
    used, y = np.where(valid, 0.0, np.nan), y[valid]
    if len(y) < 3:
        return Estimate.of(used, np.nan, np.nan, np.nan)
    R = min(groups, len(y))
    group = np.arange(len(y)) % R
    without = np.array([statistic(y[group != r]) for r in range(R)])
    value = statistic(y)
    return Estimate.of(used, value, *jackknife_interval(value, without, added))


def _difference(a, b, group, statistic_a: Statistic, statistic_b: Statistic, added: int = ADDED) -> Estimate:
    """Difference of two statistics; NaN for fewer than three samples."""
    a, b = np.asarray(a, dtype=float), np.asarray(b, dtype=float)
    valid = np.isfinite(a) & np.isfinite(b)
    used = np.where(valid, b - a, np.nan)
    group = np.unique(np.arange(len(a))[valid] if group is None else np.asarray(group)[valid], return_inverse=True)[1]
    a, b = a[valid], b[valid]
    if len(a) < 3:
        return Estimate.of(used, np.nan, np.nan, np.nan)
    with np.errstate(divide="ignore", invalid="ignore"):
        whole, without = (
            statistic_b(*moments_b) - statistic_a(*moments_a)
            for moments_a, moments_b in zip(_moments(a, group), _moments(b, group))
        )
        ends = jackknife_interval(whole, without, added) if len(without) > 1 else (np.nan, np.nan)
    return Estimate.of(used, whole, *(ends if np.isfinite(ends).all() else (np.nan, np.nan)))


def _moments(x: np.ndarray, group: np.ndarray):
    """Mean and standard deviation of all samples, then (R,) each without one of R groups."""
    n, centre = len(x), x.mean()
    centred = x - centre
    size, first, second = (np.bincount(group, weights) for weights in (np.ones(n), centred, centred**2))
    rest = n - size
    mean = (centred.sum() - first) / rest
    sigma = np.sqrt(np.maximum((centred**2).sum() - second - rest * mean**2, 0.0) / np.maximum(rest - 1, 1))
    return (centre, x.std(ddof=1)), (centre + mean, sigma)
