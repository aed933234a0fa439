"""Candidates for contact: of many places where two bodies could touch, only those that would penetrate take part.

All candidates share one compliance, ``u = S f + b``. Each sample has a working set W of its own: it is solved, or its
path followed, with the contacts of W alone, f = 0 elsewhere; then the gap at *all* candidates is computed, one product.
Where candidates outside of W penetrate by more than `PENETRATION`, the deepest of each neighbourhood joins W, on a path
of several steps all and their neighbours, and the sample goes from the start of its path again. Sets only grow, so that
this ends; then every contact outside of W obeys the law with f = 0, and the solution is that of all candidates at once,
to `PENETRATION`, at the cost of those that touch.

Where friction acts, what a contact has been through counts: candidates that penetrate by more than `ON_THE_WAY` where
a step of the path ended join as well, though they may be apart at its end. Of several legs that is seen of the last.

A sample begins with the candidates that carry force, and with those that did in a few samples, the same for all
(`Foreseen`); of a set of more than `MANY`, with those that carry force where its path begins or ends. Of a crowd
(`CROWD`) who carries force is guessed without friction, and what penetrates joins as on a path. One increment begins
with forces that change as they did in that one of the few samples whose loads are nearest. The outcome of a sample does
not depend on what it is solved together with.
"""

from __future__ import annotations

from collections.abc import Iterator
from copy import copy
from dataclasses import dataclass, fields, replace
from typing import TYPE_CHECKING

import numpy as np
from scipy.spatial import cKDTree
from scipy.spatial.distance import cdist

from mic.contact.compliance_columns import Columns
from mic.contact.friction import Friction
from mic.contact.laws import FRICTIONLESS, Law
from mic.contact.path import Followed, Increments, Leg, Path, PathSolution, Trace, at_once, ended
from mic.contact.path_record import Trail, trails
from mic.contact.solution import Status
from mic.contact.solver import ContactSolver
from mic.contact.states import LOADED, OPEN, SLIP, STICK, classify

if TYPE_CHECKING:
    from mic.contact.native.landing import Landing

__all__ = ["PENETRATION", "Foreseen", "WatchedSolver"]

PENETRATION = 1e-6  # mm: how far a candidate outside of the working set may penetrate
ON_THE_WAY = 1e-4  # mm: and how far it may before the path's end, where an error does not stay but for friction's
EQUAL = 1e-6  # of the depth: candidates that penetrate as much but for rounding
BESIDE = 0.1  # neighbourhoods: so near two candidates may read the same, and one is enough
ROUNDS = 40  # in which a working set may grow
MANY = 300  # contacts that a sample may begin a path with unasked
PREPARED = 1500  # contacts that are prepared for all samples together: some 0.3 GB
TOGETHER = 2000  # contacts of all samples whose steps are recorded together, 0.2 MB of address space each
FAR = 1e9  # mm: no contact closes that
CROWD = 1000  # candidates of which a guess looks at what presses alone: with friction it would cost as much as a sample


@dataclass(frozen=True)
class Foreseen:
    """What a few samples of m contacts went through on a path: others begin with it, and do not end by it.

    Attributes
    ----------
    touching : (m,) bool array
        Contacts that carried force at the end in any of them.
    load : (k, m) array
        Of k of them, the contacts' gaps without contact forces at the path's end, mm.
    change : (k, d m) array
        By how much the contact forces changed, N.
    """

    touching: np.ndarray
    load: np.ndarray
    change: np.ndarray

    @classmethod
    def nothing(cls, m: int, d: int) -> Foreseen:
        """Of no sample."""
        return cls(np.zeros(m, dtype=bool), np.empty((0, m)), np.empty((0, d * m)))

    def forces(self, load: np.ndarray, force: np.ndarray) -> np.ndarray:
        """(n, d m) forecast from forces (n, d m) at the start of a path, at whose end gaps are `load` (n, m): they
        change as those of the sample whose gaps are nearest; nothing where that leaves no pressure."""
        if not len(self.load):
            return np.zeros_like(force)
        forecast = (force + self.change[cdist(load, self.load).argmin(axis=1)]).reshape(*load.shape, -1)
        return np.where(forecast[:, :, :1] > 0.0, forecast, 0.0).reshape(force.shape)


