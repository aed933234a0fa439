r"""Coulomb's law with a coefficient that depends on pressure: ``‖f_t‖ <= g(f_n)``, ``g(f_n) = μ(f_n/A) f_n``.

A force satisfies it exactly if it satisfies Coulomb's law with the coefficients ``μ_k = μ(f_n,k/A_k)`` at that force;
so the certificate is Coulomb's, with these coefficients.

The function is piecewise.  Piece ``j`` is valid from its start to that of the next piece; with the argument x
(pressure, normal force or scaled normal force),

.. math:: \mu(x) = \alpha + \beta x + \gamma x^{-n};

its row is ``(start, α, β, γ, n)``; the first starts at 0, and padding rows start at infinity.  A table consists of
constant and linear pieces, a bounded power law of two constant pieces and the power function between them.

*Existence*: with ``S`` positive definite and ``g`` continuous there is a solution.  For fixed bounds ``s``, Tresca's
problem ``min ½ fᵀ S f + bᵀ f`` over ``f_n >= 0``, ``‖f_t‖ <= s`` has a unique solution ``f(s)``; it depends
continuously on ``s`` and, as ``f = 0`` is admissible, ``‖f(s)‖ <= 2‖b‖/λ_min(S)`` whatever ``s``.  Brouwer's theorem
gives an ``s = g(f_n(s))``.  *Uniqueness*: ``u(s)`` changes by at most ``λ_max(S) ‖s - s'‖``, so ``f(s)`` by ``cond(S)
‖s - s'‖``, and the solution is unique if ``cond(S) sup|g'| < 1``: for low friction, as with Coulomb's law.

``g`` must not decrease: a contact under more pressure would hold less, and slip would begin with a jump.  The real
contact area does not decrease with pressure (Bowden and Tabor 1950), and neither does ``g``.
"""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np

from mic.contact.friction import Friction
from mic.contact.laws.law import Law
from mic.contact.states import OPEN, SLIP, STICK

__all__ = ["PRESSURE_DEPENDENT", "equation", "power", "rescaled", "table"]

#: Decrease of a bound that counts as rounding, relative to μ: for tables with constant μ p.
FALLS = 1e-9


def equation(parameters, y, w, phi, A, B, state, derivative):
    """``Φ_n = y_n - max(a, 0)``, ``Φ_t = y_t - P_ball(g(max(a, 0)))(v)``, and ``dΦ = A dy + B dw``.

    ``a = y_n - w_n`` and ``v = y_t - w_t``.  Arguments as in :func:`mic.contact.laws.coulomb.equation`; a row of
    ``parameters`` holds the coefficient for methods with a fixed one, then the pieces.
    """
    columns = parameters.shape[1]
    for k in range(len(state)):
        i = 3 * k
        a = y[i] - w[i]
        v1, v2 = y[i + 1] - w[i + 1], y[i + 2] - w[i + 2]
        t = math.sqrt(v1 * v1 + v2 * v2)
        if a <= 0.0:
            state[k] = OPEN
        else:
            j = 1
            while j + 5 < columns and parameters[k, j + 5] <= a:
                j += 5
            rest = 0.0
            if parameters[k, j + 3] != 0.0:
                rest = parameters[k, j + 3] * a ** (-parameters[k, j + 4])
            linear = parameters[k, j + 2] * a
            bound = (parameters[k, j + 1] + linear + rest) * a
            if t <= bound:
                state[k] = STICK
            else:
                state[k] = SLIP
                e1, e2 = v1 / t, v2 / t
                phi[i] = w[i]  # y_n - a
                phi[i + 1] = y[i + 1] - bound * e1
                phi[i + 2] = y[i + 2] - bound * e2
                if derivative:
                    # B: derivative of (a, P_ball(g(a))(v)) by y - w; A = I - B.
                    slope = parameters[k, j + 1] + 2.0 * linear + (1.0 - parameters[k, j + 4]) * rest
                    r = bound / t
                    B[k, 0, 0], B[k, 0, 1], B[k, 0, 2] = 1.0, 0.0, 0.0
                    B[k, 1, 0], B[k, 1, 1], B[k, 1, 2] = slope * e1, r - r * e1 * e1, -r * e1 * e2
                    B[k, 2, 0], B[k, 2, 1], B[k, 2, 2] = slope * e2, -r * e1 * e2, r - r * e2 * e2
                    for row in range(3):
                        for column in range(3):
                            A[k, row, column] = -B[k, row, column]
                        A[k, row, row] += 1.0


def table(points: Sequence[tuple[float, float]]) -> np.ndarray:
    """Pieces of a piecewise linear function of pressure, constant outside its points.

    Parameters
    ----------
    points : sequence of (pressure, coefficient)
        Both ``>= 0``, pressures rising [force / length², 1].

    Returns
    -------
    (q, 5) array

    Raises
    ------
    ValueError
        For unsorted points, negative numbers, and a bound ``μ(p) p`` that decreases.
    """
    p, mu = np.array(points, dtype=float).reshape(-1, 2).T
    if not len(p):
        raise ValueError("needs at least one point [pressure, coefficient]")
    if (p < 0.0).any() or (mu < 0.0).any():
        raise ValueError("pressures and coefficients must not be negative")
    if (np.diff(p) <= 0.0).any():
        raise ValueError("pressures must rise from point to point")
    slope = np.diff(mu) / np.diff(p)
    for i, rate in enumerate(slope):  # (μ p)' = μ + p dμ/dp is linear between two points, and least at the second
        if mu[i + 1] + p[i + 1] * rate < -FALLS * mu[i]:
            raise ValueError(
                f"the friction bound μ p must not fall with pressure, and does between {p[i]:g} and {p[i + 1]:g} MPa "
                f"(μ from {mu[i]:g} to {mu[i + 1]:g}); let μ fall more slowly, or give points between"
            )
    pieces = [(start, m - s * start, s, 0.0, 0.0) for start, m, s in zip(p, mu, slope)]
    pieces.append((p[-1], mu[-1], 0.0, 0.0, 0.0))
    if p[0] > 0.0:
        pieces.insert(0, (0.0, mu[0], 0.0, 0.0, 0.0))
    return np.array(pieces)


