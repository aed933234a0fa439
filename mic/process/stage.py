"""One prepared stage: bilateral rows of its steps eliminated, contact solvers ready; it advances the state.

In each step of a stage, with S, T and L of :class:`mic.compliance.elimination.Response`, prescribed values v and
loads p,

    δ = S f + T v + L p,        b_n = g + (T v + L p)_n,        b_t = (T v + L p)_t,

S has the through-thickness compliance of candidates (`mic.model.assembly.Contacts.layer`) added on its diagonal. The
contact law relates f to ``u = S f + b``, with slip measured from the contacts' anchors (`mic.contact.path`). b grows
linearly with v and p from the step's start to its end. While overlaps are resolved, v and p are constant, and each
overlap closes from touching: ``b_n(s) = b_n + (1 − s) max(0, −u_n)``, u_n under the forces of the contacts that touch
already.

Parts that rest by contact alone are held by rows of :mod:`mic.model.rest_rows`, which follow the bilateral ones; their
values are such that they carry no force (:mod:`mic.process.resting_parts`).

A row that is pushed towards its position by a limited force (:class:`mic.process.plan.Limit`) is a load against a
stop: one more frictionless contact, whose gap is the remaining distance. If the part lies beyond the position when the
push begins, the stop moves it back from there.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property, partial
from typing import Any

import numpy as np
from scipy.sparse import csr_matrix, vstack

from mic.compliance.elimination import Response, eliminate
from mic.contact import ContactSolver
from mic.contact.compliance_columns import Columns
from mic.contact.path import Followed, Increments, Path, PathSolution
from mic.contact.states import classify
from mic.contact.working_set import WorkingSetSolver
from mic.errors import FreeMotion
from mic.model.rest_rows import separating_motion
from mic.process.drive import Drive
from mic.process.evaluation import Resolution
from mic.process.force_limits import Stops
from mic.process.free_motions import free_motion_error
from mic.process.plan import Limit, StagePlan, Step, row_compliance
from mic.process.ramp import Ramp, RampColumns, row_names
from mic.process.resting_parts import Rest, Segment
from mic.process.state import ProcessState, Values, columns
from mic.system.matrix_product import product, product_of

__all__ = ["LEAST_MOTION", "OUTPUTS", "EliminatedStep", "PreparedStage", "eliminate_steps", "path_of", "stops_of"]

#: computes the contacts' path of a step, see :meth:`PreparedStage.step`
PathSolver = Callable[..., tuple[PathSolution, np.ndarray, np.ndarray]]
#: Thicknesses of the thinnest part: the error of a path's step is relative to at least this motion of the contacts.
#: With the default tolerance and 1 mm, forty steps with equal errors add up to the 2 µm that a coordinate measuring
#: machine resolves; thinner sheets answer a motion by smaller forces and stresses.
LEAST_MOTION = 0.2
CACHED_COLUMNS = 8  # RampColumns cached for each step, on average
ROUNDING = 1e-9  # mm: remaining distances below this count as zero
#: kinds of rows that are read at the end of a stage
OUTPUTS = ("locator", "clamp", "weld", "measurement", "between", "position")
#: dense maps of a response, by which values, loads and contact forces are multiplied
MAPS = ("T", "L", "T_out", "L_out", "reaction_T", "reaction_L", "reaction_S")
LOADS = ("L", "L_out", "reaction_L")  #: maps of loads


@dataclass(frozen=True, eq=False)
class EliminatedStep:
    """A step with its bilateral rows eliminated, for all contact laws; equal only to itself.

    Attributes
    ----------
    step : Step
    bilateral : (b + k, F) csr_matrix
        Rows held, then those that read the positions of resting parts.
    response : Response
        Contact rows: those of the contacts, then of the step's stops. Output rows: those of all :data:`OUTPUTS`, in
        this order, then the rest rows. Loads: the step's. Steps that hold the same rows share everything but the loads.
    rest : Rest
        The k rest rows.
    position_maps : dict of str to array
        ``L``, ``L_out`` and ``reaction_L`` for loads on the position rows.
    """

    step: Step
    bilateral: csr_matrix
    response: Response
    rest: Rest
    position_maps: Mapping[str, np.ndarray]

    @property
    def compliance(self) -> tuple[Columns, np.ndarray]:
        """(d m + s, d m + s) compliance of contacts and stops, and its diagonal; resting parts lie on springs."""
        response = self.response
        return self.rest.compliance(response) if self.rest.soft.any() else (response.S, response.diagonal)


@dataclass
class BatchStep:
    """A batch of assemblies, or of their derivatives, in one step.

    Attributes
    ----------
    eliminated : EliminatedStep
    state : ProcessState
        Before the step.
    drive : Drive
    ramp : Ramp
        From the readings and forces before the step to those that it prescribes.
    place : (n, k) array
        Positions of the resting parts, before the step and then at its end.
    force, left : (n, m, d) array
        As :class:`mic.process.state.ProcessState` has them, before the step and then at its end.
    anchor : (n, m, d - 1) array
        Likewise.
    stop : (n, s) array
        Forces of the stops, likewise; zero for new stops.
    """

    eliminated: EliminatedStep
    state: ProcessState
    drive: Drive
    ramp: Ramp
    place: np.ndarray
    force: np.ndarray
    left: np.ndarray
    anchor: np.ndarray
    stop: np.ndarray


def eliminate_steps(model, plans: Sequence[StagePlan]) -> dict[str, list[EliminatedStep]]:
    """Eliminate the bilateral rows of every step of a reduced model, for all contact laws.

    Parameters
    ----------
    model : mic.model.reduction.Reduction
    plans : sequence of StagePlan

    Returns
    -------
    dict of str to list of EliminatedStep
        By the stage's name.

    Raises
    ------
    SceneError
        If a step leaves a part free to move.
    """
    every = vstack(list(model.rows.values()), format="csr")
    first = dict(zip(model.rows, np.cumsum([0, *(rows.shape[0] for rows in model.rows.values())])))

    def rows_of(rows):
        return every[np.array([first[kind] + i for kind, i in rows], dtype=int)]

    output = vstack([*(model.rows[kind] for kind in OUTPUTS), model.rest.rows], format="csr")
    layer = np.zeros(model.rows["contact"].shape[0])
    layer[:: model.contacts.dimension] = model.contacts.layer
    positions = [("position", i) for i in range(model.rows["position"].shape[0])]
    steps = [(plan, step) for plan in plans for step in plan.steps]
    loads: dict[tuple, dict] = {}  # load rows of all steps that hold and stop the same rows
    for _, step in steps:
        loads.setdefault((step.bilateral, step.stops), {}).update(dict.fromkeys((*positions, *step.load_rows)))
    shared: dict[tuple, tuple[csr_matrix, Response, np.ndarray]] = {}
    multiply = product_of(len(model.contacts))
    eliminated: dict[str, list[EliminatedStep]] = {plan.name: [] for plan in plans}
    for plan, step in steps:
        held = step.bilateral, step.stops
        if held not in shared:
            bilateral, soft = rows_of(step.bilateral), row_compliance(model.scene, step.bilateral)
            # The gap of a stop closes as its row moves in the direction of the push.
            stops = (-stop.sign * rows_of([stop.row]) for stop in step.stops)
            contact = vstack([model.rows["contact"], *stops], format="csr")
            series, chosen = np.pad(layer, (0, len(step.stops))), np.zeros(0, dtype=int)
            try:
                if step.resting:
                    chosen = model.rest.completing_rows(bilateral, model.compliance)
                    bilateral = vstack([bilateral, model.rest.rows[chosen]], format="csr")
                    soft = None if soft is None else np.pad(soft, (0, len(chosen)))
                pushed = rows_of(loads[held])
                response = eliminate(model.compliance, bilateral, contact, pushed, output, soft, series, multiply)
            except FreeMotion as error:
                share = [np.linalg.norm(error.motions[own]) for own in model.compliance.motions]
                raise free_motion_error(model.scene, plan, step, error, int(np.argmax(share))) from error
            # Samples are multiplied by the transposes, which then have contiguous rows.
            maps: dict[str, Any] = {name: np.asfortranarray(getattr(response, name)) for name in MAPS}
            shared[held] = bilateral, replace(response, **maps), chosen
        bilateral, response, chosen = shared[held]
        own = [list(loads[held]).index(row) for row in step.load_rows]
        position_maps = {name: getattr(response, name)[:, : len(positions)] for name in LOADS}
        response = replace(response, **{name: getattr(response, name)[:, own] for name in LOADS})
        parts = model.rest.part[chosen]
        names = tuple(model.scene.parts[p].name for p in parts)
        rest = Rest(chosen, ~np.isin(parts, step.parked), model.rest.direction[chosen], names)
        eliminated[plan.name].append(EliminatedStep(step, bilateral, response, rest, position_maps))
    return eliminated


def stops_of(contacts, step: Step) -> Stops:
    """The stops of a step among the contacts."""
    return Stops(len(contacts), len(step.stops), contacts.dimension)


class PreparedStage:
    """A stage ready to advance assemblies, under one contact law.

    Parameters
    ----------
    plan : StagePlan
    steps : list of EliminatedStep
        One for each step of the plan.
    model : mic.model.reduction.Reduction
    solver : function of a step
        Returns the :class:`mic.contact.ContactSolver`, or :class:`mic.contact.working_set.WorkingSetSolver`, of an
        :class:`EliminatedStep` that solves contact.
    path : mic.contact.path.Path
        How its steps are followed.

    Attributes
    ----------
    inspect : function or None
        Called with each step that solves contact, the state before it, and its solution.
    output : dict of str to slice
        Output rows of a response, by kind.
    """

    def __init__(
        self,
        plan: StagePlan,
        steps: list[EliminatedStep],
        model,
        solver: Callable[[EliminatedStep], ContactSolver | WorkingSetSolver],
        path: Path,
    ):
        self.plan, self.steps, self.path = plan, steps, path
        self.inspect: Callable[[EliminatedStep, ProcessState, PathSolution], None] | None = None
        self._make_solver, self._solvers = solver, dict[EliminatedStep, ContactSolver | WorkingSetSolver]()
        self._ramp_column_cache: dict[tuple, RampColumns] = {}
        self._contacts, self._between, self._joints = model.contacts, model.between, model.joints
        self._dimension = model.contacts.dimension
        count = [*(model.rows[kind].shape[0] for kind in OUTPUTS), len(model.rest)]
        edges = np.concatenate([[0], np.cumsum(count)])
        self.output = {kind: slice(a, b) for kind, a, b in zip((*OUTPUTS, "rest"), edges, edges[1:])}

    def solver(self, eliminated: EliminatedStep) -> ContactSolver | WorkingSetSolver:
        """The contact solver of a step; made once."""
        if eliminated not in self._solvers:
            self._solvers[eliminated] = self._make_solver(eliminated)
        return self._solvers[eliminated]

    def stops(self, eliminated: EliminatedStep) -> Stops:
        return stops_of(self._contacts, eliminated.step)

    def solves_contact(self, eliminated: EliminatedStep) -> bool:
        """Whether a step has contacts or stops to solve for."""
        return eliminated.step.resolves and self.stops(eliminated).total > 0

    @cached_property
    def resolves(self) -> bool:
        """Whether contact is solved, between parts or with a stop."""
        return any(self.solves_contact(each) for each in self.required_steps)

    def advance(
        self, state: ProcessState, drive: Drive, resolve: PathSolver | None = None
    ) -> tuple[ProcessState, Resolution | None]:
        """Take n assemblies through the stage.

        Parameters
        ----------
        state : ProcessState
        drive : Drive
        resolve : function, optional
            As in :meth:`step`.

        Returns
        -------
        state : ProcessState
            At its end.
        resolution : Resolution or None
            None if no contact is solved.
        """
        start, solutions, ends = state, [], {}
        for eliminated in self.required_steps:
            state, solution = self.step(eliminated, state, drive, resolve)
            solutions += [] if solution is None else [solution]
            ends[eliminated.step] = state
        if not self.resolves:
            return state, None
        last = next(each for each in reversed(self.steps) if self.solves_contact(each))
        bound = self._bound(last, state.force)
        loose: dict[int, str] = {}
        contacts = classify(state.force, bound)
        if self.plan.kind != "locate" and last.rest.soft.any():
            held_back = self.stop_forces(last.step, state)
            loose = last.rest.loose(last.response, state.force, contacts, bound, held_back)
        loose = {sample: message for sample, message in loose.items() if not state.failed[sample]}
        state.failed[list(loose)] = True
        pushed = [self._pushed(limit, ends[self.plan.steps[i]], drive) for i, limit in self.plan.checked_limits]
        resolution = self._resolution(start, state, solutions, drive, contacts, pushed)
        resolution.converged[list(loose)] = False
        for sample, message in loose.items():
            resolution.status[sample] = message
        trace = resolution.trace
        return replace(state, path_error=trace.error, force_error=trace.force_error), resolution

    def _bound(self, eliminated: EliminatedStep, force: np.ndarray) -> np.ndarray:
        """(n, m) largest tangential forces under the contact forces (n, m, d)."""
        normal = _side_by_side(force[..., 0], np.zeros((len(force), self.stops(eliminated).count)))
        return self.solver(eliminated).bound(normal)[:, : force.shape[1]]

    @cached_property
    def required_steps(self) -> list[EliminatedStep]:
        """The steps that affect the result: all; without friction those of :attr:`StagePlan.memory_steps`."""
        steps = self.steps
        with_contact = [each for each in steps if self.solves_contact(each)]
        if not with_contact or any(self.solver(each).law.frictional for each in with_contact):
            return steps
        return [steps[i] for i in self.plan.memory_steps]

    def _pushed(self, limit: Limit, state: ProcessState, drive: Drive) -> tuple[np.ndarray, np.ndarray]:
        """Force (n,) of a limited push, N, and remaining distance (n,) to its position, mm."""
        if limit.row in state.reaction:  # the plan has no limits
            return limit.sign * state.reaction[limit.row], np.zeros(len(drive))
        kind, row = limit.row
        stop = state.stop[limit.row]
        left = limit.sign * (self._position(limit, drive) - state.reading[kind][:, row])
        # A gun always presses with its full force; the sheets around its weld, or its stop, carry the rest.
        return limit.force - stop * (kind == "clamp"), np.where(left > ROUNDING, left, 0.0)

    def _position(self, limit: Limit, drive: Drive) -> np.ndarray:
        """(n,) target of a limited push: a clamp's target, or the closed gap of a gun's weld."""
        kind, row = limit.row
        if kind == "clamp":
            return drive.target["clamp"][:, row]
        return -drive.weld_gap[:, row]

    def begin(self, eliminated: EliminatedStep, state: ProcessState, drive: Drive) -> BatchStep:
        """The batch at the start of a step."""
        step = eliminated.step
        ramp = self._columns_for(step, state, drive).ramp(state, drive)
        place = (drive.target if step.sets_down else state.reading)["rest"][:, eliminated.rest.row]
        stop = self.stop_forces(step, state)
        return BatchStep(eliminated, state, drive, ramp, place, state.force, state.left, state.anchor, stop)

    def step(
        self, eliminated: EliminatedStep, state: ProcessState, drive: Drive, resolve: PathSolver | None = None
    ) -> tuple[ProcessState, PathSolution | None]:
        """The state after a step, and the path of its contacts; None if contact is not solved.

        Parameters
        ----------
        eliminated, state, drive
            The step, the state before it, and its drive.
        resolve : function, optional
            Maps the :class:`BatchStep` to the contacts' path, the forces (n, s) of the stops, and the final positions
            (n, k) of resting parts; default: the contact solver.
        """
        batch = self.begin(eliminated, state, drive)
        if not self.solves_contact(eliminated):
            return self.after(batch), None
        solution, batch.stop, batch.place = (resolve or self._resolve)(batch)
        batch.force = solution.force.reshape(state.force.shape)
        batch.left = solution.displacement.reshape(state.force.shape).copy()
        batch.left[:, :, 0] -= drive.gap
        batch.anchor = solution.anchor
        if self.inspect is not None:
            self.inspect(eliminated, state, solution)
        return self.after(batch, solution.converged), solution

    def after(self, batch: BatchStep, converged: np.ndarray | None = None) -> ProcessState:
        """The state after a step; linear in everything, except for `failed`.

        Parameters
        ----------
        batch : BatchStep
            At the end of the step.
        converged : (n,) bool array, optional
            None if no contact was solved.
        """
        state, drive, left, anchor = batch.state, batch.drive, batch.left, batch.anchor
        step, response = batch.eliminated.step, batch.eliminated.response
        columns_before = self._columns_for(step, state, drive)
        v, p = batch.ramp.at(1.0)
        v = _side_by_side(v, batch.place)
        if converged is None and step.sets_down and len(self._contacts):  # placed one by one, without contact
            left = (product(v, response.T.T) + product(p, response.L.T)).reshape(left.shape)
            anchor = left[:, :, 1:]
        force = _side_by_side(batch.force.reshape(len(left), -1), batch.stop)
        reading, reaction = self._outcome(response, v, p, force)
        return ProcessState(
            reading=reading,
            force=batch.force,
            left=left,
            anchor=anchor,
            failed=state.failed if converged is None else state.failed | ~converged,
            path_error=state.path_error,
            force_error=state.force_error,
            value=Values(columns_before.rows, v),
            reaction=Values(columns_before.rows, reaction),
            push=Values(columns_before.loads, drive.push[:, step.loads]),
            stop=Values(columns_before.stops, batch.stop),
            frozen=columns_before.weld_values(state, drive),
        )

    def _columns_for(self, step: Step, state: ProcessState, drive: Drive) -> RampColumns:
        """Columns for a step after a state with these rows; cached for the stage's own steps."""
        key = (id(step), *row_names(state))
        found = self._ramp_column_cache.get(key)
        if found is None or found.step is not step:
            if len(self._ramp_column_cache) >= CACHED_COLUMNS * len(self.steps):
                self._ramp_column_cache.clear()
            found = self._ramp_column_cache[key] = RampColumns.of(step, state, drive, self._joints)
        return found

    def stop_forces(self, step: Step, state: ProcessState) -> np.ndarray:
        """(n, s) forces of a step's stops before it; zero for new stops."""
        none = np.zeros(len(state.failed))
        rows = [stop.row for stop in step.stops]
        return columns(len(none), [state.stop[row] if row in state.stop else none for row in rows])

    def unloaded(self, batch: BatchStep, s: float) -> np.ndarray:
        """(n, d m + s) b of contacts and stops, at s of the ramp; linear."""
        response, contacts = batch.eliminated.response, len(self._contacts) * self._dimension
        v, p = batch.ramp.at(s)
        b = product(_side_by_side(v, batch.place), response.T.T) + product(p, response.L.T)
        b[:, : contacts : self._dimension] += batch.drive.gap
        for j, limit in enumerate(batch.eliminated.step.stops):
            b[:, contacts + j] += limit.sign * self._position(limit, batch.drive)
        return b

    def overlap(self, batch: BatchStep, start: np.ndarray) -> np.ndarray:
        """(n, d m + s) overlap at a step's start of the contacts that close during it, negative if open; others 0.

        It is linear in its arguments; `start` is b there.
        """
        step, state, contacts = batch.eliminated.step, batch.state, len(self._contacts) * self._dimension
        found = np.zeros_like(start)
        if step.settles:
            touching = np.zeros_like(start)
            touching[:, :contacts] = state.force.reshape(len(start), -1)
            normal = slice(0, contacts, self._dimension)
            found[:, normal] = -(start + batch.eliminated.response.S.under(touching))[:, normal]
        for j, limit in enumerate(step.stops):
            if limit.row not in state.stop:  # starts from the part, which may lie beyond the position
                kind, row = limit.row
                found[:, contacts + j] = limit.sign * (state.reading[kind][:, row] - self._position(limit, batch.drive))
        return found

    def _resolve(self, batch: BatchStep) -> tuple[PathSolution, np.ndarray, np.ndarray]:
        """Follow the ramp, or closing overlaps, with the contact solver.

        Returns the contacts' path, the forces (n, s) of the stops, and the positions (n, k) of the resting parts.
        """
        eliminated, n, contacts = batch.eliminated, len(batch.drive), batch.left[0].size
        response, rest = eliminated.response, eliminated.rest
        force = _side_by_side(batch.force.reshape(n, -1), batch.stop)
        if eliminated.step.settles and rest.soft.any():
            batch.place, batch.anchor = self.separating_motion(batch, self.unloaded(batch, 0.0))
        start, end = self.unloaded(batch, 0.0), self.unloaded(batch, 1.0)
        lift = np.maximum(0.0, self.overlap(batch, start))
        follow = partial(self.follow, eliminated)

        if not rest.soft.any():
            solution, force = follow(start + lift, end, force, batch.anchor, self.path)
            return solution, force[:, contacts:], batch.place

        def segment(s0, s1) -> Segment:
            """The part of the step from s0 to s1: b, and the loads on the rest rows."""
            left = [rest.pushed(response, batch.ramp.at(s)[1]) for s in (s0, s1)]
            return Segment(*(self.unloaded(batch, s) + (1 - s) * lift for s in (s0, s1)), *left)

        segments, s0 = rest.segments(self.path, self.solver(eliminated).law), 0.0
        anchor, pieces, begin, at = batch.anchor, [], batch.place[:, rest.soft], batch.place[:, rest.soft]
        for s1, path in segments:
            solution, force, at = rest.settle(response, segment(s0, s1), begin, at, force, anchor, follow, path)
            anchor, trace = solution.anchor, solution.trace.weighted((s1 - s0) * len(segments))
            if isinstance(self.path, Followed) and isinstance(path, Increments):  # short: part of the followed path
                solution = replace(solution, rung=np.where(solution.rung == "increments", "followed", solution.rung))
                trace = replace(trace, error=np.zeros(n), force_error=np.zeros(n))
            pieces.append(replace(solution, trace=trace))
            s0 = s1
        place = batch.place.copy()
        place[:, rest.soft] = at
        return PathSolution.join(pieces), force[:, contacts:], place

    def follow(self, eliminated, b0, b1, force, anchor, path) -> tuple[PathSolution, np.ndarray]:
        """Follow a path on which b of contacts and stops (n, d m + s) goes straight from b0 to b1.

        `force` (n, d m + s) are the forces at its start, `anchor` (n, m, d - 1) the contacts' anchors. Returns the
        contacts' path, and the forces at its end.
        """
        stops = self.stops(eliminated)
        way = np.stack([stops.pad(b0), stops.pad(b1)], axis=1)
        zeros = np.zeros((len(b0), stops.count, self._dimension - 1))
        padded = self.solver(eliminated).follow(way, stops.pad(force), np.concatenate([anchor, zeros], axis=1), path)
        solution, stop_forces = stops.split(padded)
        return solution, _side_by_side(solution.force, stop_forces)

    def contact_motions(self, eliminated: EliminatedStep) -> np.ndarray:
        """(m, d, k) motions of the contacts with the resting parts; 0 for contacts that take no part."""
        m, d = len(self._contacts), self._dimension
        G = eliminated.rest.springs(eliminated.response)[1][: m * d].reshape(m, d, -1)
        excluded = self._contacts.excluded(eliminated.step.nuggets, eliminated.step.away)
        return np.where(excluded[:, None, None], 0.0, G)

    def separating_motion(self, batch: BatchStep, unloaded: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Positions (n, k) at which unloaded resting parts overlap nowhere, and anchors that move with them."""
        soft, (_, m, d) = batch.eliminated.rest.soft, batch.force.shape
        G = self.contact_motions(batch.eliminated)
        touched = np.abs(G[:, 0]).max(axis=1, initial=0.0) > 0
        place, anchor = batch.place.copy(), batch.anchor.copy()
        for sample in np.flatnonzero(~batch.force[:, touched].any(axis=(1, 2))):
            moved = separating_motion(unloaded[sample, : m * d : d], G[:, 0])
            place[sample, soft] += moved
            anchor[sample] += G[:, 1:] @ moved
        return place, anchor

    def _resolution(self, start, end, solutions, drive, contacts, pushed) -> Resolution:
        whole, n = PathSolution.join(solutions), len(end.force)
        displacement = whole.displacement.reshape(end.force.shape).copy()
        displacement[:, :, 1:] = (end.left - start.left)[:, :, 1:]
        unseen, at = self._unseen(end, drive)
        return Resolution(
            stage=self.plan.name,
            force=end.force.copy(),
            displacement=displacement,
            state=contacts,
            # Sticking contacts inherit the error of the paths before; sliding ones lose it.
            trace=replace(
                whole.trace,
                error=start.path_error + whole.trace.error,
                force_error=start.force_error + whole.trace.force_error,
            ),
            **{name: getattr(whole, name) for name in ("residual", "converged", "iterations", "status", "rung")},
            reaction=end.reaction.take(self.plan.bilateral),
            unseen=unseen,
            unseen_at=at,
            pushed=columns(n, [force for force, _ in pushed]),
            left=columns(n, [way for _, way in pushed]),
            needed=np.full((n, len(pushed)), np.nan),
        )

    def _unseen(self, end, drive) -> tuple[np.ndarray, np.ndarray]:
        """Deepest penetration (n,) between the pairs, and the number (n,) of its point; not within welds."""
        depth = np.where(self._points_without_contact, 0.0, -(drive.between + end.reading["between"]))
        depth = np.concatenate([np.zeros((len(depth), 1)), depth], axis=1)
        at = depth.argmax(axis=1)
        return depth[np.arange(len(depth)), at], at - 1

    @cached_property
    def _points_without_contact(self) -> np.ndarray:
        """Whether each point between the pairs lies within a weld or in an inactive zone at the end."""
        last = self.steps[-1].step
        return np.isin(self._between.nugget, last.welds) | np.isin(self._between.zone, last.away)

    def _outcome(self, response, v, p, force):
        """Readings of the output rows, by kind, and reactions (n, b) of the bilateral rows.

        `force` (n, d m + s) are those of contacts and stops.
        """
        multiply = product_of(len(self._contacts))
        reading = multiply(v, response.T_out.T) + multiply(p, response.L_out.T) + response.S_out.under(force)
        reaction = multiply(v, response.reaction_T.T) + multiply(p, response.reaction_L.T)
        reaction += multiply(force, response.reaction_S.T)
        return {kind: reading[:, own] for kind, own in self.output.items()}, reaction


def _side_by_side(first: np.ndarray, second: np.ndarray) -> np.ndarray:
    """(n, j + k) two arrays side by side; the second is often empty."""
    return np.concatenate([first, second], axis=1) if second.shape[1] else first


def path_of(plan: StagePlan, law, tolerance: float, thinnest: float) -> Path:
    """Settings by which the steps of a stage are followed under a law, for this smallest thickness."""
    if plan.path == "followed" and law.followed:
        return Followed(tolerance, LEAST_MOTION * thinnest)
    return Increments(plan.increments)
