"""Sweeps of Gauss-Seidel, which find the closed contacts, then Newton's method."""

from __future__ import annotations

import numpy as np
from numba import int64, void

from mic.contact.native.gauss_seidel import gauss_seidel
from mic.contact.native.kernel import COUNTS, MATRIX, NUMBER, VECTOR, kernel
from mic.contact.native.law_equation import EQUATION_POINTER, starting_scale
from mic.contact.native.matrices import times
from mic.contact.native.newton import newton

__all__ = ["solve_by_sweeps"]


@kernel(
    void(
        EQUATION_POINTER,
        MATRIX,
        MATRIX,
        MATRIX,
        MATRIX,
        MATRIX,
        NUMBER,
        int64,
        int64,
        NUMBER,
        VECTOR,
        COUNTS,
        COUNTS,
    )
)
def solve_by_sweeps(equation, W, P, Q, parameters, Y, tol, rounds, sweeps, crowd, errors, iterations, factorisations):
    """Every sample of the batch: Gauss-Seidel, then Newton, in rounds with twice the ``sweeps`` each.

    ``Y`` holds the initial guess and receives the forces.  A law whose single contact Gauss-Seidel does not solve has
    no ``sweeps`` and one round: Newton alone.  Where Newton would need the forces of more than ``crowd`` contacts at
    once, its steps are dear and the sample is left for :func:`solve_by_splitting`.
    """
    m = len(parameters)
    slip = np.zeros(m)
    none, every = np.empty((0, 0)), np.empty(0, np.int64)
    for s in range(len(Q)):
        q = Q[s]
        y = Y[s].copy()
        scale = starting_scale(q)
        w = np.empty_like(q)
        times(W, y, w)
        w += q
        slip[:] = 0.0
        run = sweeps
        best = np.inf
        for _ in range(rounds):
            done, _ = gauss_seidel(W, every, every, P, parameters, y, w, slip, run, 1e-15)
            iterations[s] += done
            times(W, y, w)
            w += q
            guess = y.copy()
            error, more = newton(equation, W, none, q, parameters, y, w, 1e-12, scale, tol, 15, 0, crowd)
            iterations[s] += more
            factorisations[s] += more
            if error < best:
                best = error
                Y[s] = y
            if error <= tol:
                break
            y[:] = guess
            times(W, y, w)
            w += q
            run *= 2
        errors[s] = best
