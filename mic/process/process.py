"""The process: the stages in order, through which the assembly's state is passed."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import replace
from functools import cached_property, partial
from typing import Any

import numpy as np

from mic.contact import ContactSolver, laws
from mic.contact.compliance_columns import Columns
from mic.contact.friction import Friction
from mic.contact.path import Increments, Path, PathSolution, Trace
from mic.contact.path_forecast import PathForecast
from mic.contact.working_set import WorkingSetSolver
from mic.errors import ImpossibleSample, SceneError
from mic.model.sources import sources
from mic.process.drive import Drive, DriveTerms, drive
from mic.process.evaluation import Evaluation, LazyResolutions, ProcessHistory, Resolution
from mic.process.frames import ResultNames
from mic.process.free_motions import check_resting
from mic.process.linear_maps import Linear
from mic.process.plan import StagePlan, Step, plan_stages, row_compliance
from mic.process.stage import OUTPUTS, EliminatedStep, PreparedStage, eliminate_steps, path_of, stops_of
from mic.process.state import ProcessState
from mic.system.matrix_product import one_thread, product_of

__all__ = ["TOLERANCE", "Process", "contact_solver"]

PAPER_TOLERANCE = 1e-5  #: residual that the paper's solvers reach
TOLERANCE = 1e-10  #: default tolerance of the contact certificate
TRIAL_SAMPLES = 16  # samples that predict which candidates carry force
CLUSTER_SPACING = 2.0  # spacings between two candidates that join a working set together
CACHED_PROCESSES = 8  # processes kept in memory for deviations that change the contacts


def contact_solver(
    contacts,
    S: Columns,
    diagonal: np.ndarray,
    friction: Friction,
    step: Step,
    forecast: PathForecast | None = None,
    screening: bool = False,
    **settings,
):
    """The solver of a step's contacts.

    A :class:`mic.contact.working_set.WorkingSetSolver` if any contact is a candidate or takes no part, otherwise a
    :class:`mic.contact.ContactSolver`.

    Parameters
    ----------
    contacts : mic.model.assembly.Contacts
    S : (d m + s, d m + s) Columns
        Compliance at the contacts and at the step's stops, mm/N.
    diagonal : (d m + s,) array
        Its diagonal.
    friction : Friction
        Of the contacts.
    step : Step
    forecast : PathForecast, optional
        Results of this step for a few samples; default: none.
    screening : bool
        As in :class:`mic.contact.working_set.WorkingSetSolver`.
    **settings
        Law and others, as in :class:`mic.contact.ContactSolver`.
    """
    settings["semidefinite"] = True  # elimination of bilateral rows leaves a semidefinite compliance
    settings["certify_each"] = False  # no result of a stage distinguishes contacts of negligible force
    stops = stops_of(contacts, step)
    S, friction = stops.compliance(S, diagonal), stops.friction(friction)
    excluded = contacts.excluded(step.nuggets, step.away)
    if not (contacts.watched.any() or excluded.any()):
        return ContactSolver(S.block(np.arange(len(S))), friction, **settings)
    always = np.ones(stops.count, dtype=bool)
    forecast = forecast or PathForecast.empty(len(contacts) + stops.count, contacts.dimension)
    return WorkingSetSolver(
        S,
        friction,
        np.concatenate([contacts.point, np.zeros((stops.count, 3))]),
        np.concatenate([CLUSTER_SPACING * np.sqrt(contacts.area), np.zeros(stops.count)]),
        np.concatenate([~contacts.watched, always]) | forecast.touching,
        np.concatenate([~excluded, always]),
        screening=screening,
        forecast=forecast,
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
        Contact solver: the native one, or the paper's (OSQP for (12), ECOS for (13)).
    threads : int
        Threads of the native solver over the samples of a batch.
    path_tolerance : float, optional
        Tolerance of followed paths, see :class:`mic.contact.path.Followed`; default: the scene's.
    forecast : mapping, optional
        Results for a few samples, by stage and step; default: :attr:`mic.process.model.ReducedModel.forecast`.
    limited : bool
        Whether force limits apply; if not, clamps and guns hold the position that they push towards.
    plans : sequence of StagePlan, optional
        Of the model's scene, if contact is known to hold the resting parts; default: computed and checked.
    template : Process, optional
        Of the same plans under the same law, with contacts that differ only by their friction: everything that does not
        depend on friction is shared with it.

    Attributes
    ----------
    stages : list of PreparedStage
        All stages, in order.

    Raises
    ------
    SceneError
        If a stage leaves a part free to move, or contact cannot hold a resting part under the law.
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
        forecast: Mapping[tuple[str, Step], PathForecast] | None = None,
        limited: bool = True,
        plans: Sequence[StagePlan] | None = None,
        template: Process | None = None,
    ):
        self.model, self.law, self._template = model, law, template
        contacts = model.contacts
        # Without any friction all laws are equal, and the model may have no tangential rows.
        smooth = contacts.dimension == 1 and not contacts.frictional
        applied_law = laws.FRICTIONLESS if smooth else laws.find(law)
        solver_name = laws.find(law).paper_backend if backend == "paper" else "native"
        self._settings = {
            "law": applied_law,
            "backend": solver_name,
            "tol": tol if solver_name == "native" else max(tol, PAPER_TOLERANCE),
            "threads": threads,
            "dimension": contacts.dimension,
            "work": model.scene.monte_carlo.solver_work,
        }
        if plans is None:
            plans = model.plans if limited else plan_stages(model.scene, model.weld_size, limited)
            check_resting(model, plans, [applied_law.name])
        self._plans = plans
        self._eliminations = model.eliminations if limited else eliminate_steps(model, self._plans)
        frictional, slopes = applied_law.frictional, model.slopes
        # Deviations that change contacts or parts, with their values in the model.
        changing = {
            j: 0.0
            for j, source in enumerate(sources(model.scene))
            if source.changes == "compliance" or (source.changes and frictional)
        }
        if slopes is not None:
            changing |= dict(zip(slopes.source.tolist(), slopes.about.tolist()))
        self._changing = list(changing)
        self._changed_by, self._limited = np.array(list(changing.values())), limited
        self._process_cache: dict[tuple[bytes, tuple[Path, ...]], Process] = {}
        self._sample_compliance = False  # whether the compliance belongs to one sample
        self._solvers: dict[tuple, ContactSolver | WorkingSetSolver] = {}
        self._forecast, self._guessing = model.forecast if forecast is None else forecast, False
        self._path_tolerance = path_tolerance or model.scene.path.tolerance
        thinnest = min((part.thickness for part in model.scene.parts if part.thickness is not None), default=0.0)
        paths = [path_of(plan, applied_law, self._path_tolerance, thinnest) for plan in plans]
        self.stages = self._prepared(paths)

    def _prepared(self, paths: Sequence[Path]) -> list[PreparedStage]:
        model = self.model
        return [
            PreparedStage(plan, self._eliminations[plan.name], model, partial(self._solver, plan.name), path)
            for plan, path in zip(self._plans, paths)
        ]

    def _solver(self, stage: str, eliminated: EliminatedStep) -> ContactSolver | WorkingSetSolver:
        """The solver of a step; steps with the same rows and friction share it if there are no candidates."""
        contacts, step = self.model.contacts, eliminated.step
        friction = contacts.friction_in(stage)
        own = (stage, step) if contacts.watched.any() else None
        key = step.bilateral, step.parked, step.stops, step.away, friction.coefficient.tobytes(), own
        if key in self._solvers:
            return self._solvers[key]
        if self._template is not None:
            known = self._template._solver(stage, eliminated)
            self._solvers[key] = known.with_friction(stops_of(contacts, step).friction(friction))
        else:
            forecast = self._forecast.get((stage, step))
            self._solvers[key] = contact_solver(
                contacts, *eliminated.compliance, friction, step, forecast, self._guessing, **self._settings
            )
        return self._solvers[key]

    @classmethod
    def predict_working_sets(cls, model) -> dict[tuple[str, Step], PathForecast]:
        """Results of a few fixed samples for models with candidate contacts, by stage and step.

        They are computed under Coulomb's law if tangents are modelled, with one increment for each step and one working
        set for all samples. Every sample starts from them, whatever samples it is evaluated with.
        """
        if not model.contacts.watched.any():
            return {}
        trial = cls(model, "coulomb" if model.contacts.dimension == 3 else "frictionless", forecast={})
        mean, sigma = np.array([[one.mean, one.sigma] for one in model.scene.deviations]).reshape(-1, 2).T
        draws = np.random.default_rng(0).standard_normal((TRIAL_SAMPLES, len(mean)))
        draws[0] = 0.0
        if model.slopes is not None:  # shapes vary; all samples have the stiffness of the mean shape
            still = ~np.isin(trial._changing, model.slopes.source)
            trial._changing = np.array(trial._changing)[still].tolist()
            trial._changed_by = trial._changed_by[still]
        draws[:, trial._changing] = 0.0
        trial.stages, trial._guessing = trial._prepared([Increments(1)] * len(trial.stages)), True
        trial.attempt(mean + sigma * draws)
        return trial.seen

    @property
    def seen(self) -> dict[tuple[str, Step], PathForecast]:
        """Results of all samples so far, by stage and step."""
        return {key[-1]: one.observed for key, one in self._solvers.items() if isinstance(one, WorkingSetSolver)}

    @property
    def redundant(self) -> list[str]:
        """One sentence for each row of a stage that its other rows make redundant."""
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
            The stage at whose end forces and motions of the parts are evaluated; default: the last.
        """
        if not len(deviations):
            return self.evaluate(self.model.deviations({}), at).without_samples()
        if (deviations[:, self._changing] != self._changed_by).any():
            pieces = []
            for part, process in self.by_model(deviations):
                found = process.evaluate(deviations[part], at)
                if process._sample_compliance:  # a large process, which would be kept for its equilibrium
                    found = replace(found, equilibrium=partial(tuple[Any, Any], found._equilibrium))
                pieces.append(found)
            return Evaluation.join(pieces)
        number = [stage.plan.name for stage in self.stages].index(at) if at else len(self.stages) - 1
        amplitudes, solutions = deviations.copy(), None
        if self._linear is not None:
            solutions, readings, failed = self._linear.follow(self.stages, deviations)
        names = [stage.plan.name for stage in self.stages if stage.resolves]
        resolutions = LazyResolutions(names, partial(self._run, amplitudes, number, solutions))
        if solutions is None:
            readings, failed = resolutions.history.readings, resolutions.history.failed
        read = self.model.characteristics.values(readings) if readings.size else readings
        equilibrium = partial(self._equilibrium, self.stages[number], resolutions, amplitudes)
        found = Evaluation(self.law, deviations, resolutions, read, readings, failed, equilibrium, self._names)
        if solutions is None and not found.built.all():
            self._fill_needed_forces(found, np.flatnonzero(~found.built))
        return found

    @one_thread
    def _run(self, deviations: np.ndarray, number: int, solutions: Sequence[PathSolution] | None) -> ProcessHistory:
        """Take samples through all stages, with the contacts' paths if they are known."""
        loading, state = self.drive(deviations), self.start(len(deviations))
        resolutions, readings, resolve = {}, np.zeros((len(deviations), 0)), None
        if solutions is not None:
            paths, no_stops = iter(solutions), np.zeros((len(deviations), 0))
            resolve = lambda batch: (next(paths), no_stops, batch.place)
        for i, stage in enumerate(self.stages):
            state, resolution = stage.advance(state, loading, resolve)
            if resolution is not None:
                resolutions[stage.plan.name] = resolution
            if stage.plan.reads:
                readings = state.reading["measurement"] + loading.measured
            if i == number:
                end = state
        return ProcessHistory(resolutions, readings, state.failed, end)

    @cached_property
    def _linear(self) -> Linear | None:
        """The linear maps of the process; None if the compliance belongs to one sample, which is not worth it."""
        if self._guessing or self._sample_compliance:
            return None
        return Linear.of(self, len(self.model.scene.deviations))

    def drive(self, deviations: np.ndarray) -> Drive:
        """The drive for deviations (n, p), affine in them."""
        readings, slices = self._unit_shapes
        shapes = product_of(len(self.model.contacts))(deviations, readings)
        return drive(
            self.model, deviations, {kind: shapes[:, rows] for kind, rows in slices.items()}, self._drive_terms
        )

    def start(self, n: int) -> ProcessState:
        """The initial state of n assemblies."""
        model = self.model
        rows = {kind: model.rows[kind].shape[0] for kind in OUTPUTS} | {"rest": len(model.rest)}
        return ProcessState.start(n, len(model.contacts), model.contacts.dimension, rows)

    def by_model(self, deviations: np.ndarray) -> Iterator[tuple[slice, Process]]:
        """Slices of samples whose deviations change contacts and parts alike, each with its process.

        The process is this one if nothing changes.
        """
        own = deviations[:, self._changing]
        edges = [0, *(np.flatnonzero((own[1:] != own[:-1]).any(axis=1)) + 1).tolist(), len(own)]
        for a, b in zip(edges, edges[1:]):
            yield slice(a, b), self if (own[a:b] == self._changed_by).all() else self._process_for(own[a])

    def _process_for(self, amplitudes: np.ndarray) -> Process:
        """The process with the contacts and parts of these deviations; shapes are unchanged."""
        key = amplitudes.tobytes(), tuple(stage.path for stage in self.stages)
        if key not in self._process_cache:
            deviations = np.zeros(len(self.model.scene.deviations))
            deviations[self._changing] = amplitudes
            model = self.model.with_deviations(deviations)
            shared = ["forecast", "rest", "characteristics", "plans"]
            template = self if model.compliance is self.model.compliance else None
            if template is not None:
                shared.append("eliminations")
            vars(model).update({name: getattr(self.model, name) for name in shared})
            try:
                if (model.contacts.friction != self.model.contacts.friction).any():
                    check_resting(model, self._plans, [self._settings["law"].name])
                process = self._copy(
                    model, forecast=self._forecast, limited=self._limited, plans=self._plans, template=template
                )
            except SceneError as problem:
                raise ImpossibleSample(str(problem)) from problem
            process._changed_by, process._sample_compliance = amplitudes, template is None
            vars(process)["_unit_motions"] = self._unit_motions
            if template is not None:
                vars(process).update(
                    {name: getattr(self, name) for name in ("_motion_fits", "_unit_shapes", "_drive_terms", "_linear")}
                )
            # Other compliances are large: only one is cached.
            if len(self._process_cache) >= (1 if template is None else CACHED_PROCESSES):
                self._process_cache.clear()
            self._process_cache[key] = process
        return self._process_cache[key]

    def _fill_needed_forces(self, found: Evaluation, unreached: np.ndarray) -> None:
        """Fill ``needed`` with the forces of these samples without any limit; NaN if that evaluation fails."""
        without = self._unlimited.attempt(found.deviations[unreached])
        for stage, resolution in found.resolutions.items():
            known = ~resolution.reached[unreached] & ~without.failed[:, None]
            resolution.needed[unreached] = np.where(known, without.resolutions[stage].pushed, np.nan)

    @cached_property
    def _unlimited(self) -> Process:
        """The same process without force limits."""
        process = self._copy(self.model, forecast={}, limited=False)
        # The model has the changed contacts and parts already.
        process._changing, process._changed_by = self._changing, self._changed_by
        return process

    def _copy(self, model, **options: Any) -> Process:
        """A process of another model or with other options, under the same law, with the same solver and paths."""
        backend = "native" if self._settings["backend"] == "native" else "paper"
        tol, threads = self._settings["tol"], self._settings["threads"]
        found = Process(model, self.law, tol, backend, threads, self._path_tolerance, **options)
        for own, given in zip(found.stages, self.stages):
            own.path = given.path  # which a caller may have changed
        return found

    def attempt(self, deviations: np.ndarray, at: str | None = None) -> Evaluation:
        """As :meth:`evaluate`; after a numerical error sample by sample, so that only the faulty samples fail."""
        try:
            return self.evaluate(deviations, at)
        except (ArithmeticError, np.linalg.LinAlgError) as error:
            if len(deviations) == 1:
                return self.failed_evaluation(deviations, str(error))
            return Evaluation.join([self.attempt(row[None], at) for row in deviations])

    def failed_evaluation(self, deviations: np.ndarray, reason: str) -> Evaluation:
        """The evaluation of samples that could not be computed: all values NaN, with the reason as status."""
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
                trace=Trace(nan(m, 2), nan(m), nan(m), nan(m, 3), nan(), nan(), *np.zeros((2, n), int)),
                residual=nan(),
                converged=np.zeros(n, bool),
                iterations=np.zeros(n, int),
                status=np.full(n, reason, dtype=object),
                rung=np.full(n, "none", dtype=object),
                reaction=nan(len(stage.plan.bilateral)),
                unseen=nan(),
                unseen_at=np.full(n, -1),
                pushed=nan(len(stage.plan.checked_limits)),
                left=nan(len(stage.plan.checked_limits)),
                needed=nan(len(stage.plan.checked_limits)),
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
            names=self._names,
        )

    @cached_property
    def _names(self) -> ResultNames:
        return ResultNames.of(self.model, self.law)

    @cached_property
    def _unit_shapes(self) -> tuple[np.ndarray, dict[str, slice]]:
        """Readings by all rows of the shape of each unit deviation (p, R), and the slice of each kind of rows."""
        rows = {**self.model.rows, "rest": self.model.rest.rows}
        edges = np.cumsum([0, *(own.shape[0] for own in rows.values())])
        every = np.concatenate([own @ self.model.shape for own in rows.values()])
        return np.ascontiguousarray(every.T), {kind: slice(a, b) for kind, a, b in zip(rows, edges, edges[1:])}

    @cached_property
    def _drive_terms(self) -> DriveTerms:
        return DriveTerms.of(self.model)

    @cached_property
    def _unit_motions(self) -> np.ndarray:
        """(p, 6P) rigid motions of the unit shapes, beyond the elastic readings of the forces that make them."""
        model = self.model
        # A thickness moves the faces, not the middle surface.
        moved = [not source.thickening() for source in sources(model.scene)]
        shape = model.shape * np.array(moved, dtype=float)
        return model.compliance.fit(shape.T - model.compliance.displace(model.shape_forces.T))

    @cached_property
    def _motion_fits(self) -> dict[str, tuple[np.ndarray, np.ndarray, np.ndarray]]:
        return {}

    def _motion_fit(self, stage: PreparedStage) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Non-redundant rows A that a stage holds or reads of resting parts: numbers, ``A H``, inverse of ``A G``."""
        name, compliance = stage.plan.name, self.model.compliance
        if name not in self._motion_fits:
            last = stage.steps[-1]
            own = np.setdiff1d(np.arange(last.bilateral.shape[0]), last.response.redundant)
            A = last.bilateral[own]
            self._motion_fits[name] = own, compliance.displace(A.toarray()), np.linalg.pinv(compliance.rigid(A))
        return self._motion_fits[name]

    @one_thread
    def _equilibrium(self, last: PreparedStage, resolutions: LazyResolutions, deviations):
        """Forces (n, F) on the functionals and rigid motions (n, 6P) at the end of a stage, shape deviation included.

        The motions put the bilateral rows A at their values v: least squares over ``A G q = v − A H f``. Redundant rows
        are left out: their values have no effect, and may contradict the others.
        """
        model, n, state = self.model, len(deviations), resolutions.history.state
        reaction, value = (one.take(last.plan.bilateral) for one in (state.reaction, state.value))
        push = np.zeros((n, model.rows["clamp"].shape[0]))
        for i in state.push.names.column:
            push[:, i] = state.push[i]
        for limit in last.plan.steps[-1].stops:
            push[:, limit.row[1]] = limit.force - state.stop[limit.row]
        force = reaction @ last.steps[-1].bilateral[: reaction.shape[1]] + push @ model.rows["clamp"]
        force = force + state.force.reshape(n, -1) @ model.rows["contact"]
        own, AH, inverse = self._motion_fit(last)
        soft = row_compliance(model.scene, last.plan.bilateral)
        if soft is not None:
            value -= soft * reaction  # what the rows read
        value = np.column_stack([value, state.reading["rest"][:, last.steps[-1].rest.row]])
        multiply = product_of(len(model.contacts))
        motion = multiply(value[:, own] - multiply(force, AH.T), inverse.T)
        return (
            force + multiply(deviations, model.shape_forces.T),
            motion + multiply(deviations, self._unit_motions),
        )
