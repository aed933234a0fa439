"""One pass of samples and their derivatives through the process.

The steps of the contacts' paths are recorded, then retraced with derivatives (:mod:`mic.contact.tangent`).
"""

from __future__ import annotations

from dataclasses import fields, replace
from typing import Any

import numpy as np

from mic.contact.friction import Friction
from mic.contact.path import Path
from mic.contact.states import OPEN
from mic.contact.tangent import ComplianceDerivative, Contact, Dual, End, differentiate_path
from mic.model.rest_rows import separating_motion_slope
from mic.process.evaluation import ContactSensitivity, Sensitivities
from mic.process.force_limits import Stops
from mic.process.inputs import Inputs
from mic.process.moving_rows import MovingRows
from mic.process.plan import Step
from mic.process.resting_parts import Segment
from mic.process.stage import BatchStep, EliminatedStep, PreparedStage
from mic.process.state import ProcessState

__all__ = ["DifferentiatedProcess"]

RESTS = 1e-10  # of the largest gap or force: closer contacts that no input moves stay at their change of state
TOUCHES = 1e-11  # mm: a contact with more overlap closes
ROUNDS = 20  # Newton iterations for the positions of resting parts
SETTLED = 1e-11  # of the largest force: largest spring force at the solution
FREE = 1e-9  # of the largest stiffness: stiffness that counts as zero
LOOSE = 1e-6  # relative residual of a derivative above which nothing determines a resting part's position


