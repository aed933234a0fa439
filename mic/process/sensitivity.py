"""Exact derivatives of key characteristics, contact forces and slip with respect to the inputs of an assembly.

Between contact problems everything is linear, so that the derivatives take the very steps of the process: what a stage
hands to the next (readings, where contacts were left, what welds froze, reactions that are let go, forces of stops) is
handed on with its derivatives, one more assembly for each input, driven by what a unit of the input asks. Contact is
differentiated where it is solved (:mod:`mic.contact.tangent`), with its states known and the steps of its path frozen.

Where a row moves in its sheet, by δ along a tangent, it reads ``ℓ·y + δ a'·y`` and pushes with ``λ (ℓ + δ a')``: S, T
and L of what was eliminated with ℓ change (:mod:`mic.process.moving_rows`), S by ``-T αᵀ - α Tᵀ`` with α what a load on a'
moves.

Inputs are called as :mod:`mic.process.inputs` says.

A thickness changes the compliance itself, and so does a shape that the stiffness follows: with respect to these central
differences are taken, along the same steps.
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
from mic.model.rest_rows import separating_motion_slope
from mic.process.drive import Drive
from mic.process.force_limits import Stops
from mic.process.inputs import Inputs, known_inputs
from mic.process.moving_rows import Shift
from mic.process.path import Ramp
from mic.process.plan import Step
from mic.process.resting_parts import Leg
from mic.process.stage import EliminatedStep, PreparedStage
from mic.process.state import ProcessState
from mic.system.matrix_product import one_thread

__all__ = ["AT_CHANGE", "ContactSensitivity", "Sensitivities", "known_inputs", "sensitivities"]

#: A contact this near a change of state, of the largest gap or force, along which no input moves it, stays on it.
RESTS = 1e-10
#: A sample is at a change of state if it is no farther from it, in standard deviations; and how far beside it, and
#: beyond twice the way to it, derivatives to either side are taken.
AT_CHANGE, BESIDE = 1e-6, 1e-5
#: mm: what overlaps by more there closes.
TOUCHES = 1e-11
#: Of where resting parts lie: rounds, what their springs may carry then, of the largest force; stiffness that is none,
#: of the largest; and what may be left of a derivative where nothing holds them.
ROUNDS, SETTLED, FREE, LOOSE = 20, 1e-11, 1e-9, 1e-6
#: Values of samples and their derivatives that are carried at once: memory.
AT_ONCE = 2_000_000

#: Half the step of differences: of a sheet's thickness, and in standard deviations of a shape that stiffness follows.
THINNER, ASIDE = 1e-4, 1e-2

#: The steps that paths took: by stage and the step's number, the trail (n,) of each sample.
Steps = Mapping[tuple, np.ndarray]


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
        Derivatives of the tangential displacement since the stage before, mm per unit; NaN for what changes compliance.
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
        smaller values of the input and towards larger; NaN where there is no solution to be followed there, for places
        in sheets, and for shapes that the stiffness follows. Of others, and along inputs that do not lead to the
        change, the derivatives themselves.
    contacts : dict of str to ContactSensitivity
        By stage.
    reach : (n,) array
        How far the sample is from the next change of a contact's state at the end of a step of the process, to first
        order, in standard deviations along the direction in which all inputs together change it most; infinite if none
        does.
    reach_along : (n, p) array
        Likewise along each input alone; infinite for those without standard deviation, NaN along a thickness, which the
        reach of all inputs together leaves out. Of shapes that the stiffness follows, as if it did not.
    where : (n,) object array of str
        Which contact changes its state there.
    failed : (n,) bool array
        Samples whose contact missed its tolerance; their derivatives are NaN, as are those of samples in which nothing
        determines where a resting part lies.
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


def _refuse_resting(process) -> None:
    for stage in process.stages:
        for each in stage.steps:
            if each.rest.soft.any():
                part = next(own for own, soft in zip(each.rest.name, each.rest.soft) if soft)
                raise SceneError(
                    f"stages ({stage.plan.name}): part {part!r} rests by contact alone there, and no derivative by "
                    "places in sheets is taken of it; leave these inputs out, or give the part six locators"
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
        Where parts rest by contact alone, and places in sheets are inputs.
    """
    model = process.model
    names = list(model.parameters if inputs is None else inputs)
    asked = Inputs.of(model, names)
    if asked.places:
        _refuse_resting(process)
    own = inputs if isinstance(inputs, Mapping) else known_inputs(model)
    sigma = np.array([own[name] for name in names])
    steps_of = _differenced(model, names)
    thick = [i for i, (j, _) in steps_of.items() if model.scene.deviations[j].kind == "thickness"]
    reaching = np.where(np.isin(np.arange(len(names)), thick), 0.0, sigma)
    found = _carried(process, deviations, names, reaching, steps)
    if not steps_of:
        return found
    found = replace(
        found,
        sigma=sigma,
        **{name: getattr(found, name).copy() for name in ("jacobian", "sides", "reach_along")},
    )
    for i, (j, step) in steps_of.items():
        _difference(process, deviations, found, i, j, step)
        if i in thick:
            found.reach_along[:, i] = np.nan
        else:
            there = (found.reach <= AT_CHANGE) & (found.reach_along[:, i] <= BESIDE)
            found.sides[:, :, i] = np.where(there[:, None], np.nan, found.jacobian[:, :, i])[..., None]
    return found


