"""Load paths: contact forces under friction depend on the loading history.

Between two loads the displacements without contact forces change linearly from ``b⁰`` to ``b¹``, ``b(s) = b⁰ + s (b¹ -
b⁰)``, and ``u = S f + b(s)``.  A slipping contact moves against its tangential force; a sticking or open one does not
slip. The point from which the slip of a contact is measured is its *anchor* ``a`` (m, 2).  One step of
backward Euler's method solves the law with ``u_t - a`` in place of ``u_t`` and moves the anchor to ``u_t``.  With
compliant contacts, the anchor is the position of the slider, ``u_t + c f_t``
(:mod:`mic.contact.laws.micro_slip`).

:class:`Increments` are such steps, of first order.  :class:`Followed` is of second order with error control
(:mod:`mic.contact.native.follower`).
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, fields, replace
from functools import reduce

import numpy as np

from mic.contact.increments import Increments
from mic.contact.path_record import PathRecord, record_array
from mic.contact.solution import ContactSolution, Status
from mic.contact.states import OPEN, SLIP, STICK, classify
from mic.system.matrix_product import product

__all__ = ["FORCES", "Followed", "Increments", "Leg", "Path", "PathSolution", "Trace", "end_state", "from_solution"]

#: Errors of contact forces in a step may be so many times those of positions, each relative to its own size: positions
#: add up over some forty steps, but a contact that slides forgets what its force was.
FORCES = 64.0
#: Increments of a leg for samples at which the follower fails.
RESCUE = 256


@dataclass(frozen=True)
class Followed:
    """Second-order steps, their length controlled by an error estimate.

    Attributes
    ----------
    tolerance : float
        Largest error of the tangential positions in a step, relative to the tangential motion on the leg so far (root
        mean squares over the contacts); the contact forces may err by :data:`FORCES` times as much, relative to their
        largest so far.
    least : float
        Motion that the error may be relative to where the contacts have moved by less [length].
    steps : int or None
        Number of equal steps without error control, to measure the order of the method.
    recorded : bool
        Whether the solution includes its :class:`mic.contact.path_record.PathRecord`.
    """

    tolerance: float = 2.5e-4
    least: float = 0.0
    steps: int | None = None
    recorded: bool = False

    @property
    def ends(self) -> np.ndarray:
        """(steps,) ends of equal steps; empty with error control."""
        return np.arange(1, (self.steps or 0) + 1) / (self.steps or 1)


Path = Increments | Followed


@dataclass(frozen=True)
class Trace:
    """Slip, work and states of m contacts along a path, for n samples.

    Attributes
    ----------
    slip : (n, m, 2) array
        Net slip under load: tangential motion of the anchor while the contact was closed, mm.
    length : (n, m) array
        Accumulated length of the slip, mm.
    work : (n, m) array
        Work dissipated by friction, N mm; never negative.
    share : (n, m, 3) array
        Fractions of the path on which the contact was open, stuck and slipping.
    error : (n,) array
        Estimated integration error of the contacts' tangential positions, and of the slip of those that opened: root
        mean square over the contacts, mm; NaN if not estimated.
    force_error : (n,) array
        Estimated integration error of the contact forces, likewise, N; the sum over all steps, although contacts that
        slide or open lose it.
    steps, factorisations : (n,) int array
        Number of steps, and of matrices over the closed contacts that were factorised or inverted, failed rungs
        included.  Low-rank updates and factorisations shared by all samples are not counted.
    """

    slip: np.ndarray
    length: np.ndarray
    work: np.ndarray
    share: np.ndarray
    error: np.ndarray
    force_error: np.ndarray
    steps: np.ndarray
    factorisations: np.ndarray

    @classmethod
    def start(cls, n: int, m: int) -> Trace:
        """The trace at the start of a path."""
        return cls(
            slip=np.zeros((n, m, 2)),
            length=np.zeros((n, m)),
            work=np.zeros((n, m)),
            share=np.zeros((n, m, 3)),
            error=np.zeros(n),
            force_error=np.zeros(n),
            steps=np.zeros(n, dtype=np.int64),
            factorisations=np.zeros(n, dtype=np.int64),
        )

    @classmethod
    def of_step(cls, state: np.ndarray, factorisations: np.ndarray) -> Trace:
        """The trace of one step that ends in states (n, m), without slip."""
        share = np.stack([state == OPEN, state == STICK, state == SLIP], axis=-1).astype(float)
        start, steps = cls.start(*state.shape), np.ones(len(state), dtype=np.int64)
        return replace(start, share=share, steps=steps, factorisations=factorisations)

    def with_slip(self, motion: np.ndarray, before: np.ndarray, force: np.ndarray) -> Trace:
        """The trace of one step whose slipping contacts have moved by `motion` (n, m, 2); contact forces (n, m, 3)
        before the step and after it."""
        slip = np.where(self.share[:, :, SLIP, None] > 0.0, motion, 0.0)
        # The trapezoidal rule; a contact that was open before has zero force there.
        work = -np.sum(0.5 * (before + force)[:, :, 1:] * slip, axis=-1)
        return replace(self, slip=slip, length=np.linalg.norm(slip, axis=-1), work=work)

    def weighted(self, weight: float) -> Trace:
        """The trace with its shares multiplied, for paths of unequal length in sequence."""
        return replace(self, share=weight * self.share)

    def add(self, own: np.ndarray, other: Trace) -> None:
        """Append paths of the samples `own` to this trace, in place."""
        for field in fields(Trace):
            getattr(self, field.name)[own] += getattr(other, field.name)

    def __add__(self, other: Trace) -> Trace:
        """Two paths in sequence; the shares are summed, and :meth:`PathSolution.join` divides them by their number."""
        return Trace(**{field.name: getattr(self, field.name) + getattr(other, field.name) for field in fields(Trace)})


@dataclass(frozen=True)
class PathSolution:
    """State of n samples at the end of a path.

    Attributes
    ----------
    force : (n, 3m) array
    displacement : (n, 3m) array
        ``u = S f + b¹``.
    anchor : (n, m, 2) array
        Points from which further slip is measured.
    trace : Trace
    residual : (n,) array
        The largest of the steps that were certified: the ends of legs, and every increment that the compiled follower
        did not solve.
    converged : (n,) bool array
    iterations : (n,) int array
    status, rung : (n,) object array
        Of the last step, or of the first without a solution; the rung is ``"followed"`` or ``"increments"``, or that of
        the ladder if both failed.
    record : (n,) object array or None
        The :class:`mic.contact.path_record.PathRecord` of the last leg of each sample, if its path is recorded.
    unresolved : (n, m) bool array or None
        Contacts that do not satisfy their law on their own scale in the steps that were certified, see
        :attr:`mic.contact.solution.ContactSolution.unresolved`; None if the solver does not certify each contact, and
        for working sets of candidates.
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
    record: np.ndarray | None = None
    unresolved: np.ndarray | None = None

    def replaced(self, own: np.ndarray, new: PathSolution) -> PathSolution:
        """The paths with those of the samples `own` replaced; factorisations of both count."""
        solution = with_samples(self, own, new)
        solution.trace.factorisations[own] += self.trace.factorisations[own]
        return solution

    @classmethod
    def join(cls, pieces: Sequence[PathSolution]) -> PathSolution:
        """Paths in sequence: the end of the last one, and the sums of their traces.

        The rung of a sample is that of its last path, or of an earlier one that could not be followed.
        """
        last = pieces[-1]
        if len(pieces) == 1:
            return last
        rung, status = last.rung.copy(), last.status.copy()
        for piece in pieces:
            not_followed = (piece.rung != "followed") & (rung == "followed")
            rung[not_followed] = piece.rung[not_followed]
            failed = ~piece.converged & (status == Status.CONVERGED)
            status[failed] = piece.status[failed]
        trace = reduce(Trace.__add__, (piece.trace for piece in pieces))
        return replace(
            last,
            trace=replace(trace, share=trace.share / len(pieces)),
            residual=np.max([piece.residual for piece in pieces], axis=0),
            converged=np.all([piece.converged for piece in pieces], axis=0),
            iterations=np.sum([piece.iterations for piece in pieces], axis=0),
            rung=rung,
            status=status,
        )


