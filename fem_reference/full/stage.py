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

If Newton's method fails, the step to the next equilibrium is divided. The intermediate solutions only start the next
solve: slip is measured from the start of the whole step, so the division does not change the result.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field, replace

import numpy as np

from fem_reference.full.contact_law import ContactLaw
from fem_reference.full.discretisation import Discretisation, System
from fem_reference.full.equilibrium import Iteration, NoConvergence, State
from fem_reference.full.friction import ContactFriction
from fem_reference.full.path import TOUCHING, FullTrace, Point, extrapolated, increments, shares, transition
from mic.contact.states import OPEN, STICK
from mic.errors import FreeMotion
from mic.model.rest_rows import separating_motion
from mic.process.actions import Joints, ResolveOverlap, Row
from mic.process.drive import Drive
from mic.process.plan import StagePlan, Step, row_compliance

__all__ = ["ContactFailure", "FullResolution", "FullStage", "FullState", "Penalty", "Solve"]

SMALLEST_CUT = 1 / 64  # smallest fraction of a step between two equilibria
AUGMENTATIONS = 30  # largest number
AUGMENTED = 1e-10  # tolerance on the change of contact forces by an augmentation, relative to the largest force
ROUNDING = 1e-8  # relative to the largest force: a smaller change that does not decrease is rounding
FAR = 1e3  # mm: gap given to contacts excluded by a weld
SLOW = 0.1  # ε is raised tenfold if an augmentation reduces the change of forces to more than this fraction
FIRST = 0.01  # share of a followed path at which resting parts first get support
PRESSED = 1e-3  # relative to the largest force: a part whose springs carry more is not in contact
STILL = 1e-5  # mm: distance from the force-free position allowed for such a part
STAYS = 0.1  # relative to the spring forces: a smaller change per augmentation counts as constant
OFF = 10.0  # mm: a part displaced farther whose springs still carry force has no support
STIFFEST = 1e9  # largest ε/k


class ContactFailure(NoConvergence):
    """The full solve failed; the message names stage, step, contact and what to change."""


@dataclass(frozen=True)
class Penalty:
    """Enforcement of the contact law.

    Attributes
    ----------
    stiffness : float
        ε/k, with k = E t of the softer sheet of the pair.
    augmented : bool
        Remove the penalty's error by augmentation (Uzawa).
    """

    stiffness: float = 1e3
    augmented: bool = True


