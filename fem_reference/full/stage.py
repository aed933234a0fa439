"""One stage by full finite elements: the load is followed by Newton's method, no reduction.

With s from 0 to 1 over the increments of a stage:

- bilateral rows hold ``B u = v(s)``, from what the row read before the stage to its target;
- rows let go, and forces taken away, fade: ``p(s) = (1 − s) Bᵣᵀ r``;
- a contact's gap is ``g = g⁰ + n·(shape deviation) + δ_n``, and slip is measured from where the increment before left
  it.

Where Newton's method fails, the increment is cut: fractions of it are solved first. They are a path towards the
solution, not a part of the process: slip is measured from the start of the whole increment, so cutting does not
change the answer.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field, replace

import numpy as np

from fem_reference.full.discretisation import Discretisation, System
from fem_reference.full.equilibrium import ContactLaw, Iteration, NoConvergence, State
from fem_reference.full.friction import ContactFriction
from mic.errors import FreeMotion
from mic.process.actions import Joints, Row
from mic.process.drive import Drive
from mic.process.plan import StagePlan

__all__ = ["ContactFailure", "FullResolution", "FullStage", "FullState", "Penalty", "Solve"]

SMALLEST_CUT = 1 / 64  # of an increment
AUGMENTATIONS = 30
AUGMENTED = 1e-10  # change of the contact forces in the last augmentation, of the largest
ROUNDING = 1e-8  # of the largest force: a change below this that no longer shrinks is rounding
SLOW = 0.1  # an augmentation that leaves more than this share of the change before raises ε tenfold
STIFFEST = 1e9  # ε/k at most


class ContactFailure(RuntimeError):
    """The full solve failed; the message names stage, increment, contact and what to change."""


@dataclass(frozen=True)
class Penalty:
    """How the contact law is enforced.

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
    increment : int
        From 1.
    fraction : float
        Of the increment's load; 1 is its end.
    augmentation : int
        0 for the penalty method, then the number of times that f̂ was replaced by f.
    penalty : float
        ε/k.
    iterations : tuple of Iteration
    """

    stage: str
    increment: int
    fraction: float
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
    """

    stage: str
    force: np.ndarray
    displacement: np.ndarray
    state: np.ndarray
    reaction: np.ndarray


@dataclass(frozen=True)
class FullState:
    """One assembly at the end of a stage.

    Attributes
    ----------
    solution : State
        Freedoms, reactions of the independent bilateral rows, contact forces.
    left : (m, d) array
        Relative displacement δ at which each contact was left, mm.
    reaction : dict of (str, int) to float
        Forces of the bilateral rows on the parts, N or N mm.
    push : dict of int to float
        Forces of the clamp rows that push, N.
    frozen : dict of int to float
        Relative displacement that each weld row keeps.
    """

    solution: State
    left: np.ndarray
    reaction: Mapping[Row, float] = field(default_factory=dict)
    push: Mapping[int, float] = field(default_factory=dict)
    frozen: Mapping[int, float] = field(default_factory=dict)

    @classmethod
    def start(cls, freedoms: int, m: int, d: int) -> FullState:
        """Free, unloaded parts."""
        return cls(State(np.zeros(freedoms), np.zeros(0), np.zeros((m, d))), np.zeros((m, d)))


@dataclass(frozen=True)
class FullStage:
    """A stage ready to take an assembly on.

    Attributes
    ----------
    plan : StagePlan
    mesh : Discretisation
    friction : ContactFriction
        Under the law, in this stage.
    penalty : Penalty
    """

    plan: StagePlan
    mesh: Discretisation
    friction: ContactFriction
    penalty: Penalty

    def advance(self, state: FullState, drive: Drive) -> tuple[FullState, FullResolution | None, list[Solve]]:
        """Take one assembly, the drive's only one, through the stage.

        Raises
        ------
        ContactFailure
        """
        plan = self.plan
        state = replace(state, frozen=self._make_welds(state, drive))
        resolution, solves = None, []
        if plan.resolves or plan.sets_down:
            state, resolution, solves = self._load(state, drive)
        # else nothing has changed: new welds hold what they found and carry nothing yet
        reaction = {row: state.reaction.get(row, 0.0) for row in plan.bilateral}
        push = {i: float(drive.push[0, i]) for i in plan.loads}
        return replace(state, reaction=reaction, push=push), resolution, solves

    def _make_welds(self, state, drive):
        found = self.mesh.rows["weld"] @ state.solution.u
        first = Joints(self.mesh.assembly.weld_size).first
        frozen = dict(state.frozen) | {row: float(found[row]) for row in self.plan.made}
        return frozen | {int(first[weld]): -float(drive.weld_gap[0, weld]) for weld in self.plan.closing}

    def _load(self, state, drive):
        """Bring the prescribed values and loads from what they are to the stage's, increment by increment."""
        plan, mesh = self.plan, self.mesh
        try:
            system = mesh.system(plan)
            target = [state.frozen[i] if kind == "weld" else drive.target[kind][0, i] for kind, i in plan.bilateral]
            v0 = system.consistent(system.rows @ state.solution.u)
            v1 = system.consistent(np.array(target))
        except (ValueError, FreeMotion) as error:
            raise ContactFailure(f"stage {plan.name!r}: {error}") from error
        p0, p1 = self._loads(state, drive)
        reaction = np.array([state.reaction.get(row, 0.0) for row in plan.bilateral])[system.kept]
        solution, left, solves = replace(state.solution, reaction=reaction), state.left, []
        contact = plan.resolves and len(self.friction) > 0
        for number in range(1, (plan.increments if contact else 1) + 1):
            start, end = (
                (p0 + s * (p1 - p0), v0 + s * (v1 - v0))
                for s in ((number - 1) / plan.increments, number / plan.increments)
            )
            if contact:
                increment = _Increment(self, system, drive.gap[0], number, left)
                law, solution = increment.solve(solution, start, end)
                solves += increment.solves
            else:
                solution = system.equilibrium.linear(p1, v1, solution.force)
            left = mesh.contact(solution.u)
        r = np.zeros(len(plan.bilateral))
        r[system.kept] = solution.reaction
        after = replace(state, solution=solution, left=left, reaction=dict(zip(plan.bilateral, r)))
        if not contact:
            return after, None, solves
        displacement = replace(law, anchor=state.left).displacement(left)
        return after, FullResolution(plan.name, solution.force, displacement, law.state(left), r), solves

    def _loads(self, state, drive):
        """Nodal forces (N,) at the stage's start and at its end."""
        plan, rows = self.plan, self.mesh.rows
        p0, p1 = np.zeros((2, len(state.solution.u)))
        for i in plan.loads + plan.dropped_loads:
            p0 += rows["clamp"][i].T @ [state.push.get(i, 0.0)]
        for i in plan.loads:
            p1 += rows["clamp"][i].T @ [drive.push[0, i]]
        for kind, i in plan.released:
            p0 += rows[kind][i].T @ [state.reaction[kind, i]]
        return p0, p1


