r"""Path following of second order: one load after another, in scaled variables, compiled.

Between two loads ``q(s) = q⁰ + s (q¹ - q⁰)``, and with ``w = W y + q`` measured tangentially from the anchors a law
asks, where a contact is closed,

.. math::  \dot w_n = 0, \qquad \dot w_t = -\lambda e, \; \lambda \ge 0, \quad e = y_t / \|y_t\|,

with ``λ > 0`` only where the force is on the cone.  A step goes like this.

1. **Prediction.**  Statuses held, the rates are one linear problem, the law's own derivative at the step's start, of
   sliders where the slip of the step before would take them.  On the cone a contact slides forward or its force does
   not leave the cone: which of them is found by pivots.  Contacts that open or break loose on the way change a few rows
   of that problem, its inverse by rank 3.  The step ends just behind the first contact that closes.  Of what
   touches without pressing nothing is known where a path starts, and of nothing where nothing presses: there the
   first step is a short one.
2. **Solution.**  Backward Euler's method measures slip from where the step began, which drags a slider straight towards
   its end, and a contact that closes from too far back.  Both are mended, to second order, by moving the point from
   which slip is measured, and the same problem as ever is solved:

   - a slider that slips by ``l`` and starts along ``e⁰``: by ``-(1 - θ) l e⁰`` with ``1 - θ = 1/z - 1/(eᶻ - 1)``, ``z =
     l/‖y_t‖``.  A contact of compliance 1 that is drawn along a straight line forgets its old direction as ``e⁻ᶻ``
     (the tractrix), so that θ goes from ½, the trapezoidal rule, to 1, backward Euler;
   - a contact that closes at the fraction ``c`` of the step: by the tangential motion that it made until then.

   ``l``, ``c`` and that motion are the prediction's.
3. **Error.**  Those of the solution give other shifts; contacts that close in it do so one after the other, each on
   the way that the forces of those before it leave.  How far they differ, root mean square over the contacts, estimates
   the step's error; it may be a share of the motion so far, not of the path, most of which may pass without any.  A
   contact that opens while it slides adds what it moves in the time by which its opening is in doubt.  The forces that
   answer, statuses held, estimate the error of the forces: what sticks is stiff, and a position that is right to
   1e-5 mm may be a tenth of its friction.  Too large, the
   step is solved once more with the better shifts, then cut; what they would not mend cuts it at once.
"""

from __future__ import annotations

import numpy as np
from numba import boolean, int64, types, void

from mic.contact.native.gauss_seidel import gauss_seidel
from mic.contact.native.kernel import BLOCKS, COUNTS, MATRIX, NUMBER, VECTOR, kernel
from mic.contact.native.law_equation import EQUATION_POINTER, derivative, force_scale, starting_scale
from mic.contact.native.matrices import block, system, times
from mic.contact.native.newton import Coupling, NewtonSettings, newton
from mic.contact.states import OPEN, SLIP, STICK

__all__ = ["follow", "follow_among"]

# Of a step of the whole path: the longest, because the estimate sees two directions of a slider and not what it does in
# between, unless all of its motion is less than may be in error; and the shortest. Contacts may make most of their
# motion within a hundredth of the path and less.
LONGEST, SHORTEST = 0.5, 1e-6
#: Steps before a path is given up: one that is refined to rounding takes half as many.
MOST = 10000
#: Behind a closing a step goes on for this share of its length and of the path, or for this share of the motion that
#: may be in error: what closes meanwhile does so together.
BEHIND, TOGETHER, HARMLESS = 0.25, 1e-2, 0.5
#: Newton's tolerance within a path; at its end it is the solver's.  It is relative to what overlap alone would be
#: answered with, which is a thousand times the motion where parts hang together loosely: looser, paths part.
INNER = 1e-12
#: A contact this near its cone (relative) at the start of a step may slide, or by so many of Newton's tolerances.
NEAR, LEFT = 1e-7, 10.0
#: Shrinking the step aims below the tolerance by this factor, the usual one of step control; and how much it may grow.
SAFETY, GROWTH = 0.8, 4.0
#: A step in which contacts begin to press of which nothing is known is so long at most: the prediction leaves them out.
FIRST = 1e-2
#: Of the largest force: a tangential force that is less is none, nor, at the start of an increment, a normal one.
ROUNDING = 1e-12
#: Of the compliance's diagonal, so that a singular one does no harm.
DAMPING = 1e-12
#: Rows of a matrix that LAPACK inverts.
LARGE = 450
#: Contacts that open or break loose within one prediction before it is cut short, and changes of sliders after each.
EVENTS, PASSES = 32, 32
#: Changes of one slider within a large prediction: where others hold its direction it may neither slide nor be held.
INDIFFERENT = 4
#: Of the share of a step after which a contact breaks loose.
BISECTIONS = 40
#: Sweeps before Newton's method, its steps, the inverses that it may make, and changes of statuses within a step, of
#: all contacts and of one: more, and they go round in a circle.
SWEEPS, STEPS_OF_NEWTON, NEWTON, PIVOTS, TURNS = 10, 40, 10, 100, 10
#: A step with the inverse of one before, a tenth of the cost of a new one, must bring the error down by this, and of
#: the contacts this share may have changed their status.
CHORD, CHANGES = 0.3, 0.3
#: In a slider's equation its displacement counts so many times that it is this share of its force: its direction is
#: then that of its motion as well as that of its force, which others hold; and so many times at most.
EVEN, STRETCH = 0.3, 1e4
#: Contacts that close in a step are looked at one by one, but those after so many.
ONE_BY_ONE = 8
#: Sweeps where a forecast of the forces is what they begin with: they do what thirty do from the forces before.
FORECAST = 10
#: Calls for help before a problem is given up, where no shorter step is to be had, and Newton's steps in each.
HELP, PATIENCE = 6, 40

STEPS, FACTORISATIONS, RESCUES, FAILED, CUT = range(5)  #: columns of the counts

#: Of the linear problem that was solved last: statuses, stretch, A, B, contacts, inverse; and what a solution returns.
LAST_PROBLEM = COUNTS, VECTOR, BLOCKS, BLOCKS, COUNTS, MATRIX
SOLVED = types.Tuple((int64, COUNTS, MATRIX))


