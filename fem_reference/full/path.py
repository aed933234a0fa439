r"""From one load to the next: increments, or backward Euler's method extrapolated, cut where contacts open or close.

A path goes with its share s from 0 to 1. One step of backward Euler's method from s to s + h solves equilibrium at
s + h, each contact's slip measured from where the step found the contact. As long as none opens or closes, its error
has an expansion in powers of h, so that its results with the step cut into n₁ < n₂ < … equal ones extrapolate to h → 0,

    T_{j,k+1} = T_{j,k} + (T_{j,k} − T_{j−1,k}) / (n_j / n_{j−k} − 1),                                     (1)

and the last two orders of the table differ by the error of the lower one. A step whose difference is too large is
taken again, shorter. All that is linear extrapolates alike: displacements, reactions and contact forces, which stay in
equilibrium exactly, and obey the contact law to the order of the step. Where a contact opens or closes the step ends:
the place is bracketed, and found by the secant of the gap or of the force that vanishes there.

References
----------
Hairer, Wanner (1996), Solving Ordinary Differential Equations II, 2nd ed., Springer: extrapolation of the implicit
Euler method, section IV.9.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, fields, replace

import numpy as np

from fem_reference.full.equilibrium import NoConvergence
from mic.contact.increments import Increments
from mic.contact.states import OPEN, SLIP, STICK

__all__ = ["TOUCHING", "FullTrace", "Point", "extrapolated", "increments", "shares", "transition"]

SEQUENCE = (1, 2, 3)  #: n of (1): the lowest that leave an error of third order and an estimate of it
SHORTEST = 1e-8  #: of a path; below, rounding in the forces is as large as what a step changes
TOUCHING = 1e-9  #: mm: an open contact as near as this is neither open nor closed before it has moved
GROWTH = 4.0  #: of a step at most, and what a step is cut to at least
SAFETY = 0.8  #: of the step that would just keep the tolerance
PLACE = 0.1  #: of the tolerance: how far contacts may move between the ends of the bracket of an opening or closing
BISECTED = 3  #: secants in a row that leave more than half of the bracket, before it is bisected


@dataclass(frozen=True)
class Point:
    """Equilibrium at a share s of a path.

    Attributes
    ----------
    share : float
    position : (m, d - 1) array
        Where the contacts stand tangentially, or their sliders where they yield, mm: slip goes on from there.
    gap : (m,) array
        mm.
    force : (m, d) array
        N.
    state : (m,) array
        A :class:`mic.contact.states.ContactState` each.
    held : (k,) array
        All unknowns of the solver, to go on from; what it goes on from may be a sum of solutions.
    """

    share: float
    position: np.ndarray
    gap: np.ndarray
    force: np.ndarray
    state: np.ndarray
    held: np.ndarray

    def first(self, m: int) -> Point:
        """The first m contacts alone; all unknowns as they are."""
        return replace(self, **{name: getattr(self, name)[:m] for name in ("position", "gap", "force", "state")})

    @property
    def closed(self) -> np.ndarray:
        """(m,) whether each contact is."""
        return self.state != OPEN

    def differs(self, other: Point) -> np.ndarray:
        """(m,) where a contact of another point has opened or closed; not if it only touches here."""
        return (self.closed != other.closed) & ~self.touches

    @property
    def touches(self) -> np.ndarray:
        """(m,) whether each contact touches without force."""
        return ~self.closed & (self.gap <= TOUCHING)


#: ``solve(point, s, anchor)`` goes on from a point to the share s, slip measured from the positions `anchor`.
Solver = Callable[[Point, float, np.ndarray], Point]


@dataclass(frozen=True)
class FullTrace:
    """What the contacts of one assembly went through; the meanings of :class:`mic.contact.path.Trace`.

    Attributes
    ----------
    slip : (m, d - 1) array
        Net slip under load, mm.
    length : (m,) array
        Its length along the way, mm.
    work : (m,) array
        Dissipated by friction, N mm.
    share : (m, 3) array
        Shares of the path that each contact was open, stuck and slipping.
    error : float
        Estimate of the error in the contacts' tangential positions, root mean square over the contacts, mm: the sum of
        the differences that (1) left in the steps. NaN for increments, which do not know.
    steps, solves : int
        Steps taken, and equilibria solved for them, those of steps taken again included.
    """

    slip: np.ndarray
    length: np.ndarray
    work: np.ndarray
    share: np.ndarray
    error: float
    steps: int
    solves: int

    @classmethod
    def start(cls, m: int, d: int) -> FullTrace:
        """Nothing has happened yet."""
        return cls(np.zeros((m, d - 1)), np.zeros(m), np.zeros(m), np.zeros((m, 3)), 0.0, 0, 0)

    def first(self, m: int) -> FullTrace:
        """Of the first m contacts alone."""
        return replace(self, **{name: getattr(self, name)[:m] for name in ("slip", "length", "work", "share")})

    def __add__(self, other: FullTrace) -> FullTrace:
        """One after the other; shares add up, to be divided by the number of paths."""
        return FullTrace(
            **{item.name: getattr(self, item.name) + getattr(other, item.name) for item in fields(FullTrace)}
        )


def increments(solve: Solver, start: Point, count: int) -> tuple[Point, FullTrace]:
    """Steps of backward Euler's method, where production's end: :class:`mic.contact.increments.Increments`."""
    point, trace = start, FullTrace.start(*start.force.shape)
    for end in Increments(count).ends:
        before, point = point, solve(point, end, point.position)
        trace += replace(transition(before, point), error=np.nan)
    return point, trace


def transition(before: Point, after: Point) -> FullTrace:
    """One step of backward Euler's method, whose error nothing tells."""
    gone = _gone(before, after, after.state == SLIP)
    return FullTrace(*gone, shares(after.state) * (after.share - before.share), 0.0, 1, 1)


