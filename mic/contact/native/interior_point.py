r"""A primal-dual interior-point method for the conic laws, Coulomb's included.

It costs a dense factorisation per step, some tens in all, so it serves the problems on which cheap iterations stall:
many more contacts than degrees of freedom, jammed piles.  Its iterates approach the middle of the set of solutions,
where stuck contacts are strictly inside their cones; from there one Newton step usually lands exactly.

In the variables ``z = T⁻¹ y``, ``v = T ŵ`` with ``T_k = diag(1, μ, μ) / max(1, μ)`` both cones become the Lorentz cone
``L = {z_0 >= ‖z_t‖}`` and the law reads

.. math::

    L \ni z \perp v \in L, \qquad v = A z + q + s \|v_t\| e_0 + h, \quad A = T W T,

with the law's share ``s`` of De Saxcé's shift, 1 for Coulomb's law (Acary, Armand, Nguyen and Shpakovych 2022), and a
shift ``h`` that is held.  Each step linearises ``z ∘ v = σ τ e`` in the Nesterov-Todd scaling, ``M z = v``,

.. math::

    (M + (I + G) A) \, dz = R\,r_c + (I + G) r, \quad dv = R\,r_c - M dz, \quad G = s e_0 (0, v_t/\|v_t\|)^T,

with ``G² = 0``, ``r`` the residual of the equation for ``v``, and Mehrotra's predictor and corrector for ``σ`` and
``r_c``.
"""

from __future__ import annotations

import warnings

import numpy as np
from scipy.linalg import LinAlgWarning, lu_factor, lu_solve

__all__ = ["interior_point"]

_REFLECTION = np.diag([1.0, -1.0, -1.0])


@np.errstate(over="ignore", invalid="ignore", divide="ignore")  # an infeasible problem sends forces to infinity
def interior_point(W, q, mu, shift, held=None, *, tol, steps):
    """Solve one sample in scaled variables.

    Parameters
    ----------
    W : (3m, 3m) array
    q : (3m,) array
    mu : (m,) array
    shift : float
        Share ``s`` of De Saxcé's shift ``μ‖w_t‖`` that follows the solution; 0 leaves a convex problem.
    held : (m,) array, optional
        Slips whose shift ``μ held`` does not follow it.
    tol : float
        On complementarity and residual, relative to ``q``.
    steps : int

    Returns
    -------
    (3m,) array
        Scaled forces, strictly inside their cones.
    int
        Steps taken.
    """
    m = len(mu)
    contacts = np.arange(m)
    cone = np.column_stack([np.ones(m), mu, mu]) / np.maximum(1.0, mu)[:, None]
    T = cone.ravel()
    load = q * T
    if held is not None:
        load[::3] += held * cone[:, 1]
    size = np.linalg.norm(load) / np.sqrt(m)
    if size == 0.0:
        return np.zeros_like(q), 0
    load = (load / size).reshape(m, 3)
    A = W * T[:, None] * T
    z, v = np.zeros((m, 3)), np.zeros((m, 3))
    z[:, 0] = v[:, 0] = 1.0
    step = stalled = 0
    for step in range(steps):  # noqa: B007  (the count is returned)
        slip = np.hypot(v[:, 1], v[:, 2])
        residual = v - load - (A @ z.ravel()).reshape(m, 3)
        if shift:
            residual[:, 0] -= shift * slip
        gap = np.sum(z * v) / m
        if max(gap, np.linalg.norm(residual) / np.sqrt(m)) < tol:
            break
        M, R, R_inverse = _nesterov_todd(z, v)
        scaled = _apply(R, z)
        K = A.reshape(m, 3, 3 * m)
        right = residual
        if shift:
            direction = shift * v[:, 1:] / np.where(slip > 0.0, slip, 1.0)[:, None]
            K, right = K.copy(), residual.copy()
            K[:, 0] += direction[:, :1] * K[:, 1] + direction[:, 1:] * K[:, 2]
            right[:, 0] += np.sum(direction * residual[:, 1:], axis=1)
        K = np.array(K.reshape(m, 3, m, 3))
        K[contacts, :, contacts, :] += M
        with warnings.catch_warnings():
            warnings.simplefilter("ignore", LinAlgWarning)
            factors = lu_factor(K.reshape(3 * m, 3 * m), overwrite_a=True, check_finite=False)

        def newton_step(target, factors=factors, R=R, M=M, right=right):
            force = _apply(R, target)
            dz = lu_solve(factors, (force + right).ravel(), check_finite=False).reshape(m, 3)
            return dz, force - _apply(M, dz)

        dz, dv = newton_step(-scaled)
        reach = min(1.0, _distance_to_boundary(z, dz), _distance_to_boundary(v, dv))
        target = -_jordan_product(_apply(R, dz), _apply(R_inverse, dv))
        target[:, 0] += max((1.0 - reach) ** 3, 1e-6) * gap
        dz, dv = newton_step(_jordan_quotient(target, scaled) - scaled)
        reach = min(1.0, max(0.9, 1.0 - gap) * min(_distance_to_boundary(z, dz), _distance_to_boundary(v, dv)))
        stalled = stalled + 1 if reach < 1e-3 else 0
        new_z, new_v = z + reach * dz, v + reach * dv
        if stalled > 5 or not (_inside(new_z) and _inside(new_v)):
            break
        z, v = new_z, new_v
    return z.ravel() * T * size, step