def power(mu0: float, p0: float, n: float, mu_min: float, mu_max: float) -> np.ndarray:
    """Pieces of ``μ(p) = μ0 (p/p0)^(-n)``, bounded to ``[μ_min, μ_max]``.

    Returns
    -------
    (q, 5) array

    Raises
    ------
    ValueError
        For ``n > 1``, where the bound ``μ(p) p`` decreases, ``n = 0``, and unsorted limits.
    """
    if not (mu0 > 0.0 and p0 > 0.0 and 0.0 <= mu_min <= mu_max and mu_max > 0.0):
        raise ValueError("mu0 and p0 must be positive, and 0 <= mu_min <= mu_max > 0")
    if n == 0.0:
        raise ValueError("with n = 0 friction does not depend on pressure; give friction a number instead")
    if n > 1.0:
        raise ValueError(f"the friction bound μ p must not fall with pressure, and does with n = {n:g}; n is at most 1")

    def pressure(mu):  # at which μ0 (p/p0)^(-n) = mu
        with np.errstate(divide="ignore", over="ignore"):
            return p0 * float(np.float64(mu / mu0) ** (-1.0 / n))

    low, high = (mu_max, mu_min) if n > 0.0 else (mu_min, mu_max)
    pieces = [
        (0.0, low, 0.0, 0.0, 0.0),
        (pressure(low), 0.0, 0.0, mu0 * p0**n, n),
        (pressure(high), high, 0.0, 0.0, 0.0),
    ]
    # A limit that is never reached starts at infinity; one that always applies starts at 0 and hides earlier pieces.
    return np.array(pieces)


def rescaled(pieces: np.ndarray, factor: np.ndarray | float) -> np.ndarray:
    """The pieces as a function of x, given as a function of ``factor · x``: pressure is force times ``1/A``.

    Parameters
    ----------
    pieces : (..., q, 5) array
    factor : float or array that broadcasts with the leading axes
        Positive.
    """
    s = np.asarray(factor, dtype=float)[..., None]
    start, alpha, beta, gamma, n = np.moveaxis(np.asarray(pieces, dtype=float), -1, 0)
    return np.stack(np.broadcast_arrays(start / s, alpha, beta * s, gamma * s**-n, n), axis=-1)


def _parameters(friction: Friction) -> np.ndarray:
    """(m, 1 + 5 q): the coefficient of the unloaded contact, for methods with a fixed one, then the pieces."""
    m, pieces = len(friction), friction.pressure
    if pieces is None:
        pieces = np.zeros((m, 1, 5))
        pieces[:, 0, 1] = friction.coefficient
    padded = np.concatenate([np.zeros((m, 1)), pieces.reshape(m, 5 * pieces.shape[1])], axis=1)
    padded[:, 0] = _coefficient(padded, np.zeros(m))
    return padded


def _pieces(parameters):
    m, p = parameters.shape
    return parameters[:, 1:].reshape(m, (p - 1) // 5, 5)


def _scaled(parameters, d_n, d_t):
    """``μ' = μ d_n/d_t`` as a function of ``y_n = f_n/d_n``."""
    pieces = rescaled(_pieces(parameters), d_n)
    pieces[..., 1:4] *= (d_n / d_t)[:, None, None]
    return np.concatenate([parameters[:, :1] * (d_n / d_t)[:, None], pieces.reshape(parameters[:, 1:].shape)], axis=1)


def _terms(parameters, normal):
    """α, β x, γ x⁻ⁿ and n of the pieces that apply at the normal forces x (..., m)."""
    pieces = _pieces(parameters)
    x = np.maximum(normal, 0.0)
    piece = np.maximum((x[..., None] >= pieces[..., 0]).sum(axis=-1) - 1, 0)
    _, alpha, beta, gamma, n = np.moveaxis(pieces[np.arange(len(pieces)), piece], -1, 0)
    x = np.where((gamma != 0.0) & (x == 0.0) & (n > 0.0), np.finfo(float).tiny, x)
    return alpha, beta * x, np.where(gamma != 0.0, gamma * x**-n, 0.0), n


def _coefficient(parameters, normal):
    alpha, linear, rest, _ = _terms(parameters, normal)
    return alpha + linear + rest


def _slope(parameters, normal):
    alpha, linear, rest, n = _terms(parameters, normal)
    return alpha + 2.0 * linear + (1.0 - n) * rest


PRESSURE_DEPENDENT = Law(
    name="pressure-dependent",
    title="Coulomb's law with a coefficient that depends on pressure, from a table or a power law.",
    colour="#009e73",
    mark="D",
    shift=1.0,
    equation=equation,
    gauss_seidel=True,
    reads="pressure",
    followed=True,
    parameters=_parameters,
    scaled=_scaled,
    coefficient=_coefficient,
    slope=_slope,
)
