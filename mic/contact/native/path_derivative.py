r"""The paths of samples solved again together with all their derivatives.

A step is ``w = S f + q`` with the equations of :mod:`mic.contact.native.linearised_law`, so that ``dw = S df + dq``.
``dq`` of the tangents is what the loads move in the step less ``S df⁰``: where the anchors stand is what contacts and
loads had moved before, ``a = (S f⁰ + b(s⁰))_t``. So none of it is handed on but forces, and only contacts that are
closed cost anything.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numba import boolean, int64, types, void

from mic.contact.native.kernel import BLOCKS, COUNTS, MASK, MATRIX, NUMBER, VECTOR, kernel
from mic.contact.native.linear_problem import bent, moved, solved
from mic.contact.native.linearised_law import CONTACTS, EQUATIONS, Equations, bound, equations, on_cone, states
from mic.contact.native.matrices import assign, assign_sum, system
from mic.contact.native.touching import touching
from mic.contact.states import OPEN, SLIP

__all__ = ["Loads", "Records", "differentiate"]

#: Newton's steps, and by how much of the largest force the last may move them.
STEPS, SETTLED = 20, 1e-9
#: By how much of the largest force a step may move them for slopes to be taken in the next.
NEAR = 1e-4
#: Of its bound: a tangential force that is less has no direction.
UNDIRECTED = 1e-6


class Loads(NamedTuple):
    """Displacements without contact forces, mm, of n samples or of one, which has no first axis.

    Attributes
    ----------
    b, rate : (n, d m) array
        Where the path begins, and what they change until its end.
    B, drate : (n, d m, p) array
        Their derivatives.
    anchor, danchor : (n, (d - 1) m), (n, (d - 1) m, p) array
        Where the contacts stand at first.
    """

    b: np.ndarray
    rate: np.ndarray
    B: np.ndarray
    drate: np.ndarray
    anchor: np.ndarray
    danchor: np.ndarray


class Records(NamedTuple):
    """Recorded steps of n samples, one sample after the other.

    Attributes
    ----------
    followed : (n,) bool array
        Whether steps are the follower's, the first of which leads nowhere.
    edges : (n + 1,) int array
        Where the steps of each sample begin.
    ends, guess : (k,), (k, d m) array
        Where steps end, and the forces there.
    """

    followed: np.ndarray
    edges: np.ndarray
    ends: np.ndarray
    guess: np.ndarray


class Step(NamedTuple):
    """A step from the forces ``f0`` (d m,) with derivatives ``F0`` (d m, p), which its solution replaces in place.

    Attributes
    ----------
    first : bool
        Whether it is the first of its path, which moves the contacts from where they stand.
    s, h : float
        Where it ends, and its length.
    q : (d m,) array
        What loads alone move, slip from where it is measured.
    loaded, closing : (l,), (c,) int array
        Contacts that bear when it begins, and those that close in it.
    turns : (m,) bool array
        Contacts on their cones when it begins.
    dshift : (2 c, p) array
        Derivatives of how far those that close move before they touch.
    bent : (d m, p) array
        Derivative of S times ``f0``.
    """

    first: bool
    s: float
    h: float
    f0: np.ndarray
    F0: np.ndarray
    q: np.ndarray
    loaded: np.ndarray
    closing: np.ndarray
    turns: np.ndarray
    dshift: np.ndarray
    bent: np.ndarray


LOADS = types.NamedTuple([VECTOR, VECTOR, MATRIX, MATRIX, VECTOR, MATRIX], Loads)
ALL_LOADS = types.NamedTuple([MATRIX, MATRIX, BLOCKS, BLOCKS, MATRIX, BLOCKS], Loads)
RECORDS = types.NamedTuple([MASK, COUNTS, VECTOR, MATRIX], Records)
STEP = types.NamedTuple([boolean, NUMBER, NUMBER, VECTOR, MATRIX, VECTOR, COUNTS, COUNTS, MASK, MATRIX, MATRIX], Step)


@kernel(STEP(CONTACTS, LOADS, boolean, NUMBER, NUMBER, boolean, VECTOR, VECTOR, MATRIX))
def _begin(contacts, loads, first, begin, s, second, guess, f, F):
    """The step from ``begin`` to ``s``, of second order or not, at whose end forces are near ``guess``."""
    m, p, h = len(contacts.length), F.shape[1], s - begin
    size = len(f) // m
    q = loads.b + s * loads.rate
    loaded, closing = np.flatnonzero(f[::size] != 0.0), np.zeros(0, np.int64)
    turns, dshift = np.zeros(m, np.bool_), np.zeros((0, p))
    change = bent(contacts, f)
    if size == 3:
        response = np.dot(contacts.S, f)
        for k in range(m):
            i = 3 * k
            for c in range(1, 3):
                if first:
                    q[i + c] -= loads.anchor[2 * k + c - 1]
                else:
                    q[i + c] = h * loads.rate[i + c] - response[i + c]
        if second:
            on_cone(contacts, f, turns)
            closing = np.flatnonzero((f[::3] <= 0.0) & (guess[::3] > 0.0))
        if len(closing):
            rows = 3 * closing
            gap, dgap = np.empty(len(rows)), moved(contacts.S, rows, 3, loaded, F)
            for a in range(len(rows)):
                gap[a] = response[rows[a]] + loads.b[rows[a]] + begin * loads.rate[rows[a]]
                row = dgap[a]
                row += loads.B[rows[a]] + begin * loads.drate[rows[a]] + change[rows[a]]
            shift, dshift = touching(contacts, loads.rate, loads.drate, f, F, turns, closing, h, gap, dgap)
            for a in range(len(closing)):
                for c in range(2):
                    q[rows[a] + 1 + c] -= shift[a, c]
    return Step(first, s, h, f, F, q, loaded, closing, turns, dshift, change)


@kernel(void(CONTACTS, VECTOR, VECTOR, COUNTS, VECTOR))
def _classify(contacts, q, x, state, w):
    """Fill states and displacements at the forces x (d m,), of which those that the states exclude are replaced."""
    size, moves = len(x) // len(state), False
    assign_sum(w, np.dot(contacts.S, x), 1.0, q)
    states(contacts, x, w, state)
    for k in range(len(state)):
        i = size * k
        if state[k] == OPEN:
            for c in range(i, i + size):
                moves = moves or x[c] != 0.0
                x[c] = 0.0
        elif state[k] == SLIP and size == 3:  # without a direction of its own it has that of the map
            g, _ = bound(contacts, k, x[i])
            if g > 0.0 and np.sqrt(x[i + 1] ** 2 + x[i + 2] ** 2) <= UNDIRECTED * g:
                v1, v2 = x[i + 1] - w[i + 1] / contacts.length[k], x[i + 2] - w[i + 2] / contacts.length[k]
                t = np.sqrt(v1 * v1 + v2 * v2)
                x[i + 1], x[i + 2], moves = g * v1 / t, g * v2 / t, True
    if moves:
        assign_sum(w, np.dot(contacts.S, x), 1.0, q)


@kernel(BLOCKS(CONTACTS, LOADS, STEP, COUNTS, VECTOR))
def _load_slopes(contacts, loads, step, own, x):
    """(c, d, p) ``dq`` of the contacts ``own`` (c,), with the change of S at the forces x."""
    count, p, size = len(own), step.F0.shape[1], len(x) // len(contacts.length)
    tangents = np.empty((size - 1) * count, np.int64)
    for a in range(count):
        for c in range(size - 1):
            tangents[(size - 1) * a + c] = 3 * own[a] + 1 + c
    dmoved = np.zeros((len(tangents), p))
    if not step.first and size == 3:
        dmoved = moved(contacts.S, tangents, 3, step.loaded, step.F0)
    bends, dq = bent(contacts, x), np.empty((count, size, p))
    place = np.full(len(contacts.length), -1)
    for a in range(len(step.closing)):
        place[step.closing[a]] = a
    for a in range(count):
        k = own[a]
        i = size * k
        for c in range(size):
            slopes, rate = dq[a, c], loads.drate[i + c]
            if c == 0 or step.first:
                assign_sum(slopes, loads.B[i + c], step.s, rate)
                if c:
                    slopes -= loads.danchor[2 * k + c - 1]
            else:
                for j in range(p):
                    slopes[j] = step.h * rate[j] - dmoved[2 * a + c - 1, j]
                if place[k] >= 0:
                    slopes -= step.dshift[2 * place[k] + c - 1]
            if len(contacts.inputs):
                slopes += bends[i + c]
                if c and not step.first:
                    slopes -= step.bent[i + c]
    return dq


@kernel(void(CONTACTS, EQUATIONS, COUNTS, MATRIX, BLOCKS, MATRIX))
def _slope_sides(contacts, found, own, F0, dq, right):
    """Fill right-hand sides (d c, p) of the slopes of the contacts ``own`` (c,)."""
    count, size, p = dq.shape
    for a in range(count):
        k = own[a]
        for row in range(size):
            target = right[size * a + row, 1:]
            target[:] = 0.0
            for c in range(size):
                if found.Q[k, row, c] != 0.0:
                    target -= found.Q[k, row, c] * dq[a, c]
                if found.P0[k, row, c] != 0.0:
                    target -= found.P0[k, row, c] * F0[size * k + c]
            if found.r[k, row, 0] != 0.0:
                target -= found.r[k, row, 0] * contacts.rougher[k]
            if found.r[k, row, 1] != 0.0 and len(contacts.inputs):
                target -= found.r[k, row, 1] * contacts.softer[k]


@kernel(boolean(CONTACTS, LOADS, STEP, boolean, boolean, VECTOR, VECTOR, MATRIX, COUNTS))
def _solve(contacts, loads, step, slopes, alone, x, f, F, state):
    """Newton's method for one step, from the forces x; fills f, F and state at its end and returns whether it ended.

    ``slopes`` are solved with each Newton step, or only with those that settle; ``alone`` they are, and x is kept.
    """
    m = len(state)
    size, p = len(x) // m, F.shape[1]
    now, w = np.zeros(m, np.int64), np.zeros(len(x))
    rows = Equations(
        np.zeros((m, size, size)),
        np.zeros((m, size, size)),
        np.zeros((m, size, size)),
        np.zeros((m, size)),
        np.zeros((m, size, 2)),
    )
    for _ in range(STEPS):
        scale = max(np.abs(x).max() if len(x) else 0.0, 1e-300)
        _classify(contacts, step.q, x, now, w)
        own = np.flatnonzero(now != OPEN)
        count = len(own)
        equations(contacts, own, now, step.turns, x, w, step.f0, rows)
        right = np.empty((size * count, 1 + (p if slopes else 0)))
        for a in range(count):
            for row in range(size):
                right[size * a + row, 0] = -rows.R[own[a], row]
        if slopes and count:
            _slope_sides(contacts, rows, own, step.F0, _load_slopes(contacts, loads, step, own, x), right)
        found = solved(system(contacts.S, rows.P, rows.Q, own, 0.0), right)
        change = 0.0
        for a in range(count):
            for c in range(size):
                move = found[size * a + c, 0]
                change = max(change, abs(move)) if np.isfinite(move) else np.inf
                if not alone:
                    x[size * own[a] + c] += move
        if not np.isfinite(change):
            return False
        # Where two states both hold, on the cone without slip, either has these forces and slopes.
        if slopes and (alone or change <= SETTLED * scale):
            assign(f, x)
            F[:] = 0.0
            for k in range(len(now)):
                state[k] = now[k]
            for a in range(count):
                for c in range(size):
                    assign(F[size * own[a] + c], found[size * a + c, 1:])
            return True
        slopes = slopes or change <= NEAR * scale
    return False


@kernel(
    void(CONTACTS, RECORDS, ALL_LOADS, COUNTS, boolean, MATRIX, BLOCKS, types.Array(int64, 2, "C"), MATRIX),
    from_python=True,
)
def differentiate(contacts, records, loads, first, forced, f, F, state, q):
    """Solve the recorded steps of n samples again, with derivatives.

    Parameters
    ----------
    contacts : LinearisedContacts
    records : Records
    loads : Loads
    first : (n,) int array
        The step to begin with, f and F being those at its start; in place the one for which no solution was found, or
        how many there are.
    forced : bool
        Whether that step is taken as it was found, whatever it leaves.
    f, F, state : (n, d m), (n, d m, p), (n, m) array
        Receive forces, slopes and states at the end.
    q : (n, d m) array
        Receives what loads alone move in the last step, slip from where it is measured.
    """
    for i in range(len(first)):
        own = Loads(loads.b[i], loads.rate[i], loads.B[i], loads.drate[i], loads.anchor[i], loads.danchor[i])
        ends = records.ends[records.edges[i] : records.edges[i + 1]]
        guess = records.guess[records.edges[i] : records.edges[i + 1]]
        start = first[i]
        first[i] = len(ends)
        for number in range(start, len(ends)):
            begin, second = ends[number - 1] if number else 0.0, records.followed[i] and number > 0
            x, alone = guess[number].copy(), forced and number == start
            step = _begin(contacts, own, number == 0, begin, ends[number], second, x, f[i], F[i])
            assign(q[i], step.q)
            if not _solve(contacts, own, step, alone or not second, alone, x, f[i], F[i], state[i]):
                first[i] = number
                break
