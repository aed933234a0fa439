"""Differences between two assemblies that were made of the same samples, with the interval that pairing leaves.

What both samples share cancels in a difference, so that its interval is narrower than those of the two figures, often
by far. Samples run along the first axis; a pair of which either value is not finite is left out. For figures that are
smooth in their samples the interval is the jackknife's [1]_: with θ₍ᵣ₎ the figure's difference without group r of R,

    s² = (R − 1)/R Σ (θ₍ᵣ₎ − θ̄)²,

and Student's t of R − 1 degrees of freedom; samples that are independent are groups of one.

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

from mic.statistics.estimates import LEVEL, Estimate

__all__ = [
    "centred_capability_change",
    "jackknife",
    "mean_change",
    "share_change",
    "six_sigma_change",
    "standard_error",
]

#: A figure of samples with these numbers, means and standard deviations.
Figure = Callable[[np.ndarray, np.ndarray], np.ndarray]


def mean_change(a, b, group=None, level: float = LEVEL) -> Estimate:
    """By how much the mean of `b` lies above that of `a`.

    Parameters
    ----------
    a, b : (n,) array
        Of the same samples.
    group : (n,) int array, optional
        Which samples a design made together; default: each by itself.
    """
    return _jackknifed(a, b, group, lambda mean, sigma: mean, lambda mean, sigma: mean, level)


def six_sigma_change(a, b, group=None, level: float = LEVEL) -> Estimate:
    """By how much six standard deviations of `b` are more than those of `a`; arguments as :func:`mean_change`."""
    return _jackknifed(a, b, group, lambda mean, sigma: 6 * sigma, lambda mean, sigma: 6 * sigma, level)


def centred_capability_change(a, b, limits_a, limits_b, group=None, level: float = LEVEL) -> Estimate:
    """By how much Cpk of `b` exceeds that of `a`, each against its own limits.

    Parameters
    ----------
    a, b, group
        As :func:`mean_change`.
    limits_a, limits_b : pair of float
        Lower and upper, in the unit of the samples.
    """

    def capability(limits) -> Figure:
        lower, upper = limits
        with_ = lambda mean, sigma: np.minimum(upper - mean, mean - lower) / (3 * sigma)
        return with_

    return _jackknifed(a, b, group, capability(limits_a), capability(limits_b), level)


def share_change(a, b, group=None, level: float = LEVEL) -> Estimate:
    """By how much the share of samples of which something holds differs.

    With ``n₀₁`` samples of which it holds in `b` only and ``n₁₀`` in `a` only, ``(n₀₁ − n₁₀)/n``; its interval is
    Wald's with half a sample more of each kind [2]_, which holds where none differ, too. Of samples that a design made
    together, that of :func:`mean_change`.

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
    """``s`` above, of which the interval of a change was made; of samples each by itself."""
    return float((change.high - change.value) / stdtrit(change.used - 1, 0.5 + level / 2))


def jackknife(y, figure: Callable[[np.ndarray], float], level: float = LEVEL, groups: int = 50) -> Estimate:
    """Any figure of samples with the jackknife's interval, such as what of the largest 6σ of several quantities differs
    between two assemblies, whose columns stand side by side.

    Parameters
    ----------
    y : (n, k) array
        Samples that are independent; those with a value that is not finite are left out.
    figure : callable
        A number of samples (m, k).
    groups : int
        R above, at most; of fewer samples each is one. The first, and every so many after it, are one group.
    """
    y = np.asarray(y, dtype=float)
    valid = np.isfinite(y).all(axis=1)
    kept, y = np.where(valid, 0.0, np.nan), y[valid]
    if len(y) < 3:
        return Estimate.of(kept, np.nan, np.nan, np.nan)
    R = min(groups, len(y))
    which = np.arange(len(y)) % R
    without = np.array([figure(y[which != r]) for r in range(R)])
    half = stdtrit(R - 1, 0.5 + level / 2) * np.sqrt((R - 1) / R * np.sum((without - without.mean()) ** 2))
    value = figure(y)
    return Estimate.of(kept, value, value - half, value + half)


def _jackknifed(a, b, group, figure_a: Figure, figure_b: Figure, level: float) -> Estimate:
    """The difference of two figures; NaN where there are fewer than three samples."""
    a, b = np.asarray(a, dtype=float), np.asarray(b, dtype=float)
    valid = np.isfinite(a) & np.isfinite(b)
    left_out = np.where(valid, b - a, np.nan)
    which = np.unique(np.arange(len(a))[valid] if group is None else np.asarray(group)[valid], return_inverse=True)[1]
    a, b = a[valid], b[valid]
    if len(a) < 3:
        return Estimate.of(left_out, np.nan, np.nan, np.nan)
    with np.errstate(divide="ignore", invalid="ignore"):
        whole, without = (
            figure_b(*of_b) - figure_a(*of_a)
            for of_a, of_b in zip(_with_and_without(a, which), _with_and_without(b, which))
        )
        R = len(without)
        spread = np.sqrt((R - 1) / R * np.sum((without - without.mean()) ** 2))
    half = stdtrit(R - 1, 0.5 + level / 2) * spread if R > 1 and np.isfinite(spread) else np.nan
    return Estimate.of(left_out, whole, whole - half, whole + half)


def _with_and_without(x: np.ndarray, which: np.ndarray):
    """Mean and standard deviation of samples, then (R,) each without one of R groups."""
    n, centre = len(x), x.mean()
    off = x - centre
    size, first, second = (np.bincount(which, weights) for weights in (np.ones(n), off, off**2))
    rest = n - size
    mean = (off.sum() - first) / rest
    spread = np.sqrt(np.maximum((off**2).sum() - second - rest * mean**2, 0.0) / np.maximum(rest - 1, 1))
    return (centre, x.std(ddof=1)), (centre + mean, spread)
