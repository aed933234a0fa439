"""Estimated errors of a step: of the positions of contacts, and of their forces."""

from __future__ import annotations

import numpy as np
from numba import void

from mic.contact.native.kept_factors import force_rates
from mic.contact.native.kernel import BLOCKS, COUNTS, MATRIX, NUMBER, VECTOR, kernel
from mic.contact.native.matrices import displace
from mic.contact.native.path_constants import ROUNDING
from mic.contact.native.slider_lag import lag
from mic.contact.native.step_data import LAST_PROBLEM, PREDICTION, WORKSPACE
from mic.contact.native.step_trace import opening_motion
from mic.contact.states import OPEN, SLIP, STICK

__all__ = ["force_error", "mean_force", "motion_size", "opening_doubt", "over_allowed", "position_error", "rates"]


@kernel(NUMBER(VECTOR, VECTOR))
def motion_size(w, unit):
    """Root mean square over the contacts of a tangential motion, a length."""
    total = 0.0
    for i in range(0, len(unit), 3):
        total += (w[i + 1] ** 2 + w[i + 2] ** 2) * unit[i + 1] ** 2
    return np.sqrt(3.0 * total / max(len(unit), 1))


@kernel(NUMBER(VECTOR, VECTOR))
def mean_force(y, unit):
    """Root mean square over the contacts of forces, N."""
    total = 0.0
    for i in range(len(unit)):
        total += (y[i] / unit[i]) ** 2
    return np.sqrt(3.0 * total / max(len(unit), 1))


@kernel(NUMBER(NUMBER, NUMBER, NUMBER, NUMBER))
def over_allowed(error, allowed, force, bearing):
    """How many times too large errors of a step are, in positions and forces."""
    return max(error / max(allowed, 1e-300), force / max(bearing, 1e-300))


@kernel(NUMBER(PREDICTION, WORKSPACE, VECTOR))
def opening_doubt(predicted, work, unit):
    """Root mean square over the contacts of the way on which it is in doubt whether one that opens was still loaded, a
    length: its position is right, its slip under load may not be."""
    opened, gone, w, state, total = predicted.opened, predicted.gone, work.w, work.state, 0.0
    for k in range(len(state)):
        if predicted.state[k] == OPEN or state[k] != OPEN:
            continue
        i = 3 * k
        end, doubt = opening_motion(k, predicted, work)
        way = (1.0 - end) * np.sqrt(w[i + 1] ** 2 + w[i + 2] ** 2)
        if opened[k] < 1.0:
            way += np.sqrt((gone[k, 0] - end * w[i + 1]) ** 2 + (gone[k, 1] - end * w[i + 2]) ** 2)
        total += (doubt * way * unit[i + 1]) ** 2
    return np.sqrt(total / max(len(state), 1))


@kernel(NUMBER(PREDICTION, WORKSPACE, MATRIX, VECTOR))
def position_error(predicted, work, shift, unit):
    """Root mean square over the contacts of what a step may be wrong by in their tangential positions, a length.

    Per contact, how far the solution's shifts ``work.other`` are from those that were taken, ``shift``; for a slider
    that turns by Δφ along its way l the difference of its chord and the mean of its two directions, ``l Δφ²/12``, and
    ``l Δφ/2`` by as much as its step is backward Euler's, which has the last direction all along, and where the
    prediction did not see that it would slide; and half the way of a slider that was predicted to go on and stops.
    ``work.doubt`` receives it as a displacement: a slider's across its way, because along it the slider bears what it
    bears wherever it is, to where it slid before.
    """
    state0, e0, grip, loose, _, motion, _, _ = predicted
    y0, y, w, state, other, doubt = work.y0, work.y, work.w, work.state, work.other, work.doubt
    total = 0.0
    for k in range(len(state)):
        i = 3 * k
        doubt[i], doubt[i + 1], doubt[i + 2] = 0.0, other[k, 0] - shift[k, 0], other[k, 1] - shift[k, 1]
        error, more, d1, d2 = np.sqrt(doubt[i + 1] ** 2 + doubt[i + 2] ** 2), 0.0, 0.0, 0.0
        t = np.sqrt(y[i + 1] ** 2 + y[i + 2] ** 2)
        if state0[k] != OPEN and state[k] == SLIP and t > ROUNDING * y[i]:  # without friction it has no direction
            moved = np.sqrt(w[i + 1] ** 2 + w[i + 2] ** 2)
            e1, e2, before1, before2 = y[i + 1] / t, y[i + 2] / t, e0[k, 0], e0[k, 1]
            part = 1.0
            if loose[k] < 1.0:
                part -= 2.0 * lag(moved / max(min(t, grip[k]), 1e-300))
            else:
                t0 = max(np.sqrt(y0[i + 1] ** 2 + y0[i + 2] ** 2), 1e-300)
                before1, before2 = y0[i + 1] / t0, y0[i + 2] / t0
            turn = np.sqrt((before1 - e1) ** 2 + (before2 - e2) ** 2)
            more = 0.5 * part * moved * turn
            if loose[k] < 1.0:
                more += moved * turn**2 / 12.0
            side = 1.0 if before1 * e2 >= before2 * e1 else -1.0
            d1, d2 = -side * e2, side * e1
        elif loose[k] < 1.0 and state[k] == STICK:  # it stops on the way
            more = 0.5 * np.sqrt(motion[i + 1] ** 2 + motion[i + 2] ** 2)
            d1, d2 = -0.5 * motion[i + 1] / max(more, 1e-300), -0.5 * motion[i + 2] / max(more, 1e-300)
        if doubt[i + 1] * d1 + doubt[i + 2] * d2 < -0.1 * more:  # errors add up
            d1, d2 = -d1, -d2
        doubt[i + 1] += more * d1
        doubt[i + 2] += more * d2
        total += ((error + more) * unit[i + 1]) ** 2
    return np.sqrt(total / max(len(state), 1))


@kernel(void(MATRIX, BLOCKS, COUNTS, MATRIX, VECTOR, VECTOR, VECTOR))
def rates(W, B, closed, inverse, rate, dy, dw):
    """``A_k dy_k + B_k dw_k = 0`` with ``dw = W dy + rate``, and ``dy = 0`` where contacts are open."""
    n = 3 * len(closed)
    right = np.empty(n)
    for a in range(len(closed)):
        k = closed[a]
        for row in range(3):
            total = 0.0
            for column in range(3):
                total -= B[k, row, column] * rate[3 * k + column]
            right[3 * a + row] = total
    solution = np.dot(inverse, right)
    dy[:] = 0.0
    for a in range(len(closed)):
        for row in range(3):
            dy[3 * closed[a] + row] = solution[3 * a + row]
    displace(W, dy, rate, dw)


@kernel(NUMBER(MATRIX, LAST_PROBLEM, VECTOR, VECTOR))
def force_error(W, last, doubt, unit):
    """Root mean square over the contacts of the forces that answer a displacement ``doubt``, statuses held, N.

    Where the linear problem that was solved last is not to be had, each contact answers by its own compliance.
    """
    dy, dw = doubt.copy(), np.empty_like(doubt)
    if len(last.factors.lu) > 0:
        force_rates(W, last.factors, doubt, dy)
    elif len(last.own) > 0:
        rates(W, last.B, last.own, last.inverse, doubt, dy, dw)
    return mean_force(dy, unit)
