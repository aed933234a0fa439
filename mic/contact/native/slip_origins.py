"""The points from which a step of second order measures slip: those of sliders lag, and closing contacts touch late."""

from __future__ import annotations

import numpy as np
from numba import boolean, void

from mic.contact.native.kept_factors import unit_solutions
from mic.contact.native.kept_inverse import inverted
from mic.contact.native.kernel import MATRIX, NUMBER, kernel
from mic.contact.native.matrices import assign, assign_sum
from mic.contact.native.slider_lag import lag
from mic.contact.native.step_data import LAST_PROBLEM, PREDICTION, WORKSPACE
from mic.contact.states import OPEN, SLIP

__all__ = ["closings", "crossing", "origins"]

#: Contacts that close in a step are looked at one by one, but those after so many.
ONE_BY_ONE = 8
#: Of many closed contacts so many may close in a step, or the others do not answer.
TOGETHER = 32


@kernel(NUMBER(NUMBER, NUMBER))
def crossing(start, end):
    """Where a line from ``start >= 0`` to ``end < 0`` crosses zero."""
    start = max(start, 0.0)
    return start / (start - end)


@kernel(void(PREDICTION, WORKSPACE, boolean))
def origins(predicted, work, solved):
    """Fill where each contact's slip is measured from in a step, and the share of it after which an open one touches.

    The predicted end gives ``work.shift``, the solution, if the step is ``solved``, ``work.other``; ``w_t`` is measured
    from the anchors.  ``work.late`` becomes 0 for contacts that were closed and 1 for those that stay open.  For those
    that close in a solution, ``closings`` fills both.
    """
    w0, touched, shift = work.w0, work.late, work.other if solved else work.shift
    y, w, state = (work.y, work.w, work.state) if solved else (work.yp, work.wp, predicted.state)
    for k in range(len(state)):
        i = 3 * k
        shift[k, 0] = shift[k, 1] = touched[k] = 0.0
        if predicted.state[k] == OPEN:
            touched[k] = 1.0
            if w[i] < 0.0 and not solved:
                c = crossing(w0[i], w[i])
                touched[k] = c
                shift[k, 0], shift[k, 1] = c * w[i + 1], c * w[i + 2]
        elif predicted.loose[k] < 1.0 and (not solved or state[k] == SLIP):
            d1, d2 = predicted.e[k, 0], predicted.e[k, 1]
            if solved:
                length = np.sqrt(w[i + 1] ** 2 + w[i + 2] ** 2)
            else:
                length = max(-(d1 * w[i + 1] + d2 * w[i + 2]), 0.0)
            bound = min(predicted.grip[k], np.sqrt(y[i + 1] ** 2 + y[i + 2] ** 2))
            back = lag(length / max(bound, 1e-300)) * length
            shift[k, 0], shift[k, 1] = -back * d1, -back * d2


@kernel(void(MATRIX, LAST_PROBLEM, PREDICTION, WORKSPACE))
def closings(W, last, predicted, work):
    """Fill where contacts that close in a step were then (work.other), and after which share of it (work.late).

    One after the other: until the first closes all go where the end would be without the forces of any of them, to
    which the others' answer, then where it would be with the first one's, and so on.  The last
    problem tells the answers, statuses held; where it is not to be had, they give none.
    """
    own, inverse, w0, y, w, state = last.own, last.inverse, work.w0, work.y, work.w, work.state
    shift, touched = work.other, work.late
    new = np.flatnonzero((predicted.state == OPEN) & (state != OPEN))
    count, passed = len(new), 0.0
    place, at, free = np.full(len(state), -1), np.empty((count, 3)), np.empty((count, 3))
    for a in range(len(own)):
        place[own[a]] = a
    for a in range(count):
        for c in range(3):
            at[a, c] = w0[3 * new[a] + c]
    late = np.ones(count, np.bool_)  # those that have not closed yet
    many = len(last.factors.lu) > 0
    found = unit_solutions(W, last.factors, new if many and count <= TOGETHER else new[:0])
    known = len(found) > 0
    for a in range(count):
        known = known and place[new[a]] >= 0
    for turn in range(count):
        left = np.flatnonzero(late)
        if turn < ONE_BY_ONE:
            n, change, right = 3 * len(left), np.zeros(len(y)), np.zeros(len(inverse))
            column = np.empty(n, np.int64)
            forces, rows, inner = np.empty(n), np.empty(n, np.int64), np.empty((n, n))
            for a in range(n):
                k = new[left[a // 3]]
                change[3 * k + a % 3] = -y[3 * k + a % 3]
                forces[a] = change[3 * k + a % 3]
                rows[a], column[a] = 3 * place[k] + a % 3, 3 * left[a // 3] + a % 3
            if known:
                for a in range(n):
                    for b in range(n):
                        inner[a, b] = found[column[b], 3 * new[left[a // 3]] + a % 3]
                share = np.dot(inverted(inner), forces)
                change[:] = 0.0
                for b in range(n):
                    assign_sum(change, change, share[b], found[column[b]])
            elif not many and rows.min() >= 0:
                for a in range(n):
                    for b in range(n):
                        inner[a, b] = inverse[rows[a], rows[b]]
                inner = inverted(inner)
                for a in range(n):
                    for b in range(n):
                        right[rows[a]] += inner[a, b] * forces[b]
                answer = np.dot(inverse, right)
                for a in range(len(own)):
                    for c in range(3):
                        change[3 * own[a] + c] = answer[3 * a + c]
            for a in left:
                for c in range(3):
                    i = 3 * new[a] + c
                    free[a, c] = w[i]
                    for j in range(len(y)):
                        free[a, c] += W[i, j] * change[j]
        first, soonest = -1, 1.0
        for a in left:
            if free[a, 0] < 0.0:
                c = crossing(at[a, 0], free[a, 0])
                if c < soonest:
                    first, soonest = a, c
        if first < 0:  # at the very end
            for a in left:
                touched[new[a]] = 1.0
                assign(shift[new[a]], free[a, 1:])
            return
        for a in left:
            for c in range(3):
                at[a, c] += soonest * (free[a, c] - at[a, c])
        passed += soonest * (1.0 - passed)
        touched[new[first]] = passed
        assign(shift[new[first]], at[first, 1:])
        late[first] = False
