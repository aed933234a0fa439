"""Splitting (over-relaxed ADMM), each step of which is one product with a matrix that all samples share."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
from numba import int64, void

from mic.contact.ladder import Rung
from mic.contact.native.batch import BATCH, Batch
from mic.contact.native.kernel import MATRIX, NUMBER, VECTOR, kernel
from mic.contact.native.law_equation import EQUATION_POINTER, starting_scale
from mic.contact.native.matrices import TOGETHER, assign, displace, times_together
from mic.contact.native.newton import COUPLING, Coupling, NewtonSettings, newton
from mic.contact.native.problem import ScaledProblem

__all__ = ["splitting"]


@kernel(void(NUMBER, VECTOR, MATRIX, NUMBER, VECTOR, VECTOR, VECTOR, VECTOR))
def _split(shift, q, parameters, rho, z, l, r, x):
    """A step of over-relaxed ADMM, in place, with ``x = (W + ρ I)⁻¹ r``.

    ``x̂ = 1.6 x - 0.6 z``; ``z = P_K(x̂ + l/ρ)``; ``l += ρ (x̂ - z)``, which tends to ``-ŵ``, so that De Saxcé's shift is
    ``μ‖l_t‖``; ``r = ρ z - l - q - s μ‖l_t‖ n`` with the law's ``shift`` ``s``.
    """
    for k in range(len(parameters)):
        i = 3 * k
        mu = parameters[k, 0]
        v0 = 1.6 * x[i] - 0.6 * z[i] + l[i] / rho
        v1 = 1.6 * x[i + 1] - 0.6 * z[i + 1] + l[i + 1] / rho
        v2 = 1.6 * x[i + 2] - 0.6 * z[i + 2] + l[i + 2] / rho
        t = np.sqrt(v1 * v1 + v2 * v2)
        if mu * t <= -v0:
            z0, shrink = 0.0, 0.0
        elif t <= mu * v0:
            z0, shrink = v0, 1.0
        else:
            z0 = (v0 + mu * t) / (1.0 + mu * mu)
            shrink = mu * z0 / t
        z[i], z[i + 1], z[i + 2] = z0, shrink * v1, shrink * v2
        l[i], l[i + 1], l[i + 2] = rho * (v0 - z0), rho * (1.0 - shrink) * v1, rho * (1.0 - shrink) * v2
        opening = shift * mu * np.sqrt(l[i + 1] * l[i + 1] + l[i + 2] * l[i + 2])
        r[i] = rho * z0 - l[i] - q[i] - opening
        r[i + 1] = rho * z[i + 1] - l[i + 1] - q[i + 1]
        r[i + 2] = rho * z[i + 2] - l[i + 2] - q[i + 2]


@kernel(void(EQUATION_POINTER, COUPLING, MATRIX, NUMBER, NUMBER, BATCH, NUMBER, int64, int64), from_python=True)
def solve_by_splitting(equation, coupling, resolvent, rho, shift, batch, tol, steps, rounds):
    """Every sample of the batch: splitting, then Newton, in rounds with twice the splitting ``steps`` each.

    Some samples take the steps of the splitting together, in one pass over the resolvent; each remains what it is
    alone.
    """
    W, _, parameters = coupling
    Q, Y, errors, iterations, factorisations = batch
    crowd = float(len(parameters))
    for first in range(0, len(Q), TOGETHER):
        own = np.arange(first, min(first + TOGETHER, len(Q)))
        Z, run = Y[own], steps
        L, X, R = np.zeros_like(Z), np.empty_like(Z), rho * Z - Q[own]
        errors[own] = np.inf
        for _ in range(rounds):
            for _ in range(run):
                times_together(resolvent, R, X)
                for s in range(len(own)):
                    _split(shift, Q[own[s]], parameters, rho, Z[s], L[s], R[s], X[s])
            for s in range(len(own)):
                k, y, w = own[s], Z[s].copy(), np.empty(len(W))
                scale = starting_scale(Q[k])
                displace(W, y, Q[k], w)
                error, more = newton(equation, coupling, Q[k], y, w, NewtonSettings(1e-12, scale, tol, crowd, 15, 0))
                iterations[k] += run + more
                factorisations[k] += more
                if error < errors[k]:
                    errors[k] = error
                    assign(Y[k], y)
            left = np.flatnonzero(errors[own] > tol)
            own, Z, L, R, X = own[left], Z[left], L[left], R[left], X[left]
            run *= 2


def splitting(problem: ScaledProblem, rung: Rung, tol: float) -> Callable[[Batch], None]:
    """The method prepared for one problem."""
    inverse, resolvent, rho = problem.splitting
    coupling, equation, shift = Coupling(problem.W, inverse, problem.parameters), problem.equation, problem.law.shift
    settings = tol, rung["steps"], rung["rounds"]
    return lambda batch: solve_by_splitting(equation, coupling, resolvent, rho, shift, batch, *settings)