@dataclass(frozen=True)
class Leg(Trace):
    """Result of a follower between two loads, not certified yet; slip, work and states as :class:`Trace` has them.

    Attributes
    ----------
    force : (n, 3m) array
        Contact forces at the end.
    b : (n, 3m) array
        Displacements without contact forces, relative to the anchors of the last step: the problem that `force` solves.
    anchor : (n, m, 2) array
    given_up : (n,) bool array
        Whether the follower failed.
    record : (n,) object array or None
        As :class:`PathSolution` has it.
    """

    force: np.ndarray
    b: np.ndarray
    anchor: np.ndarray
    given_up: np.ndarray
    record: np.ndarray | None = None

    @classmethod
    def start(cls, n: int, m: int) -> Leg:
        """No forces, all contacts open along the leg, with friction."""
        trace = Trace.start(n, m)
        trace.share[:, :, OPEN] = 1.0
        force, anchor = np.zeros((n, 3 * m)), np.zeros((n, m, 2))
        return cls(**vars(trace), force=force, b=force.copy(), anchor=anchor, given_up=np.zeros(n, dtype=bool))

    def trace(self, **changed: np.ndarray) -> Trace:
        """The trace alone, some of its fields changed."""
        return Trace(**{field.name: getattr(self, field.name) for field in fields(Trace)} | changed)


