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
from mic.process.ramp import Ramp
from mic.process.ramp_columns import RampColumns, row_names
from mic.process.resting_parts import Rest, Segment
from mic.process.row_values import Values, columns
from mic.process.state import ProcessState
from mic.system.matrix_product import product

__all__ = ["LEAST_MOTION", "OUTPUTS", "EliminatedStep", "PreparedStage", "eliminate_steps", "path_of", "stops_of"]

#: computes the contacts' path of a step, see :meth:`PreparedStage.step`
PathSolver = Callable[..., tuple[PathSolution, np.ndarray, np.ndarray]]
#: mm: the error of a path step is relative to at least this motion. With the default tolerance, forty steps with equal
#: errors add up to the 2 µm that a coordinate measuring machine resolves.
LEAST_MOTION = 0.2
CACHED_COLUMNS = 8  # RampColumns cached for each step, on average
ROUNDING = 1e-9  # mm: remaining distances below this count as zero
#: kinds of rows that are read at the end of a stage
OUTPUTS = ("locator", "clamp", "weld", "measurement", "between", "position")
#: dense maps of a response, by which values, loads and contact forces are multiplied
MAPS = ("T", "L", "T_out", "L_out", "reaction_T", "reaction_L", "reaction_S")
LOADS = ("L", "L_out", "reaction_L")  #: maps of loads