class DifferentiatedProcess:
    """n samples, with one more assembly for each sample and input that holds the derivatives.

    Derivatives are ordered by sample, and by input within a sample.

    Parameters
    ----------
    process : mic.process.process.Process
    deviations : (n, p') array
    names : list of str
        The p inputs.
    sigma : (p,) array
        Their standard deviations.
    steps : mapping or None
        Recorded path steps to be retraced; None: each path is followed and recorded first.
    offset : (n,) array, optional
        Offset of the only input from its value in each sample.
    """

    def __init__(self, process, deviations, names, sigma, steps, offset=None):
        self.process, self.names, self.sigma, self.given_steps = process, names, sigma, steps
        self.n, self.p = len(deviations), len(names)
        self.inputs = Inputs.of(process.model, names)
        self.drive, self.drive_slope = process.drive(deviations), self.inputs.drive(process, deviations)
        self.undetermined = np.zeros(self.n, dtype=bool)
        self.offset = np.zeros(self.n) if offset is None else offset
        if offset is not None:
            self.drive = self.drive.combined(lambda value, slope: value + offset[:, None] * slope, self.drive_slope)
        self.steps: dict[tuple, Any] = {}
        self.reach, self.where = np.full(self.n, np.inf), np.full(self.n, "", dtype=object)
        self.reach_along, self.exact = np.full((self.n, self.p), np.inf), np.ones(self.n, dtype=bool)

    def sensitivities(self) -> Sensitivities:
        """Take the samples and their derivatives through all stages."""
        state, slope = self.process.start(self.n), self.process.start(self.n * self.p)
        contacts, read = {}, (np.zeros((self.n, 0)), np.zeros((self.n * self.p, 0)))
        for stage in self.process.stages:
            before, last = slope, None
            for number, eliminated in enumerate(stage.required_steps):
                state, slope, end = self._step(stage, number, eliminated, state, slope)
                last = end or last
            if last is not None:
                contacts[stage.plan.name] = self._contacts(state, slope, before, last)
            if stage.plan.reads:
                read = (
                    state.reading["measurement"] + self.drive.measured,
                    slope.reading["measurement"] + self.drive_slope.measured,
                )
        values, jacobian = read[0], self._columns(read[1])
        if values.size:
            characteristics = self.process.model.characteristics
            jacobian = np.matmul(characteristics.tangent(values), jacobian)
            values = characteristics.values(values)
        failed = state.failed | self.undetermined
        jacobian[failed] = np.nan
        sides = np.repeat(jacobian[..., None], 2, axis=-1)
        own, reach = (self.process.law, self.names, self.sigma), (self.reach, self.reach_along, self.where)
        return Sensitivities(*own, values, jacobian, sides, contacts, *reach, failed, self.exact, self.steps)

    def _columns(self, slope: np.ndarray) -> np.ndarray:
        """(n, ..., p) from (n p, ...)."""
        return np.moveaxis(slope.reshape(self.n, self.p, *slope.shape[1:]), 1, -1)

    def _rows(self, slope: np.ndarray) -> np.ndarray:
        """(n p, ...) from (n, ..., p)."""
        return np.moveaxis(slope, -1, 1).reshape(self.n * self.p, *slope.shape[1:-1])

    def _step(self, stage: PreparedStage, number: int, eliminated: EliminatedStep, state, slope):
        """The states after a step, and the end of its contact path; None where contact is not solved."""
        driven, plain = (replace(eliminated, step=step) for step in self._limited_steps(eliminated.step))
        batch = stage.begin(driven, state, self.drive)
        change = stage.begin(plain, self._with_moved_rows(state, slope), self.drive_slope)
        moving = MovingRows.of(self.inputs.places, stage, eliminated)
        end: End | None = None
        converged = all_solved = None
        if stage.solves_contact(eliminated):
            end, converged = self._solve(stage, number, eliminated, batch, change, moving)
            all_solved = np.ones(self.n * self.p, dtype=bool)
            self.exact &= end.solved | ~converged
            self._update_reach(stage, eliminated, end)
            stops, outputs = stage.stops(eliminated), (end.force, end.displacement, end.anchor)
            _set_end(batch, stops, *(one.value for one in outputs))
            _set_end(change, stops, *(self._rows(one.slope) for one in outputs))
        after, slope_after = stage.after(batch, converged), stage.after(change, all_solved)
        if len(moving):
            moving.read(stage, slope_after, after, self.p, *_values_and_loads(batch, 1.0), end is not None)
        return after, slope_after, end

    def _solve(self, stage, number, eliminated, batch, change, moving) -> tuple[End, np.ndarray]:
        """The end of the contact path of a step, and whether the samples converged.

        `change` has the derivatives of `batch`; the positions of resting parts and their derivatives are set in both.
        """
        sides, stops = (batch, change), stage.stops(eliminated)
        soft, settles = eliminated.rest.soft.any(), eliminated.step.settles
        if soft and settles:
            self._separate_resting_parts(stage, batch, change)
        starts, stop = ([stage.unloaded(side, s) for side in sides] for s in (0.0, 1.0))
        compliance_slope = moving.compliance_slope()
        for s, (_, moved) in enumerate((starts, stop)):
            moving.load(moved, self.p, *_values_and_loads(batch, float(s)))
        overlap, overlap_slope = (stage.overlap(side, start) for side, start in zip(sides, starts))
        if compliance_slope is not None and settles:
            touching = np.column_stack([batch.force.reshape(self.n, -1), np.zeros((self.n, stops.count))])
            normal = slice(0, stops.rows, stops.dimension)
            overlap_slope[:, normal] -= self._rows(compliance_slope.apply(touching, self.p))[:, normal]
        lifts = np.maximum(0.0, overlap), np.where(np.repeat(overlap > 0.0, self.p, axis=0), overlap_slope, 0.0)
        anchor = self._varied(*(_pad_anchor(stops, side.anchor) for side in sides))
        contact = self._contact(stage, eliminated, compliance_slope)
        if soft:
            return self._step_with_resting_parts(stage, number, eliminated, sides, starts, stop, lifts, anchor, contact)
        starts = [start + lift for start, lift in zip(starts, lifts)]
        record, converged = self._recorded_path(stage, number, eliminated, batch, starts[0], stop[0])
        b0, b1 = (self._varied(*(stops.pad(one) for one in both)) for both in (starts, stop))
        return self._differentiated_path(self._excluded(eliminated), contact, b0, b1, anchor, record), converged

    def _separate_resting_parts(self, stage: PreparedStage, batch: BatchStep, change: BatchStep) -> None:
        """Separate resting parts that overlap before the step; set positions, anchors and their derivatives."""
        start, slope = stage.unloaded(batch, 0.0), self._columns(stage.unloaded(change, 0.0))
        place, anchor = stage.separating_motion(batch, start)
        soft, (_, m, d) = batch.eliminated.rest.soft, batch.force.shape
        G = stage.contact_motions(batch.eliminated)
        moved, turned = self._columns(change.place), self._columns(change.anchor)
        for i in np.flatnonzero((place != batch.place).any(axis=1)):
            motion = (place - batch.place)[i, soft]
            motion_slope = separating_motion_slope(start[i, : m * d : d], slope[i, : m * d : d], G[:, 0], motion)
            moved[i, soft] += motion_slope
            turned[i] += np.einsum("mjk,kp->mjp", G[:, 1:], motion_slope)
        batch.place, batch.anchor, change.place, change.anchor = place, anchor, self._rows(moved), self._rows(turned)

    def _step_with_resting_parts(self, stage, number, eliminated, sides, starts, stop, lifts, anchor, contact):
        """End of the contact path of a step with resting parts, and whether their positions converged.

        The position q̄ of a part is an additional input of each segment, determined by ``λ(x, q̄) = 0``: the springs
        carry no force (:mod:`mic.process.resting_parts`).
        """
        rest, response, stops = eliminated.rest, eliminated.response, stage.stops(eliminated)
        (c, G), law = rest.springs(response), stage.solver(eliminated).law
        k, p = int(rest.soft.sum()), self.p
        contact = replace(contact, friction_slope=np.pad(contact.friction_slope, ((0, 0), (0, k))))
        nominal = self._varied(*(side.place[:, rest.soft] for side in sides))
        force = self._varied(*(np.column_stack([side.force.reshape(len(side.force), -1), side.stop]) for side in sides))
        position, s_start, converged = nominal, 0.0, np.ones(self.n, dtype=bool)

        def loads(s: float) -> tuple[Dual, Dual]:
            """b, and the loads e on the rest rows, position s of the step."""
            b = [(1 - s) * (start + lift) + s * last for start, lift, last in zip(starts, lifts, stop)]
            return self._varied(*b), self._varied(*(rest.pushed(response, side.ramp.at(s)[1]) for side in sides))

        for segment, (s_end, path) in enumerate(rest.segments(stage.path, law)):
            (b0, _), (b1, e1) = ends = loads(s_start), loads(s_end)
            record, target, settled = self._rest_positions(
                stage, (number, segment), eliminated, ends, nominal, position, force, anchor, path
            )
            converged &= settled
            carried = _times(force, G)
            moved = _each(lambda now, nominal, f: now - nominal - c * f, position, nominal, carried)
            begin = _each(np.add, b0, _times(moved, G.T))
            offset = _times(_each(lambda nominal, e: nominal + c * e, nominal, e1), G.T)
            without_parts = _each(np.subtract, b1, offset)
            none = np.zeros((self.n, len(G), k))
            for _ in range(ROUNDS):
                end = Dual(without_parts.value + target @ G.T, np.concatenate([without_parts.slope, none + G], axis=2))
                end_state = self._differentiated_path(
                    self._excluded(eliminated),
                    contact,
                    _for_solver(stops, Dual(begin.value, np.concatenate([begin.slope, none], axis=2))),
                    _for_solver(stops, end),
                    Dual(anchor.value, np.pad(anchor.slope, ((0, 0), (0, 0), (0, k)))),
                    record,
                )
                f = _without_padding(stops, end_state.force)
                λ, M = e1.value - f.value @ G, np.einsum("rk,nrj->nkj", G, f.slope[:, :, p:])
                scale = np.maximum(np.abs(f.value).max(axis=1, initial=0.0), np.abs(e1.value).max(axis=1, initial=0.0))
                if (np.abs(λ).max(axis=1) <= SETTLED * scale).all():
                    break
                target = target + _least_norm_solution(M, λ[..., None])[..., 0]
            before = e1.slope - np.einsum("rk,nrp->nkp", G, f.slope[:, :, :p])
            dq = position.slope + _least_norm_solution(M, before - M @ position.slope)
            residual = np.abs(before - M @ dq).max(axis=(1, 2), initial=0.0)
            self.undetermined |= residual > LOOSE * np.maximum(np.abs(before).max(axis=(1, 2), initial=0.0), 1e-300)
            end_state = _chain_rule(end_state, p, dq)
            force, anchor, position = _without_padding(stops, end_state.force), end_state.anchor, Dual(target, dq)
            self.exact &= end_state.solved | ~settled
            s_start = s_end
        for side, values in zip(sides, (position.value, self._rows(position.slope))):
            side.place = side.place.copy()
            side.place[:, rest.soft] = values
        return end_state, converged

    def _rest_positions(self, stage, numbers, eliminated, loads, nominal, at, force, anchor, path):
        """Recorded steps (n,) of a segment, spring targets (n, k) of its resting parts, and whether they converged.

        `numbers` are those of the step and of the segment.
        """
        key, position_key = (stage.plan.name, *numbers), (stage.plan.name, *numbers, "at")
        if self.given_steps is not None:
            self.steps |= {each: self.given_steps[each] for each in (key, position_key)}
            return self.steps[key], np.stack(list(self.steps[position_key])), np.ones(self.n, dtype=bool)
        rest, response = eliminated.rest, eliminated.response
        (b0, e0), (b1, e1) = loads

        def follow(start, end, pressed, anchors, path):
            return stage.follow(eliminated, start, end, pressed, anchors, replace(path, recorded=True))

        stops = stage.stops(eliminated)
        anchors = anchor.value.reshape(self.n, stops.total, stops.dimension - 1)[:, : stops.contacts]
        values = Segment(b0.value, b1.value, e0.value, e1.value)
        solution, pressed, place = rest.settle(
            response, values, nominal.value, at.value, force.value, anchors, follow, path
        )
        c, G = rest.springs(response)
        target = place + c * (e1.value - pressed @ G)
        positions = np.empty(self.n, dtype=object)
        positions[:] = list(target)
        self.steps[key], self.steps[position_key] = solution.record, positions
        return solution.record, target, solution.converged

    def _differentiated_path(
        self, out: np.ndarray, contact: Contact, start: Dual, end: Dual, anchor: Dual, record
    ) -> End:
        """Retrace the recorded paths with derivatives; contacts `out` (m + s,) take no part.

        An offset sample has the friction at its offset, and contacts that were open throughout its recorded path are
        added if they overlap.
        """
        if not self.offset.any():
            return differentiate_path(contact, start, end, anchor, record)
        ends = []
        for i, way in enumerate(self.offset):
            coefficient = np.maximum(contact.friction.coefficient + way * contact.friction_slope[:, 0], 0.0)
            there = replace(contact, friction=replace(contact.friction, coefficient=coefficient))
            b0, b1, anchors_now = (Dual(one.value[i : i + 1], one.slope[i : i + 1]) for one in (start, end, anchor))
            also = np.zeros(len(out), dtype=bool)
            while True:
                found = differentiate_path(there, b0, b1, anchors_now, record[i : i + 1], also)
                new = ~out & ~also & (found.state[0] == OPEN) & (found.normal.value[0] < -TOUCHES)
                if not new.any():
                    break
                also |= new
            ends.append(found)
        return End.join(ends)

    def _with_moved_rows(self, state: ProcessState, slope: ProcessState) -> ProcessState:
        """The slope state with the readings of rows whose positions are inputs."""
        if not self.inputs.places:
            return slope
        reading = {kind: values.copy() for kind, values in slope.reading.items()}
        for place in self.inputs.places:
            kind, row = place.row
            reading[kind][place.input :: self.p, row] += state.reading["position"][:, place.number]
        return replace(slope, reading=reading)

    def _limited_steps(self, step: Step) -> tuple[Step, Step]:
        """The step with the samples' force limits, and with the derivatives of the limits in their place."""
        none = np.zeros(self.p)

        def unit(limit):
            return np.tile(self.inputs.limit.get(limit.row, none), self.n)

        def with_forces(force):
            tables = {name: getattr(step, name) for name in ("limits", "dropped_limits")}
            forces = {name: tuple(replace(one, force=force(one)) for one in limits) for name, limits in tables.items()}
            return replace(step, **forces)

        moved = self.offset.any() and self.inputs.limit
        return with_forces(lambda limit: limit.force + self.offset * unit(limit)) if moved else step, with_forces(unit)

    def _varied(self, value, slope) -> Dual:
        return Dual(value, self._columns(slope))

    def _recorded_path(self, stage: PreparedStage, number: int, eliminated, batch: BatchStep, b0, b1):
        """Recorded path steps (n,) of the contacts, and whether the samples met their tolerance."""
        key = stage.plan.name, number
        if self.given_steps is not None:
            self.steps[key] = self.given_steps[key]
            return self.steps[key], np.ones(self.n, dtype=bool)
        force = np.column_stack([batch.force.reshape(self.n, -1), batch.stop])
        path: Path = replace(stage.path, recorded=True)
        found, _ = stage.follow(eliminated, b0, b1, force, batch.anchor, path)
        self.steps[key] = found.record
        return found.record, found.converged

    def _contact(
        self, stage: PreparedStage, eliminated: EliminatedStep, compliance_slope: ComplianceDerivative | None
    ) -> Contact:
        contacts, law = self.process.model.contacts, stage.solver(eliminated).law
        stops = stage.stops(eliminated)
        friction = stops.friction(contacts.friction_in(stage.plan.name))
        friction_slope = np.concatenate([self.inputs.friction, np.zeros((stops.count, self.p))])
        if law.coefficient_varies and friction.pressure is not None:
            friction_slope[: stops.contacts][~np.isnan(contacts.pressure[:, 0, 0])] = 0.0
        return Contact(
            law,
            stops.compliance(*eliminated.compliance),
            friction if law.frictional else Friction.of(0.0, stops.total),
            friction_slope,
            contacts.dimension,
            compliance_slope
            and ComplianceDerivative(
                stops.pad(compliance_slope.left), stops.pad(compliance_slope.right), compliance_slope.inputs
            ),
        )

    def _contacts(self, state: ProcessState, slope: ProcessState, before: ProcessState, end: End) -> ContactSensitivity:
        m = state.force.shape[1]
        return ContactSensitivity(
            state.force,
            end.state[:, :m],
            self._columns(slope.force),
            self._columns(slope.left[:, :, 1:] - before.left[:, :, 1:]),
        )

    def _excluded(self, eliminated: EliminatedStep) -> np.ndarray:
        """(m + s,) whether each contact or stop takes no part in a step."""
        step, contacts = eliminated.step, self.process.model.contacts
        return np.concatenate([contacts.excluded(step.nuggets, step.away), np.zeros(len(step.stops), dtype=bool)])

    def _update_reach(self, stage: PreparedStage, eliminated: EliminatedStep, end: End) -> None:
        """Update the distance to the nearest change of state with the contacts at the end of a step."""
        active = ~self._excluded(eliminated)
        for margin in (end.normal, end.cone):
            size = np.abs(margin.value)
            finite = np.where(np.isfinite(size), size, 0.0)
            change = np.abs(margin.slope) * self.sigma
            joint = np.linalg.norm(change, axis=2)
            rests = np.maximum(finite, joint) <= RESTS * finite.max(axis=1, keepdims=True, initial=0.0)
            counts = active & np.isfinite(size) & ~rests & (joint > 0.0)
            distance = np.where(counts, finite / np.where(counts, joint, 1.0), np.inf)
            along = np.where(
                counts[:, :, None] & (change > 0.0), finite[:, :, None] / np.where(change > 0, change, 1.0), np.inf
            )
            self.reach_along = np.minimum(self.reach_along, along.min(axis=1, initial=np.inf))
            if not distance.shape[1]:
                continue
            nearest = distance.argmin(axis=1)
            for i, k in enumerate(nearest):
                if distance[i, k] < self.reach[i]:
                    self.reach[i] = distance[i, k]
                    self.where[i] = self._state_change(stage, eliminated, int(k), end.state[i, k], margin is end.cone)

    def _state_change(self, stage: PreparedStage, eliminated: EliminatedStep, k: int, state: int, slips: bool) -> str:
        """Describe a change of state: the stage, the contact or stop, and whether it slips, closes or opens."""
        model = self.process.model
        change = "slips" if slips else "closes" if state == 0 else "opens"
        if k >= len(model.contacts):
            kind, row = eliminated.step.stops[k - len(model.contacts)].row
            return f"{stage.plan.name}: the stop of {model.labels[kind][row]} {change}"
        return f"{stage.plan.name}: contact {k} of zone {model.scene.zones[model.contacts.zone[k]].name} {change}"


