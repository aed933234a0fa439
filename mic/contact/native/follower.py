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

from mic.contact.native.kept_factors import no_factors
from mic.contact.native.kernel import COUNTS, MATRIX, NUMBER, VECTOR, kernel
from mic.contact.native.law_equation import starting_scale
from mic.contact.native.matrices import assign, assign_sum, displace
from mic.contact.native.path_constants import FAILED, LONGEST, STEPS
from mic.contact.native.path_step import (
    HELP,
    INNER,
    SAMPLE_LEG,
    SHORTEST,
    Place,
    SampleLeg,
    controlled_step,
    euler_step,
    next_length,
    right_hand_side,
    step_end,
)
from mic.contact.native.pivots import without_problem
from mic.contact.native.step_data import (
    CONTROL,
    LAST_PROBLEM,
    OUTCOME,
    PATH_PROBLEM,
    PREDICTION,
    WORKSPACE,
    Aim,
    LastProblem,
    Prediction,
    Record,
    Workspace,
)
from mic.contact.native.step_error import mean_force, motion_size
from mic.contact.native.step_solution import solve
from mic.contact.native.step_trace import record_step

__all__ = ["MOST", "SWEEPS", "follow"]

#: Steps before a path is given up: one that is refined to rounding takes half as many.
MOST = 10000
#: A force that is off its cone by so many of Newton's tolerances may be on it.
LEFT = 10.0
#: A step in which contacts begin to press of which nothing is known is so long at most: the prediction leaves them out.
FIRST = 1e-2
#: Sweeps before Newton's method.
SWEEPS = 10


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


@kernel(types.Tuple((WORKSPACE, PREDICTION, LAST_PROBLEM))(int64))
def arrays(m):
    """What the steps of a path of m contacts work with; of first order nothing is predicted."""
    y0, w0, y, w, q = np.empty(3 * m), np.empty(3 * m), np.empty(3 * m), np.empty(3 * m), np.empty(3 * m)
    yp, wp, doubt, phi = np.empty(3 * m), np.empty(3 * m), np.zeros(3 * m), np.empty(3 * m)
    state, shift, other = np.zeros(m, np.int64), np.zeros((m, 2)), np.zeros((m, 2))
    late, pace = np.zeros(m), np.zeros(m)
    work = Workspace(y0, w0, y, w, q, state, yp, wp, shift, other, late, pace, doubt, phi)
    state0, e0, grip, loose = np.zeros(m, np.int64), np.zeros((m, 2)), np.zeros(m), np.ones(m)
    x, motion, opened, gone = np.zeros(3 * m), np.zeros(3 * m), np.ones(m), np.zeros((m, 2))
    predicted = Prediction(state0, e0, grip, loose, x, motion, opened, gone)
    kept, stretch, A, B = np.zeros(m, np.int64), np.ones(m), np.zeros((m, 3, 3)), np.zeros((m, 3, 3))
    return work, predicted, LastProblem(kept, stretch, A, B, np.empty(0, np.int64), np.empty((0, 0)), no_factors())


@kernel(
    types.Tuple((int64, SAMPLE_LEG, LAST_PROBLEM))(PATH_PROBLEM, CONTROL, SAMPLE_LEG, WORKSPACE, LAST_PROBLEM, COUNTS)
)
def begin(problem, control, leg, work, last, counts):
    """Displacements at the start of a leg: whether they are found, the leg with its scale, and the linear problem that
    was solved last."""
    y, w, q = work.y, work.w, work.q
    work.shift[:] = 0.0
    right_hand_side(leg, 0.0, work.shift, q)
    displace(problem.W, y, q, w)
    scale = max(starting_scale(q), starting_scale(q + leg.rate))
    leg = SampleLeg(leg.q0, leg.rate, leg.anchor, scale)
    work.pace[:] = 0.0
    assign(work.y0, y)
    if control.order == 1:  # what does not balance is part of the first step
        for i in range(0, len(w), 3):
            w[i + 1] = w[i + 2] = 0.0
        return 1, leg, last
    aim = Aim(INNER, scale, control.sweeps, HELP, True, False)
    solved, last = solve(problem, work, aim, last, counts)
    return solved, leg, last


