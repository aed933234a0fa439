"""Exact derivatives of key characteristics, contact forces and slip with respect to the inputs of an assembly.

Between contact problems everything is linear, so that the derivatives take the very steps of the process: what a stage
hands to the next (readings, where contacts were left, what welds froze, reactions that are let go, forces of stops) is
handed on with its derivatives, one more assembly for each input, driven by what a unit of the input asks. Contact is
differentiated where it is solved (:mod:`mic.contact.tangent`), with its states known and the steps of its path frozen.

Where a row moves in its sheet, by δ along a tangent, it reads ``ℓ·y + δ a'·y`` and pushes with ``λ (ℓ + δ a')``: S, T
and L of what was eliminated with ℓ change (:mod:`mic.process.shift`), S by ``-T αᵀ - α Tᵀ`` with α what a load on a'
moves.

Inputs are called as :mod:`mic.process.inputs` says.

A thickness changes the compliance itself: with respect to it central differences are taken, along the same steps.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, fields, replace
from typing import Any

import numpy as np

from mic.contact.friction import Friction
from mic.contact.path import Path
from mic.contact.states import OPEN
from mic.contact.tangent import Bend, Contact, End, Varied, retrace
from mic.errors import SceneError
from mic.process.drive import Drive
from mic.process.inputs import Inputs, known_inputs
from mic.process.path import Ramp
from mic.process.plan import Step
from mic.process.shift import Shift
from mic.process.stage import EliminatedStep, PreparedStage
from mic.process.state import ProcessState
from mic.process.stops import Stops
from mic.product import one_thread

__all__ = ["AT_CHANGE", "ContactSensitivity", "Sensitivities", "known_inputs", "sensitivities"]

#: A contact this near a change of state, of the largest gap or force, along which no input moves it, stays on it.
RESTS = 1e-10
#: A sample is at a change of state if it is no farther from it, in standard deviations; and how far beside it, and
#: beyond twice the way to it, derivatives to either side are taken.
AT_CHANGE, BESIDE = 1e-6, 1e-5
#: mm: what overlaps by more there closes.
TOUCHES = 1e-11
#: Values of samples and their derivatives that are carried at once: memory.
AT_ONCE = 2_000_000

#: Of a sheet's thickness: half the step of differences with respect to it.
THINNER = 1e-4

#: The steps that paths took: by stage and the step's number, the trail (n,) of each sample.
Steps = Mapping[tuple[str, int], np.ndarray]


@dataclass(frozen=True)
class ContactSensitivity:
    """The m contacts at the end of a stage that resolves them.

    Attributes
    ----------
    force : (n, m, d) array
        N.
    state : (n, m) int8 array
        A :class:`mic.contact.states.ContactState` each.
    force_slope : (n, m, d, p) array
        Derivatives of the forces, N per unit of the inputs.
    slip_slope : (n, m, d - 1, p) array
        Derivatives of the tangential displacement since the stage before, mm per unit; NaN for a thickness.
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
        Standard deviations of the inputs; 0 of those that the scene holds fixed.
    measurements : (n, k) array
        Key characteristics along the path whose derivative is taken, mm; from those of an evaluation they differ by no
        more than the error of its path.
    jacobian : (n, k, p) array
        Their derivatives, mm per unit of the inputs.
    sides : (n, k, p, 2) array
        Of samples at a change of state (``reach`` at most :data:`AT_CHANGE`), derivatives to either side of it, towards
        smaller values of the input and towards larger; NaN where there is no solution to be followed there, and for
        places in sheets. Of others, and along inputs that do not lead to the change, the derivatives themselves.
    contacts : dict of str to ContactSensitivity
        By stage.
    reach : (n,) array
        How far the sample is from the next change of a contact's state at the end of a step of the process, to first
        order, in standard deviations along the direction in which all inputs together change it most; infinite if none
        does.
    reach_along : (n, p) array
        Likewise along each input alone; infinite for those without standard deviation, NaN along a thickness, which the
        reach of all inputs together leaves out.
    where : (n,) object array of str
        Which contact changes its state there.
    failed : (n,) bool array
        Samples whose contact missed its tolerance; their derivatives are NaN.
    exact : (n,) bool array
        Whether every step of the path could be solved for anew; else derivatives are those of the steps as they were
        found, to the error of the path.
    steps : mapping
        The steps that the paths took, to be frozen in another call.
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
    steps: Steps

    @classmethod
    def join(cls, pieces: Sequence[Sensitivities]) -> Sensitivities:
        """One after the other."""

        def stacked(arrays):
            return np.concatenate(list(arrays))

        contacts = {
            stage: ContactSensitivity(
                **{
                    one.name: stacked(getattr(piece.contacts[stage], one.name) for piece in pieces)
                    for one in fields(ContactSensitivity)
                }
            )
            for stage in pieces[0].contacts
        }
        arrays = ("measurements", "jacobian", "sides", "reach", "reach_along", "where", "failed", "exact")
        return replace(
            pieces[0],
            contacts=contacts,
            steps={key: stacked(piece.steps[key] for piece in pieces) for key in pieces[0].steps},
            **{name: stacked(getattr(piece, name) for piece in pieces) for name in arrays},
        )