class _Increment:
    """One load increment, and the Newton solves that it took."""

    def __init__(self, stage: FullStage, system: System, gap: np.ndarray, number: int, left: np.ndarray):
        self.stage, self.system, self.gap, self.number, self.left = stage, system, gap, number, left
        self.solves: list[Solve] = []

    def solve(self, solution: State, start, end) -> tuple[ContactLaw, State]:
        """From one load and its values to the next; returns the law that the end satisfies, slip from the start."""
        k, β = self.stage.mesh.contact_stiffness, self.stage.penalty.stiffness
        estimate = solution.force.copy()
        if not self.stage.penalty.augmented:
            estimate[:, 0] = 0.0
        law = ContactLaw(self.stage.friction, self.gap, self.left, estimate, β * k, k)
        solution = self._penalised(solution, start, end, law)
        if self.stage.penalty.augmented:
            law, solution = self._augment(solution, start, end, law)
        return law, solution

    def _newton(self, solution, start, end, law, fraction, augmentation):
        p, v = (a + fraction * (b - a) for a, b in zip(start, end))
        solution, iterations = self.system.equilibrium.newton(solution, p, v, law)
        k = self.stage.mesh.contact_stiffness
        penalty = float(law.penalty[0] / k[0])
        self.solves.append(Solve(self.stage.plan.name, self.number, fraction, augmentation, penalty, tuple(iterations)))
        return solution

    def _penalised(self, solution, start, end, law):
        """The increment by the penalty method, cut where Newton's method fails."""
        done, step = 0.0, 1.0
        while done < 1:
            try:
                solution = self._newton(solution, start, end, law, min(1.0, done + step), 0)
                done = min(1.0, done + step)
            except NoConvergence as problem:
                step /= 2
                if step < SMALLEST_CUT:
                    raise self._failure(done, problem, "raise the stage's increments or lower the penalty") from problem
        return solution

    def _augment(self, solution, start, end, law):
        """f̂ ← f until the forces no longer change."""
        change, stiffness = np.inf, self.stage.mesh.contact_stiffness
        for augmentation in range(1, AUGMENTATIONS + 1):
            before = change
            augmented = law.augmented(solution.force)
            change = float(np.abs(augmented.estimate - law.estimate).max())
            largest = max(np.abs(solution.force).max(), np.abs(solution.reaction).max())
            if change <= AUGMENTED * largest or before <= ROUNDING * largest and change > 0.5 * before:
                return law, solution
            stiffer = change > SLOW * before and law.penalty[0] < STIFFEST * stiffness[0]
            law = replace(augmented, penalty=(10 if stiffer else 1) * law.penalty)
            try:
                solution = self._newton(solution, start, end, law, 1.0, augmentation)
            except NoConvergence as problem:
                raise self._failure(1.0, problem, "lower the penalty, or do without augmentation") from problem
        raise self._failure(
            1.0,
            f"after {AUGMENTATIONS} augmentations the forces still change by {change:.1e} N",
            "raise the penalty; look for contacts that the welds make redundant",
        )

    def _failure(self, fraction, problem, remedy):
        plan, assembly = self.stage.plan, self.stage.mesh.assembly
        where = ""
        if isinstance(problem, NoConvergence) and problem.contact is not None:
            label = assembly.labels["contact"][problem.contact * assembly.contacts.dimension].rsplit(" ", 1)[0]
            where = f", worst at contact {label!r}"
        return ContactFailure(
            f"stage {plan.name!r}, increment {self.number} of {plan.increments}, "
            f"at {fraction:.3g} of its load{where}: {problem}; {remedy}"
        )
