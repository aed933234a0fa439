"""The native backend: scaling once per ``S``, then every sample down the ladder."""

from __future__ import annotations

from collections.abc import Iterator
from concurrent.futures import ThreadPoolExecutor
from copy import copy
from dataclasses import replace
from typing import TYPE_CHECKING

import numpy as np

from mic.contact import ladder
from mic.contact.friction import Friction
from mic.contact.laws import Law
from mic.contact.lazy_memory import lazy_zeros
from mic.contact.native import follower, path_constants
from mic.contact.native.batch import Batch
from mic.contact.native.candidate_increment import Found, Samples, SolverContacts, follow_among
from mic.contact.native.frictionless import active_set
from mic.contact.native.infeasibility import infeasible
from mic.contact.native.landing import Landing
from mic.contact.native.matrices import block
from mic.contact.native.problem import ScaledProblem, inverse_root
from mic.contact.native.proximal_points import proximal_points
from mic.contact.native.splitting import splitting
from mic.contact.native.step_data import Control, Outcome, PathProblem, Record
from mic.contact.native.sweeps import sweeps
from mic.contact.path import FORCES, Increments, Leg, Path
from mic.contact.path_record import PathRecord, record_array

if TYPE_CHECKING:
    from mic.contact.compliance_columns import Columns

__all__ = ["NativeSolver"]

#: The method of every rung of :data:`mic.contact.ladder.BATCH`, by its name.
METHODS = {"sweeps": sweeps, "guess": sweeps, "splitting": splitting, "active set": active_set}
#: Tasks for each thread: few, because handing them out costs as much as an easy sample, and enough to level the load.
TASKS = 8

#: Sweeps before Newton's method where a step is the whole way: three times as many as on a followed path save one of
#: its steps in seven, and cost less.
SWEEPS = 30


