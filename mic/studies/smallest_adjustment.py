"""The smallest adjustment that brings an assembly within its limits.

What counts is how far the intervals ``h ± half`` of the key characteristics reach beyond their limits at most. Each
adjustment is tried by itself, in steps that can be set; smallest is what takes the least share of what is allowed.
Where none suffices, the one that leaves least is told.

Key characteristics of an adjusted assembly come from what was learnt (:mod:`mic.studies.emulator_training`), and what that errs
by is added to the intervals. Where it does not decide, they come from the derivatives and are evaluated at what is
proposed, which is gone by from there on, until it is proposed again.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np

from mic.process.model import ReducedModel
from mic.studies.adjustment import Adjustment, extended
from mic.studies.emulator_training import Learnt

__all__ = ["Advisor", "Proposal"]

TRIED = 20  # changes to either side, between which the smallest is looked for
AGAIN = 8  # evaluations at most
LOST = 1e6  # mm: in place of what cannot be computed, beyond all limits
WORTH = 1e-3  # mm: an adjustment that helps less is none

#: Key characteristics (n, k) of changes (n,) of one adjustment, and half widths (n, k) or (k,) of their intervals.
_Foretold = Callable[[int, np.ndarray], tuple[np.ndarray, np.ndarray]]


@dataclass(frozen=True)
class Proposal:
    """One adjustment of one assembly.

    Attributes
    ----------
    adjustment : Adjustment
    change : float
        In its unit; 0 where nothing can be set that helps.
    beyond : float
        How far the worst interval reaches beyond its limits then, mm; negative within.
    before : float
        The same without it.
    evaluated : bool
        Whether the assembly was evaluated for it.
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


class Advisor:
    """Proposes adjustments.

    Parameters
    ----------
    model : ReducedModel
    law : str
        Contact law.
    some : sequence of Adjustment
        One at least.
    learnt : Learnt, optional
        What was learnt of what these adjustments change.
    """

    def __init__(self, model: ReducedModel, law: str, some: Sequence[Adjustment], learnt: Learnt | None = None):
        self._model, self._names = extended(model, some)
        self._law, self._some, self._learnt = law, list(some), learnt
        self._lower, self._upper = np.array([item.bounds for item in model.scene.measurements]).T

    def propose(self, x: np.ndarray, y: np.ndarray, half: np.ndarray, off: np.ndarray, covered: bool) -> Proposal:
        """The smallest adjustment of an assembly.

        Parameters
        ----------
        x : (p,) array
            Its deviations.
        y, half : (k,) array
            Its key characteristics and the half widths of their intervals, mm.
        off : (k,) array
            What y errs by, mm; 0 where it was evaluated.
        covered : bool
            Whether it lies between the assemblies that were learnt from.
        """
        learnt, before = self._learnt, self._beyond(y, half)
        if learnt is not None and covered:

            def foretold(a: int, changes: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
                more, errs = learnt(self._adjusted(x, a, changes))
                return y + more, half + off + errs

            which, change, beyond = self._smallest(foretold)
            told, wide = foretold(which, np.array([change]))
            if beyond <= 0 or self._beyond(told, 2 * half - wide)[0] > 0:  # by as much as it errs by at least
                return Proposal(self._some[which], change, beyond, before, False)
        which, change, beyond = self._evaluated(x, y, half)
        return Proposal(self._some[which], change, beyond, before, True)

    def _beyond(self, y: np.ndarray, half: np.ndarray):
        """(...) how far intervals (..., k) reach beyond their limits at most, mm; negative within."""
        return np.maximum(y + half - self._upper, self._lower - y + half).max(axis=-1)

    def _adjusted(self, x: np.ndarray, a: int, changes: np.ndarray) -> np.ndarray:
        """(n, p + a) an assembly with changes (n,) of one adjustment."""
        found = np.zeros((len(changes), len(x) + len(self._some)))
        found[:, : len(x)], found[:, len(x) + a] = x, changes
        return found

    def _smallest(self, foretold: _Foretold) -> tuple[int, float, float]:
        """Which adjustment, its change, and how far the intervals reach beyond then, by what is foretold."""
        best, enough = (0, 0.0, np.inf), []
        for a, own in enumerate(self._some):
            for end in (own.low, own.high):
                coarse = np.linspace(0.0, end, TRIED + 1)
                beyond = self._beyond(*foretold(a, coarse))
                first = int(np.argmax(beyond[1:] <= 0)) + 1 if (beyond[1:] <= 0).any() else int(beyond.argmin())
                if not first:
                    best = min(best, (a, 0.0, float(beyond[0])), key=lambda one: one[2])
                    continue
                fine = own.settings(float(coarse[first - 1]), float(coarse[first]))
                left = self._beyond(*foretold(a, fine))
                i = int(np.argmax(left <= 0)) if (left <= 0).any() else int(left.argmin())
                found = a, float(fine[i]), float(left[i])
                best = min(best, found, key=lambda one: one[2])
                enough += [found] if left[i] <= 0 else []
        return self._least(enough) or best

    def _evaluated(self, x: np.ndarray, y: np.ndarray, half: np.ndarray) -> tuple[int, float, float]:
        """As :meth:`_smallest`, evaluated."""
        process, start = self._model.process(self._law), self._adjusted(x, 0, np.zeros(1))[0]
        slope = np.nan_to_num(self._model.sensitivities(start, self._law, self._names).jacobian[0])  # (k, a)
        known: dict[tuple[int, float], np.ndarray] = {}

        def foretold(a: int, changes: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
            """Between what is known on the same side, and along the slopes beyond."""
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
            known[a, change] = np.full(len(y), LOST) if answer.failed[0] else answer.measurements[0]

        for _ in range(AGAIN):
            a, change, _ = self._smallest(foretold)
            if (a, change) in known or (not change and known):
                break
            if change:
                evaluate(a, change)
            else:  # where nothing moves at first, more may
                for b, own in enumerate(self._some):
                    evaluate(b, own.low)
                    evaluate(b, own.high)
        tried = [(a, change, float(self._beyond(own, half))) for (a, change), own in known.items()]
        tried = tried or [(0, 0.0, float(self._beyond(y, half)))]
        return self._least([one for one in tried if one[2] <= 0]) or min(tried, key=lambda one: one[2])

    def _least(self, some: list[tuple[int, float, float]]) -> tuple[int, float, float] | None:
        return min(some, key=lambda one: abs(one[1]) / self._some[one[0]].size, default=None)
