"""Samples and processor time that an accuracy of 6σ takes: the samples alone, or few followed ones with surrogates."""

from __future__ import annotations

import math
import time
from dataclasses import dataclass

import numpy as np
import pandas as pd
from scipy.stats import norm

from mic.process.model import ReducedModel
from mic.results.improved import FURTHER, improve
from mic.results.output_samples import OutputSamples
from mic.setting_choice import leading as largest_of_each
from mic.statistics.control_variate import LEAST_ALONE
from mic.statistics.draw import draw
from mic.statistics.estimates import LEVEL, six_sigma
from verification.budget import values

__all__ = ["FEW", "SamplingCost", "enough", "leading", "measure_sampling"]

FEW = 50  # followed samples, the first block of a run


@dataclass(frozen=True)
class SamplingCost:
    """Accuracy and cost of a scene's samples with surrogates.

    Attributes
    ----------
    half : float
        Largest half-width of the 95 % interval of a leading 6σ, relative to it; NaN without surrogates.
    each : float
        CPU seconds per followed sample, including its samples in one step.
    used : int
        Followed samples with this half-width, fewer than which a run does not use.
    """

    half: float = math.nan
    each: float = math.nan
    used: int = FEW

    def samples(self, target: float) -> float:
        """Followed samples for a half-width: it falls at least with their square root. NaN without surrogates."""
        if not (self.half == self.half and target > 0):
            return math.nan
        return max(self.used, math.ceil(self.used * (self.half / target) ** 2))

    def cheapest(self, target: float, each: float) -> tuple[float, int, str]:
        """CPU seconds, followed samples and estimator of the cheaper way to a half-width.

        Parameters
        ----------
        target : float
            Relative to 6σ.
        each : float
            CPU seconds per sample without surrogates.
        """
        alone, few = enough(target), self.samples(target)
        if few * self.each < alone * each:
            return few * self.each, int(few), f"{few:.0f} followed samples with surrogates"
        return alone * each, alone, f"{alone} samples alone"


def enough(target: float) -> int:
    """Number of normal samples for which half the confidence interval of 6σ is the target."""
    return math.ceil((norm.ppf((1 + LEVEL) / 2) / target) ** 2 / 2) + 1


def leading(six_sigma: pd.Series) -> pd.Index:
    """Quantities "kind:name" whose 6σ is among the largest of their kind."""
    return largest_of_each(six_sigma, six_sigma.index.str.partition(":").get_level_values(0))


def measure_sampling(model: ReducedModel, law: str, seed: int) -> SamplingCost:
    """Evaluate the first followed samples of a scene, and its samples in one step, as a run with an accuracy does."""
    one_step = model.one_step if len(model.contacts) else None
    used, cheap = FEW if one_step is not None else LEAST_ALONE, None
    x = draw(model.scene, seed, 0, (1 + FURTHER) * used)
    own, seconds = _evaluated(model, law, x[:used])
    if one_step is not None:
        frame, more = _evaluated(one_step, law, x)
        cheap, seconds = _outputs(x, frame), seconds + more
    improved = improve(model.scene, _outputs(x[:used], own), used, cheap)
    names = leading(6 * own.std(ddof=1))
    if improved is None or not len(names):
        return SamplingCost()
    found, halves = improved.estimates.six_sigma(), []
    for name in names:
        k = improved.index((name,))
        best = six_sigma(own[name].to_numpy()) if k is None else found.at(k)
        halves.append(float((best.high - best.low) / (2 * best.value)))
    return SamplingCost(max(halves), seconds / used, used)


def _evaluated(model: ReducedModel, law: str, x: np.ndarray) -> tuple[pd.DataFrame, float]:
    """Results of samples, and the CPU seconds that they took."""
    process = model.process(law)
    process.attempt(x[:2])  # compile before the time is measured
    start = time.process_time()
    return values(model, process.attempt(x)), time.process_time() - start


def _outputs(x: np.ndarray, frame: pd.DataFrame) -> OutputSamples:
    return OutputSamples(tuple((name,) for name in frame), np.arange(len(x)), x, frame.to_numpy())
