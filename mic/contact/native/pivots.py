"""A linear problem of contacts with its inequalities, by pivots: statuses change one by one, the inverse by rank 3."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numba import int64, types, void

from mic.contact.native.kept_factors import factors_of, no_factors
from mic.contact.native.kept_inverse import border, change, inverse_of
from mic.contact.native.kernel import BLOCKS, COUNTS, MATRIX, NUMBER, VECTOR, kernel
from mic.contact.native.law_equation import derivative, linear_equation, statuses
from mic.contact.native.matrices import assign, assign_block, displace
from mic.contact.native.path_constants import NEAR
from mic.contact.native.step_data import LAST_PROBLEM, PATH_PROBLEM, WORKSPACE, LastProblem
from mic.contact.states import OPEN, SLIP, STICK

__all__ = ["anew", "factorised_anew", "linearise", "linearised", "pivots", "updated", "without_problem"]

#: Changes of statuses within a step, of all contacts and of one: more, and they go round in a circle.
PIVOTS, TURNS = 100, 10
#: In a slider's equation its displacement counts so many times that it is this share of its force: its direction is
#: then that of its motion as well as that of its force, which others hold; and so many times at most.
EVEN, STRETCH = 0.3, 1e4


class Linearised(NamedTuple):
    """The law's equations, linearised where the contacts are.

    Attributes
    ----------
    state, scaling : (m,) array
        Statuses, and how many times tangential displacements count.
    A, B, right : (m, 3, 3), (m, 3, 3), (3m,) array
        ``A dy + B dw = right``.
    e : (m, 2) array
        Directions of sliders.
    place : (m,) array
        0 for contacts that take part, -1 for the others; then their place among those of the problem.
    phi : (3m,) array
        Scratch.
    """

    state: np.ndarray
    scaling: np.ndarray
    A: np.ndarray
    B: np.ndarray
    right: np.ndarray
    e: np.ndarray
    place: np.ndarray
    phi: np.ndarray


LINEARISED = types.NamedTuple([COUNTS, VECTOR, BLOCKS, BLOCKS, VECTOR, MATRIX, COUNTS, VECTOR], Linearised)


@kernel(LINEARISED(int64))
def linearised(m):
    """Arrays for m contacts."""
    state, place = np.zeros(m, np.int64), np.zeros(m, np.int64)
    A, B = np.zeros((m, 3, 3)), np.zeros((m, 3, 3))
    return Linearised(state, np.ones(m), A, B, np.zeros(3 * m), np.zeros((m, 2)), place, np.zeros(3 * m))


@kernel(int64(PATH_PROBLEM, WORKSPACE, LAST_PROBLEM, types.boolean, LINEARISED))
def linearise(problem, work, last, serves, linear):
    """Linearise the equations at (work.y, work.w); returns how many statuses are not those of the last problem.

    If that problem ``serves``, its sliders keep their scaling.
    """
    state, scaling, A, B, right, e, place, phi = linear
    y, w = work.y, work.w
    stretched = np.empty(len(w))
    for k in range(len(state)):
        i = 3 * k
        scaling[k] = last.stretch[k]
        if last.state[k] != SLIP or not serves:
            force = np.sqrt(y[i + 1] ** 2 + y[i + 2] ** 2)
            motion = np.sqrt(w[i + 1] ** 2 + w[i + 2] ** 2)
            scaling[k] = min(max(EVEN * force / max(motion, 1e-300), 1.0), STRETCH)
        stretched[i] = w[i]
        stretched[i + 1], stretched[i + 2] = scaling[k] * w[i + 1], scaling[k] * w[i + 2]
    derivative(problem.equation, problem.parameters, y, stretched, phi, A, B, state)
    changed = 0
    for k in range(len(state)):
        i = 3 * k
        place[k] = 0 if state[k] != OPEN or y[i] != 0.0 or y[i + 1] != 0.0 or y[i + 2] != 0.0 else -1
        if state[k] == SLIP:
            for row in range(3):
                for c in range(1, 3):
                    B[k, row, c] *= scaling[k]
            v1, v2 = y[i + 1] - stretched[i + 1], y[i + 2] - stretched[i + 2]
            t = np.sqrt(v1 * v1 + v2 * v2)
            e[k, 0], e[k, 1] = v1 / t, v2 / t
        for c in range(i, i + 3):
            right[c] = -w[c] if state[k] == STICK else -phi[c]
        if state[k] != last.state[k]:
            changed += 1
    return changed


@kernel(LAST_PROBLEM(LAST_PROBLEM))
def without_problem(last):
    """Its arrays, but no last problem: neither an inverse nor factors."""
    none = np.empty(0, np.int64), np.empty((0, 0))
    return LastProblem(last.state, last.stretch, last.A, last.B, none[0], none[1], no_factors())


@kernel(void(LINEARISED, LAST_PROBLEM))
def copy_equations(linear, last):
    """The last problem's equations become those of the linearised one."""
    assign(last.stretch, linear.scaling)
    for k in range(len(linear.state)):
        last.state[k] = linear.state[k]
        assign_block(last.A[k], linear.A[k])
        assign_block(last.B[k], linear.B[k])


