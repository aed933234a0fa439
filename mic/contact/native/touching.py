"""Where contacts that close within a step begin to touch, with derivatives."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numba import types, void

from mic.contact.native.kernel import BLOCKS, COUNTS, MASK, MATRIX, NUMBER, VECTOR, kernel
from mic.contact.native.linear_problem import bent, moved, solved
from mic.contact.native.linearised_law import CONTACTS, bound
from mic.contact.native.matrices import assign, system

__all__ = ["touching"]

#: Changes of the contacts on their cones that slide when a step begins.
PIVOTS = 10
#: Share of a normal force over which g' is differenced.
SHARE = 1e-5


class Rates(NamedTuple):
    """Rates of a path where a step begins, of c closed contacts among m.

    Attributes
    ----------
    own : (c,) int array
    slides : (c,) bool array
        Those on their cones that slide against their forces.
    e : (c, 2) array
        Directions of the forces of those on their cones.
    Q, J : (m, 3, 3), (3 c, 3 c) array
        Their linear problem ``J df = -Q rate``.
    df, dw : (3 m,) array
        Rates of forces and displacements.
    """

    own: np.ndarray
    slides: np.ndarray
    e: np.ndarray
    Q: np.ndarray
    J: np.ndarray
    df: np.ndarray
    dw: np.ndarray


RATES = types.NamedTuple([COUNTS, MASK, MATRIX, BLOCKS, MATRIX, VECTOR, VECTOR], Rates)


@kernel(void(VECTOR, COUNTS, MASK, MASK, VECTOR, MATRIX, BLOCKS, BLOCKS))
def _rows(length, own, slides, smooth, rise, e, P, Q):
    """Fill ``P df + Q dw = 0`` of closed contacts: they stay closed, and stick, slide along e, or bear no friction."""
    P[:], Q[:] = 0.0, 0.0
    for a in range(len(own)):
        k = own[a]
        κ = length[k]
        Q[k, 0, 0] = 1.0
        if smooth[a]:
            P[k, 1, 1] = P[k, 2, 2] = κ
        elif slides[a]:
            P[k, 1, 0], P[k, 1, 1], P[k, 1, 2] = -κ * rise[a], κ * e[a, 0], κ * e[a, 1]
            Q[k, 2, 1], Q[k, 2, 2] = -e[a, 1], e[a, 0]
        else:
            Q[k, 1, 1] = Q[k, 2, 2] = 1.0


@kernel(RATES(CONTACTS, VECTOR, VECTOR, MASK))
def _rates(contacts, rate, f0, on_cone):
    """The rates at forces ``f0``: those on their cones slide forward, or their forces do not leave the cones."""
    own = np.flatnonzero(f0[::3] > 0.0)
    count, m = len(own), len(contacts.length)
    P, Q, slides = np.zeros((m, 3, 3)), np.zeros((m, 3, 3)), np.zeros(count, np.bool_)
    e, rise, smooth = np.zeros((count, 2)), np.zeros(count), np.zeros(count, np.bool_)
    for a in range(count):
        k = own[a]
        g, rise[a] = bound(contacts, k, f0[3 * k])
        smooth[a], slides[a] = g <= 0.0, on_cone[k]
        if on_cone[k]:
            t0 = np.sqrt(f0[3 * k + 1] ** 2 + f0[3 * k + 2] ** 2)
            e[a, 0], e[a, 1] = f0[3 * k + 1] / t0, f0[3 * k + 2] / t0
    df, dw = np.zeros(len(f0)), rate.copy()
    right, J = np.zeros((3 * count, 1)), np.zeros((3 * count, 3 * count))
    for _ in range(PIVOTS):
        _rows(contacts.length, own, slides, smooth, rise, e, P, Q)
        for a in range(count):
            for row in range(3):
                right[3 * a + row, 0] = 0.0
                for c in range(3):
                    right[3 * a + row, 0] -= Q[own[a], row, c] * rate[3 * own[a] + c]
        J = system(contacts.S, P, Q, own, 0.0)
        found = solved(J, right)
        for a in range(count):
            for c in range(3):
                df[3 * own[a] + c] = found[3 * a + c, 0]
        dw = np.dot(contacts.S, df) + rate
        changed = False
        for a in range(count):
            i = 3 * own[a]
            if not on_cone[own[a]]:
                continue
            if slides[a]:
                turns = e[a, 0] * dw[i + 1] + e[a, 1] * dw[i + 2] > 0.0
            else:
                turns = e[a, 0] * df[i + 1] + e[a, 1] * df[i + 2] - rise[a] * df[i] > 0.0
            if turns:
                slides[a], changed = not slides[a], True
        if not changed:
            break
    return Rates(own, slides, e, Q, J, df, dw)


@kernel(MATRIX(CONTACTS, RATES, MATRIX, VECTOR, MATRIX))
def _force_rate_slopes(contacts, rates, drate, f0, F0):
    """(3 m, p) derivatives of the rates of forces, ``rates.df``; ``drate`` (3 m, p) those of the loads' rates."""
    own, _, e, Q, J, df, dw = rates
    count, p = len(own), F0.shape[1]
    right, slopes = np.zeros((3 * count, p)), np.zeros((len(f0), p))
    for a in range(count):
        k = own[a]
        i, κ = 3 * k, contacts.length[k]
        for row in range(3):
            for c in range(3):
                if Q[k, row, c] != 0.0:
                    side = right[3 * a + row]
                    side -= Q[k, row, c] * drate[i + c]
        if rates.slides[a]:
            t0 = np.sqrt(f0[i + 1] ** 2 + f0[i + 2] ** 2)
            # The direction turns with its force: de = n (n·df⁰)/t⁰, n across e.
            by_force = κ * (e[a, 0] * df[i + 2] - e[a, 1] * df[i + 1]) / t0
            by_way = -(e[a, 0] * dw[i + 1] + e[a, 1] * dw[i + 2]) / t0
            bends = 0.0
            if contacts.coefficient_varies:
                step = SHARE * f0[i]
                above, below = bound(contacts, k, f0[i] + step), bound(contacts, k, f0[i] - step)
                bends = (above[1] - below[1]) / (2.0 * step)
            for j in range(p):
                turn = e[a, 0] * F0[i + 2, j] - e[a, 1] * F0[i + 1, j]
                right[3 * a + 1, j] -= by_force * turn - κ * (contacts.rougher[k, j] + bends * F0[i, j]) * df[i]
                right[3 * a + 2, j] -= by_way * turn
    if count:
        found = solved(J, right)
        for a in range(count):
            for c in range(3):
                assign(slopes[3 * own[a] + c], found[3 * a + c])
    return slopes


