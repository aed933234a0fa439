"""One assembly at a time: what its measured parts will make of it, and which adjustment would help.

A part list gives values of some of the scene's deviations. The others are at their means, and what they leave open is
told by the derivatives about the mean assembly, ``σ² = Σ_j (∂h/∂x_j σ_j)²``. A characteristic is accepted where all of
``h ± 1.96 √(σ² + e²)`` lies within its limits, e the error of the model, rejected where none of it does, and open
between.

Where an evaluation takes longer than an answer may, answers come from a spline between assemblies that were evaluated
beforehand (:mod:`mic.studies.emulator`). What it errs by at assemblies that it had not seen is part of e.
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
from mic.sampling.normal import from_normal
from mic.studies.adjustment import FACTOR, SHIM, Adjustment, adjustments, extended
from mic.studies.emulator import Emulator

__all__ = ["FARTHEST", "Predictor", "predict"]

FARTHEST = 6.0  #: standard deviations: what lies farther off its mean, the model was not built for
TRIED = 41  # changes of an adjustment within its bounds, from which the best is taken
WORTH = 1e-3  # mm: an adjustment that helps less is none
#: standard deviations: between assemblies so far off their means the spline is made, and beyond them it is not asked
REACH = 3.0
WIDER = 1.5  # standard deviations of those
FIRST, BATCH, BATCHES = 8, 16, 8  # assemblies to begin with, beside 3/2 of each deviation; and those added until
FINE = 5e-3  # of the tolerance: e of the spline is small enough


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
    quick : bool
        Whether a spline answers in place of an evaluation, within :data:`REACH` standard deviations. Making it ready
        takes some dozen evaluations.

    Raises
    ------
    SceneError
        If nothing is measured or nothing varies; if the spline errs by more than :data:`FINE` of a tolerance.
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
        quick: bool = False,
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
        self._emulator: Emulator | None = None
        self._off = np.zeros(len(self._lower))  # what it errs by
        if quick:
            self._emulator, self._off = self._learned()

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
        far = self._far(x)
        farthest = int(far.argmax())
        if far[farthest] > FARTHEST:
            return self._told("refused", f"{names[farthest]} is {far[farthest]:.3g} σ off its mean", far[farthest])
        y, off = self._foretold(x, far[farthest])
        if y is None:
            return self._told("failed", "its contact problems were not solved", far[farthest])
        unknown = self._slope**2 @ np.where(given, 0.0, self._sigma) ** 2
        half = float(ndtri(0.5 + LEVEL / 2)) * np.sqrt(self.error**2 + off**2 + unknown)
        verdict = self._verdicts(y, half)
        said = ""
        if self._adjusted is not None and (verdict != "accepted").any():
            said = self._best(x, y, half)
        worst = "rejected" if "rejected" in verdict else "open" if "open" in verdict else "accepted"
        items = self.model.scene.measurements
        return self._tabled(
            [*(item.name for item in items), ""],
            np.append([y, y - half, y + half], np.full((3, 1), np.nan), axis=1),
            [*verdict, worst],
            [*("" for _ in items), said],
            far[farthest],
        )

    def _far(self, x: np.ndarray) -> np.ndarray:
        """(p,) by how many standard deviations deviations are off their means."""
        off = np.abs(x - self._mean)
        with np.errstate(divide="ignore", invalid="ignore"):
            return np.where(off > 0, off / self._sigma, 0.0)

    def _foretold(self, x: np.ndarray, far: float) -> tuple[np.ndarray | None, np.ndarray]:
        """Key characteristics (k,) of an assembly, none where they cannot be computed, and what they err by (k,)."""
        if self._emulator is not None and far <= REACH:
            return self._emulator(self._scaled(x[None]))[0], self._off
        found = self._process.attempt(x[None])
        return None if found.failed[0] else found.measurements[0], np.zeros(len(self._lower))

    def _scaled(self, x: np.ndarray) -> np.ndarray:
        """Deviations (n, p) off their means, in standard deviations."""
        return np.asarray((x - self._mean) / np.where(self._sigma > 0, self._sigma, 1.0))

    def _learned(self) -> tuple[Emulator, np.ndarray]:
        """A spline between assemblies on all sides, and what it errs by (k,), mm."""
        scene, p = self.model.scene, len(self._mean)
        stream, fine = np.random.default_rng(0), FINE * (self._upper - self._lower)
        u, h, off = np.empty((0, p)), np.empty((0, len(fine))), np.full(len(fine), np.inf)
        for count in (p + p // 2 + FIRST, *[BATCH] * BATCHES):
            x = from_normal(scene, np.clip(WIDER * stream.standard_normal((count, p)), -REACH, REACH))
            found = self._process.attempt(x)
            known, own = self._scaled(x[~found.failed]), found.measurements[~found.failed]
            if len(u) > p + 1 and len(own):
                off = np.sqrt(((Emulator(u, h)(known) - own) ** 2).mean(axis=0))
            u, h = np.concatenate([u, known]), np.concatenate([h, own])
            if (off <= fine).all():
                return Emulator(u, h), off
        worst = int((off / fine).argmax())
        raise SceneError(
            f"scene {scene.name!r}: quick answers for {scene.measurements[worst].name} err by {off[worst]:.3g} mm "
            f"after {len(u)} evaluations, over {FINE:.1%} of its tolerance; leave quick out, so that all are evaluated"
        )

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
        return self._tabled([""], np.full((3, 1), np.nan), [verdict], [said], far)

    def _tabled(self, names: list[str], values: np.ndarray, verdicts: list[str], said: list[str], far: float):
        """The table, at once: of values, low and high ends (3, rows)."""
        told = {"file": "", "row": 0, "model": "", "law": self.law, "measurement": names}
        told |= dict(zip(("value", "low", "high"), values, strict=True)) | {"verdict": verdicts, "said": said}
        return pd.DataFrame(told | {"far": float(far)}, columns=PREDICTIONS.names)


def predict(
    model: ReducedModel,
    parts: pd.DataFrame | Sequence[Mapping[str, float]],
    law: str | None = None,
    adjust: Sequence[str] = (),
    shim: float = SHIM,
    factor: float = FACTOR,
    error: float = 0.0,
    quick: bool = False,
) -> pd.DataFrame:
    """Foretell assemblies from their measured parts; one after the other, :class:`Predictor` does that.

    Parameters
    ----------
    model : ReducedModel
    parts : DataFrame, or sequence of mappings
        A row or mapping for each assembly: values of deviations by name, N or mm. NaN is not known.
    law, adjust, shim, factor, error, quick
        As :class:`Predictor` takes them.

    Returns
    -------
    DataFrame
        As :data:`mic.results.schema.PREDICTIONS` declares it, ``file`` empty and ``row`` the number of the assembly,
        from 0: of each assembly its key characteristics, then the whole of it.

    Raises
    ------
    SceneError
        As :class:`Predictor`; if there is no assembly.
    ValueError
        As :class:`Predictor`; for unknown names and values that are not finite.
    """
    rows = parts.to_dict("records") if isinstance(parts, pd.DataFrame) else list(parts)
    if not rows:
        raise SceneError("parts: there is no assembly in them; give a row for each")
    predictor = Predictor(model, law, adjust, shim, factor, error, quick)
    known = [{str(name): value for name, value in row.items() if not np.isnan(value)} for row in rows]
    return pd.concat([predictor.judge(row).assign(row=i) for i, row in enumerate(known)], ignore_index=True)
