r"""Statistics of an expensive model from few samples, with surrogates and a cheap model as control variates.

Three levels: the model y at n samples, optionally a cheap model o (friction in one step) at these and at M - n further
samples, and surrogates (:mod:`mic.statistics.surrogate`) at a population of many points. With a prediction p(x, o) of y
and a function h(x) of the inputs, any mean value is a sum of differences [1]_:

.. math::

    E\,g(y) = E\,g(h) + E\,(g(p) - g(h)) + E\,(g(y) - g(p)),

estimated over the population, the M and the n samples. With the cheap model ``p = β o + c(x)`` and ``h = β ô(x) +
c(x)``, where ô and c are surrogates; without, ``p = h = c``. Everything is fitted to the other folds (cross-fitting
[2]_), the choice of the surrogate included. So the estimates are unbiased for any fit, and choosing the best surrogate
does not make the intervals too narrow. β is 1 unless the samples show otherwise.

Standard errors are those of the differences. A sample also enters the surrogates that its neighbours judge. A local
surrogate, a spline, is changed by it where about one other sample judges, but that number scatters by about one, which
doubles the variance. To each level two samples are added that deviate as much as the farthest
one, and at the upper level at least half as much as a sample of the cheap model does from its surrogate: few samples
miss rare jumps, which many cheap ones show. Student's t has a degree of freedom less than there are folds. What fewer
than 3 of n assemblies do may be unseen in all samples, and no interval holds it; therefore more samples are needed
without a cheap model.

Shares and quantiles are those of ``h`` plus the held-out errors ``y - h``, scaled to the estimated mean and σ. Their
intervals take the uncertainty of the mean and of σ at the limit, the error of the surrogate near it (of one sample
there are at least the farthest one and its like), and the number of points in the population.

References
----------
.. [1] M. B. Giles: Multilevel Monte Carlo methods, Acta Numer. 24 (2015) 259-328.
.. [2] V. Chernozhukov et al.: Double/debiased machine learning for treatment and structural parameters, Econom. J. 21
       (2018) C1-C68, section 3.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import cached_property
from typing import NamedTuple

import numpy as np
from scipy.special import ndtri, stdtrit

from mic.statistics.estimates import LEVEL, Estimate
from mic.statistics.surrogate import best_surrogate, linear_functions

__all__ = ["FOLDS", "LEAST", "LEAST_ALONE", "SurrogateEstimates", "surrogate_estimates"]

LEAST, LEAST_ALONE = 50, 200  # samples of the model, with a cheap model and without
FOLDS = 8
DEPENDENT = 1e-9  # variance, of standardised inputs, of a combination that the others determine
ADDED = 2  # samples as far as the farthest
UNSEEN = 0.5  # of the largest error of the cheap model's surrogate: error of the cheap model that no sample shows
PRIOR = 0.1  # variance of the cheap model that speaks for β = 1, in samples
JOINT = 256  # samples whose errors enter a share over several outputs
REACH, BISECTIONS = 20.0, 26  # of quantiles: standard deviations around the mean, halvings
NEIGHBOURHOOD = 0.5  # standard deviations around a limit whose samples show the error of the surrogate there


class _Sum(NamedTuple):
    """An estimated quantity (k,) as a sum over levels.

    Attributes
    ----------
    value : (k,) array
    upper, lower : (n, k), (M - n, k) array
        Contribution of each sample.
    halves : (F, k) array
        Half the difference between the halves of the population of each fold, times the weight of the fold.
    unseen : (k,) array
        Contribution of a jump that no sample shows.
    local : (k,) array
        Share of the folds whose surrogate is local, a spline.
    """

    value: np.ndarray
    upper: np.ndarray
    lower: np.ndarray
    halves: np.ndarray
    unseen: np.ndarray
    local: np.ndarray

    def times(self, factor) -> _Sum:
        """The contributions times a factor (k,)."""
        value, upper, lower, halves, _, _ = (factor * item for item in self)
        return _Sum(value, upper, lower, halves, np.abs(factor) * self.unseen, self.local)

    def plus(self, other: _Sum) -> _Sum:
        """The sum with another quantity of the same samples."""
        return _Sum(*(mine + its for mine, its in zip(self, other)))._replace(local=self.local)

    @property
    def error(self) -> np.ndarray:
        """(k,) standard error."""
        variance = (self.halves**2).sum(axis=0)
        for part, least, local in ((self.upper, self.unseen, self.local), (self.lower, 0.0, 1.0)):
            if len(part) > 1:
                square = (part - part.mean(axis=0)) ** 2
                farthest = np.maximum(square.max(axis=0), np.square(least))
                own = len(part) / (len(part) - 1) * (square.sum(axis=0) + ADDED * farthest)
                variance = variance + (1 + local) * own
        return np.sqrt(variance)


@dataclass(frozen=True)
class SurrogateEstimates:
    """Statistics of k outputs with their intervals.

    Attributes
    ----------
    kind : list of str
        By output, the surrogate of most folds: ``"plain"`` (none, or the variance is not known), ``"linear"``,
        ``"quadratic"`` or ``"spline"``; with the cheap model after ``"one-step, "``.
    explained : (k,) array
        Share of the variance that the surrogate explains.
    samples, cheap_samples : int
        Evaluations of the model, and of the cheap model.
    """

    kind: list[str]
    explained: np.ndarray
    samples: int
    cheap_samples: int
    _mean: _Sum
    _variance: _Sum
    _sorted: np.ndarray  # (k, F, 2, N / 2), both halves of the population, sorted along the last axis
    _points: np.ndarray  # (F, N, k), the same in the order of the points, single precision
    _errors: np.ndarray  # (n, k), held out
    _farthest: np.ndarray  # (k,), largest error or that of a jump that no sample shows
    _fold: np.ndarray  # (n,)

    def at(self, outputs: list[int]) -> SurrogateEstimates:
        """The estimates of some of the outputs."""
        mean, variance = (_Sum(*(part[..., outputs] for part in total)) for total in (self._mean, self._variance))
        return replace(
            self,
            kind=[self.kind[k] for k in outputs],
            explained=self.explained[outputs],
            _mean=mean,
            _variance=variance,
            _sorted=self._sorted[outputs],
            _points=self._points[..., outputs],
            _errors=self._errors[:, outputs],
            _farthest=self._farthest[outputs],
        )

    def mean(self, level: float = LEVEL) -> Estimate:
        """Mean."""
        half = _t(level) * self._mean.error
        return self._estimate(self._mean.value, self._mean.value - half, self._mean.value + half)

    def sigma(self, level: float = LEVEL) -> Estimate:
        """Standard deviation; the interval is symmetric on the logarithm."""
        value, factor = self._sigma, np.exp(_t(level) * self._relative_error)
        return self._estimate(value, value / factor, value * factor)

    def six_sigma(self, level: float = LEVEL) -> Estimate:
        """Six standard deviations."""
        sigma = self.sigma(level)
        return self._estimate(6 * sigma.value, 6 * sigma.low, 6 * sigma.high)

    def centred_capability(self, lower, upper, level: float = LEVEL) -> Estimate:
        """Cpk for limits (k,) that may be infinite, ``min(upper - mean, mean - lower) / (3 σ)``."""
        mean, sigma = self._mean.value, self._sigma
        above = upper - mean <= mean - lower
        with np.errstate(divide="ignore", invalid="ignore"):
            value = np.where(above, upper - mean, mean - lower) / (3 * sigma)
            finite = np.where(np.isfinite(value), value, np.nan)
            slope = np.where(above, -1.0, 1.0) / (3 * sigma)
            total = self._mean.times(slope).plus(self._variance.times(-finite / (2 * sigma**2)))
        half = _t(level) * total.error
        return self._estimate(value, finite - half, finite + half)

    def share_outside(self, lower, upper, level: float = LEVEL) -> Estimate:
        """Share outside limits (k,) that may be infinite."""
        shares = []
        for sign in (0.0, 1.0, -1.0):  # the value; limits moved outwards, and inwards
            low = lower - sign * self._shift(lower, level)
            high = upper + sign * self._shift(upper, level)
            outside = self._below(low) + _weights(self._fold)[:, None] / 2 - self._below(high)
            shares.append(np.clip(outside.sum(axis=(1, 2)) - sign * self._halves_error(outside, level), 0.0, 1.0))
        return self._estimate(*shares)

    def share_outside_any(self, lower, upper, level: float = LEVEL) -> Estimate:
        """Share with any output outside its limits (k,), which may be infinite; not an array.

        The ends of the interval are those with all limits moved together, by their uncertainty at level 1 - α/k.
        """
        each, shares = 1 - (1 - level) / len(self.kind), []
        for sign in (0.0, 1.0, -1.0):
            low, high = lower - sign * self._shift(lower, each), upper + sign * self._shift(upper, each)
            share = self._outside_any(low, high)
            shares.append(float(np.clip(share - sign * self._share_error(share, level), 0.0, 1.0)))
        value, low, high = shares
        return Estimate(value, low, high, self.samples, 0)  # type: ignore[arg-type]

    def _outside_any(self, low: np.ndarray, high: np.ndarray) -> np.ndarray:
        """Share of the predicted distribution with any output outside limits (k,)."""
        low, high = self._limits(low)[:JOINT], self._limits(high)[:JOINT]  # (n, k)
        outside = 0
        for f, points in enumerate(self._points):
            own = self._fold[:JOINT] == f
            if not own.any():
                continue
            reached = ((points < low[own].max(axis=0)) | (points > high[own].min(axis=0))).any(axis=1)
            for lowest, highest in zip(low[own], high[own]):
                outside += ((points[reached] < lowest) | (points[reached] > highest)).any(axis=1).sum()
        return np.array(outside / (len(low) * self._points.shape[1]))

    def _limits(self, limit: np.ndarray) -> np.ndarray:
        """(n, k) limits of the surrogates' values at the errors of the samples."""
        centre, spread = self._predicted
        with np.errstate(divide="ignore", invalid="ignore"):
            scaled = np.where(self._sigma > 0, (limit - self._mean.value) * spread / self._sigma, limit - centre)
        return centre + scaled - self._errors

    @cached_property
    def _predicted(self) -> tuple[np.ndarray, np.ndarray]:
        """Mean and standard deviation (k,) of the surrogates' values and errors."""
        centre = self._sorted.mean(axis=(1, 2, 3)) + self._errors.mean(axis=0)
        return centre, np.sqrt(self._sorted.var(axis=(1, 2, 3)) + self._errors.var(axis=0))

    def quantile(self, probability: float, level: float = LEVEL) -> Estimate:
        """Quantile of the predicted distribution."""
        value = self._inverse(probability)
        half = self._halves_error(self._below(value), level)
        shift = self._shift(value, level)
        low, high = (self._inverse(np.clip(probability + sign * half, 0.0, 1.0)) for sign in (-1, 1))
        return self._estimate(value, low - shift, high + shift)

    def _inverse(self, probability: float | np.ndarray) -> np.ndarray:
        """(k,) quantiles, by bisection."""
        low, high = self._mean.value - REACH * self._sigma, self._mean.value + REACH * self._sigma
        for _ in range(BISECTIONS):
            middle = (low + high) / 2
            below = self._distribution(middle) < probability
            low, high = np.where(below, middle, low), np.where(below, high, middle)
        return (low + high) / 2

    def _share_error(self, share: np.ndarray, level: float) -> np.ndarray:
        """Sampling error of a share of the population, at most: that of random points."""
        share, points = np.clip(share, 0.0, 1.0), self._sorted[0].size
        return ndtri(0.5 + level / 2) * np.sqrt(share * (1 - share) / points)

    @property
    def _sigma(self) -> np.ndarray:
        return np.sqrt(np.maximum(self._variance.value, 0.0))

    @property
    def _relative_error(self) -> np.ndarray:
        """(k,) standard error of log σ; NaN without spread."""
        with np.errstate(divide="ignore", invalid="ignore"):
            return np.where(self._sigma > 0, self._variance.error / (2 * self._variance.value), np.nan)

    def _estimate(self, value, low, high) -> Estimate:
        used = np.full(len(self.kind), self.samples)
        return Estimate(value, low, high, used, np.zeros_like(used))

    def _distribution(self, limit) -> np.ndarray:
        """(k,) share of the predicted distribution below limits (k,)."""
        return self._shares_below(limit, self._merged).sum(axis=(1, 2))

    def _below(self, limit) -> np.ndarray:
        """The same share as a sum over folds and halves of the population, (k, F, 2)."""
        return self._shares_below(limit, self._sorted)

    def _shares_below(self, limit, points: np.ndarray) -> np.ndarray:
        """(k, F, h) share below limits (k,) of the points (k, F, h, N / h) of each fold, with the errors there."""
        limits = self._limits(np.asarray(limit, dtype=float))
        by_fold = [limits[self._fold == f].T.copy() for f in range(FOLDS)]
        below = np.empty(points.shape[:3])
        for k, f, part in np.ndindex(below.shape):
            below[k, f, part] = points[k, f, part].searchsorted(by_fold[f][k]).sum()
        return below / (points[0, 0].size * len(limits))

    @cached_property
    def _merged(self) -> np.ndarray:
        """(k, F, 1, N) the points of each fold, sorted."""
        k, F = self._sorted.shape[:2]
        return np.sort(self._sorted.reshape(k, F, 1, -1), axis=3, kind="stable")

    def _halves_error(self, shares: np.ndarray, level: float) -> np.ndarray:
        """(k,) sampling error of a sum of shares (k, F, 2), from the differences of the halves; at least one point."""
        points = self._sorted[0].size
        square = (np.diff(shares, axis=2)[:, :, 0] ** 2).sum(axis=1)
        return _t(level) * np.sqrt(square + 1 / points**2)

    def _shift(self, limit, level: float) -> np.ndarray:
        """(k,) uncertainty of the prediction at limits (k,)."""
        distance = np.where(np.isfinite(limit), limit, self._mean.value) - self._mean.value
        near, value = NEIGHBOURHOOD * self._sigma, self._mean.value + distance
        share = self._distribution(value + near) - self._distribution(value - near)
        neighbours = np.maximum(share * self.samples, 1.0)
        local = self._errors.var(axis=0, ddof=1) / neighbours
        square = self._mean.error**2 + (self._relative_error * distance) ** 2 + local
        return _t(level) * np.sqrt(square) + self._farthest / neighbours


