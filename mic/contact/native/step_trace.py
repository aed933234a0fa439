"""What happens to contacts in a step: when they open, and their slip, work and states."""

from __future__ import annotations

import numpy as np
from numba import int64, types, void

from mic.contact.native.kernel import NUMBER, kernel
from mic.contact.native.path_constants import ROUNDING
from mic.contact.native.slip_origins import crossing
from mic.contact.native.step_data import PREDICTION, RECORD, WORKSPACE
from mic.contact.states import OPEN, SLIP, STICK

__all__ = ["opening_motion", "record_step"]


@kernel(types.UniTuple(NUMBER, 2)(int64, PREDICTION, WORKSPACE))
def opening_motion(k, predicted, work):
    """After which share of a step contact k opens, and how much that is to be doubted, 0 to 1.

    The prediction's share, doubted by as much as the gap at the end is not the prediction's.
    """
    i, w = 3 * k, work.w
    if predicted.opened[k] == 1.0:  # the prediction did not see it
        return crossing(work.y0[i], -max(w[i], 1e-300)), 1.0
    return predicted.opened[k], min(abs(w[i] - predicted.motion[i]) / max(w[i], predicted.motion[i], 1e-300), 1.0)


@kernel(void(PREDICTION, WORKSPACE, NUMBER, RECORD))
def record_step(predicted, work, part, record):
    """Add a step, a ``part`` of the path, to a record: slip under load, its length, friction's work, shares.

    Forces of a contact that slides grow linearly over the step, so that the work is the trapezoid ``-½ (y⁰ + y)·slip``;
    one that breaks loose unforeseen slides under the force of the end.  A contact closes or opens where the prediction
    has it: it opens after a share of the step, having gone so far.  By as much as the end is not the prediction's
    the way without load is not, but a like share of the whole.
    """
    state0, e0, grip, loose, _, _, _, gone = predicted
    y0, y, w, state, shift = work.y0, work.y, work.w, work.state, work.other
    slip, length, share = record.slip, record.length, record.share
    for k in range(len(state)):
        i = 3 * k
        m1, m2 = w[i + 1], w[i + 2]
        begin, end = work.late[k], 1.0  # of the step, under load
        if state0[k] == OPEN:
            if state[k] == OPEN:
                share[k, 0] += part
                continue
            m1, m2 = m1 - shift[k, 0], m2 - shift[k, 1]
        elif state[k] == OPEN:
            end, doubt = opening_motion(k, predicted, work)
            m1 = (1.0 - doubt) * gone[k, 0] + doubt * end * m1
            m2 = (1.0 - doubt) * gone[k, 1] + doubt * end * m2
        slides = 1.0  # share of the time under load in which the contact slides
        if state0[k] == STICK:
            if loose[k] == 0.0:  # held on its cone
                slides = 1.0 if state[k] == SLIP else 0.0
            elif loose[k] < 1.0:
                slides = max(end - loose[k], 0.0) / max(end, 1e-300)
            elif state[k] == SLIP:
                # Its own compliance, 1, as if it were all: first the force grows, then the contact moves.
                t0 = np.sqrt(y0[i + 1] ** 2 + y0[i + 2] ** 2)
                t1 = np.sqrt(y[i + 1] ** 2 + y[i + 2] ** 2)
                moved = np.sqrt(m1 * m1 + m2 * m2)
                slides = moved / max(moved + abs(t1 - t0), 1e-300)
            else:
                slides = 0.0
        if state[k] == STICK:
            slides = 0.5 * slides if state0[k] != OPEN else 0.0
        if slides == 0.0:
            m1 = m2 = 0.0
        share[k, 0] += part * (1.0 - (end - begin))
        share[k, 1] += part * (end - begin) * (1.0 - slides)
        share[k, 2] += part * (end - begin) * slides
        slip[k, 0] += m1
        slip[k, 1] += m2
        length[k] += np.sqrt(m1 * m1 + m2 * m2)
        f1, f2 = 0.5 * y[i + 1], 0.5 * y[i + 2]
        if loose[k] < 1.0:
            f1, f2 = f1 + 0.5 * grip[k] * e0[k, 0], f2 + 0.5 * grip[k] * e0[k, 1]
        elif state0[k] == STICK:
            f1, f2 = 2.0 * f1, 2.0 * f2
        if np.sqrt(f1 * f1 + f2 * f2) > ROUNDING * max(y0[i], y[i]):
            record.work[k] -= f1 * m1 + f2 * m2