@dataclass(frozen=True)
class EliminatedStep:
    """A step with its bilateral rows eliminated, for all contact laws.

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
    contact_rows = model.rows["contact"].shape[0]
    layer = np.zeros(contact_rows)
    layer[:: model.contacts.dimension] = model.contacts.layer
    positions = [("position", i) for i in range(model.rows["position"].shape[0])]
    loads: dict[tuple, dict] = {}  # load rows of all steps that hold and stop the same rows
    for plan in plans:
        for step in plan.steps:
            loads.setdefault((step.bilateral, step.stops), {}).update(dict.fromkeys((*positions, *step.load_rows)))
    shared: dict[tuple, tuple[csr_matrix, Response, np.ndarray]] = {}
    eliminated: dict[str, list[EliminatedStep]] = {}
    for plan in plans:
        for step in plan.steps:
            held = step.bilateral, step.stops
            if held not in shared:
                bilateral, soft = rows_of(step.bilateral), row_compliance(model.scene, step.bilateral)
                contact = vstack([model.rows["contact"], *(stop_row(model.rows, stop) for stop in step.stops)])
                try:
                    chosen = np.zeros(0, dtype=int)
                    if step.resting:
                        chosen = model.rest.completing_rows(bilateral, model.compliance)
                        bilateral = vstack([bilateral, model.rest.rows[chosen]], format="csr")
                        soft = None if soft is None else np.concatenate([soft, np.zeros(len(chosen))])
                    series = np.concatenate([layer, np.zeros(len(step.stops))])
                    response = eliminate(
                        model.compliance, bilateral, contact.tocsr(), rows_of(loads[held]), output, soft, series
                    )
                except FreeMotion as error:
                    share = [np.linalg.norm(error.motions[own]) for own in model.compliance.motions]
                    raise free_motion_error(model.scene, plan, step, error, int(np.argmax(share))) from error
                # Samples are multiplied by the transposes, which then have contiguous rows.
                maps: dict[str, Any] = {name: np.asfortranarray(getattr(response, name)) for name in MAPS}
                response = replace(response, **maps)
                shared[held] = bilateral, response, chosen
            bilateral, response, chosen = shared[held]
            own = [list(loads[held]).index(row) for row in step.load_rows]
            position_maps = {name: getattr(response, name)[:, : len(positions)] for name in LOADS}
            response = replace(response, **{name: getattr(response, name)[:, own] for name in LOADS})
            rest = Rest(
                chosen,
                ~np.isin(model.rest.part[chosen], step.parked),
                model.rest.direction[chosen],
                tuple(model.scene.parts[p].name for p in model.rest.part[chosen]),
            )
            eliminated.setdefault(plan.name, []).append(EliminatedStep(step, bilateral, response, rest, position_maps))
    return eliminated


def stops_of(contacts, step: Step) -> Stops:
    """The stops of a step among the contacts."""
    return Stops(len(contacts), len(step.stops), contacts.dimension)


def stop_row(rows: Mapping[str, csr_matrix], limit: Limit) -> csr_matrix:
    """(1, F) row of a limited force's stop: its gap closes as the row moves in the direction of the push."""
    kind, row = limit.row
    return -limit.sign * rows[kind][row]


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
        self.plan, self.steps, self.path, self._solver_of = plan, steps, path, solver
        self._solvers: dict[int, tuple[EliminatedStep, ContactSolver | WorkingSetSolver]] = {}
        self._ramp_column_cache: dict[tuple[int, ...], RampColumns] = {}
        self._contacts, self._between, self._joints = model.contacts, model.between, model.joints
        self._dimension = model.contacts.dimension
        count = [*(model.rows[kind].shape[0] for kind in OUTPUTS), len(model.rest)]
        edges = np.concatenate([[0], np.cumsum(count)])
        self.output = {kind: slice(a, b) for kind, a, b in zip((*OUTPUTS, "rest"), edges, edges[1:])}

    def solver(self, eliminated: EliminatedStep) -> ContactSolver | WorkingSetSolver:
        """The contact solver of a step."""
        cached = self._solvers.get(id(eliminated))
        if cached is None or cached[0] is not eliminated:
            cached = self._solvers[id(eliminated)] = eliminated, self._solver_of(eliminated)
        return cached[1]

    def stops(self, eliminated: EliminatedStep) -> Stops:
        return stops_of(self._contacts, eliminated.step)

    def solves_contact(self, eliminated: EliminatedStep) -> bool:
        """Whether a step has contacts or stops to solve for."""
        return eliminated.step.resolves and self.stops(eliminated).total > 0

    @cached_property
    def resolves(self) -> bool:
        """Whether contact is solved, between parts or with a stop."""
        return any(self.solves_contact(each) for each in self.required_steps)

    @property
    def response(self) -> Response:
        """Response of its last step."""
        return self.steps[-1].response

    @property
    def bilateral(self) -> csr_matrix:
        """(b + k, F) rows held at its end, and those that read the positions of resting parts."""
        return self.steps[-1].bilateral

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
        loose = {sample: message for sample, message in self._loose_parts(state).items() if not state.failed[sample]}
        state.failed[list(loose)] = True
        pushed = [self._pushed(limit, ends[self.plan.steps[i]], drive) for i, limit in self.plan.checked_limits]
        resolution = self._resolution(start, state, solutions, drive, pushed)
        resolution.converged[list(loose)] = False
        for sample, message in loose.items():
            resolution.status[sample] = message
        return replace(state, path_error=resolution.trace.error), resolution

    def _loose_parts(self, state: ProcessState) -> dict[int, str]:
        """Samples in which a part lies loose at the stage's end, with the message for each."""
        last = next(each for each in reversed(self.steps) if self.solves_contact(each))
        if self.plan.kind == "locate" or not last.rest.soft.any():
            return {}
        stop_forces = self.stop_forces(last.step, state)
        bound = self._bound(last, state.force)
        return last.rest.loose(last.response, state.force, classify(state.force, bound), bound, stop_forces)

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

    def step(
        self, eliminated: EliminatedStep, state: ProcessState, drive: Drive, resolve: PathSolver | None = None
    ) -> tuple[ProcessState, PathSolution | None]:
        """The state after a step, and the path of its contacts; None if contact is not solved.

        Parameters
        ----------
        eliminated, state, drive
            The step, the state before it, and its drive.
        resolve : function, optional
            Maps these, the step's ramp and the positions (n, k) of resting parts to the contacts' path, the forces (n,
            s) of the stops, and the final positions of resting parts; default: the contact solver.
        """
        step = eliminated.step
        ramp = self.ramp(step, state, drive)
        place = (drive.target if step.sets_down else state.reading)["rest"][:, eliminated.rest.row]
        force, left, anchor, solution = state.force, state.left, state.anchor, None
        stop = self.stop_forces(step, state)
        if self.solves_contact(eliminated):
            solution, stop, place = (resolve or self._resolve)(eliminated, state, drive, ramp, place)
            force = solution.force.reshape(force.shape)
            left = solution.displacement.reshape(force.shape).copy()
            left[:, :, 0] -= drive.gap
            anchor = solution.anchor
        converged = None if solution is None else solution.converged
        after = self.after(eliminated, state, drive, ramp, place, force, left, anchor, stop, converged)
        return after, solution

    def after(
        self,
        eliminated: EliminatedStep,
        state: ProcessState,
        drive: Drive,
        ramp: Ramp,
        place: np.ndarray,
        force: np.ndarray,
        left: np.ndarray,
        anchor: np.ndarray,
        stop: np.ndarray,
        converged: np.ndarray | None,
    ) -> ProcessState:
        """The state after a step; linear in all arguments, except for `failed`.

        Parameters
        ----------
        eliminated, state, drive, ramp
            The step, the state before it, its drive and its ramp.
        place : (n, k) array
            Positions of the resting parts.
        force, left : (n, m, d) array
        anchor : (n, m, d - 1) array
        stop : (n, s) array
        converged : (n,) bool array or None
            None if no contact was solved.
        """
        step, response = eliminated.step, eliminated.response
        columns_before = self._columns_for(step, state, drive)
        v, p = ramp.at(1.0)
        v = _side_by_side(v, place)
        if converged is None and step.sets_down and len(self._contacts):  # placed one by one, without contact
            left = (product(v, response.T.T) + product(p, response.L.T)).reshape(left.shape)
            anchor = left[:, :, 1:]
        reading, reaction = self._outcome(response, v, p, _side_by_side(force.reshape(len(force), -1), stop))
        return ProcessState(
            reading=reading,
            force=force,
            left=left,
            anchor=anchor,
            failed=state.failed if converged is None else state.failed | ~converged,
            path_error=state.path_error,
            value=Values(columns_before.rows, v),
            reaction=Values(columns_before.rows, reaction),
            push=Values(columns_before.loads, drive.push[:, step.loads]),
            stop=Values(columns_before.stops, stop),
            frozen=columns_before.weld_values(state, drive),
        )

    def ramp(self, step: Step, state: ProcessState, drive: Drive) -> Ramp:
        """The ramp of a step, from the current readings and forces to those prescribed."""
        return self._columns_for(step, state, drive).ramp(state, drive)

    def _columns_for(self, step: Step, state: ProcessState, drive: Drive) -> RampColumns:
        """Columns for a step after a state with these rows; cached for the stage's own steps."""
        before = row_names(state)
        key = (id(step), *map(id, before))
        found = self._ramp_column_cache.get(key)
        if found is None or found.step is not step or found.known != before:
            if len(self._ramp_column_cache) >= CACHED_COLUMNS * len(self.steps):
                self._ramp_column_cache.clear()
            found = self._ramp_column_cache[key] = RampColumns.of(step, state, drive, self._joints)
        return found

    def stop_forces(self, step: Step, state: ProcessState) -> np.ndarray:
        """(n, s) forces of a step's stops before it; zero for new stops."""
        none = np.zeros(len(state.failed))
        return columns(len(none), [state.stop.get(stop.row, none) for stop in step.stops])

    def unloaded(self, eliminated: EliminatedStep, drive: Drive, ramp: Ramp, place: np.ndarray, s: float) -> np.ndarray:
        """(n, d m + s) b of contacts and stops, at s of the ramp; linear."""
        response, contacts = eliminated.response, len(self._contacts) * self._dimension
        v, p = ramp.at(s)
        b = product(_side_by_side(v, place), response.T.T) + product(p, response.L.T)
        b[:, : contacts : self._dimension] += drive.gap
        for j, limit in enumerate(eliminated.step.stops):
            b[:, contacts + j] += limit.sign * self._position(limit, drive)
        return b

    def overlap(self, eliminated: EliminatedStep, state: ProcessState, drive: Drive, start: np.ndarray) -> np.ndarray:
        """(n, d m + s) overlap at a step's start of the contacts that close during it, negative if open; others 0.

        It is linear in its arguments.
        """
        step, contacts = eliminated.step, len(self._contacts) * self._dimension
        found = np.zeros_like(start)
        if step.settles:
            touching = np.zeros_like(start)
            touching[:, :contacts] = state.force.reshape(len(start), -1)
            normal = slice(0, contacts, self._dimension)
            found[:, normal] = -(start + eliminated.response.S.under(touching))[:, normal]
        for j, limit in enumerate(step.stops):
            if limit.row not in state.stop:  # starts from the part, which may lie beyond the position
                kind, row = limit.row
                found[:, contacts + j] = limit.sign * (state.reading[kind][:, row] - self._position(limit, drive))
        return found

    def _resolve(self, eliminated, state, drive, ramp, place) -> tuple[PathSolution, np.ndarray, np.ndarray]:
        """Follow the ramp, or closing overlaps, with the contact solver.

        Returns the contacts' path, the forces (n, s) of the stops, and the positions (n, k) of the resting parts, which
        start at `place`.
        """
        response, rest, step, n = eliminated.response, eliminated.rest, eliminated.step, len(drive)
        contacts, anchor = state.left[0].size, state.anchor
        force = _side_by_side(state.force.reshape(n, -1), self.stop_forces(step, state))

        def unloaded(s, place):
            return self.unloaded(eliminated, drive, ramp, place, s)

        if step.settles and rest.soft.any():
            place, anchor = self.separating_motion(eliminated, state, unloaded(0.0, place), place)
        start, end = unloaded(0.0, place), unloaded(1.0, place)
        lift = np.maximum(0.0, self.overlap(eliminated, state, drive, start))
        follow = partial(self.follow, eliminated)

        if not rest.soft.any():
            solution, force = follow(start + lift, end, force, anchor, self.path)
            return solution, force[:, contacts:], place

        def segment(s0, s1) -> Segment:
            """The part of the step from s0 to s1: b, and the loads on the rest rows."""
            left = [rest.pushed(response, ramp.at(s)[1]) for s in (s0, s1)]
            return Segment(unloaded(s0, place) + (1 - s0) * lift, unloaded(s1, place) + (1 - s1) * lift, *left)

        segments, s0 = rest.segments(self.path, self.solver(eliminated).law), 0.0
        pieces, begin, at = [], place[:, rest.soft], place[:, rest.soft]
        for s1, path in segments:
            solution, force, at = rest.settle(response, segment(s0, s1), begin, at, force, anchor, follow, path)
            anchor, trace = solution.anchor, solution.trace.weighted((s1 - s0) * len(segments))
            if isinstance(self.path, Followed) and isinstance(path, Increments):  # short: part of the followed path
                solution = replace(solution, rung=np.where(solution.rung == "increments", "followed", solution.rung))
                trace = replace(trace, error=np.zeros(n))
            pieces.append(replace(solution, trace=trace))
            s0 = s1
        place = place.copy()
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

    def separating_motion(self, eliminated, state, unloaded, place) -> tuple[np.ndarray, np.ndarray]:
        """Positions (n, k) at which unloaded resting parts overlap nowhere, and anchors that move with them."""
        rest, (_, m, d) = eliminated.rest, state.force.shape
        G = self.contact_motions(eliminated)
        touched = np.abs(G[:, 0]).max(axis=1, initial=0.0) > 0
        place, anchor = place.copy(), state.anchor.copy()
        for sample in np.flatnonzero(~state.force[:, touched].any(axis=(1, 2))):
            moved = separating_motion(unloaded[sample, : m * d : d], G[:, 0])
            place[sample, rest.soft] += moved
            anchor[sample] += G[:, 1:] @ moved
        return place, anchor

    def _resolution(self, start, end, solutions, drive, pushed) -> Resolution:
        whole, n = PathSolution.join(solutions), len(end.force)
        displacement = whole.displacement.reshape(end.force.shape).copy()
        displacement[:, :, 1:] = (end.left - start.left)[:, :, 1:]
        resolving = next(each for each in reversed(self.steps) if self.solves_contact(each))
        bound = self._bound(resolving, end.force)
        unseen, at = self._unseen(end, drive)
        return Resolution(
            stage=self.plan.name,
            force=end.force.copy(),
            displacement=displacement,
            state=classify(end.force, bound),
            # Sticking contacts inherit the error of the paths before; sliding ones lose it.
            trace=replace(whole.trace, error=start.path_error + whole.trace.error),
            residual=whole.residual,
            converged=whole.converged,
            iterations=whole.iterations,
            status=whole.status,
            rung=whole.rung,
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
        reading = product(v, response.T_out.T) + product(p, response.L_out.T) + response.S_out.under(force)
        reaction = product(v, response.reaction_T.T) + product(p, response.reaction_L.T)
        reaction += product(force, response.reaction_S.T)
        return {kind: reading[:, own] for kind, own in self.output.items()}, reaction


def _side_by_side(first: np.ndarray, second: np.ndarray) -> np.ndarray:
    """(n, j + k) two arrays side by side; the second is often empty."""
    return np.concatenate([first, second], axis=1) if second.shape[1] else first


def path_of(plan: StagePlan, law, tolerance: float) -> Path:
    """How a stage's steps are followed under a law."""
    if plan.path == "followed" and law.followed:
        return Followed(tolerance, LEAST_MOTION)
    return Increments(plan.increments)
