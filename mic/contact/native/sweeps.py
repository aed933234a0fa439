"""Sweeps of Gauss-Seidel, which find the closed contacts, then Newton's method."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
from numba import int64, void

from mic.contact.ladder import Rung
from mic.contact.native.batch import BATCH, Batch
from mic.contact.native.gauss_seidel import gauss_seidel
from mic.contact.native.kernel import MATRIX, NUMBER, kernel
from mic.contact.native.law_equation import EQUATION_POINTER, starting_scale
from mic.contact.native.matrices import assign, displace
from mic.contact.native.newton import COUPLING, NO_INVERSE, Coupling, NewtonSettings, newton
from mic.contact.native.problem import ScaledProblem

__all__ = ["sweeps"]


@kernel(void(EQUATION_POINTER, COUPLING, MATRIX, BATCH, NUMBER, int64, int64, NUMBER), from_python=True)
def solve_by_sweeps(equation, coupling, P, batch, tol, rounds, sweeps, crowd):
    """Every sample of the batch: Gauss-Seidel, then Newton, in rounds with twice the ``sweeps`` each.

    A law whose single contact Gauss-Seidel does not solve has no ``sweeps`` and one round: Newton alone.  Where Newton
    would need the forces of more than ``crowd`` contacts at once, its steps are dear and the sample is left for
    :func:`solve_by_splitting`.
    """
    W, _, parameters = coupling
    Q, Y, errors, iterations, factorisations = batch
    slip = np.zeros(len(parameters))
    for s in range(len(Q)):
        q = Q[s]
        y = Y[s].copy()
        scale = starting_scale(q)
        w = np.empty_like(q)
        displace(W, y, q, w)
        slip[:] = 0.0
        run = sweeps
        best = np.inf
        for _ in range(rounds):
            done, _ = gauss_seidel(W, P, parameters, y, w, slip, run, 1e-15)
            iterations[s] += done
            displace(W, y, q, w)
            guess = y.copy()
            error, more = newton(equation, coupling, q, y, w, NewtonSettings(1e-12, scale, tol, crowd, 15, 0))
            iterations[s] += more
            factorisations[s] += more
            if error < best:
                best = error
                assign(Y[s], y)
            if error <= tol:
                break
            assign(y, guess)
            displace(W, y, q, w)
            run *= 2
        errors[s] = best


def sweeps(problem: ScaledProblem, rung: Rung, tol: float) -> Callable[[Batch], None]:
    """The method prepared for one problem: sweeps where the law has them, then Newton's method."""
    # Rounds differ in their sweeps alone: without them the second would repeat the first.
    rounds, number = (rung["rounds"], rung["sweeps"]) if problem.law.gauss_seidel else (1, 0)
    crowd, coupling = rung["crowd"] * len(problem.parameters), Coupling(problem.W, NO_INVERSE, problem.parameters)
    equation, factors = problem.equation, problem.factors
    return lambda batch: solve_by_sweeps(equation, coupling, factors, batch, tol, rounds, number, crowd)
