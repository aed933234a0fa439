"""The patient rungs: one stubborn sample, by one method after the other.

Every method is a generator of forces ``y``, and of the sweeps and the factorisations that each took since the last one;
who asks for them certifies each and stops at the first that is good enough.
"""

from __future__ import annotations

import numpy as np

from mic.contact.ladder import INTERIOR_POINT
from mic.contact.native import kernels
from mic.contact.native.batch import relaxation
from mic.contact.native.interior_point import interior_point
from mic.contact.native.polish import polished
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
    interior : (d m,) array
        The last answer of the interior point; ``best`` before there is one.
    """

    def __init__(self, problem: ScaledProblem, q: np.ndarray, best: np.ndarray):
        self.problem, self.q, self.best, self.interior = problem, q, best, best
        self.renew(best)

    def renew(self, y: np.ndarray) -> None:
        """Hold the friction that belongs to the forces ``y``, where it depends on them."""
        if self.problem.law.varies and np.isfinite(y).all():
            self.problem = self.problem.renewed(y)


def newton(search, rung):
    """Newton from the best force."""
    for y, steps in polished(search.problem, search.q, search.best):
        yield y, 0, steps


def renewed_friction(search, rung):
    """Coulomb's law with the friction held, solved; then it is renewed from the normal forces.

    Per contact the step to the new coefficient is halved where it turns back, and doubled, up to the whole, where not.
    """
    problem, q, y = search.problem, search.q, search.best
    mu, share, before = problem.friction.copy(), np.ones(len(problem.parameters)), np.zeros(len(problem.parameters))
    for _ in range(rung["steps"]):
        y, error, sweeps, steps = _relaxed(problem.held(), rung, rung["tol"], q, y)
        if error > rung["tol"]:
            y, more = interior_point(problem.W, q, problem.friction, problem.law.shift, **INTERIOR_POINT.settings)
            steps += more
        for z, more in polished(problem, q, y):
            yield z, sweeps, steps + more
            sweeps = steps = 0
        step = problem.renewed(y).friction - mu
        share = np.where(step * before < 0.0, 0.5 * share, np.minimum(1.0, 2.0 * share))
        before, mu = step, mu + share * step
        problem = problem.holding(mu)


def interior(search, rung):
    """The interior point, polished."""
    yield from _interior_polished(search, search.problem.law.shift)


def fixed_point(search, rung):
    """De Saxcé's fixed point: the convex problem with the shift ``s μ‖w_t‖`` held is solved, then the shift renewed."""
    q, held = search.q, np.zeros(len(search.problem.parameters))
    for _ in range(rung["steps"]):
        yield from _interior_polished(search, 0.0, held)
        problem = search.problem
        w = problem.W @ search.interior + q
        held = problem.law.shift * np.hypot(w[1::3], w[2::3])


def proximal_points(search, rung):
    """Proximal-point steps: solve with ``W + α I`` and ``q - α y``, and move there.

    ``α`` falls while the problems are solved. One that is not is rejected: ``y`` stays and ``α`` grows, and waits there
    for some solved ones. Steps to half-solved problems stall.
    """
    q, y, alpha, wait = search.q, search.best, rung["start"], 0
    neighbours = search.problem.neighbours if search.problem.law.frictional else None
    if search.problem.law.gauss_seidel:
        for sweeps in rung["warm"]:
            y = _swept(search.problem, neighbours, q, y, sweeps)
            z, _, steps = _landed(search.problem, rung, q, y)
            yield z, sweeps, steps
    for _ in range(rung["steps"]):
        z, easy, *counts = _solved(search.problem.proximal(alpha), neighbours, rung, q - alpha * y, y)
        if z is not None:
            y, wait = z, wait - 1
            alpha = alpha if wait > 0 or not easy else max(rung["gain"] * alpha, rung["smallest"])
        else:
            alpha, wait = min(rung["loss"] * alpha, rung["largest"]), rung["wait"]
        yield y, *counts


def _solved(problem, neighbours, rung, q, y):
    """Newton at once, then after sweeps: the forces or None, whether at once; sweeps and steps of Newton's method."""
    done = taken = 0
    for sweeps in rung["sweeps"]:
        if sweeps:
            if not problem.law.gauss_seidel:
                break
            y = _swept(problem, neighbours, q, y, sweeps)
        z, error, steps = _landed(problem, rung, q, y)
        done, taken = done + sweeps, taken + steps
        if error <= rung["tol"]:
            return z, sweeps == 0, done, taken
    return None, False, done, taken


def _swept(problem, neighbours, q, y, sweeps):
    y, slip = y.copy(), np.zeros(len(problem.parameters))
    w = problem.W @ y + q
    kernels.gauss_seidel(problem.W, *neighbours, problem.factors, problem.parameters, y, w, slip, sweeps, 1e-15)
    return y


def _landed(problem, rung, q, y):
    """Newton from y: forces, error and steps."""
    if not problem.law.frictional:
        Y, error, done, steps = y[None].copy(), np.zeros(1), *np.zeros((2, 1), np.int64)
        kernels.solve_frictionless(problem.W, q[None], Y, 0.1 * rung["tol"], 1, error, done, steps)
        return Y[0], error[0], int(steps[0])
    y, w, scale, tol = y.copy(), problem.W @ y + q, kernels.starting_scale(q), 0.1 * rung["tol"]
    m, none = len(problem.parameters), np.empty((0, 0))
    error, steps = kernels.newton(
        problem.equation, problem.W, none, q, problem.parameters, y, w, 1e-13, scale, tol, rung["newton"], 0, m
    )
    return y, error, steps


def _interior_polished(search, shift, held=None):
    problem, q = search.problem, search.q
    search.interior, steps = interior_point(problem.W, q, problem.friction, shift, held, **INTERIOR_POINT.settings)
    for y, more in polished(problem, q, search.interior):
        yield y, 0, steps + more
        steps = 0


def _relaxed(problem, rung, tol, q, y):
    """One problem by :func:`relaxation` from y: forces, error, sweeps, and steps of Newton's method."""
    Y, errors, counts = y[None].copy(), np.zeros(1), np.zeros((2, 1), dtype=np.int64)
    relaxation(problem, rung, tol)(q[None], Y, errors, *counts)
    (passes,), (steps,) = counts.tolist()
    return Y[0], errors[0], passes - steps, steps


#: The method of every rung of :data:`mic.contact.ladder.PATIENT`, by its name.
METHODS = {
    "newton": newton,
    "renewed friction": renewed_friction,
    "interior point": interior,
    "fixed point": fixed_point,
    "proximal points": proximal_points,
}