@one_thread
def sensitivities(
    process,
    deviations: np.ndarray,
    inputs: Sequence[str] | Mapping[str, float] | None = None,
    steps: Steps | None = None,
) -> Sensitivities:
    """Take assemblies through all stages, and their derivatives with them.

    Parameters
    ----------
    process : mic.process.process.Process
    deviations : (n, p) array
        As :meth:`mic.model.reduction.Reduction.deviations` returns it.
    inputs : sequence of str, or mapping of str to float, optional
        Names as :func:`known_inputs` has them, and their standard deviations, should they be others than those;
        default: the scene's deviations.
    steps : mapping, optional
        Steps of the paths, frozen: those of other samples nearby.

    Raises
    ------
    ValueError
        For inputs that are not known, or none.
    SceneError
        Where parts rest by contact alone: they come to lie by finite ways, of which no derivative is taken.
    """
    model = process.model
    names = list(model.parameters if inputs is None else inputs)
    Inputs.of(model, names)  # what is not known is told first
    for stage in process.stages:
        for each in stage.steps:
            if each.rest.soft.any():
                part = next(own for own, soft in zip(each.rest.name, each.rest.soft) if soft)
                raise SceneError(
                    f"stages ({stage.plan.name}): part {part!r} rests by contact alone there, and comes to lie by "
                    "finite ways, of which no derivative is taken; give it six locators there, or take differences of "
                    "evaluations"
                )
    own = inputs if isinstance(inputs, Mapping) else known_inputs(model)
    sigma = np.array([own[name] for name in names])
    thick = {names.index(one.name): j for j, one in enumerate(model.scene.deviations)
             if one.kind == "thickness" and one.name in names}  # fmt: skip
    reaching = np.where(np.isin(np.arange(len(names)), list(thick)), 0.0, sigma)
    found = _carried(process, deviations, names, reaching, steps)
    if not thick:
        return found
    found = replace(found, sigma=sigma, jacobian=found.jacobian.copy(), reach_along=found.reach_along.copy())
    for i, j in thick.items():
        _difference(process, deviations, found, i, j)
    return found