@kernel(NUMBER(NUMBER))
def _lag(z):
    """``1 - θ = 1/z - 1/(eᶻ - 1)``: how far behind the end of its slip a slider's reference is, in shares of it."""
    if z < 1e-3:
        return 0.5 - z / 12.0
    if z > 300.0:
        return 1.0 / z
    return 1.0 / z - 1.0 / np.expm1(z)


@kernel(NUMBER(NUMBER, NUMBER))
def _crossing(start, end):
    """Where a line from ``start >= 0`` to ``end < 0`` crosses zero."""
    start = max(start, 0.0)
    return start / (start - end)


@kernel(void(VECTOR, COUNTS, MATRIX, VECTOR, VECTOR, VECTOR, VECTOR, COUNTS, boolean, MATRIX, VECTOR))
def _shifts(w0, state0, e0, grip, loose, y, w, state, solved, shift, touched):
    """Where each contact's slip is measured from in a step, and the share of it after which an open contact touches.

    Parameters
    ----------
    w0, state0
        The step's start: displacements, states.
    e0, grip, loose
        Of sliders, as predicted: directions and ‖y_t‖ when they began to slide, and after which share of the step.
    y, w, state
        The step's end, as predicted or, where it is ``solved``, as the law has it; ``w_t`` from the anchors.
    shift : (m, 2) array
    touched : (m,) array
        Both are filled; ``touched`` is 0 for contacts that were closed and 1 for those that stay open.  Of those that
        close in a solution ``closings`` tells them.
    """
    for k in range(len(state0)):
        i = 3 * k
        shift[k, 0] = shift[k, 1] = touched[k] = 0.0
        if state0[k] == OPEN:
            touched[k] = 1.0
            if w[i] < 0.0 and not solved:
                c = _crossing(w0[i], w[i])
                touched[k] = c
                shift[k, 0], shift[k, 1] = c * w[i + 1], c * w[i + 2]
        elif loose[k] < 1.0 and (not solved or state[k] == SLIP):
            d1, d2 = e0[k, 0], e0[k, 1]
            if solved:
                length = np.sqrt(w[i + 1] ** 2 + w[i + 2] ** 2)
            else:
                length = max(-(d1 * w[i + 1] + d2 * w[i + 2]), 0.0)
            bound = min(grip[k], np.sqrt(y[i + 1] ** 2 + y[i + 2] ** 2))
            back = _lag(length / max(bound, 1e-300)) * length
            shift[k, 0], shift[k, 1] = -back * d1, -back * d2


@kernel(NUMBER(VECTOR, VECTOR))
def _motion(w, unit):
    """Root mean square over the contacts of a tangential motion, a length."""
    total = 0.0
    for i in range(0, len(unit), 3):
        total += (w[i + 1] ** 2 + w[i + 2] ** 2) * unit[i + 1] ** 2
    return np.sqrt(3.0 * total / max(len(unit), 1))


@kernel(NUMBER(VECTOR, VECTOR))
def _mean(y, unit):
    """Root mean square over the contacts of forces, N."""
    total = 0.0
    for i in range(len(unit)):
        total += (y[i] / unit[i]) ** 2
    return np.sqrt(3.0 * total / max(len(unit), 1))


@kernel(NUMBER(NUMBER, NUMBER, NUMBER, NUMBER))
def _excess(error, allowed, force, bearing):
    """How many times too large errors of a step are, in positions and forces."""
    return max(error / max(allowed, 1e-300), force / max(bearing, 1e-300))


@kernel(NUMBER(NUMBER))
def _rounded(factor):
    """The next smaller power of √2: rounding of an estimate does not change the length of the next step."""
    return 2.0 ** (0.5 * np.floor(2.0 * np.log2(factor)))


@kernel(void(VECTOR, VECTOR, NUMBER))
def _forward(y, w, slack):
    """Sliders go a little forward along their way, so that a contact on its cone is one, whatever its last bits.

    ``slack`` is how far Newton's tolerance may leave a force from its cone; one without friction has no way.
    """
    for i in range(0, len(y), 3):
        t = np.sqrt(y[i + 1] ** 2 + y[i + 2] ** 2)
        share = NEAR + slack / max(t, 1e-300)
        w[i + 1] -= share * y[i + 1] + 1e-12 * abs(y[i])
        w[i + 2] -= share * y[i + 2]


@kernel(boolean(VECTOR, VECTOR, VECTOR, NUMBER, boolean))
def _unforeseen(y, w, rate, slack, starts):
    """Whether contacts may press in the next step of which nothing is known: any, where none presses yet, and where a
    path starts those that touch without force."""
    presses = soon = at_once = False
    for i in range(0, len(y), 3):
        if y[i] > slack:
            presses = True
        else:
            soon = soon or w[i] + FIRST * rate[i] < -slack
            at_once = at_once or w[i] + SHORTEST * rate[i] < -slack
    return (soon and not presses) or (at_once and starts)


@kernel(types.UniTuple(NUMBER, 2)(VECTOR, VECTOR, VECTOR, int64, VECTOR))
def _opening(y0, w, motion, k, opened):
    """After which share of a step contact k opens, and how much that is to be doubted, 0 to 1.

    The prediction's share, doubted by as much as the gap at the end is not the prediction's.
    """
    i = 3 * k
    if opened[k] == 1.0:  # the prediction did not see it
        return _crossing(y0[i], -max(w[i], 1e-300)), 1.0
    return opened[k], min(abs(w[i] - motion[i]) / max(w[i], motion[i], 1e-300), 1.0)


@kernel(NUMBER(VECTOR, COUNTS, VECTOR, VECTOR, COUNTS, VECTOR, MATRIX, VECTOR))
def _unsure(y0, state0, motion, w, state, opened, gone, unit):
    """Root mean square over the contacts of the way on which it is in doubt whether one that opens was still loaded, a
    length: its position is right, its slip under load may not be."""
    total = 0.0
    for k in range(len(state)):
        if state0[k] == OPEN or state[k] != OPEN:
            continue
        i = 3 * k
        end, doubt = _opening(y0, w, motion, k, opened)
        way = (1.0 - end) * np.sqrt(w[i + 1] ** 2 + w[i + 2] ** 2)
        if opened[k] < 1.0:
            way += np.sqrt((gone[k, 0] - end * w[i + 1]) ** 2 + (gone[k, 1] - end * w[i + 2]) ** 2)
        total += (doubt * way * unit[i + 1]) ** 2
    return np.sqrt(total / max(len(state), 1))


