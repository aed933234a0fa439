"""Contact without friction: projected Gauss-Seidel, then Newton's method on the active set."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
from numba import int64, void

from mic.contact.ladder import Rung
from mic.contact.native.batch import BATCH, Batch
from mic.contact.native.kernel import MATRIX, NUMBER, kernel
from mic.contact.native.lapack import solution
from mic.contact.native.law_equation import force_scale, relative
from mic.contact.native.matrices import assign
from mic.contact.native.problem import ScaledProblem

__all__ = ["active_set", "solve_frictionless"]


@kernel(void(MATRIX, BATCH, NUMBER, int64), from_python=True)
def solve_frictionless(W, batch, tol, rounds):
    """Every sample of the batch, ``0 <= y ⊥ W y + q >= 0``: projected Gauss-Seidel, then Newton on the active set.

    ``W`` (m, m) holds the normal rows only.
    """
    Q, Y, errors, iterations, factorisations = batch
    m = len(W)
    active = np.empty(m, np.int64)
    for s in range(len(Q)):
        q = Q[s]
        y = Y[s].copy()
        scale = np.linalg.norm(np.minimum(q, 0.0))
        w = np.dot(W, y) + q
        total, sweeps = 0, 5
        best = np.inf
        for _ in range(rounds):
            for _ in range(sweeps):
                for i in range(m):
                    if W[i, i] <= 0.0 or (y[i] == 0.0 and w[i] >= 0.0):
                        continue
                    change = max(y[i] - w[i] / W[i, i], 0.0) - y[i]
                    if change != 0.0:
                        y[i] += change
                        for j in range(m):
                            w[j] += change * W[i, j]
            total += sweeps
            guess = y.copy()
            w = np.dot(W, y) + q
            for _ in range(12):
                error = np.linalg.norm(np.minimum(y, w))
                size = force_scale(scale, q, y, w)
                error = relative(error, size)
                if error < best:
                    best = error
                    assign(Y[s], y)
                if error <= tol:
                    break
                count = 0
                for i in range(m):
                    if y[i] > w[i]:
                        active[count] = i
                        count += 1
                J = np.empty((count, count))
                r = np.empty((count, 1))
                for a in range(count):
                    i = active[a]
                    r[a, 0] = -q[i] + 1e-12 * y[i]
                    for b in range(count):
                        J[a, b] = W[i, active[b]]
                    J[a, a] += 1e-12
                d = solution(J, r)
                y[:] = 0.0
                for a in range(count):
                    y[active[a]] = d[a, 0]
                w = np.dot(W, y) + q
                total += 1
                factorisations[s] += 1
            if best <= tol:
                break
            assign(y, guess)
            w = np.dot(W, y) + q
            sweeps *= 2
        errors[s] = best
        iterations[s] += total


def active_set(problem: ScaledProblem, rung: Rung, tol: float) -> Callable[[Batch], None]:
    """The method prepared for one problem."""
    return lambda batch: solve_frictionless(problem.W, batch, tol, rung["rounds"])
