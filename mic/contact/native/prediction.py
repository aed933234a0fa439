"""Prediction of a step: rates with statuses held, pivots of what slides, and events on the way."""

from __future__ import annotations

import numpy as np
from numba import int64, types, void

from mic.contact.native.kept_inverse import LARGE, change, inverse_of, let_go
from mic.contact.native.kernel import COUNTS, MATRIX, NUMBER, VECTOR, kernel
from mic.contact.native.law_equation import EQUATION_POINTER, derivative
from mic.contact.native.matrices import assign, assign_sum
from mic.contact.native.path_constants import FACTORISATIONS, LONGEST, NEAR, ROUNDING
from mic.contact.native.slip_origins import lag
from mic.contact.native.step_error import motion_size, rates
from mic.contact.states import OPEN, SLIP, STICK

__all__ = ["forward", "predict"]

#: A share of the motion that may be in error: what closes within it does so together.
HARMLESS = 0.5
#: Contacts that open or break loose within one prediction before it is cut short, and changes of sliders after each.
EVENTS, PASSES = 32, 32
#: Changes of one slider within a large prediction: where others hold its direction it may neither slide nor be held.
INDIFFERENT = 4
#: Of the share of a step after which a contact breaks loose.
BISECTIONS = 40


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


@kernel(int64(EQUATION_POINTER, MATRIX, VECTOR, VECTOR, COUNTS, types.Array(types.boolean, 1, "C"), VECTOR, COUNTS))
def first_breaking(equation, parameters, y, still, state, held, phi, found):
    """A contact that sticks and whose force has left the cone, but for those that were just held; -1 if none does.

    One that has no normal force left and a tangential one has left it before.
    """
    asked = False
    for k in range(len(state)):
        asked = asked or (state[k] == STICK and not held[k])
    if not asked:
        return -1
    nothing = np.empty((0, 3, 3))
    equation(parameters, y, still, phi, nothing, nothing, found, False)
    for k in range(len(state)):
        if state[k] == STICK and not held[k]:
            if found[k] == SLIP:
                return k
            if found[k] == OPEN and np.sqrt(y[3 * k + 1] ** 2 + y[3 * k + 2] ** 2) > ROUNDING * np.abs(y).max():
                return k
    return -1