def surrogate_estimates(
    x: np.ndarray, y: np.ndarray, population: np.ndarray, cheap: tuple[np.ndarray, np.ndarray] | None = None
) -> SurrogateEstimates | None:
    """Statistics of k outputs from n samples.

    Parameters
    ----------
    x, y : (n, p), (n, k) array
        Inputs and outputs of independent samples; samples with an output that is not finite are excluded.
    population : (F, N, p) array
        Points of the inputs' distribution for each of the :data:`FOLDS` folds, quasi-random in both halves.
    cheap : (M, p), (M, k) array, optional
        Inputs and outputs of the cheap model: first those of the n samples, then further ones.

    Returns
    -------
    SurrogateEstimates or None
        None for fewer than :data:`LEAST` samples, :data:`LEAST_ALONE` without a cheap model, or inputs without spread.
    """
    valid = np.isfinite(y).all(axis=1)
    o, further_x, further_o = np.zeros((len(y), 0)), x[:0], y[:0]
    if cheap is not None:
        o, further_x, further_o = cheap[1][: len(y)], cheap[0][len(y) :], cheap[1][len(y) :]
        valid &= np.isfinite(o).all(axis=1)
        known = np.isfinite(further_o).all(axis=1)
        further_x, further_o = further_x[known], further_o[known]
    x, y, o = x[valid], y[valid], o[valid]
    centre, spread = population.mean(axis=(0, 1)), population.std(axis=(0, 1))
    varying = spread > 0
    if len(y) < (LEAST if cheap else LEAST_ALONE) or not varying.any():
        return None
    x, further_x, points = ((z[..., varying] - centre[varying]) / spread[varying] for z in (x, further_x, population))
    flat = points.reshape(-1, points.shape[-1])
    variance, axes = np.linalg.eigh(flat.T @ flat / len(flat))
    independent = variance > DEPENDENT
    if not independent.all():
        turned = axes[:, independent] / np.sqrt(variance[independent])
        x, further_x, points = x @ turned, further_x @ turned, points @ turned
    return _Folds(x, y, o, further_x, further_o, points).estimates()