class WatchedSolver:
    """Stands in for a :class:`mic.contact.ContactSolver` over all candidates.

    Parameters
    ----------
    S : (d m, d m) Columns
        Compliance over all candidates.
    friction : Friction
    point : (m, 3) array
        Where they stand, mm.
    reach : (m,) array
        Of the candidates within this distance of one that joins, none joins in the same round, mm.
    start : (m,) bool array
        What every working set begins with.
    allowed : (m,) bool array
        Candidates that may ever carry force.
    law : Law
    guessing : bool
        Whether to guess who carries force, at a fraction of the cost: all samples share a working set, which loses
        again what lets go, and each round begins where the one before ended. Of more than `CROWD` candidates the guess
        is without friction.
    foreseen : Foreseen, optional
        What others went through, which tells where one increment begins; default: nothing.
    **settings
        Of :class:`mic.contact.ContactSolver`.

    Attributes
    ----------
    carried : (m,) bool array
        Candidates that have carried force at the end of any path so far.
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
        guessing: bool = False,
        foreseen: Foreseen | None = None,
        **settings,
    ):
        self.law, self._S, self._settings = law, S, settings
        self._d = settings.get("dimension", 3)
        self._friction = friction if law.frictional else Friction.of(0.0, len(start))
        self._parameters = law.parameters(self._friction)
        nothing = Foreseen.nothing(len(start), self._d)
        self._foreseen, self._guessed = foreseen or nothing, [nothing]
        self._start, self._allowed, self._guessing = start & allowed, allowed, guessing
        self._crowd = law.frictional and len(start) > CROWD
        self.carried = np.zeros(len(start), dtype=bool)
        tree = cKDTree(point)
        self._neighbours = tree.query_ball_point(point, reach)
        self._twins = tree.query_ball_point(point, BESIDE * np.asarray(reach))
        # What joins lies mostly beside what takes part: samples that need more share this set, and its solver.
        self._beside = self._start.copy()
        for candidate in np.flatnonzero(self._start):
            self._beside[self._neighbours[candidate]] = True
        self._beside &= allowed
        self._solvers: dict[bytes, ContactSolver] = {}
        self._joined = self._beside.copy()
        self._prepared: ContactSolver | None = None  # see _prepare
        self._pressing: ContactSolver | None = None  # see _pressed
        self._landing: Landing | None = None  # see _lands

    def under(self, friction: Friction) -> WatchedSolver:
        """The same candidates under another friction; what the compliance alone decides is kept."""
        some = copy(self)
        some._friction = friction if self.law.frictional else Friction.of(0.0, len(self._start))
        some._parameters, some.carried = self.law.parameters(some._friction), np.zeros_like(self.carried)
        of = lambda solver, own: solver.under(some._friction.take(own))
        some._solvers = {key: of(one, np.frombuffer(key, dtype=bool)) for key, one in self._solvers.items()}
        some._landing = None
        some._prepared = None if self._prepared is None else of(self._prepared, self._joined)
        return some

    @property
    def seen(self) -> Foreseen:
        """What samples went through so far; loads and changes where it was guessed who carries force."""
        load, change = (np.concatenate([getattr(one, name) for one in self._guessed]) for name in ("load", "change"))
        return Foreseen(self.carried, load, change)

    def bound(self, normal: np.ndarray) -> np.ndarray:
        """As :meth:`mic.contact.ContactSolver.bound`, over all candidates."""
        return self.law.bound(normal, self._parameters)

    def solve(self, b: np.ndarray) -> PathSolution:
        """As :meth:`mic.contact.ContactSolver.solve`, for a batch (n, d m): the law alone, whatever was before."""
        return self._grown(b[:, None], np.zeros_like(b), np.zeros((len(b), len(self._start), self._d - 1)), None)

    def follow(self, b: np.ndarray, force: np.ndarray, anchor: np.ndarray, path: Path) -> PathSolution:
        """As :meth:`mic.contact.ContactSolver.follow`; a candidate that is not allowed loses its force at the start.

        Returns
        -------
        PathSolution
            Over all candidates; what took no part was open all the way.
        """
        force = np.where(np.repeat(self._allowed, self._d), force, 0.0)
        step = isinstance(path, Increments) and path.count == 1 and b.shape[1] == 2
        plain = (step if self.law.frictional else self._d == 3) and not path.recorded  # the end alone counts
        crowd = self._guessing or self._start.sum() > MANY
        if not plain or crowd or self._settings.get("backend", "native") != "native":
            found = self._grown(b, force.copy() if self._guessing else force, anchor, path)  # a guess works in it
            if self._guessing:
                kept = found.converged
                load, change = b[kept, -1, :: self._d], (found.force - force)[kept]
                self._guessed.append(Foreseen(self.carried, load, change))
            return found
        found = self._stepped(b, force, anchor)
        lost = np.flatnonzero(~found.converged)
        return found.put(lost, self._grown(b[lost], force[lost], anchor[lost], path)) if len(lost) else found

    def _stepped(self, b, force, anchor) -> PathSolution:
        """One increment along loads b (n, k + 1, d m), k = 1 where there is friction, on sets that grow, each round one
        call for all samples that need it; each begins where the one before ended. What ends too far from its law, or
        nowhere, has not converged."""
        n, m, d = len(b), len(self._start), self._d
        working = self._start | self._allowed & _loaded(force.reshape(n, m, d)[:, :, 0])
        leg, end, solved, todo, solver = Leg.start(n, m), b[:, -1], np.zeros(n, dtype=bool), np.arange(n), None
        u, guess, near = end.copy(), self._foreseen.forces(end[:, ::d], force), False
        for _ in range(ROUNDS):
            self._prepare(working[todo].any(axis=0))
            solver = self._prepared
            if solver is None or (working[todo] & ~self._joined).any():
                break
            among = np.flatnonzero(self._joined)
            if self.law.frictional:
                solver.backend.step(among, todo, b, force, anchor, working, guess, near, leg)
            else:
                self._press(solver, todo, end, working, guess, leg)
            u[todo] = self._S.under(leg.force[todo]) + end[todo]
            unseen = self._unseen(u[todo], anchor[todo], None, working[todo])
            grows = (unseen > PENETRATION).any(axis=1)
            solved[todo] = ~leg.given_up[todo] & ~grows
            grows &= ~leg.given_up[todo]
            todo = todo[grows]
            if not len(todo):
                break
            for sample, depth in zip(todo, unseen[grows]):
                working[sample, self._joining(depth, False)] = True
            guess, near = leg.force, True
        found = self._open(n, m)
        if solver is None:
            return replace(found, converged=solved)
        rows, taken = np.repeat(self._joined, d), np.repeat(working, d, axis=1)
        moved = np.where(taken, u - end, 0.0)[:, rows]
        residual, converged, status = solver.judged(leg.b[:, rows], leg.force[:, rows], moved)
        converged &= solved
        self.carried |= _loaded(leg.force[converged].reshape(-1, m, d)[:, :, 0]).any(axis=0)
        sliders = self.law.compliance(self._friction)[:, None] * leg.force.reshape(n, m, d)[:, :, 1:]
        stands = u.reshape(n, m, d)[:, :, 1:] + sliders
        error, steps = np.full(n, np.nan if self.law.frictional else 0.0), np.ones(n, dtype=np.int64)
        trace = Trace(leg.slip, leg.length, leg.work, leg.share, error, steps, leg.factorisations)
        if self.law.followed:
            stands[working] = leg.anchor[working]
        else:
            trace = self._ended(trace, force, leg.force, stands - anchor)
        return replace(
            found,
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

    def _press(self, solver, some, end, working, guess, leg: Leg) -> None:
        """What :meth:`mic.contact.backends.Backend.step` does, at loads `end` (n, d m) where nothing rubs."""
        for samples, own in _alike(working, some):
            rows = np.repeat(own, self._d)
            if not rows.any():
                continue
            places, part = np.ix_(samples, rows), solver.backend.take(own[self._joined])
            leg.b[places] = end[places]
            leg.force[places], _, spent, _ = part.solve(leg.b[places], guess[places])
            leg.factorisations[samples] += spent

    def _ended(self, trace: Trace, before, force, motion) -> Trace:
        """Of a law that has no path: what counts is the state at the end, and the `motion` (n, m, 2) since the start,
        at which contact forces (n, d m) were those `before`; as in :func:`mic.contact.path.increments`."""
        now = force.reshape(*motion.shape[:2], self._d)
        state = classify(now, self.bound(now[:, :, 0]))
        share = np.stack([state == OPEN, state == STICK, state == SLIP], axis=2).astype(float)
        if not self.law.frictional:
            return replace(trace, share=share)
        slip = np.where((state == SLIP)[:, :, None], motion, 0.0)
        work = -np.sum(0.5 * (before.reshape(now.shape) + now)[:, :, 1:] * slip, axis=2)
        return replace(trace, slip=slip, length=np.linalg.norm(slip, axis=2), work=work, share=share)

    def _grown(self, b, force, anchor, path: Path | None) -> PathSolution:
        """Paths along loads b (n, k + 1, d m), or solutions of the last load at once, on sets that grow."""
        n, m, d = len(b), len(self._start), self._d
        normal = force.reshape(n, m, d)[:, :, 0]
        working = self._start | self._allowed & _loaded(normal)
        if path is not None and not self._guessing and self._start.sum() > MANY:
            working = self._touching(b, force, anchor) | self._allowed & _loaded(normal)
        recorded = path is not None and path.recorded
        looking = self._looking(path)
        many = looking or self._crowd and not self._guessing  # a path costs what touches, and another round as much
        way = replace(path, recorded=True) if path is not None and looking else path
        found, passed = self._open(n, m, recorded), np.zeros((n, m))
        todo = np.arange(n)
        iterations, factorisations = np.zeros((2, n), dtype=np.int64)
        for round_ in range(ROUNDS):
            if self._guessing:
                working[:] = working.any(axis=0)
            self._prepare(working[todo].any(axis=0))
            left = todo
            if round_ and path is None and self._lands():
                for samples, own, solver in self._by_solver(working, todo):
                    solution = self._landed(own, solver, working[samples], b[samples], force[samples], anchor[samples])
                    self._put(found, samples, own, solution, b[samples])
                    u = found.displacement[samples].reshape(len(samples), m, d)
                    found.anchor[samples] = np.where(working[samples, :, None], found.anchor[samples], u[:, :, 1:])
                    iterations[samples] += solution.iterations
                    factorisations[samples] += solution.trace.factorisations
                    force[samples] = found.force[samples]
                left = todo[~found.converged[todo]]
            for samples, own in _alike(working, left, TOGETHER if looking else None):
                solution = self._solved(own, b[samples], force[samples], anchor[samples], way)
                self._put(found, samples, own, solution, b[samples])
                if looking:
                    passed[samples] = self._passed(own, b[samples], solution)
                iterations[samples] += solution.iterations
                factorisations[samples] += solution.trace.factorisations
                if path is None or self._guessing:  # the next round begins where this one ended
                    force[samples] = found.force[samples]
            unseen = self._unseen(found.displacement[todo], anchor[todo], path, working[todo])
            unseen = np.maximum(unseen, passed[todo])
            grows = (unseen > PENETRATION).any(axis=1) & found.converged[todo]
            todo, unseen = todo[grows], unseen[grows]
            if not len(todo):
                break
            if self._guessing and round_ < ROUNDS // 2:
                working = self._start | _loaded(found.force.reshape(n, m, d)[:, :, 0])
            for sample, depth in zip(todo, unseen):
                working[sample, self._joining(depth, many)] = True
                if path is None:
                    working[sample] |= self._beside
        found.converged[todo] = False
        found.status[todo] = Status.NOT_CONVERGED
        self.carried |= _loaded(found.force[found.converged].reshape(-1, m, d)[:, :, 0]).any(axis=0)
        return replace(found, iterations=iterations, trace=replace(found.trace, factorisations=factorisations))

    def _lands(self) -> bool:
        """Whether a round may begin with what the one before found: most samples press the same many contacts, whose
        inverse is accurate; of a crowd it takes too long."""
        native = self._settings.get("backend", "native") == "native"
        if self._guessing or not self.law.frictional or not native or not MANY < self._start.sum() <= CROWD:
            return False
        if self._landing is None:
            self._landing = self._solver(self._start).backend.landing(self._start, self._S)
        return bool(self._landing)

    def _by_solver(self, working, todo) -> Iterator[tuple[np.ndarray, np.ndarray, ContactSolver]]:
        """Samples of `todo`, candidates (m,) with their sets (n, m) among them, and the solver of these."""
        if self._prepared is not None and not (working[todo] & ~self._joined).any():
            yield todo, self._joined, self._prepared
            return
        for samples, own in _alike(working, todo):
            yield samples, own, self._solver(own)

    def _landed(self, own, solver: ContactSolver, working, b, force, anchor) -> PathSolution:
        """The last loads at once, from forces that are near, over the candidates `own` (m,) of a solver; those that a
        sample does not have are far away from each other."""
        among, rows = np.flatnonzero(own), np.repeat(own, self._d)
        end = b[:, -1, rows].reshape(len(b), -1, self._d)
        end[:, :, 1:] -= anchor[:, among]
        end[:, :, 0][~working[:, among]] = FAR
        load = end.reshape(len(b), -1)
        landed = solver.backend.land(load, force[:, rows], among, self._landing)
        solution = ended(solver, solver.certified(load, *landed))
        return replace(solution, anchor=solution.anchor + anchor[:, among])

    def _touching(self, b, force, anchor) -> np.ndarray:
        """(n, m) which of the candidates that samples begin with carry force where the path begins or ends, each taken
        at once; of a crowd, where there were no friction."""
        touching = np.zeros((len(b), len(self._start)), dtype=bool)
        for k in (0, -1):
            if self._crowd:
                solution = self._pressed(self._start, b[:, [k]], force, anchor)
            else:
                solution = self._solved(self._start, b[:, [k]], force, anchor, None)
            touching[:, self._start] |= _loaded(solution.force.reshape(len(b), -1, self._d)[:, :, 0])
        return touching

    def _solved(self, own, b, force, anchor, path) -> PathSolution:
        """Paths of samples that share a working set (m,)."""
        if not own.any():
            return self._open(len(b), 0, path is not None and path.recorded)
        if self._guessing and self._crowd:
            return self._pressed(own, b, force, anchor)
        rows = np.repeat(own, self._d)
        solver = self._solver(own)
        if path is None:
            end = b[:, -1, rows].reshape(len(b), -1, self._d)
            end[:, :, 1:] -= anchor[:, own]
            solution = at_once(solver, end.reshape(len(b), -1), force[:, rows])
            return replace(solution, anchor=solution.anchor + anchor[:, own])
        return solver.follow(b[:, :, rows], force[:, rows], anchor[:, own], path)

    def _pressed(self, own, b, force, anchor) -> PathSolution:
        """As :meth:`_solved`, what presses at the last load if nothing rubs; anchors stay."""
        rows = np.flatnonzero(own) * self._d
        solver, first = self._pressing, (own == self._start).all()
        if solver is None or not first:
            settings = self._settings | {"dimension": 1, "backend": "native"}
            solver = ContactSolver(self._S.block(rows), 0.0, law=FRICTIONLESS, **settings)
            self._pressing = solver if first else self._pressing  # every batch begins with it
        solution = at_once(solver, b[:, -1, rows], force[:, rows])
        pressing = np.zeros((len(b), len(rows), self._d))
        pressing[:, :, 0] = solution.force
        return replace(solution, force=pressing.reshape(len(b), -1), anchor=anchor[:, own])

    def _prepare(self, joining: np.ndarray) -> None:
        """What is had once for all the candidates `joining` (m,), of any sample, serves every working set among them;
        not of more than :data:`PREPARED`, nor, where all share one, of more than :data:`MANY`."""
        joined = self._joined | joining
        if joined.sum() <= (MANY if self._guessing else PREPARED) and (
            self._prepared is None or (joined != self._joined).any()
        ):
            self._joined, self._prepared = joined, self._made(joined)

    def _solver(self, own: np.ndarray) -> ContactSolver:
        """Of the working set `own` (m,)."""
        key = own.tobytes()
        if key in self._solvers:
            return self._solvers[key]
        if self._prepared is None or (own & ~self._joined).any():
            solver = self._made(own)
        else:
            solver = self._prepared.take(own[self._joined])
        if (own == self._start).all() or (own == self._beside).all():  # most samples need these, and need them again
            self._solvers[key] = solver
        return solver

    def _made(self, own: np.ndarray) -> ContactSolver:
        """For the candidates `own` (m,), from their compliance."""
        index = np.flatnonzero(np.repeat(own, self._d))
        return ContactSolver(self._S.block(index), self._friction.take(own), law=self.law, **self._settings)

    def _open(self, n: int, m: int, recorded: bool = False) -> PathSolution:
        """No forces, m contacts open all the way."""
        d = self._d
        trace = Trace.start(n, m)
        trace.share[:, :, OPEN] = 1.0
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
            trail=trails(Trail(1, np.ones(1), np.zeros((1, d * m))) for _ in range(n)) if recorded else None,
        )

    def _put(self, found: PathSolution, samples, own, solution: PathSolution, b) -> None:
        """The solution of some samples over their working set (m,), in its place among all candidates."""
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
        if found.trail is not None and solution.trail is not None:
            for sample, trail in zip(samples, solution.trail):
                wide = np.zeros((len(trail.ends), d * m))
                wide[:, rows] = trail.force
                found.trail[sample] = replace(trail, force=wide)
        for one in fields(Trace):
            here, there = getattr(solution.trace, one.name), getattr(found.trace, one.name)
            if here.ndim == 1:
                # An error is that of the contacts' positions, root mean square: here over all of them.
                there[samples] = here * np.sqrt(own.mean()) if one.name == "error" else here
            else:
                there[places] = here

    def _unseen(self, displacement, anchor, path, working) -> np.ndarray:
        """(n, m) how far candidates miss their law that may take part and do not, mm: how far they penetrate.

        Without force a contact obeys a law of shift s where ``u_n ≥ (1 − s) μ ‖u_t − a‖``, a where the increment began.
        """
        u = displacement.reshape(len(displacement), -1, self._d)
        depth = -u[:, :, 0]
        if self.law.frictional and self.law.shift < 1:
            last = np.diff(path.ends, prepend=0.0)[-1] if isinstance(path, Increments) else 1.0
            moved = last * np.linalg.norm(u[:, :, 1:] - anchor, axis=2)
            depth = depth + (1 - self.law.shift) * self._friction.coefficient * moved
        return np.where(working | ~self._allowed, 0.0, depth)

    def _looking(self, path: Path | None) -> bool:
        """Whether it counts what penetrates before a path's end: where there is friction, and more than one step."""
        if path is None or self._guessing or not self.law.frictional:
            return False
        return isinstance(path, Followed) or path.count > 1

    def _passed(self, own, b, solution: PathSolution) -> np.ndarray:
        """(n, m) how far candidates that may take part and do not penetrate where steps of the last leg ended, mm; 0
        where it is no more than :data:`ON_THE_WAY`. All samples have the working set `own` (m,)."""
        depth, rest = np.zeros((len(b), len(own))), np.flatnonzero(self._allowed & ~own)
        if solution.trail is None or not len(rest) or not own.any():
            return depth
        rows, way = rest * self._d, list(solution.trail)
        pressing = np.logical_or.reduce([trail.force.any(axis=0) for trail in way])
        S = self._S.take(np.flatnonzero(np.repeat(own, self._d))[pressing])[:, rows]
        for sample, trail in enumerate(way):
            gone, s = trail.ends > 0, trail.ends[trail.ends > 0, None]
            u = (1 - s) * b[sample, -2, rows] + s * b[sample, -1, rows] + trail.force[gone][:, pressing] @ S
            depth[sample, rest] = -u.min(axis=0)
        return np.where(depth > ON_THE_WAY, depth, 0.0)

    def _joining(self, depth, many: bool) -> list[int]:
        """The deepest candidate of each neighbourhood; the first of those that are as deep but for rounding.

        Where `many` may join, all that penetrate and the neighbours of each: a path costs what touches, and another
        round as much. Of those nearer to each other than :data:`BESIDE` neighbourhoods one joins even then.
        """
        near = self._twins if many else self._neighbours
        chosen, left = [], np.where(depth > PENETRATION, depth, 0.0)
        while left.any():
            chosen.append(int(np.argmax(left >= (1 - EQUAL) * left.max())))
            left[near[chosen[-1]]] = 0.0
        if not many:
            return chosen
        free = self._allowed.copy()
        for candidate in chosen:
            free[near[candidate]] = False
        for candidate in sorted({one for each in chosen for one in self._neighbours[each]}):
            if free[candidate]:
                chosen.append(candidate)
                free[near[candidate]] = False
        return chosen


def _loaded(normal: np.ndarray) -> np.ndarray:
    """Which contacts carry normal force (n, m), rounding apart."""
    return normal > LOADED * normal.max(axis=1, keepdims=True, initial=0.0)


def _alike(
    working: np.ndarray, todo: np.ndarray, contacts: int | None = None
) -> Iterator[tuple[np.ndarray, np.ndarray]]:
    """Samples of `todo` that share a working set, and the set (m,); with no more than so many `contacts` together."""
    together: dict[bytes, list[int]] = {}
    for sample in todo:
        together.setdefault(working[sample].tobytes(), []).append(sample)
    for samples in together.values():
        own = working[samples[0]]
        most = len(samples) if contacts is None else max(1, contacts // max(1, int(own.sum())))
        for first in range(0, len(samples), most):
            yield np.array(samples[first : first + most]), own
