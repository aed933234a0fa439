"""A load path of frictional contact: from one equilibrium to the next, by the whole or by the condensed route.

Nodal forces, values of the bilateral rows and gaps change linearly with the share s of the load, from 0 to 1. Each
equilibrium is found by one of two routes:

- *whole*: Newton's method on all freedoms, reactions and contact forces, by penalty, and by augmentation f̂ ← f if
  Coulomb's law is to hold exactly. No compliance is formed. If Newton's method fails, it starts again with a tenth and
  a hundredth of the penalty, which does not change an augmented solution; then with fractions of the load. The
  fractions only start the next solve: slip is measured from the start of the whole step.
- *condensed*: the linear part is condensed onto the contact forces (:mod:`fem_reference.full.condensation`), on one
  process and with parts that bilateral rows hold.

If the chosen route does not converge, the other one is used. Each :class:`Solve` records its route.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, replace
from functools import partial
from typing import Literal, get_args

import numpy as np

from fem_reference.full.contact_law import ContactLaw
from fem_reference.full.equilibrium import Equilibrium, Iteration, NoConvergence, State
from fem_reference.full.friction import ContactFriction
from fem_reference.full.path import Point
from mic.contact.states import OPEN, STICK

__all__ = ["ROUTES", "ContactFailure", "Contacts", "LoadPath", "Penalty", "Route", "Solve", "Springs", "route_taken"]

Route = Literal["whole", "condensed"]
ROUTES = get_args(Route)
SMALLEST_CUT = 1 / 64  # smallest fraction of a step between two equilibria
SOFTER = (1.0, 0.1, 0.01)  # factors of the penalty that are tried in turn if the solution is augmented
AUGMENTATIONS = 30  # largest number
AUGMENTED = 1e-10  # tolerance on the change of contact forces by an augmentation, relative to the largest force
ROUNDING = 1e-8  # relative to the largest force: a smaller change that does not decrease is rounding
SLOW = 0.1  # ε is raised tenfold if an augmentation reduces the change of forces to more than this fraction
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
    route : {"whole", "condensed"}
        Route of this solve.
    """

    stage: str
    step: int
    share: float
    augmentation: int
    penalty: float
    iterations: tuple[Iteration, ...]
    route: Route


def route_taken(chosen: Route, solves: Sequence[Solve]) -> str:
    """The chosen route, and how many of the solves went by the other because the chosen one did not converge.

    Examples
    --------
    ``"whole"``, ``"whole, 2 of 31 solves condensed"``.
    """
    others = [solve.route for solve in solves if solve.route != chosen]
    return f"{chosen}, {len(others)} of {len(solves)} solves {others[0]}" if others else chosen


@dataclass(frozen=True)
class Contacts:
    """Constants of m contacts along a load path.

    Attributes
    ----------
    friction : ContactFriction
    stiffness : (m,) array
        k = E t of the softer sheet, N/mm.
    layer : (m,) array
        c, compression through the thickness, mm/N.
    """

    friction: ContactFriction
    stiffness: np.ndarray
    layer: np.ndarray


@dataclass(frozen=True)
class Springs:
    """Bilateral rows that are springs of resting parts.

    Attributes
    ----------
    rows : (k,) int array
        Their numbers among the bilateral rows.
    compliance : (k,) array
        mm/N.
    """

    rows: np.ndarray
    compliance: np.ndarray

    @classmethod
    def none(cls) -> Springs:
        """No springs."""
        return cls(np.zeros(0, dtype=int), np.zeros(0))


