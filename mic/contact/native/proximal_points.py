"""Proximal points: one difficult sample, by a sequence of problems that are easier."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from mic.contact.ladder import Rung
from mic.contact.native.batch import Batch
from mic.contact.native.frictionless import solve_frictionless
from mic.contact.native.gauss_seidel import gauss_seidel
from mic.contact.native.law_equation import starting_scale
from mic.contact.native.newton import NO_INVERSE, Coupling, NewtonSettings, newton
from mic.contact.native.problem import ScaledProblem

__all__ = ["proximal_points"]


def proximal_points(
    problem: ScaledProblem, rung: Rung, q: np.ndarray, y: np.ndarray
) -> Iterator[tuple[np.ndarray, int, int]]:
    """Sweeps and Newton for the problem itself, then steps: solve with ``W + α I`` and ``q - α y``, and move there.

    ``α`` falls while the problems are solved. One that is not is rejected: ``y`` stays and ``α`` grows, and waits there
    for some solved ones. Steps to half-solved problems stall. Sweeps take the friction of the last forces.

    Parameters
    ----------
    problem : ScaledProblem
    rung : Rung
    q, y : (d m,) array
        Displacements without force, and the force to start from.

    Yields
    ------
    force : (d m,) array
        For the caller to certify.
    sweeps, steps : int
        Since the last one.
    """
    problem, alpha, wait = problem.renewed(y), rung["start"], 0
    for sweeps in rung["first"] if problem.law.gauss_seidel else ():
        y = _swept(problem, q, y, sweeps)
        found, _, steps = _newton(problem, rung, q, y)
        yield found, sweeps, steps
        problem = problem.renewed(found)
    for _ in range(rung["steps"]):
        found, error, sweeps, steps = _solved(problem.proximal(alpha), rung, q - alpha * y, y)
        if error <= rung["tol"]:
            y, wait = found, wait - 1
            if wait <= 0 and not sweeps:
                alpha = max(rung["gain"] * alpha, rung["smallest"])
        else:
            alpha, wait = min(rung["loss"] * alpha, rung["largest"]), rung["wait"]
        yield y, sweeps, steps
        problem = problem.renewed(y)


def _solved(problem, rung, q, y):
    """Newton at once and, where that fails, after sweeps: the best forces, their error, sweeps and steps."""
    best, error, sweeps, steps = y, np.inf, 0, 0
    for more in rung["sweeps"] if problem.law.gauss_seidel else (0,):
        if more:
            y = _swept(problem, q, y, more)
        found, left, taken = _newton(problem, rung, q, y)
        sweeps, steps = sweeps + more, steps + taken
        if left < error:
            best, error = found, left
        if error <= rung["tol"]:
            break
    return best, error, sweeps, steps


def _swept(problem, q, y, sweeps):
    y, w, slip = y.copy(), problem.W @ y + q, np.zeros(len(problem.parameters))
    gauss_seidel(problem.W, problem.factors, problem.parameters, y, w, slip, sweeps, 1e-15)
    return y


def _newton(problem, rung, q, y):
    """Newton's method from y, whole steps: the best forces, their error and the steps taken."""
    tol, m = 0.1 * rung["tol"], len(problem.parameters)
    if not problem.law.frictional:
        batch = Batch(q[None], y[None].copy(), np.zeros(1), np.zeros(1, np.int64), np.zeros(1, np.int64))
        solve_frictionless(problem.W, batch, tol, 1)
        return batch.Y[0], batch.errors[0], int(batch.factorisations[0])
    y, w = y.copy(), problem.W @ y + q
    settings = NewtonSettings(rung["damping"], starting_scale(q), tol, float(m), rung["newton"], 0)
    coupling = Coupling(problem.W, NO_INVERSE, problem.parameters)
    return y, *newton(problem.equation, coupling, q, y, w, settings)