@kernel(NUMBER(VECTOR, COUNTS, MATRIX, VECTOR, VECTOR, VECTOR, VECTOR, VECTOR, COUNTS, MATRIX, MATRIX, VECTOR, VECTOR))
def _error(y0, state0, e0, grip, loose, motion, y, w, state, shift, other, unit, doubt):
    """Root mean square over the contacts of what a step may be wrong by in their tangential positions, a length.

    Per contact, how far the shifts of the solution are from those that were taken; for a slider that turns by Δφ along
    its way l what its chord and the mean of its two directions differ by, ``l Δφ²/12``, and ``l Δφ/2`` by as much as
    its step is backward Euler's, which has the last direction all along, and where nobody foresaw that it would slide;
    and half the way of a slider that was foreseen to go on and stops.  ``doubt`` (3m,) receives it as a displacement:
    a slider's across its way, because along it the slider bears what it bears wherever it is, to where it slid before.
    """
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
                part -= 2.0 * _lag(moved / max(min(t, grip[k]), 1e-300))
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


@kernel(
    void(
        VECTOR,
        VECTOR,
        VECTOR,
        COUNTS,
        MATRIX,
        VECTOR,
        VECTOR,
        VECTOR,
        VECTOR,
        COUNTS,
        VECTOR,
        MATRIX,
        VECTOR,
        MATRIX,
        NUMBER,
        MATRIX,
        VECTOR,
        VECTOR,
        MATRIX,
    )
)
def _record(
    y0, w0, motion, state0, e0, grip, loose, y, w, state, touched, shift, opened, gone, part, slip, length, work, share
):
    """Add a step to what the contacts went through: slip under load, its length, friction's work, shares of the path.

    Forces of a contact that slides grow linearly over the step, so that the work is the trapezoid ``-½ (y⁰ + y)·slip``;
    one that breaks loose unforeseen slides under the force of the end.  A contact closes or opens where the prediction
    has it: it opens after the share ``opened``, having ``gone`` so far.  By as much as the end is not the prediction's
    the way without load is not, but a like share of the whole.
    """
    for k in range(len(state)):
        i = 3 * k
        m1, m2 = w[i + 1], w[i + 2]
        begin, end = touched[k], 1.0  # of the step, under load
        if state0[k] == OPEN:
            if state[k] == OPEN:
                share[k, 0] += part
                continue
            m1, m2 = m1 - shift[k, 0], m2 - shift[k, 1]
        elif state[k] == OPEN:
            end, doubt = _opening(y0, w, motion, k, opened)
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
            work[k] -= f1 * m1 + f2 * m2


@kernel(MATRIX(MATRIX))
def _inverted_by_lapack(matrix):
    """As :func:`_inverted`, of a large one."""
    try:
        return np.linalg.inv(matrix.T).T  # the inverse comes column by column
    except Exception:
        return np.zeros_like(matrix)


@kernel(void(MATRIX, MATRIX))
def _inverted_four(block, inverse):
    """Inverse of a (4, 4) block whose rows come in the order of its pivots."""
    inverse[:] = 0.0
    for a in range(4):
        scale = 1.0 / block[a, a]
        inverse[a, a] = 1.0
        for j in range(4):
            block[a, j] *= scale
            inverse[a, j] *= scale
        for b in range(4):
            factor = block[b, a]
            if b != a:
                for j in range(4):
                    block[b, j] -= factor * block[a, j]
                    inverse[b, j] -= factor * inverse[a, j]


@kernel(boolean(MATRIX, MATRIX, MATRIX, COUNTS, int64))
def _pivots(M, four, trial, place, k):
    """Rows k to k + 3 of M and of ``four``, its columns of the same numbers, become pivots; False if there are none.

    ``place`` receives where the rows were; ``trial`` is scratch.
    """
    trial[:] = four
    for c in range(4):
        p = k + c
        for i in range(k + c + 1, len(M)):
            if abs(trial[i, c]) > abs(trial[p, c]):
                p = i
        place[k + c] = p
        if trial[p, c] == 0.0:
            return False
        if p != k + c:
            for j in range(M.shape[1]):
                M[k + c, j], M[p, j] = M[p, j], M[k + c, j]
            for j in range(4):
                four[k + c, j], four[p, j] = four[p, j], four[k + c, j]
                trial[k + c, j], trial[p, j] = trial[p, j], trial[k + c, j]
        scale = 1.0 / trial[k + c, c]
        for i in range(k + c + 1, len(M)):
            factor = trial[i, c] * scale
            for j in range(c + 1, 4):
                trial[i, j] -= factor * trial[k + c, j]
    return True


@kernel(MATRIX(MATRIX))
def _inverted(matrix):
    """Inverse X by Gauss and Jordan's method with pivots, four columns at a time; zeros if it is singular.

    Four pivots pass over the other rows at once, two rows at a time: for the 60 to 300 rows of contacts that touch it
    takes two thirds of the time of LAPACK's, which has more than :data:`LARGE`.  On the transpose, because it leaves a
    small residual ``X M - I``, and ``M X - I`` is what a solution needs.
    """
    n = len(matrix)
    if n > LARGE:
        return _inverted_by_lapack(matrix)
    rows, width = (n + 3) // 4 * 4, (n + 7) // 8 * 8
    M, place = np.zeros((rows, width)), np.empty(rows, np.int64)
    four, trial, pivot = np.empty((rows, 4)), np.empty((rows, 4)), np.empty((4, width))
    block, inner = np.empty((4, 4)), np.empty((4, 4))
    for i in range(n):
        for j in range(n):
            M[j, i] = matrix[i, j]
    for i in range(n, rows):
        M[i, i] = 1.0
    for k in range(0, rows, 4):
        four[:] = M[:, k : k + 4]
        if not _pivots(M, four, trial, place, k):
            return np.zeros((n, n))
        block[:] = four[k : k + 4]
        _inverted_four(block, inner)
        row0, row1, row2, row3 = M[k], M[k + 1], M[k + 2], M[k + 3]
        for a in range(4):
            x0, x1, x2, x3 = inner[a, 0], inner[a, 1], inner[a, 2], inner[a, 3]
            line = pivot[a]
            for j in range(width):
                line[j] = x0 * row0[j] + x1 * row1[j] + x2 * row2[j] + x3 * row3[j]
            line[k : k + 4] = inner[a]
        row0, row1, row2, row3 = pivot[0], pivot[1], pivot[2], pivot[3]
        for i in range(0, rows, 2):
            if k <= i < k + 4:
                continue
            one, two = M[i], M[i + 1]
            one[k : k + 4], two[k : k + 4] = 0.0, 0.0
            f0, f1, f2, f3 = four[i, 0], four[i, 1], four[i, 2], four[i, 3]
            g0, g1, g2, g3 = four[i + 1, 0], four[i + 1, 1], four[i + 1, 2], four[i + 1, 3]
            for j in range(width):
                x0, x1, x2, x3 = row0[j], row1[j], row2[j], row3[j]
                one[j] -= f0 * x0 + f1 * x1 + f2 * x2 + f3 * x3
                two[j] -= g0 * x0 + g1 * x1 + g2 * x2 + g3 * x3
        M[k : k + 4] = pivot
    for k in range(rows - 1, -1, -1):
        p = place[k]
        if p != k:
            for i in range(n):
                M[i, k], M[i, p] = M[i, p], M[i, k]
    inverse = np.empty((n, n))
    for i in range(n):
        for j in range(n):
            inverse[i, j] = M[j, i]
    return inverse


