"""How contacts get from one load to the next: friction has memory, so that the way there is part of the answer.

Between two loads the displacements without contact forces go straight from ``b⁰`` to ``b¹``, ``b(s) = b⁰ + s (b¹ -
b⁰)``, and ``u = S f + b(s)``.  A contact that slips moves against its force, and one that sticks or is open does not
slip; where each of them stands, the point from which its slip is measured, is the *anchor* ``a`` (m, 2).  One step of
backward Euler's method solves the law with ``u_t - a`` in place of ``u_t`` and moves the anchor to ``u_t``.  Where
contacts yield before they slip, the anchor is where their sliders stand, ``u_t + c f_t``
(:mod:`mic.contact.laws.micro_slip`).

:class:`Increments` takes steps of this kind, first order.  :class:`Followed` is of second order and controls its
error (:mod:`mic.contact.native.follower`).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, fields, replace
from functools import reduce

import numpy as np

from mic.contact.increments import Increments
from mic.contact.path_record import Trail, trails
from mic.contact.solution import ContactSolution
from mic.contact.states import OPEN, SLIP, STICK, classify
from mic.system.matrix_product import product

__all__ = ["Followed", "Increments", "Leg", "Path", "PathSolution", "Trace", "at_once", "ended"]

#: Increments of a leg for a sample that the follower gives up.
RESCUE = 256


@dataclass(frozen=True)
class Followed:
    """Steps of second order, as long as their error allows.

    Attributes
    ----------
    tolerance : float
        Largest error of a step, as a share of the tangential motion that the contacts made on the leg so far (root mean
        squares over the contacts).
    least : float
        Of a motion at least so large, however little the contacts have moved [length].
    steps : int or None
        So many equal steps instead, whatever their error: to show the order of the method.
    recorded : bool
        Whether the solution tells its :class:`mic.contact.path_record.Trail`.
    """

    tolerance: float = 2.5e-4
    least: float = 0.0
    steps: int | None = None
    recorded: bool = False

    @property
    def ends(self) -> np.ndarray:
        """(steps,) where equal steps end; none, if their error is controlled."""
        return np.arange(1, (self.steps or 0) + 1) / (self.steps or 1)


Path = Increments | Followed


@dataclass(frozen=True)
class Trace:
    """What n samples of m contacts went through on a path.

    Attributes
    ----------
    slip : (n, m, 2) array
        Net slip under load: tangential motion of the anchor while the contact was closed, mm.
    length : (n, m) array
        Its length along the way, mm.
    work : (n, m) array
        Work dissipated by friction, N mm; never negative.
    share : (n, m, 3) array
        Shares of the path that the contact was open, stuck and slipping.
    error : (n,) array
        Estimate of the error that the path left in the contacts' tangential positions, and in the slip of those that
        opened, root mean square over the contacts, mm; NaN where nothing estimates it.
    steps, factorisations : (n,) int array
        What it took: matrices over the contacts that touch that were factorised or inverted anew, by whichever rung,
        those of a rung that failed too.  What changes a few rows of an inverse is not counted, nor what is factorised
        once for all samples.
    """

    slip: np.ndarray
    length: np.ndarray
    work: np.ndarray
    share: np.ndarray
    error: np.ndarray
    steps: np.ndarray
    factorisations: np.ndarray

    @classmethod
    def start(cls, n: int, m: int) -> Trace:
        """Nothing has happened yet."""
        none = np.zeros(n, dtype=np.int64)
        return cls(
            np.zeros((n, m, 2)), np.zeros((n, m)), np.zeros((n, m)), np.zeros((n, m, 3)), np.zeros(n), none, none.copy()
        )

    def weighted(self, weight: float) -> Trace:
        """With the shares of the path multiplied, where paths of unequal length come one after the other."""
        return replace(self, share=weight * self.share)

    def __add__(self, other: Trace) -> Trace:
        """One after the other; shares add up, for :meth:`PathSolution.join` to divide by the number of paths."""
        return Trace(**{field.name: getattr(self, field.name) + getattr(other, field.name) for field in fields(Trace)})


@dataclass(frozen=True)
class PathSolution:
    """Where n samples ended.

    Attributes
    ----------
    force : (n, 3m) array
    displacement : (n, 3m) array
        ``u = S f + b¹``.
    anchor : (n, m, 2) array
        Where the contacts stand, from which slip goes on.
    trace : Trace
    residual : (n,) array
        The largest of the steps whose certificate was taken: all increments, or the end of a followed path.
    converged : (n,) bool array
    iterations : (n,) int array
    status, rung : (n,) object array
        Of the last step; the rung is ``"followed"`` or ``"increments"``, or the ladder's where neither would do.
    trail : (n,) object array or None
        The :class:`mic.contact.path_record.Trail` of each sample, of the last leg, where its path is recorded.
    """

    force: np.ndarray
    displacement: np.ndarray
    anchor: np.ndarray
    trace: Trace
    residual: np.ndarray
    converged: np.ndarray
    iterations: np.ndarray
    status: np.ndarray
    rung: np.ndarray
    trail: np.ndarray | None = None

    def put(self, own: np.ndarray, some: PathSolution) -> PathSolution:
        """These paths, those of the samples `own` replaced; what was factorised in vain counts too."""
        found = _put(self, own, some)
        found.trace.factorisations[own] += self.trace.factorisations[own]
        return found

    @classmethod
    def join(cls, pieces: Sequence[PathSolution]) -> PathSolution:
        """Paths in a row: where the last one ended, and what all of them were.

        A sample has the rung of its last path, unless that was followed and one before had to be rescued.
        """
        last = pieces[-1]
        if len(pieces) == 1:
            return last
        rung = last.rung.copy()
        for piece in pieces:
            rescued = (piece.rung != "followed") & (rung == "followed")
            rung[rescued] = piece.rung[rescued]
        trace = reduce(Trace.__add__, (piece.trace for piece in pieces))
        return replace(
            last,
            trace=replace(trace, share=trace.share / len(pieces)),
            residual=np.max([piece.residual for piece in pieces], axis=0),
            converged=np.all([piece.converged for piece in pieces], axis=0),
            iterations=np.sum([piece.iterations for piece in pieces], axis=0),
            rung=rung,
        )


@dataclass(frozen=True)
class Leg:
    """What a follower found between two loads, good or not: the caller certifies it.

    Attributes
    ----------
    force : (n, 3m) array
        At the end.
    b : (n, 3m) array
        Displacements without contact forces, from where slip is measured in the last step: the problem that `force`
        solves.
    anchor : (n, m, 2) array
    slip, length, work, share, error
        As :class:`Trace` has them.
    steps, factorisations : (n,) int array
        As :class:`Trace` has them.
    given_up : (n,) bool array
    trail : (n,) object array or None
        As :class:`PathSolution` has it.
    """

    force: np.ndarray
    b: np.ndarray
    anchor: np.ndarray
    slip: np.ndarray
    length: np.ndarray
    work: np.ndarray
    share: np.ndarray
    error: np.ndarray
    steps: np.ndarray
    factorisations: np.ndarray
    given_up: np.ndarray
    trail: np.ndarray | None = None

    @classmethod
    def start(cls, n: int, m: int) -> Leg:
        """No forces yet, all contacts open on all of the way, with friction."""
        trace = Trace.start(n, m)
        trace.share[:, :, OPEN] = 1.0
        return cls(
            force=np.zeros((n, 3 * m)),
            b=np.zeros((n, 3 * m)),
            anchor=np.zeros((n, m, 2)),
            given_up=np.zeros(n, dtype=bool),
            **vars(trace),
        )


def follow(solver, b, force, anchor, path: Path) -> PathSolution:
    """Leg by leg, each starting where the one before ended; see :meth:`mic.contact.ContactSolver.follow`."""
    n, loads, _ = b.shape
    m, d = solver.contacts, solver.dimension
    force = np.zeros((n, d * m)) if force is None else force
    anchor = b[:, 0].reshape(n, m, d)[:, :, 1:] if anchor is None else anchor
    if not solver.law.frictional:
        return at_once(solver, b[:, -1], force, path.recorded)
    legs = []
    for k in range(loads - 1):
        b0, b1 = b[:, k], b[:, k + 1]
        if solver.law.followed:
            leg = followed(solver, b0, b1, force, anchor, path)
        else:
            leg = increments(
                solver, b0, b1, force, anchor, path if isinstance(path, Increments) else Increments(1, path.recorded)
            )
        force, anchor = leg.force, leg.anchor
        legs.append(leg)
    return PathSolution.join(legs)


def followed(solver, b0, b1, force, anchor, path: Path) -> PathSolution:
    """One leg by the compiled follower; a sample that it gives up, or whose end misses the certificate, is rescued by
    increments, each with the whole ladder."""
    n = len(b0)
    plain = isinstance(path, Increments)
    leg = solver.backend.follow(b0, b1, force, anchor, path)
    name = "increments" if plain else "followed"
    moved = product(leg.force, solver.S)
    residual, converged, status = solver.judged(leg.b, leg.force, moved)
    trace = Trace(
        leg.slip,
        leg.length,
        leg.work,
        leg.share,
        np.full(n, np.nan) if plain else leg.error,
        leg.steps,
        leg.factorisations,
    )
    found = PathSolution(
        force=leg.force,
        displacement=moved + b1,
        anchor=leg.anchor,
        trace=trace,
        residual=residual,
        converged=converged,
        iterations=leg.factorisations,
        status=status,
        rung=np.full(n, name, dtype=object),
        trail=leg.trail,
    )
    lost = np.flatnonzero(~converged | leg.given_up)
    if not lost.size:
        return found
    rescue = path if isinstance(path, Increments) else Increments(RESCUE, path.recorded)
    return found.put(lost, increments(solver, b0[lost], b1[lost], force[lost], anchor[lost], rescue))


def _put(all_samples, own, some):
    """The first with the samples `own` from the second."""
    values = {}
    for field in fields(all_samples):
        value, new = getattr(all_samples, field.name), getattr(some, field.name)
        if isinstance(value, Trace):
            values[field.name] = _put(value, own, new)
        elif value is not None:
            value = value.copy()
            value[own] = new
            values[field.name] = value
    return type(all_samples)(**values)


def increments(solver, b0, b1, force, anchor, path: Increments) -> PathSolution:
    """Steps of backward Euler's method; the arguments of :meth:`mic.contact.ContactSolver.follow`."""
    n, m = len(b0), solver.contacts
    trace = Trace.start(n, m)
    error = np.full(n, np.nan)
    slip, length, work, share = trace.slip, trace.length, trace.work, trace.share
    converged, residual = np.ones(n, dtype=bool), np.zeros(n)
    iterations, factorisations = np.zeros(n, dtype=np.int64), np.zeros(n, dtype=np.int64)
    ends, forces = path.ends, []
    for end, part in zip(ends, np.diff(ends, prepend=0.0)):
        b = b0 + end * (b1 - b0)
        b = b.reshape(n, m, 3).copy()
        b[:, :, 1:] -= anchor
        # Where Coulomb's law has several solutions, take the one that continues the state before.
        solution = solver.solve(b.reshape(n, -1), guess=force)
        before, now = (f.reshape(n, m, 3) for f in (force, solution.force))
        moved = solution.displacement.reshape(n, m, 3)[:, :, 1:] + solver.compliance[:, None] * now[:, :, 1:]
        state = classify(now, solver.bound(now[..., 0]))
        closed = state != OPEN
        slid = np.where((state == SLIP)[:, :, None], moved, 0.0)
        slip, length = slip + slid, length + np.linalg.norm(slid, axis=-1)
        # The trapezoidal rule where the contact was closed before, else its force has grown from nothing.
        work = work - np.sum(0.5 * (before + now)[:, :, 1:] * slid, axis=-1)
        share = share + np.stack([~closed, state == STICK, state == SLIP], axis=-1) * part
        anchor = anchor + moved
        force = solution.force
        forces.append(force)
        converged &= solution.converged
        residual = np.maximum(residual, solution.residual)
        iterations = iterations + solution.iterations
        factorisations = factorisations + solution.factorisations
    u = (product(force, solver.S) + b1).reshape(n, -1)
    steps = np.full(n, path.count, dtype=np.int64)
    return PathSolution(
        force,
        u,
        anchor,
        Trace(slip, length, work, share, error, steps, factorisations),
        residual,
        converged,
        iterations,
        np.asarray(solution.status),
        np.asarray(solution.rung),
        _trails(ends, forces) if path.recorded else None,
    )