class LoadPath:
    """Load path of a step, and its Newton solves.

    Parameters
    ----------
    equilibrium : Equilibrium
    contacts : Contacts
    start, end : tuple of array
        Nodal forces (N,), values of the bilateral rows (b,) and gaps (m,) at both ends.
    penalty : Penalty
    route : {"whole", "condensed"}
        Route to try first.
    label : tuple of (str, int)
        Stage and step, for :class:`Solve`.
    where : callable
        ``where(share, contact)`` describes, for an error message, a share of the load and a contact (or None).
    springs : Springs, optional
        Resting parts.
    """

    def __init__(
        self,
        equilibrium: Equilibrium,
        contacts: Contacts,
        start: tuple[np.ndarray, np.ndarray, np.ndarray],
        end: tuple[np.ndarray, np.ndarray, np.ndarray],
        penalty: Penalty,
        route: Route,
        label: tuple[str, int],
        where: Callable[[float, int | None], str],
        springs: Springs | None = None,
    ):
        self.equilibrium, self.contacts, self.start, self.end = equilibrium, contacts, start, end
        self.penalty, self.route, self.label, self.where = penalty, route, label, where
        self.springs = springs or Springs.none()
        self.solves: list[Solve] = []

    def start_point(self, solution: State, anchor: np.ndarray) -> Point:
        """Equilibrium at the start of the load path; contacts without an entry in `anchor` are where they stand."""
        force, δ = solution.force, self.equilibrium.contact(solution.u)
        position = np.concatenate([anchor, δ[len(anchor) :, 1:]])
        contact = np.where(force[:, 0] > 0, STICK, OPEN)
        return Point(0.0, position, self.start[2] + δ[:, 0], force, contact, solution.stacked)

    def solve(self, point: Point, share: float, anchor: np.ndarray) -> Point:
        """On from a point, slip measured from `anchor` (m, d - 1).

        Raises
        ------
        ContactFailure
            If neither route converges.
        """
        contacts = self.contacts
        estimate = point.force.copy()
        if not self.penalty.augmented:
            estimate[:, 0] = 0.0
        origin = np.column_stack([np.zeros(len(anchor)), anchor])
        k = contacts.stiffness
        law = ContactLaw(
            contacts.friction, self.end[2], origin, estimate, self.penalty.stiffness * k, k, contacts.layer
        )
        solution = self.equilibrium.unpack(point.unknowns)
        failure: ContactFailure | None = None
        for attempt in self._attempts(solution, point.share, share, law):
            try:
                law, solution, state = attempt()
                break
            except ContactFailure as problem:
                failure = problem
            except NoConvergence:  # of the condensed route
                continue
        else:
            assert failure is not None
            raise failure
        δ = self.equilibrium.contact(solution.u)
        position = contacts.friction.slider(δ, solution.force)
        gap = law.displacement(δ)[:, 0] + contacts.layer * solution.force[:, 0]
        return Point(share, position, gap, solution.force, state, solution.stacked)

    def _attempts(self, solution, done, share, law) -> Iterator[Callable]:
        """Solves to try in turn, each of which returns the law, the solution and the states of the contacts."""
        place = self._place(solution)
        whole = partial(self._whole, solution, done, share, place)
        condensed = [partial(self._condensed, solution, share, law, place)] * self.equilibrium.condensable
        yield from condensed if self.route == "condensed" else ()
        if self.penalty.augmented and not len(place) and share > done:
            for factor in SOFTER:
                yield partial(whole, replace(law, penalty=factor * law.penalty), cut=False)
        yield partial(whole, law, cut=True)
        yield from condensed if self.route == "whole" else ()

    def _place(self, solution: State) -> np.ndarray:
        """(k,) positions of the parts on springs."""
        return (self.equilibrium.B @ solution.u)[self.springs.rows]

    def _condensed(self, solution, share, law, place):
        """Solution of the condensed system, by Coulomb's exact law if augmented."""
        p, v, gap = self._loads(share, place)
        law = replace(law, gap=gap)
        exact = replace(law, penalty=np.full(len(gap), np.inf)) if self.penalty.augmented else law
        solution, state, iterations = self.equilibrium.condensed(solution.force, p, v, exact)
        self._note(share, 0, exact, iterations, "condensed")
        return law, solution, state

    def _whole(self, solution, done, share, place, law, cut):
        """Solution of the whole system."""
        law, solution = self._penalised(solution, done, share, law, place, cut)
        if self.penalty.augmented or len(place):
            law, solution = self._augment(solution, share, law, place)
        return law, solution, law.state(self.equilibrium.contact(solution.u))

    def _loads(self, share, place):
        """Nodal forces, values and gaps at a share, resting parts on springs about `place`."""
        p, v, gap = (a + share * (b - a) for a, b in zip(self.start, self.end))
        v[self.springs.rows] = place
        return p, v, gap

    def _newton(self, solution, share, law, place, augmentation):
        p, v, gap = self._loads(share, place)
        law = replace(law, gap=gap)
        solution, iterations = self.equilibrium.newton(solution, p, v, law)
        self._note(share, augmentation, law, iterations, "whole")
        return law, solution

    def _note(self, share, augmentation, law, iterations, route):
        penalty = float(law.penalty[0] / law.stiffness[0])
        self.solves.append(Solve(*self.label, share, augmentation, penalty, tuple(iterations), route))

    def _penalised(self, solution, done, share, law, place, cut):
        """Solution at `share` by the penalty method, in shorter steps if Newton's method fails and `cut` is true;
        resting parts are on springs about `place`."""
        whole = length = share - done
        while True:
            target = share if done + 1.5 * length > share else done + length
            try:
                used, solution = self._newton(solution, target, law, place, 0)
            except NoConvergence as problem:
                length /= 2
                if not cut or length < SMALLEST_CUT * whole or whole == 0:
                    remedy = "use increments in this stage, or lower the penalty"
                    raise self._failure(done, problem, remedy) from problem
                continue
            if target == share:
                return used, solution
            done = target

    def _augment(self, solution, share, law, place):
        """Augment f̂ ← f until the contact forces converge and the springs of resting parts carry no force.

        Springs are moved to the position of their part; for parts without contact until that motion is negligible.
        """
        change, stiffness, augmented = np.inf, law.stiffness, self.penalty.augmented
        springs, softness = self.springs.rows, self.springs.compliance
        initial, carried_before, stride = place, np.full(len(place), np.inf), 1.0
        for augmentation in range(1, AUGMENTATIONS + 1):
            before = change
            stronger = law.augmented(solution.force) if augmented else law
            change = float(np.abs(stronger.estimate - law.estimate).max(initial=0.0))
            largest = max(np.abs(solution.force).max(initial=0.0), np.abs(solution.reaction).max(initial=0.0))
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
            "raise the penalty, or remove contacts that welds or supports make redundant",
        )

    def _failure(self, share, problem, remedy) -> ContactFailure:
        return ContactFailure(f"{self.where(share, getattr(problem, 'contact', None))}: {problem}; {remedy}")