@kernel(void(MATRIX, MATRIX, MATRIX, MATRIX))
def _lessen(inverse, left, M, X):
    """``inverse -= left M⁻¹ X`` of rank 3, nothing if M is singular; M and X are used up.

    M is eliminated, not inverted: the rows that change must be as exact as the others.
    """
    for k in range(3):
        p = k
        for i in range(k + 1, 3):
            if abs(M[i, k]) > abs(M[p, k]):
                p = i
        if M[p, k] == 0.0:
            return
        if p != k:
            for j in range(3):
                M[k, j], M[p, j] = M[p, j], M[k, j]
            for j in range(X.shape[1]):
                X[k, j], X[p, j] = X[p, j], X[k, j]
        for i in range(k + 1, 3):
            factor = M[i, k] / M[k, k]
            for j in range(k + 1, 3):
                M[i, j] -= factor * M[k, j]
            for j in range(X.shape[1]):
                X[i, j] -= factor * X[k, j]
    X0, X1, X2 = X[0], X[1], X[2]
    for j in range(X.shape[1]):
        X2[j] /= M[2, 2]
        X1[j] = (X1[j] - M[1, 2] * X2[j]) / M[1, 1]
        X0[j] = (X0[j] - M[0, 1] * X1[j] - M[0, 2] * X2[j]) / M[0, 0]
    for i in range(len(inverse)):
        l0, l1, l2 = left[i, 0], left[i, 1], left[i, 2]
        row = inverse[i]
        for j in range(len(row)):
            row[j] -= l0 * X0[j] + l1 * X1[j] + l2 * X2[j]


@kernel(void(MATRIX, BLOCKS, BLOCKS, COUNTS, MATRIX, int64, MATRIX, MATRIX))
def _change(W, A, B, closed, inverse, a, new_A, new_B):
    """The contact ``closed[a]`` begins or ceases to slide: its rows of the system change, the inverse by rank 3."""
    n, k = len(inverse), closed[a]
    V = np.zeros((3, n))
    for row in range(3):
        d0, d1, d2 = new_B[row, 0] - B[k, row, 0], new_B[row, 1] - B[k, row, 1], new_B[row, 2] - B[k, row, 2]
        W0, W1, W2 = W[3 * k], W[3 * k + 1], W[3 * k + 2]
        for b in range(len(closed)):
            for column in range(3):
                j = 3 * closed[b] + column
                V[row, 3 * b + column] = d0 * W0[j] + d1 * W1[j] + d2 * W2[j]
        for column in range(3):
            V[row, 3 * a + column] += (
                new_A[row, column] - A[k, row, column] + DAMPING * (new_B[row, column] - B[k, row, column])
            )
    A[k], B[k] = new_A, new_B
    X = np.zeros((3, n))  # V times the inverse
    X0, X1, X2 = X[0], X[1], X[2]
    for j in range(n):
        v0, v1, v2 = V[0, j], V[1, j], V[2, j]
        line = inverse[j]
        for i in range(n):
            X0[i] += v0 * line[i]
            X1[i] += v1 * line[i]
            X2[i] += v2 * line[i]
    left = inverse[:, 3 * a : 3 * a + 3].copy()
    _lessen(inverse, left, np.eye(3) + X[:, 3 * a : 3 * a + 3], X)


@kernel(types.Tuple((COUNTS, MATRIX))(MATRIX, BLOCKS, COUNTS, MATRIX, int64))
def _border(W, B, own, inverse, k):
    """The contact k joins the system `own`, open: its inverse with three rows and columns more."""
    c, n = len(own), len(inverse)
    column = np.empty((n, 3))
    for a in range(c):
        for row in range(3):
            for j in range(3):
                total = 0.0
                for i in range(3):
                    total += B[own[a], row, i] * W[3 * own[a] + i, 3 * k + j]
                column[3 * a + row, j] = total
    joined, grown = np.empty(c + 1, np.int64), np.zeros((n + 3, n + 3))
    joined[:c], joined[c] = own, k
    grown[:n, :n] = inverse
    grown[:n, n:] = -np.dot(inverse, column)
    for i in range(n, n + 3):
        grown[i, i] = 1.0
    return joined, grown


@kernel(void(MATRIX, int64))
def _let_go(inverse, a):
    """The contact ``closed[a]`` opens: its rows and columns leave the system, the inverse by rank 3."""
    i = 3 * a
    left, right = inverse[:, i : i + 3].copy(), inverse[i : i + 3].copy()
    _lessen(inverse, left, inverse[i : i + 3, i : i + 3].copy(), right)
    inverse[:, i : i + 3] = 0.0
    inverse[i : i + 3] = 0.0


@kernel(int64(EQUATION_POINTER, MATRIX, VECTOR, VECTOR, COUNTS, types.Array(types.boolean, 1, "C"), VECTOR, COUNTS))
def _breaking(equation, parameters, y, still, state, held, phi, found):
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


@kernel(void(EQUATION_POINTER, MATRIX, VECTOR, VECTOR, VECTOR, int64, MATRIX, MATRIX, VECTOR, VECTOR))
def _facet(equation, parameters, y, w, y_new, k, A, B, right, e):
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
    A[:], B[:] = blocks_A[0], blocks_B[0]
    for row in range(3):
        right[row] = -phi[row]
        for c in range(3):
            right[row] -= A[row, c] * (y[i + c] - at[c]) + B[row, c] * (w[i + c] - back[c])


