"""One stage by full finite elements, step by step, without reduction.

The load parameter s goes from 0 to 1 over a step of the stage:

- bilateral rows obey ``B u = v(s)``, from their readings before the step to their targets;
- forces of removed rows and removed loads decrease as ``p(s) = (1 − s) Bᵣᵀ r``;
- the gap of a contact is ``g = g⁰ + n·(shape deviation) + δ_n``. While parts settle, v and p are constant, and each
  overlap ``−(g⁰ + δ_n)``, computed with the contact forces that already act, is closed from touching;
- a row pushed towards its position by a limited force (:class:`mic.process.plan.Limit`) is a load with a stop, which
  is a frictionless contact. If the part starts beyond the position, the stop moves it back;
- parts that rest by contact alone are on soft springs, moved in every solve until they carry no force (method of
  multipliers);
- slip is measured from the contact's previous position, in increments or along a followed path
  (:mod:`fem_reference.full.path`).
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from functools import partial

import numpy as np

from fem_reference.full.discretisation import Discretisation
from fem_reference.full.equilibrium import State
from fem_reference.full.friction import ContactFriction
from fem_reference.full.load_path import ContactFailure, Contacts, LoadPath, Penalty, Route, Solve, Springs
from fem_reference.full.path import TOUCHING, FullTrace, Point, extrapolated, increments, shares, transition
from mic.errors import FreeMotion
from mic.model.rest_rows import separating_motion
from mic.process.actions import ResolveOverlap
from mic.process.drive import Drive
from mic.process.plan import StagePlan, Step, row_compliance

__all__ = ["FullResolution", "FullStage", "FullState"]

ROUNDING = 1e-8  # relative to the largest force: a smaller change is rounding
FAR = 1e3  # mm: gap given to contacts excluded by a weld
FIRST = 0.01  # share of a followed path at which resting parts first get support


@dataclass(frozen=True)
class FullResolution:
    """Contact solution of one stage; conventions of :class:`mic.process.evaluation.Resolution`.

    Attributes
    ----------
    stage : str
    force : (m, d) array
        N; normal compression positive.
    displacement : (m, d) array
        mm; the normal component is the gap, the tangential ones the slip since the stage before.
    state : (m,) array
        A :class:`mic.contact.states.ContactState` each.
    reaction : (b,) array
        Forces of the bilateral rows on the parts, N or N mm, in the plan's order; 0 for redundant rows.
    trace : FullTrace
        History of the contacts; shares refer to the steps that resolve contact.
    pushed, left : (p,) array
        Force of each clamp or gun of limited force at its check, N, and its remaining distance, mm.
    """

    stage: str
    force: np.ndarray
    displacement: np.ndarray
    state: np.ndarray
    reaction: np.ndarray
    trace: FullTrace
    pushed: np.ndarray
    left: np.ndarray


@dataclass(frozen=True)
class FullState:
    """One assembly at the end of a stage.

    Attributes
    ----------
    solution : State
        Freedoms, reactions of the independent bilateral rows, contact forces.
    left : (m, d) array
        Relative displacement δ of each contact, mm.
    anchor : (m, d - 1) array
        Position from which further slip is measured, mm: δ_t, or the slider's position if the contact yields.
    reaction : dict of (str, int) to float
        Forces of the bilateral rows on the parts, N or N mm.
    push : dict of int to float
        Forces of the clamp rows that push, N.
    stop : dict of (str, int) to float
        Forces of the stops on rows that a limited force pushes, N.
    frozen : dict of int to float
        Relative displacement that each weld row prescribes.
    """

    solution: State
    left: np.ndarray
    anchor: np.ndarray
    reaction: Mapping[tuple[str, int], float] = field(default_factory=dict)
    push: Mapping[int, float] = field(default_factory=dict)
    stop: Mapping[tuple[str, int], float] = field(default_factory=dict)
    frozen: Mapping[int, float] = field(default_factory=dict)

    @classmethod
    def start(cls, freedoms: int, m: int, d: int) -> FullState:
        """Free, unloaded parts."""
        none = np.zeros((m, d))
        return cls(State(np.zeros(freedoms), np.zeros(0), none), none, none[:, 1:])


@dataclass(frozen=True)
class FullStage:
    """A stage of the full model.

    Attributes
    ----------
    plan : StagePlan
    mesh : Discretisation
    friction : ContactFriction
        Friction of the law in this stage.
    penalty : Penalty
    tolerance : float
        Error tolerance of a followed path, mm (:func:`fem_reference.full.path.extrapolated`).
    route : {"whole", "condensed"}
        Route to try first (:mod:`fem_reference.full.load_path`).
    """

    plan: StagePlan
    mesh: Discretisation
    friction: ContactFriction
    penalty: Penalty
    tolerance: float
    route: Route

    def advance(self, state: FullState, drive: Drive) -> tuple[FullState, FullResolution | None, list[Solve]]:
        """Solve the stage for the single assembly of `drive`.

        Raises
        ------
        ContactFailure
        """
        start, ends, traces, solves, pushed = state, [], [], [], {}
        for number, step in enumerate(self.plan.steps, start=1):
            state = replace(state, frozen=self._make_welds(step, state, drive))
            if step.resolves or step.sets_down:
                if step.settles and step.resting:
                    state = self._put_down(step, state, drive)
                load_path = self._load_path(number, step, state, drive)
                if step.resolves and len(self.friction) + len(step.stops):
                    state, end, trace = self._resolve(step, load_path, state)
                    ends, traces, solves = [*ends, end], [*traces, trace], solves + load_path.solves
                else:
                    state = self._without_contact(step, load_path, state)
            else:  # no load changes: new welds hold the present displacement and take over the forces of their guns
                guns = {limit.row: limit.load - limit.sign * state.stop[limit.row] for limit in step.dropped_limits}
                state = replace(state, reaction={**state.reaction, **guns})
            reaction = {row: state.reaction.get(row, 0.0) for row in step.bilateral}
            push = {i: float(drive.push[0, i]) for i in step.loads}
            stop = {limit.row: state.stop.get(limit.row, 0.0) for limit in step.stops}
            state = replace(state, reaction=reaction, push=push, stop=stop)
            pushed |= {(number - 1, limit): self._pushed(limit, state, drive) for limit in step.limits}
        if not ends:
            return state, None, solves
        trace = sum(traces[1:], traces[0])
        trace = replace(trace, share=trace.share / len(traces))
        checked = np.array([pushed[limit] for limit in self.plan.checked_limits]).reshape(-1, 2)
        return state, self._resolution(start, state, ends[-1], trace, drive, checked), solves

    def _position(self, limit, drive) -> float:
        """Target of the row that a limited force pushes: the clamp's target, or a closed gap at a gun's weld."""
        kind, row = limit.row
        if kind == "clamp":
            return float(drive.target["clamp"][0, row])
        return -float(drive.weld_gap[0, row])

    def _distance_left(self, limit, state, drive) -> float:
        """Signed distance of a limited force from its target, mm; negative beyond it."""
        kind, row = limit.row
        return limit.sign * (self._position(limit, drive) - float((self.mesh.rows[kind][row] @ state.solution.u)[0]))

    def _pushed(self, limit, state, drive) -> tuple[float, float]:
        """Force, N, and remaining distance, mm, of a limited force; a gun presses with its full force."""
        stop, distance = state.stop[limit.row], self._distance_left(limit, state, drive)
        return limit.force - stop * (limit.row[0] == "clamp"), distance if distance > TOUCHING else 0.0

    def _make_welds(self, step, state, drive):
        reading = self.mesh.rows["weld"] @ state.solution.u
        frozen = dict(state.frozen) | {row: float(reading[row]) for row in step.made}
        closed = step.closed(self.mesh.assembly.joints)
        return frozen | {row: -float(drive.weld_gap[0, row]) for row in closed}

    def _load_path(self, number, step: Step, state, drive) -> LoadPath:
        """Load path from the present values and loads to those at the end of the step."""
        mesh = self.mesh
        try:
            system = mesh.system(step)
            target = [state.frozen[i] if kind == "weld" else drive.target[kind][0, i] for kind, i in step.bilateral]
            soft = row_compliance(mesh.assembly.scene, step.bilateral)
            carried = np.array([state.reaction.get(row, 0.0) for row in step.bilateral])
            v0 = system.rows @ state.solution.u
            place = drive.target["rest"][0, system.place] if step.sets_down else v0[len(target) :].copy()
            v0[: len(target)] += 0.0 if soft is None else soft * carried
            v0 = system.consistent(v0)
            v1 = system.consistent(np.concatenate([target, place]))
        except (ValueError, FreeMotion) as error:
            raise ContactFailure(f"stage {self.plan.name!r}: {error}") from error
        p0, p1 = self._loads(step, state, drive)
        position = [limit.sign * self._position(limit, drive) for limit in step.stops]
        gap = np.concatenate([np.where(self._excluded(step), FAR, drive.gap[0]), position])
        overlap = np.zeros_like(gap)
        if step.settles:
            before = np.zeros((len(gap), state.left.shape[1]))
            before[: len(state.left)] = state.solution.force
            unloaded = system.equilibrium.linear(p0, v0, before)
            unloaded_gap = gap + mesh.contact(unloaded.u, step.stops)[:, 0]
            unloaded_gap[: len(state.left)] += mesh.assembly.contacts.layer * state.solution.force[:, 0]
            overlap = np.maximum(0, -unloaded_gap)
            overlap[overlap <= TOUCHING] = 0
        overlap[len(drive.gap[0]) :] = [
            0.0 if limit.row in state.stop else max(0.0, -self._distance_left(limit, state, drive))
            for limit in step.stops
        ]
        friction, layer = self.friction.with_stops(len(step.stops)), np.zeros(len(gap))
        layer[: len(drive.gap[0])] = mesh.assembly.contacts.layer
        return LoadPath(
            system.equilibrium,
            Contacts(friction, mesh.stiffness(step.stops), layer),
            (p0, v0, gap + overlap),
            (p1, v1, gap),
            self.penalty,
            self.route,
            (self.plan.name, number),
            partial(self._where, number, step),
            Springs(np.searchsorted(system.independent, system.soft), system.springs[system.springs > 0]),
        )

    def _where(self, number, step, share, contact) -> str:
        """Stage, step, share of the load and a contact for an error message."""
        assembly, where = self.mesh.assembly, ""
        if contact is not None:
            if contact < len(assembly.contacts):
                name = assembly.labels["contact"][contact * assembly.contacts.dimension].rsplit(" ", 1)[0]
            else:
                kind, row = step.stops[contact - len(assembly.contacts)].row
                name = assembly.labels[kind][row]
            where = f", worst at contact {name!r}"
        return f"stage {self.plan.name!r}, step {number} of {len(self.plan.steps)}, at {share:.3g} of its load{where}"

    def _put_down(self, step, state, drive) -> FullState:
        """Move resting parts without contact force, and their anchors, to where they do not overlap other parts.

        The contact displacements per unit of each rest row come from linear equilibria.
        """
        mesh, system = self.mesh, self.mesh.system(step)
        p, _ = self._loads(step, state, drive)
        v = (system.rows @ state.solution.u)[system.independent]
        none = np.zeros((len(state.left) + len(step.stops), state.left.shape[1]))
        start = system.equilibrium.linear(p, v, none)
        unit = np.eye(len(v))[np.searchsorted(system.independent, system.soft)]
        moved = [system.equilibrium.linear(p, v + displacement, none).u - start.u for displacement in unit]
        G = np.array([mesh.contact(u) for u in moved]).reshape(len(unit), *state.left.shape)
        G[:, self._excluded(step)] = 0.0
        touched = np.abs(G).max(axis=(0, 2), initial=0.0) > TOUCHING
        if state.solution.force[touched].any():
            return state
        by = separating_motion(drive.gap[0] + mesh.contact(start.u)[:, 0], G[:, :, 0].T)
        slid = np.einsum("k,kmd->md", by, G)
        solution = replace(state.solution, u=state.solution.u + np.tensordot(by, np.array(moved), 1))
        return replace(state, solution=solution, left=state.left + slid, anchor=state.anchor + slid[:, 1:])

    def _excluded(self, step) -> np.ndarray:
        """(m,) whether each contact is excluded by a weld or by a part that is away."""
        return self.mesh.assembly.contacts.excluded(step.welds, step.away)

    def _loads(self, step, state, drive):
        """Nodal forces (N,) at the step's start and at its end."""
        rows = self.mesh.rows
        p0, p1 = np.zeros((2, len(state.solution.u)))
        for i in step.loads + step.dropped_loads:
            p0 += rows["clamp"][i].T @ [state.push.get(i, 0.0)]
        for i in step.loads:
            p1 += rows["clamp"][i].T @ [drive.push[0, i]]
        for limit in step.stops:
            load = rows[limit.row[0]][limit.row[1]].T @ [limit.load]
            p0 += load * (limit.row in state.stop)
            p1 += load
        for limit in step.dropped_limits:
            p0 += rows[limit.row[0]][limit.row[1]].T @ [limit.load - limit.sign * state.stop[limit.row]]
        for kind, i in step.released:
            p0 += rows[kind][i].T @ [state.reaction[kind, i]]
        return p0, p1

    def _without_contact(self, step, load_path, state) -> FullState:
        """Linear equilibrium at the end of the load path; contacts keep their forces and get new anchors."""
        p, v, _ = load_path.end
        equilibrium = load_path.equilibrium
        none = np.zeros((len(step.stops), state.left.shape[1]))
        solution = equilibrium.linear(p, v, np.concatenate([state.solution.force, none]))
        solution = replace(solution, force=state.solution.force)
        touching = equilibrium.linear(p, v, np.zeros((len(state.left) + len(none), none.shape[1])))
        left = self.mesh.contact(touching.u)
        return self._after(step, state, solution, left, left[:, 1:])

    def _resolve(self, step, load_path, state) -> tuple[FullState, Point, FullTrace]:
        """Contact solution along the load path; without friction only its end is solved and slip is zero."""
        system, solve = self.mesh.system(step), load_path.solve
        reaction = np.zeros(system.rows.shape[0])
        reaction[: len(step.bilateral)] = [state.reaction.get(row, 0.0) for row in step.bilateral]
        reaction = reaction[system.independent]
        stops, m = step.stops, len(self.friction)
        force = np.zeros((len(stops), state.left.shape[1]))
        force[:, 0] = [state.stop.get(limit.row, 0.0) for limit in stops]
        start = load_path.start_point(
            State(state.solution.u, reaction, np.concatenate([state.solution.force, force])), state.anchor
        )
        settles = all(isinstance(action, ResolveOverlap) for action in step.move)
        if settles and (load_path.start[2] == load_path.end[2]).all():  # nothing overlaps, so nothing moves
            end, trace = start, replace(FullTrace.start(*start.force.shape), share=shares(start.state))
        elif not self.friction.any():
            end, trace = increments(solve, start, 1)
            trace = replace(FullTrace.start(*end.force.shape), share=trace.share, steps=1, solves=1)
        elif self.plan.path == "followed":
            bound, _ = self.friction.bound(np.maximum(start.force[:m, 0], 0))
            less = (np.linalg.norm(start.force[:m, 1:], axis=1) > bound + ROUNDING * bound.max(initial=0.0)).any()
            if less or start.force[:m][self._excluded(step)].any():
                start = solve(start, 0.0, start.position)  # less friction than before, or a weld excludes a contact
            first = FullTrace.start(*start.force.shape)
            if len(system.soft):  # resting parts move a finite distance at zero load before they touch
                before, start = start, solve(start, FIRST, start.position)
                first = transition(before, start)
            end, trace = extrapolated(solve, start, self.tolerance)
            trace = first + trace
        else:
            end, trace = increments(solve, start, self.plan.increments)
        solution = load_path.equilibrium.unpack(end.unknowns)
        state = replace(state, stop={limit.row: float(f) for limit, f in zip(stops, solution.force[m:, 0])})
        solution = replace(solution, force=solution.force[:m])
        end, trace = end.first(m), trace.first(m)
        return self._after(step, state, solution, self.mesh.contact(solution.u), end.position), end, trace

    def _after(self, step, state, solution, left, anchor):
        system = self.mesh.system(step)
        r = np.zeros(system.rows.shape[0])
        r[system.independent] = solution.reaction
        reaction = dict(zip(step.bilateral, r))  # without the rest rows at the end of r
        return replace(state, solution=solution, left=left, anchor=anchor, reaction=reaction)

    def _resolution(self, start, state, end, trace, drive, checked) -> FullResolution:
        gap = np.where(self._excluded(self.plan.steps[-1]), drive.gap[0] + state.left[:, 0], end.gap)
        displacement = np.column_stack([gap, (state.left - start.left)[:, 1:]])
        reaction = np.array([state.reaction[row] for row in self.plan.bilateral])
        return FullResolution(
            self.plan.name, state.solution.force, displacement, end.state, reaction, trace, *checked.T.copy()
        )
