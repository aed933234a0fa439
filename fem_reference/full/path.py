r"""Integration of a load path: increments, or extrapolated backward Euler with event location.

A path has a parameter s from 0 to 1. One step of backward Euler's method from s to s + h solves equilibrium at s + h,
with each contact's slip measured from its position at s. While no contact opens or closes, the error has an expansion
in powers of h, so that results with the step divided into n₁ < n₂ < … equal parts extrapolate to h → 0,

    T_{j,k+1} = T_{j,k} + (T_{j,k} − T_{j−1,k}) / (n_j / n_{j−k} − 1),                                     (1)

and the difference of the last two orders estimates the error of the lower one. A step whose difference exceeds the
tolerance is repeated with a shorter length. Displacements, reactions and contact forces extrapolate with the same
weights: they satisfy equilibrium exactly, and the contact law to the order of the step. A step ends where a contact
opens or closes; this point is bracketed and found by the secant method on the gap or the normal force.

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

SEQUENCE = (1, 2, 3)  #: n of (1): third order with an error estimate
SHORTEST = 1e-8  #: shortest step; below it, rounding of the forces is as large as their change
TOUCHING = 1e-9  #: mm: an open contact with a smaller gap counts as touching
GROWTH = 4.0  #: largest factor by which a step grows or shrinks
SAFETY = 0.8  #: safety factor on the step length that meets the tolerance
PLACE = 0.1  #: motion of contacts within the bracket of an opening or closing, relative to the tolerance
BISECTED = 3  #: secant steps in a row that reduce the bracket by less than half, before bisection


@dataclass(frozen=True)
class Point:
    """Equilibrium at a share s of a path.

    Attributes
    ----------
    share : float
    position : (m, d - 1) array
        Tangential position of the contacts, or of their sliders if they yield, mm; slip is measured from it.
    gap : (m,) array
        mm.
    force : (m, d) array
        N.
    state : (m,) array
        A :class:`mic.contact.states.ContactState` each.
    unknowns : (k,) array
        All unknowns of the solver, or a linear combination of solutions.
    """

    share: float
    position: np.ndarray
    gap: np.ndarray
    force: np.ndarray
    state: np.ndarray
    unknowns: np.ndarray

    def first(self, m: int) -> Point:
        """The same point with only the first m contacts; all unknowns remain."""
        return replace(self, **{name: getattr(self, name)[:m] for name in ("position", "gap", "force", "state")})

    @property
    def closed(self) -> np.ndarray:
        """(m,) whether each contact is closed."""
        return self.state != OPEN

    def differs(self, other: Point) -> np.ndarray:
        """(m,) whether each contact is open here and closed in `other`, or the reverse; not if it touches here."""
        return (self.closed != other.closed) & ~self.touches

    @property
    def touches(self) -> np.ndarray:
        """(m,) whether each contact touches without force."""
        return ~self.closed & (self.gap <= TOUCHING)


#: ``solve(point, s, anchor)`` returns the equilibrium at s, started from `point`, with slip measured from `anchor`.
Solver = Callable[[Point, float, np.ndarray], Point]


@dataclass(frozen=True)
class FullTrace:
    """History of the contacts of one assembly, as in :class:`mic.contact.path.Trace`.

    Attributes
    ----------
    slip : (m, d - 1) array
        Net slip under load, mm.
    length : (m,) array
        Length of the slip path, mm.
    work : (m,) array
        Dissipated by friction, N mm.
    share : (m, 3) array
        Shares of the path that each contact was open, stuck and slipping.
    error : float
        Estimated error of the contacts' tangential positions, root mean square over the contacts, mm: the sum over
        the steps of the differences in (1). NaN for increments, which have no estimate.
    steps, solves : int
        Accepted steps, and solved equilibria including those of repeated steps.
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
        """Empty history of m contacts."""
        return cls(np.zeros((m, d - 1)), np.zeros(m), np.zeros(m), np.zeros((m, 3)), 0.0, 0, 0)

    def first(self, m: int) -> FullTrace:
        """History of the first m contacts."""
        return replace(self, **{name: getattr(self, name)[:m] for name in ("slip", "length", "work", "share")})

    def __add__(self, other: FullTrace) -> FullTrace:
        """Consecutive histories; the shares add up and must be divided by the number of paths."""
        return FullTrace(
            **{item.name: getattr(self, item.name) + getattr(other, item.name) for item in fields(FullTrace)}
        )


