"""The verdict of a run: whether its key characteristics have the required capability, and the share outside limits."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Any

import numpy as np
import pandas as pd

from mic.results.run_samples import RunSamples
from mic.results.schema import RARE
from mic.results.statistic_tables import GROUPS, whole_yield
from mic.statistics.capability import looks_normal, normal_share_outside
from mic.statistics.control_variate import FOLDS
from mic.statistics.decision import Decision, decide, decide_share
from mic.statistics.estimates import LEVEL, Estimate

__all__ = ["COUNTED", "NORMAL", "SUBSET", "SURROGATES", "CapabilityVerdict", "capability_verdict"]

SUBSET, SURROGATES, COUNTED, NORMAL = (
    "by subset simulation",
    "by surrogates of the key characteristics",
    "counted among the samples",
    "extrapolated by normal distributions of the samples",
)
COUNTABLE = 10  # samples outside from which counting is as good as any model


@dataclass(frozen=True)
class CapabilityVerdict:
    """The verdict under one law.

    Attributes
    ----------
    cpk : Estimate
        Of each key characteristic, (k,), with the interval that the decision uses.
    decision : Decision
        ``each`` in the order of the scene's key characteristics; of one entry if a share outside is required.
    target_cpk, target_outside : float or None
        The requirement; one of them is None.
    samples : int
    needed : int or None
        Samples with which a decision is likely (:class:`mic.statistics.decision.Decision`), a multiple of the sampling
        design's groups; None if there is no such number.
    outside : Estimate
        Share of the assemblies outside any limit.
    estimator : str
        That of this share.
    """

    cpk: Estimate
    decision: Decision
    target_cpk: float | None
    target_outside: float | None
    samples: int
    needed: int | None
    outside: Estimate
    estimator: str

    @property
    def verdict(self) -> str:
        """``capable``, ``not capable`` or ``not decided``."""
        return self.decision.verdict

    def as_dict(self) -> dict[str, Any]:
        """The verdict for ``summary.json``."""
        ppm = [1e6 * float(x) for x in (self.outside.value, self.outside.low, self.outside.high)]
        return {
            "verdict": self.verdict,
            "target_cpk": self.target_cpk,
            "target_outside": self.target_outside,
            "samples_needed": self.needed,
            "outside_ppm": ppm[0],
            "outside_ppm_ci": ppm[1:],
            "outside_by": self.estimator,
        }


def capability_verdict(outcome: RunSamples, law: str, table: pd.DataFrame) -> CapabilityVerdict | None:
    """The verdict under one law; None without key characteristics or valid samples.

    Parameters
    ----------
    outcome : RunSamples
    law : str
    table : DataFrame
        The best estimates of the run (:func:`mic.results.headline.headline`).
    """
    report, samples = outcome.model.scene.report, len(outcome.sample_numbers(law))
    if not outcome.model.scene.measurements or not samples:
        return None
    cpk, freedom = _cpk(outcome, law, table)
    outside, estimator = _outside(outcome, law, extrapolated=report.target_outside is None)
    if report.target_outside is None:
        target_cpk = report.target_cpk
        decision = decide(cpk.value, cpk.low, cpk.high, target_cpk, samples, freedom)
    else:
        target_cpk, decision = None, decide_share(outside, report.target_outside)
    by_samples = math.isfinite(decision.needed) and (target_cpk is not None or estimator != SUBSET)
    needed = _rounded(decision.needed, outcome.together) if by_samples else None
    return CapabilityVerdict(cpk, decision, target_cpk, report.target_outside, samples, needed, outside, estimator)


def _cpk(outcome: RunSamples, law: str, table: pd.DataFrame) -> tuple[Estimate, Any]:
    """Cpk of each key characteristic, and the degrees of freedom of the intervals."""
    rows = table[table["law"] == law]
    value, low, high = (rows[name].to_numpy(dtype=float) for name in ("cpk", "cpk_low", "cpk_high"))
    freedom: Any = min(math.ceil(len(outcome.sample_numbers(law)) / outcome.together), GROUPS) - 1
    if outcome.together == 1:
        freedom = np.where(rows["alone_cpk"].notna(), FOLDS - 1.0, math.inf)
    return Estimate(value, low, high, rows["samples"].to_numpy(), np.zeros(len(rows), dtype=int)), freedom


def _bounds(outcome: RunSamples) -> np.ndarray:
    """(2, k) limits that the key characteristics can exceed, mm."""
    return np.array([item.bounds for item in outcome.model.scene.measurements]).T


def _outside(outcome: RunSamples, law: str, extrapolated: bool) -> tuple[Estimate, str]:
    """Share of the assemblies outside any limit, and its estimator, the first that is supported.

    Subset simulation, if it was computed; surrogates, if there is one of each key characteristic; the count, if at
    least :data:`COUNTABLE` samples are outside; normal distributions, if no key characteristic contradicts them: the
    sum over the characteristics, whose interval reaches from the largest lower end to the sum of the upper ends at
    level ``1 - α/k``; else the count. A decision on the share itself uses no extrapolation by normal distributions:
    skewness that does not show in the samples multiplies so small a share.
    """
    accumulator, samples = outcome.accumulators[law], len(outcome.sample_numbers(law))
    rare = outcome.study(RARE)
    own = [] if rare is None else rare[(rare["law"] == law) & (rare["measurement"] == "")].to_dict("records")
    if own:
        value, low, high = (float(own[-1][f"outside{end}"]) for end in ("", "_low", "_high"))
        return Estimate(value, low, high, samples, 0), SUBSET  # type: ignore[arg-type]
    improved = outcome.improved(law)
    keys = [("measurement", item.name) for item in outcome.model.scene.measurements]
    outputs = [k for key in keys if improved and (k := improved.index(key)) is not None]
    if improved and len(outputs) == len(keys):
        return improved.estimates.at(outputs).share_outside_any(*_bounds(outcome)), SURROGATES
    good, moments = whole_yield(outcome, law), accumulator.moments["measurements",]
    counted = Estimate(1 - good.value, 1 - good.high, 1 - good.low, good.used, good.excluded)
    few = int(accumulator.counts["any outside",]) < COUNTABLE
    if not (few and extrapolated) or outcome.together > 1 or not np.all(looks_normal(moments)):
        return counted, COUNTED
    lower, upper = _bounds(outcome)
    shares = normal_share_outside(moments, lower, upper, 1 - (1 - LEVEL) / len(lower))
    total, high = (min(float(np.sum(x)), 1.0) for x in (shares.value, shares.high))
    return Estimate(total, float(np.max(shares.low)), high, samples, 0), NORMAL  # type: ignore[arg-type]


def _rounded(samples: float, multiple: int) -> int:
    """A number of samples rounded up to two digits, and to a multiple."""
    digit = 10 ** max(0, math.floor(math.log10(max(samples, 1.0))) - 1)
    return math.ceil(math.ceil(samples / digit) * digit / multiple) * multiple