@kernel(MATRIX(MATRIX, BLOCKS, BLOCKS, COUNTS))
def inverse_of(W, A, B, closed):
    """Inverse of ``A_k x_k + B_k (W x)_k`` over the contacts that are closed; zeros if it is singular."""
    return _inverted(system(W, A, B, closed, DAMPING))


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
    times(W, dy, dw)
    dw += rate


@kernel(NUMBER(MATRIX, BLOCKS, COUNTS, MATRIX, VECTOR, VECTOR))
def force_error(W, B, own, inverse, doubt, unit):
    """Root mean square over the contacts of the forces that answer a displacement ``doubt``, statuses held, N.

    Where the linear problem that was solved last is not to be had, each contact answers by its own compliance.
    """
    dy, dw = doubt.copy(), np.empty_like(doubt)
    if len(own) > 0:
        rates(W, B, own, inverse, doubt, dy, dw)
    return _mean(dy, unit)


@kernel(void(MATRIX, COUNTS, MATRIX, VECTOR, VECTOR, VECTOR, VECTOR, VECTOR))
def linear(W, own, inverse, right, y, q, y_new, w_new):
    """``y_new = y + J⁻¹ right`` over the contacts `own`, and ``w_new = W y_new + q``."""
    r = np.empty(3 * len(own))
    for a in range(len(own)):
        for c in range(3):
            r[3 * a + c] = right[3 * own[a] + c]
    x = np.dot(inverse, r)
    y_new[:] = y
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


