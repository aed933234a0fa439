"""Results of the process: contact solutions by stage, key characteristics, forces, and their derivatives."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, fields, replace
from functools import cached_property, partial
from html import escape
from typing import TYPE_CHECKING, Any

import numpy as np

from mic.contact.path import Trace
from mic.contact.states import STATES
from mic.process.frames import ResultNames, frame, states
from mic.process.state import ProcessState
from mic.system.arguments import did_you_mean

if TYPE_CHECKING:
    import pandas as pd  # not needed to evaluate a model

__all__ = ["ContactSensitivity", "Evaluation", "LazyResolutions", "ProcessHistory", "Resolution", "Sensitivities"]

REACHED = 1e-3  # mm: a smaller distance to the position counts as reached, for no gauge can measure it


@dataclass(frozen=True)
class Resolution:
    """Contact solution of one stage for n samples and m pairs of dimension d (3, or 1 for normals only).

    Attributes
    ----------
    stage : str
    force : (n, m, d) array
        N; normal compression positive.
    displacement : (n, m, d) array
        mm; the normal component is the gap, the tangential ones are the tangential displacement since the stage before,
        for open contacts too.
    state : (n, m) int8 array
        A :class:`mic.ContactState` each: 0 open, 1 stick, 2 slip; :attr:`state_names` has their names.
    trace : mic.contact.path.Trace
        History of the contacts along the path: slip under load, friction work, shares of the path. Its error is that of
        the contacts' positions at the end of the stage: the error of this path plus, as a bound, those of all paths
        before.
    residual : (n,) array
        Scale-free natural-map residual, the largest over the increments, or over the ends of the steps followed.
    converged : (n,) bool array
        True if all of these met the tolerance.
    iterations : (n,) int array
    status : (n,) object array
        Outcome of the last step.
    rung : (n,) object array
        ``"followed"``, or the rung of the solver ladder that found the last force, see
        :class:`mic.contact.ContactSolution`.
    reaction : (n, b) array
        Forces of the bilateral rows on the parts, N or N mm.
    unseen : (n,) array
        Deepest penetration at the end, at points between the pairs, where no pair detects it, mm; 0 if there is none.
    unseen_at : (n,) int array
        Which of the model's points between the pairs; -1 if there is none.
    pushed : (n, p) array
        Forces of the clamps and guns of limited force when they are checked
        (:attr:`mic.process.plan.StagePlan.checked_limits`), N.
    left : (n, p) array
        Distance of each to its position, mm; 0 if it is reached.
    needed : (n, p) array
        If a position is not reached: the force of each clamp and gun without any limit in that sample, N; otherwise
        NaN.
    """

    stage: str
    force: np.ndarray
    displacement: np.ndarray
    state: np.ndarray
    trace: Trace
    residual: np.ndarray
    converged: np.ndarray
    iterations: np.ndarray
    status: np.ndarray
    rung: np.ndarray
    reaction: np.ndarray
    unseen: np.ndarray
    unseen_at: np.ndarray
    pushed: np.ndarray
    left: np.ndarray
    needed: np.ndarray

    def __repr__(self) -> str:
        n, m = self.state.shape
        return f"Resolution of stage {self.stage!r}: {n} samples with {m} contacts each: {states(self.state)}"

    @property
    def state_names(self) -> np.ndarray:
        """(n, m) array of the states' names: open, stick or slip."""
        return np.array(STATES)[self.state]

    @property
    def reached(self) -> np.ndarray:
        """(n, p) whether each clamp and gun of limited force reached its position."""
        return ~(self.left > REACHED)

    @classmethod
    def join(cls, pieces: Sequence[Resolution]) -> Resolution:
        """Concatenate solutions of one stage."""
        trace = Trace(**_stacked([piece.trace for piece in pieces], Trace))
        return cls(stage=pieces[0].stage, trace=trace, **_stacked(pieces, cls))


@dataclass(frozen=True)
class ProcessHistory:
    """Results of n assemblies over all stages.

    Attributes
    ----------
    resolutions : dict of str to Resolution
        By stage, for the stages that solve contact.
    readings : (n, r) array
        As in :class:`Evaluation`.
    failed : (n,) bool array
        As in :class:`Evaluation`.
    state : mic.process.state.ProcessState
        At the end of the requested stage.
    """

    resolutions: dict[str, Resolution]
    readings: np.ndarray
    failed: np.ndarray
    state: ProcessState