def increments(solve: Solver, start: Point, count: int) -> tuple[Point, FullTrace]:
    """Steps of backward Euler's method at the ends of :class:`mic.contact.increments.Increments`."""
    point, trace = start, FullTrace.start(*start.force.shape)
    for end in Increments(count).ends:
        before, point = point, solve(point, end, point.position)
        trace += replace(transition(before, point), error=np.nan)
    return point, trace


def transition(before: Point, after: Point) -> FullTrace:
    """History of one step of backward Euler's method, without error estimate."""
    slip = _slip(before, after, after.state == SLIP)
    return FullTrace(*slip, shares(after.state) * (after.share - before.share), 0.0, 1, 1)


def extrapolated(solve: Solver, start: Point, tolerance: float) -> tuple[Point, FullTrace]:
    """Integrate a path with steps adapted to the tolerance that end where a contact opens or closes.

    Parameters
    ----------
    solve : Solver
    start : Point
        Equilibrium at s = 0.
    tolerance : float
        Largest error of a contact's position in a step as estimated by (1), mm.

    Raises
    ------
    NoConvergence
        If the solver fails even for the shortest step.
    """
    solve = counted = _Counted(solve)
    point, trace, length = start, FullTrace.start(*start.force.shape), 1.0
    while point.share < 1.0:
        try:
            whole, cut = _to_first_change(solve, point, min(1.0, point.share + length), tolerance)
            end, history, difference = _extrapolate(solve, point, whole)
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
        trace += FullTrace(*history[:3], history[3] * taken, rms, 1, 0)
        # A step ended by a change may have an error of rounding only, which gives no information on the next length.
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
    """One step of backward Euler's method to s, or to just after the first change of an open or closed contact; and
    whether a change ended it."""
    before, after = start, solve(start, s, start.position)
    known, idle = [start], 0  # points before the change
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
        point = solve(start, trial, start.position)
        if start.differs(point).any():
            after = point
        else:
            before, known = point, [*known[-1:], point]
        idle = 0 if not inside or after.share - before.share <= 0.5 * bracket else idle + 1
    return after, after.share < s


def _crossing(known, changed) -> float:
    """Secant estimate of s where the first gap or normal force of the changing contacts vanishes; NaN from one
    point."""
    if len(known) < 2:
        return np.nan
    first, second = (np.where(point.closed, point.force[:, 0], point.gap)[changed] for point in known)
    slope = (second - first) / (known[1].share - known[0].share)
    falling = slope < 0
    return float((known[1].share - second[falling] / slope[falling]).min(initial=np.inf))


def _extrapolate(solve, start, whole):
    """Extrapolate the step from `start` to the end of `whole`, its single step of backward Euler's method, by (1).

    Returns
    -------
    end : Point
        Its states are those after the shortest steps.
    history : list of array
        Net slip, its length and work, and the shares of the states from the shortest steps.
    difference : (m, d - 1) array
        Difference of the positions of the last two orders.
    """
    counted = start.closed | start.touches & whole.closed
    rows: list[list[list]] = []
    for n in SEQUENCE:
        point, history = start, None
        for i in range(1, n + 1):
            s = start.share + i / n * (whole.share - start.share)
            before, point = point, whole if n == 1 else solve(point, s, point.position)
            # Changes happen at the end of the step: a contact that was closed at its start counts as closed until then.
            state = np.where(point.closed, point.state, np.where(before.closed, before.state, STICK))
            added = [*_slip(before, point, counted), shares(np.where(counted, state, OPEN)) / n]
            history = added if history is None else [a + b for a, b in zip(history, added)]
        row = [[point.position, point.gap, point.force, point.unknowns, *history]]
        for k, above in enumerate(rows[-1] if rows else []):
            ratio = n / SEQUENCE[len(rows) - k - 1] - 1
            row.append([a + (a - b) / ratio for a, b in zip(row[-1], above)])
        rows.append(row)
    position, gap, force, unknowns, *history = rows[-1][-1]
    history[3] = rows[-1][0][-1]
    return Point(whole.share, position, gap, force, point.state, unknowns), history, position - rows[-1][-2][0]


def _slip(before: Point, after: Point, counted: np.ndarray):
    """Slip (m, d - 1), its length (m,) and its work (m,) of the `counted` contacts between two points, with the force
    at the end (backward Euler)."""
    slip = np.where(counted[:, None], after.position - before.position, 0.0)
    return [slip, np.linalg.norm(slip, axis=1), -np.sum(after.force[:, 1:] * slip, axis=1)]


def shares(state):
    """(m, 3) one-hot encoding of the states open, stuck, slipping."""
    return np.stack([state == OPEN, state == STICK, state == SLIP], axis=-1).astype(float)