def follow(solver, b, force, anchor, path: Path) -> PathSolution:
    """Solve leg by leg, each from the end of the previous one; see :meth:`mic.contact.ContactSolver.follow`."""
    n, loads, _ = b.shape
    m, d = solver.contacts, solver.dimension
    force = np.zeros((n, d * m)) if force is None else force
    anchor = b[:, 0].reshape(n, m, d)[:, :, 1:] if anchor is None else anchor
    if not solver.law.frictional:
        return end_state(solver, b[:, -1], force, path.recorded)
    if not (solver.law.followed or isinstance(path, Increments)):
        path = Increments(1, path.recorded)
    outside = solver.outside_range(b.reshape(n, -1))  # a path has units and is not scaled
    if outside.any():
        b, force, anchor = b.copy(), force.copy(), anchor.copy()
        b[outside], force[outside], anchor[outside] = 0.0, 0.0, 0.0
    solve_leg: Callable[..., PathSolution] = followed if solver.law.followed else increments
    legs = []
    for k in range(loads - 1):
        leg = solve_leg(solver, b[:, k], b[:, k + 1], force, anchor, path)
        force, anchor = leg.force, leg.anchor
        legs.append(leg)
    named = [leg.unresolved for leg in legs if leg.unresolved is not None]
    solution = replace(PathSolution.join(legs), unresolved=np.any(named, axis=0) if named else None)
    solution.converged[outside], solution.residual[outside] = False, np.inf
    solution.status[outside] = Status.OUT_OF_RANGE
    return solution


def followed(solver, b0, b1, force, anchor, path: Path) -> PathSolution:
    """One leg by the compiled follower; samples at which it fails, or whose end is not certified, are solved by
    increments, each with the whole ladder."""
    n = len(b0)
    incremental = isinstance(path, Increments)
    leg = solver.backend.follow(b0, b1, force, anchor, path)
    response = product(leg.force, solver.S)
    residual, converged, status = solver.check_convergence(leg.b, leg.force, response)
    solution = PathSolution(
        force=leg.force,
        displacement=response + b1,
        anchor=leg.anchor,
        trace=leg.trace(**_unknown(n)) if incremental else leg.trace(),
        residual=residual,
        converged=converged,
        iterations=leg.factorisations,
        status=status,
        rung=np.full(n, "increments" if incremental else "followed", dtype=object),
        record=leg.record,
        unresolved=solver.unresolved(leg.b, leg.force, response),
    )
    failed = np.flatnonzero(~converged | leg.given_up)
    if not failed.size:
        return solution
    fallback = path if isinstance(path, Increments) else Increments(RESCUE, path.recorded)
    again = increments(solver, b0[failed], b1[failed], force[failed], anchor[failed], fallback)
    return solution.replaced(failed, again)