def extrapolated(solve: Solver, start: Point, tolerance: float) -> tuple[Point, FullTrace]:
    """Steps as long as their error allows, ended where a contact opens or closes.

    Parameters
    ----------
    solve : Solver
    start : Point
        At the share 0.
    tolerance : float
        Largest error of a contact's position in a step, mm, as (1) estimates it.

    Raises
    ------
    NoConvergence
        Of the solver, where a step cannot be taken however short.
    """
    solve = counted = _Counted(solve)
    point, trace, length = start, FullTrace.start(*start.force.shape), 1.0
    while point.share < 1.0:
        try:
            whole, cut = _to_first_change(solve, point, min(1.0, point.share + length), tolerance)
            end, way, difference = _extrapolate(solve, point, whole)
        except NoConvergence:
            length /= GROWTH
            if length < SHORTEST:
                raise
            continue
        taken = whole.share - point.share
        error = float(np.abs(difference).max(initial=0.0))
        allowed = SAFETY * (tolerance / error) ** (1 / len(SEQUENCE)) * taken if error > 0 else 1.0
        if error > tolerance and taken > SHORTEST:
            length = max(SHORTEST, allowed, taken / GROWTH)
            continue
        rms = float(np.sqrt((difference**2).sum() / max(len(difference), 1)))
        trace += FullTrace(*way[:3], way[3] * taken, rms, 1, 0)
        # A step that a change has cut short may leave an error of rounding, which says nothing of a length.
        length = max(SHORTEST, length if cut and allowed >= GROWTH * taken else min(allowed, GROWTH * taken))
        point = end
    return point, replace(trace, solves=counted.calls)


class _Counted:
    """A solver that counts its calls."""

    def __init__(self, solve: Solver):
        self.solve, self.calls = solve, 0

    def __call__(self, point: Point, s: float, anchor: np.ndarray) -> Point:
        self.calls += 1
        return self.solve(point, s, anchor)


def _to_first_change(solve, start, s, tolerance) -> tuple[Point, bool]:
    """One step of backward Euler's method to s, or to just after the first contact that opens or closes before; and
    whether it is the latter."""
    before, after = start, solve(start, s, start.position)
    known, idle = [start], 0  # points on the near side of the change
    while start.differs(after).any():
        moved = float(np.abs(after.position - start.position).max(initial=0.0))
        width = max(SHORTEST, PLACE * tolerance / max(moved, tolerance) * (after.share - start.share))
        bracket = after.share - before.share
        if bracket <= width:
            return after, True
        place = _crossing(known, start.differs(after)) if idle < BISECTED else np.nan
        inside = np.isfinite(place) and before.share <= place < after.share
        trial = place + 0.5 * width if inside else 0.5 * (before.share + after.share)
        trial = min(max(trial, before.share + 0.5 * width), after.share - 0.25 * width)
        found = solve(start, trial, start.position)
        if start.differs(found).any():
            after = found
        else:
            before, known = found, [*known[-1:], found]
        idle = 0 if not inside or after.share - before.share <= 0.5 * bracket else idle + 1
    return after, after.share < s


def _crossing(known, changed) -> float:
    """Where the first of the contacts that change has its gap or its normal force vanish, by the secant; NaN from one
    point alone."""
    if len(known) < 2:
        return np.nan
    first, second = (np.where(point.closed, point.force[:, 0], point.gap)[changed] for point in known)
    slope = (second - first) / (known[1].share - known[0].share)
    falling = slope < 0
    return float((known[1].share - second[falling] / slope[falling]).min(initial=np.inf))


def _extrapolate(solve, start, whole):
    """The step from `start` to where `whole`, its one step of backward Euler's method, ends, by (1).

    Returns
    -------
    end : Point
        Its states are those of the shortest steps' end.
    way : list of array
        Net slip, its length and work, and the shares of the states, these of the shortest steps.
    difference : (m, d - 1) array
        Of the positions of the last two orders.
    """
    counted = start.closed | start.touches & whole.closed
    rows: list[list[list]] = []
    for n in SEQUENCE:
        point, way = start, None
        for i in range(1, n + 1):
            s = start.share + i / n * (whole.share - start.share)
            before, point = point, whole if n == 1 else solve(point, s, point.position)
            # What changes, changes at the end of the step: until then a contact is closed that was so at its start.
            state = np.where(point.closed, point.state, np.where(before.closed, before.state, STICK))
            gone = [*_gone(before, point, counted), shares(np.where(counted, state, OPEN)) / n]
            way = gone if way is None else [a + b for a, b in zip(way, gone)]
        row = [[point.position, point.gap, point.force, point.held, *way]]
        for k, above in enumerate(rows[-1] if rows else []):
            ratio = n / SEQUENCE[len(rows) - k - 1] - 1
            row.append([a + (a - b) / ratio for a, b in zip(row[-1], above)])
        rows.append(row)
    position, gap, force, held, *way = rows[-1][-1]
    way[3] = rows[-1][0][-1]
    return Point(whole.share, position, gap, force, point.state, held), way, position - rows[-1][-2][0]


def _gone(before: Point, after: Point, counted: np.ndarray):
    """Slip (m, d - 1), its length (m,) and its work (m,) of the contacts that count, between two points: the force of
    backward Euler's method is that at the end."""
    slip = np.where(counted[:, None], after.position - before.position, 0.0)
    return [slip, np.linalg.norm(slip, axis=1), -np.sum(after.force[:, 1:] * slip, axis=1)]


def shares(state):
    """(m, 3) ones where the contacts are open, stuck, slipping."""
    return np.stack([state == OPEN, state == STICK, state == SLIP], axis=-1).astype(float)