class NativeSolver:
    """One compliance, scaled; solves batches of right-hand sides, :class:`mic.contact.backends.Backend`.

    Parameters
    ----------
    S : (3m, 3m) array, or (m, m) for ``dimension`` 1
        Symmetric compliance, all that stands in series with the sliders included.
    friction : Friction, or what makes one
    law : Law
    tol : float
        Certificate to reach.
    threads : int
    dimension : {3, 1}
    work : float
        Largest work of the fallback for one sample, see :data:`mic.contact.ladder.WORK`.

    Attributes
    ----------
    problem : ScaledProblem
    scaling : (3m,) or (m,) array
        ``D``, the scaled force's unit.
    """

    def __init__(self, S, friction, law: Law, tol: float, threads: int, dimension: int, work: float = ladder.WORK):
        self.tol, self.threads, self.work = tol, threads, work
        # Without friction the normal rows are all there is to solve.
        self._stride = 1 if law.frictional else dimension
        self._size = 3 if law.frictional else 1
        S = S[:: self._stride, :: self._stride]
        diagonal = S.diagonal()
        parameters = law.parameters(Friction.of(friction, len(S) // self._size))
        if law.frictional:
            diagonal = diagonal.reshape(-1, 3)
            d_n = inverse_root(diagonal[:, 0])
            d_t = inverse_root(0.5 * (diagonal[:, 1] + diagonal[:, 2]))
            self.scaling = np.column_stack([d_n, d_t, d_t]).ravel()
            parameters = law.scaled(parameters, d_n, d_t)
        else:
            self.scaling = inverse_root(diagonal)
        W = S * self.scaling[:, None]
        W *= self.scaling
        self.problem = ScaledProblem.of(law, np.ascontiguousarray(W), parameters)
        self._apart: list[NativeSolver] | None = None

    def with_friction(self, friction: Friction) -> NativeSolver:
        """See :meth:`mic.contact.backends.Backend.with_friction`."""
        some, law = copy(self), self.problem.law
        parameters = law.parameters(friction)
        if law.frictional:
            d_n, d_t = self.scaling.reshape(-1, 3)[:, :2].T
            parameters = law.scaled(parameters, d_n, d_t)
        some.problem = replace(self.problem, parameters=np.ascontiguousarray(parameters, dtype=float))
        some._apart = None
        return some

    def subset(self, own: np.ndarray) -> NativeSolver:
        """See :meth:`mic.contact.backends.Backend.subset`."""
        rows = np.flatnonzero(np.repeat(own, self._size))
        some, problem = copy(self), self.problem
        some.scaling = self.scaling[rows]
        some.problem = replace(
            problem,
            W=block(problem.W, np.flatnonzero(own), self._size),
            parameters=problem.parameters[own],
            factors=None if problem.factors is None else problem.factors[own],
        )
        some._apart = None
        return some

    def solve(self, b: np.ndarray, guess: np.ndarray | None) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
        """All samples, by the cheap rungs: each takes those that the ones before left unsolved.

        See :meth:`mic.contact.backends.Backend.solve`.
        """
        n, law, tol = len(b), self.problem.law, ladder.MARGIN * self.tol
        Q = np.ascontiguousarray(b[:, :: self._stride] * self.scaling)
        Y = np.zeros_like(Q) if guess is None else np.ascontiguousarray(guess[:, :: self._stride] / self.scaling)
        rungs = [rung for rung in ladder.BATCH if rung.applies(law) and (rung.name != "guess" or Y.any())]
        errors, iterations, factorisations = np.full(n, np.inf), *np.zeros((2, n), dtype=np.int64)
        found = np.full(n, rungs[0].name, dtype=object)
        for rung in rungs if Q.size else ():
            unsolved = np.flatnonzero(errors > tol)
            if not unsolved.size or (rung is not rungs[0] and self._still()):
                break
            if rung is not rungs[0] and len(self.problem.components) > 1:
                self._solve_apart(b, unsolved, rungs, Y, iterations, factorisations, found)
                break
            method = METHODS[rung.name](self.problem, rung, tol)
            self._share(method, unsolved, Batch(Q, Y, errors, iterations, factorisations))
            found[unsolved] = rung.name
        force = np.zeros_like(b)
        force[:, :: self._stride] = Y * self.scaling
        return force, iterations, factorisations, found

    def landing(self, own: np.ndarray, S: Columns) -> Landing:
        """See :meth:`mic.contact.backends.Backend.landing`."""
        return Landing(self.problem, self.scaling, own, S)

    def land(self, b: np.ndarray, guess: np.ndarray, among: np.ndarray, landing: Landing):
        """See :meth:`mic.contact.backends.Backend.land`."""
        Q, Y = np.ascontiguousarray(b * self.scaling), np.ascontiguousarray(guess / self.scaling)
        spent = landing.solve(self.problem, self.scaling, among, Q, Y, ladder.MARGIN * self.tol)
        return Y * self.scaling, spent, spent.copy(), np.full(len(b), "guess", dtype=object)

    def _solve_apart(self, b, unsolved, rungs, Y, iterations, factorisations, found):
        """The same samples, contacts that hang together by themselves: each goes down the ladder as far as it must."""
        furthest, names = np.zeros(len(unsolved), dtype=int), [rung.name for rung in rungs]
        for rows, own, part in self._parts(b.shape[1]):
            force, *counts, rung = part.solve(b[np.ix_(unsolved, rows)], None)
            Y[np.ix_(unsolved, own)] = force[:, :: self._stride] / part.scaling
            iterations[unsolved] += counts[0]
            factorisations[unsolved] += counts[1]
            furthest = np.maximum(furthest, [names.index(name) for name in rung])
        found[unsolved] = np.array(names, dtype=object)[furthest]

    def _still(self) -> bool:
        """Whether nothing moves, whatever the forces: then none helps."""
        return not self.problem.W.any()

    def _parts(self, size: int) -> Iterator[tuple[np.ndarray, np.ndarray, NativeSolver]]:
        """Rows of b, of `size` in all, and of the scaled problem, and the solver, of contacts that hang together."""
        if self._apart is None:
            self._apart = [self.subset(own) for own in self.problem.components]
        dimension = size // len(self.problem.parameters)
        for own, part in zip(self.problem.components, self._apart):
            yield np.flatnonzero(np.repeat(own, dimension)), np.flatnonzero(np.repeat(own, self._size)), part

    def attempts(self, b: np.ndarray, force: np.ndarray) -> Iterator[tuple[np.ndarray, int, int, str]]:
        """Proximal points, contacts that hang together by themselves, those farthest from their law first.

        See :meth:`mic.contact.backends.Backend.attempts`.
        """
        if len(self.problem.components) <= 1:
            yield from self._climb(b, force)
            return
        left = [(part.error(b[rows], force[rows]), rows, part) for rows, _, part in self._parts(len(b))]
        names, furthest = ladder.rungs(self.problem.law), 0
        for least, rows, part in sorted(left, key=lambda part: part[0], reverse=True):
            if least <= ladder.APART * self.tol:
                continue
            best = force[rows]
            for candidate, *counts, rung in part._climb(b[rows], best):
                whole = force.copy()
                whole[rows] = candidate
                furthest = max(furthest, names.index(rung))
                yield whole, *counts, names[furthest]
                error = part.error(b[rows], candidate)
                if error < least:
                    least, best = error, candidate
                if least <= ladder.APART * self.tol:
                    break
            force = force.copy()
            force[rows] = best

    def error(self, b: np.ndarray, force: np.ndarray) -> float:
        """How far a force is from obeying the law, as the certificate has it in scaled variables."""
        return self.problem.error(self._scaled(b), force[:: self._stride] / self.scaling)

    def _climb(self, b, force):
        """Proximal points from the best force so far, until the work is spent."""
        if self._still():
            return
        m, work, start = len(self.problem.parameters), 0.0, force[:: self._stride] / self.scaling
        for y, passes, factorisations in proximal_points(self.problem, ladder.PROXIMAL, self._scaled(b), start):
            candidate = np.zeros_like(b)
            candidate[:: self._stride] = y * self.scaling
            yield candidate, passes + factorisations, factorisations, ladder.PROXIMAL.name
            work += max(1.0, passes / m + factorisations)
            if work > self.work:
                return

    def follow(self, b0: np.ndarray, b1: np.ndarray, force: np.ndarray, anchor: np.ndarray, path: Path) -> Leg:
        """All samples from one load to the next; see :meth:`mic.contact.backends.Backend.follow`."""
        problem, D, n, m = self._path_problem(), self.scaling, len(b0), len(self.problem.parameters)
        unit = 1.0 / D.reshape(m, 3)[:, 1]
        Q0, Q1 = np.ascontiguousarray(b0 * D), np.ascontiguousarray(b1 * D)
        Y, Q = np.ascontiguousarray(force / D), np.zeros_like(Q0)
        L = np.ascontiguousarray((anchor / unit[:, None]).reshape(n, 2 * m))
        record = Record(np.zeros((n, m, 2)), np.zeros((n, m)), np.zeros((n, m)), np.zeros((n, m, 3)))
        sums, counts = np.zeros((n, 2)), np.zeros((n, 3), dtype=np.int64)
        if isinstance(path, Increments):
            order, tolerances = 1, (0.0, 0.0, 0.0)
        else:
            order, tolerances = 2, (path.tolerance, path.least, FORCES * path.tolerance)
        room, unguessed = follower.MOST + 1 if path.recorded else 0, np.empty((0, 3 * m))
        passed, passed_force = lazy_zeros(n, room), lazy_zeros(n, room, 3 * m)
        control = self._control(order, path.ends, tolerances, follower.SWEEPS)

        def chunk(own):
            outcome = Outcome(
                Q[own], Record(*(a[own] for a in record)), *(a[own] for a in (sums, counts, passed, passed_force))
            )
            follower.follow(problem, (Q0[own], Q1[own]), control, L[own], Y[own], outcome, unguessed, False)

        self._each(chunk, n)
        steps = self._records(order, counts[:, path_constants.STEPS], passed, passed_force) if room else None
        return self._leg(Y, Q, L, record, counts, sums, steps)

    def step(self, among, some, b, force, anchor, working, guess, near, leg: Leg) -> None:
        """See :meth:`mic.contact.backends.Backend.step`; what :meth:`take` has of the contacts is had in one call."""
        samples = Samples(*map(np.ascontiguousarray, (b, force, anchor, working, guess)))
        found = Found(leg.force, leg.b, leg.anchor, leg.slip, leg.length, leg.work, leg.share)
        counts = np.zeros((len(b), 3), dtype=np.int64)
        own, control = self.problem, self._control(1, np.ones(1), (0.0, 0.0, 0.0), SWEEPS)
        assert own.factors is not None  # of a law with friction
        contacts = SolverContacts(own.W, own.factors, own.parameters, self.scaling, among)

        def chunk(part):
            follow_among(own.equation, contacts, some[part], control, samples, near, found, counts)

        self._each(chunk, len(some))
        leg.factorisations[some] += counts[some, path_constants.FACTORISATIONS]
        leg.given_up[some] = counts[some, path_constants.FAILED] > 0

    def _path_problem(self) -> PathProblem:
        """The problem as kernels of paths take it."""
        own = self.problem
        assert own.factors is not None  # of a law with friction, as all are that have a path
        return PathProblem(own.equation, own.W, own.factors, own.parameters, 1.0 / self.scaling)

    def _control(self, order, ends, tolerances: tuple[float, float, float], sweeps) -> Control:
        """How a path is followed, with the tolerance of this solver."""
        return Control(order, ends, *tolerances, ladder.MARGIN * self.tol, sweeps * self.problem.law.gauss_seidel)

    def _leg(self, Y, Q, L, record: Record, counts, sums, steps) -> Leg:
        """What the follower tells in scaled quantities, in mm and N."""
        D, (n, m) = self.scaling, record.length.shape
        unit = 1.0 / D.reshape(m, 3)[:, 1]
        return Leg(
            force=Y * D,
            b=Q / D,
            anchor=L.reshape(n, m, 2) * unit[:, None],
            slip=record.slip * unit[:, None],
            length=record.length * unit,
            work=record.work,
            share=record.share,
            error=sums[:, 0].copy(),
            force_error=sums[:, 1].copy(),
            steps=counts[:, path_constants.STEPS].copy(),
            factorisations=counts[:, path_constants.FACTORISATIONS].copy(),
            given_up=counts[:, path_constants.FAILED] > 0,
            record=steps,
        )

    def _records(self, order, steps, passed, force) -> np.ndarray:
        """(n,) records of samples with these numbers of steps."""
        count = steps + (order == 2)
        return record_array(
            PathRecord(order, ends[:k].copy(), own[:k] * self.scaling) for k, ends, own in zip(count, passed, force)
        )

    def infeasible(self, b: np.ndarray) -> bool:
        """See :meth:`mic.contact.backends.Backend.infeasible`."""
        law = self.problem.law
        fixed = law.frictional and not law.coefficient_varies
        dilatancy = (1.0 - law.shift) * self.problem.friction if fixed else None
        return infeasible(self.problem.W, self._scaled(b), self._size, dilatancy)

    def _scaled(self, b):
        return b[:: self._stride] * self.scaling

    def _share(self, method, samples, batch):
        """Run a method on chunks of the samples of a batch, in parallel; what it finds is stored in place."""

        def chunk(pick):
            part = Batch(*(array[pick] for array in batch))
            method(part)
            for array, own in zip(batch[1:], part[1:]):
                array[pick] = own

        self._each(lambda own: chunk(samples[own]), len(samples))

    def _each(self, work, n):
        """``work(slice)`` for slices of n samples, in parallel."""
        size = -(-n // (TASKS * self.threads if self.threads > 1 else 1))
        slices = [slice(first, first + size) for first in range(0, n, max(size, 1))]
        if self.threads == 1:
            for own in slices:
                work(own)
        else:
            with ThreadPoolExecutor(self.threads) as pool:
                list(pool.map(work, slices))
