"""Contact solver with a working set: of many candidate contacts only those that would penetrate are solved.

All candidates share one compliance, ``u = S f + b``. Each sample has a working set W: it is solved, or its path
followed, with the contacts of W alone, f = 0 elsewhere; then the gaps of *all* candidates are computed by one product.
If candidates outside W penetrate by more than `PENETRATION` allows, the deepest of each neighbourhood joins W (on a
path of several steps, all of them and their neighbours), and the sample is solved again from the start of its path.
Working sets only grow, so the iteration ends. Then every contact outside W satisfies the law with f = 0 to
`PENETRATION`, and the solution is that of all candidates, at the cost of the closed ones. With friction, candidates
that penetrate by more than `PATH_PENETRATION` allows at the end of a step of the last leg join as well.

The initial working set holds the candidates that carry force, and those that did in a few pilot samples
(:mod:`mic.contact.path_forecast`). From more than `MAX_INITIAL` of these, only those that carry force at an end of the
path are taken. With more than `MANY_CANDIDATES` candidates, screening ignores friction, and a path in many steps takes
those at the end of one increment with friction too. A path of one increment starts from the forces' change in the
nearest pilot sample; with more than `MAX_INITIAL` candidates, from forces without friction
(:mod:`mic.contact.large_increment`). A sample does not depend on others of its batch.
"""

from __future__ import annotations

from collections.abc import Iterator
from copy import copy
from dataclasses import fields, replace
from typing import TYPE_CHECKING, Any

import numpy as np
from scipy.spatial import cKDTree

from mic.contact.compliance_columns import Columns
from mic.contact.friction import Friction
from mic.contact.ladder import MARGIN
from mic.contact.large_increment import end_forces, forces_without_friction
from mic.contact.laws import Law
from mic.contact.path import Followed, Increments, Leg, Path, PathSolution, Trace, end_state, from_solution
from mic.contact.path_forecast import PathForecast
from mic.contact.path_record import PathRecord, record_array
from mic.contact.solution import Status
from mic.contact.solver import ContactSolver
from mic.contact.states import LOADED, OPEN, classify

if TYPE_CHECKING:
    from mic.contact.native.landing import Landing

__all__ = ["PENETRATION", "WorkingSetSolver"]

# Relative to the radius of the candidate's neighbourhood, some 10 mm on a car body:
PENETRATION = 1e-7  # largest penetration of a candidate outside the working set
PATH_PENETRATION = 1e-5  # likewise before the end of the path, where it affects the result through friction only
EQUAL = 1e-6  # relative difference of penetrations that counts as rounding
DUPLICATE = 0.1  # neighbourhood radii: of candidates within this distance one is enough
MAX_ROUNDS = 40  # in which a working set grows
MAX_INITIAL = 300  # contacts of an initial working set that is not screened
MAX_PREPARED = 1500  # contacts of the solver that all samples share: some 0.3 GB
MAX_RECORDED = 2000  # contacts, over all samples, whose steps are recorded at a time: 0.2 MB of address space each
ROUGH = 1e-5  # error of Newton's method, relative, while many contacts join
FAR = 1e8  # neighbourhood radii: a gap that never closes
MANY_CANDIDATES = 1000  # candidates above which screening ignores friction, to be cheaper than a sample


