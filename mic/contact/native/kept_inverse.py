"""The inverse of a linear problem over the closed contacts, kept and changed contact by contact."""

from __future__ import annotations

import numpy as np
from numba import boolean, int64, types, void

from mic.contact.native.kernel import BLOCKS, COUNTS, MATRIX, kernel
from mic.contact.native.matrices import assign, assign_block, system

__all__ = ["DAMPING", "border", "change", "inverse_of", "inverted", "let_go"]

#: Of the compliance's diagonal, so that a singular one does no harm.
DAMPING = 1e-12


@kernel(void(MATRIX, MATRIX))
def _inverted_four(block, inverse):
    """Inverse of a (4, 4) block whose rows come in the order of its pivots."""
    inverse[:] = 0.0
    for a in range(4):
        scale = 1.0 / block[a, a]
        inverse[a, a] = 1.0
        for j in range(4):
            block[a, j] *= scale
            inverse[a, j] *= scale
        for b in range(4):
            factor = block[b, a]
            if b != a:
                for j in range(4):
                    block[b, j] -= factor * block[a, j]
                    inverse[b, j] -= factor * inverse[a, j]


@kernel(boolean(MATRIX, MATRIX, MATRIX, COUNTS, int64))
def _pivots(M, four, trial, place, k):
    """Rows k to k + 3 of M and of ``four``, its columns of the same numbers, become pivots; False if there are none.

    ``place`` receives where the rows were; ``trial`` is scratch.
    """
    for i in range(len(M)):
        for c in range(4):
            trial[i, c] = four[i, c]
    for c in range(4):
        p = k + c
        for i in range(k + c + 1, len(M)):
            if abs(trial[i, c]) > abs(trial[p, c]):
                p = i
        place[k + c] = p
        if trial[p, c] == 0.0:
            return False
        if p != k + c:
            for j in range(M.shape[1]):
                M[k + c, j], M[p, j] = M[p, j], M[k + c, j]
            for j in range(4):
                four[k + c, j], four[p, j] = four[p, j], four[k + c, j]
                trial[k + c, j], trial[p, j] = trial[p, j], trial[k + c, j]
        scale = 1.0 / trial[k + c, c]
        for i in range(k + c + 1, len(M)):
            factor = trial[i, c] * scale
            for j in range(c + 1, 4):
                trial[i, j] -= factor * trial[k + c, j]
    return True


@kernel(MATRIX(MATRIX))
def inverted(matrix):
    """Inverse X by Gauss and Jordan's method with pivots, four columns at a time; zeros if it is singular.

    Four pivots pass over the other rows at once, two rows at a time: for the 60 to 300 rows of contacts that touch it
    takes two thirds of the time of LAPACK's.  On the transpose, because it leaves a small residual ``X M - I``, and ``M
    X - I`` is what a solution needs.
    """
    n = len(matrix)
    rows, width = (n + 3) // 4 * 4, (n + 7) // 8 * 8
    M, place = np.zeros((rows, width)), np.empty(rows, np.int64)
    four, trial, pivot = np.empty((rows, 4)), np.empty((rows, 4)), np.empty((4, width))
    block, inner = np.empty((4, 4)), np.empty((4, 4))
    for i in range(n):
        for j in range(n):
            M[j, i] = matrix[i, j]
    for i in range(n, rows):
        M[i, i] = 1.0
    for k in range(0, rows, 4):
        for i in range(rows):
            for c in range(4):
                four[i, c] = M[i, k + c]
        if not _pivots(M, four, trial, place, k):
            return np.zeros((n, n))
        assign_block(block, four[k : k + 4])
        _inverted_four(block, inner)
        row0, row1, row2, row3 = M[k], M[k + 1], M[k + 2], M[k + 3]
        for a in range(4):
            x0, x1, x2, x3 = inner[a, 0], inner[a, 1], inner[a, 2], inner[a, 3]
            line = pivot[a]
            for j in range(width):
                line[j] = x0 * row0[j] + x1 * row1[j] + x2 * row2[j] + x3 * row3[j]
            assign(line[k : k + 4], inner[a])
        row0, row1, row2, row3 = pivot[0], pivot[1], pivot[2], pivot[3]
        for i in range(0, rows, 2):
            if k <= i < k + 4:
                continue
            one, two = M[i], M[i + 1]
            one[k : k + 4], two[k : k + 4] = 0.0, 0.0
            f0, f1, f2, f3 = four[i, 0], four[i, 1], four[i, 2], four[i, 3]
            g0, g1, g2, g3 = four[i + 1, 0], four[i + 1, 1], four[i + 1, 2], four[i + 1, 3]
            for j in range(width):
                x0, x1, x2, x3 = row0[j], row1[j], row2[j], row3[j]
                one[j] -= f0 * x0 + f1 * x1 + f2 * x2 + f3 * x3
                two[j] -= g0 * x0 + g1 * x1 + g2 * x2 + g3 * x3
        assign_block(M[k : k + 4], pivot)
    for k in range(rows - 1, -1, -1):
        p = place[k]
        if p != k:
            for i in range(n):
                M[i, k], M[i, p] = M[i, p], M[i, k]
    inverse = np.empty((n, n))
    for i in range(n):
        for j in range(n):
            inverse[i, j] = M[j, i]
    return inverse


