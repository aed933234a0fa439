"""Linear systems by LAPACK: with their checks and messages, those of ``np.linalg`` take a tenth of all compilation.

What stands row by row here is read column by column there: the transpose.
"""

from __future__ import annotations

import math

import numpy as np
from numba import boolean, float64, int32, types, void

from mic.contact.native.kernel import COUNTS, MATRIX, NUMBER, kernel

__all__ = ["factors", "least_squares", "solution", "substitute"]

#: Kind of numbers, the first argument of a routine: double precision.
DOUBLE = ord("d")
_KIND, _SIZE, _NUMBERS, _INTEGERS = types.char, types.intp, types.CPointer(float64), types.CPointer(int32)


def _routine(name: str, *arguments) -> types.ExternalFunction:
    """What Numba itself calls; returns 0 if LAPACK succeeds."""
    return types.ExternalFunction(f"numba_{name}", types.intc(_KIND, *arguments))


_solve = _routine("xgesv", _SIZE, _SIZE, _NUMBERS, _SIZE, _INTEGERS, _NUMBERS, _SIZE)
_factorise = _routine("xxgetrf", _SIZE, _SIZE, _NUMBERS, _SIZE, _INTEGERS)
_solve_least_squares = _routine(
    "ez_gelsd", _SIZE, _SIZE, _SIZE, _NUMBERS, _SIZE, _NUMBERS, _SIZE, _NUMBERS, float64, _INTEGERS
)


@kernel(boolean(MATRIX))
def _finite(matrix):
    for row in matrix:
        for value in row:
            if not math.isfinite(value):
                return False
    return True


@kernel(MATRIX(MATRIX, MATRIX))
def solution(columns, right):
    """``J⁻¹ R`` of a matrix given by its columns, ``Jᵀ``; zeros if it is singular to the last bit, or not finite."""
    n, count = right.shape
    J, x, pivots = columns.copy(), np.ascontiguousarray(right.T), np.empty(n, np.int32)
    if n == 0 or not (_finite(J) and _finite(x)):
        return np.zeros((n, count))
    if _solve(DOUBLE, n, count, J.ctypes, n, pivots.ctypes, x.ctypes, n) != 0:
        return np.zeros((n, count))
    return np.ascontiguousarray(x.T)


@kernel(types.Tuple((MATRIX, COUNTS))(MATRIX))
def factors(columns):
    """Factors L U of a matrix given by its columns, by columns, and the rows that change places; none if it is singular
    to the last bit, or not finite."""
    n, found, pivots = len(columns), columns.copy(), np.empty(len(columns), np.int32)
    if n == 0 or not _finite(found) or _factorise(DOUBLE, n, n, found.ctypes, n, pivots.ctypes) != 0:
        return np.empty((0, 0)), np.empty(0, np.int64)
    rows = np.empty(n, np.int64)
    for i in range(n):
        rows[i] = pivots[i] - 1
    return found, rows


@kernel(void(MATRIX, COUNTS, MATRIX))
def substitute(lu, rows, X):
    """Solve ``L U x = b`` for each row of X, in place, with what :func:`factors` returns."""
    n = len(rows)
    for x in X:
        for i in range(n):
            x[i], x[rows[i]] = x[rows[i]], x[i]
    for j in range(n):
        column = lu[j]
        for x in X:
            value = x[j]
            for i in range(j + 1, n):
                x[i] -= value * column[i]
    for j in range(n - 1, -1, -1):
        column = lu[j]
        for x in X:
            x[j] /= column[j]
            value = x[j]
            for i in range(j):
                x[i] -= value * column[i]


@kernel(MATRIX(MATRIX, MATRIX, NUMBER))
def least_squares(matrix, right, negligible):
    """Least solution of a square system; singular values below ``negligible`` of the largest count as zero."""
    n, count = right.shape
    J, x = np.ascontiguousarray(matrix.T), np.ascontiguousarray(right.T)
    sizes, rank = np.empty(n), np.empty(1, np.int32)
    if n == 0 or not (_finite(J) and _finite(x)):
        return np.full((n, count), np.nan)
    if _solve_least_squares(DOUBLE, n, n, count, J.ctypes, n, x.ctypes, n, sizes.ctypes, negligible, rank.ctypes) != 0:
        return np.full((n, count), np.nan)
    return np.ascontiguousarray(x.T)
