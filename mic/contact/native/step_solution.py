"""Solution of a step: sweeps, then Newton's method with an inverse that is kept and changed by pivots."""

from __future__ import annotations

import numpy as np
from numba import boolean, int64, types, void

from mic.contact.native.gauss_seidel import gauss_seidel
from mic.contact.native.kept_factors import are_many, solve_with_factors
from mic.contact.native.kernel import COUNTS, NUMBER, VECTOR, kernel
from mic.contact.native.law_equation import derivative, force_scale
from mic.contact.native.matrices import assign, assign_sum, displace
from mic.contact.native.newton import PATIENT, Coupling, NewtonSettings, newton
from mic.contact.native.path_constants import FACTORISATIONS
from mic.contact.native.pivots import anew, factorised_anew, linearise, linearised, pivots, updated, without_problem
from mic.contact.native.step_data import AIM, LAST_PROBLEM, PATH_PROBLEM, WORKSPACE
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


@kernel(void(PATH_PROBLEM, WORKSPACE, VECTOR, int64))
def sweep(problem, work, slip, sweeps):
    """Gauss-Seidel's sweeps from (work.y, work.w), and ``w = W y + q`` without the rounding that they leave."""
    gauss_seidel(problem.W, problem.P, problem.parameters, work.y, work.w, slip, sweeps, 1e-15)
    displace(problem.W, work.y, work.q, work.w)


@kernel(NUMBER(PATH_PROBLEM, VECTOR, VECTOR, VECTOR, AIM, int64, COUNTS))
def newton_alone(problem, q, y, w, aim, halvings, counts):
    """The error of :func:`mic.contact.native.newton.newton` from the guess (y, w), which it improves."""
    coupling = Coupling(problem.W, np.empty((0, 0)), problem.parameters)
    crowd = float(len(problem.parameters))
    settings = NewtonSettings(1e-12, aim.scale, aim.tol, crowd, PATIENCE, halvings)
    error, steps = newton(problem.equation, coupling, q, y, w, settings)
    counts[FACTORISATIONS] += steps
    return error


@kernel(SOLVED(PATH_PROBLEM, WORKSPACE, AIM, LAST_PROBLEM, COUNTS))
def newton_by_pivots(problem, work, aim, last, counts):
    """Newton's method whose linear problems keep their inequalities (Josephy's), from the guess (work.y, work.w).

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
    y, w, q, linear = work.y, work.w, work.q, linearised(len(problem.parameters))
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
            displace(problem.W, y, q, w)
            error = before
        changed = linearise(problem, work, last, serves, linear)
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
        settled, last = pivots(problem, work, 0.1 * aim.tol * size, last, linear)
        if not settled:
            return 0, without_problem(last)
    return 0, last


@kernel(boolean(LAST_PROBLEM, COUNTS))
def has_factors(last, state):
    """Whether the last problem has factors for these statuses."""
    if len(last.factors.lu) == 0:
        return False
    for k in range(len(state)):
        if state[k] != last.state[k]:
            return False
    return True


@kernel(SOLVED(PATH_PROBLEM, WORKSPACE, AIM, LAST_PROBLEM, COUNTS))
def newton_by_factors(problem, work, aim, last, counts):
    """Newton's method for many contacts, from the guess (work.y, work.w); arguments and results as
    :func:`newton_by_pivots`.

    Sliders are linearised as there.  Statuses are those at the last point: many change at once.  While none changes,
    factors serve again as long as every step brings the error down by :data:`CHORD`.
    """
    y, w, q, linear = work.y, work.w, work.q, linearised(len(problem.parameters))
    step, least, gained, before = np.empty_like(y), np.inf, 0, np.inf
    for iteration in range(STEPS_OF_NEWTON):
        derivative(problem.equation, problem.parameters, y, w, linear.phi, linear.A, linear.B, linear.state)
        error = np.sqrt(np.dot(linear.phi, linear.phi)) / force_scale(aim.scale, q, y, w)
        if not error < np.inf or iteration - gained > PATIENT:
            break
        if error < least or iteration == 1:  # a guess may be near, and the way from it lead through larger errors
            least, gained = error, iteration
        solved, same = error <= aim.tol, has_factors(last, linear.state)
        if solved and (same or not aim.current):
            return 1, last
        serves = same and error <= CHORD * before
        before = error
        changed = linearise(problem, work, last, serves, linear)
        if not serves or changed > 0:
            last = factorised_anew(problem.W, last, linear)
            counts[FACTORISATIONS] += 1
            if len(last.factors.lu) == 0:
                break
        if solved:
            return 1, last
        assign_sum(linear.phi, np.zeros(len(y)), -1.0, linear.right)
        solve_with_factors(problem.W, last.factors, linear.phi, y, step)
        assign_sum(y, y, 1.0, step)
        displace(problem.W, y, q, w)
    return 0, without_problem(last)


@kernel(SOLVED(PATH_PROBLEM, WORKSPACE, AIM, LAST_PROBLEM, COUNTS))
def solve(problem, work, aim, last, counts):
    """One problem of the law from the guess (work.y, work.w): sweeps and Newton, else more sweeps from the forces
    where the step starts, and Newton.

    Newton's method with pivots comes first where the solution is near; where it is not, its pivots are wasted on
    four problems in five, and it is the first help.  For many contacts :func:`newton_by_factors` takes its place.  The
    rest as :func:`newton_by_pivots`.
    """
    y, w, q, sweeps = work.y, work.w, work.q, aim.sweeps
    best, slip = work.y0.copy(), np.zeros(len(problem.parameters))
    again = not aim.near and (y == work.y0).all()  # the first help would repeat the first attempt's sweeps
    if sweeps > 0:
        sweep(problem, work, slip, sweeps)
        if again:
            assign(best, y)
    many = are_many(y)
    if many != (len(last.factors.lu) > 0):
        last = without_problem(last)
    if many:
        z = y.copy()
        solved, last = newton_by_factors(problem, work, aim, last, counts)
        if solved == 1:
            return 1, last
        assign(y, z)
        displace(problem.W, y, q, w)
    elif aim.near:
        solved, last = newton_by_pivots(problem, work, aim, last, counts)
        if solved == 1:
            return 1, last
    run, halvings = sweeps, 0 if sweeps > 0 else 20
    for call in range(aim.calls + 1):
        if newton_alone(problem, q, y, w, aim, halvings, counts) <= aim.tol:
            return 1, last
        if call == aim.calls:
            break
        assign(y, best)
        displace(problem.W, y, q, w)
        if sweeps > 0 and not (again and call == 0):
            sweep(problem, work, slip, run)
            assign(best, y)
        run *= 2
        if not aim.near and not many and call == 0:
            solved, last = newton_by_pivots(problem, work, aim, last, counts)
            if solved == 1:
                return 1, last
    return 0, last


@kernel(boolean(PATH_PROBLEM, VECTOR, WORKSPACE, AIM, COUNTS))
def lands(problem, guess, work, aim, counts):
    """Whether Newton's method solves a problem from a guess (3m,); else (work.y, work.w) stay as they are."""
    y, w = guess.copy(), np.empty_like(guess)
    displace(problem.W, y, work.q, w)
    if newton_alone(problem, work.q, y, w, aim, 0, counts) > aim.tol:
        return False
    assign(work.y, y)
    assign(work.w, w)
    return True
