"""Factors of a linear problem over many closed contacts, with changes of a few of them by Woodbury's identity.

An inverse of 3c rows, changed by rank 3, serves few contacts (:mod:`mic.contact.native.kept_inverse`). Of many, c, most
slide and have two unknowns each, so that to factorise takes a tenth of the time of an inverse.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numba import boolean, int64, types, void

from mic.contact.native.kept_inverse import DAMPING
from mic.contact.native.kernel import BLOCKS, COUNTS, MATRIX, VECTOR, kernel
from mic.contact.native.lapack import solution
from mic.contact.native.linear_step import factorised, steps_by_factors
from mic.contact.native.matrices import assign, displace
from mic.contact.states import OPEN

__all__ = [
    "FACTORS",
    "MANY",
    "Factors",
    "add_responses",
    "are_many",
    "changed_rates",
    "factors_of",
    "force_rates",
    "is_full",
    "no_factors",
    "solve_with_factors",
    "unit_solutions",
]

#: Closed contacts that are many.
MANY = 150
#: Contacts that may change before a prediction ends.
MOST = 48


class Factors(NamedTuple):
    """Factors of ``A_k x_k + B_k (W x)_k = r_k`` over m contacts, ``x = 0`` where they are open.

    Attributes
    ----------
    state : (m,) array
    A, B : (m, 3, 3) array
    lu, rows : (n, n), (n,) array
        Empty if there are no factors.
    changed, size : (48,), (1,) int array
        Contacts whose equations have changed since, and how many there are.
    responses, moved : (3 * 48, 3m), (3 * 48, 3 * 48) array
        ``x`` for a unit of each equation of these contacts, a row each, and ``W x`` at the same contacts.
    steady : (3m,) array
        ``x`` of the rates before any change.
    """

    state: np.ndarray
    A: np.ndarray
    B: np.ndarray
    lu: np.ndarray
    rows: np.ndarray
    changed: np.ndarray
    size: np.ndarray
    responses: np.ndarray
    moved: np.ndarray
    steady: np.ndarray


FACTORS = types.NamedTuple([COUNTS, BLOCKS, BLOCKS, MATRIX, COUNTS, COUNTS, COUNTS, MATRIX, MATRIX, VECTOR], Factors)


@kernel(boolean(VECTOR))
def are_many(y):
    """Whether so many contacts press that factors serve better than an inverse."""
    count = 0
    for i in range(0, len(y), 3):
        count += y[i] > 0.0
    return count > MANY


@kernel(FACTORS())
def no_factors():
    """Empty arrays: there are no factors."""
    counts, blocks, matrix = np.empty(0, np.int64), np.empty((0, 3, 3)), np.empty((0, 0))
    return Factors(counts, blocks, blocks, matrix, counts, counts, counts, matrix, matrix, np.empty(0))


@kernel(FACTORS(MATRIX, BLOCKS, BLOCKS, COUNTS, boolean), from_python=True)
def factors_of(W, A, B, state, changing):
    """Factors of the equations A, B; with room for changes if they are ``changing``."""
    lu, rows = factorised(W, A, B, state, OPEN, DAMPING)
    most, n = MOST if changing else 0, len(W)
    responses, moved, steady = np.empty((3 * most, n)), np.empty((3 * most, 3 * most)), np.zeros(n)
    changed, size = np.empty(most, np.int64), np.zeros(1, np.int64)
    return Factors(state.copy(), A.copy(), B.copy(), lu, rows, changed, size, responses, moved, steady)


@kernel(void(MATRIX, FACTORS, VECTOR, VECTOR, VECTOR))
def solve_with_factors(W, kept, phi, z, x):
    """Fill ``x`` with ``A x + B W x = -Φ``, as the equations were when they were factorised, ``x = -z`` where contacts
    are open."""
    size = (1, len(x))
    steps_by_factors(W, kept.A, kept.B, (kept.lu, kept.rows), phi.reshape(size), kept.state, OPEN, z, x.reshape(size))


@kernel(void(MATRIX, FACTORS, VECTOR, VECTOR))
def force_rates(W, kept, rate, dy):
    """Fill ``dy`` with ``A dy + B (W dy + rate) = 0``, as the equations were when they were factorised."""
    phi, nothing = np.zeros(len(rate)), np.zeros(len(rate))
    for k in range(len(kept.state)):
        for row in range(3):
            for c in range(3):
                phi[3 * k + row] += kept.B[k, row, c] * rate[3 * k + c]
    solve_with_factors(W, kept, phi, nothing, dy)


@kernel(MATRIX(MATRIX, FACTORS, COUNTS))
def unit_solutions(W, kept, contacts):
    """(3k, 3m) ``x`` for a unit of each equation of some contacts."""
    phi, n = np.zeros((3 * len(contacts), len(W))), len(W)
    for a in range(len(phi)):
        phi[a, 3 * contacts[a // 3] + a % 3] = -1.0
    found = np.zeros_like(phi)
    steps_by_factors(W, kept.A, kept.B, (kept.lu, kept.rows), phi, kept.state, OPEN, np.zeros(n), found)
    return found


@kernel(boolean(FACTORS))
def is_full(kept):
    """Whether no more contacts may change."""
    return kept.size[0] == len(kept.changed)


@kernel(void(MATRIX, FACTORS, int64), from_python=True)
def add_responses(W, kept, k):
    """Contact k will change: how all contacts respond to its equations."""
    count, n = kept.size[0], len(W)
    for a in range(count):
        if kept.changed[a] == k:
            return
    kept.changed[count] = k
    kept.size[0] = count + 1
    found = unit_solutions(W, kept, kept.changed[count : count + 1])
    for c in range(3):
        assign(kept.responses[3 * count + c], found[c])
    for a in range(3 * count + 3):
        for b in range(3 * count + 3):
            if a >= 3 * count or b >= 3 * count:
                i = 3 * kept.changed[a // 3] + a % 3
                total = 0.0
                for j in range(n):
                    total += W[i, j] * kept.responses[b, j]
                kept.moved[a, b] = total


@kernel(void(MATRIX, FACTORS, BLOCKS, BLOCKS, VECTOR, VECTOR, VECTOR), from_python=True)
def changed_rates(W, kept, A, B, rate, dy, dw):
    """``A_k dy_k + B_k dw_k = 0`` with ``dw = W dy + rate``, of A and B only those of contacts that changed.

    With ``X`` the responses of the changed contacts J, ``dy = x + X z``, where z solves their equations ``(A X + B W
    X)_J z = -(A x + B (W x + rate))_J`` (Woodbury).
    """
    count, n, x = 3 * kept.size[0], len(W), kept.steady
    if count == 0:
        force_rates(W, kept, rate, x)
    assign(dy, x)
    if count > 0:
        matrix, right, here = np.empty((count, count)), np.empty((count, 1)), np.empty(3)
        for a in range(0, count, 3):
            k = kept.changed[a // 3]
            for c in range(3):
                here[c] = rate[3 * k + c]
                for j in range(n):
                    here[c] += W[3 * k + c, j] * x[j]
            for row in range(3):
                right[a + row, 0] = 0.0
                for c in range(3):
                    right[a + row, 0] -= A[k, row, c] * x[3 * k + c] + B[k, row, c] * here[c]
                for b in range(count):
                    total = 0.0
                    for c in range(3):
                        total += A[k, row, c] * kept.responses[b, 3 * k + c] + B[k, row, c] * kept.moved[a + c, b]
                    matrix[b, a + row] = total
        z = solution(matrix, right)
        for b in range(count):
            for j in range(n):
                dy[j] += z[b, 0] * kept.responses[b, j]
    displace(W, dy, rate, dw)