class LazyResolutions(Mapping[str, Resolution]):
    """Contact solutions by stage, in order; computed when the first of them is requested.

    Parameters
    ----------
    stages : sequence of str
        Those that solve contact.
    history : function
        Computes the :class:`ProcessHistory`; called once.
    """

    def __init__(self, stages: Sequence[str], history: Callable[[], ProcessHistory]):
        self._stages, self._compute = stages, history

    @cached_property
    def history(self) -> ProcessHistory:
        """Results over all stages."""
        history = self._compute()
        del self._compute  # frees its arguments
        return history

    def __getitem__(self, stage: str) -> Resolution:
        if stage not in self._stages:
            raise KeyError(f"no stage {stage!r} solves contact; {did_you_mean(stage, self._stages)}")
        return self.history.resolutions[stage]

    def __contains__(self, stage: object) -> bool:
        return stage in self._stages

    def __iter__(self) -> Iterator[str]:
        return iter(self._stages)

    def __len__(self) -> int:
        return len(self._stages)


@dataclass(frozen=True)
class Evaluation:
    """Results of n assemblies.

    Attributes
    ----------
    law : str
    deviations : (n, p) array
    resolutions : mapping of str to Resolution
        By stage, for the stages that solve contact; computed when first requested.
    measurements : (n, k) array
        Key characteristics in the scene's order, mm from nominal; empty if nothing is measured.
    readings : (n, r) array
        The readings from which they are computed (`mic.model.characteristics`), mm; empty likewise.
    failed : (n,) bool array
        Samples whose contact did not meet its tolerance in some stage.
    equilibrium : function
        Computes :attr:`functional_force` and :attr:`motion` when either is first requested.
    names : ResultNames
    """

    law: str
    deviations: np.ndarray
    resolutions: Mapping[str, Resolution]
    measurements: np.ndarray
    readings: np.ndarray
    failed: np.ndarray
    equilibrium: Callable[[], tuple[np.ndarray, np.ndarray]]
    names: ResultNames

    def __repr__(self) -> str:
        failed, measured = int(self.failed.sum()), ", ".join(self.names.measurements[:8]) or "none"
        more = ", …" if len(self.names.measurements) > 8 else ""
        return (
            f"Evaluation of {len(self.failed)} samples under {self.law}, {failed or 'none'} failed\n"
            f"  key characteristics, mm from nominal: {measured}{more}\n"
            f"  stages that solve contact: {', '.join(self.resolutions) or 'none'}\n"
            f'  to_frame() has one row per sample; to_frame("contacts") has contact forces and states'
        )

    def _repr_html_(self) -> str:
        """HTML for notebooks."""
        return f"<pre>{escape(repr(self))}</pre>{self.to_frame()._repr_html_()}"  # type: ignore[operator]

    def to_frame(self, table: str = "samples") -> pd.DataFrame:
        """A table of the results.

        Parameters
        ----------
        table : {"samples", "deviations", "measurements", "contacts"}
            ``"samples"``: a row for each sample, with its deviations, key characteristics (mm from nominal; NaN if it
            failed), ``failed`` and ``built``. ``"deviations"`` and ``"measurements"``: only these columns.
            ``"contacts"``: a row for each stage that solves contact, sample and contact pair, with zone, force
            (``f_n``, ``f_t1``, ``f_t2``, N), displacement (``u_n`` …, mm) and ``state``: open, stick or slip
            (:class:`mic.ContactState`).

        Returns
        -------
        DataFrame
            Samples have the index of the evaluated DataFrame, or numbers from 0. ``attrs["units"]`` has the units of
            deviations and key characteristics by column. A deviation whose name another column has is called
            ``deviation NAME``.

        Raises
        ------
        ArgumentError
            For another table.
        """
        return frame(self, table)

    @property
    def functional_force(self) -> np.ndarray:
        """(n, F) all forces on the retained functionals in the last stage, with those that make the shapes, N."""
        return self._equilibrium[0]

    @property
    def motion(self) -> np.ndarray:
        """(n, 6P) rigid-body motions of the parts in the last stage, with those of the shapes, mm and rad."""
        return self._equilibrium[1]

    @cached_property
    def _equilibrium(self) -> tuple[np.ndarray, np.ndarray]:
        return self.equilibrium()

    def __getstate__(self) -> dict[str, Any]:
        """Everything computed, so that a pickled evaluation does not carry its process along."""
        known = {"resolutions": dict(self.resolutions), "equilibrium": partial(tuple, self._equilibrium)}
        return vars(self) | known

    @property
    def built(self) -> np.ndarray:
        """(n,) whether every clamp and gun of limited force reached its position; true if there are none."""
        reached = [resolution.reached.all(axis=1) for resolution in self.resolutions.values()]
        return np.logical_and.reduce([np.ones(len(self.failed), dtype=bool), *reached])

    @classmethod
    def join(cls, pieces: Sequence[Evaluation]) -> Evaluation:
        """Concatenate evaluations under one law."""
        if len(pieces) == 1:
            return pieces[0]
        stages = pieces[0].resolutions
        resolutions = {stage: Resolution.join([piece.resolutions[stage] for piece in pieces]) for stage in stages}

        def equilibrium():
            return tuple(np.concatenate(each) for each in zip(*(piece._equilibrium for piece in pieces)))

        arrays, names = _stacked(pieces, cls), pieces[0].names
        return cls(law=pieces[0].law, resolutions=resolutions, equilibrium=equilibrium, names=names, **arrays)

    def without_samples(self) -> Evaluation:
        """The result of no assembly: all arrays have their shapes, with n = 0."""
        resolutions = {
            stage: replace(one, trace=replace(one.trace, **_emptied(one.trace)), **_emptied(one))
            for stage, one in self.resolutions.items()
        }
        force, motion = self._equilibrium
        equilibrium = partial(tuple[Any, Any], (force[:0], motion[:0]))
        return replace(self, resolutions=resolutions, equilibrium=equilibrium, **_emptied(self))