@kernel(types.Tuple((MATRIX, MATRIX))(CONTACTS, VECTOR, MATRIX, VECTOR, MATRIX, MASK, COUNTS, NUMBER, VECTOR, MATRIX))
def touching(contacts, rate, drate, f0, F0, on_cone, closing, h, gap, dgap):
    """How far contacts that are open when a step of length h begins move until they touch, at the rates of its start:

        x h w_t', x = -w_n/(h w_n').

    Parameters
    ----------
    contacts : LinearisedContacts
    rate, drate : (3 m,), (3 m, p) array
        Of the displacements without contact forces.
    f0, F0, on_cone : (3 m,), (3 m, p), (m,) array
        Forces when the step begins, their derivatives, and which lie on their cones.
    closing : (c,) int array
    h : float
    gap, dgap : (c,), (c, p) array
        What they have to go.

    Returns
    -------
    shift, dshift : (c, 2), (2 c, p) array
    """
    p = F0.shape[1]
    rates = _rates(contacts, rate, f0, on_cone)
    dw = rates.dw
    if len(contacts.inputs):
        drate = drate + bent(contacts, rates.df)
    slopes = _force_rate_slopes(contacts, rates, drate, f0, F0)
    rows = np.empty(3 * len(closing), np.int64)
    for a in range(len(closing)):
        for c in range(3):
            rows[3 * a + c] = 3 * closing[a] + c
    slide = moved(contacts.S, rows, 3, rates.own, slopes)
    shift, dshift = np.zeros((len(closing), 2)), np.zeros((2 * len(closing), p))
    for a in range(len(closing)):
        i = 3 * closing[a]
        x, by_gap, by_fall = 0.0, 0.0, 0.0
        if dw[i] < 0.0:
            x = -gap[a] / (h * dw[i])
            if 0.0 < x < 1.0:
                by_gap, by_fall = -1.0 / (h * dw[i]), gap[a] / (h * dw[i] * dw[i])
        x = min(max(x, 0.0), 1.0)
        for c in range(2):
            shift[a, c] = x * h * dw[i + 1 + c]
            for j in range(p):
                dx = by_gap * dgap[a, j] + by_fall * (drate[i, j] + slide[3 * a, j])
                way = drate[i + 1 + c, j] + slide[3 * a + 1 + c, j]
                dshift[2 * a + c, j] = h * (dx * dw[i + 1 + c] + x * way)
    return shift, dshift
