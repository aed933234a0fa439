"""One step of a path: of first order, or of second order with controlled error."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numba import boolean, int64, types, void

from mic.contact.native.kept_factors import are_many
from mic.contact.native.kernel import COUNTS, MATRIX, NUMBER, VECTOR, kernel
from mic.contact.native.law_equation import starting_scale, statuses
from mic.contact.native.matrices import assign, assign_sum, displace
from mic.contact.native.path_constants import ROUNDING
from mic.contact.native.prediction import Limits, forward, predict
from mic.contact.native.slip_origins import closings, origins
from mic.contact.native.step_data import CONTROL, LAST_PROBLEM, PATH_PROBLEM, PREDICTION, WORKSPACE, Aim
from mic.contact.native.step_error import (
    force_error,
    mean_force,
    motion_size,
    opening_doubt,
    over_allowed,
    position_error,
)
from mic.contact.native.step_solution import lands, solve
from mic.contact.states import OPEN, SLIP, STICK

__all__ = [
    "HELP",
    "INNER",
    "SAMPLE_LEG",
    "SHORTEST",
    "SampleLeg",
    "Place",
    "controlled_step",
    "euler_step",
    "next_length",
    "step_end",
]

#: The shortest step of the whole path: contacts may make most of their motion within a hundredth of the path and less.
SHORTEST = 1e-6
#: Behind a closing a step goes on for this share of its length and of the path: what closes meanwhile does so together.
BEHIND, TOGETHER = 0.25, 1e-2
#: Newton's tolerance within a path; at its end it is the solver's.  It is relative to what overlap alone would be
#: answered with, which is a thousand times the motion where parts hang together loosely: looser, paths part.
INNER = 1e-12
#: Shrinking the step aims below the tolerance by this factor, the usual one of step control; and how much it may grow.
SAFETY, GROWTH = 0.8, 4.0
#: Calls for help before a problem is given up, where no shorter step is to be had.
HELP = 6


class SampleLeg(NamedTuple):
    """The way of one sample from a load to the next.

    Attributes
    ----------
    q0, rate : (3m,) array
        ``q`` at the start, without the anchors, and its change over the whole path.
    anchor : (2m,) array
    scale : float
        Force that Newton's tolerance is relative to.
    """

    q0: np.ndarray
    rate: np.ndarray
    anchor: np.ndarray
    scale: float


class Place(NamedTuple):
    """Where a step starts.

    Attributes
    ----------
    s, step : float
        Share of the path that is done, and length of the step to try.
    slack : float
        How far Newton's tolerance may leave a force from its cone.
    made, most : float
        Tangential motion, and the largest mean force, so far.
    """

    s: float
    step: float
    slack: float
    made: float
    most: float


class Trial(NamedTuple):
    """A step that is tried.

    Attributes
    ----------
    target : float
        Share of the path at its end.
    allowed, bearing : float
        Its error may be so large, in positions and in forces.
    last : bool
        Whether no shorter step is to be had.
    """

    target: float
    allowed: float
    bearing: float
    last: bool


SAMPLE_LEG = types.NamedTuple([VECTOR, VECTOR, VECTOR, NUMBER], SampleLeg)
PLACE = types.NamedUniTuple(NUMBER, 5, Place)
TRIAL = types.NamedTuple([NUMBER, NUMBER, NUMBER, boolean], Trial)


@kernel(NUMBER(NUMBER))
def rounded_factor(factor):
    """The next smaller power of √2: rounding of an estimate does not change the length of the next step."""
    return 2.0 ** (0.5 * np.floor(2.0 * np.log2(factor)))


@kernel(NUMBER(NUMBER, NUMBER))
def next_length(step, excess):
    """Length of a step after one whose error was ``excess`` times what it may be, at most 1."""
    return step * min(GROWTH, rounded_factor(SAFETY / np.sqrt(max(excess, 1e-300))))


@kernel(NUMBER(NUMBER, NUMBER))
def step_end(s, step):
    """Where a step ends; at the very end rather than just before."""
    return 1.0 if s + step > 1.0 - 1e-9 else s + step


@kernel(void(SAMPLE_LEG, NUMBER, MATRIX, VECTOR))
def right_hand_side(leg, target, shift, q):
    """Fill ``q`` at a share of the path, slip measured from the shifted anchors."""
    assign_sum(q, leg.q0, target, leg.rate)
    for k in range(len(shift)):
        for c in range(2):
            q[3 * k + 1 + c] -= leg.anchor[2 * k + c] + shift[k, c]


@kernel(void(PATH_PROBLEM, NUMBER, PREDICTION, WORKSPACE))
def hold_statuses(problem, slack, predicted, work):
    """Statuses, directions and forces of sliders at the start of a step of first order, which nothing predicts."""
    y0, state0 = work.y0, predicted.state
    assign(work.wp, work.w0)
    forward(y0, work.wp, slack)
    statuses(problem.equation, problem.parameters, y0, work.wp, work.phi, state0)
    least = 0.0
    for k in range(len(state0)):
        least = max(least, ROUNDING * y0[3 * k])
    for k in range(len(state0)):
        if y0[3 * k] <= least:  # it touches: its force grows from none, as where it closes
            state0[k] = OPEN
        grip = np.sqrt(y0[3 * k + 1] ** 2 + y0[3 * k + 2] ** 2)
        predicted.grip[k] = grip
        if grip > 0.0:
            predicted.e[k, 0], predicted.e[k, 1] = y0[3 * k + 1] / grip, y0[3 * k + 2] / grip
        predicted.loose[k] = 0.0 if state0[k] == SLIP else 1.0


@kernel(
    types.Tuple((int64, LAST_PROBLEM))(
        PATH_PROBLEM,
        CONTROL,
        SAMPLE_LEG,
        PLACE,
        types.Tuple((VECTOR, boolean)),
        PREDICTION,
        WORKSPACE,
        LAST_PROBLEM,
        COUNTS,
    )
)
def euler_step(problem, control, leg, place, guess, predicted, work, last, counts):
    """A step of backward Euler's method.

    Parameters
    ----------
    guess : tuple of (3m,) array and bool
        Of the forces at the end, if it has any, and whether Newton's method tries it as it is; if not, sweeps begin
        with it.
    """
    y, w, q = work.y, work.w, work.q
    (forces, near), target = guess, step_end(place.s, place.step)
    hold_statuses(problem, place.slack, predicted, work)
    right_hand_side(leg, target, work.shift, q)
    assign(y, work.y0)
    if len(forces) > 0 and not near:
        assign(y, forces)
    displace(problem.W, y, q, w)
    scale = starting_scale(q) if target == 1.0 else leg.scale
    aim, solved = Aim(control.tol, scale, control.sweeps, HELP, False, False), 1
    if len(forces) == 0 or not near or not lands(problem, forces, work, aim, counts):
        solved, last = solve(problem, work, aim, last, counts)
    statuses(problem.equation, problem.parameters, y, w, work.phi, work.state)
    return solved, last


@kernel(void(VECTOR, VECTOR, PREDICTION, VECTOR))
def guess_end(y0, yp, predicted, y):
    """Fill the forces from which the solution of a step begins, from the predicted end."""
    assign(y, yp)
    many = are_many(y0)
    for k in range(len(predicted.state)):
        i = 3 * k
        if predicted.opened[k] < 1.0:
            y[i : i + 3] = 0.0
        # Linear rates overrun a slider that turns fast: it starts from its old direction.  Many would move others.
        if predicted.state[k] == SLIP and y0[i] > 0.0 and not many:
            grown = max(y[i], 0.0) / y0[i]
            y[i + 1], y[i + 2] = grown * y0[i + 1], grown * y0[i + 2]


@kernel(boolean(PREDICTION, WORKSPACE))
def rests_inside_cone(predicted, work):
    """Whether a contact that was predicted to break loose on the way sticks where its slip is measured from.

    It would end inside its cone and break loose on the way of the next step, too, and so on in steps that never grow.
    """
    for k in range(len(work.state)):
        moved = work.shift[k, 0] != 0.0 or work.shift[k, 1] != 0.0
        if moved and 0.0 < predicted.loose[k] < 1.0 and work.state[k] == STICK:
            return True
    return False


@kernel(
    types.Tuple((int64, LAST_PROBLEM, NUMBER, NUMBER, NUMBER))(
        PATH_PROBLEM, CONTROL, SAMPLE_LEG, TRIAL, PREDICTION, WORKSPACE, LAST_PROBLEM, COUNTS
    )
)
def solve_with_shifts(problem, control, leg, trial, predicted, work, last, counts):
    """Solve a step with the prediction's shifts, then with the solution's; where there is no shorter step, with none.

    Without any it is backward Euler's method as it is, which always leads on.

    Returns
    -------
    solved, last
        As of :func:`mic.contact.native.step_solution.solve`.
    error, force : float
        Estimated errors in positions and forces.
    bearing : float
        What the error in forces may be.
    """
    target, allowed, bearing, shortest = trial
    y, w, q, state, shift, other, doubt = work.y, work.w, work.q, work.state, work.shift, work.other, work.doubt
    W, unit = problem.W, problem.unit
    given, turn = len(control.ends) > 0, 0
    calls = HELP if shortest or motion_size(predicted.motion, unit) <= allowed else 0
    while True:
        right_hand_side(leg, target, shift, q)
        if turn == 2:
            assign(y, work.y0)
        elif turn == 0:
            guess_end(work.y0, work.yp, predicted, y)
        displace(W, y, q, w)
        size = starting_scale(q) if target == 1.0 else leg.scale
        aim = Aim(control.tol if target == 1.0 or given else INNER, size, control.sweeps, calls, True, True)
        solved, last = solve(problem, work, aim, last, counts)
        statuses(problem.equation, problem.parameters, y, w, work.phi, state)
        for k in range(len(state)):
            w[3 * k + 1] += shift[k, 0]
            w[3 * k + 2] += shift[k, 1]
        origins(predicted, work, True)
        closings(W, last, predicted, work)
        if turn == 2:  # as far from backward Euler's method as its shifts are
            for k in range(len(state)):
                doubt[3 * k], doubt[3 * k + 1], doubt[3 * k + 2] = 0.0, other[k, 0], other[k, 1]
            return solved, last, motion_size(doubt, unit), force_error(W, last, doubt, unit), bearing
        error = position_error(predicted, work, shift, unit)
        force = force_error(W, last, doubt, unit)
        # Neither a shorter step nor one without shifts would tell when a contact opens.
        unsure = 0.0 if shortest else opening_doubt(predicted, work, unit)
        error = error if shortest else np.hypot(error, unsure)
        bearing = max(bearing, control.bearable * mean_force(y, unit))  # nothing pressed before
        again = turn == 0 and rests_inside_cone(predicted, work)
        if solved == 1 and not again and (turn == 1 if given else over_allowed(error, allowed, force, bearing) <= 1.0):
            return solved, last, error, force, bearing
        left = np.hypot(position_error(predicted, work, other, unit), unsure)
        left = over_allowed(left, allowed, force_error(W, last, doubt, unit), bearing)
        if turn == 0 and solved == 1 and (again or given or shortest or left <= 1.0):
            turn = 1
            for k in range(len(state)):
                assign(shift[k], other[k])
        elif shortest:
            turn = 2
            shift[:] = 0.0
        else:
            return solved, last, error, force, bearing


@kernel(
    types.Tuple((int64, LAST_PROBLEM, types.UniTuple(NUMBER, 5)))(
        PATH_PROBLEM, CONTROL, SAMPLE_LEG, PLACE, PREDICTION, WORKSPACE, LAST_PROBLEM, COUNTS
    )
)
def controlled_step(problem, control, leg, place, predicted, work, last, counts):
    """A step of second order, cut until its error is as small as it may be.

    Returns
    -------
    solved, last
        As of :func:`mic.contact.native.step_solution.solve`.
    step : tuple of float
        Where it ends, its length, its errors in positions and forces, and how many times what they may be they are.
    """
    y0, w0, yp, wp, unit = work.y0, work.w0, work.yp, work.wp, problem.unit
    given, step = len(control.ends) > 0, place.step
    smallest = 1.0 if given else SHORTEST
    while True:
        behind = 1.0 if given else min(TOGETHER, max(smallest, BEHIND * step))
        allowed = np.inf if given else control.tolerance * max(control.least, place.made)
        limits = Limits(behind, allowed, place.slack)
        step = predict(problem, leg.rate, step, limits, predicted, work, counts)
        assign_sum(yp, y0, (1.0 - place.s) / step, predicted.x)  # if all goes on
        for i in range(0, len(yp), 3):
            if yp[i] <= 0.0:
                yp[i : i + 3] = 0.0
        bearing = control.bearable * max(place.most, mean_force(yp, unit))
        assign_sum(yp, y0, 1.0, predicted.x)
        assign_sum(wp, w0, 1.0, predicted.motion)
        allowed = control.tolerance * max(control.least, place.made + motion_size(predicted.motion, unit))
        target, shortest = step_end(place.s, step), step <= 1.0001 * smallest
        origins(predicted, work, False)
        trial = Trial(target, allowed, bearing, shortest)
        solved, last, error, force, bearing = solve_with_shifts(
            problem, control, leg, trial, predicted, work, last, counts
        )
        if solved == 1:
            for k in range(len(work.state)):
                slip = np.sqrt(work.w[3 * k + 1] ** 2 + work.w[3 * k + 2] ** 2)
                work.pace[k] = slip / (target - place.s) if work.state[k] == SLIP else 0.0
        excess = over_allowed(error, allowed, force, bearing)
        if solved == 1 and excess <= 1.0 or shortest:
            return solved, last, (target, step, error, force, excess)
        shrink = rounded_factor(SAFETY / np.sqrt(excess)) if solved == 1 else 0.25
        step *= max(min(0.5, max(0.25, shrink)), smallest / step)