def _differenced(model, names: Sequence[str]) -> dict[int, tuple[int, float]]:
    """Of the inputs that change the compliance, by their numbers, the number of the deviation and half the step."""
    follows = [] if model.slopes is None else model.slopes.source.tolist()
    found = {}
    for j, one in enumerate(model.scene.deviations):
        if one.name in names and one.kind == "thickness":
            thickness = next(part.sheet[0] for part in model.scene.parts if part.name == one.part)
            found[names.index(one.name)] = j, THINNER * thickness
        elif one.name in names and j in follows:
            found[names.index(one.name)] = j, ASIDE * one.sigma
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


def _difference(process, deviations: np.ndarray, found: Sensitivities, i: int, j: int, half: float) -> None:
    """Put the derivatives with respect to what changes the compliance, input i and deviation j, into those that were
    found: central differences along the same steps."""
    step = np.where(np.arange(deviations.shape[1]) == j, half, 0.0)
    low, high = (
        _carried(process, deviations + way * step, found.inputs[i : i + 1], np.zeros(1), found.steps)
        for way in (-1.0, 1.0)
    )
    found.jacobian[:, :, i] = (high.measurements - low.measurements) / (2 * half)
    found.jacobian[found.failed, :, i] = np.nan
    for stage, own in found.contacts.items():
        slope = high.contacts[stage].force - low.contacts[stage].force
        own.force_slope[..., i] = slope / (2 * half)
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
        self.loose = np.zeros(self.n, dtype=bool)
        self.aside = np.zeros(self.n) if aside is None else aside
        if aside is not None:
            self.drive = _beside(self.drive, self.slope_drive, aside)
        self.steps: dict[tuple, np.ndarray] = {}
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
        jacobian[state.failed | self.loose] = np.nan
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
            state.failed | self.loose,
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
            anchors = [of.anchor for _, of, _ in sides]
            soft = eliminated.rest.soft.any()
            if soft and eliminated.step.settles:
                self._put_down(stage, eliminated, sides, ramps, places, anchors)
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
            lifts = [np.maximum(0.0, over), np.where(np.repeat(over > 0.0, self.p, axis=0), slope_over, 0.0)]
            stands = self._varied(*(_with_stops(stops, one) for one in anchors))
            if soft:
                end, converged = self._laid(stage, number, eliminated, ramps, places, starts, stop, lifts, ends, stands)
            else:
                starts = [start + lift for start, lift in zip(starts, lifts)]
                trail, converged = self._trail(stage, number, eliminated, state, starts[0], stop[0])
                end = self._retraced(
                    self._out(eliminated),
                    self._contact(stage, eliminated, bend),
                    self._varied(*(stops.spread(one) for one in starts)),
                    self._varied(*(stops.spread(one) for one in stop)),
                    stands,
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

    def _put_down(self, stage, eliminated, sides, ramps, places, anchors) -> None:
        """Where resting parts are put down, and the anchors, which go with them: in place, with their slopes."""
        (_, state, drive), (plain, _, slope_drive) = sides
        start = stage.unloaded(eliminated, drive, ramps[0], places[0], 0.0)
        slope = self._columns(stage.unloaded(plain, slope_drive, ramps[1], places[1], 0.0))
        place, anchor = stage.separating_motion(eliminated, state, start, places[0])
        soft, (_, m, d) = eliminated.rest.soft, state.force.shape
        G = eliminated.rest.springs(eliminated.response)[1][: m * d].reshape(m, d, -1)
        G = np.where(self._out(eliminated)[:m, None, None], 0.0, G)
        moved, turned = self._columns(places[1]), self._columns(anchors[1])
        for i in np.flatnonzero((place != places[0]).any(axis=1)):
            way = (place - places[0])[i, soft]
            own = separating_motion_slope(start[i, : m * d : d], slope[i, : m * d : d], G[:, 0], way)
            moved[i, soft] += own
            turned[i] += np.einsum("mjk,kp->mjp", G[:, 1:], own)
        places[:], anchors[:] = [place, self._rows(moved)], [anchor, self._rows(turned)]

    def _laid(self, stage, number, eliminated, ramps, places, starts, stop, lifts, ends, anchor):
        """Where contacts end in a step whose parts rest, and whether they were settled; `places` are where the parts
        come to lie.

        Where a part lies is one more input of a leg, q̄, of which nothing is left to carry for its springs: ``λ(x, q̄) =
        0`` (:mod:`mic.process.resting_parts`).
        """
        rest, response, stops = eliminated.rest, eliminated.response, stage.stops(eliminated)
        (c, G), law = rest.springs(response), stage.solver(eliminated).law
        k, p = int(rest.soft.sum()), self.p
        contact = self._contact(stage, eliminated, None)
        contact = replace(contact, rougher=np.pad(contact.rougher, ((0, 0), (0, k))))
        drawn = self._varied(*(place[:, rest.soft] for place in places))
        force = self._varied(*(np.column_stack([f.reshape(len(f), -1), s]) for f, _, _, s in ends))
        at, s0, converged = drawn, 0.0, np.ones(self.n, dtype=bool)

        def loads(s: float) -> tuple[Varied, Varied]:
            """b, and what the rest rows are left with, at s of the step."""
            b = [(1 - s) * (start + lift) + s * last for start, lift, last in zip(starts, lifts, stop)]
            return self._varied(*b), self._varied(*(rest.pushed(response, ramp.at(s)[1]) for ramp in ramps))

        for leg, (s1, path) in enumerate(rest.legs(stage.path, law)):
            (b0, _), (b1, e1) = loads(s0), loads(s1)
            trail, target, good = self._settled(
                stage, number, leg, eliminated, (loads(s0), loads(s1)), drawn, at, force, anchor, path
            )
            converged &= good
            begin = _plus(b0, _times(_minus(_minus(at, drawn), _scaled(c, _times(force, G))), G.T))
            ahead = _minus(b1, _times(_plus(drawn, _scaled(c, e1)), G.T))
            none = np.zeros((self.n, len(G), k))
            for _ in range(ROUNDS):
                end = Varied(ahead.value + target @ G.T, np.concatenate([ahead.slope, none + G], axis=2))
                found = self._retraced(
                    self._out(eliminated),
                    contact,
                    _spread(stops, Varied(begin.value, np.concatenate([begin.slope, none], axis=2))),
                    _spread(stops, end),
                    Varied(anchor.value, np.pad(anchor.slope, ((0, 0), (0, 0), (0, k)))),
                    trail,
                )
                f = _gathered(stops, found.force)
                λ, M = e1.value - f.value @ G, np.einsum("rk,nrj->nkj", G, f.slope[:, :, p:])
                scale = np.maximum(np.abs(f.value).max(axis=1, initial=0.0), np.abs(e1.value).max(axis=1, initial=0.0))
                if (np.abs(λ).max(axis=1) <= SETTLED * scale).all():
                    break
                target = target + _least(M, λ[..., None])[..., 0]
            before = e1.slope - np.einsum("rk,nrp->nkp", G, f.slope[:, :, :p])
            dq = at.slope + _least(M, before - M @ at.slope)
            left = np.abs(before - M @ dq).max(axis=(1, 2), initial=0.0)
            self.loose |= left > LOOSE * np.maximum(np.abs(before).max(axis=(1, 2), initial=0.0), 1e-300)
            found = _combined(found, p, dq)
            force, anchor, at = _gathered(stops, found.force), found.anchor, Varied(target, dq)
            self.exact &= found.solved | ~good
            s0 = s1
        for side, values in enumerate((at.value, self._rows(at.slope))):
            places[side] = places[side].copy()
            places[side][:, rest.soft] = values
        return found, converged

    def _settled(self, stage, number, leg, eliminated, loads, drawn, at, force, anchor, path):
        """The steps (n,) that the contacts take on a leg, where its parts come to lie (n, k), and whether they do."""
        key, lies = (stage.plan.name, number, leg), (stage.plan.name, number, leg, "at")
        if self.frozen is not None:
            self.steps[key], self.steps[lies] = self.frozen[key], self.frozen[lies]
            return self.frozen[key], np.stack(list(self.frozen[lies])), np.ones(self.n, dtype=bool)
        rest, response, stops = eliminated.rest, eliminated.response, stage.stops(eliminated)
        solver, sides = stage.solver(eliminated), stops.dimension - 1
        (b0, e0), (b1, e1) = loads

        def follow(start, end, pressed, stands, path):
            way = np.stack([stops.spread(start), stops.spread(end)], axis=1)
            none = np.zeros((len(start), stops.count, sides))
            recorded = replace(path, recorded=True)
            found = solver.follow(way, stops.spread(pressed), np.concatenate([stands, none], axis=1), recorded)
            solution, stopped = stops.split(found)
            return solution, np.column_stack([solution.force, stopped])

        stands = anchor.value.reshape(self.n, stops.total, sides)[:, : stops.contacts]
        moving = Leg(b0.value, b1.value, e0.value, e1.value)
        solution, pressed, place = rest.settle(
            response, moving, drawn.value, at.value, force.value, stands, follow, path
        )
        c, G = rest.springs(response)
        target = place + c * (e1.value - pressed @ G)
        trail: Any = solution.trail
        kept = np.empty(self.n, dtype=object)
        kept[:] = list(target)
        self.steps[key], self.steps[lies] = trail, kept
        return trail, target, solution.converged

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
        return np.concatenate([contacts.excluded(step.nuggets, step.away), np.zeros(len(step.stops), dtype=bool)])

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


def _plus(one: Varied, other: Varied) -> Varied:
    return Varied(one.value + other.value, one.slope + other.slope)


def _minus(one: Varied, other: Varied) -> Varied:
    return Varied(one.value - other.value, one.slope - other.slope)


def _scaled(factor: float, one: Varied) -> Varied:
    return Varied(factor * one.value, factor * one.slope)


def _times(one: Varied, matrix: np.ndarray) -> Varied:
    """``X A``, of rows (n, r) and A (r, k)."""
    return Varied(one.value @ matrix, np.einsum("nrp,rk->nkp", one.slope, matrix))


def _spread(stops: Stops, one: Varied) -> Varied:
    """As the solver has it."""
    slope = [stops.spread(one.slope[:, :, i]) for i in range(one.slope.shape[2])]
    return Varied(stops.spread(one.value), np.stack(slope, axis=2))


def _gathered(stops: Stops, force: Varied) -> Varied:
    """(n, d m + s) forces of contacts and stops, as the stage has them."""
    own = np.concatenate([np.arange(stops.rows), np.arange(stops.rows, force.value.shape[1], stops.dimension)])
    return Varied(force.value[:, own], force.slope[:, own])


def _combined(end: End, p: int, more: np.ndarray) -> End:
    """With what the inputs behind the first p change when these (n, k, p) move them."""

    def own(one):
        return Varied(one.value, one.slope[:, :, :p] + one.slope[:, :, p:] @ more) if isinstance(one, Varied) else one

    return End(**{one.name: own(getattr(end, one.name)) for one in fields(End)})


def _least(matrix: np.ndarray, right: np.ndarray) -> np.ndarray:
    """(n, k, p) least solutions of systems (n, k, k) that may leave motions free."""
    return np.matmul(np.linalg.pinv(matrix, rcond=FREE), right)