@kernel(LAST_PROBLEM(MATRIX, LAST_PROBLEM, LINEARISED))
def anew(W, last, linear):
    """The linearised problem with an inverse of its own."""
    own = np.flatnonzero(linear.place >= 0)
    for a in range(len(own)):
        linear.place[own[a]] = a
    copy_equations(linear, last)
    inverse = inverse_of(W, last.A, last.B, own)
    return LastProblem(last.state, last.stretch, last.A, last.B, own, inverse, no_factors())


@kernel(LAST_PROBLEM(MATRIX, LAST_PROBLEM, LINEARISED))
def factorised_anew(W, last, linear):
    """The linearised problem of many contacts with factors of its own."""
    copy_equations(linear, last)
    factors, own = factors_of(W, last.A, last.B, last.state, False), np.flatnonzero(last.state != OPEN)
    own = own if len(factors.lu) > 0 else own[:0]
    return LastProblem(last.state, last.stretch, last.A, last.B, own, np.empty((0, 0)), factors)


@kernel(LAST_PROBLEM(MATRIX, LAST_PROBLEM, LINEARISED, int64))
def joined(W, last, linear, k):
    """The last problem with contact k, open."""
    linear.place[k] = len(last.own)
    own, inverse = border(W, last.B, last.own, last.inverse, k)
    linear_equation(last.A[k], last.B[k], 1.0)
    return LastProblem(last.state, last.stretch, last.A, last.B, own, inverse, last.factors)


@kernel(LAST_PROBLEM(MATRIX, LAST_PROBLEM, LINEARISED))
def updated(W, last, linear):
    """The last problem with the contacts that take part now and the equations of those whose status has changed."""
    place, asked = linear.place, linear.place.copy()
    place[:] = -1
    for a in range(len(last.own)):
        place[last.own[a]] = a
    for k in range(len(place)):
        if asked[k] == 0 and place[k] < 0:
            last = joined(W, last, linear, k)
    for k in range(len(place)):
        if linear.state[k] != last.state[k]:
            change(W, last.A, last.B, last.own, last.inverse, place[k], linear.A[k], linear.B[k])
            last.state[k], last.stretch[k] = linear.state[k], linear.scaling[k]
    return last


@kernel(void(PATH_PROBLEM, VECTOR, VECTOR, VECTOR, int64, MATRIX, MATRIX, VECTOR, VECTOR))
def facet(problem, y, w, y_new, k, A, B, right, e):
    """Contact k slides against the force that ``y_new`` has: its linear equation there, ``A dy + B dw = right``.

    ``e`` (2,) receives the force's direction.
    """
    i = 3 * k
    at, back, phi, found = y_new[i : i + 3].copy(), np.zeros(3), np.zeros(3), np.zeros(1, np.int64)
    own, blocks_A, blocks_B = problem.parameters[k : k + 1], np.zeros((1, 3, 3)), np.zeros((1, 3, 3))
    problem.equation(own, at, back, phi, blocks_A, blocks_B, found, False)
    if found[0] == SLIP:  # from outside onto the cone
        at[1] -= phi[1]
        at[2] -= phi[2]
    t = max(np.sqrt(at[1] ** 2 + at[2] ** 2), 1e-300)
    for c in range(1, 3):
        e[c - 1] = at[c] / t
        back[c] = -NEAR * at[c]
    problem.equation(own, at, back, phi, blocks_A, blocks_B, found, True)
    assign_block(A, blocks_A[0])
    assign_block(B, blocks_B[0])
    for row in range(3):
        right[row] = -phi[row]
        for c in range(3):
            right[row] -= A[row, c] * (y[i + c] - at[c]) + B[row, c] * (w[i + c] - back[c])


