"""Differences between two assemblies evaluated on the same samples, with confidence intervals from the pairs.

Scatter that both assemblies share cancels in the difference, so its interval is narrower than those of the two
statistics. Samples run along the first axis; pairs with a value that is not finite are excluded. Intervals of
statistics that are smooth in the samples are those of the jackknife [1]_ over groups
(:func:`mic.statistics.estimates.jackknife_error`), with Student's t of R − 1 degrees of freedom for R groups;
independent samples are groups of one.

References
----------
.. [1] J. Shao, D. Tu: The Jackknife and Bootstrap, 1995, sections 1.2 and 2.3.
.. [2] A. Agresti, Y. Min: Simple improved confidence intervals for comparing matched proportions, Statist. Med. 24
       (2005) 729-740.
"""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
from scipy.special import ndtri, stdtrit

from mic.statistics.estimates import LEVEL, Estimate, jackknife_error

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


def mean_change(a, b, group=None, level: float = LEVEL) -> Estimate:
    """Mean of `b` minus mean of `a`.

    Parameters
    ----------
    a, b : (n,) array
        Values on the same samples.
    group : (n,) int array, optional
        Groups of samples of a sampling design; default: independent samples.
    """
    statistic = lambda mean, sigma: mean
    return _difference(a, b, group, statistic, statistic, level)


def six_sigma_change(a, b, group=None, level: float = LEVEL) -> Estimate:
    """6σ of `b` minus 6σ of `a`; arguments as :func:`mean_change`."""
    statistic = lambda mean, sigma: 6 * sigma
    return _difference(a, b, group, statistic, statistic, level)


def centred_capability_change(a, b, limits_a, limits_b, group=None, level: float = LEVEL) -> Estimate:
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

    return _difference(a, b, group, capability(limits_a), capability(limits_b), level)


def share_change(a, b, group=None, level: float = LEVEL) -> Estimate:
    """Share of true samples of `b` minus that of `a`.

    With ``n₀₁`` samples true in `b` only and ``n₁₀`` in `a` only, it is ``(n₀₁ − n₁₀)/n``. Its interval is Wald's with
    half a sample added to each of the four cells [2]_, which is valid even if no sample differs; with groups, it is
    that of :func:`mean_change`.

    Parameters
    ----------
    a, b : (n,) bool array
    group : (n,) int array, optional
    """
    a, b = np.asarray(a, dtype=float), np.asarray(b, dtype=float)
    if group is not None:
        return mean_change(a, b, group, level)
    n, more, less = len(a), float((b > a).sum()), float((b < a).sum())
    if not n:
        return Estimate.of(a, np.nan, np.nan, np.nan)
    value = (more - less) / (n + 2)
    spread = np.sqrt(more + less + 1 - (more - less) ** 2 / (n + 2)) / (n + 2)
    half = float(ndtri(0.5 + level / 2)) * spread
    return Estimate.of(a, (more - less) / n, max(value - half, -1.0), min(value + half, 1.0))


def standard_error(change: Estimate, level: float = LEVEL) -> float:
    """Standard error from which the interval of a change of independent samples was computed."""
    return float((change.high - change.value) / stdtrit(change.used - 1, 0.5 + level / 2))


def jackknife(y, statistic: Callable[[np.ndarray], float], level: float = LEVEL, groups: int = 50) -> Estimate:
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
    """
    y = np.asarray(y, dtype=float)
    valid = np.isfinite(y).all(axis=1)
    used, y = np.where(valid, 0.0, np.nan), y[valid]
    if len(y) < 3:
        return Estimate.of(used, np.nan, np.nan, np.nan)
    R = min(groups, len(y))
    group = np.arange(len(y)) % R
    without = np.array([statistic(y[group != r]) for r in range(R)])
    half = stdtrit(R - 1, 0.5 + level / 2) * jackknife_error(without)
    value = statistic(y)
    return Estimate.of(used, value, value - half, value + half)


def _difference(a, b, group, statistic_a: Statistic, statistic_b: Statistic, level: float) -> Estimate:
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
        R, error = len(without), jackknife_error(without)
    half = stdtrit(R - 1, 0.5 + level / 2) * error if R > 1 and np.isfinite(error) else np.nan
    return Estimate.of(used, whole, whole - half, whole + half)


def _moments(x: np.ndarray, group: np.ndarray):
    """Mean and standard deviation of all samples, then (R,) each without one of R groups."""
    n, centre = len(x), x.mean()
    centred = x - centre
    size, first, second = (np.bincount(group, weights) for weights in (np.ones(n), centred, centred**2))
    rest = n - size
    mean = (centred.sum() - first) / rest
    sigma = np.sqrt(np.maximum((centred**2).sum() - second - rest * mean**2, 0.0) / np.maximum(rest - 1, 1))
    return (centre, x.std(ddof=1)), (centre + mean, sigma)