@kernel(MATRIX(MATRIX, BLOCKS, BLOCKS, COUNTS))
def inverse_of(W, A, B, closed):
    """Inverse of ``A_k x_k + B_k (W x)_k`` over the contacts that are closed; zeros if it is singular."""
    return inverted(system(W, A, B, closed, DAMPING))


@kernel(void(MATRIX, MATRIX, MATRIX, MATRIX))
def _lessen(inverse, left, M, X):
    """``inverse -= left M⁻¹ X`` of rank 3, nothing if M is singular; M and X are used up.

    M is eliminated, not inverted: the rows that change must be as exact as the others.
    """
    for k in range(3):
        p = k
        for i in range(k + 1, 3):
            if abs(M[i, k]) > abs(M[p, k]):
                p = i
        if M[p, k] == 0.0:
            return
        if p != k:
            for j in range(3):
                M[k, j], M[p, j] = M[p, j], M[k, j]
            for j in range(X.shape[1]):
                X[k, j], X[p, j] = X[p, j], X[k, j]
        for i in range(k + 1, 3):
            factor = M[i, k] / M[k, k]
            for j in range(k + 1, 3):
                M[i, j] -= factor * M[k, j]
            for j in range(X.shape[1]):
                X[i, j] -= factor * X[k, j]
    X0, X1, X2 = X[0], X[1], X[2]
    for j in range(X.shape[1]):
        X2[j] /= M[2, 2]
        X1[j] = (X1[j] - M[1, 2] * X2[j]) / M[1, 1]
        X0[j] = (X0[j] - M[0, 1] * X1[j] - M[0, 2] * X2[j]) / M[0, 0]
    for i in range(len(inverse)):
        l0, l1, l2 = left[i, 0], left[i, 1], left[i, 2]
        row = inverse[i]
        for j in range(len(row)):
            row[j] -= l0 * X0[j] + l1 * X1[j] + l2 * X2[j]


@kernel(void(MATRIX, BLOCKS, BLOCKS, COUNTS, MATRIX, int64, MATRIX, MATRIX))
def change(W, A, B, closed, inverse, a, new_A, new_B):
    """The contact ``closed[a]`` begins or ceases to slide: its rows of the system change, the inverse by rank 3."""
    n, k = len(inverse), closed[a]
    V = np.zeros((3, n))
    for row in range(3):
        d0, d1, d2 = new_B[row, 0] - B[k, row, 0], new_B[row, 1] - B[k, row, 1], new_B[row, 2] - B[k, row, 2]
        W0, W1, W2 = W[3 * k], W[3 * k + 1], W[3 * k + 2]
        for b in range(len(closed)):
            for column in range(3):
                j = 3 * closed[b] + column
                V[row, 3 * b + column] = d0 * W0[j] + d1 * W1[j] + d2 * W2[j]
        for column in range(3):
            V[row, 3 * a + column] += (
                new_A[row, column] - A[k, row, column] + DAMPING * (new_B[row, column] - B[k, row, column])
            )
    assign_block(A[k], new_A)
    assign_block(B[k], new_B)
    X = np.zeros((3, n))  # V times the inverse
    X0, X1, X2 = X[0], X[1], X[2]
    for j in range(n):
        v0, v1, v2 = V[0, j], V[1, j], V[2, j]
        line = inverse[j]
        for i in range(n):
            X0[i] += v0 * line[i]
            X1[i] += v1 * line[i]
            X2[i] += v2 * line[i]
    left = inverse[:, 3 * a : 3 * a + 3].copy()
    _lessen(inverse, left, np.eye(3) + X[:, 3 * a : 3 * a + 3], X)


@kernel(types.Tuple((COUNTS, MATRIX))(MATRIX, BLOCKS, COUNTS, MATRIX, int64))
def border(W, B, own, inverse, k):
    """The contact k joins the system `own`, open: its inverse with three rows and columns more."""
    c, n = len(own), len(inverse)
    column = np.empty((n, 3))
    for a in range(c):
        for row in range(3):
            for j in range(3):
                total = 0.0
                for i in range(3):
                    total += B[own[a], row, i] * W[3 * own[a] + i, 3 * k + j]
                column[3 * a + row, j] = total
    response, joined, grown = np.dot(inverse, column), np.empty(c + 1, np.int64), np.zeros((n + 3, n + 3))
    for a in range(c):
        joined[a] = own[a]
    joined[c] = k
    for i in range(n):
        assign(grown[i, :n], inverse[i])
        for j in range(3):
            grown[i, n + j] = -response[i, j]
    for i in range(n, n + 3):
        grown[i, i] = 1.0
    return joined, grown


@kernel(void(MATRIX, int64))
def let_go(inverse, a):
    """The contact ``closed[a]`` opens: its rows and columns leave the system, the inverse by rank 3."""
    i = 3 * a
    left, right = inverse[:, i : i + 3].copy(), inverse[i : i + 3].copy()
    _lessen(inverse, left, inverse[i : i + 3, i : i + 3].copy(), right)
    inverse[:, i : i + 3] = 0.0
    inverse[i : i + 3] = 0.0
