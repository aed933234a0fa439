r"""Equations of contacts in known states, with their derivatives, for one step of a path.

They stand in :mod:`mic.contact.tangent`. Of one contact, linearised at (f, w), where f⁰ are the forces when the step
begins and κ is the contact's own compliance,

    P df + Q dw + P⁰ df⁰ + r (dμ, dκ) = -R.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import NamedTuple

import numpy as np
from numba import boolean, int64, types, void

from mic.contact.native.kernel import BLOCKS, COUNTS, MASK, MATRIX, NUMBER, VECTOR, kernel
from mic.contact.native.law_equation import EQUATION_POINTER
from mic.contact.native.slider_lag import lag_and_slope
from mic.contact.states import LOADED, ON_CONE, OPEN, SLIP, STICK

__all__ = ["CONTACTS", "EQUATIONS", "Equations", "LinearisedContacts", "bound", "equations", "on_cone", "states"]

#: A tangential force that is beyond every bound, in normal forces.
BEYOND = 1e6


class LinearisedContacts(NamedTuple):
    """m contacts of d rows, 1 without friction and otherwise 3, with derivatives by p inputs.

    Attributes
    ----------
    equation, coefficient_varies, shift
        The law's.
    S : (d m, d m) array
        mm/N, symmetric.
    length : (m,) array
        The contacts' own compliance κ, mm/N.
    parameters : (m, ...) array
        Of the law.
    rougher, softer : (m, p) array
        Derivatives of the coefficients of friction and of κ.
    left, right, inputs : (l, d m), (l, d m), (l,) array
        Changes of S, each an input's: ``left rightᵀ`` per unit.
    """

    equation: Callable
    coefficient_varies: bool
    shift: float
    S: np.ndarray
    length: np.ndarray
    parameters: np.ndarray
    rougher: np.ndarray
    softer: np.ndarray
    left: np.ndarray
    right: np.ndarray
    inputs: np.ndarray


class Equations(NamedTuple):
    """Linearised equations of m contacts, of which those of closed ones are filled.

    Attributes
    ----------
    P, Q, P0 : (m, d, d) array
    R : (m, d) array
        Residuals, mm.
    r : (m, d, 2) array
    """

    P: np.ndarray
    Q: np.ndarray
    P0: np.ndarray
    R: np.ndarray
    r: np.ndarray


class Way(NamedTuple):
    """Tangential displacement of a slider from where its slip is measured, ``w' = w_t + λ e``.

    Attributes
    ----------
    w, e : (2,) array
    by_w, by_f, by_f0 : (2, 2) array
        Derivatives by ``w_t``, ``f_t`` and ``f⁰_t``.
    by_length : float
        Derivative of λ by the contact's own compliance.
    """

    w: np.ndarray
    e: np.ndarray
    by_w: np.ndarray
    by_f: np.ndarray
    by_f0: np.ndarray
    by_length: float


CONTACTS = types.NamedTuple(
    [EQUATION_POINTER, boolean, NUMBER, MATRIX, VECTOR, *5 * (MATRIX,), COUNTS], LinearisedContacts
)
EQUATIONS = types.NamedTuple([BLOCKS, BLOCKS, BLOCKS, MATRIX, BLOCKS], Equations)
WAY = types.NamedTuple([VECTOR, VECTOR, MATRIX, MATRIX, MATRIX, NUMBER], Way)
#: κ, μ, 1 - σ, g and g' of a slider.
SLIDER = types.UniTuple(NUMBER, 5)


@kernel(types.UniTuple(NUMBER, 2)(CONTACTS, int64, NUMBER))
def bound(contacts, k, normal):
    """``g(f_n)`` of contact k, and ``g'``: the law's equation tells both where it varies, of a force far outside."""
    if not contacts.coefficient_varies:
        return contacts.parameters[k, 0] * normal, contacts.parameters[k, 0]
    y, phi, state = np.zeros(3), np.zeros(3), np.zeros(1, np.int64)
    A, B = np.zeros((1, 3, 3)), np.zeros((1, 3, 3))
    y[0] = max(normal, 1e-200)
    y[1] = BEYOND * y[0]
    contacts.equation(contacts.parameters[k : k + 1], y, np.zeros(3), phi, A, B, state, True)
    return B[0, 2, 2] * y[1] if normal > 0.0 else 0.0, B[0, 1, 0]


@kernel(WAY(VECTOR, VECTOR, VECTOR, boolean, NUMBER))
def _way(f, w, f0, turns, κ):
    """Where a contact of force f and displacement w (3,) has slid; only one that ``turns`` has a shift λ e."""
    v, e, by_κ = w[1:].copy(), np.zeros(2), 0.0
    D, E, E0 = np.eye(2), np.zeros((2, 2)), np.zeros((2, 2))
    if turns:
        t = np.sqrt(f[1] * f[1] + f[2] * f[2])
        t0 = np.sqrt(f0[1] * f0[1] + f0[2] * f0[2])
        e[0], e[1] = f0[1] / t0, f0[2] / t0
        l = -(e[0] * w[1] + e[1] * w[2])
        z = l / (0.5 * κ * (t0 + t))
        φ, dφ = lag_and_slope(z)
        λ, by_l, by_c, by_κ = φ * l, φ + dφ * z, -dφ * z * z * 0.5 * κ, -dφ * z * l / κ
        across = e[1] * w[1] - e[0] * w[2]  # of w_t
        for i in range(2):
            v[i] += λ * e[i]
            for j in range(2):
                D[i, j] -= by_l * e[i] * e[j]
                E[i, j] = e[i] * by_c * f[1 + j] / t
            E0[i, 0] = e[i] * (by_c * e[0] - by_l * across * e[1] / t0)
            E0[i, 1] = e[i] * (by_c * e[1] + by_l * across * e[0] / t0)
        E0[0, 0] += λ * e[1] * e[1] / t0
        E0[0, 1] -= λ * e[0] * e[1] / t0
        E0[1, 0] -= λ * e[0] * e[1] / t0
        E0[1, 1] += λ * e[0] * e[0] / t0
    return Way(v, e, D, E, E0, by_κ)


@kernel(void(VECTOR, VECTOR, WAY, SLIDER, EQUATIONS, int64))
def _slip(f, w, way, slider, into, k):
    """Fill the equations of a contact k that slips under load."""
    κ, μ, share, g, rise = slider
    P, Q, P0, R, r = into.P[k], into.Q[k], into.P0[k], into.R[k], into.r[k]
    v, e, D, E, E0 = way.w, way.e, way.by_w, way.by_f, way.by_f0
    t = np.sqrt(f[1] * f[1] + f[2] * f[2])
    along = (f[1] * v[0] + f[2] * v[1]) / t
    R[0] = w[0] + share * μ * along
    Q[0, 0] = 1.0
    if share != 0.0:
        r[0, 0], r[0, 1] = share * along, share * μ * (f[1] * e[0] + f[2] * e[1]) / t * way.by_length
        for j in range(2):
            by_w = (f[1] * D[0, j] + f[2] * D[1, j]) / t
            by_f = (f[1] * E[0, j] + f[2] * E[1, j]) / t
            by_f0 = (f[1] * E0[0, j] + f[2] * E0[1, j]) / t
            own = (v[j] - along * f[1 + j] / t) / t
            Q[0, 1 + j], P[0, 1 + j], P0[0, 1 + j] = share * μ * by_w, share * μ * (by_f + own), share * μ * by_f0
    R[1] = κ * (t - g)
    P[1, 0], P[1, 1], P[1, 2] = -κ * rise, κ * f[1] / t, κ * f[2] / t
    r[1, 0] = -κ * f[0]
    weight = np.sqrt(v[0] * v[0] + v[1] * v[1]) / κ + g
    R[2] = (f[1] * v[1] - f[2] * v[0]) / weight
    r[2, 1] = (f[1] * e[1] - f[2] * e[0]) * way.by_length / weight
    P[2, 1], P[2, 2] = v[1] / weight, -v[0] / weight
    for j in range(2):
        Q[2, 1 + j] = (f[1] * D[1, j] - f[2] * D[0, j]) / weight
        P[2, 1 + j] += (f[1] * E[1, j] - f[2] * E[0, j]) / weight
        P0[2, 1 + j] = (f[1] * E0[1, j] - f[2] * E0[0, j]) / weight


@kernel(void(CONTACTS, COUNTS, COUNTS, MASK, VECTOR, VECTOR, VECTOR, EQUATIONS))
def equations(contacts, own, state, turns, f, w, f0, into):
    """Fill the equations of the contacts ``own`` (c,) in their states (m,), all closed.

    ``turns`` (m,) are those that lay on their cones when the step began: what they slip from lags behind them.
    """
    size = into.P.shape[1]
    for k in own:
        into.P[k], into.Q[k], into.P0[k], into.R[k], into.r[k] = 0.0, 0.0, 0.0, 0.0, 0.0
        i, κ = size * k, contacts.length[k]
        if size == 1 or state[k] == STICK:
            for c in range(size):
                into.R[k, c], into.Q[k, c, c] = w[i + c], 1.0
            continue
        g, rise = bound(contacts, k, f[i])
        if g > 0.0:
            here, there = f[i : i + 3], w[i : i + 3]
            way = _way(here, there, f0[i : i + 3], turns[k], κ)
            _slip(here, there, way, (κ, g / f[i], 1.0 - contacts.shift, g, rise), into, k)
        else:
            into.R[k, 0], into.Q[k, 0, 0] = w[i], 1.0
            for c in range(1, 3):
                into.R[k, c], into.P[k, c, c] = κ * f[i + c], κ


@kernel(void(CONTACTS, VECTOR, VECTOR, COUNTS))
def states(contacts, f, w, state):
    """Branches of the natural map, no tolerance."""
    size = len(f) // len(state)
    for k in range(len(state)):
        i, κ = size * k, contacts.length[k]
        normal = f[i] - w[i] / κ
        if size == 1:
            state[k] = SLIP if normal > 0.0 else OPEN
            continue
        v1, v2 = f[i + 1] - w[i + 1] / κ, f[i + 2] - w[i + 2] / κ
        across = np.sqrt(v1 * v1 + v2 * v2)
        if normal <= (-contacts.parameters[k, 0] * across if contacts.shift == 0.0 else 0.0):
            state[k] = OPEN
        else:
            state[k] = STICK if across <= bound(contacts, k, max(normal, 0.0))[0] else SLIP


@kernel(void(CONTACTS, VECTOR, MASK))
def on_cone(contacts, f, found):
    """Contacts that are loaded and on their cones."""
    largest = 0.0
    for k in range(len(found)):
        largest = max(largest, f[3 * k])
    for k in range(len(found)):
        i = 3 * k
        found[k] = False
        if f[i] > LOADED * largest:
            g = bound(contacts, k, f[i])[0]
            found[k] = g > 0.0 and np.sqrt(f[i + 1] ** 2 + f[i + 2] ** 2) >= (1.0 - ON_CONE) * g
