"""One assembly at a time: what its measured parts will make of it, and which adjustment would help.

A part list gives values of some of the scene's deviations. The others are at their means, and what they leave open is
told by the derivatives about the mean assembly, ``σ² = Σ_j (∂h/∂x_j σ_j)²``. A characteristic is accepted where all of
``h ± 1.96 √(σ² + e²)`` lies within its limits, e the error of the model, rejected where none of it does, and open
between.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np
import pandas as pd
from scipy.special import ndtri

from mic.errors import SceneError
from mic.process.model import ReducedModel
from mic.results.schema import PREDICTIONS
from mic.results.statistics import LEVEL
from mic.studies.adjustment import FACTOR, SHIM, Adjustment, adjustments, extended

__all__ = ["FARTHEST", "Predictor"]

FARTHEST = 6.0  #: standard deviations: what lies farther off its mean, the model was not built for
TRIED = 41  # changes of an adjustment within its bounds, from which the best is taken
WORTH = 1e-3  # mm: an adjustment that helps less is none


@dataclass(frozen=True)
class _Adjusted:
    """A model with some adjustments as deviations more."""

    model: ReducedModel
    names: list[str]
    some: list[Adjustment]


class Predictor:
    """A model made ready to judge assemblies one by one.

    Parameters
    ----------
    model : ReducedModel
    law : str, optional
        Contact law; default: the first of the scene's report.
    adjust : sequence of str
        Locators and clamps that may be adjusted (:mod:`mic.studies.adjustment`); none by default.
    shim, factor : float
        By how much at most: mm, and of a force.
    error : float
        e above, mm.

    Raises
    ------
    SceneError
        If nothing is measured or nothing varies.
    ValueError
        If what may be adjusted is not known, or the error is negative.
    """

    def __init__(
        self,
        model: ReducedModel,
        law: str | None = None,
        adjust: Sequence[str] = (),
        shim: float = SHIM,
        factor: float = FACTOR,
        error: float = 0.0,
    ):
        scene = model.scene
        if not scene.measurements or not scene.deviations:
            raise SceneError(
                f"scene {scene.name!r} has no {'deviations' if scene.measurements else 'measurements'}: there is "
                "nothing to foretell; give it some"
            )
        if not error >= 0:
            raise ValueError(f"error must not be negative, and is {error:g}")
        self.model, self.law, self.error = model, law or scene.report.laws[0], error
        self._process = model.process(self.law)
        self._mean = np.array([item.mean for item in scene.deviations])
        self._sigma = np.array([item.sigma for item in scene.deviations])
        self._lower, self._upper = np.array([item.bounds for item in scene.measurements]).T
        self._adjusted = None
        if adjust:
            some = adjustments(model, shim, factor, list(adjust))
            self._adjusted = _Adjusted(*extended(model, some), some)
        slopes = model.sensitivities({}, self.law)
        self._slope = np.nan_to_num(slopes.jacobian[0])  # of the mean assembly

    def judge(self, values: Mapping[str, float]) -> pd.DataFrame:
        """Foretell one assembly.

        Parameters
        ----------
        values : mapping of str to float
            Deviations by name, N or mm; those that are missing are not known.

        Returns
        -------
        DataFrame
            As :data:`mic.results.schema.PREDICTIONS` declares it, ``file`` and ``row`` empty and 0: each key
            characteristic, then the whole assembly.

        Raises
        ------
        ValueError
            For unknown names and values that are not finite.
        """
        x = self.model.deviations(dict(values))[0]
        names = self.model.parameters
        given = np.array([name in values for name in names])
        off = np.abs(x - self._mean)
        with np.errstate(divide="ignore", invalid="ignore"):
            far = np.where(off > 0, off / self._sigma, 0.0)
        farthest = int(far.argmax())
        items = self.model.scene.measurements
        if far[farthest] > FARTHEST:
            return self._told("refused", f"{names[farthest]} is {far[farthest]:.3g} σ off its mean", far[farthest])
        found = self._process.attempt(x[None])
        if found.failed[0]:
            return self._told("failed", "its contact problems were not solved", far[farthest])
        y = found.measurements[0]
        unknown = self._slope**2 @ np.where(given, 0.0, self._sigma) ** 2
        half = float(ndtri(0.5 + LEVEL / 2)) * np.sqrt(self.error**2 + unknown)
        verdict = self._verdicts(y, half)
        said = ""
        if self._adjusted is not None and (verdict != "accepted").any():
            said = self._best(x, y, half)
        worst = "rejected" if "rejected" in verdict else "open" if "open" in verdict else "accepted"
        table = pd.DataFrame(
            {
                "measurement": [*(item.name for item in items), ""],
                "value": [*y, np.nan],
                "low": [*(y - half), np.nan],
                "high": [*(y + half), np.nan],
                "verdict": [*verdict, worst],
                "said": [*("" for _ in items), said],
            }
        )
        return self._tabled(table, far[farthest])

    def _verdicts(self, y: np.ndarray, half: np.ndarray) -> np.ndarray:
        within = (y - half >= self._lower) & (y + half <= self._upper)
        beyond = (y + half < self._lower) | (y - half > self._upper)
        return np.where(within, "accepted", np.where(beyond, "rejected", "open")).astype(object)

    def _beyond(self, y: np.ndarray, half: np.ndarray) -> np.ndarray:
        """(...) how far the intervals (..., k) reach beyond their limits at most, mm; negative within."""
        return np.maximum(y + half - self._upper, self._lower - y + half).max(axis=-1)

    def _best(self, x: np.ndarray, y: np.ndarray, half: np.ndarray) -> str:
        """The adjustment that brings the worst characteristic farthest towards its limits, evaluated; in words."""
        assert self._adjusted is not None
        model, names, some = self._adjusted.model, self._adjusted.names, self._adjusted.some
        start = np.concatenate([x, np.zeros(len(names))])
        J = np.nan_to_num(model.sensitivities(start, self.law, names).jacobian[0])  # (k, a)
        now, best = float(self._beyond(y, half)), None
        for a, own in enumerate(some):
            changes = np.linspace(own.low, own.high, TRIED)
            foretold = self._beyond(y + changes[:, None] * J[:, a], half)
            i = int(foretold.argmin())
            if best is None or foretold[i] < best[0]:
                best = float(foretold[i]), a, own.settable(float(changes[i]))
        assert best is not None
        _, a, change = best
        start[len(x) + a] = change
        found = model.process(self.law).attempt(start[None])
        left = np.inf if found.failed[0] else float(self._beyond(found.measurements[0], half))
        own = some[a]
        if left > now - WORTH:
            return f"no adjustment helps; {own.name} would do most"
        reached = "within all limits" if left <= 0 else f"still {1e3 * left:.3g} µm beyond"
        return f"{own.name} by {change:+.4g} {own.unit}: {reached}"

    def _told(self, verdict: str, said: str, far: float) -> pd.DataFrame:
        table = pd.DataFrame({"measurement": [""], "verdict": [verdict], "said": [said]})
        return self._tabled(table.assign(value=np.nan, low=np.nan, high=np.nan), far)

    def _tabled(self, table: pd.DataFrame, far: float) -> pd.DataFrame:
        return table.assign(file="", row=0, model="", law=self.law, far=float(far))[PREDICTIONS.names]