@dataclass(frozen=True)
class Solve:
    """One Newton solve.

    Attributes
    ----------
    stage : str
    step : int
        Of the stage, from 1.
    share : float
        Of the step's load; 1 is its end.
    augmentation : int
        0 for the penalty method, otherwise the number of augmentations so far.
    penalty : float
        ε/k; infinite if Coulomb's law was solved exactly.
    iterations : tuple of Iteration
    """

    stage: str
    step: int
    share: float
    augmentation: int
    penalty: float
    iterations: tuple[Iteration, ...]


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
    reaction: Mapping[Row, float] = field(default_factory=dict)
    push: Mapping[int, float] = field(default_factory=dict)
    stop: Mapping[Row, float] = field(default_factory=dict)
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
    """

    plan: StagePlan
    mesh: Discretisation
    friction: ContactFriction
    penalty: Penalty
    tolerance: float

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
                    state, end, trace = self._resolve(load_path, state)
                    ends, traces, solves = [*ends, end], [*traces, trace], solves + load_path.solves
                else:
                    state = self._without_contact(load_path, state)
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
        closed = step.closed(Joints(self.mesh.assembly.weld_size))
        return frozen | {row: -float(drive.weld_gap[0, row]) for row in closed}

    def _load_path(self, number, step: Step, state, drive) -> _LoadPath:
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
        return _LoadPath(self, system, number, step, (p0, v0, gap + overlap), (p1, v1, gap))

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

    def _without_contact(self, load_path, state) -> FullState:
        """Linear equilibrium at the end of the load path; contacts keep their forces and get new anchors."""
        p, v, _ = load_path.end
        equilibrium = load_path.system.equilibrium
        none = np.zeros((len(load_path.step.stops), state.left.shape[1]))
        solution = equilibrium.linear(p, v, np.concatenate([state.solution.force, none]))
        solution = replace(solution, force=state.solution.force)
        touching = equilibrium.linear(p, v, np.zeros((len(state.left) + len(none), none.shape[1])))
        left = self.mesh.contact(touching.u)
        return self._after(load_path, state, solution, left, left[:, 1:])

    def _resolve(self, load_path, state) -> tuple[FullState, Point, FullTrace]:
        """Contact solution along the load path; without friction only its end is solved and slip is zero."""
        system, step, solve = load_path.system, load_path.step, load_path.solve
        reaction = np.zeros(system.rows.shape[0])
        reaction[: len(step.bilateral)] = [state.reaction.get(row, 0.0) for row in step.bilateral]
        reaction = reaction[system.independent]
        stops, m = step.stops, len(self.friction)
        force = np.zeros((len(stops), state.left.shape[1]))
        force[:, 0] = [state.stop.get(limit.row, 0.0) for limit in stops]
        start = load_path.start_point(
            State(state.solution.u, reaction, np.concatenate([state.solution.force, force])), state.anchor
        )
        if load_path.still:
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
        solution = system.equilibrium.unpack(end.unknowns)
        state = replace(state, stop={limit.row: float(f) for limit, f in zip(stops, solution.force[m:, 0])})
        solution = replace(solution, force=solution.force[:m])
        end, trace = end.first(m), trace.first(m)
        return self._after(load_path, state, solution, self.mesh.contact(solution.u), end.position), end, trace

    def _after(self, load_path, state, solution, left, anchor):
        r = np.zeros(load_path.system.rows.shape[0])
        r[load_path.system.independent] = solution.reaction
        reaction = dict(zip(load_path.step.bilateral, r))  # without the rest rows at the end of r
        return replace(state, solution=solution, left=left, anchor=anchor, reaction=reaction)

    def _resolution(self, start, state, end, trace, drive, checked) -> FullResolution:
        gap = np.where(self._excluded(self.plan.steps[-1]), drive.gap[0] + state.left[:, 0], end.gap)
        displacement = np.column_stack([gap, (state.left - start.left)[:, 1:]])
        reaction = np.array([state.reaction[row] for row in self.plan.bilateral])
        return FullResolution(
            self.plan.name, state.solution.force, displacement, end.state, reaction, trace, *checked.T.copy()
        )


class _LoadPath:
    """Load path of a step, and its Newton solves; loads are (nodal forces, values, gaps)."""

    def __init__(self, stage: FullStage, system: System, number: int, step: Step, start, end):
        self.stage, self.system, self.number, self.step = stage, system, number, step
        self.start, self.end = start, end
        self.solves: list[Solve] = []

    @property
    def still(self) -> bool:
        """Whether nothing moves: the step only settles parts, and none overlap."""
        settles = all(isinstance(action, ResolveOverlap) for action in self.step.move)
        return settles and bool((self.start[2] == self.end[2]).all())

    def start_point(self, solution: State, anchor: np.ndarray) -> Point:
        """Equilibrium at the start of the load path."""
        force, δ = solution.force, self.stage.mesh.contact(solution.u, self.step.stops)
        position = np.concatenate([anchor, δ[len(anchor) :, 1:]])
        contact = np.where(force[:, 0] > 0, STICK, OPEN)
        return Point(0.0, position, self.start[2] + δ[:, 0], force, contact, solution.stacked)

    def solve(self, point: Point, share: float, anchor: np.ndarray) -> Point:
        """On from a point, slip measured from `anchor` (m, d - 1)."""
        mesh, penalty, stops = self.stage.mesh, self.stage.penalty, self.step.stops
        friction, k = self.stage.friction.with_stops(len(stops)), mesh.stiffness(stops)
        estimate = point.force.copy()
        if not penalty.augmented:
            estimate[:, 0] = 0.0
        origin = np.column_stack([np.zeros(len(k)), anchor])
        layer = np.concatenate([mesh.assembly.contacts.layer, np.zeros(len(stops))])
        law = ContactLaw(friction, self.end[2], origin, estimate, penalty.stiffness * k, k, layer)
        solution = self.system.equilibrium.unpack(point.unknowns)
        place = self._place(solution)
        condensed = self._condensed(solution, share, law, place)
        if condensed is None:
            law, solution = self._penalised(solution, point.share, share, law, place)
            if penalty.augmented or len(place):
                law, solution = self._augment(solution, share, law, place)
            state = law.state(mesh.contact(solution.u, stops))
        else:
            law, solution, state = condensed
        δ = mesh.contact(solution.u, stops)
        position = friction.slider(δ, solution.force)
        gap = law.displacement(δ)[:, 0] + layer * solution.force[:, 0]
        return Point(share, position, gap, solution.force, state, solution.stacked)

    def _place(self, solution: State) -> np.ndarray:
        """(k,) positions of the parts on springs."""
        return (self.system.rows @ solution.u)[self.system.soft]

    def _condensed(self, solution, share, law, place):
        """Solution of the condensed system, by Coulomb's exact law if augmented; None if there is no such system or
        the solver fails."""
        equilibrium = self.system.equilibrium
        if not equilibrium.condensable:
            return None
        p, v, gap = self._loads(share, place)
        law = replace(law, gap=gap)
        exact = replace(law, penalty=np.full(len(gap), np.inf)) if self.stage.penalty.augmented else law
        try:
            solution, state, iterations = equilibrium.condensed(solution.force, p, v, exact)
        except NoConvergence:
            return None
        self._note(share, 0, exact, iterations)
        return law, solution, state

    def _loads(self, share, place):
        """Nodal forces, values and gaps at a share, resting parts on springs about `place`."""
        p, v, gap = (a + share * (b - a) for a, b in zip(self.start, self.end))
        v[np.searchsorted(self.system.independent, self.system.soft)] = place
        return p, v, gap

    def _newton(self, solution, share, law, place, augmentation):
        p, v, gap = self._loads(share, place)
        law = replace(law, gap=gap)
        solution, iterations = self.system.equilibrium.newton(solution, p, v, law)
        self._note(share, augmentation, law, iterations)
        return law, solution

    def _note(self, share, augmentation, law, iterations):
        penalty = float(law.penalty[0] / law.stiffness[0])
        self.solves.append(Solve(self.stage.plan.name, self.number, share, augmentation, penalty, tuple(iterations)))

    def _penalised(self, solution, done, share, law, place):
        """Solution at `share` by the penalty method, in shorter steps if Newton's method fails; resting parts are on
        springs about `place`."""
        whole = length = share - done
        while True:
            target = share if done + 1.5 * length > share else done + length
            try:
                used, solution = self._newton(solution, target, law, place, 0)
            except NoConvergence as problem:
                length /= 2
                if length < SMALLEST_CUT * whole or whole == 0:
                    raise self._failure(
                        done, problem, "use increments in this stage, or lower the penalty"
                    ) from problem
                continue
            if target == share:
                return used, solution
            done = target

    def _augment(self, solution, share, law, place):
        """Augment f̂ ← f until the contact forces converge and the springs of resting parts carry no force.

        Springs are moved to the position of their part; for parts without contact until that motion is negligible.
        """
        change, stiffness, augmented = np.inf, law.stiffness, self.stage.penalty.augmented
        springs, softness = (
            np.searchsorted(self.system.independent, self.system.soft),
            self.system.springs[self.system.springs > 0],
        )
        initial, carried_before, stride = place, np.full(len(place), np.inf), 1.0
        for augmentation in range(1, AUGMENTATIONS + 1):
            before = change
            stronger = law.augmented(solution.force) if augmented else law
            change = float(np.abs(stronger.estimate - law.estimate).max())
            largest = max(np.abs(solution.force).max(), np.abs(solution.reaction).max())
            carried = np.abs(solution.reaction[springs])
            free = (carried > PRESSED * largest) & (softness * carried <= STILL)
            moves = (carried > AUGMENTED * largest) & ~free
            settled = change <= AUGMENTED * largest or before <= ROUNDING * largest and change > 0.5 * before
            if settled and not moves.any():
                return law, solution
            if moves.any() and np.abs(place - initial).max() > OFF:
                raise self._failure(
                    share,
                    f"a part that rests by contact alone has moved more than {OFF:g} mm under {carried.max():.2g} N "
                    "without finding support",
                    "add locators there, or friction",
                )
            now = solution.reaction[springs]  # a constant force means that the part slides: double the stride
            constant = np.abs(now - carried_before).max(initial=0.0) < STAYS * carried.max(initial=0.0)
            stride = 2 * stride if constant else 1.0
            carried_before = now
            stiffer = change > SLOW * before and law.penalty[0] < STIFFEST * stiffness[0] and not moves.any()
            law = replace(stronger, penalty=(10 if stiffer else 1) * law.penalty)
            if moves.any():
                place = place + stride * (self._place(solution) - place)
            try:
                law, solution = self._newton(solution, share, law, place, augmentation)
            except NoConvergence as problem:
                raise self._failure(share, problem, "lower the penalty, or set augmented=False") from problem
        raise self._failure(
            share,
            f"after {AUGMENTATIONS} augmentations the forces still change by {change:.1e} N",
            "raise the penalty, or remove contacts that the welds make redundant",
        )

    def _failure(self, share, problem, remedy):
        plan, assembly = self.stage.plan, self.stage.mesh.assembly
        where = ""
        if isinstance(problem, NoConvergence) and problem.contact is not None:
            at, stops = problem.contact, self.step.stops
            if at < len(assembly.contacts):
                where = assembly.labels["contact"][at * assembly.contacts.dimension].rsplit(" ", 1)[0]
            else:
                kind, row = stops[at - len(assembly.contacts)].row
                where = assembly.labels[kind][row]
            where = f", worst at contact {where!r}"
        return ContactFailure(
            f"stage {plan.name!r}, step {self.number} of {len(plan.steps)}, "
            f"at {share:.3g} of its load{where}: {problem}; {remedy}"
        )