def _trails(ends, forces) -> np.ndarray:
    """(n,) of steps of first order that all samples take, forces (n, d m) at the end of each."""
    return trails(Trail(1, ends, own) for own in np.stack(forces, axis=1))


def at_once(solver, b, guess, recorded: bool = False) -> PathSolution:
    """The law at the end alone, as if nothing had been before: all that counts without friction.

    Parameters
    ----------
    solver : mic.contact.ContactSolver
    b, guess : (n, d m) array
    recorded : bool
    """
    return ended(solver, solver.solve(b, guess=guess), recorded)


def ended(solver, solution: ContactSolution, recorded: bool = False) -> PathSolution:
    """A path that is no more than the `solution` (n samples) at its end, by a :class:`mic.contact.ContactSolver`."""
    n, m = len(solution.force), solver.contacts
    u = solution.displacement.reshape(n, m, -1)
    force = solution.force.reshape(n, m, -1)
    state = classify(force, solver.bound(force[:, :, 0]))
    share = np.stack([state == OPEN, state == STICK, state == SLIP], axis=-1).astype(float)
    trace = replace(
        Trace.start(n, m), share=share, steps=np.ones(n, dtype=np.int64), factorisations=solution.factorisations
    )
    return PathSolution(
        solution.force,
        solution.displacement,
        u[:, :, 1:],
        trace,
        solution.residual,
        solution.converged,
        solution.iterations,
        np.asarray(solution.status),
        np.asarray(solution.rung),
        _trails(np.ones(1), [solution.force]) if recorded else None,
    )
