"""Statistics of a run with surrogates and, if an accuracy is required, with samples in one step.

See :mod:`mic.statistics.control_variate`. An output keeps the estimates of the samples alone if the surrogate explains
less than half of its variance, or if so many samples know better.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numpy as np

from mic.results.output_samples import Key, OutputSamples
from mic.statistics import draw, estimates
from mic.statistics.control_variate import FOLDS, LEAST, LEAST_ALONE, SurrogateEstimates, surrogate_estimates
from mic.statistics.estimates import Estimate, Moments

__all__ = ["FURTHER", "Improved", "improve", "population"]

POINTS, MOST_POINTS = 4096, 32768  # of the population of each fold, up to 200 samples and at most
FURTHER = 8  # further samples in one step for each sample; each costs a twentieth to a hundredth of a followed one
USEFUL = 0.5  # share of the variance that a surrogate explains, at least
QUANTILES = {"low_quantile": 0.00135, "high_quantile": 0.99865}  # those of a normal population at 3 σ


@dataclass(frozen=True)
class Improved:
    """Estimates of the outputs that are better than those of the samples alone.

    Attributes
    ----------
    keys : tuple of tuple
        As :attr:`mic.results.output_samples.OutputSamples.keys`.
    estimates : SurrogateEstimates
        Of all outputs.
    better : (k,) bool array
        Whether they are better than those of the samples alone.
    limits : dict of str to (float, float)
        Lower and upper limit of each key characteristic, mm.
    """

    keys: tuple[Key, ...]
    estimates: SurrogateEstimates
    better: np.ndarray
    limits: Mapping[str, tuple[float, float]]

    def index(self, key: Key) -> int | None:
        """Number of an output; None if the samples alone are better."""
        k = self.keys.index(key) if key in self.keys else None
        return k if k is not None and self.better[k] else None

    @cached_property
    def characteristics(self) -> dict[str, dict[str, Estimate]]:
        """Better estimates of key characteristics by name and figure; cached, since quantiles take a bisection."""
        better = {key[1]: k for k, key in enumerate(self.keys) if key[0] == "measurement" and self.better[k]}
        if not better:
            return {}
        of = self.estimates.at(list(better.values()))
        lower, upper = np.array([self.limits[name] for name in better]).T
        found = {
            "mean": of.mean(),
            "six_sigma": of.six_sigma(),
            "cpk": of.centred_capability(lower, upper),
            "share_outside": of.share_outside(lower, upper),
        } | {figure: of.quantile(probability) for figure, probability in QUANTILES.items()}
        return {name: {figure: one.at(k) for figure, one in found.items()} for k, name in enumerate(better)}


def population(scene, samples: int) -> np.ndarray:
    """(F, N, p) points of the distribution of the scene's deviations.

    More samples take more points, so that the points do not limit the accuracy.
    """
    points = POINTS
    while points < min(POINTS * samples / LEAST_ALONE, MOST_POINTS):
        points *= 2
    return draw.population(scene, scene.monte_carlo.seed, FOLDS, points)


def improve(
    scene,
    samples: OutputSamples,
    total: int,
    one_step: OutputSamples | None = None,
    points: Callable[[Any, int], np.ndarray] = population,
) -> Improved | None:
    """Estimates from the samples of a law; None for few samples, or if the scene gives or groups them.

    Parameters
    ----------
    scene : mic.scene.Scene
    samples : OutputSamples
        The first samples.
    total : int
        Number of all valid samples.
    one_step : OutputSamples, optional
        Of the same law in one step, in ascending order: these and further ones.
    points : callable, optional
        Returns the :func:`population` of a scene and a number of samples.
    """
    drawn = scene.monte_carlo.values is None and scene.monte_carlo.design == "independent"
    needed = LEAST_ALONE if one_step is None else LEAST
    if not drawn or not scene.deviations or len(samples.y) < needed or not samples.keys:
        return None
    cheap = None
    if one_step is not None:
        keys = tuple(key for key in samples.keys if key in one_step.keys)
        samples, one_step = samples.of_keys(keys), one_step.of_keys(keys)
        place = np.searchsorted(one_step.numbers, samples.numbers)
        known = np.isin(samples.numbers, one_step.numbers)
        o = np.where(known[:, None], one_step.y[np.minimum(place, len(one_step.y) - 1)], np.nan)
        further = ~np.isin(one_step.numbers, samples.numbers)
        cheap = np.concatenate([samples.x, one_step.x[further]]), np.concatenate([o, one_step.y[further]])
    found = surrogate_estimates(samples.x, samples.y, points(scene, total), cheap)
    if found is None:
        return None
    better = np.array([kind != "plain" for kind in found.kind]) & (found.explained >= USEFUL)
    if total > len(samples.y):
        shrink = np.sqrt(len(samples.y) / total)
        better &= _width(found.sigma()) < shrink * _width(estimates.sigma(Moments.of(samples.y)))
    return Improved(samples.keys, found, better, {item.name: item.bounds for item in scene.measurements})


def _width(estimate: Estimate) -> np.ndarray:
    """(k,) relative widths of intervals; infinite if undefined."""
    with np.errstate(divide="ignore", invalid="ignore"):
        width = np.log(np.atleast_1d(estimate.high)) - np.log(np.atleast_1d(estimate.low))
    return np.where(np.isfinite(width), width, np.inf)