def _apply(blocks, x):
    return np.einsum("kij,kj->ki", blocks, x)


def _determinant(x):
    """``x_0² - ‖x_t‖²``, positive inside the cone, without cancellation."""
    tangential = np.hypot(x[:, 1], x[:, 2])
    return (x[:, 0] - tangential) * (x[:, 0] + tangential)


def _inside(x):
    return np.isfinite(x).all() and (x[:, 0] > np.hypot(x[:, 1], x[:, 2])).all()


def _nesterov_todd(z, v):
    """``M`` with ``M z = v``, its symmetric root ``R`` and ``R⁻¹``, one 3 × 3 block per contact."""
    det_z, det_v = _determinant(z), _determinant(v)
    z_unit, v_unit = z / np.sqrt(det_z)[:, None], v / np.sqrt(det_v)[:, None]
    w = v_unit + z_unit @ _REFLECTION
    w /= np.sqrt(2.0 + 2.0 * np.sum(z_unit * v_unit, axis=1))[:, None]
    root = w + [1.0, 0.0, 0.0]
    root /= np.sqrt(2.0 * (w[:, 0] + 1.0))[:, None]
    stretch = (det_v / det_z) ** 0.25
    M = stretch[:, None, None] ** 2 * (2.0 * w[:, :, None] * w[:, None, :] - _REFLECTION)
    unit = 2.0 * root[:, :, None] * root[:, None, :] - _REFLECTION
    return M, stretch[:, None, None] * unit, (_REFLECTION @ unit @ _REFLECTION) / stretch[:, None, None]


def _jordan_product(x, y):
    product = x[:, :1] * y + y[:, :1] * x
    product[:, 0] = np.sum(x * y, axis=1)
    return product


def _jordan_quotient(x, y):
    """The ``a`` with ``y ∘ a = x``."""
    quotient = np.empty_like(x)
    quotient[:, 0] = (y[:, 0] * x[:, 0] - np.sum(y[:, 1:] * x[:, 1:], axis=1)) / _determinant(y)
    quotient[:, 1:] = (x[:, 1:] - y[:, 1:] * quotient[:, :1]) / y[:, :1]
    return quotient


def _distance_to_boundary(x, d):
    """Largest ``α`` with ``x + α d`` in every cone; infinite if there is none."""
    a = _determinant(d)
    b = x[:, 0] * d[:, 0] - x[:, 1] * d[:, 1] - x[:, 2] * d[:, 2]
    c = _determinant(x)
    root = np.sqrt(b * b - a * c)
    half = -(b + np.copysign(root, b))
    roots = np.stack([half / a, c / half])
    return np.min(roots, initial=np.inf, where=roots > 0.0)
