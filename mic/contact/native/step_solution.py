"""Solution of a step: sweeps, then Newton's method with an inverse that is kept and changed by pivots."""

from __future__ import annotations

import numpy as np
from numba import boolean, int64, types, void

from mic.contact.native.gauss_seidel import gauss_seidel
from mic.contact.native.kept_inverse import border, change, inverse_of
from mic.contact.native.kernel import BLOCKS, COUNTS, MATRIX, NUMBER, VECTOR, kernel
from mic.contact.native.law_equation import EQUATION_POINTER, derivative, force_scale, linear_equation, starting_scale
from mic.contact.native.matrices import assign, times
from mic.contact.native.newton import Coupling, NewtonSettings, newton
from mic.contact.native.path_constants import FACTORISATIONS, NEAR, RESCUES
from mic.contact.states import OPEN, SLIP, STICK

__all__ = ["LAST_PROBLEM", "lands", "solve"]

#: Newton's steps, the inverses that it may make, and changes of statuses within a step, of all contacts and of one:
#: more, and they go round in a circle.
STEPS_OF_NEWTON, NEWTON, PIVOTS, TURNS = 40, 10, 100, 10
#: A step with the inverse of one before, a tenth of the cost of a new one, must bring the error down by this, and of
#: the contacts this share may have changed their status.
CHORD, CHANGES = 0.3, 0.3
#: In a slider's equation its displacement counts so many times that it is this share of its force: its direction is
#: then that of its motion as well as that of its force, which others hold; and so many times at most.
EVEN, STRETCH = 0.3, 1e4
#: Newton's steps in a call for help.
PATIENCE = 40

#: Of the linear problem that was solved last: statuses, stretch, A, B, contacts, inverse; and what a solution returns.
LAST_PROBLEM = COUNTS, VECTOR, BLOCKS, BLOCKS, COUNTS, MATRIX
SOLVED = types.Tuple((int64, COUNTS, MATRIX))


@kernel(void(EQUATION_POINTER, MATRIX, VECTOR, VECTOR, VECTOR, int64, MATRIX, MATRIX, VECTOR, VECTOR))
def facet(equation, parameters, y, w, y_new, k, A, B, right, e):
    """Contact k slides against the force that ``y_new`` has: its linear equation there, ``A dy + B dw = right``.

    ``e`` (2,) receives the force's direction.
    """
    i = 3 * k
    at, back, phi, found = y_new[i : i + 3].copy(), np.zeros(3), np.zeros(3), np.zeros(1, np.int64)
    own, blocks_A, blocks_B = parameters[k : k + 1], np.zeros((1, 3, 3)), np.zeros((1, 3, 3))
    equation(own, at, back, phi, blocks_A, blocks_B, found, False)
    if found[0] == SLIP:  # from outside onto the cone
        at[1] -= phi[1]
        at[2] -= phi[2]
    t = max(np.sqrt(at[1] ** 2 + at[2] ** 2), 1e-300)
    for c in range(1, 3):
        e[c - 1] = at[c] / t
        back[c] = -NEAR * at[c]
    equation(own, at, back, phi, blocks_A, blocks_B, found, True)
    for row in range(3):
        assign(A[row], blocks_A[0, row])
        assign(B[row], blocks_B[0, row])
        right[row] = -phi[row]
        for c in range(3):
            right[row] -= A[row, c] * (y[i + c] - at[c]) + B[row, c] * (w[i + c] - back[c])


@kernel(void(MATRIX, COUNTS, MATRIX, VECTOR, VECTOR, VECTOR, VECTOR, VECTOR))
def linear(W, own, inverse, right, y, q, y_new, w_new):
    """``y_new = y + J⁻¹ right`` over the contacts `own`, and ``w_new = W y_new + q``."""
    r = np.empty(3 * len(own))
    for a in range(len(own)):
        for c in range(3):
            r[3 * a + c] = right[3 * own[a] + c]
    x = np.dot(inverse, r)
    assign(y_new, y)
    for a in range(len(own)):
        for c in range(3):
            y_new[3 * own[a] + c] += x[3 * a + c]
    times(W, y_new, w_new)
    w_new += q


@kernel(void(MATRIX, MATRIX, MATRIX, VECTOR, VECTOR, VECTOR, VECTOR, int64))
def sweep(W, P, parameters, y, w, q, slip, sweeps):
    """Gauss-Seidel's sweeps from (y, w), and ``w = W y + q`` without the rounding that they leave."""
    gauss_seidel(W, P, parameters, y, w, slip, sweeps, 1e-15)
    times(W, y, w)
    w += q