def with_samples(batch, own, new):
    """A copy of a dataclass of arrays (n, …) with the samples `own` taken from a `new` one."""
    values = {}
    for name, value in vars(batch).items():
        if isinstance(value, Trace):
            values[name] = with_samples(value, own, getattr(new, name))
        elif value is not None:
            values[name] = value.copy()
            values[name][own] = getattr(new, name)
    return replace(batch, **values)


def increments(solver, b0, b1, force, anchor, path: Increments) -> PathSolution:
    """Steps of backward Euler's method; the arguments of :meth:`mic.contact.ContactSolver.follow`."""
    n, m = len(b0), solver.contacts
    trace = Trace.start(n, m)
    converged, residual, iterations = np.ones(n, dtype=bool), np.zeros(n), np.zeros(n, dtype=np.int64)
    status, rung = np.full(n, Status.CONVERGED, dtype=object), np.full(n, "increments", dtype=object)
    force, anchor = force.copy(), anchor.copy()
    unresolved = np.zeros((n, m), dtype=bool) if solver.certify_each else None
    ends, forces = path.ends, []
    for end, part in zip(ends, np.diff(ends, prepend=0.0)):
        left = np.flatnonzero(converged)  # a sample ends at its first increment without a solution
        if not left.size:
            forces.append(force.copy())
            continue
        b = (b0[left] + end * (b1[left] - b0[left])).reshape(len(left), m, 3)
        b[:, :, 1:] -= anchor[left]
        # If Coulomb's law has several solutions, the guess selects the one that continues the last state.
        solution = solver.solve(b.reshape(len(left), -1), guess=force[left], refine=False)
        before, now = (f.reshape(-1, m, 3) for f in (force[left], solution.force))
        moved = solution.displacement.reshape(-1, m, 3)[:, :, 1:] + solver.compliance[:, None] * now[:, :, 1:]
        step = Trace.of_step(classify(now, solver.bound(now[..., 0])), solution.factorisations)
        trace.add(left, step.with_slip(moved, before, now).weighted(part))
        anchor[left] += moved
        force[left] = solution.force
        forces.append(force.copy())
        converged[left], status[left], rung[left] = solution.converged, solution.status, solution.rung
        residual[left] = np.maximum(residual[left], solution.residual)
        if unresolved is not None:
            unresolved[left] |= solution.unresolved
        iterations[left] += solution.iterations
    return PathSolution(
        force=force,
        displacement=(product(force, solver.S) + b1).reshape(n, -1),
        anchor=anchor,
        trace=replace(trace, **_unknown(n)),
        residual=residual,
        converged=converged,
        iterations=iterations,
        status=status,
        rung=rung,
        record=_records(ends, forces) if path.recorded else None,
        unresolved=unresolved,
    )


def _unknown(n: int) -> dict[str, np.ndarray]:
    """Errors of n paths that are not estimated."""
    return {"error": np.full(n, np.nan), "force_error": np.full(n, np.nan)}


def _records(ends, forces) -> np.ndarray:
    """(n,) records of first-order steps that are the same for all samples, with forces (n, d m) at the end of each."""
    return record_array(PathRecord(1, ends, force) for force in np.stack(forces, axis=1))


def end_state(solver, b, guess, recorded: bool = False) -> PathSolution:
    """Solve the law at the end alone, without history: exact without friction.

    Parameters
    ----------
    solver : mic.contact.ContactSolver
    b, guess : (n, d m) array
    recorded : bool
    """
    return from_solution(solver, solver.solve(b, guess=guess, refine=False), recorded)


def from_solution(solver, solution: ContactSolution, recorded: bool = False) -> PathSolution:
    """The path of one step that ends in a `solution` (n samples) of a :class:`mic.contact.ContactSolver`."""
    n, m = len(solution.force), solver.contacts
    force = solution.force.reshape(n, m, -1)
    return PathSolution(
        force=solution.force,
        displacement=solution.displacement,
        anchor=solution.displacement.reshape(n, m, -1)[:, :, 1:],
        trace=Trace.of_step(classify(force, solver.bound(force[:, :, 0])), solution.factorisations),
        residual=solution.residual,
        converged=solution.converged,
        iterations=solution.iterations,
        status=np.asarray(solution.status),
        rung=np.asarray(solution.rung),
        record=_records(np.ones(1), [solution.force]) if recorded else None,
        unresolved=solution.unresolved,
    )
