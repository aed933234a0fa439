"""Iterative refinement: Newton steps of one sample with the displacement in extended precision.

A converged force may hold only relative to the largest contact (:mod:`mic.contact.contact_residual`).  With ``S f +
b`` free of cancellation, the error of a step is relative to the step, and a few steps usually make all hold.
"""

from __future__ import annotations

import numpy as np

from mic.contact.contact_residual import RESOLVED, contact_residuals, directional_stiffness, displacement_of
from mic.contact.laws import Law
from mic.contact.states import OPEN, STICK

__all__ = ["refined"]

#: Newton steps; loaded contacts above which the dense step is not tried.
STEPS, LARGEST = 6, 600
#: Rows above which a singular step is not solved by least squares.
FEW = 90


def refined(S, b, force, parameters, law: Law, dimension: int) -> np.ndarray:
    """The force (d m,) of one sample after refinement: that with the smallest of the largest residuals of a contact.

    Parameters
    ----------
    S : (d m, d m) array
        Compliance, that of the sliders' springs included.
    b, force : (d m,) array
    parameters : (m, p) array
    law : Law
    dimension : {3, 1}
    """
    every, rho = np.arange(len(S) // dimension), directional_stiffness(S, law, dimension)
    unit = np.sqrt(rho)
    if law.frictional:
        scaled = np.ascontiguousarray(law.scaled(parameters, unit[:, 0], unit[:, 1]))
    else:  # the normal rows alone
        S, b, whole, every = S[::dimension, ::dimension], b[::dimension], force, every
        force, unit, scaled, dimension = force[::dimension], unit[:, :1], parameters, 1
    best, least = force, np.inf
    for _ in range(STEPS):
        w = displacement_of(S, b, force, every, dimension)
        known = parameters, force[None], law, dimension, rho, w.astype(float).reshape(1, -1)
        largest = contact_residuals(S, b[None], *known).max()
        if not largest < least:
            break
        best, least = force, largest
        step = _step(S, w, scaled, force, law, unit) if least > RESOLVED else None
        if step is None or not np.isfinite(step).all():
            break
        force = force + step
    if law.frictional or len(best) == len(whole):
        return best
    full = np.zeros_like(whole)
    full[:: len(whole) // len(best)] = best
    return full


def _linearised(w, parameters, force, law, unit):
    """Equation Φ (m, d), its derivatives by force and displacement (m, d, d) and state (m,), in scaled variables."""
    m, d = w.shape
    y, w = force.reshape(m, d) / unit, (w * unit).astype(float)
    A, B, state = np.zeros((m, d, d)), np.zeros((m, d, d)), np.empty(m, dtype=np.int64)
    if law.frictional:
        phi = np.empty(3 * m)
        law.equation(parameters, y.ravel(), w.ravel(), phi, A, B, state, True)
        phi = phi.reshape(m, d)
    else:
        phi, state[:] = w.copy(), np.where(y[:, 0] > w[:, 0], STICK, OPEN)
    opened, stuck = state == OPEN, state == STICK
    phi[opened], phi[stuck] = y[opened], w[stuck]
    A[opened], B[opened] = np.eye(d), 0.0
    A[stuck], B[stuck] = 0.0, np.eye(d)
    return phi, A, B, state


def _step(S, w, parameters, force, law, unit):
    """(d m,) Newton step in scaled variables, as forces; None if there are too many unknowns."""
    d, D = w.shape[1], unit.ravel()
    phi, A, B, state = _linearised(w, parameters, force, law, unit)
    closed = np.flatnonzero(state != OPEN)
    if len(closed) > LARGEST:
        return None
    step = -np.where((state == OPEN)[:, None], phi, 0.0).ravel()
    if len(closed):
        rows = (d * closed[:, None] + np.arange(d)).ravel()
        # A contact that opens moves the others.
        gone = np.flatnonzero(step)
        right = phi[closed] + _times(B[closed], D[rows] * (S[np.ix_(rows, gone)] @ (D[gone] * step[gone])))
        W = (D[rows, None] * S[np.ix_(rows, rows)] * D[rows]).reshape(len(closed), d, -1)
        system = np.einsum("kij,kjl->kil", B[closed], W).reshape(len(rows), -1)
        for place, block in enumerate(A[closed]):
            system[d * place : d * place + d, d * place : d * place + d] += block
        step[rows] = _solved(system, -right.ravel())
    return step * D


def _times(blocks, vector):
    return np.einsum("kij,kj->ki", blocks, vector.reshape(len(blocks), -1))


def _solved(matrix, right):
    """Solution of a linear system, by least squares if it is singular and small."""
    if len(right) <= FEW:
        return np.linalg.lstsq(matrix, right, rcond=None)[0]
    try:
        return np.linalg.solve(matrix, right)
    except np.linalg.LinAlgError:
        return np.full(len(right), np.nan)