@kernel(void(MATRIX, LAST_PROBLEM, VECTOR, VECTOR, VECTOR, VECTOR, VECTOR))
def solve_linear(W, last, right, y, q, y_new, w_new):
    """``y_new = y + J⁻¹ right`` over its contacts, and ``w_new = W y_new + q``."""
    own = last.own
    r = np.empty(3 * len(own))
    for a in range(len(own)):
        for c in range(3):
            r[3 * a + c] = right[3 * own[a] + c]
    x = np.dot(last.inverse, r)
    assign(y_new, y)
    for a in range(len(own)):
        for c in range(3):
            y_new[3 * own[a] + c] += x[3 * a + c]
    displace(W, y_new, q, w_new)


@kernel(types.UniTuple(int64, 2)(PATH_PROBLEM, COUNTS, LINEARISED, VECTOR, VECTOR, NUMBER))
def most_violated(problem, state, linear, y, w, small):
    """The contact whose inequality is violated most, -1 if none is by more than ``small``, and how many are."""
    trial, found, phi = y.copy(), np.zeros(len(state), np.int64), linear.phi
    sticks = False
    for k in range(len(state)):
        if state[k] == STICK:
            sticks = True
        else:
            trial[3 * k + 1] = trial[3 * k + 2] = 0.0
    if sticks:
        statuses(problem.equation, problem.parameters, trial, np.zeros(len(y)), phi, found)
    hardest, worst, many = small, -1, 0
    for k in range(len(state)):
        i = 3 * k
        if state[k] == OPEN:
            wrong = -w[i]
        elif y[i] < 0.0:
            wrong = -y[i]
        elif state[k] == SLIP:
            wrong = linear.e[k, 0] * w[i + 1] + linear.e[k, 1] * w[i + 2]
        elif found[k] == SLIP:
            wrong = np.sqrt(phi[i + 1] ** 2 + phi[i + 2] ** 2)
        else:
            continue
        many += wrong > small
        if wrong > hardest:
            hardest, worst = wrong, k
    return worst, many


@kernel(void(PATH_PROBLEM, VECTOR, VECTOR, VECTOR, LAST_PROBLEM, LINEARISED, int64))
def turn_over(problem, y, w, y_new, last, linear, k):
    """Contact k, which takes part, changes its status: it opens, slides against its force, or sticks."""
    A, B, right, i = linear.A, linear.B, linear.right, 3 * k
    if last.state[k] != OPEN and y_new[i] < 0.0:
        last.state[k] = OPEN
        for c in range(i, i + 3):
            right[c] = -y[c]
        linear_equation(A[k], B[k], 1.0)
    elif last.state[k] == STICK:
        last.state[k] = SLIP
        last.stretch[k] = 1.0
        facet(problem, y, w, y_new, k, A[k], B[k], right[i : i + 3], linear.e[k])
    else:
        last.state[k] = STICK
        for c in range(i, i + 3):
            right[c] = -w[c]
        linear_equation(A[k], B[k], 0.0)
    change(problem.W, last.A, last.B, last.own, last.inverse, linear.place[k], A[k], B[k])


@kernel(types.Tuple((types.boolean, LAST_PROBLEM))(PATH_PROBLEM, WORKSPACE, NUMBER, LAST_PROBLEM, LINEARISED))
def pivots(problem, work, small, last, linear):
    """Solve the last problem with its inequalities: whether it is done; then (work.y, work.w) are its solution.

    After each linear solution the contact whose inequality is violated most changes its status.
    """
    y, w, q = work.y, work.w, work.q
    y_new, w_new, turned = np.empty_like(y), np.empty_like(w), np.zeros(len(last.state), np.int64)
    for pivot in range(PIVOTS):
        solve_linear(problem.W, last, linear.right, y, q, y_new, w_new)
        worst, many = most_violated(problem, last.state, linear, y_new, w_new, small)
        if worst < 0:
            assign(y, y_new)
            assign(w, w_new)
            return True, last
        turned[worst] += 1
        if turned[worst] > TURNS or many > PIVOTS - pivot:  # one by one they would not be done
            break
        if linear.place[worst] < 0:
            last = joined(problem.W, last, linear, worst)
        turn_over(problem, y, w, y_new, last, linear, worst)
    return False, last
