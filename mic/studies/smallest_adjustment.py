"""The smallest adjustment that brings an assembly within its limits.

The criterion is the largest excess of the intervals ``h ± half`` of the key characteristics over their limits.
Adjustments are tried one at a time, in steps that can be set; the smallest is the one that takes the least share of its
allowed range. If none suffices, the result is the one with the smallest excess.

Key characteristics of an adjusted assembly come from the emulator (:mod:`mic.studies.emulator_training`), whose error
is added to the intervals. If this does not decide, the derivatives predict a change, the assembly is evaluated there,
and the prediction interpolates between the evaluations, until a change is proposed for the second time.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np

from mic.process.model import ReducedModel
from mic.studies.adjustment import Adjustment, extended
from mic.studies.emulator_training import AssemblyEmulator

__all__ = ["AdjustmentSearch", "ProposedAdjustment"]

GRID = 20  # changes of the coarse grid on each side
MAX_EVALUATIONS = 8  # largest number of refinements by evaluation
UNKNOWN = 1e6  # mm: key characteristics of an assembly that cannot be computed, beyond all limits
WORTH = 1e-3  # mm: an adjustment with a smaller effect does not count

#: Key characteristics (n, k) of changes (n,) of one adjustment, and half widths (n, k) or (k,) of their intervals.
_Prediction = Callable[[int, np.ndarray], tuple[np.ndarray, np.ndarray]]


@dataclass(frozen=True)
class ProposedAdjustment:
    """One adjustment of one assembly.

    Attributes
    ----------
    adjustment : Adjustment
    change : float
        Change in its unit; 0 if no change helps.
    beyond : float
        Excess of the worst interval over its limits after the change, mm; negative within.
    before : float
        Excess without the change.
    evaluated : bool
        Whether the result comes from an evaluation of the assembly.
    """

    adjustment: Adjustment
    change: float
    beyond: float
    before: float
    evaluated: bool

    def __str__(self) -> str:
        own = self.adjustment
        if self.beyond > 0 and self.beyond > self.before - WORTH:
            return f"no adjustment helps; {own.name} would do most"
        left = f"{1e3 * abs(self.beyond):.3g} µm"
        reached = f"within all limits by {left}" if self.beyond <= 0 else f"still {left} beyond"
        return f"{own.name} by {self.change:+.4g} {own.unit}: {reached}"


class AdjustmentSearch:
    """Finds the smallest adjustment of an assembly.

    Parameters
    ----------
    model : ReducedModel
    law : str
        Contact law.
    some : sequence of Adjustment
        At least one.
    emulator : AssemblyEmulator, optional
        Emulator of the changes that these adjustments cause.
    """

    def __init__(
        self, model: ReducedModel, law: str, some: Sequence[Adjustment], emulator: AssemblyEmulator | None = None
    ):
        self._model, self._names = extended(model, some)
        self._law, self._some, self._emulator = law, list(some), emulator
        self._lower, self._upper = np.array([item.bounds for item in model.scene.measurements]).T

    def propose(
        self, x: np.ndarray, y: np.ndarray, half: np.ndarray, off: np.ndarray, covered: bool
    ) -> ProposedAdjustment:
        """The smallest adjustment of an assembly.

        Parameters
        ----------
        x : (p,) array
            Its deviations.
        y, half : (k,) array
            Its key characteristics and the half widths of their intervals, mm.
        off : (k,) array
            Error of y, mm; 0 if it was evaluated.
        covered : bool
            Whether it lies within the range of the emulator.
        """
        emulator, before = self._emulator, self._beyond(y, half)
        if emulator is not None and covered:

            def predict(a: int, changes: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
                more, errs = emulator(self._adjusted(x, a, changes))
                return y + more, half + off + errs

            which, change, beyond = self._smallest(predict)
            told, wide = predict(which, np.array([change]))
            if beyond <= 0 or self._beyond(told, 2 * half - wide)[0] > 0:  # even with the error subtracted
                return ProposedAdjustment(self._some[which], change, beyond, before, False)
        which, change, beyond = self._smallest_by_evaluation(x, y, half)
        return ProposedAdjustment(self._some[which], change, beyond, before, True)

    def _beyond(self, y: np.ndarray, half: np.ndarray):
        """(...) largest excess of intervals (..., k) over their limits, mm; negative within."""
        return np.maximum(y + half - self._upper, self._lower - y + half).max(axis=-1)

    def _adjusted(self, x: np.ndarray, a: int, changes: np.ndarray) -> np.ndarray:
        """(n, p + a) an assembly with changes (n,) of one adjustment."""
        found = np.zeros((len(changes), len(x) + len(self._some)))
        found[:, : len(x)], found[:, len(x) + a] = x, changes
        return found

    def _smallest(self, predict: _Prediction) -> tuple[int, float, float]:
        """Number of the adjustment, its change and the excess that remains, by the prediction."""
        best, enough = (0, 0.0, np.inf), []
        for a, own in enumerate(self._some):
            for end in (own.low, own.high):
                coarse = np.linspace(0.0, end, GRID + 1)
                beyond = self._beyond(*predict(a, coarse))
                first = int(np.argmax(beyond[1:] <= 0)) + 1 if (beyond[1:] <= 0).any() else int(beyond.argmin())
                if not first:
                    best = min(best, (a, 0.0, float(beyond[0])), key=lambda one: one[2])
                    continue
                fine = own.settings(float(coarse[first - 1]), float(coarse[first]))
                left = self._beyond(*predict(a, fine))
                i = int(np.argmax(left <= 0)) if (left <= 0).any() else int(left.argmin())
                found = a, float(fine[i]), float(left[i])
                best = min(best, found, key=lambda one: one[2])
                enough += [found] if left[i] <= 0 else []
        return self._least(enough) or best

    def _smallest_by_evaluation(self, x: np.ndarray, y: np.ndarray, half: np.ndarray) -> tuple[int, float, float]:
        """As :meth:`_smallest`, by evaluations of the assembly."""
        process, start = self._model.process(self._law), self._adjusted(x, 0, np.zeros(1))[0]
        slope = np.nan_to_num(self._model.sensitivities(start, self._law, self._names).jacobian[0])  # (k, a)
        known: dict[tuple[int, float], np.ndarray] = {}

        def predict(a: int, changes: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
            """Interpolate between evaluations on the same side; extrapolate along the derivatives."""
            found = np.empty((len(changes), len(y)))
            for i, change in enumerate(changes):
                own = {0.0: y} | {abs(at): told for (b, at), told in known.items() if b == a and at * change > 0}
                at, way = np.array(sorted(own)), abs(change)
                near = int(np.clip(np.searchsorted(at, way) - 1, 0, len(at) - 1))
                before = own[at[near]]
                if near + 1 < len(at):
                    found[i] = before + (way - at[near]) / (at[near + 1] - at[near]) * (own[at[near + 1]] - before)
                else:
                    found[i] = before + (way - at[near]) * np.sign(change) * slope[:, a]
            return found, half

        def evaluate(a: int, change: float) -> None:
            answer = process.attempt(self._adjusted(x, a, np.array([change])))
            known[a, change] = np.full(len(y), UNKNOWN) if answer.failed[0] else answer.measurements[0]

        for _ in range(MAX_EVALUATIONS):
            a, change, _ = self._smallest(predict)
            if (a, change) in known or (not change and known):
                break
            if change:
                evaluate(a, change)
            else:  # no small change has an effect: try the largest
                for b, own in enumerate(self._some):
                    evaluate(b, own.low)
                    evaluate(b, own.high)
        tried = [(a, change, float(self._beyond(own, half))) for (a, change), own in known.items()]
        tried = tried or [(0, 0.0, float(self._beyond(y, half)))]
        return self._least([one for one in tried if one[2] <= 0]) or min(tried, key=lambda one: one[2])

    def _least(self, some: list[tuple[int, float, float]]) -> tuple[int, float, float] | None:
        return min(some, key=lambda one: abs(one[1]) / self._some[one[0]].size, default=None)