def _carried(process, deviations, names, sigma, steps) -> Sensitivities:
    """Derivatives with the compliance as it is, in blocks of samples."""
    model = process.model
    size = sum(rows.shape[0] for rows in model.rows.values()) * (len(names) + 1)
    block = max(1, AT_ONCE // max(size, 1))
    pieces = []
    for run, each in process.parted(deviations):
        for first in range(run.start, run.stop, block):
            some = slice(first, min(first + block, run.stop))
            frozen = None if steps is None else {key: trail[some] for key, trail in steps.items()}
            piece = _Sensitivity(each, deviations[some], names, sigma, frozen).found()
            _take_sides(each, deviations[some], piece)
            pieces.append(piece)
    return Sensitivities.join(pieces)


def _difference(process, deviations: np.ndarray, found: Sensitivities, i: int, j: int) -> None:
    """Put the derivatives with respect to a thickness, input i and deviation j, into those that were found: central
    differences along the same steps, for the compliance itself changes with it."""
    step = np.zeros(deviations.shape[1])
    step[j] = THINNER * next(part.sheet[0] for part in process.model.scene.parts
                             if part.name == process.model.scene.deviations[j].part)  # fmt: skip
    low, high = (
        _carried(process, deviations + way * step, found.inputs[i : i + 1], np.zeros(1), found.steps)
        for way in (-1.0, 1.0)
    )
    found.jacobian[:, :, i] = (high.measurements - low.measurements) / (2 * step[j])
    found.jacobian[found.failed, :, i] = np.nan
    found.reach_along[:, i] = np.nan
    for stage, own in found.contacts.items():
        slope = high.contacts[stage].force - low.contacts[stage].force
        own.force_slope[..., i] = slope / (2 * step[j])
        own.slip_slope[..., i] = np.nan


def _take_sides(process, deviations: np.ndarray, found: Sensitivities) -> None:
    """Of samples at a change of state, find the derivatives to either side, the steps of their paths frozen."""
    there = np.flatnonzero(~found.failed & (found.reach <= AT_CHANGE))
    for i, (name, σ) in enumerate(zip(found.inputs, found.sigma)) if there.size else ():
        own = there[found.reach_along[there, i] <= BESIDE]
        if not own.size:
            continue
        way = σ * (BESIDE + 2 * found.reach_along[own, i])
        both, aside = np.tile(own, 2), np.concatenate([-way, way])
        steps = {key: trail[both] for key, trail in found.steps.items()}
        beside = _Sensitivity(process, deviations[both], [name], np.array([σ]), steps, aside)
        if beside.inputs.places:
            found.sides[own, :, i] = np.nan
            continue
        sides = beside.found()
        slope = np.where((sides.exact & ~sides.failed)[:, None], sides.jacobian[:, :, 0], np.nan)
        found.sides[own, :, i] = slope.reshape(2, len(own), -1).transpose(1, 2, 0)


class _Sensitivity:
    """A batch of samples, with one more assembly for each sample and input: sample by sample, its inputs in a row.

    With `aside` (n,), its one input is so far from where the sample has it.
    """

    def __init__(self, process, deviations, names, sigma, steps, aside=None):
        self.process, self.names, self.sigma, self.frozen = process, names, sigma, steps
        self.n, self.p = len(deviations), len(names)
        self.inputs = Inputs.of(process.model, names)
        self.drive, self.slope_drive = process.asked(deviations), self.inputs.drive(process, deviations)
        self.aside = np.zeros(self.n) if aside is None else aside
        if aside is not None:
            self.drive = _beside(self.drive, self.slope_drive, aside)
        self.steps: dict[tuple[str, int], np.ndarray] = {}
        self.reach, self.where = np.full(self.n, np.inf), np.full(self.n, "", dtype=object)
        self.along, self.exact = np.full((self.n, self.p), np.inf), np.ones(self.n, dtype=bool)

    def found(self) -> Sensitivities:
        state, slope = self.process.start(self.n), self.process.start(self.n * self.p)
        contacts, read = {}, (np.zeros((self.n, 0)), np.zeros((self.n * self.p, 0)))
        for stage in self.process.stages:
            before, last = slope, None
            for number, eliminated in enumerate(stage.needed):
                state, slope, end = self._step(stage, number, eliminated, state, slope)
                last = end or last
            if last is not None:
                contacts[stage.plan.name] = self._contacts(state, slope, before, last)
            if stage.plan.reads:
                read = (
                    state.reading["measurement"] + self.drive.measured,
                    slope.reading["measurement"] + self.slope_drive.measured,
                )
        values, jacobian = read[0], self._columns(read[1])
        if values.size:
            characteristics = self.process.model.characteristics
            jacobian = np.matmul(characteristics.tangent(values), jacobian)
            values = characteristics.values(values)
        jacobian[state.failed] = np.nan
        return Sensitivities(
            self.process.law,
            self.names,
            self.sigma,
            values,
            jacobian,
            np.repeat(jacobian[..., None], 2, axis=-1),
            contacts,
            self.reach,
            self.along,
            self.where,
            state.failed,
            self.exact,
            self.steps,
        )

    def _columns(self, slope: np.ndarray) -> np.ndarray:
        """(n, ..., p) from (n p, ...)."""
        return np.moveaxis(slope.reshape(self.n, self.p, *slope.shape[1:]), 1, -1)

    def _rows(self, slope: np.ndarray) -> np.ndarray:
        """(n p, ...) from (n, ..., p)."""
        return np.moveaxis(slope, -1, 1).reshape(self.n * self.p, *slope.shape[1:-1])

    def _step(self, stage: PreparedStage, number: int, eliminated: EliminatedStep, state, slope):
        """The states after a step, and where its contacts ended; None where they were not resolved."""
        driven, plain = (replace(eliminated, step=step) for step in self._limited(eliminated.step))
        sides = (driven, state, self.drive), (plain, self._moved(state, slope), self.slope_drive)
        ramps = [stage.ramp(each.step, of, drive) for each, of, drive in sides]
        shift = Shift.of(self.inputs.places, stage, eliminated)
        places = [
            (drive.target if each.step.sets_down else of.reading)["rest"][:, each.rest.row] for each, of, drive in sides
        ]
        ends = [(of.force, of.left, of.anchor, stage.stopped(each.step, of)) for each, of, _ in sides]
        end: End | None = None
        converged = None
        if stage.solved(eliminated):
            stops = stage.stops(eliminated)
            starts, stop = (
                [
                    stage.unloaded(each, drive, ramp, place, s)
                    for (each, _, drive), ramp, place in zip(sides, ramps, places)
                ]
                for s in (0.0, 1.0)
            )
            bend = shift.bend()
            for s, (_, moved) in enumerate((starts, stop)):
                shift.load(moved, self.p, *_driven(ramps[0], places[0], float(s)))
            over, slope_over = (
                stage.overlap(each, of, drive, start) for (each, of, drive), start in zip(sides, starts)
            )
            if bend is not None and eliminated.step.settles:
                touching = np.column_stack([state.force.reshape(self.n, -1), np.zeros((self.n, stops.count))])
                normal = slice(0, stops.rows, stops.dimension)
                slope_over[:, normal] -= self._rows(bend.under(touching, self.p))[:, normal]
            starts[0] += np.maximum(0.0, over)
            starts[1] += np.where(np.repeat(over > 0.0, self.p, axis=0), slope_over, 0.0)
            trail, converged = self._trail(stage, number, eliminated, state, starts[0], stop[0])
            end = self._retraced(
                self._out(eliminated),
                self._contact(stage, eliminated, bend),
                self._varied(*(stops.spread(one) for one in starts)),
                self._varied(*(stops.spread(one) for one in stop)),
                self._varied(*(_with_stops(stops, of.anchor) for _, of, _ in sides)),
                trail,
            )
            self.exact &= end.solved | ~converged
            self._reach(stage, eliminated, end)
            found = (end.force, end.displacement, end.anchor)
            ends = [
                _split(stops, self.drive.gap, *(one.value for one in found)),
                _split(stops, self.slope_drive.gap, *(self._rows(one.slope) for one in found)),
            ]

        def left_behind(side: int, solved: np.ndarray | None) -> ProcessState:
            each, of, drive = sides[side]
            force, left, anchor, stop = ends[side]
            return stage.after(each, of, drive, ramps[side], places[side], force, left, anchor, stop, solved)

        after = left_behind(0, converged)
        slope_after = left_behind(1, None if end is None else np.ones(self.n * self.p, dtype=bool))
        if len(shift):
            shift.read(stage, slope_after, after, self.p, *_driven(ramps[0], places[0], 1.0), end is not None)
        return after, slope_after, end

    def _retraced(self, out: np.ndarray, contact: Contact, start: Varied, end: Varied, anchor: Varied, trail) -> End:
        """The paths; of samples that are beside their own under the friction there, and contacts may touch that never
        did, but for those that take no part, `out`."""
        if not self.aside.any():
            return retrace(contact, start, end, anchor, trail)
        ends = []
        for i, way in enumerate(self.aside):
            coefficient = np.maximum(contact.friction.coefficient + way * contact.rougher[:, 0], 0.0)
            there = replace(contact, friction=replace(contact.friction, coefficient=coefficient))
            b0, b1, stands = (Varied(one.value[i : i + 1], one.slope[i : i + 1]) for one in (start, end, anchor))
            also = np.zeros(len(out), dtype=bool)
            while True:
                found = retrace(there, b0, b1, stands, trail[i : i + 1], also)
                new = ~out & ~also & (found.state[0] == OPEN) & (found.normal.value[0] < -TOUCHES)
                if not new.any():
                    break
                also |= new
            ends.append(found)
        return End.join(ends)

    def _moved(self, state: ProcessState, slope: ProcessState) -> ProcessState:
        """The slopes of the state, what rows read where they move."""
        if not self.inputs.places:
            return slope
        reading = {kind: values.copy() for kind, values in slope.reading.items()}
        for place in self.inputs.places:
            kind, row = place.row
            reading[kind][place.input :: self.p, row] += state.reading["position"][:, place.number]
        return replace(slope, reading=reading)

    def _limited(self, step: Step) -> tuple[Step, Step]:
        """The step with limits that push with what the samples have, and with what a unit of each input adds."""
        none = np.zeros(self.p)

        def unit(limits):
            return tuple(
                replace(limit, force=np.tile(self.inputs.limit.get(limit.row, none), self.n)) for limit in limits
            )

        units = replace(step, limits=unit(step.limits), dropped_limits=unit(step.dropped_limits))
        if not (self.aside.any() and self.inputs.limit):
            return step, units

        def beside(limits, of):
            return tuple(replace(limit, force=limit.force + self.aside * one.force) for limit, one in zip(limits, of))

        moved = beside(step.limits, units.limits), beside(step.dropped_limits, units.dropped_limits)
        return replace(step, limits=moved[0], dropped_limits=moved[1]), units

    def _varied(self, value, slope) -> Varied:
        return Varied(value, self._columns(slope))

    def _trail(self, stage: PreparedStage, number: int, eliminated, state, b0, b1):
        """The steps (n,) that the contacts take, and whether the samples met their tolerance."""
        key = stage.plan.name, number
        if self.frozen is not None:
            self.steps[key] = self.frozen[key]
            return self.frozen[key], np.ones(self.n, dtype=bool)
        stops, d = stage.stops(eliminated), self.process.model.contacts.dimension
        force = np.column_stack([state.force.reshape(self.n, stops.rows), stage.stopped(eliminated.step, state)])
        anchor = _with_stops(stops, state.anchor).reshape(self.n, stops.total, d - 1)
        path: Path = replace(stage.path, recorded=True)
        way = np.stack([stops.spread(b0), stops.spread(b1)], axis=1)
        found = stage.solver(eliminated).follow(way, stops.spread(force), anchor, path)
        trail: Any = found.trail
        self.steps[key] = trail
        return trail, found.converged

    def _contact(self, stage: PreparedStage, eliminated: EliminatedStep, bend: Bend | None) -> Contact:
        contacts, law = self.process.model.contacts, stage.solver(eliminated).law
        stops = stage.stops(eliminated)
        friction = stops.friction(contacts.friction_in(stage.plan.name))
        rougher = np.concatenate([self.inputs.rougher, np.zeros((stops.count, self.p))])
        if law.varies and friction.pressure is not None:
            rougher[: stops.contacts][~np.isnan(contacts.pressure[:, 0, 0])] = 0.0
        return Contact(
            law,
            stops.compliance(*eliminated.compliance),
            friction if law.frictional else Friction.of(0.0, stops.total),
            rougher,
            contacts.dimension,
            bend and Bend(stops.spread(bend.left), stops.spread(bend.lean), bend.whose),
        )

    def _contacts(self, state: ProcessState, slope: ProcessState, before: ProcessState, end: End) -> ContactSensitivity:
        m = state.force.shape[1]
        return ContactSensitivity(
            state.force,
            end.state[:, :m],
            self._columns(slope.force),
            self._columns(slope.left[:, :, 1:] - before.left[:, :, 1:]),
        )

    def _out(self, eliminated: EliminatedStep) -> np.ndarray:
        """(m + s,) contacts that take no part in a step."""
        step, contacts = eliminated.step, self.process.model.contacts
        return np.concatenate([contacts.out(step.nuggets, step.away), np.zeros(len(step.stops), dtype=bool)])

    def _reach(self, stage: PreparedStage, eliminated: EliminatedStep, end: End) -> None:
        """Note what changes its state nearest, should it be nearer than all before."""
        there = ~self._out(eliminated)
        for margin in (end.normal, end.cone):
            size = np.abs(margin.value)
            finite = np.where(np.isfinite(size), size, 0.0)
            pushed = np.abs(margin.slope) * self.sigma
            joint = np.linalg.norm(pushed, axis=2)
            rests = np.maximum(finite, joint) <= RESTS * finite.max(axis=1, keepdims=True, initial=0.0)
            counts = there & np.isfinite(size) & ~rests & (joint > 0.0)
            distance = np.where(counts, finite / np.where(counts, joint, 1.0), np.inf)
            along = np.where(
                counts[:, :, None] & (pushed > 0.0), finite[:, :, None] / np.where(pushed > 0, pushed, 1.0), np.inf
            )
            self.along = np.minimum(self.along, along.min(axis=1, initial=np.inf))
            if not distance.shape[1]:
                continue
            nearest = distance.argmin(axis=1)
            for i, k in enumerate(nearest):
                if distance[i, k] < self.reach[i]:
                    self.reach[i] = distance[i, k]
                    self.where[i] = self._told(stage, eliminated, int(k), end.state[i, k], margin is end.cone)

    def _told(self, stage: PreparedStage, eliminated: EliminatedStep, k: int, state: int, slips: bool) -> str:
        """In words what changes."""
        model = self.process.model
        what = "slips" if slips else "closes" if state == 0 else "opens"
        if k >= len(model.contacts):
            kind, row = eliminated.step.stops[k - len(model.contacts)].row
            return f"{stage.plan.name}: the stop of {model.labels[kind][row]} {what}"
        return f"{stage.plan.name}: contact {k} of zone {model.scene.zones[model.contacts.zone[k]].name} {what}"


def _with_stops(stops: Stops, anchor: np.ndarray) -> np.ndarray:
    """(n, (d - 1)(m + s)) anchors of contacts (n, m, d - 1), and of stops, which have none."""
    n, _, sides = anchor.shape
    return np.column_stack([anchor.reshape(n, stops.contacts * sides), np.zeros((n, stops.count * sides))])


def _split(stops: Stops, gap, force, u, anchor) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
    """Forces of contacts (n, m, d), where they were left and their anchors, and forces (n, s) of stops."""
    shape = len(force), stops.contacts, stops.dimension
    left = u[:, : stops.rows].reshape(shape).copy()
    left[:, :, 0] -= gap
    sides = stops.dimension - 1
    return (
        force[:, : stops.rows].reshape(shape),
        left,
        anchor[:, : stops.contacts * sides].reshape(*shape[:2], sides),
        force[:, stops.rows :: stops.dimension],
    )


def _driven(ramp: Ramp, place: np.ndarray, s: float) -> tuple[np.ndarray, np.ndarray]:
    """Values and loads of a step's rows at s of the ramp."""
    v, loads = ramp.at(s)
    return np.column_stack([v, place]), loads


def _beside(drive: Drive, slope: Drive, way: np.ndarray) -> Drive:
    """What drives samples that are so far (n,) along their input."""
    moved = {
        one.name: getattr(drive, one.name) + way[:, None] * getattr(slope, one.name)
        for one in fields(Drive)
        if one.name != "target"
    }
    return Drive({kind: value + way[:, None] * slope.target[kind] for kind, value in drive.target.items()}, **moved)