@kernel(void(MATRIX, COUNTS, MATRIX, VECTOR, COUNTS, VECTOR, VECTOR, COUNTS, MATRIX, VECTOR))
def closings(W, own, inverse, w0, state0, y, w, state, shift, touched):
    """Where contacts that close in a step were when they did, and after which share of it: ``shift``, ``touched``.

    One after the other: until the first closes all go where the end would be without the forces of any of them, to
    which the others' answer, then where it would be with the first one's, and so on.  The inverse over the contacts
    `own` tells the answers, statuses held; where it is not to be had, they give none.
    """
    new = np.flatnonzero((state0 == OPEN) & (state != OPEN))
    count, passed = len(new), 0.0
    place, at, free = np.full(len(state), -1), np.empty((count, 3)), np.empty((count, 3))
    for a in range(len(own)):
        place[own[a]] = a
    for a in range(count):
        for c in range(3):
            at[a, c] = w0[3 * new[a] + c]
    late = np.ones(count, np.bool_)  # those that have not closed yet
    for turn in range(count):
        left = np.flatnonzero(late)
        if turn < ONE_BY_ONE:
            n, change, right = 3 * len(left), np.zeros(len(y)), np.zeros(len(inverse))
            forces, rows, inner = np.empty(n), np.empty(n, np.int64), np.empty((n, n))
            for a in range(n):
                k = new[left[a // 3]]
                change[3 * k + a % 3] = -y[3 * k + a % 3]
                forces[a] = change[3 * k + a % 3]
                rows[a] = 3 * place[k] + a % 3
            if rows.min() >= 0:
                for a in range(n):
                    for b in range(n):
                        inner[a, b] = inverse[rows[a], rows[b]]
                inner = _inverted(inner)
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
                c = _crossing(at[a, 0], free[a, 0])
                if c < soonest:
                    first, soonest = a, c
        if first < 0:  # at the very end
            for a in left:
                touched[new[a]] = 1.0
                shift[new[a]] = free[a, 1:]
            return
        for a in left:
            for c in range(3):
                at[a, c] += soonest * (free[a, c] - at[a, c])
        passed += soonest * (1.0 - passed)
        touched[new[first]] = passed
        shift[new[first]] = at[first, 1:]
        late[first] = False


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
    one, none, nothing = np.eye(3), np.zeros((3, 3)), np.empty((0, 3, 3))
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
            y[:] = y_old
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
                new_B[k, :, 1:] *= scaling[k]
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
                    own, inverse = _border(W, B, own, inverse, k)
                    A[k], B[k] = one, none
        else:
            if renewed == NEWTON and not solved:
                break
            own = np.flatnonzero(place >= 0)
            for a in range(len(own)):
                place[own[a]] = a
            A[:], B[:], kept[:], stretch[:] = new_A, new_B, state, scaling
            inverse = inverse_of(W, A, B, own)
            counts[FACTORISATIONS] += 1
            renewed += 1
        for k in range(m):
            if state[k] == kept[k]:
                continue
            _change(W, A, B, own, inverse, place[k], new_A[k], new_B[k])
            kept[k], stretch[k] = state[k], scaling[k]
        if solved:
            return 1, own, inverse
        y_old[:], before = y, error
        settled = False
        turned[:] = 0
        for pivot in range(PIVOTS):
            linear(W, own, inverse, right, y, q, y_new, w_new)
            trial[:] = y_new
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
                own, inverse = _border(W, B, own, inverse, worst)
                A[worst], B[worst] = one, none
            if kept[worst] != OPEN and y_new[i] < 0.0:
                kept[worst] = OPEN
                right[i : i + 3] = -y[i : i + 3]
                new_A[worst], new_B[worst] = one, none
            elif kept[worst] == STICK:
                kept[worst] = SLIP
                stretch[worst] = 1.0
                _facet(
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
                right[i : i + 3] = -w[i : i + 3]
                new_A[worst], new_B[worst] = none, one
            _change(W, A, B, own, inverse, place[worst], new_A[worst], new_B[worst])
        if not settled:
            return 0, np.empty(0, np.int64), inverse
        y[:], w[:] = y_new, w_new
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
            best[:] = y
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
        y[:] = best
        times(W, y, w)
        w += q
        if sweeps > 0 and not (again and call == 0):
            sweep(W, P, parameters, y, w, q, slip, run)
            best[:] = y
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
    y[:], w[:] = found, moved
    return True


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
        As :func:`_forward` has it.
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
    _forward(y, w, slack)
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
            slip *= 1.0 - _lag(slip / max(t, 1e-300))
            if slip > NEAR * t:
                w[i + 1], w[i + 2] = w0[i + 1] - slip * e0[k, 0], w0[i + 2] - slip * e0[k, 1]
    derivative(equation, parameters, y, w, phi, A, B, found)
    w[:] = w0
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
                _change(W, A, B, closed, inverse, worst, A0[k], B0[k])
            else:
                state[k], held[k] = STICK, True
                _change(W, A, B, closed, inverse, worst, np.zeros((3, 3)), np.eye(3))
        if event == 0:
            state0[:] = state
        advance, first = step - reached, -1
        closes = False
        trial[:] = motion + (step - reached) * dw
        if step > LONGEST and reached < LONGEST and _motion(trial, unit) > allowed:
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
        trial[:] = y + advance * dy
        if _breaking(equation, parameters, trial, still, state, held, phi, found) >= 0:
            low, high = 0.0, advance
            for _ in range(BISECTIONS):
                middle = 0.5 * (low + high)
                trial[:] = y + middle * dy
                if _breaking(equation, parameters, trial, still, state, held, phi, found) >= 0:
                    high = middle
                else:
                    low = middle
            trial[:] = y + high * dy
            breaks = _breaking(equation, parameters, trial, still, state, held, phi, found)
            advance, first, closes = high, breaks, False
            i = 3 * breaks
            if y[i] + high * dy[i] <= NEAR * y0[i]:  # it comes to the tip of its cone: it opens, and does not slide
                breaks = -1
        if closes:
            harmless = HARMLESS * allowed / max(_motion(dw, unit), 1e-300)
            advance = min(advance + max(behind, harmless), step - reached)
        y += advance * dy
        w += advance * dw
        x += advance * dy
        motion += advance * dw
        reached += advance
        trial[:] = y
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
            A0[first], B0[first] = new_A[first], new_B[first]
            for a in range(len(closed)):
                if closed[a] == first:
                    _change(W, A, B, closed, inverse, a, A0[first], B0[first])
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
                _let_go(inverse, a)
    if reached < step:
        step = max(reached, min(behind, step))
    for k in range(m):
        if opened[k] < 1.0:
            opened[k] /= step
        if loose[k] < 1.0:
            loose[k] /= step
    return step


@kernel(
    void(
        EQUATION_POINTER,
        MATRIX,
        MATRIX,
        MATRIX,
        VECTOR,
        MATRIX,
        MATRIX,
        MATRIX,
        MATRIX,
        int64,
        VECTOR,
        NUMBER,
        NUMBER,
        NUMBER,
        NUMBER,
        int64,
        MATRIX,
        BLOCKS,
        MATRIX,
        MATRIX,
        BLOCKS,
        MATRIX,
        types.Array(int64, 2, "C"),
        MATRIX,
        BLOCKS,
        MATRIX,
        boolean,
    )
)
def follow(
    equation,
    W,
    P,
    parameters,
    unit,
    Q0,
    Q1,
    L,
    Y,
    order,
    ends,
    tolerance,
    least,
    bearable,
    tol,
    sweeps,
    Q,
    slip,
    length,
    work,
    share,
    sums,
    counts,
    passed,
    passed_force,
    guess,
    near,
):
    """Every sample of a batch from one load to the next.

    Parameters
    ----------
    unit : (3m,) array
        Length of a unit of ``w``; a unit of ``y`` is its reciprocal.
    Q0, Q1 : (n, 3m) array
        ``q`` at the two loads, without the anchors.
    L, Y : (n, 2m), (n, 3m) array
        Anchors and forces, at the start and, in place, at the end.
    order : {1, 2}
        1 for backward Euler's method as it is: neither prediction nor shifts, and no estimate.
    ends : (k,) array
        Where steps end, in shares of the path, the last at 1; none for steps of controlled error.
    tolerance, least, bearable : float
        A step's error in positions may be the first share of the tangential motion so far, or of the length
        ``least`` if that is larger; in forces ``bearable`` times the largest so far or at the end of the path if
        those that press go on: all root mean square over the contacts.
    tol : float
        Newton's tolerance at the end.
    sweeps : int
        Of Gauss-Seidel, where Newton needs help; 0 if they are not the law's.
    Q : (n, 3m) array
        Receives the right-hand side of the last step: what the certificate is measured against.
    slip, length, work, share : (n, m, 2), (n, m), (n, m), (n, m, 3) array
        Receive what :class:`mic.contact.path.Trace` holds, the first two in scaled lengths.
    sums : (n, 2) array
        Receives the sums of the steps' errors, in positions and in forces, N.
    counts : (n, 5) int array
    passed, passed_force : (n, k), (n, k, 3m) array
        Receive where the first k steps end, and the forces there; of second order from the start on, at 0.
    guess : (n, 3m) array
        Of the forces at the end, for one step of first order; (0, 3m) for none.
    near : bool
        Whether Newton's method tries the guess as it is; if not, sweeps begin with it.
    """
    size = Q0.shape[1]
    m = len(parameters)
    y, w, q = np.empty(size), np.empty(size), np.empty(size)
    y0, w0, yp, wp = np.empty(size), np.empty(size), np.empty(size), np.empty(size)
    x, motion, rate = np.zeros(size), np.zeros(size), np.empty(size)  # of first order nothing is predicted
    state0, state, e0 = np.zeros(m, np.int64), np.zeros(m, np.int64), np.zeros((m, 2))
    shift, other = np.zeros((m, 2)), np.zeros((m, 2))
    grip, loose = np.zeros(m), np.ones(m)
    touched, late, opened, gone = np.zeros(m), np.zeros(m), np.ones(m), np.zeros((m, 2))
    phi, nothing, kept = np.empty(size), np.empty((0, 3, 3)), np.zeros(m, np.int64)
    stretch, A, B = np.ones(m), np.zeros((m, 3, 3)), np.zeros((m, 3, 3))
    pace, doubt = np.zeros(m), np.zeros(size)
    given = len(ends) > 0
    smallest = 1.0 if given else SHORTEST
    for sample in range(len(Q0)):
        done = counts[sample]
        y[:] = Y[sample]
        q[:] = Q0[sample]
        for k in range(m):
            q[3 * k + 1] -= L[sample, 2 * k]
            q[3 * k + 2] -= L[sample, 2 * k + 1]
        times(W, y, w)
        w += q
        rate[:] = Q1[sample] - Q0[sample]
        scale = max(starting_scale(q), starting_scale(q + rate))
        pace[:] = 0.0
        y0[:] = y
        solved, own, inverse = 1, np.empty(0, np.int64), np.empty((0, 0))
        if order == 1:  # what does not balance is part of the first step
            for k in range(m):
                w[3 * k + 1] = w[3 * k + 2] = 0.0
        else:
            solved, own, inverse = solve(
                equation,
                W,
                P,
                parameters,
                y,
                w,
                q,
                y0,
                INNER,
                scale,
                sweeps,
                HELP,
                True,
                False,
                kept,
                stretch,
                A,
                B,
                own,
                inverse,
                done,
            )
        if solved == 0:
            done[FAILED] += 1
            continue
        s, h, made, bearing, most = 0.0, ends[0] if given else 1.0, 0.0, 0.0, 0.0
        while True:
            taken = done[STEPS] - 1 + (order == 2)
            if 0 <= taken < passed.shape[1]:
                passed[sample, taken] = s
                passed_force[sample, taken] = y
            for k in range(m):
                for c in range(2):
                    L[sample, 2 * k + c] += w[3 * k + 1 + c]
                    w[3 * k + 1 + c] = 0.0
            if s == 1.0:
                break
            y0[:], w0[:] = y, w
            slack = LEFT * INNER * max(scale, np.sqrt(np.dot(y0, y0)))
            most = max(most, _mean(y, unit))
            step = 1.0 - s if s + 1.0001 * h >= 1.0 else h
            short = order == 2 and not given and _unforeseen(y0, w0, rate, slack, s == 0.0)
            if short:
                step = min(step, FIRST)
            solved, error, force, excess = 1, 0.0, 0.0, 0.0
            while True:
                if order == 1:
                    wp[:] = w0
                    _forward(y0, wp, slack)
                    equation(parameters, y0, wp, phi, nothing, nothing, state0, False)
                    least = 0.0
                    for k in range(m):
                        least = max(least, ROUNDING * y0[3 * k])
                    for k in range(m):
                        if y0[3 * k] <= least:  # it touches: its force grows from none, as where it closes
                            state0[k] = OPEN
                        grip[k] = np.sqrt(y0[3 * k + 1] ** 2 + y0[3 * k + 2] ** 2)
                        if grip[k] > 0.0:
                            e0[k, 0], e0[k, 1] = y0[3 * k + 1] / grip[k], y0[3 * k + 2] / grip[k]
                        loose[k] = 0.0 if state0[k] == SLIP else 1.0
                else:
                    behind = 1.0 if given else min(TOGETHER, max(smallest, BEHIND * step))
                    allowed = np.inf if given else tolerance * max(least, made)
                    step = predict(
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
                        done,
                    )
                yp[:] = y0 + (1.0 - s) / step * x  # if all goes on
                for k in range(m):
                    if yp[3 * k] <= 0.0:
                        yp[3 * k : 3 * k + 3] = 0.0
                bearing = bearable * max(most, _mean(yp, unit))
                yp[:], wp[:] = y0 + x, w0 + motion
                allowed = tolerance * max(least, made + _motion(motion, unit))
                target = 1.0 if s + step > 1.0 - 1e-9 else s + step
                if order == 2:
                    _shifts(w0, state0, e0, grip, loose, yp, wp, state0, False, shift, touched)
                # With the prediction's shifts, then with the solution's; where no shorter step is to be had, with
                # none: backward Euler's method as it is, which always leads on.
                turn, last = 0, step <= 1.0001 * smallest
                while True:
                    q[:] = Q0[sample] + target * rate
                    for k in range(m):
                        for c in range(2):
                            q[3 * k + 1 + c] -= L[sample, 2 * k + c] + shift[k, c]
                    if turn == 2:
                        y[:] = y0
                    elif turn == 0:
                        y[:] = yp
                        for k in range(m):
                            if order == 2 and opened[k] < 1.0:
                                y[3 * k : 3 * k + 3] = 0.0
                        # Linear rates overrun a slider that turns fast: it starts from its old direction.
                        for k in range(m):
                            i = 3 * k
                            if order == 2 and state0[k] == SLIP and y0[i] > 0.0:
                                grown = max(y[i], 0.0) / y0[i]
                                y[i + 1], y[i + 2] = grown * y0[i + 1], grown * y0[i + 2]
                    if len(guess) > 0 and not near:
                        y[:] = guess[sample]
                    times(W, y, w)
                    w += q
                    end, landed = target == 1.0, False
                    if len(guess) > 0 and near:
                        landed = lands(equation, W, parameters, guess[sample], y, w, q, tol, done)
                    if landed:
                        solved = 1
                    else:
                        solved, own, inverse = solve(
                            equation,
                            W,
                            P,
                            parameters,
                            y,
                            w,
                            q,
                            y0,
                            tol if end or given else INNER,
                            starting_scale(q) if end else scale,
                            sweeps,
                            HELP if last or order == 1 or _motion(motion, unit) <= allowed else 0,
                            order == 2,
                            order == 2,
                            kept,
                            stretch,
                            A,
                            B,
                            own,
                            inverse,
                            done,
                        )
                    equation(parameters, y, w, phi, nothing, nothing, state, False)
                    for k in range(m):
                        w[3 * k + 1] += shift[k, 0]
                        w[3 * k + 2] += shift[k, 1]
                    if order == 1:
                        break
                    _shifts(w0, state0, e0, grip, loose, y, w, state, True, other, late)
                    closings(W, own, inverse, w0, state0, y, w, state, other, late)
                    if turn == 2:  # as far from backward Euler's method as its shifts are
                        for k in range(m):
                            doubt[3 * k], doubt[3 * k + 1], doubt[3 * k + 2] = 0.0, other[k, 0], other[k, 1]
                        error = _motion(doubt, unit)
                        force = force_error(W, B, own, inverse, doubt, unit)
                        break
                    placed = _error(y0, state0, e0, grip, loose, motion, y, w, state, shift, other, unit, doubt)
                    force = force_error(W, B, own, inverse, doubt, unit)
                    unsure = _unsure(y0, state0, motion, w, state, opened, gone, unit)
                    error = np.hypot(placed, unsure)
                    if last:  # neither a shorter step nor one without shifts would tell when a contact opens
                        unsure, error = 0.0, placed
                    bearing = max(bearing, bearable * _mean(y, unit))  # nothing pressed before
                    excess = _excess(error, allowed, force, bearing)
                    if solved == 1 and (turn == 1 if given else excess <= 1.0):
                        break
                    left = np.hypot(
                        _error(y0, state0, e0, grip, loose, motion, y, w, state, other, other, unit, doubt), unsure
                    )
                    left = _excess(left, allowed, force_error(W, B, own, inverse, doubt, unit), bearing)
                    if turn == 0 and solved == 1 and (given or last or left <= 1.0):
                        turn = 1
                        shift[:], touched[:] = other, late
                    elif last:
                        turn = 2
                        shift[:], touched[:] = 0.0, 0.0
                    else:
                        break
                if solved == 1:
                    for k in range(m):
                        pace[k] = 0.0
                        if state[k] == SLIP:
                            pace[k] = np.sqrt(w[3 * k + 1] ** 2 + w[3 * k + 2] ** 2) / (target - s)
                excess = _excess(error, allowed, force, bearing)
                if solved == 1 and excess <= 1.0 or last:
                    break
                done[CUT] += 1
                shrink = _rounded(SAFETY / np.sqrt(excess)) if solved == 1 else 0.25
                step *= max(min(0.5, max(0.25, shrink)), smallest / step)
            if solved == 0:
                done[FAILED] += 1
                break
            _record(
                y0,
                w0,
                motion,
                state0,
                e0,
                grip,
                loose,
                y,
                w,
                state,
                late,
                other,
                opened,
                gone,
                target - s,
                slip[sample],
                length[sample],
                work[sample],
                share[sample],
            )
            sums[sample, 0] += error
            sums[sample, 1] += force
            done[STEPS] += 1
            s = target
            made += _motion(w, unit)
            h = min(1.0, max(smallest, step * min(GROWTH, _rounded(SAFETY / np.sqrt(max(excess, 1e-300))))))
            if short:  # now it is known
                h = max(h, LONGEST)
            if given:
                h = ends[min(done[STEPS], len(ends) - 1)] - s
            elif done[STEPS] > MOST:
                done[FAILED] += 1
                break
        Q[sample], Y[sample] = q, y


@kernel(
    void(
        EQUATION_POINTER,
        MATRIX,
        MATRIX,
        MATRIX,
        VECTOR,
        COUNTS,
        COUNTS,
        NUMBER,
        int64,
        BLOCKS,
        MATRIX,
        BLOCKS,
        types.Array(boolean, 2, "C"),
        MATRIX,
        boolean,
        MATRIX,
        MATRIX,
        BLOCKS,
        BLOCKS,
        MATRIX,
        MATRIX,
        BLOCKS,
        types.Array(int64, 2, "C"),
    )
)
def follow_among(
    equation,
    W,
    P,
    parameters,
    D,
    among,
    some,
    tol,
    sweeps,
    b,
    force,
    anchor,
    working,
    guess,
    near,
    found,
    Q,
    L,
    slip,
    length,
    work,
    share,
    counts,
):
    """One step of first order of samples, each with the contacts of its own working set alone.

    As :func:`follow` with one sample at a time and what :func:`block` takes of W; but loads, forces and all that is
    found are those of a batch over all contacts, in mm and N, of which W has some.

    Parameters
    ----------
    D : (3k,) array
        Units of the scaled forces of W's contacts.
    among, some : (k,), (l,) int array
        Numbers of W's contacts among all m, and of the samples in the batch.
    b, force, anchor : (n, 2, 3m), (n, 3m), (n, m, 2) array
        Loads, and forces and anchors at the start.
    working : (n, m) bool array
    guess : (n, 3m) array
        Of the forces at the end, for samples that have any: taken as it is where it is ``near``, else as a
        forecast, with which few sweeps begin.
    found, Q, L, slip, length, work, share : (n, 3m), (n, 3m), (n, m, 2), (n, m, 2), (n, m), (n, m), (n, m, 3) array
        Receive forces, the right-hand side, anchors and what :class:`mic.contact.path.Trace` holds, of the contacts
        of the working sets; the others are not touched.
    counts : (n, 5) int array
    """
    at_end, none, nothing = np.ones(1), np.empty((1, 0)), np.empty((1, 0, 0))
    sums = np.zeros((1, 2))
    for s in some:
        own = np.flatnonzero(working[s][among])
        m, done = len(own), counts[s : s + 1]
        some_P, some_parameters = np.empty((m, P.shape[1])), np.empty((m, parameters.shape[1]))
        size = 1, 3 * m
        q0, q1, y, start, q = np.empty(size), np.empty(size), np.empty(size), np.empty(size), np.zeros(size)
        anchors, unit = np.empty((1, 2 * m)), np.empty(3 * m)
        guessed = False
        for a in range(m):
            k = own[a]
            i, j = 3 * a, 3 * among[k]
            some_P[a], some_parameters[a] = P[k], parameters[k]
            for c in range(3):
                d = D[3 * k + c]
                unit[i + c] = 1.0 / d
                q0[0, i + c], q1[0, i + c] = b[s, 0, j + c] * d, b[s, 1, j + c] * d
                y[0, i + c], start[0, i + c] = force[s, j + c] / d, guess[s, j + c] / d
                guessed = guessed or guess[s, j + c] != 0.0
            for c in range(2):
                anchors[0, 2 * a + c] = anchor[s, among[k], c] * D[3 * k + 1]
        slips, lengths, works, shares = np.zeros((1, m, 2)), np.zeros((1, m)), np.zeros((1, m)), np.zeros((1, m, 3))
        follow(
            equation,
            block(W, own, 3),
            some_P,
            some_parameters,
            unit,
            q0,
            q1,
            anchors,
            y,
            1,
            at_end,
            0.0,
            0.0,
            0.0,
            tol,
            min(sweeps, FORECAST) if guessed and not near else sweeps,
            q,
            slips,
            lengths,
            works,
            shares,
            sums,
            done,
            none,
            nothing,
            start if guessed else start[:0],
            near,
        )
        for a in range(m):
            k = among[own[a]]
            i, j = 3 * a, 3 * k
            length[s, k], work[s, k] = lengths[0, a] * unit[3 * a + 1], works[0, a]
            for c in range(3):
                d = D[3 * own[a] + c]
                found[s, j + c], Q[s, j + c], share[s, k, c] = y[0, i + c] * d, q[0, i + c] / d, shares[0, a, c]
            for c in range(2):
                L[s, k, c], slip[s, k, c] = (
                    anchors[0, 2 * a + c] * unit[3 * a + 1],
                    slips[0, a, c] * unit[3 * a + 1],
                )