@kernel(
    SOLVED(EQUATION_POINTER, MATRIX, MATRIX, VECTOR, VECTOR, VECTOR, NUMBER, NUMBER, boolean, *LAST_PROBLEM, COUNTS)
)
def newton_by_pivots(equation, W, parameters, y, w, q, tol, scale, current, kept, stretch, A, B, own, inverse, counts):
    """Newton's method whose linear problems keep their inequalities (Josephy's), from the guess (y, w).

    Equations are linearised where they are, statuses are not held: after each linear solution the contact whose
    inequality is violated most changes its status, the inverse by rank 3, until none is.  A slider whose motion is
    small would else be taken for one that sticks and back again, step after step.

    A problem differs little from the one solved before: its inverse serves, with the rows of contacts whose status
    changed, as long as every step brings the error down by :data:`CHORD`.

    Parameters
    ----------
    current : bool
        Whether the linear problem has the statuses of the solution in any case, however it was found.
    kept, stretch, A, B : (m,), (m,), (m, 3, 3), (m, 3, 3) array
        Of the linear problem that was solved last: statuses, how many times tangential displacements count, and
        the equations.
    own : (c,) int array
        The contacts that it is over, none if there was none.
    inverse : (3c, 3c) array

    Returns
    -------
    int
        1 if it is solved; ``w = W y + q`` in any case.
    own, inverse
        The last ones.
    """
    m = len(parameters)
    phi, new_A, new_B = np.zeros(3 * m), np.zeros((m, 3, 3)), np.zeros((m, 3, 3))
    state, found, place = np.zeros(m, np.int64), np.zeros(m, np.int64), np.zeros(m, np.int64)
    turned = np.zeros(m, np.int64)
    e, right, scaling = np.zeros((m, 2)), np.zeros(3 * m), np.ones(m)
    y_new, w_new, trial, still = np.empty(3 * m), np.empty(3 * m), np.empty(3 * m), np.zeros(3 * m)
    nothing = np.empty((0, 3, 3))
    y_old, before, renewed, tried = y.copy(), np.inf, 0, False
    for _ in range(STEPS_OF_NEWTON):
        derivative(equation, parameters, y, w, phi, new_A, new_B, state)
        size = force_scale(scale, q, y, w)
        error = np.sqrt(np.dot(phi, phi))
        solved, changed = error <= tol * size, 0
        for k in range(m):
            if state[k] != (kept[k] if len(own) > 0 else OPEN):
                changed += 1
        if solved and (not current or changed == 0):
            return 1, own, inverse
        serves = len(own) > 0 and (solved or error <= CHORD * before)
        if tried and before < error and not solved:
            assign(y, y_old)
            times(W, y, w)
            w += q
            error = before
        small = 0.1 * tol * size
        for k in range(m):
            i = 3 * k
            scaling[k] = stretch[k]
            if kept[k] != SLIP or not serves:
                force = np.sqrt(y[i + 1] ** 2 + y[i + 2] ** 2)
                motion = np.sqrt(w[i + 1] ** 2 + w[i + 2] ** 2)
                scaling[k] = min(max(EVEN * force / max(motion, 1e-300), 1.0), STRETCH)
            trial[i] = w[i]
            trial[i + 1], trial[i + 2] = scaling[k] * w[i + 1], scaling[k] * w[i + 2]
        derivative(equation, parameters, y, trial, phi, new_A, new_B, state)
        changed = 0
        for k in range(m):
            i = 3 * k
            place[k] = 0 if state[k] != OPEN or y[i] != 0.0 or y[i + 1] != 0.0 or y[i + 2] != 0.0 else -1
            if state[k] == SLIP:
                for row in range(3):
                    for c in range(1, 3):
                        new_B[k, row, c] *= scaling[k]
                v1, v2 = y[i + 1] - trial[i + 1], y[i + 2] - trial[i + 2]
                t = np.sqrt(v1 * v1 + v2 * v2)
                e[k, 0], e[k, 1] = v1 / t, v2 / t
            for c in range(i, i + 3):
                right[c] = -w[c] if state[k] == STICK else -phi[c]
            if state[k] != kept[k]:
                changed += 1
        tried = serves and changed <= CHANGES * len(own)
        if tried:
            asked = place.copy()
            place[:] = -1
            for a in range(len(own)):
                place[own[a]] = a
            for k in range(m):
                if asked[k] == 0 and place[k] < 0:
                    place[k] = len(own)
                    own, inverse = border(W, B, own, inverse, k)
                    linear_equation(A[k], B[k], 1.0)
        else:
            if renewed == NEWTON and not solved:
                break
            own = np.flatnonzero(place >= 0)
            for a in range(len(own)):
                place[own[a]] = a
            assign(stretch, scaling)
            for k in range(m):
                kept[k] = state[k]
                for row in range(3):
                    assign(A[k, row], new_A[k, row])
                    assign(B[k, row], new_B[k, row])
            inverse = inverse_of(W, A, B, own)
            counts[FACTORISATIONS] += 1
            renewed += 1
        for k in range(m):
            if state[k] == kept[k]:
                continue
            change(W, A, B, own, inverse, place[k], new_A[k], new_B[k])
            kept[k], stretch[k] = state[k], scaling[k]
        if solved:
            return 1, own, inverse
        assign(y_old, y)
        before = error
        settled = False
        turned[:] = 0
        for pivot in range(PIVOTS):
            linear(W, own, inverse, right, y, q, y_new, w_new)
            assign(trial, y_new)
            sticks = False
            for k in range(m):
                if kept[k] == STICK:
                    sticks = True
                else:
                    trial[3 * k + 1] = trial[3 * k + 2] = 0.0
            if sticks:
                equation(parameters, trial, still, phi, nothing, nothing, found, False)
            hardest, worst, many = small, -1, 0
            for k in range(m):
                i = 3 * k
                if kept[k] == OPEN:
                    wrong = -w_new[i]
                elif y_new[i] < 0.0:
                    wrong = -y_new[i]
                elif kept[k] == SLIP:
                    wrong = e[k, 0] * w_new[i + 1] + e[k, 1] * w_new[i + 2]
                elif found[k] == SLIP:
                    wrong = np.sqrt(phi[i + 1] ** 2 + phi[i + 2] ** 2)
                else:
                    continue
                many += wrong > small
                if wrong > hardest:
                    hardest, worst = wrong, k
            if worst < 0:
                settled = True
                break
            turned[worst] += 1
            if turned[worst] > TURNS or many > PIVOTS - pivot:  # one by one they would not be done
                break
            i = 3 * worst
            if place[worst] < 0:
                place[worst] = len(own)
                own, inverse = border(W, B, own, inverse, worst)
                linear_equation(A[worst], B[worst], 1.0)
            if kept[worst] != OPEN and y_new[i] < 0.0:
                kept[worst] = OPEN
                for c in range(i, i + 3):
                    right[c] = -y[c]
                linear_equation(new_A[worst], new_B[worst], 1.0)
            elif kept[worst] == STICK:
                kept[worst] = SLIP
                stretch[worst] = 1.0
                facet(
                    equation,
                    parameters,
                    y,
                    w,
                    y_new,
                    worst,
                    new_A[worst],
                    new_B[worst],
                    right[i : i + 3],
                    e[worst],
                )
            else:
                kept[worst] = STICK
                for c in range(i, i + 3):
                    right[c] = -w[c]
                linear_equation(new_A[worst], new_B[worst], 0.0)
            change(W, A, B, own, inverse, place[worst], new_A[worst], new_B[worst])
        if not settled:
            return 0, np.empty(0, np.int64), inverse
        assign(y, y_new)
        assign(w, w_new)
    return 0, own, inverse