class WorkingSetSolver:
    """Solves contact problems like :class:`mic.contact.ContactSolver`, with a working set of the candidates.

    Parameters
    ----------
    S : (d m, d m) Columns
        Compliance over all candidates.
    friction : Friction
    point : (m, 3) array
        Positions of the candidates, mm.
    reach : (m,) array
        Radius of neighbourhoods: candidates within it of one that joins do not join in the same round, mm.
    start : (m,) bool array
        Candidates of every initial working set.
    allowed : (m,) bool array
        Candidates that may carry force.
    law : Law
    screening : bool
        Whether only to find which candidates carry force, at a fraction of the cost: all samples share a working set,
        from which contacts that open are removed, and each round starts from the last one. Friction is ignored with
        more than `MANY_CANDIDATES` candidates.
    forecast : PathForecast, optional
        Result of pilot samples, from which the forces of one increment are forecast; default: none.
    **settings
        Further arguments of :class:`mic.contact.ContactSolver`.

    Attributes
    ----------
    carried : (m,) bool array
        Candidates that carried force at the end of any path so far.
    """

    def __init__(
        self,
        S: Columns,
        friction: Friction,
        point: np.ndarray,
        reach: np.ndarray,
        start: np.ndarray,
        allowed: np.ndarray,
        law: Law,
        screening: bool = False,
        forecast: PathForecast | None = None,
        **settings,
    ):
        self.law, self._S, self._settings = law, S, settings
        self._d, self._native = settings.get("dimension", 3), settings.get("backend", "native") == "native"
        self._friction = friction if law.frictional else Friction.of(0.0, len(start))
        self._parameters = law.parameters(self._friction)
        self._screened = PathForecast.empty(len(start), self._d)
        self._forecast = forecast or self._screened
        self._start, self._allowed, self._screening = start & allowed, allowed, screening
        self._many = law.frictional and len(start) > MANY_CANDIDATES
        self.carried = np.zeros(len(start), dtype=bool)
        self._allowed_depth = PENETRATION * np.broadcast_to(np.asarray(reach, dtype=float), len(start))
        tree = cKDTree(point)
        self._neighbours = tree.query_ball_point(point, reach)
        self._duplicates = tree.query_ball_point(point, DUPLICATE * np.asarray(reach))
        # New contacts are mostly neighbours of the initial ones: samples that need more share this set and its solver.
        self._neighbourhood = self._start.copy()
        for candidate in np.flatnonzero(self._start):
            self._neighbourhood[self._neighbours[candidate]] = True
        self._neighbourhood &= allowed
        self._solvers: dict[bytes, ContactSolver] = {}
        self._prepared_set = self._neighbourhood.copy()
        self._prepared: ContactSolver | None = None  # see _prepare
        self._normal: np.ndarray | None = None  # see _solved_frictionless
        self._factorised: Landing | None = None  # see _uses_newton

    def with_friction(self, friction: Friction) -> WorkingSetSolver:
        """The solver of the same candidates with another friction; everything that depends on S alone is reused."""
        some = copy(self)
        some._friction = friction if self.law.frictional else Friction.of(0.0, len(self._start))
        some._parameters, some.carried = self.law.parameters(some._friction), np.zeros_like(self.carried)
        changed = lambda solver, own: solver.with_friction(some._friction.take(own))
        some._solvers = {key: changed(known, np.frombuffer(key, bool)) for key, known in self._solvers.items()}
        some._factorised = None
        some._prepared = None if self._prepared is None else changed(self._prepared, self._prepared_set)
        return some

    @property
    def observed(self) -> PathForecast:
        """Forecast from the samples solved so far; loads and changes of forces only if `screening`."""
        return replace(self._screened, touching=self.carried)

    def bound(self, normal: np.ndarray) -> np.ndarray:
        """See :meth:`mic.contact.ContactSolver.bound`, for all candidates."""
        return self.law.bound(normal, self._parameters)

    def solve(self, b: np.ndarray) -> PathSolution:
        """See :meth:`mic.contact.ContactSolver.solve`, for a batch (n, d m), without loading history."""
        anchor = np.zeros((len(b), len(self._start), self._d - 1))
        return self._solve_growing(b[:, None], np.zeros_like(b), anchor, None)

    def follow(self, b: np.ndarray, force: np.ndarray, anchor: np.ndarray, path: Path) -> PathSolution:
        """See :meth:`mic.contact.ContactSolver.follow`; candidates that are not allowed lose their initial force.

        Returns
        -------
        PathSolution
            For all candidates; those outside the working set are open all along the path.
        """
        force = np.where(np.repeat(self._allowed, self._d), force, 0.0)
        single = isinstance(path, Increments) and path.count == 1 and b.shape[1] == 2
        stepwise = (single if self.law.frictional else self._d == 3) and not path.recorded  # only the end matters
        large = self._start.sum() > MAX_INITIAL
        if single and stepwise and large and self.law.frictional and self._native and not self._screening:
            return self._solve_large_increment(b, force, anchor)
        if not stepwise or large or self._screening or not self._native:
            before = force.copy() if self._screening else force  # screening modifies it
            found = self._solve_growing(b, before, anchor, path)
            if self._screening:
                converged, known = found.converged, self._screened
                load = np.concatenate([known.load, b[converged, -1, :: self._d]])
                change = np.concatenate([known.change, (found.force - force)[converged]])
                self._screened = PathForecast(self.carried, load, change)
            return found
        found = self._solve_increment(b, force, anchor)
        lost = np.flatnonzero(~found.converged)
        if not len(lost):
            return found
        return found.replaced(lost, self._solve_growing(b[lost], force[lost], anchor[lost], path))

    def _solve_increment(self, b, force, anchor) -> PathSolution:
        """One increment along loads b (n, k + 1, d m), k = 1 with friction, with growing working sets.

        Each round is one call for all remaining samples and starts from the result of the last round. Samples whose
        residual is too large, or that fail, have not converged.
        """
        n, m, d = len(b), len(self._start), self._d
        working = self._start | self._allowed & _loaded(force.reshape(n, m, d)[:, :, 0])
        leg, end, solved, todo, solver = Leg.start(n, m), b[:, -1], np.zeros(n, dtype=bool), np.arange(n), None
        u, guess, near = end.copy(), self._forecast.forces(end[:, ::d], force), False
        for _ in range(MAX_ROUNDS):
            self._prepare(working[todo].any(axis=0))
            solver = self._prepared
            if solver is None or (working[todo] & ~self._prepared_set).any():
                break
            among = np.flatnonzero(self._prepared_set)
            if self.law.frictional:
                solver.backend.step(among, todo, b, force, anchor, working, guess, near, leg)
            else:
                self._step_frictionless(solver, todo, end, working, guess, leg)
            u[todo] = self._S.under(leg.force[todo]) + end[todo]
            depths = self._penetration(u[todo], anchor[todo], None, working[todo])
            grows = (depths > self._allowed_depth).any(axis=1)
            solved[todo] = ~leg.given_up[todo] & ~grows
            grows &= ~leg.given_up[todo]
            todo = todo[grows]
            if not len(todo):
                break
            for sample, depth in zip(todo, depths[grows]):
                working[sample, self._joining(depth, False)] = True
            guess, near = leg.force, True
        if solver is None:
            return replace(self._open(n, m), converged=solved)
        rows, taken = np.repeat(self._prepared_set, d), np.repeat(working, d, axis=1)
        moved = np.where(taken, u - end, 0.0)[:, rows]
        residual, converged, status = solver.check_convergence(leg.b[:, rows], leg.force[:, rows], moved)
        return self._increment(leg, u, force, anchor, working, residual, converged & solved, status)

    def _solve_large_increment(self, b, force, anchor) -> PathSolution:
        """Like :meth:`_solve_increment` with friction, sample by sample, for many contacts.

        Newton's method ends at the error `ROUGH` until no candidate joins, then at that of the solver.
        """
        n, m, d = len(b), len(self._start), self._d
        leg, u = Leg.start(n, m), b[:, -1].copy()
        working = self._allowed & _loaded(force.reshape(n, m, d)[:, :, 0])
        pressing = self._solved_frictionless(self._start, b, force, anchor).force
        working[:, self._start] |= pressing[:, ::d] > 0.0
        guess, target = force.copy(), b[:, -1].reshape(n, m, d).copy()
        guess[:, np.flatnonzero(self._start) * d] = pressing[:, ::d]
        target[:, :, 1:] -= anchor
        residual, converged, status = np.zeros(n), np.zeros(n, dtype=bool), np.full(n, Status.NOT_CONVERGED, object)
        for k in range(n):
            one, solver, tol = np.array([k]), None, ROUGH
            for round_ in range(2 * MAX_ROUNDS):
                if solver is None:
                    solver, rows = self._new_solver(working[k]), np.repeat(working[k], d)
                known: tuple[Any, Any, Any] = solver.backend, target[k].ravel()[rows], guess[k, rows]
                guess[k, rows], steps = end_forces(*known, round_ > 0, max(tol, MARGIN * solver.tol))
                leg.factorisations[k] += steps
                u[k] = self._S.under(guess[one])[0] + b[k, -1]
                depth = self._penetration(u[one], anchor[one], None, working[one])[0]
                if (depth > self._allowed_depth).any():
                    working[k, self._joining(depth, True)] = True
                    solver = None
                elif tol == 0.0:
                    break
                else:
                    tol = 0.0
            else:
                continue
            solver.backend.step(np.flatnonzero(working[k]), one, b, force, anchor, working, guess, True, leg)
            u[k] = self._S.under(leg.force[one])[0] + b[k, -1]
            load, own, moved = (values[:, rows] for values in (leg.b[one], leg.force[one], u[one] - b[one, -1]))
            residual[one], converged[one], status[one] = solver.check_convergence(load, own, moved)
        return self._increment(leg, u, force, anchor, working, residual, converged & ~leg.given_up, status)

    def _increment(self, leg: Leg, u, force, anchor, working, residual, converged, status) -> PathSolution:
        """The solution of one increment, from its leg, the displacements u (n, d m) of all candidates at its end, and
        the forces before it."""
        n, m, d = len(working), len(self._start), self._d
        self.carried |= _loaded(leg.force[converged].reshape(-1, m, d)[:, :, 0]).any(axis=0)
        sliders = self.law.compliance(self._friction)[:, None] * leg.force.reshape(n, m, d)[:, :, 1:]
        stands = u.reshape(n, m, d)[:, :, 1:] + sliders
        error = np.full(n, np.nan if self.law.frictional else 0.0)
        if self.law.followed:
            trace = leg.trace(error=error, force_error=error, steps=np.ones(n, dtype=np.int64))
            stands[working] = leg.anchor[working]
        else:  # no path: from the states at the end and the motion since the start
            before, now = (f.reshape(n, m, d) for f in (force, leg.force))
            trace = replace(
                Trace.of_step(classify(now, self.bound(now[:, :, 0])), leg.factorisations),
                error=error,
                force_error=error,
            )
            if self.law.frictional:
                trace = trace.with_slip(stands - anchor, before, now)
        return PathSolution(
            force=leg.force,
            displacement=u,
            anchor=stands,
            trace=trace,
            residual=residual,
            converged=converged,
            status=status,
            iterations=leg.factorisations.copy(),
            rung=np.full(n, "increments" if self.law.frictional else "active set", dtype=object),
        )

    def _step_frictionless(self, solver, some, end, working, guess, leg: Leg) -> None:
        """Like :meth:`mic.contact.backends.Backend.step`, without friction, at loads `end` (n, d m)."""
        for samples, own in _by_working_set(working, some):
            rows = np.repeat(own, self._d)
            if not rows.any():
                continue
            places, part = np.ix_(samples, rows), solver.backend.subset(own[self._prepared_set])
            leg.b[places] = end[places]
            leg.force[places], _, spent, _ = part.solve(leg.b[places], guess[places])
            leg.factorisations[samples] += spent

    def _solve_growing(self, b, force, anchor, path: Path | None) -> PathSolution:
        """Paths along loads b (n, k + 1, d m), or solutions of the last load alone, with growing working sets."""
        n, m, d = len(b), len(self._start), self._d
        normal = force.reshape(n, m, d)[:, :, 0]
        working, checks_path = self._start | self._allowed & _loaded(normal), self._checks_path(path)
        if path is not None and not self._screening and self._start.sum() > MAX_INITIAL:
            working = self._initially_loaded(b, force, anchor) | self._allowed & _loaded(normal)
            if checks_path and self._many and self._native:  # each that joins lets a path begin again
                increment = self._solve_large_increment(b[:, [0, -1]], force, anchor)
                working |= _loaded(increment.force.reshape(n, m, d)[:, :, 0])
        recorded = path is not None and path.recorded
        many = checks_path or self._many and not self._screening  # another round of a path is expensive
        recorded_path = replace(path, recorded=True) if path is not None and checks_path else path
        found, on_path = self._open(n, m, recorded), np.zeros((n, m))
        todo = np.arange(n)
        spent = np.zeros((2, n), dtype=np.int64)  # iterations and factorisations
        for round_ in range(MAX_ROUNDS):
            if self._screening:
                working[:] = working.any(axis=0)
            self._prepare(working[todo].any(axis=0))
            left = todo
            if round_ and path is None and self._uses_newton():
                for samples, own, solver in self._by_solver(working, todo):
                    solution = self._newton(own, solver, working[samples], b[samples], force[samples], anchor[samples])
                    self._put(found, samples, own, solution, b[samples], spent)
                    u = found.displacement[samples].reshape(len(samples), m, d)
                    found.anchor[samples] = np.where(working[samples, :, None], found.anchor[samples], u[:, :, 1:])
                    force[samples] = found.force[samples]
                left = todo[~found.converged[todo]]
            for samples, own in _by_working_set(working, left, MAX_RECORDED if checks_path else None):
                solution = self._solved(own, b[samples], force[samples], anchor[samples], recorded_path)
                self._put(found, samples, own, solution, b[samples], spent)
                if checks_path:
                    on_path[samples] = self._path_penetration(own, b[samples], solution)
                if path is None or self._screening:  # the next round starts from this result
                    force[samples] = found.force[samples]
            depths = self._penetration(found.displacement[todo], anchor[todo], path, working[todo])
            depths = np.maximum(depths, on_path[todo])
            grows = (depths > self._allowed_depth).any(axis=1) & found.converged[todo]
            todo, depths = todo[grows], depths[grows]
            if not len(todo):
                break
            if self._screening and round_ < MAX_ROUNDS // 2:
                working = self._start | _loaded(found.force.reshape(n, m, d)[:, :, 0])
            for sample, depth in zip(todo, depths):
                working[sample, self._joining(depth, many)] = True
                if path is None:
                    working[sample] |= self._neighbourhood
        found.converged[todo] = False
        found.status[todo] = Status.NOT_CONVERGED
        self.carried |= _loaded(found.force[found.converged].reshape(-1, m, d)[:, :, 0]).any(axis=0)
        return replace(found, iterations=spent[0], trace=replace(found.trace, factorisations=spent[1]))

    def _uses_newton(self) -> bool:
        """Whether rounds use Newton's method from the last result: most samples close the same contacts, with an
        accurate inverse; too slow with many candidates."""
        suits = self.law.frictional and self._native and not self._screening
        if not (suits and MAX_INITIAL < self._start.sum() <= MANY_CANDIDATES):
            return False
        if self._factorised is None:
            self._factorised = self._solver(self._start).backend.landing(self._start, self._S)
        return bool(self._factorised)

    def _by_solver(self, working, todo) -> Iterator[tuple[np.ndarray, np.ndarray, ContactSolver]]:
        """Samples of `todo`, candidates (m,) that include their working sets (n, m), and the solver of these."""
        if self._prepared is not None and not (working[todo] & ~self._prepared_set).any():
            yield todo, self._prepared_set, self._prepared
            return
        for samples, own in _by_working_set(working, todo):
            yield samples, own, self._solver(own)

    def _newton(self, own, solver: ContactSolver, working, b, force, anchor) -> PathSolution:
        """Solve the last loads alone from close forces, for the candidates `own` (m,) of a solver; those outside the
        working set of a sample get a large gap."""
        among, rows = np.flatnonzero(own), np.repeat(own, self._d)
        end = b[:, -1, rows].reshape(len(b), -1, self._d)
        end[:, :, 1:] -= anchor[:, among]
        end[:, :, 0][~working[:, among]] = FAR / PENETRATION * self._allowed_depth.max()
        load = end.reshape(len(b), -1)
        newton = solver.backend.land(load, force[:, rows], among, self._factorised)
        solution = from_solution(solver, solver.certify(load, *newton))
        return replace(solution, anchor=solution.anchor + anchor[:, among])

    def _initially_loaded(self, b, force, anchor) -> np.ndarray:
        """(n, m) initial candidates that carry force at the start or the end of the path, each solved without history;
        with many candidates also without friction."""
        touching = np.zeros((len(b), len(self._start)), dtype=bool)
        for k in (0, -1):
            if self._many:
                solution = self._solved_frictionless(self._start, b[:, [k]], force, anchor)
            else:
                solution = self._solved(self._start, b[:, [k]], force, anchor, None)
            touching[:, self._start] |= _loaded(solution.force.reshape(len(b), -1, self._d)[:, :, 0])
        return touching

    def _solved(self, own, b, force, anchor, path) -> PathSolution:
        """Paths of samples with the same working set (m,)."""
        if not own.any():
            return self._open(len(b), 0, path is not None and path.recorded)
        if self._screening and self._many:
            return self._solved_frictionless(own, b, force, anchor)
        rows = np.repeat(own, self._d)
        solver = self._solver(own)
        if path is None:
            end = b[:, -1, rows].reshape(len(b), -1, self._d)
            end[:, :, 1:] -= anchor[:, own]
            solution = end_state(solver, end.reshape(len(b), -1), force[:, rows])
            return replace(solution, anchor=solution.anchor + anchor[:, own])
        return solver.follow(b[:, :, rows], force[:, rows], anchor[:, own], path)

    def _solved_frictionless(self, own, b, force, anchor) -> PathSolution:
        """Like :meth:`_solved`, at the last load without friction and not certified; anchors are unchanged."""
        rows, first = np.flatnonzero(own) * self._d, (own == self._start).all()
        S = self._normal if self._normal is not None and first else self._S.block(rows)
        self._normal = S if first else self._normal  # every sample starts with this set
        found = self._open(len(b), len(rows))
        for sample, pressing in enumerate(found.force):
            pressing[:: self._d] = forces_without_friction(S, b[sample, -1, rows], force[sample, rows])
        return replace(found, anchor=anchor[:, own])

    def _prepare(self, joining: np.ndarray) -> None:
        """Prepare a solver for all candidates `joining` (m,) of any sample, which serves every working set among them;
        limited to :data:`MAX_PREPARED` contacts, or to :data:`MAX_INITIAL` if all samples share a working set."""
        joined = self._prepared_set | joining
        known = self._prepared is not None and (joined == self._prepared_set).all()
        if not known and joined.sum() <= (MAX_INITIAL if self._screening else MAX_PREPARED):
            self._prepared_set, self._prepared = joined, self._new_solver(joined)

    def _solver(self, own: np.ndarray) -> ContactSolver:
        """Solver of the working set `own` (m,)."""
        key = own.tobytes()
        if key in self._solvers:
            return self._solvers[key]
        if self._prepared is None or (own & ~self._prepared_set).any():
            solver = self._new_solver(own)
        else:
            solver = self._prepared.subset(own[self._prepared_set])
        if (own == self._start).all() or (own == self._neighbourhood).all():  # needed by most samples
            self._solvers[key] = solver
        return solver

    def _new_solver(self, own: np.ndarray) -> ContactSolver:
        """New solver of the candidates `own` (m,)."""
        index = np.flatnonzero(np.repeat(own, self._d))
        return ContactSolver(self._S.block(index), self._friction.take(own), law=self.law, **self._settings)

    def _open(self, n: int, m: int, recorded: bool = False) -> PathSolution:
        """Solution without forces, m contacts open along the path."""
        d, trace = self._d, Trace.start(n, m)
        trace.share[:, :, OPEN] = 1.0
        one = PathRecord(1, np.ones(1), np.zeros((1, d * m)))
        return PathSolution(
            force=np.zeros((n, d * m)),
            displacement=np.zeros((n, d * m)),
            anchor=np.zeros((n, m, d - 1)),
            trace=trace,
            residual=np.zeros(n),
            converged=np.ones(n, dtype=bool),
            iterations=np.zeros(n, dtype=np.int64),
            status=np.full(n, Status.CONVERGED, dtype=object),
            rung=np.full(n, "followed", dtype=object),
            record=record_array([one] * n) if recorded else None,
        )

    def _put(self, found: PathSolution, samples, own, solution: PathSolution, b, spent) -> None:
        """Insert the solution of some samples for their working set (m,) into that of all candidates, and add its cost
        to `spent` (2, n)."""
        m, d = len(own), self._d
        rows, places = np.repeat(own, d), np.ix_(samples, own)
        force = np.zeros((len(samples), d * m))
        force[:, rows] = solution.force
        found.force[samples] = force
        u = self._S.under(force) + b[:, -1]
        found.displacement[samples] = u
        anchor = u.reshape(-1, m, d)[:, :, 1:].copy()
        anchor[:, own] = solution.anchor
        found.anchor[samples] = anchor
        for name in ("residual", "converged", "status", "rung"):
            getattr(found, name)[samples] = getattr(solution, name)
        spent[:, samples] += [solution.iterations, solution.trace.factorisations]
        if found.record is not None and solution.record is not None:
            for sample, record in zip(samples, solution.record):
                wide = np.zeros((len(record.ends), d * m))
                wide[:, rows] = record.force
                found.record[sample] = replace(record, force=wide)
        for field in fields(Trace):
            here, there = getattr(solution.trace, field.name), getattr(found.trace, field.name)
            if here.ndim == 1:
                # Errors are root mean squares over the contacts, here over all candidates.
                there[samples] = here * np.sqrt(own.mean()) if field.name in ("error", "force_error") else here
            else:
                there[places] = here

    def _penetration(self, displacement, anchor, path, working) -> np.ndarray:
        """(n, m) violation of the law by allowed candidates outside the working set: their penetration, mm.

        Without force a contact satisfies a law of shift s if ``u_n ≥ (1 − s) μ ‖u_t − a‖``, with a the anchor at the
        start of the increment.
        """
        u = displacement.reshape(len(displacement), -1, self._d)
        depth = -u[:, :, 0]
        if self.law.frictional and self.law.shift < 1:
            last = np.diff(path.ends, prepend=0.0)[-1] if isinstance(path, Increments) else 1.0
            moved = last * np.linalg.norm(u[:, :, 1:] - anchor, axis=2)
            depth = depth + (1 - self.law.shift) * self._friction.coefficient * moved
        return np.where(working | ~self._allowed, 0.0, depth)

    def _checks_path(self, path: Path | None) -> bool:
        """Whether penetration before the end of the path matters: with friction and more than one step."""
        if path is None or self._screening or not self.law.frictional:
            return False
        return isinstance(path, Followed) or path.count > 1

    def _path_penetration(self, own, b, solution: PathSolution) -> np.ndarray:
        """(n, m) penetration of allowed candidates outside the common working set `own` (m,) at the ends of steps of
        the last leg, mm; 0 up to what :data:`PATH_PENETRATION` allows."""
        depth, rest = np.zeros((len(b), len(own))), np.flatnonzero(self._allowed & ~own)
        if solution.record is None or not len(rest) or not own.any():
            return depth
        rows, records = rest * self._d, list(solution.record)
        pressing = np.logical_or.reduce([record.force.any(axis=0) for record in records])
        S = self._S.take(np.flatnonzero(np.repeat(own, self._d))[pressing])[:, rows]
        for sample, record in enumerate(records):
            steps, s = record.ends > 0, record.ends[record.ends > 0, None]
            u = (1 - s) * b[sample, -2, rows] + s * b[sample, -1, rows] + record.force[steps][:, pressing] @ S
            depth[sample, rest] = -u.min(axis=0)
        return np.where(depth > PATH_PENETRATION / PENETRATION * self._allowed_depth, depth, 0.0)

    def _joining(self, depth, many: bool) -> list[int]:
        """The deepest candidate of each neighbourhood, the first of those with equal depth.

        If `many` may join: all that penetrate and their neighbours, since another round of a path is expensive; but
        only one of those within :data:`DUPLICATE` neighbourhood radii of each other.
        """
        near = self._duplicates if many else self._neighbours
        chosen, left = [], np.where(depth > self._allowed_depth, depth, 0.0)
        while left.any():
            chosen.append(int(np.argmax(left >= (1 - EQUAL) * left.max())))
            left[near[chosen[-1]]] = 0.0
        if not many:
            return chosen
        free = self._allowed.copy()
        for candidate in chosen:
            free[near[candidate]] = False
        for candidate in sorted({neighbour for deepest in chosen for neighbour in self._neighbours[deepest]}):
            if free[candidate]:
                chosen.append(candidate)
                free[near[candidate]] = False
        return chosen


def _loaded(normal: np.ndarray) -> np.ndarray:
    """(n, m) whether contacts carry normal force beyond rounding."""
    return normal > LOADED * normal.max(axis=1, keepdims=True, initial=0.0)


def _by_working_set(
    working: np.ndarray, todo: np.ndarray, contacts: int | None = None
) -> Iterator[tuple[np.ndarray, np.ndarray]]:
    """Groups of samples of `todo` with the same working set, and the set (m,); at most `contacts` contacts a group."""
    groups: dict[bytes, list[int]] = {}
    for sample in todo:
        groups.setdefault(working[sample].tobytes(), []).append(sample)
    for samples in groups.values():
        own = working[samples[0]]
        most = len(samples) if contacts is None else max(1, contacts // max(1, int(own.sum())))
        for first in range(0, len(samples), most):
            yield np.array(samples[first : first + most]), own
