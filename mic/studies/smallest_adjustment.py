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
from operator import attrgetter
from typing import NamedTuple

import numpy as np

from mic.process.model import ReducedModel
from mic.studies.adjustment import Adjustment, with_adjustments
from mic.studies.emulator_training import AssemblyEmulator
from mic.studies.samples import limits

__all__ = ["AdjustmentSearch", "ProposedAdjustment"]

GRID = 20  # changes of the coarse grid on each side
MAX_EVALUATIONS = 8  # largest number of refinements by evaluation
UNKNOWN = 1e6  # mm: key characteristics of an assembly that cannot be computed, beyond all limits
WORTH = 1e-3  # mm: an adjustment with a smaller effect does not count

#: Key characteristics (n, k) of changes (n,) of one adjustment, and half widths (n, k) or (k,) of their intervals.
_Prediction = Callable[[int, np.ndarray], tuple[np.ndarray, np.ndarray]]


class _Candidate(NamedTuple):
    """Number of an adjustment, its change, and the excess over the limits with it, mm."""

    number: int
    change: float
    excess: float


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
        adjustment = self.adjustment
        if self.beyond > 0 and self.beyond > self.before - WORTH:
            return f"no adjustment helps; {adjustment.name} has the largest effect"
        distance = f"{1e3 * abs(self.beyond):.3g} µm"
        reached = f"within all limits by {distance}" if self.beyond <= 0 else f"still {distance} beyond a limit"
        return f"{adjustment.name} by {self.change:+.4g} {adjustment.unit}: {reached}"


class AdjustmentSearch:
    """Finds the smallest adjustment of an assembly.

    Parameters
    ----------
    model : ReducedModel
    law : str
        Contact law.
    available : sequence of Adjustment
        At least one.
    emulator : AssemblyEmulator, optional
        Emulator of the changes that these adjustments cause.
    """

    def __init__(
        self, model: ReducedModel, law: str, available: Sequence[Adjustment], emulator: AssemblyEmulator | None = None
    ):
        self._model, self._names = with_adjustments(model, available)
        self._law, self._available, self._emulator = law, list(available), emulator
        self._lower, self._upper = limits(model.scene)

    def propose(
        self, x: np.ndarray, y: np.ndarray, half: np.ndarray, error: np.ndarray, covered: bool
    ) -> ProposedAdjustment:
        """The smallest adjustment of an assembly.

        Parameters
        ----------
        x : (p,) array
            Its deviations.
        y, half : (k,) array
            Its key characteristics and the half widths of their intervals, mm.
        error : (k,) array
            Error of y, mm; 0 if it was evaluated.
        covered : bool
            Whether it lies within the range of the emulator.
        """
        emulator, before = self._emulator, self._beyond(y, half)
        if emulator is not None and covered:

            def predict(a: int, changes: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
                effect, effect_error = emulator(self._adjusted(x, a, changes))
                return y + effect, half + error + effect_error

            number, change, beyond = self._smallest(predict)
            predicted, width = predict(number, np.array([change]))
            if beyond <= 0 or self._beyond(predicted, 2 * half - width)[0] > 0:  # even with the error subtracted
                return ProposedAdjustment(self._available[number], change, beyond, before, False)
        number, change, beyond = self._smallest_by_evaluation(x, y, half)
        return ProposedAdjustment(self._available[number], change, beyond, before, True)

    def _beyond(self, y: np.ndarray, half: np.ndarray):
        """(...) largest excess of intervals (..., k) over their limits, mm; negative within."""
        return np.maximum(y + half - self._upper, self._lower - y + half).max(axis=-1)

    def _adjusted(self, x: np.ndarray, a: int, changes: np.ndarray) -> np.ndarray:
        """(n, p + a) an assembly with changes (n,) of one adjustment."""
        whole = np.zeros((len(changes), len(x) + len(self._available)))
        whole[:, : len(x)], whole[:, len(x) + a] = x, changes
        return whole

    def _smallest(self, predict: _Prediction) -> _Candidate:
        """The smallest sufficient change by the prediction, or the one with the smallest excess."""
        best, sufficient = _Candidate(0, 0.0, np.inf), []
        for a, adjustment in enumerate(self._available):
            for end in (adjustment.low, adjustment.high):
                coarse = np.linspace(0.0, end, GRID + 1)
                excess = self._beyond(*predict(a, coarse))
                within = excess[1:] <= 0
                first = int(np.argmax(within)) + 1 if within.any() else int(excess.argmin())
                if not first:
                    best = min(best, _Candidate(a, 0.0, float(excess[0])), key=_excess)
                    continue
                fine = adjustment.settings(float(coarse[first - 1]), float(coarse[first]))
                excess = self._beyond(*predict(a, fine))
                within = excess <= 0
                i = int(np.argmax(within)) if within.any() else int(excess.argmin())
                candidate = _Candidate(a, float(fine[i]), float(excess[i]))
                best = min(best, candidate, key=_excess)
                sufficient += [candidate] if within.any() else []
        return self._least_change(sufficient) or best

    def _smallest_by_evaluation(self, x: np.ndarray, y: np.ndarray, half: np.ndarray) -> _Candidate:
        """As :meth:`_smallest`, by evaluations of the assembly."""
        process, start = self._model.process(self._law), self._adjusted(x, 0, np.zeros(1))[0]
        slope = np.nan_to_num(self._model.sensitivities(start, self._law, self._names).jacobian[0])  # (k, a)
        evaluated: dict[tuple[int, float], np.ndarray] = {}

        def predict(a: int, changes: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
            """Interpolate between evaluations on the same side; extrapolate along the derivatives."""
            result = np.empty((len(changes), len(y)))
            for i, change in enumerate(changes):
                values = {abs(at): value for (b, at), value in evaluated.items() if b == a and at * change > 0}
                values[0.0] = y
                at, size = np.array(sorted(values)), abs(change)
                j = int(np.clip(np.searchsorted(at, size) - 1, 0, len(at) - 1))
                before, distance = values[at[j]], size - at[j]
                if j + 1 < len(at):
                    result[i] = before + distance / (at[j + 1] - at[j]) * (values[at[j + 1]] - before)
                else:
                    result[i] = before + distance * np.sign(change) * slope[:, a]
            return result, half

        def evaluate(a: int, change: float) -> None:
            evaluation = process.attempt(self._adjusted(x, a, np.array([change])))
            evaluated[a, change] = np.full(len(y), UNKNOWN) if evaluation.failed[0] else evaluation.measurements[0]

        for _ in range(MAX_EVALUATIONS):
            a, change, _ = self._smallest(predict)
            if (a, change) in evaluated or (not change and evaluated):
                break
            if change:
                evaluate(a, change)
            else:  # no small change has an effect: try the largest
                for b, adjustment in enumerate(self._available):
                    evaluate(b, adjustment.low)
                    evaluate(b, adjustment.high)
        candidates = [_Candidate(*key, float(self._beyond(values, half))) for key, values in evaluated.items()]
        candidates = candidates or [_Candidate(0, 0.0, float(self._beyond(y, half)))]
        sufficient = [candidate for candidate in candidates if candidate.excess <= 0]
        return self._least_change(sufficient) or min(candidates, key=_excess)

    def _least_change(self, candidates: list[_Candidate]) -> _Candidate | None:
        """The candidate with the smallest change relative to its allowed range; None without candidates."""
        relative = lambda candidate: abs(candidate.change) / self._available[candidate.number].size
        return min(candidates, key=relative, default=None)


_excess = attrgetter("excess")