@kernel(
    void(
        PATH_PROBLEM,
        CONTROL,
        SAMPLE_LEG,
        types.Tuple((VECTOR, boolean)),
        OUTCOME,
        int64,
        WORKSPACE,
        PREDICTION,
        LAST_PROBLEM,
    )
)
def follow_leg(problem, control, leg, guess, outcome, i, work, predicted, last):
    """Sample i from one load to the next, step by step."""
    record = Record(outcome.record.slip[i], outcome.record.length[i], outcome.record.work[i], outcome.record.share[i])
    y, w, counts, ends = work.y, work.w, outcome.counts[i], control.ends
    given = len(ends) > 0
    s, h, made, most = 0.0, ends[0] if given else 1.0, 0.0, 0.0
    while True:
        taken = counts[STEPS] - 1 + (control.order == 2)
        if 0 <= taken < outcome.passed.shape[1]:
            outcome.passed[i, taken] = s
            assign(outcome.passed_force[i, taken], y)
        for k in range(len(work.state)):
            for c in range(2):
                leg.anchor[2 * k + c] += w[3 * k + 1 + c]
                w[3 * k + 1 + c] = 0.0
        if s == 1.0:
            break
        assign(work.y0, y)
        assign(work.w0, w)
        slack = LEFT * INNER * max(leg.scale, np.sqrt(np.dot(y, y)))
        most = max(most, mean_force(y, problem.unit))
        step = 1.0 - s if s + 1.0001 * h >= 1.0 else h
        short = control.order == 2 and not given and unforeseen(y, w, leg.rate, slack, s == 0.0)
        if short:
            step = min(step, FIRST)
        place = Place(s, step, slack, made, most)
        if control.order == 1:
            solved, last = euler_step(problem, control, leg, place, guess, predicted, work, last, counts)
            target, error, force, excess = step_end(s, step), 0.0, 0.0, 0.0
        else:
            solved, last, taken_step = controlled_step(problem, control, leg, place, predicted, work, last, counts)
            target, step, error, force, excess = taken_step
        if solved == 0:
            counts[FAILED] += 1
            break
        record_step(predicted, work, target - s, record)
        outcome.sums[i, 0] += error
        outcome.sums[i, 1] += force
        counts[STEPS] += 1
        s = target
        made += motion_size(w, problem.unit)
        if given:
            h = ends[min(counts[STEPS], len(ends) - 1)] - s
            continue
        h = min(1.0, max(SHORTEST, next_length(step, excess)))
        if short:  # now it is known
            h = max(h, LONGEST)
        if counts[STEPS] > MOST:
            counts[FAILED] += 1
            break


@kernel(
    void(PATH_PROBLEM, types.UniTuple(MATRIX, 2), CONTROL, MATRIX, MATRIX, OUTCOME, MATRIX, boolean), from_python=True
)
def follow(problem, loads, control, L, Y, outcome, guess, near):
    """Every sample of a batch from one load to the next.

    Parameters
    ----------
    loads : tuple of two (n, 3m) arrays
        ``q`` at the start and at the end, without the anchors.
    L, Y : (n, 2m), (n, 3m) array
        Anchors and forces, at the start and, in place, at the end.
    outcome : Outcome
        Is filled.
    guess : (n, 3m) array
        Of the forces at the end, for one step of first order; (0, 3m) for none.
    near : bool
        Whether Newton's method tries the guess as it is; if not, sweeps begin with it.
    """
    Q, counts = outcome.q, outcome.counts
    work, predicted, last = arrays(len(problem.parameters))
    rate, none = np.empty(Q.shape[1]), np.empty(0)
    for i in range(len(Q)):
        assign(work.y, Y[i])
        assign_sum(rate, loads[1][i], -1.0, loads[0][i])
        leg = SampleLeg(loads[0][i], rate, L[i], 0.0)
        last = without_problem(last)
        solved, leg, last = begin(problem, control, leg, work, last, counts[i])
        if solved == 0:
            counts[i, FAILED] += 1
            continue
        forces = guess[i] if len(guess) > 0 else none
        follow_leg(problem, control, leg, (forces, near), outcome, i, work, predicted, last)
        assign(Q[i], work.q)
        assign(Y[i], work.y)
