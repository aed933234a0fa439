"""Decision whether a process is capable, from estimates with confidence intervals.

A characteristic is capable if the whole interval of its Cpk lies above the required one, and not capable if it lies
below. All of k characteristics must be capable, so a set is capable if each interval lies above [1]_; for the opposite
decision, which one characteristic is enough for, the intervals have the level ``1 - α/k`` (Bonferroni). Each of the two
decisions is then wrong with a probability of at most α, whatever the correlation of the characteristics.

References
----------
.. [1] R. L. Berger: Multiparameter hypothesis testing and acceptance sampling, Technometrics 24 (1982) 295-300.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from scipy.special import stdtrit

from mic.statistics.estimates import LEVEL, Estimate

__all__ = ["CAPABLE", "NOT_CAPABLE", "NOT_DECIDED", "Decision", "decide", "decide_share"]

CAPABLE, NOT_CAPABLE, NOT_DECIDED = "capable", "not capable", "not decided"
POWER = 0.9  # probability of a decision with the stated number of samples, if the estimates are the true values
MOST = 10_000_000  # samples: larger numbers are not stated


@dataclass(frozen=True)
class Decision:
    """Decision on k characteristics together.

    Attributes
    ----------
    verdict : {"capable", "not capable", "not decided"}
    each : list of str
        The same for each characteristic.
    needed : float
        Number of samples with which a decision follows with a probability of 90 % if the estimates are the true
        values; NaN if there is a decision or an interval is missing, infinite beyond 10 million.
    """

    verdict: str
    each: list[str]
    needed: float


def decide(value, low, high, target: float, samples: int, freedom=np.inf) -> Decision:
    """Decide whether all of k figures are at least `target`.

    Parameters
    ----------
    value, low, high : (k,) array
        Estimates with their intervals; without spread ±∞ and NaN.
    target : float
    samples : int
        Number of samples that the estimates come from.
    freedom : float or (k,) array
        Degrees of freedom of Student's t in the intervals; infinite: normal.
    """
    value, low, high = (np.atleast_1d(np.asarray(x, dtype=float)) for x in (value, low, high))
    α, k, t = 1 - LEVEL, len(value), lambda p: stdtrit(np.broadcast_to(np.minimum(freedom, 1e9), value.shape), p)
    one, several = t(1 - α / 2), t(1 - α / (2 * k))
    below, above = value - low, (high - value) * several / one  # half-widths of the two decisions
    capable = (value - below >= target) | (value == np.inf)
    failing = (value + above < target) | (value == -np.inf)
    each = [CAPABLE if yes else NOT_CAPABLE if no else NOT_DECIDED for yes, no in zip(capable, failing)]
    if failing.any() or capable.all():
        return Decision(NOT_CAPABLE if failing.any() else CAPABLE, each, math.nan)
    open_, under = ~capable, ~capable & (value < target)
    power = t(POWER) if under.any() else t(1 - (1 - POWER) / open_.sum())
    half, quantile = np.where(under, above, below), np.where(under, several, one)
    with np.errstate(divide="ignore"):
        factor = (half * (1 + power / quantile) / np.abs(value - target)) ** 2
    needed = samples * float(factor[under].min() if under.any() else factor[open_].max())
    return Decision(NOT_DECIDED, each, needed if np.isnan(needed) or needed <= MOST else np.inf)


def decide_share(share: Estimate, target: float) -> Decision:
    """Decide whether a share is at most `target`; for none among the samples, `needed` assumes none among more, too."""
    # Probit: the interval of a share is nearly symmetric, and shrinks as 1/√n, on this scale.
    probit = lambda p: -float(stdtrit(1e9, p))
    value, low, high = (probit(x) for x in (share.value, share.high, share.low))
    decision = decide(value, low, high, probit(target), int(share.used))
    if share.value > 0:
        return decision
    if share.high <= target:
        return Decision(CAPABLE, [CAPABLE], math.nan)
    needed = math.log((1 - LEVEL) / 2) / math.log1p(-target)
    return Decision(NOT_DECIDED, [NOT_DECIDED], needed if needed <= MOST else math.inf)