@kernel(
    NUMBER(
        EQUATION_POINTER,
        MATRIX,
        MATRIX,
        VECTOR,
        VECTOR,
        VECTOR,
        VECTOR,
        NUMBER,
        NUMBER,
        NUMBER,
        NUMBER,
        VECTOR,
        COUNTS,
        MATRIX,
        VECTOR,
        VECTOR,
        VECTOR,
        VECTOR,
        VECTOR,
        MATRIX,
        COUNTS,
    )
)
def predict(
    equation,
    W,
    parameters,
    unit,
    y0,
    w0,
    rate,
    step,
    behind,
    allowed,
    slack,
    pace,
    state0,
    e0,
    grip,
    loose,
    x,
    motion,
    opened,
    gone,
    counts,
):
    """Where a step leads with statuses held, but that contacts open on the way.

    A slider's direction comes to rest within a slip of its compliance, much less than that of a step where sheets
    slide on each other as rigid bodies do: held, the directions of several would not let them.  So a slider of
    which it is known how far it may go is linearised there, at the end of its slip, as the shifts have it.

    Parameters
    ----------
    y0, w0 : (3m,) array
        The step's start, ``w_t = 0``.
    rate : (3m,) array
        Change of ``q`` over the whole path.
    unit : (3m,) array
        Length of a unit of ``w``; a unit of ``y`` is its reciprocal.
    step, behind : float
        Length of the step, in shares of the path; and how far it goes behind the first contact that closes.
    allowed : float
        Error of the step, a length: motion below it does not count.  A contact that slid farther ends the step
        where it opens, too.
    slack : float
        As :func:`forward` has it.
    pace : (m,) array
        Slip that is expected of sliders, over the whole path; 0 if nothing is.
    state0, e0 : (m,), (m, 2) array
        Receive the statuses of the start, and the directions of sliders.
    grip, loose : (m,) array
        Receive ‖y_t‖ of sliders when they begin to slide, and the share of the step after which they do: 0 for
        those that slide at its start, 1 for those that do not slide.
    x, motion : (3m,) array
        Receive the changes of forces and displacements.
    opened, gone : (m,), (m, 2) array
        Receive the share of the step after which a contact opens, 1 if it does not, and its tangential motion
        until then.

    Returns
    -------
    float
        Length of the step, shorter where a contact closes.
    """
    m = len(parameters)
    phi, A, B = np.zeros(3 * m), np.zeros((m, 3, 3)), np.zeros((m, 3, 3))
    y, w, found = y0.copy(), w0.copy(), np.zeros(m, np.int64)
    dy, dw = np.empty(3 * m), np.empty(3 * m)
    forward(y, w, slack)
    opened[:] = 1.0
    gone[:] = 0.0
    derivative(equation, parameters, y, w, phi, A, B, state0)
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
    derivative(equation, parameters, y, w, phi, A, B, found)
    assign(w, w0)
    x[:] = 0.0
    motion[:] = 0.0
    for k in range(m):
        loose[k] = 0.0 if state0[k] == SLIP else 1.0
        grip[k] = np.sqrt(y[3 * k + 1] ** 2 + y[3 * k + 2] ** 2)
    state, held = state0.copy(), np.zeros(m, np.bool_)
    trial, still = np.empty(3 * m), np.zeros(3 * m)
    new_A, new_B, nothing = np.zeros((m, 3, 3)), np.zeros((m, 3, 3)), np.empty((0, 3, 3))
    A0, B0, turned = A.copy(), B.copy(), np.zeros(m, np.int64)
    closed = np.flatnonzero(state != OPEN)
    large = 3 * len(closed) > LARGE  # where changes of the inverse are dear
    inverse = inverse_of(W, A, B, closed)
    counts[FACTORISATIONS] += 1
    reached = 0.0
    for event in range(EVENTS):
        for _ in range(PASSES):
            rates(W, B, closed, inverse, rate, dy, dw)
            # On the cone a contact slides forward or its force does not leave the cone, never both: of those that
            # do neither, the worst changes. One may do neither whichever it is, as others turn it: of many
            # it is left.
            hardest, worst = 0.0, -1
            for a in range(len(closed)):
                k = closed[a]
                i = 3 * k
                if grip[k] <= ROUNDING * y0[i] or (large and turned[k] >= INDIFFERENT):  # no friction: no direction
                    continue
                if state[k] == SLIP:
                    wrong = dw[i + 1] * e0[k, 0] + dw[i + 2] * e0[k, 1]
                elif held[k]:
                    wrong = 0.0
                    for c in range(3):
                        wrong += (e0[k, 0] * A0[k, 1, c] + e0[k, 1] * A0[k, 2, c]) * dy[i + c]
                else:
                    continue
                if wrong > hardest:
                    hardest, worst = wrong, a
            if worst < 0:
                break
            k = closed[worst]
            turned[k] += 1
            if held[k]:
                state[k], held[k] = SLIP, False
                change(W, A, B, closed, inverse, worst, A0[k], B0[k])
            else:
                state[k], held[k] = STICK, True
                change(W, A, B, closed, inverse, worst, np.zeros((3, 3)), np.eye(3))
        if event == 0:
            for k in range(m):
                state0[k] = state[k]
        advance, first = step - reached, -1
        closes = False
        assign_sum(trial, motion, step - reached, dw)
        if step > LONGEST and reached < LONGEST and motion_size(trial, unit) > allowed:
            step = LONGEST
            advance = step - reached
        for k in range(m):
            i = 3 * k
            if state0[k] == OPEN:
                if dw[i] < 0.0:
                    touches = max(w[i], 0.0) / -dw[i]
                    # What touches as the step begins has made no way before: it need not be cut for.
                    if behind - reached < touches < advance:
                        advance, first, closes = touches, k, True
            elif state[k] != OPEN and dy[i] < 0.0 and max(y[i], 0.0) < -dy[i] * advance:
                advance, first, closes = max(y[i], 0.0) / -dy[i], k, False
        breaks = -1
        assign_sum(trial, y, advance, dy)
        if first_breaking(equation, parameters, trial, still, state, held, phi, found) >= 0:
            low, high = 0.0, advance
            for _ in range(BISECTIONS):
                middle = 0.5 * (low + high)
                assign_sum(trial, y, middle, dy)
                if first_breaking(equation, parameters, trial, still, state, held, phi, found) >= 0:
                    high = middle
                else:
                    low = middle
            assign_sum(trial, y, high, dy)
            breaks = first_breaking(equation, parameters, trial, still, state, held, phi, found)
            advance, first, closes = high, breaks, False
            i = 3 * breaks
            if y[i] + high * dy[i] <= NEAR * y0[i]:  # it comes to the tip of its cone: it opens, and does not slide
                breaks = -1
        if closes:
            harmless = HARMLESS * allowed / max(motion_size(dw, unit), 1e-300)
            advance = min(advance + max(behind, harmless), step - reached)
        assign_sum(y, y, advance, dy)
        assign_sum(w, w, advance, dw)
        assign_sum(x, x, advance, dy)
        assign_sum(motion, motion, advance, dw)
        reached += advance
        assign(trial, y)
        for k in range(m):
            trial[3 * k + 1] *= 1.0 + NEAR
            trial[3 * k + 2] *= 1.0 + NEAR
        equation(parameters, trial, still, phi, nothing, nothing, found, False)
        for k in range(m):
            held[k] = held[k] and found[k] != STICK
        if closes or first < 0 or event == EVENTS - 1:
            break
        i = 3 * first
        if breaks >= 0:
            for k in range(m):
                for c in range(1, 3):
                    trial[3 * k + c] = -NEAR * y[3 * k + c]  # a little forward, as above
            derivative(equation, parameters, y, trial, phi, new_A, new_B, found)
            state[first], loose[first] = SLIP, reached
            grip[first] = np.sqrt(y[i + 1] ** 2 + y[i + 2] ** 2)
            e0[first, 0], e0[first, 1] = y[i + 1] / grip[first], y[i + 2] / grip[first]
            for row in range(3):
                assign(A0[first, row], new_A[first, row])
                assign(B0[first, row], new_B[first, row])
            for a in range(len(closed)):
                if closed[a] == first:
                    change(W, A, B, closed, inverse, a, A0[first], B0[first])
            continue
        opened[first] = reached
        gone[first, 0], gone[first, 1] = motion[i + 1], motion[i + 2]
        for row in range(3):
            x[i + row] = -y0[i + row]
            y[i + row] = 0.0
        state[first] = OPEN
        # Where it was counts, if it slid so far that the time of its opening does.
        if unit[i + 1] * np.sqrt(gone[first, 0] ** 2 + gone[first, 1] ** 2) > allowed * np.sqrt(m):
            step = min(step, reached + behind)
        for a in range(len(closed)):
            if closed[a] == first:
                let_go(inverse, a)
    if reached < step:
        step = max(reached, min(behind, step))
    for k in range(m):
        if opened[k] < 1.0:
            opened[k] /= step
        if loose[k] < 1.0:
            loose[k] /= step
    return step