@kernel(
    SOLVED(
        EQUATION_POINTER,
        MATRIX,
        MATRIX,
        MATRIX,
        VECTOR,
        VECTOR,
        VECTOR,
        VECTOR,
        NUMBER,
        NUMBER,
        int64,
        int64,
        boolean,
        boolean,
        *LAST_PROBLEM,
        COUNTS,
    )
)
def solve(
    equation,
    W,
    P,
    parameters,
    y,
    w,
    q,
    start,
    tol,
    scale,
    sweeps,
    calls,
    near,
    current,
    kept,
    stretch,
    A,
    B,
    own,
    inverse,
    counts,
):
    """One problem of the law from the guess (y, w): sweeps and Newton, else more sweeps from `start`, and Newton.

    Newton's method with pivots comes first where the solution is `near`; where it is not, its pivots are wasted on
    four problems in five, and it is the first help.  `calls` for help are made before it is given up.  The rest as
    :func:`newton_by_pivots`.
    """
    m = len(parameters)
    none = np.empty((0, 0))
    best = start.copy()
    slip = np.zeros(m)
    again = not near and (y == start).all()  # the first help would repeat the first attempt's sweeps
    if sweeps > 0:
        sweep(W, P, parameters, y, w, q, slip, sweeps)
        if again:
            assign(best, y)
    if near:
        solved, own, inverse = newton_by_pivots(
            equation, W, parameters, y, w, q, tol, scale, current, kept, stretch, A, B, own, inverse, counts
        )
        if solved == 1:
            return 1, own, inverse
    run, halvings = sweeps, 0 if sweeps > 0 else 20
    for call in range(calls + 1):
        error, steps = newton(
            equation,
            Coupling(W, none, parameters),
            q,
            y,
            w,
            NewtonSettings(1e-12, scale, tol, float(m), PATIENCE, halvings),
        )
        counts[FACTORISATIONS] += steps
        if error <= tol:
            return 1, own, inverse
        if call == calls:
            break
        counts[RESCUES] += 1
        assign(y, best)
        times(W, y, w)
        w += q
        if sweeps > 0 and not (again and call == 0):
            sweep(W, P, parameters, y, w, q, slip, run)
            assign(best, y)
        run *= 2
        if not near and call == 0:
            solved, own, inverse = newton_by_pivots(
                equation, W, parameters, y, w, q, tol, scale, current, kept, stretch, A, B, own, inverse, counts
            )
            if solved == 1:
                return 1, own, inverse
    return 0, own, inverse


@kernel(boolean(EQUATION_POINTER, MATRIX, MATRIX, VECTOR, VECTOR, VECTOR, VECTOR, NUMBER, COUNTS))
def lands(equation, W, parameters, guess, y, w, q, tol, counts):
    """Whether Newton's method solves a problem from a guess (3m,); else (y, w) stay as they are."""
    found, moved = guess.copy(), np.empty_like(w)
    times(W, found, moved)
    moved += q
    none, m = np.empty((0, 0)), len(parameters)
    error, steps = newton(
        equation,
        Coupling(W, none, parameters),
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
