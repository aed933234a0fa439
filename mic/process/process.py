"""The process: stages in order, the assembly's state handed from one to the next."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from functools import cached_property, partial
from typing import Any

import numpy as np

from mic.contact import ContactSolver, laws
from mic.contact.compliance_columns import Columns
from mic.contact.friction import Friction
from mic.contact.path import Increments, Path, PathSolution, Trace
from mic.contact.working_set import Foreseen, WatchedSolver
from mic.errors import ImpossibleSample, SceneError
from mic.model.sources import sources
from mic.process.drive import Drive, DriveTerms, drive
from mic.process.evaluation import Evaluation, LazyResolutions, ProcessHistory, Resolution
from mic.process.free_motions import check_resting
from mic.process.linear_maps import Linear
from mic.process.plan import StagePlan, Step, plan_stages, yielding
from mic.process.stage import OUTPUTS, EliminatedStep, PreparedStage, eliminate_steps, path_of, stops_of
from mic.process.state import ProcessState
from mic.system.matrix_product import one_thread, product

__all__ = ["TOLERANCE", "Process", "contact_solver"]

#: The paper's solvers reach this residual.
PAPER_TOLERANCE = 1e-5
#: What the contact certificate of a run reaches, unless another is asked for.
TOLERANCE = 1e-10
#: Samples by which the candidates are guessed that carry force.
AHEAD = 16
#: Spacings between two candidates that join a working set together.
APART = 2.0
#: Processes that are kept whose deviations have changed the contacts.
KEPT = 8


def contact_solver(
    contacts,
    S: Columns,
    own: np.ndarray,
    friction: Friction,
    step: Step,
    foreseen: Foreseen | None = None,
    guessing: bool = False,
    **settings,
):
    """What solves the contacts of a step: a :class:`mic.contact.working_set.WatchedSolver` where any is a candidate, or
    takes no part.

    Parameters
    ----------
    contacts : mic.model.assembly.Contacts
    S : (d m + s, d m + s) Columns
        Compliance at the contacts and at the step's stops, mm/N.
    own : (d m + s,) array
        Its diagonal.
    friction : Friction
        Of the contacts.
    step : Step
    foreseen : Foreseen, optional
        What this step did to a few samples; default: nothing is known.
    guessing : bool
        As :class:`mic.contact.working_set.WatchedSolver` has it.
    **settings
        Law and others, as :class:`mic.contact.ContactSolver` takes them.
    """
    settings["semidefinite"] = True  # as a compliance is that bilateral rows were eliminated from
    stops = stops_of(contacts, step)
    S, friction = stops.compliance(S, own), stops.friction(friction)
    out = contacts.excluded(step.nuggets, step.away)
    if not (contacts.watched.any() or out.any()):
        return ContactSolver(S.block(np.arange(len(S))), friction, **settings)
    always = np.ones(stops.count, dtype=bool)
    foreseen = foreseen or Foreseen.nothing(len(contacts) + stops.count, contacts.dimension)
    return WatchedSolver(
        S,
        friction,
        np.concatenate([contacts.point, np.zeros((stops.count, 3))]),
        np.concatenate([APART * np.sqrt(contacts.area), np.zeros(stops.count)]),
        np.concatenate([~contacts.watched, always]) | foreseen.touching,
        np.concatenate([~out, always]),
        guessing=guessing,
        foreseen=foreseen,
        **settings,
    )


class Process:
    """All stages of a reduced model, prepared for one contact law.

    Parameters
    ----------
    model : mic.process.model.ReducedModel
    law : str
        Name of a contact law (`mic.contact.laws`).
    tol : float
        Tolerance of the contact certificate; the paper's solvers get `PAPER_TOLERANCE` if that is larger.
    backend : {"native", "paper"}
        Who solves the contacts: the native solver, or the paper's (OSQP for (12), ECOS for (13)).
    threads : int
        Threads of the native solver over the samples of a batch.
    path_tolerance : float, optional
        Of the paths that are followed, see :class:`mic.contact.path.Followed`; default: the scene's.
    foreseen : mapping, optional
        What a few samples went through, by stage and step; default: :attr:`mic.process.model.ReducedModel.foreseen`.
    limited : bool
        Whether limits of forces are kept; without, clamps and guns hold the position that they push towards.
    plans : sequence of StagePlan, optional
        Those of the model's scene, where it is known that contact holds what rests; default: made and looked at.

    like : Process, optional
        Of the same plans under the same law, whose contacts differ by their friction alone: what does not hang on that
        is taken over.

    Attributes
    ----------
    stages : list of PreparedStage
        All stages, in order.

    Raises
    ------
    SceneError
        If a stage leaves a part free to move, or to contact that cannot hold it under the law.
    """

    @one_thread
    def __init__(
        self,
        model,
        law: str,
        tol: float = TOLERANCE,
        backend: str = "native",
        threads: int = 1,
        path_tolerance: float | None = None,
        foreseen: Mapping[tuple[str, Step], Foreseen] | None = None,
        limited: bool = True,
        plans: Sequence[StagePlan] | None = None,
        like: Process | None = None,
    ):
        self.model, self.law, self._like = model, law, like
        contacts = model.contacts
        # Without friction anywhere every law is the frictionless one, and the model may hold no tangential rows.
        smooth = contacts.dimension == 1 and not contacts.frictional
        obeyed = laws.FRICTIONLESS if smooth else laws.find(law)
        solver_name = laws.find(law).paper_backend if backend == "paper" else "native"
        self._settings = {
            "law": obeyed,
            "backend": solver_name,
            "tol": tol if solver_name == "native" else max(tol, PAPER_TOLERANCE),
            "threads": threads,
            "dimension": contacts.dimension,
        }
        if plans is not None:
            self._plans = plans
        else:
            self._plans = model.plans if limited else plan_stages(model.scene, model.weld_size, limited)
        if plans is None:
            check_resting(model, self._plans, [obeyed.name])
        self._eliminations = model.eliminations if limited else eliminate_steps(model, self._plans)
        rubs, slopes = obeyed.frictional, model.slopes
        #: By the deviations that change contacts or parts, at which values these are as the model has them.
        changing = {
            j: 0.0
            for j, source in enumerate(sources(model.scene))
            if source.changes == "compliance" or (source.changes and rubs)
        }
        if slopes is not None:
            changing |= dict(zip(slopes.source.tolist(), slopes.about.tolist()))
        self._changing = list(changing)
        self._changed_by, self._limited = np.array(list(changing.values())), limited
        self._varied: dict[bytes, Process] = {}
        self._own_parts = False  # whether its parts' compliance is one sample's own
        self._solvers: dict[tuple, ContactSolver | WatchedSolver] = {}
        self._foreseen, self._guessing = model.foreseen if foreseen is None else foreseen, False
        path_tolerance = path_tolerance or model.scene.path.tolerance
        self._path_tolerance = path_tolerance
        self.stages = self._prepared([path_of(plan, obeyed, path_tolerance) for plan in self._plans])

    def _prepared(self, paths: Sequence[Path]) -> list[PreparedStage]:
        model = self.model
        return [
            PreparedStage(plan, self._eliminations[plan.name], model, partial(self._solver, plan.name), path)
            for plan, path in zip(self._plans, paths)
        ]

    def _solver(self, stage: str, eliminated: EliminatedStep) -> ContactSolver | WatchedSolver:
        """Of a step; those that hold the same rows under the same friction share it, where nothing is watched."""
        contacts, step = self.model.contacts, eliminated.step
        friction = contacts.friction_in(stage)
        own = (stage, step) if contacts.watched.any() else None
        key = step.bilateral, step.parked, step.stops, step.away, friction.coefficient.tobytes(), own
        if key in self._solvers:
            return self._solvers[key]
        if self._like is not None:
            known = self._like._solver(stage, eliminated)
            self._solvers[key] = known.under(stops_of(contacts, step).friction(friction))
        else:
            foreseen = self._foreseen.get((stage, step))
            self._solvers[key] = contact_solver(
                contacts, *eliminated.compliance, friction, step, foreseen, self._guessing, **self._settings
            )
        return self._solvers[key]

    @classmethod
    def look_ahead(cls, model) -> dict[tuple[str, Step], Foreseen]:
        """What a few samples, always the same, go through where there are candidates, by stage and step: under
        Coulomb's law where tangents are modelled, with one increment a step, all on one working set.

        A sample starts from it, whatever samples it is evaluated with.
        """
        if not model.contacts.watched.any():
            return {}
        ahead = cls(model, "coulomb" if model.contacts.dimension == 3 else "frictionless", foreseen={})
        mean, sigma = np.array([[one.mean, one.sigma] for one in model.scene.deviations]).reshape(-1, 2).T
        draws = np.random.default_rng(0).standard_normal((AHEAD, len(mean)))
        draws[0] = 0.0
        if model.slopes is not None:  # shapes vary, with the stiffness of their mean for all
            still = ~np.isin(ahead._changing, model.slopes.source)
            ahead._changing = np.array(ahead._changing)[still].tolist()
            ahead._changed_by = ahead._changed_by[still]
        draws[:, ahead._changing] = 0.0
        ahead.stages, ahead._guessing = ahead._prepared([Increments(1)] * len(ahead.stages)), True
        ahead.attempt(mean + sigma * draws)
        return ahead.seen

    @property
    def seen(self) -> dict[tuple[str, Step], Foreseen]:
        """What samples went through so far, by stage and step."""
        return {key[-1]: one.seen for key, one in self._solvers.items() if isinstance(one, WatchedSolver)}

    @property
    def redundant(self) -> list[str]:
        """One sentence for each row that a stage holds in vain, since its others hold it already."""
        return [
            f"stage {stage}: {kind} row {self.model.labels[kind][i]} repeats other rows of the stage; "
            "its value has no effect"
            for stage, kind, i in dict.fromkeys(
                (stage.plan.name, *each.step.bilateral[j])
                for stage in self.stages
                for each in stage.steps
                for j in each.response.redundant
            )
        ]

    @one_thread
    def evaluate(self, deviations: np.ndarray, at: str | None = None) -> Evaluation:
        """Take a batch through all stages.

        Parameters
        ----------
        deviations : (n, p) array
            As :meth:`mic.model.reduction.Reduction.deviations` returns it.
        at : str, optional
            The stage at whose end all forces and the parts' motions are told; default: the last.
        """
        if (deviations[:, self._changing] != self._changed_by).any():
            by_model = self.by_model(deviations)
            return Evaluation.join([process.evaluate(deviations[part], at) for part, process in by_model])
        told = [stage.plan.name for stage in self.stages].index(at) if at else len(self.stages) - 1
        asked, solutions = deviations.copy(), None
        if self._linear is not None:
            solutions, readings, failed = self._linear.follow(self.stages, deviations)
        names = [stage.plan.name for stage in self.stages if stage.resolves]
        resolutions = LazyResolutions(names, partial(self._through, asked, told, solutions))
        if solutions is None:
            readings, failed = resolutions.history.readings, resolutions.history.failed
        read = self.model.characteristics.values(readings) if readings.size else readings
        equilibrium = partial(self._equilibrium, self.stages[told], resolutions, asked)
        found = Evaluation(self.law, deviations, resolutions, read, readings, failed, equilibrium)
        if solutions is None and any(resolution.left.size for resolution in resolutions.values()):
            short = np.flatnonzero(~found.built)
            if short.size:
                self._tell_needs(found, short)
        return found

    @one_thread
    def _through(
        self, deviations: np.ndarray, told: int, solutions: Sequence[PathSolution] | None = None
    ) -> ProcessHistory:
        """Take samples through all stages, one by one; where the contacts' paths are known, by these."""
        asked, state = self.asked(deviations), self.start(len(deviations))
        resolutions, readings, resolve = {}, np.zeros((len(deviations), 0)), None
        if solutions is not None:
            left, nothing = iter(solutions), np.zeros((len(deviations), 0))
            resolve = lambda eliminated, state, drive, ramp, place: (next(left), nothing, place)
        for i, stage in enumerate(self.stages):
            state, resolution = stage.advance(state, asked, resolve)
            if resolution is not None:
                resolutions[stage.plan.name] = resolution
            if stage.plan.reads:
                readings = state.reading["measurement"] + asked.measured
            if i == told:
                end = state
        return ProcessHistory(resolutions, readings, state.failed, end)

    @cached_property
    def _linear(self) -> Linear | None:
        """What is linear in the process; not worth it where compliance is one sample's own."""
        if self._guessing or self._own_parts:
            return None
        return Linear.of(self, len(self.model.scene.deviations))

    def asked(self, deviations: np.ndarray) -> Drive:
        """What deviations (n, p) ask of the assembly, affine in them."""
        every, own = self._unit_shapes
        shapes = product(deviations, every)
        return drive(self.model, deviations, {kind: shapes[:, rows] for kind, rows in own.items()}, self._drive_terms)

    def start(self, n: int) -> ProcessState:
        """The state of n assemblies before anything happens."""
        model = self.model
        rows = {kind: model.rows[kind].shape[0] for kind in OUTPUTS} | {"rest": len(model.rest)}
        return ProcessState.start(n, len(model.contacts), model.contacts.dimension, rows)

    def by_model(self, deviations: np.ndarray) -> Iterator[tuple[slice, Process]]:
        """Samples in runs (slices of them) whose deviations change contacts and parts alike, and the process of each,
        one by one: this one where nothing changes them."""
        own = deviations[:, self._changing]
        edges = [0, *(np.flatnonzero((own[1:] != own[:-1]).any(axis=1)) + 1).tolist(), len(own)]
        for a, b in zip(edges, edges[1:]):
            yield slice(a, b), self if (own[a:b] == self._changed_by).all() else self._changed(own[a])

    def _changed(self, amplitudes: np.ndarray) -> Process:
        """The process with contacts and parts as these deviations change them; shapes stay as they are."""
        key = amplitudes.tobytes()
        if key not in self._varied:
            deviations = np.zeros(len(self.model.scene.deviations))
            deviations[self._changing] = amplitudes
            model = self.model.with_deviations(deviations)
            vars(model).update({name: getattr(self.model, name) for name in ("foreseen", "rest", "characteristics")})
            if model.compliance is self.model.compliance:
                vars(model)["eliminations"] = self.model.eliminations
            elif self._limited:
                vars(model)["eliminations"] = eliminate_steps(model, self._plans)
            same = (model.contacts.friction == self.model.contacts.friction).all()
            backend = "native" if self._settings["backend"] == "native" else "paper"
            how: dict[str, Any] = {name: self._settings[name] for name in ("tol", "threads")}
            how |= {"path_tolerance": self._path_tolerance, "foreseen": self._foreseen, "limited": self._limited}
            how["plans"] = self._plans
            how["like"] = self if model.compliance is self.model.compliance else None
            try:
                if not same:  # what rests under one friction may not under another
                    check_resting(model, self._plans, [self._settings["law"].name])
                process = Process(model, self.law, backend=backend, **how)
            except SceneError as problem:
                raise ImpossibleSample(str(problem)) from problem
            process._changed_by, process._own_parts = amplitudes, how["like"] is None
            vars(process)["_unit_motions"] = self._unit_motions
            if how["like"] is not None:
                vars(process).update(
                    {name: getattr(self, name) for name in ("_held", "_unit_shapes", "_drive_terms", "_linear")}
                )
            if len(self._varied) >= (KEPT if model.compliance is self.model.compliance else 1):  # compliance is large
                self._varied.clear()
            self._varied[key] = process
        return self._varied[key]

    def _tell_needs(self, found: Evaluation, short: np.ndarray) -> None:
        """What the forces of these samples would be if none had a limit, into ``needed``; NaN where that fails."""
        without = self._unlimited.attempt(found.deviations[short])
        for stage, resolution in found.resolutions.items():
            known = ~resolution.reached[short] & ~without.failed[:, None]
            resolution.needed[short] = np.where(known, without.resolutions[stage].pushed, np.nan)

    @cached_property
    def _unlimited(self) -> Process:
        """The same process without limits of forces."""
        settings = {name: self._settings[name] for name in ("tol", "threads")}
        backend = "native" if self._settings["backend"] == "native" else "paper"
        process = Process(
            self.model,
            self.law,
            backend=backend,
            path_tolerance=self._path_tolerance,
            foreseen={},
            limited=False,
            **settings,
        )
        # The model's contacts and parts are changed already, or stay as they are.
        process._changing, process._changed_by = self._changing, self._changed_by
        return process

    def attempt(self, deviations: np.ndarray, at: str | None = None) -> Evaluation:
        """As :meth:`evaluate`; should it break, sample by sample, so that only the samples at fault are lost."""
        try:
            return self.evaluate(deviations, at)
        except (ArithmeticError, np.linalg.LinAlgError) as error:
            if len(deviations) == 1:
                return self.blank(deviations, str(error))
            return Evaluation.join([self.attempt(row[None], at) for row in deviations])

    def blank(self, deviations: np.ndarray, reason: str) -> Evaluation:
        """The evaluation of samples that could not be computed: failed, all values NaN, the reason as their status."""
        model = self.model
        n, m, d = len(deviations), len(model.contacts), model.contacts.dimension

        def nan(*shape):
            return np.full((n, *shape), np.nan)

        resolutions = {
            stage.plan.name: Resolution(
                stage=stage.plan.name,
                force=nan(m, d),
                displacement=nan(m, d),
                state=np.zeros((n, m), np.int8),
                trace=Trace(nan(m, 2), nan(m), nan(m), nan(m, 3), nan(), np.zeros(n, int), np.zeros(n, int)),
                residual=nan(),
                converged=np.zeros(n, bool),
                iterations=np.zeros(n, int),
                status=np.full(n, reason, dtype=object),
                rung=np.full(n, "none", dtype=object),
                reaction=nan(len(stage.plan.bilateral)),
                unseen=nan(),
                unseen_at=np.full(n, -1),
                pushed=nan(len(stage.plan.judged)),
                left=nan(len(stage.plan.judged)),
                needed=nan(len(stage.plan.judged)),
            )
            for stage in self.stages
            if stage.resolves
        }
        force, motion = nan(model.compliance.size), nan(6 * len(model.compliance))
        return Evaluation(
            law=self.law,
            deviations=deviations,
            resolutions=resolutions,
            measurements=nan(len(model.scene.measurements) if self.stages[-1].plan.reads else 0),
            readings=nan(model.rows["measurement"].shape[0] if self.stages[-1].plan.reads else 0),
            failed=np.ones(n, bool),
            equilibrium=lambda: (force, motion),
        )

    @cached_property
    def _unit_shapes(self) -> tuple[np.ndarray, dict[str, slice]]:
        """What all rows read of the shape that each unit deviation gives (p, R), and which of them are of each kind."""
        rows = {**self.model.rows, "rest": self.model.rest.rows}
        edges = np.cumsum([0, *(own.shape[0] for own in rows.values())])
        every = np.concatenate([own @ self.model.shape for own in rows.values()])
        return np.ascontiguousarray(every.T), {kind: slice(a, b) for kind, a, b in zip(rows, edges, edges[1:])}

    @cached_property
    def _drive_terms(self) -> DriveTerms:
        return DriveTerms.of(self.model)

    @cached_property
    def _unit_motions(self) -> np.ndarray:
        """(p, 6P) rigid motions of these shapes, beside the elastic readings of the forces that make them."""
        model = self.model
        moved = [not source.thickening() for source in sources(model.scene)]  # where faces move, the middle does not
        shape = model.shape * np.array(moved, dtype=float)
        return model.compliance.fit(shape.T - model.compliance.displace(model.shape_forces.T))

    @cached_property
    def _held(self) -> dict[str, tuple[np.ndarray, np.ndarray, np.ndarray]]:
        return {}

    def _held_by(self, stage: PreparedStage) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Numbers of the rows A that a stage holds, or knows of resting parts, and that are not redundant, ``A H``, and
        the inverse of ``A G``."""
        name, compliance = stage.plan.name, self.model.compliance
        if name not in self._held:
            own = np.setdiff1d(np.arange(stage.bilateral.shape[0]), stage.response.redundant)
            A = stage.bilateral[own]
            self._held[name] = own, compliance.displace(A.toarray()), np.linalg.pinv(compliance.rigid(A))
        return self._held[name]

    @one_thread
    def _equilibrium(self, last: PreparedStage, resolutions: LazyResolutions, deviations):
        """Forces (n, F) on the functionals and rigid motions (n, 6P) at the end of a stage, the shape deviation
        included.

        The motions put the bilateral rows A at their values v: least squares over ``A G q = v − A H f``. Redundant rows
        take no part: their values have no effect, and may contradict the others.
        """
        model, n, state = self.model, len(deviations), resolutions.history.state
        reaction, value = (one.take(last.plan.bilateral) for one in (state.reaction, state.value))
        push = np.zeros((n, model.rows["clamp"].shape[0]))
        for i, force in state.push.items():
            push[:, i] = force
        for limit in last.plan.steps[-1].stops:
            push[:, limit.row[1]] = limit.force - state.stop[limit.row]
        force = reaction @ last.bilateral[: reaction.shape[1]] + push @ model.rows["clamp"]
        force = force + state.force.reshape(n, -1) @ model.rows["contact"]
        own, AH, inverse = self._held_by(last)
        soft = yielding(model.scene, last.plan.bilateral)
        if soft is not None:
            value -= soft * reaction  # what the rows read
        value = np.column_stack([value, state.reading["rest"][:, last.steps[-1].rest.row]])
        motion = product(value[:, own] - product(force, AH.T), inverse.T)
        return (
            force + product(deviations, model.shape_forces.T),
            motion + product(deviations, self._unit_motions),
        )
