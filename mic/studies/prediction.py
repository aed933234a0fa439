"""Predict individual assemblies from measured parts, and the joint adjustment that each needs.

A part list gives values of some of the scene's deviations. The others have their mean values; their contribution to the
uncertainty follows from the derivatives about the mean assembly, ``σ² = Σ_j (∂h/∂x_j σ_j)²``. With e the error of the
model, a characteristic is accepted if the whole interval ``h ± 1.96 √(σ² + e²)`` lies within its limits, rejected if no
part of it does, and open otherwise.

Predictions come from a spline between assemblies that were evaluated beforehand (:mod:`mic.studies.emulator_training`).
The bound of 95 % of its errors is part of the interval. The assembly itself is evaluated if that error could change a
verdict, or if the assembly lies beyond the range of the training.

The proposed adjustments are found and evaluated together (:mod:`mic.studies.joint_adjustment`). With the objective
``yield`` they are the smallest, relative to their ranges, that bring the interval of every characteristic within its
limits, and only assemblies that are not accepted are adjusted.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path

import numpy as np
import pandas as pd
from scipy.special import ndtri

from mic.errors import ArgumentError, SceneError
from mic.process.evaluation import Evaluation
from mic.process.model import ReducedModel
from mic.results.schema import PREDICTIONS
from mic.statistics.estimates import LEVEL
from mic.studies.adjustable import Adjustable
from mic.studies.emulator_training import train_emulator
from mic.studies.joint_adjustment import JointAdjustment, ProposedAdjustment
from mic.studies.samples import Progress, limits
from mic.system.arguments import checked, numbers_by_name

__all__ = ["FARTHEST", "Predictor", "predict"]

FARTHEST = 6.0  #: standard deviations from the mean beyond which an assembly is refused
NORMAL = float(ndtri(0.5 + LEVEL / 2))  # half of an interval per standard deviation
NOTHING = (np.nan,) * 3  # value, low and high of a whole assembly


class Predictor:
    """Predicts individual assemblies with a model.

    Parameters
    ----------
    model : ReducedModel
    law : str, optional
        Contact law; default: the first of the scene's report.
    adjust : sequence of str, or Adjustable
        Locators and clamps that may be adjusted, ``all`` or ``scene``, or these with objective, step and largest number
        (:class:`mic.studies.adjustable.Adjustable`); none by default.
    shim, factor : float, optional
        Largest adjustments: a shift, mm, and a factor on a force. Default: 0.5 and 2, or the scene's
        (:class:`mic.studies.adjustable.Adjustable`).
    error : float
        Error e of the model, mm.
    exact : bool
        Whether every assembly is evaluated. Otherwise some dozens are evaluated first to train the spline.
    cache : Path, optional
        Folder of the disk cache of the training assemblies.
    progress : callable, optional
        Called with the number of training evaluations since the last call.

    Attributes
    ----------
    emulator : AssemblyEmulator or None
        The spline; None if every assembly is evaluated.
    evaluation : Evaluation or None
        Evaluation of the last predicted assembly; None if its prediction comes from the spline.

    Raises
    ------
    SceneError
        If nothing is measured or nothing varies.
    ArgumentError
        If an adjustable item is unknown, or the error is negative.
    """

    def __init__(
        self,
        model: ReducedModel,
        law: str | None = None,
        adjust: Sequence[str] | Adjustable = (),
        shim: float | None = None,
        factor: float | None = None,
        error: float = 0.0,
        exact: bool = False,
        cache: Path | None = None,
        progress: Progress = lambda count: None,
    ):
        scene = model.scene
        if not scene.measurements or not scene.deviations:
            raise SceneError(
                f"scene {scene.name!r} has no {'deviations' if scene.measurements else 'measurements'}: there is "
                "nothing to predict; add some"
            )
        if not error >= 0:
            raise ArgumentError(f"error must not be negative, but is {error:g}")
        self.model, self.law, self.error = model, law or scene.report.laws[0], error
        self._process = model.process(self.law)
        self._mean = np.array([item.mean for item in scene.deviations])
        self._sigma = np.array([item.sigma for item in scene.deviations])
        self._lower, self._upper = limits(scene)
        request = adjust if isinstance(adjust, Adjustable) else Adjustable(adjust, shim, factor)
        if request.names:
            request.of(model)  # raises before the training
        self.evaluation: Evaluation | None = None
        self.proposal: ProposedAdjustment | None = None
        self.emulator = None if exact else train_emulator(model, self.law, cache, progress)
        self._adjustment = JointAdjustment(model, self.law, request, progress) if request.names else None
        slopes = model.sensitivities({}, self.law)
        self._slope = np.nan_to_num(slopes.jacobian[0])  # of the mean assembly

    @property
    def target(self) -> dict[str, float]:
        """Target of the adjustments by key characteristic, mm; empty if they have none but the limits."""
        if self._adjustment is None or not self._adjustment.always:
            return {}
        names = [item.name for item in self.model.scene.measurements]
        return dict(zip(names, self._adjustment.goal.target.tolist()))

    def predict(
        self, values: Mapping[str, float], covariance: np.ndarray | None = None, unexplained: float = 0.0
    ) -> pd.DataFrame:
        """Predict one assembly.

        Parameters
        ----------
        values : mapping of str to float
            Deviations by name, N or mm; missing ones are unknown.
        covariance : (p, p) array, optional
            Covariance of the errors of all deviations, given their measurement; default: no errors.
        unexplained : float
            Deviation that the scene's deviations do not describe, mm: a further error of each characteristic.

        Returns
        -------
        DataFrame
            As :data:`mic.results.schema.PREDICTIONS` declares it, with empty ``file`` and ``row`` 0: a row for each key
            characteristic, then one for the whole assembly.

        Raises
        ------
        ArgumentError
            For unknown names and values that are not finite.
        """
        x, self.proposal = self.model.deviations(numbers_by_name("parts", values))[0], None
        names = self.model.parameters
        given = np.array([name in values for name in names])
        distance = self._distance(x)
        if covariance is not None:  # a scan taken as it is has no distribution to be compared with
            distance[(self._sigma == 0.0) & (covariance.diagonal() > 0.0)] = 0.0
        farthest = int(distance.argmax())
        if distance[farthest] > FARTHEST:
            said = f"{names[farthest]} is {distance[farthest]:.3g} σ off its mean"
            return self._table([("", *NOTHING, "refused", "", said)], distance)
        unmeasured_variance = (self._slope * np.where(given, 0.0, self._sigma)) ** 2
        unknown_variance = unmeasured_variance.sum(axis=1)
        if covariance is not None:
            unknown_variance += np.einsum("kp,pq,kq->k", self._slope, covariance, self._slope, optimize=True)
        half = NORMAL * np.sqrt(self.error**2 + unexplained**2 + unknown_variance)
        y, error, source = self._key_characteristics(x, half)
        if y is None:
            return self._table([("", *NOTHING, "failed", "", "its contact problems could not be solved")], distance)
        width = np.hypot(half, error)
        verdict, proposal, assembly_source = self._verdicts(y, width), "", source
        known = np.sqrt(np.maximum(width**2 - NORMAL**2 * unmeasured_variance.sum(axis=1), 0.0))
        measure = self._to_measure(verdict, self._verdicts(y, known), unmeasured_variance)
        if (adjustment := self._adjusting(verdict, half, measure)) is not None:
            noise = np.zeros(len(x)) if covariance is None else np.sqrt(covariance.diagonal())
            noise = np.where(given | (self._sigma == 0), noise, np.inf)
            self.proposal = adjustment.propose(x, half, noise)
            proposal, assembly_source = str(self.proposal), "evaluated"
            if measure and not adjustment.always and self.proposal.excess > 0:
                self.proposal = None
            elif covariance is None:  # the assembly was evaluated without changes too
                y, source, width = self.proposal.before, "evaluated", half
                verdict = self._verdicts(y, width)
        if self.proposal is None or not (self.proposal.changes or self.proposal.order):
            proposal = measure or proposal
        worst = "rejected" if "rejected" in verdict else "open" if "open" in verdict else "accepted"
        items = [item.name for item in self.model.scene.measurements]
        rows = [(*row, source, "") for row in zip(items, y, y - width, y + width, verdict)]
        table = self._table([*rows, ("", *NOTHING, worst, assembly_source, proposal)], distance)
        if self.proposal is not None and (self.proposal.changes or self.proposal.order):
            table["adjusted"] = [*self.proposal.after, np.nan]
        return table

    def _adjusting(self, verdict: np.ndarray, half: np.ndarray, measure: str) -> JointAdjustment | None:
        """The adjustment of an assembly; None if it needs none, or if missing measurements make its intervals exceed
        the tolerance."""
        if self._adjustment is None or self._adjustment.always:
            return self._adjustment
        fits = bool((2 * half <= self._upper - self._lower).all())
        return self._adjustment if (verdict != "accepted").any() and (fits or not measure) else None

    def _to_measure(self, verdict: np.ndarray, known: np.ndarray, variance: np.ndarray) -> str:
        """Which deviation to measure, if missing measurements alone leave verdicts (k,) open; empty if not.

        `known` (k,) are the verdicts without the (k, p) variance due to the missing measurements.
        """
        open_, decided = verdict == "open", known != "open"
        if not open_.any() or not decided[open_].all() or "rejected" in verdict:
            return ""
        share = variance[open_] / np.maximum(variance[open_].sum(axis=1, keepdims=True), 1e-300)
        k, j = np.unravel_index(int(share.argmax()), share.shape)
        name = self.model.scene.measurements[np.flatnonzero(open_)[k]].name
        return f"measure {self.model.parameters[j]}, which causes {100 * share[k, j]:.0f} % of the variance of {name}"

    def _distance(self, x: np.ndarray) -> np.ndarray:
        """(p,) distance of the deviations from their means, in standard deviations."""
        difference = np.abs(x - self._mean)
        with np.errstate(divide="ignore", invalid="ignore"):
            return np.where(difference > 0, difference / self._sigma, 0.0)

    def _key_characteristics(self, x: np.ndarray, half: np.ndarray) -> tuple[np.ndarray | None, np.ndarray, str]:
        """Key characteristics (k,) of an assembly, or None if they cannot be computed; their errors (k,) in addition to
        the known half widths; ``learnt`` or ``evaluated``."""
        emulator, self.evaluation = self.emulator, None
        if emulator is not None and emulator.covers(x):
            y, error = (array[0] for array in emulator(x[None]))
            if (self._verdicts(y - error, half) == self._verdicts(y + error, half)).all():
                return y, error, "learnt"
        self.evaluation = evaluation = self._process.attempt(x[None])
        return None if evaluation.failed[0] else evaluation.measurements[0], np.zeros(len(self._lower)), "evaluated"

    def _verdicts(self, y: np.ndarray, half: np.ndarray) -> np.ndarray:
        """(k,) ``accepted``, ``rejected`` or ``open`` for intervals y ± half."""
        within = (y - half >= self._lower) & (y + half <= self._upper)
        beyond = (y + half < self._lower) | (y - half > self._upper)
        return np.where(within, "accepted", np.where(beyond, "rejected", "open")).astype(object)

    def _table(self, rows: list[tuple], distance: np.ndarray) -> pd.DataFrame:
        """The table of an assembly with deviations (p,) at these distances."""
        table = pd.DataFrame(rows, columns=["measurement", "value", "low", "high", "verdict", "way", "said"])
        return table.assign(
            file="", row=0, model="", law=self.law, adjusted=np.nan, far=float(distance.max()), checksum=""
        )[PREDICTIONS.names]


@checked
def predict(
    model: ReducedModel,
    parts: pd.DataFrame | Sequence[Mapping[str, float]],
    law: str | None = None,
    adjust: Sequence[str] | Adjustable = (),
    shim: float | None = None,
    factor: float | None = None,
    error: float = 0.0,
    exact: bool = False,
    cache: Path | None = None,
    progress: Progress = lambda count: None,
) -> pd.DataFrame:
    """Predict assemblies from their measured parts, with one :class:`Predictor`.

    Parameters
    ----------
    model : ReducedModel
    parts : DataFrame, or sequence of mappings
        A row or mapping for each assembly: values of deviations by name, N or mm; NaN for unknown ones.
    law, adjust, shim, factor, error, exact, cache
        Parameters of :class:`Predictor`.
    progress : callable or bool, optional
        Called with the number of training evaluations since the last call; or whether a bar is shown.

    Returns
    -------
    DataFrame
        As :data:`mic.results.schema.PREDICTIONS` declares it, with empty ``file``, and in ``row`` the number of the
        assembly from 0: for each assembly its key characteristics, then the whole assembly.

    Raises
    ------
    SceneError
        As :class:`Predictor`, and if there is no assembly.
    ArgumentError
        As :class:`Predictor`, and for unknown names and values that are not finite.
    """
    rows = parts.to_dict("records") if isinstance(parts, pd.DataFrame) else list(parts)
    if not rows:
        raise SceneError("parts: the list is empty; give a row for each assembly")
    named = [numbers_by_name("parts", row, unknown=True) for row in rows]
    known = [{name: value for name, value in row.items() if not np.isnan(value)} for row in named]
    predictor = Predictor(model, law, adjust, shim, factor, error, exact, cache, progress)
    return pd.concat([predictor.predict(row).assign(row=i) for i, row in enumerate(known)], ignore_index=True)