def _pad_anchor(stops: Stops, anchor: np.ndarray) -> np.ndarray:
    """(n, (d - 1)(m + s)) anchors of contacts (n, m, d - 1), padded with zeros for the stops."""
    n, _, sides = anchor.shape
    return np.column_stack([anchor.reshape(n, stops.contacts * sides), np.zeros((n, stops.count * sides))])


def _set_end(batch: BatchStep, stops: Stops, force, u, anchor) -> None:
    """Set forces, positions and anchors at the end of a batch's step from those of contacts and stops."""
    shape = len(force), stops.contacts, stops.dimension
    sides = stops.dimension - 1
    batch.force = force[:, : stops.rows].reshape(shape)
    batch.left = u[:, : stops.rows].reshape(shape).copy()
    batch.left[:, :, 0] -= batch.drive.gap
    batch.anchor = anchor[:, : stops.contacts * sides].reshape(*shape[:2], sides)
    batch.stop = force[:, stops.rows :: stops.dimension]


def _values_and_loads(batch: BatchStep, s: float) -> tuple[np.ndarray, np.ndarray]:
    """Values and loads of a step's rows at s of the ramp."""
    v, loads = batch.ramp.at(s)
    return np.column_stack([v, batch.place]), loads


def _each(function, *terms: Dual) -> Dual:
    """A linear function of the values, and of the slopes."""
    return Dual(function(*(term.value for term in terms)), function(*(term.slope for term in terms)))