class _Folds:
    """Predictions of each sample from a fit to the other folds."""

    def __init__(self, x, y, o, further_x, further_o, points):
        self.y, two = y, o.shape[1] > 0
        self.cheap = len(o) + len(further_o) if two else 0
        self.fold, further = np.arange(len(y)) % FOLDS, np.arange(len(further_x)) % FOLDS
        self.p, self.h = np.empty_like(y), np.empty_like(y)
        self.further_p, self.further_h = np.empty_like(further_o), np.empty_like(further_o)
        self.population = np.empty((*points.shape[:2], y.shape[1]))
        self.kinds: list[list[str]] = []
        for f in range(FOLDS):
            rest, test, others, held = self.fold != f, self.fold == f, further != f, further == f
            if two:
                known = np.concatenate([x[rest], further_x[others]]), np.concatenate([o[rest], further_o[others]])
                predict, function, kind = _fit(x[rest], y[rest], o[rest], known)
                self.p[test] = predict(x[test], o[test])
                self.further_p[held] = predict(further_x[held], further_o[held])
                self.further_h[held] = function(further_x[held])
            else:
                surrogate = best_surrogate(x[rest], y[rest])
                function, kind = surrogate.predict, surrogate.kind
                self.p[test] = function(x[test])
            self.h[test] = function(x[test])
            self.population[f] = function(points[f])
            self.kinds.append([f"one-step, {name}" if two else name for name in kind])

    def estimates(self) -> SurrogateEstimates:
        """The statistics."""
        mean = self._mean_of(lambda value: value)
        variance = self._mean_of(lambda value: (value - mean.value) ** 2)
        with np.errstate(divide="ignore", invalid="ignore"):
            explained = 1 - (self.y - self.p).var(axis=0) / variance.value
        known = variance.value > variance.error
        kinds = (Counter(names).most_common(1)[0][0] for names in zip(*self.kinds))
        kind = [name if certain else "plain" for name, certain in zip(kinds, known)]
        errors = self.y - self.h
        unseen = self._unseen(np.concatenate([self.p - self.h, self.further_p - self.further_h]))
        farthest = np.maximum(np.abs(errors).max(axis=0), unseen)
        halves = np.stack(np.array_split(np.moveaxis(self.population, 2, 0), 2, axis=2), axis=2)
        ordered, points = np.sort(halves, axis=3), self.population.astype(np.float32)
        return SurrogateEstimates(
            kind, explained, len(self.y), self.cheap, mean, variance, ordered, points, errors, farthest, self.fold
        )  # fmt: skip

    def _mean_of(self, function: Callable[[np.ndarray], np.ndarray]) -> _Sum:
        """E g(y)."""
        n, total = len(self.y), len(self.y) + len(self.further_h)
        weight = _weights(self.fold)[:, None]
        first, second = (function(half).mean(axis=1) for half in np.array_split(self.population, 2, axis=1))
        above, below = function(self.y) - function(self.p), function(self.p) - function(self.h)
        further_below = function(self.further_p) - function(self.further_h)
        upper, lower = above / n + below / total, further_below / total
        value = (weight * (first + second) / 2).sum(axis=0) + upper.sum(axis=0) + lower.sum(axis=0)
        unseen = self._unseen(np.concatenate([below, further_below])) / n
        local = np.mean([[name.endswith("spline") for name in names] for names in self.kinds], axis=0)
        return _Sum(value, upper, lower, weight * (first - second) / 2, unseen, local)

    @staticmethod
    def _unseen(below: np.ndarray) -> np.ndarray:
        """(k,) difference y - p of a sample that none of the n is like, from those of the lower level."""
        return UNSEEN * np.abs(below).max(axis=0)


