"""Prediction of a step: rates with statuses held, pivots of what slides, and events on the way."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numba import int64, types, void

from mic.contact.native.kept_factors import (
    FACTORS,
    MANY,
    Factors,
    add_responses,
    changed_rates,
    factors_of,
    is_full,
    no_factors,
)
from mic.contact.native.kept_inverse import change, inverse_of, let_go
from mic.contact.native.kernel import BLOCKS, COUNTS, MASK, MATRIX, NUMBER, VECTOR, kernel
from mic.contact.native.law_equation import derivative, statuses
from mic.contact.native.matrices import assign, assign_block, assign_sum
from mic.contact.native.path_constants import FACTORISATIONS, LONGEST, NEAR, ROUNDING
from mic.contact.native.slider_lag import lag
from mic.contact.native.step_data import PATH_PROBLEM, PREDICTION, WORKSPACE
from mic.contact.native.step_error import motion_size, rates
from mic.contact.states import OPEN, SLIP, STICK

__all__ = ["Limits", "forward", "predict"]

#: A share of the motion that may be in error: what closes within it does so together.
HARMLESS = 0.5
#: Contacts that open or break loose within one prediction before it is cut short, and changes of sliders after each.
EVENTS, PASSES = 32, 32
#: Changes of one slider within a large prediction: where others hold its direction it may neither slide nor be held.
INDIFFERENT = 4
#: Of the share of a step after which a contact breaks loose.
BISECTIONS = 40


class Limits(NamedTuple):
    """What a prediction may neglect.

    Attributes
    ----------
    behind : float
        How far a step goes behind the first contact that closes, in shares of the path.
    allowed : float
        Error of the step, a length: motion below it does not count.  A contact that slid farther ends the step where it
        opens, too.
    slack : float
        As :func:`forward` has it.
    """

    behind: float
    allowed: float
    slack: float


LIMITS = types.NamedUniTuple(NUMBER, 3, Limits)


@kernel(void(VECTOR, VECTOR, NUMBER))
def forward(y, w, slack):
    """Sliders go a little forward along their way, so that a contact on its cone is one, whatever its last bits.

    ``slack`` is how far Newton's tolerance may leave a force from its cone; one without friction has no way.
    """
    for i in range(0, len(y), 3):
        t = np.sqrt(y[i + 1] ** 2 + y[i + 2] ** 2)
        share = NEAR + slack / max(t, 1e-300)
        w[i + 1] -= share * y[i + 1] + 1e-12 * abs(y[i])
        w[i + 2] -= share * y[i + 2]


class Course(NamedTuple):
    """Where a prediction has come to.

    Attributes
    ----------
    y, w, dy, dw : (3m,) array
        Forces and displacements, and their rates over the path.
    state, held : (m,) array
        Statuses, and which contacts on their cone are held.
    A, B, slide_A, slide_B : (m, 3, 3) array
        Equations of the rates, and those of sliders.
    turned : (m,) array
        How often a slider has changed.
    closed : (c,) int array
        Contacts that are closed at the start.
    inverse : (3c, 3c) array
        Of the equations over them, unless there are many.
    factors : Factors
        Of the equations of many contacts.
    trial, phi, found : (3m,), (3m,), (m,) array
        Scratch.
    """

    y: np.ndarray
    w: np.ndarray
    dy: np.ndarray
    dw: np.ndarray
    state: np.ndarray
    held: np.ndarray
    A: np.ndarray
    B: np.ndarray
    slide_A: np.ndarray
    slide_B: np.ndarray
    turned: np.ndarray
    closed: np.ndarray
    inverse: np.ndarray
    factors: Factors
    trial: np.ndarray
    phi: np.ndarray
    found: np.ndarray


COURSE = types.NamedTuple(
    [*[VECTOR] * 4, COUNTS, MASK, *[BLOCKS] * 4, COUNTS, COUNTS, MATRIX, FACTORS, VECTOR, VECTOR, COUNTS], Course
)


@kernel(int64(int64, COURSE))
def place_of(k, course):
    """The place of contact k among the closed ones."""
    a = 0
    while course.closed[a] != k:
        a += 1
    return a


@kernel(int64(PATH_PROBLEM, COURSE, NUMBER))
def first_breaking(problem, course, advance):
    """The first contact that sticks and whose force has left the cone after an ``advance``; -1 if none does.

    Contacts that were just held are left out.

    One that has no normal force left and a tangential one has left it before.
    """
    y, state, held, found, asked = course.trial, course.state, course.held, course.found, False
    assign_sum(y, course.y, advance, course.dy)
    for k in range(len(state)):
        asked = asked or (state[k] == STICK and not held[k])
    if not asked:
        return -1
    statuses(problem.equation, problem.parameters, y, np.zeros(len(y)), course.phi, found)
    for k in range(len(state)):
        if state[k] == STICK and not held[k]:
            if found[k] == SLIP:
                return k
            if found[k] == OPEN and np.sqrt(y[3 * k + 1] ** 2 + y[3 * k + 2] ** 2) > ROUNDING * np.abs(y).max():
                return k
    return -1


@kernel(COURSE(PATH_PROBLEM, NUMBER, NUMBER, PREDICTION, WORKSPACE))
def begin_course(problem, step, slack, predicted, work):
    """The start of a prediction, with its statuses and equations; arguments of :func:`predict`."""
    state0, e0, grip, loose, x, motion, opened, gone = predicted
    y0, w0, pace, m = work.y0, work.w0, work.pace, len(state0)
    phi, A, B = np.zeros(3 * m), np.zeros((m, 3, 3)), np.zeros((m, 3, 3))
    y, w, found = y0.copy(), w0.copy(), np.zeros(m, np.int64)
    forward(y, w, slack)
    derivative(problem.equation, problem.parameters, y, w, phi, A, B, state0)
    for k in range(m):
        i = 3 * k
        if y[i] <= slack:
            state0[k] = OPEN
        if state0[k] == SLIP:
            v1, v2 = y[i + 1] - w[i + 1], y[i + 2] - w[i + 2]
            t = np.sqrt(v1 * v1 + v2 * v2)
            e0[k, 0], e0[k, 1] = v1 / t, v2 / t
            slip, t = pace[k] * step, np.sqrt(y[i + 1] ** 2 + y[i + 2] ** 2)
            slip *= 1.0 - lag(slip / max(t, 1e-300))
            if slip > NEAR * t:
                w[i + 1], w[i + 2] = w0[i + 1] - slip * e0[k, 0], w0[i + 2] - slip * e0[k, 1]
    derivative(problem.equation, problem.parameters, y, w, phi, A, B, found)
    assign(w, w0)
    opened[:] = 1.0
    gone[:] = x[:] = motion[:] = 0.0
    for k in range(m):
        loose[k] = 0.0 if state0[k] == SLIP else 1.0
        grip[k] = np.sqrt(y[3 * k + 1] ** 2 + y[3 * k + 2] ** 2)
    state, closed, dy, dw = state0.copy(), np.flatnonzero(state0 != OPEN), np.empty(3 * m), np.empty(3 * m)
    held, turned, trial = np.zeros(m, np.bool_), np.zeros(m, np.int64), np.empty(3 * m)
    inverse, factors = np.empty((0, 0)), no_factors()
    if len(closed) > MANY:
        factors = factors_of(problem.W, A, B, state, True)
    if len(factors.lu) == 0:
        inverse = inverse_of(problem.W, A, B, closed)
    slide_A, slide_B = A.copy(), B.copy()
    return Course(
        y, w, dy, dw, state, held, A, B, slide_A, slide_B, turned, closed, inverse, factors, trial, phi, found
    )


@kernel(void(MATRIX, COURSE, int64, MATRIX, MATRIX))
def change_equations(W, course, a, new_A, new_B):
    """The contact ``closed[a]`` begins or ceases to slide, or opens."""
    k = course.closed[a]
    if len(course.factors.lu) == 0:
        change(W, course.A, course.B, course.closed, course.inverse, a, new_A, new_B)
        return
    add_responses(W, course.factors, k)
    assign_block(course.A[k], new_A)
    assign_block(course.B[k], new_B)


@kernel(void(MATRIX, VECTOR, VECTOR, PREDICTION, COURSE))
def sliding_rates(W, rate, y0, predicted, course):
    """Rates of forces and displacements, with contacts on their cone that slide forward or are held.

    On the cone a contact slides forward or its force does not leave the cone, never both: of those that do neither, the
    worst changes.  One may do neither whichever it is, as others turn it: of many it is left.
    """
    dy, dw, state, held, closed, e = course.dy, course.dw, course.state, course.held, course.closed, predicted.e
    large = len(course.factors.lu) > 0
    for _ in range(PASSES):
        if large:
            changed_rates(W, course.factors, course.A, course.B, rate, dy, dw)
        else:
            rates(W, course.B, closed, course.inverse, rate, dy, dw)
        hardest, worst = 0.0, -1
        for a in range(len(closed)):
            k = closed[a]
            i = 3 * k
            if predicted.grip[k] <= ROUNDING * y0[i]:  # no friction: no direction
                continue
            if large and course.turned[k] >= INDIFFERENT:
                continue
            if state[k] == SLIP:
                wrong = dw[i + 1] * e[k, 0] + dw[i + 2] * e[k, 1]
            elif held[k]:
                wrong = 0.0
                for c in range(3):
                    wrong += (e[k, 0] * course.slide_A[k, 1, c] + e[k, 1] * course.slide_A[k, 2, c]) * dy[i + c]
            else:
                continue
            if wrong > hardest:
                hardest, worst = wrong, a
        if worst < 0 or (large and is_full(course.factors)):
            break
        k = closed[worst]
        course.turned[k] += 1
        if held[k]:
            state[k], held[k] = SLIP, False
            change_equations(W, course, worst, course.slide_A[k], course.slide_B[k])
        else:
            state[k], held[k] = STICK, True
            change_equations(W, course, worst, np.zeros((3, 3)), np.eye(3))


@kernel(
    types.Tuple((NUMBER, int64, types.boolean, types.boolean))(
        PATH_PROBLEM, VECTOR, NUMBER, NUMBER, LIMITS, PREDICTION, COURSE
    )
)
def next_event(problem, y0, reached, left, limits, predicted, course):
    """How far the rates hold: to the first contact that closes, opens or breaks loose, or to the end.

    Parameters
    ----------
    reached, left : float
        Shares of the path that the step has made, and that are left of it.

    Returns
    -------
    advance : float
    first : int
        The contact; -1 at the end.
    closes, breaks : bool
        Whether it closes or breaks loose; else it opens.
    """
    y, w, dy, dw, state = course.y, course.w, course.dy, course.dw, course.state
    advance, first, closes, breaks = left, -1, False, False
    for k in range(len(state)):
        i = 3 * k
        if predicted.state[k] == OPEN:
            if dw[i] < 0.0:
                touches = max(w[i], 0.0) / -dw[i]
                # What touches as the step begins has made no way before: it need not be cut for.
                if limits.behind - reached < touches < advance:
                    advance, first, closes = touches, k, True
        elif state[k] != OPEN and dy[i] < 0.0 and max(y[i], 0.0) < -dy[i] * advance:
            advance, first, closes = max(y[i], 0.0) / -dy[i], k, False
    if first_breaking(problem, course, advance) >= 0:
        low, high = 0.0, advance
        for _ in range(BISECTIONS):
            middle = 0.5 * (low + high)
            if first_breaking(problem, course, middle) >= 0:
                high = middle
            else:
                low = middle
        first = first_breaking(problem, course, high)
        i = 3 * first
        # At the tip of its cone it opens, and does not slide.
        advance, closes, breaks = high, False, y[i] + high * dy[i] > NEAR * y0[i]
    if closes:
        harmless = HARMLESS * limits.allowed / max(motion_size(dw, problem.unit), 1e-300)
        advance = min(advance + max(limits.behind, harmless), left)
    return advance, first, closes, breaks


@kernel(void(PATH_PROBLEM, NUMBER, PREDICTION, COURSE))
def go_on(problem, advance, predicted, course):
    """Go on with the rates; what was held on its cone and has left it inwards is free again."""
    y, trial, held, found = course.y, course.trial, course.held, course.found
    assign_sum(y, y, advance, course.dy)
    assign_sum(course.w, course.w, advance, course.dw)
    assign_sum(predicted.x, predicted.x, advance, course.dy)
    assign_sum(predicted.motion, predicted.motion, advance, course.dw)
    assign(trial, y)
    for k in range(len(held)):
        trial[3 * k + 1] *= 1.0 + NEAR
        trial[3 * k + 2] *= 1.0 + NEAR
    statuses(problem.equation, problem.parameters, trial, np.zeros(len(y)), course.phi, found)
    for k in range(len(held)):
        held[k] = held[k] and found[k] != STICK


@kernel(void(PATH_PROBLEM, int64, NUMBER, PREDICTION, COURSE))
def break_loose(problem, k, reached, predicted, course):
    """Contact k begins to slide."""
    y, trial, m, i = course.y, course.trial, len(course.state), 3 * k
    A, B = np.zeros((m, 3, 3)), np.zeros((m, 3, 3))
    for j in range(m):
        for c in range(1, 3):
            trial[3 * j + c] = -NEAR * y[3 * j + c]  # a little forward, as above
    derivative(problem.equation, problem.parameters, y, trial, course.phi, A, B, course.found)
    course.state[k], predicted.loose[k] = SLIP, reached
    predicted.grip[k] = np.sqrt(y[i + 1] ** 2 + y[i + 2] ** 2)
    predicted.e[k, 0], predicted.e[k, 1] = y[i + 1] / predicted.grip[k], y[i + 2] / predicted.grip[k]
    assign_block(course.slide_A[k], A[k])
    assign_block(course.slide_B[k], B[k])
    change_equations(problem.W, course, place_of(k, course), A[k], B[k])


@kernel(void(MATRIX, VECTOR, int64, NUMBER, PREDICTION, COURSE))
def open_up(W, y0, k, reached, predicted, course):
    """Contact k opens."""
    i = 3 * k
    predicted.opened[k] = reached
    predicted.gone[k, 0], predicted.gone[k, 1] = predicted.motion[i + 1], predicted.motion[i + 2]
    for row in range(3):
        predicted.x[i + row] = -y0[i + row]
        course.y[i + row] = 0.0
    course.state[k] = OPEN
    if len(course.factors.lu) == 0:
        let_go(course.inverse, place_of(k, course))
    else:
        change_equations(W, course, place_of(k, course), np.eye(3), np.zeros((3, 3)))


@kernel(NUMBER(PATH_PROBLEM, VECTOR, NUMBER, LIMITS, PREDICTION, WORKSPACE, COUNTS))
def predict(problem, rate, step, limits, predicted, work, counts):
    """Where a step leads with statuses held, but that contacts open on the way.

    A slider's direction comes to rest within a slip of its compliance, much less than that of a step where sheets
    slide on each other as rigid bodies do: held, the directions of several would not let them.  So a slider of
    which it is known how far it may go is linearised there, at the end of its slip, as the shifts have it.

    Parameters
    ----------
    rate : (3m,) array
        Change of ``q`` over the whole path.
    step : float
        Length of the step, in shares of the path.
    limits : Limits
    predicted : Prediction
        Is filled.

    Returns
    -------
    float
        Length of the step, shorter where a contact closes.
    """
    y0, unit, motion, gone, m = work.y0, problem.unit, predicted.motion, predicted.gone, len(predicted.state)
    course = begin_course(problem, step, limits.slack, predicted, work)
    counts[FACTORISATIONS] += 1
    reached = 0.0
    for event in range(EVENTS):
        sliding_rates(problem.W, rate, y0, predicted, course)
        if event == 0:
            for k in range(m):
                predicted.state[k] = course.state[k]
        assign_sum(course.trial, motion, step - reached, course.dw)
        if step > LONGEST and reached < LONGEST and motion_size(course.trial, unit) > limits.allowed:
            step = LONGEST
        advance, first, closes, breaks = next_event(problem, y0, reached, step - reached, limits, predicted, course)
        go_on(problem, advance, predicted, course)
        reached += advance
        full = len(course.factors.lu) > 0 and is_full(course.factors)
        if closes or first < 0 or full or event == EVENTS - 1:
            break
        if breaks:
            break_loose(problem, first, reached, predicted, course)
            continue
        open_up(problem.W, y0, first, reached, predicted, course)
        # Where it was counts, if it slid so far that the time of its opening does.
        way = unit[3 * first + 1] * np.sqrt(gone[first, 0] ** 2 + gone[first, 1] ** 2)
        if way > limits.allowed * np.sqrt(m):
            step = min(step, reached + limits.behind)
    if reached < step:
        step = max(reached, min(limits.behind, step))
    for k in range(m):
        if predicted.opened[k] < 1.0:
            predicted.opened[k] /= step
        if predicted.loose[k] < 1.0:
            predicted.loose[k] /= step
    return step
