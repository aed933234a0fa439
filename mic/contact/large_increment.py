"""One increment of many contacts: the closed contacts without friction, then Newton's method for the law.

Symbols as in :mod:`mic.contact.native.problem`: ``w = W y + q``. Newton's method starts from normal forces without
friction, tangential forces of the last state, and a few Gauss-Seidel sweeps; so most contacts have their final state
after three steps. Each step factorises the matrix of the closed contacts; iterative solvers need more time, since the
compliances of deep and of local deformation differ by a factor of a million.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from mic.contact.states import OPEN, SLIP, STICK

if TYPE_CHECKING:
    from mic.contact.native.solver import NativeSolver

__all__ = ["end_forces", "forces_without_friction"]

PASSES = 30  # of the active set without friction
SWEEPS = 10  # of Gauss-Seidel before Newton's method
STEPS = 40  # of Newton's method
#: The displacement of a slider is multiplied by a weight of at most STRETCH, so that it is at least this fraction of
#: its force: the direction of its force then follows that of its motion, which halves the number of last steps.
EVEN, STRETCH = 0.3, 1e4
DAMPING = 1e-12  # added to the diagonal of W, in case it is singular


def forces_without_friction(S: np.ndarray, b: np.ndarray, force: np.ndarray) -> np.ndarray:
    """Normal forces (m,) with ``0 <= f ⊥ S f + b >= 0``, by a primal-dual active set; the last ones if it cycles.

    Hintermüller, Ito and Kunisch, The primal-dual active set strategy as a semismooth Newton method, SIAM J. Optim. 13
    (2003).

    Parameters
    ----------
    S : (m, m) array
        Compliance of the normal rows, mm/N.
    b : (m,) array
        Gaps without contact forces, mm.
    force : (m,) array
        Initial normal forces, N.
    """
    from scipy.linalg import solve  # slow to import

    stiffness = 1.0 / np.maximum(S.diagonal(), np.finfo(float).tiny)
    closed = force > stiffness * (S @ force + b)
    for _ in range(PASSES):
        own = np.flatnonzero(closed)
        rows = S[own]
        matrix = rows[:, own]
        matrix[np.diag_indices(len(own))] *= 1.0 + DAMPING
        force = np.zeros(len(b))
        try:
            force[own] = solve(matrix, -b[own], assume_a="pos", overwrite_a=True, check_finite=False)
        except np.linalg.LinAlgError:  # singular to rounding
            break
        before, closed = closed, force > stiffness * (force[own] @ rows + b)
        if (closed == before).all():
            break
    return np.maximum(force, 0.0)


def end_forces(
    backend: NativeSolver, b: np.ndarray, guess: np.ndarray, near: bool, tol: float
) -> tuple[np.ndarray, int]:
    """Forces (3m,) at the end of an increment, N, those with the least error if Newton's method fails; and its steps.

    Parameters
    ----------
    backend : mic.contact.native.solver.NativeSolver
    b : (3m,) array
        Displacements without contact forces, relative to the anchors, mm.
    guess : (3m,) array
        Initial forces, N.
    near : bool
        Whether they solve the problem of fewer candidates, so that no sweeps are needed.
    tol : float
        Norm of the law's equations to reach, relative to that of the forces.
    """
    from mic.contact.native.gauss_seidel import gauss_seidel
    from mic.contact.native.law_equation import derivative, force_scale, starting_scale
    from mic.contact.native.linear_step import linear_step
    from mic.contact.native.matrices import times

    problem, unit = backend.problem, backend.scaling
    W, parameters, m = problem.W, problem.parameters, len(problem.parameters)
    q, y, w, change = b * unit, guess / unit, np.empty(3 * m), np.empty(3 * m)
    phi, A, B, state = np.empty(3 * m), np.empty((m, 3, 3)), np.empty((m, 3, 3)), np.empty(m, np.int64)
    if problem.law.gauss_seidel and not near:
        times(W, y, w)
        w += q
        gauss_seidel(W, problem.factors, parameters, y, w, np.zeros(m), SWEEPS, 1e-15)
    scale, least, best, steps = starting_scale(q), np.inf, y, 0
    while True:
        times(W, y, w)
        w += q
        derivative(problem.equation, parameters, y, w, phi, A, B, state)
        error = np.linalg.norm(phi) / max(force_scale(scale, q, y, w), np.finfo(float).tiny)
        if error < least:
            least, best = error, y.copy()
        if error <= tol or not np.isfinite(error) or steps == STEPS:
            return best * unit, steps
        weight = np.ones((m, 3))
        weight[:, 1:] = np.clip(EVEN * _tangential(y) / np.maximum(_tangential(w), 1e-300), 1.0, STRETCH)
        derivative(problem.equation, parameters, y, w * weight.ravel(), phi, A, B, state)
        slides, sticks = state == SLIP, state == STICK
        B[slides] *= weight[slides, None]
        phi.reshape(m, 3)[sticks] = w.reshape(m, 3)[sticks]
        linear_step(W, A, B, phi, state, OPEN, y, DAMPING, False, change)
        y, steps = y + change, steps + 1


def _tangential(z: np.ndarray) -> np.ndarray:
    """(m, 1) norms of the tangential parts of (3m,)."""
    return np.hypot(z[1::3], z[2::3])[:, None]
