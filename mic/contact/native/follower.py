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

from mic.contact.native.kernel import BLOCKS, MATRIX, NUMBER, VECTOR, kernel
from mic.contact.native.law_equation import EQUATION_POINTER, starting_scale
from mic.contact.native.matrices import assign, assign_sum, times
from mic.contact.native.path_constants import CUT, FAILED, LONGEST, ROUNDING, STEPS
from mic.contact.native.prediction import forward, predict
from mic.contact.native.slip_origins import closings, origins
from mic.contact.native.step_error import (
    force_error,
    mean_force,
    motion_size,
    opening_doubt,
    over_allowed,
    position_error,
)
from mic.contact.native.step_solution import lands, solve
from mic.contact.native.step_trace import record_step
from mic.contact.states import OPEN, SLIP

__all__ = ["MOST", "SWEEPS", "follow"]

#: The shortest step of the whole path: contacts may make most of their motion within a hundredth of the path and less.
SHORTEST = 1e-6
#: Steps before a path is given up: one that is refined to rounding takes half as many.
MOST = 10000
#: Behind a closing a step goes on for this share of its length and of the path: what closes meanwhile does so together.
BEHIND, TOGETHER = 0.25, 1e-2
#: Newton's tolerance within a path; at its end it is the solver's.  It is relative to what overlap alone would be
#: answered with, which is a thousand times the motion where parts hang together loosely: looser, paths part.
INNER = 1e-12
#: A force that is off its cone by so many of Newton's tolerances may be on it.
LEFT = 10.0
#: Shrinking the step aims below the tolerance by this factor, the usual one of step control; and how much it may grow.
SAFETY, GROWTH = 0.8, 4.0
#: A step in which contacts begin to press of which nothing is known is so long at most: the prediction leaves them out.
FIRST = 1e-2
#: Sweeps before Newton's method.
SWEEPS = 10
#: Calls for help before a problem is given up, where no shorter step is to be had.
HELP = 6


@kernel(NUMBER(NUMBER))
def rounded_factor(factor):
    """The next smaller power of √2: rounding of an estimate does not change the length of the next step."""
    return 2.0 ** (0.5 * np.floor(2.0 * np.log2(factor)))


@kernel(boolean(VECTOR, VECTOR, VECTOR, NUMBER, boolean))
def unforeseen(y, w, rate, slack, starts):
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
        assign(y, Y[sample])
        assign(q, Q0[sample])
        for k in range(m):
            q[3 * k + 1] -= L[sample, 2 * k]
            q[3 * k + 2] -= L[sample, 2 * k + 1]
        times(W, y, w)
        w += q
        assign_sum(rate, Q1[sample], -1.0, Q0[sample])
        scale = max(starting_scale(q), starting_scale(q + rate))
        pace[:] = 0.0
        assign(y0, y)
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
                assign(passed_force[sample, taken], y)
            for k in range(m):
                for c in range(2):
                    L[sample, 2 * k + c] += w[3 * k + 1 + c]
                    w[3 * k + 1 + c] = 0.0
            if s == 1.0:
                break
            assign(y0, y)
            assign(w0, w)
            slack = LEFT * INNER * max(scale, np.sqrt(np.dot(y0, y0)))
            most = max(most, mean_force(y, unit))
            step = 1.0 - s if s + 1.0001 * h >= 1.0 else h
            short = order == 2 and not given and unforeseen(y0, w0, rate, slack, s == 0.0)
            if short:
                step = min(step, FIRST)
            solved, error, force, excess = 1, 0.0, 0.0, 0.0
            while True:
                if order == 1:
                    assign(wp, w0)
                    forward(y0, wp, slack)
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
                assign_sum(yp, y0, (1.0 - s) / step, x)  # if all goes on
                for k in range(m):
                    if yp[3 * k] <= 0.0:
                        yp[3 * k : 3 * k + 3] = 0.0
                bearing = bearable * max(most, mean_force(yp, unit))
                assign_sum(yp, y0, 1.0, x)
                assign_sum(wp, w0, 1.0, motion)
                allowed = tolerance * max(least, made + motion_size(motion, unit))
                target = 1.0 if s + step > 1.0 - 1e-9 else s + step
                if order == 2:
                    origins(w0, state0, e0, grip, loose, yp, wp, state0, False, shift, touched)
                # With the prediction's shifts, then with the solution's; where no shorter step is to be had, with
                # none: backward Euler's method as it is, which always leads on.
                turn, last = 0, step <= 1.0001 * smallest
                while True:
                    assign_sum(q, Q0[sample], target, rate)
                    for k in range(m):
                        for c in range(2):
                            q[3 * k + 1 + c] -= L[sample, 2 * k + c] + shift[k, c]
                    if turn == 2:
                        assign(y, y0)
                    elif turn == 0:
                        assign(y, yp)
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
                        assign(y, guess[sample])
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
                            HELP if last or order == 1 or motion_size(motion, unit) <= allowed else 0,
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
                    origins(w0, state0, e0, grip, loose, y, w, state, True, other, late)
                    closings(W, own, inverse, w0, state0, y, w, state, other, late)
                    if turn == 2:  # as far from backward Euler's method as its shifts are
                        for k in range(m):
                            doubt[3 * k], doubt[3 * k + 1], doubt[3 * k + 2] = 0.0, other[k, 0], other[k, 1]
                        error = motion_size(doubt, unit)
                        force = force_error(W, B, own, inverse, doubt, unit)
                        break
                    placed = position_error(y0, state0, e0, grip, loose, motion, y, w, state, shift, other, unit, doubt)
                    force = force_error(W, B, own, inverse, doubt, unit)
                    unsure = opening_doubt(y0, state0, motion, w, state, opened, gone, unit)
                    error = np.hypot(placed, unsure)
                    if last:  # neither a shorter step nor one without shifts would tell when a contact opens
                        unsure, error = 0.0, placed
                    bearing = max(bearing, bearable * mean_force(y, unit))  # nothing pressed before
                    excess = over_allowed(error, allowed, force, bearing)
                    if solved == 1 and (turn == 1 if given else excess <= 1.0):
                        break
                    left = np.hypot(
                        position_error(y0, state0, e0, grip, loose, motion, y, w, state, other, other, unit, doubt),
                        unsure,
                    )
                    left = over_allowed(left, allowed, force_error(W, B, own, inverse, doubt, unit), bearing)
                    if turn == 0 and solved == 1 and (given or last or left <= 1.0):
                        turn = 1
                        assign(touched, late)
                        for k in range(m):
                            assign(shift[k], other[k])
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
                excess = over_allowed(error, allowed, force, bearing)
                if solved == 1 and excess <= 1.0 or last:
                    break
                done[CUT] += 1
                shrink = rounded_factor(SAFETY / np.sqrt(excess)) if solved == 1 else 0.25
                step *= max(min(0.5, max(0.25, shrink)), smallest / step)
            if solved == 0:
                done[FAILED] += 1
                break
            record_step(
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
            made += motion_size(w, unit)
            h = min(1.0, max(smallest, step * min(GROWTH, rounded_factor(SAFETY / np.sqrt(max(excess, 1e-300))))))
            if short:  # now it is known
                h = max(h, LONGEST)
            if given:
                h = ends[min(done[STEPS], len(ends) - 1)] - s
            elif done[STEPS] > MOST:
                done[FAILED] += 1
                break
        assign(Q[sample], q)
        assign(Y[sample], y)