def _times(one: Dual, matrix: np.ndarray) -> Dual:
    """``X A``, of rows (n, r) and A (r, k)."""
    return Dual(one.value @ matrix, np.einsum("nrp,rk->nkp", one.slope, matrix))


def _for_solver(stops: Stops, one: Dual) -> Dual:
    """Values of contacts and stops, padded to d rows for each stop as the solver needs them."""
    slope = [stops.pad(one.slope[:, :, i]) for i in range(one.slope.shape[2])]
    return Dual(stops.pad(one.value), np.stack(slope, axis=2))


def _without_padding(stops: Stops, force: Dual) -> Dual:
    """(n, d m + s) forces of contacts and stops, without the rows that the solver adds to stops."""
    own = np.concatenate([np.arange(stops.rows), np.arange(stops.rows, force.value.shape[1], stops.dimension)])
    return Dual(force.value[:, own], force.slope[:, own])


def _chain_rule(end: End, p: int, position_slope: np.ndarray) -> End:
    """Derivatives by the p inputs, with those by the positions of resting parts, whose slopes are (n, k, p)."""

    def own(one):
        if not isinstance(one, Dual):
            return one
        return Dual(one.value, one.slope[:, :, :p] + one.slope[:, :, p:] @ position_slope)

    return End(**{one.name: own(getattr(end, one.name)) for one in fields(End)})


def _least_norm_solution(matrix: np.ndarray, right: np.ndarray) -> np.ndarray:
    """(n, k, p) least-norm solutions of systems (n, k, k) that may be singular."""
    return np.matmul(np.linalg.pinv(matrix, rcond=FREE), right)
