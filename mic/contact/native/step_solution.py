"""Solution of a step: sweeps, then Newton's method with an inverse that is kept and changed by pivots."""

from __future__ import annotations

import numpy as np
from numba import boolean, int64, types, void

from mic.contact.native.gauss_seidel import gauss_seidel
from mic.contact.native.kernel import COUNTS, NUMBER, VECTOR, kernel
from mic.contact.native.law_equation import derivative, force_scale, starting_scale
from mic.contact.native.matrices import assign, times
from mic.contact.native.newton import Coupling, NewtonSettings, newton
from mic.contact.native.path_constants import FACTORISATIONS, RESCUES
from mic.contact.native.pivots import anew, linearise, linearised, pivots, updated
from mic.contact.native.step_data import AIM, LAST_PROBLEM, PATH_PROBLEM, LastProblem
from mic.contact.states import OPEN

__all__ = ["lands", "solve"]

#: Newton's steps, and the inverses that it may make.
STEPS_OF_NEWTON, NEWTON = 40, 10
#: A step with the inverse of one before, a tenth of the cost of a new one, must bring the error down by this, and of
#: the contacts this share may have changed their status.
CHORD, CHANGES = 0.3, 0.3
#: Newton's steps in a call for help.
PATIENCE = 40

SOLVED = types.Tuple((int64, LAST_PROBLEM))


@kernel(void(PATH_PROBLEM, VECTOR, VECTOR, VECTOR, VECTOR, int64))
def sweep(problem, y, w, q, slip, sweeps):
    """Gauss-Seidel's sweeps from (y, w), and ``w = W y + q`` without the rounding that they leave."""
    gauss_seidel(problem.W, problem.P, problem.parameters, y, w, slip, sweeps, 1e-15)
    times(problem.W, y, w)
    w += q


@kernel(SOLVED(PATH_PROBLEM, VECTOR, VECTOR, VECTOR, AIM, LAST_PROBLEM, COUNTS))
def newton_by_pivots(problem, y, w, q, aim, last, counts):
    """Newton's method whose linear problems keep their inequalities (Josephy's), from the guess (y, w).

    Equations are linearised where they are, statuses are not held: after each linear solution the contact whose
    inequality is violated most changes its status, the inverse by rank 3, until none is.  A slider whose motion is
    small would else be taken for one that sticks and back again, step after step.

    A problem differs little from the one solved before: its inverse serves, with the rows of contacts whose status
    changed, as long as every step brings the error down by :data:`CHORD`.

    Returns
    -------
    int
        1 if it is solved; ``w = W y + q`` in any case.
    LastProblem
    """
    linear = linearised(len(problem.parameters))
    y_old, before, renewed, tried = y.copy(), np.inf, 0, False
    for _ in range(STEPS_OF_NEWTON):
        derivative(problem.equation, problem.parameters, y, w, linear.phi, linear.A, linear.B, linear.state)
        size = force_scale(aim.scale, q, y, w)
        error = np.sqrt(np.dot(linear.phi, linear.phi))
        solved, changed = error <= aim.tol * size, 0
        for k in range(len(linear.state)):
            if linear.state[k] != (last.state[k] if len(last.own) > 0 else OPEN):
                changed += 1
        if solved and (not aim.current or changed == 0):
            return 1, last
        serves = len(last.own) > 0 and (solved or error <= CHORD * before)
        if tried and before < error and not solved:
            assign(y, y_old)
            times(problem.W, y, w)
            w += q
            error = before
        changed = linearise(problem, y, w, last, serves, linear)
        tried = serves and changed <= CHANGES * len(last.own)
        if tried:
            last = updated(problem.W, last, linear)
        elif renewed == NEWTON and not solved:
            break
        else:
            last = anew(problem.W, last, linear)
            counts[FACTORISATIONS] += 1
            renewed += 1
        if solved:
            return 1, last
        assign(y_old, y)
        before = error
        settled, last = pivots(problem, y, w, q, 0.1 * aim.tol * size, last, linear)
        if not settled:
            return 0, LastProblem(last.state, last.stretch, last.A, last.B, np.empty(0, np.int64), last.inverse)
    return 0, last


@kernel(SOLVED(PATH_PROBLEM, VECTOR, VECTOR, VECTOR, VECTOR, AIM, LAST_PROBLEM, COUNTS))
def solve(problem, y, w, q, start, aim, last, counts):
    """One problem of the law from the guess (y, w): sweeps and Newton, else more sweeps from `start`, and Newton.

    Newton's method with pivots comes first where the solution is near; where it is not, its pivots are wasted on
    four problems in five, and it is the first help.  The rest as :func:`newton_by_pivots`.
    """
    m, sweeps = len(problem.parameters), aim.sweeps
    none = np.empty((0, 0))
    best = start.copy()
    slip = np.zeros(m)
    again = not aim.near and (y == start).all()  # the first help would repeat the first attempt's sweeps
    if sweeps > 0:
        sweep(problem, y, w, q, slip, sweeps)
        if again:
            assign(best, y)
    if aim.near:
        solved, last = newton_by_pivots(problem, y, w, q, aim, last, counts)
        if solved == 1:
            return 1, last
    run, halvings = sweeps, 0 if sweeps > 0 else 20
    for call in range(aim.calls + 1):
        error, steps = newton(
            problem.equation,
            Coupling(problem.W, none, problem.parameters),
            q,
            y,
            w,
            NewtonSettings(1e-12, aim.scale, aim.tol, float(m), PATIENCE, halvings),
        )
        counts[FACTORISATIONS] += steps
        if error <= aim.tol:
            return 1, last
        if call == aim.calls:
            break
        counts[RESCUES] += 1
        assign(y, best)
        times(problem.W, y, w)
        w += q
        if sweeps > 0 and not (again and call == 0):
            sweep(problem, y, w, q, slip, run)
            assign(best, y)
        run *= 2
        if not aim.near and call == 0:
            solved, last = newton_by_pivots(problem, y, w, q, aim, last, counts)
            if solved == 1:
                return 1, last
    return 0, last


@kernel(boolean(PATH_PROBLEM, VECTOR, VECTOR, VECTOR, VECTOR, NUMBER, COUNTS))
def lands(problem, guess, y, w, q, tol, counts):
    """Whether Newton's method solves a problem from a guess (3m,); else (y, w) stay as they are."""
    found, moved = guess.copy(), np.empty_like(w)
    times(problem.W, found, moved)
    moved += q
    none, m = np.empty((0, 0)), len(problem.parameters)
    error, steps = newton(
        problem.equation,
        Coupling(problem.W, none, problem.parameters),
        q,
        found,
        moved,
        NewtonSettings(1e-12, starting_scale(q), tol, float(m), PATIENCE, 0),
    )
    counts[FACTORISATIONS] += steps
    if error > tol:
        return False
    assign(y, found)
    assign(w, moved)
    return True