#: Recorded path steps: by stage and number of the step, the record (n,) of each sample.
PathSteps = Mapping[tuple, np.ndarray]


@dataclass(frozen=True)
class ContactSensitivity:
    """Contact forces and their derivatives, for m contacts at the end of a stage that solves contact.

    Attributes
    ----------
    force : (n, m, d) array
        N.
    state : (n, m) int8 array
        A :class:`mic.ContactState` each: 0 open, 1 stick, 2 slip.
    force_slope : (n, m, d, p) array
        Derivatives of the forces, N per unit of the inputs.
    slip_slope : (n, m, d - 1, p) array
        Derivatives of the tangential displacement since the stage before, mm per unit; NaN for inputs that change the
        compliance.
    """

    force: np.ndarray
    state: np.ndarray
    force_slope: np.ndarray
    slip_slope: np.ndarray


@dataclass(frozen=True)
class Sensitivities:
    """Derivatives of n assemblies with respect to p inputs.

    Attributes
    ----------
    law : str
    inputs : list of str
    sigma : (p,) array
        Standard deviations of the inputs; 0 for inputs that the scene holds fixed.
    measurements : (n, k) array
        Key characteristics along the differentiated path, mm; they differ from those of an evaluation by at most the
        error of its path.
    jacobian : (n, k, p) array
        Their derivatives, mm per unit of the inputs.
    sides : (n, k, p, 2) array
        One-sided derivatives of samples at a change of state (``reach`` at most
        :data:`mic.process.sensitivity.AT_CHANGE`): towards smaller and towards larger values of the input. NaN where no
        solution exists there, for positions in sheets, and for shapes that change the stiffness. Other samples, and
        inputs that do not lead to the change, have the derivatives themselves on both sides.
    contacts : dict of str to ContactSensitivity
        By stage.
    reach : (n,) array
        Distance to the next change of a contact's state at the end of a step, to first order, in standard deviations
        along the direction in which all inputs together change that contact most; infinite if no state changes.
    reach_along : (n, p) array
        The same along each input alone: infinite for inputs without standard deviation, NaN for thicknesses, which
        ``reach`` ignores too. Changes of the stiffness with the shape are ignored.
    where : (n,) object array of str
        The contact that changes its state there.
    failed : (n,) bool array
        Samples whose contact did not meet its tolerance, or in which nothing determines the position of a resting part;
        their derivatives are NaN.
    exact : (n,) bool array
        Whether every step of the path was solved again exactly; otherwise the derivatives have the error of the path.
    steps : mapping
        The recorded path steps, which another call can reuse.
    """

    law: str
    inputs: list[str]
    sigma: np.ndarray
    measurements: np.ndarray
    jacobian: np.ndarray
    sides: np.ndarray
    contacts: dict[str, ContactSensitivity]
    reach: np.ndarray
    reach_along: np.ndarray
    where: np.ndarray
    failed: np.ndarray
    exact: np.ndarray
    steps: PathSteps

    @classmethod
    def join(cls, pieces: Sequence[Sensitivities]) -> Sensitivities:
        """Concatenate batches of samples."""
        first = pieces[0]
        contacts = {
            stage: ContactSensitivity(**_stacked([piece.contacts[stage] for piece in pieces], ContactSensitivity))
            for stage in first.contacts
        }
        steps = {key: np.concatenate([piece.steps[key] for piece in pieces]) for key in first.steps}
        arrays = _stacked(pieces, cls) | {"sigma": first.sigma}
        return cls(law=first.law, inputs=first.inputs, contacts=contacts, steps=steps, **arrays)


def _emptied(piece) -> dict[str, Any]:
    """All fields that are arrays over samples, without any."""
    return {field.name: getattr(piece, field.name)[:0] for field in fields(piece) if field.type == "np.ndarray"}


def _stacked(pieces, cls) -> dict[str, np.ndarray]:
    """All fields that are arrays over samples, concatenated."""
    arrays = [field.name for field in fields(cls) if field.type == "np.ndarray"]
    return {name: np.concatenate([getattr(piece, name) for piece in pieces]) for name in arrays}
