"""The patient rungs: one stubborn sample, by one method after the other.

Every method is a generator of forces ``y``, and of the sweeps and the factorisations that each took since the last one;
who asks for them certifies each and stops at the first that is good enough.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from mic.contact.native.frictionless import solve_frictionless
from mic.contact.native.gauss_seidel import gauss_seidel
from mic.contact.native.law_equation import starting_scale
from mic.contact.native.newton import newton
from mic.contact.native.problem import ScaledProblem

__all__ = ["METHODS", "Search"]


class Search:
    """What the rungs hand on while they look for the solution of one sample.

    Attributes
    ----------
    problem : ScaledProblem
    q : (d m,) array
    best : (d m,) array
        The force that the cheap rungs left behind.
    """

    def __init__(self, problem: ScaledProblem, q: np.ndarray, best: np.ndarray):
        self.problem, self.q, self.best = problem, q, best
        self.renew(best)

    def renew(self, y: np.ndarray) -> None:
        """Hold the friction that belongs to the forces ``y``, where it depends on them."""
        if self.problem.law.varies and np.isfinite(y).all():
            self.problem = self.problem.renewed(y)


def renewed_friction(search, rung):
    """Coulomb's law with the friction held, solved; then it is renewed from the normal forces.

    Per contact the step to the new coefficient is halved where it turns back, and doubled, up to the whole, where not.
    """
    problem, q, y = search.problem, search.q, search.best
    mu, share, before = problem.friction.copy(), np.ones(len(problem.parameters)), np.zeros(len(problem.parameters))
    for _ in range(rung["steps"]):
        found = _solved(problem.held(), problem.neighbours, rung, q, y)
        y = found.y
        z, _, steps = landed(problem, rung, q, y)
        yield z, found.sweeps, found.steps + steps
        step = problem.renewed(y).friction - mu
        share = np.where(step * before < 0.0, 0.5 * share, np.minimum(1.0, 2.0 * share))
        before, mu = step, mu + share * step
        problem = problem.holding(mu)


def proximal_points(search, rung):
    """Proximal-point steps: solve with ``W + α I`` and ``q - α y``, and move there.

    ``α`` falls while the problems are solved. One that is not is rejected: ``y`` stays and ``α`` grows, and waits there
    for some solved ones. Steps to half-solved problems stall.
    """
    problem, q, y, alpha, wait = search.problem, search.q, search.best, rung["start"], 0
    neighbours = problem.neighbours
    for sweeps in rung["first"] if problem.law.gauss_seidel else ():
        y = _swept(search.problem, neighbours, q, y, sweeps)
        z, _, steps = landed(search.problem, rung, q, y)
        yield z, sweeps, steps
    for _ in range(rung["steps"]):
        found = _solved(search.problem.proximal(alpha), neighbours, rung, q - alpha * y, y)
        if found.error <= rung["tol"]:
            y, wait = found.y, wait - 1
            if wait <= 0 and not found.sweeps:
                alpha = max(rung["gain"] * alpha, rung["smallest"])
        else:
            alpha, wait = min(rung["loss"] * alpha, rung["largest"]), rung["wait"]
        yield y, found.sweeps, found.steps


class _Found(NamedTuple):
    """Forces, their error, and the sweeps and Newton's steps that they took."""

    y: np.ndarray
    error: float
    sweeps: int
    steps: int


def _solved(problem, neighbours, rung, q, y) -> _Found:
    """Newton at once and, where that fails, after more and more sweeps: the best forces."""
    best, error, sweeps, steps = y, np.inf, 0, 0
    for more in rung["sweeps"] if problem.law.gauss_seidel else (0,):
        if more:
            y = _swept(problem, neighbours, q, y, more)
        z, left, taken = landed(problem, rung, q, y)
        sweeps, steps = sweeps + more, steps + taken
        if left < error:
            best, error = z, left
        if error <= rung["tol"]:
            break
    return _Found(best, error, sweeps, steps)


def _swept(problem, neighbours, q, y, sweeps):
    y, w, slip = y.copy(), problem.W @ y + q, np.zeros(len(problem.parameters))
    gauss_seidel(problem.W, *neighbours, problem.factors, problem.parameters, y, w, slip, sweeps, 1e-15)
    return y


def landed(problem, rung, q, y):
    """Newton's method from y, whole steps: the best forces, their error and the steps taken."""
    tol, m = 0.1 * rung["tol"], len(problem.parameters)
    if not problem.law.frictional:
        Y, error, passes, taken = y[None].copy(), np.zeros(1), np.zeros(1, np.int64), np.zeros(1, np.int64)
        solve_frictionless(problem.W, q[None], Y, tol, 1, error, passes, taken)
        return Y[0], error[0], int(taken[0])
    y, w = y.copy(), problem.W @ y + q
    settings = rung["damping"], starting_scale(q), tol, rung["newton"], 0, m
    error, steps = newton(problem.equation, problem.W, np.empty((0, 0)), q, problem.parameters, y, w, *settings)
    return y, error, steps


#: The method of every rung of :data:`mic.contact.ladder.PATIENT`, by its name.
METHODS = {"renewed friction": renewed_friction, "proximal points": proximal_points}