def _fit(x, y, o, known) -> tuple[Callable, Callable, list[str]]:
    """p(x, o), h(x) and the kinds of surrogate, with the cheap model's samples ``known`` = (x, o)."""
    cheap, functions = best_surrogate(*known), linear_functions(x)
    rest = _residual(functions, o)
    slope = (_residual(functions, y - o) * rest).sum(axis=0)
    with np.errstate(divide="ignore", invalid="ignore"):
        slope = slope / ((rest**2).sum(axis=0) + PRIOR * known[1].var(axis=0))
    beta = 1 + np.where(np.isfinite(slope), slope, 0.0)
    correction = best_surrogate(x, y - beta * o)
    return (
        lambda x, o: beta * o + correction.predict(x),
        lambda x: beta * cheap.predict(x) + correction.predict(x),
        correction.kind,
    )


def _residual(functions: np.ndarray, y: np.ndarray) -> np.ndarray:
    """y without its regression on functions of the inputs; around its mean for few samples."""
    if len(y) <= functions.shape[1] + 2:
        return y - y.mean(axis=0)
    return y - functions @ np.linalg.lstsq(functions, y, rcond=None)[0]


def _weights(fold: np.ndarray) -> np.ndarray:
    """(F,) share of the samples in each fold."""
    return np.bincount(fold, minlength=FOLDS) / len(fold)


def _t(level: float) -> float:
    return float(stdtrit(FOLDS - 1, 0.5 + level / 2))
