"""Products with the compliance, and parts of it."""

from __future__ import annotations

import numpy as np
from numba import int64, void

from mic.contact.native.kernel import BLOCKS, COUNTS, MATRIX, NUMBER, VECTOR, kernel

__all__ = [
    "TOGETHER",
    "assign",
    "assign_block",
    "assign_sum",
    "block",
    "displace",
    "responses",
    "symmetric",
    "system",
    "times",
    "times_together",
]

#: Samples that one pass over a large matrix serves.
TOGETHER = 4
#: Rows and columns of pieces of a matrix that are read with those of its transpose.
TILE = 32


@kernel(void(VECTOR, VECTOR))
def assign(target, source):
    """``target[:] = source``, which Numba would compile anew at each place, with the words of its errors."""
    for i in range(len(target)):
        target[i] = source[i]


@kernel(void(MATRIX, MATRIX))
def assign_block(target, source):
    """``target[:] = source``, of matrices."""
    for row in range(len(target)):
        assign(target[row], source[row])


@kernel(void(VECTOR, VECTOR, NUMBER, VECTOR))
def assign_sum(target, a, factor, b):
    """``target[:] = a + factor * b``."""
    for i in range(len(target)):
        target[i] = a[i] + factor * b[i]


@kernel(void(MATRIX, VECTOR, VECTOR), from_python=True)
def times(W, x, out):
    """``out = W x`` for symmetric ``W``, skipping the contacts where ``x`` vanishes; two of the others at a time."""
    out[:] = 0.0
    first = -1
    for i in range(0, len(x), 3):
        if x[i] == 0.0 and x[i + 1] == 0.0 and x[i + 2] == 0.0:
            continue
        if first < 0:
            first = i
            continue
        x0, x1, x2, x3, x4, x5 = x[first], x[first + 1], x[first + 2], x[i], x[i + 1], x[i + 2]
        row0, row1, row2, row3, row4, row5 = W[first], W[first + 1], W[first + 2], W[i], W[i + 1], W[i + 2]
        for j in range(len(x)):
            out[j] += row0[j] * x0 + row1[j] * x1 + row2[j] * x2 + row3[j] * x3 + row4[j] * x4 + row5[j] * x5
        first = -1
    if first >= 0:
        x0, x1, x2 = x[first], x[first + 1], x[first + 2]
        row0, row1, row2 = W[first], W[first + 1], W[first + 2]
        for j in range(len(x)):
            out[j] += row0[j] * x0 + row1[j] * x1 + row2[j] * x2


@kernel(void(MATRIX, VECTOR, VECTOR, VECTOR))
def displace(W, y, q, w):
    """``w = W y + q``."""
    times(W, y, w)
    for i in range(len(w)):
        w[i] += q[i]


@kernel(void(MATRIX, MATRIX, MATRIX))
def times_together(W, X, out):
    """``out = X W`` for symmetric ``W``, some samples a pass; a row is the same bits whatever the others are."""
    n, whole = W.shape[1], len(X) - len(X) % TOGETHER
    out[:] = 0.0
    for s in range(0, whole, TOGETHER):
        out0, out1, out2, out3 = out[s], out[s + 1], out[s + 2], out[s + 3]
        for i in range(0, n, 3):
            row0, row1, row2 = W[i], W[i + 1], W[i + 2]
            a0, a1, a2 = X[s, i], X[s, i + 1], X[s, i + 2]
            b0, b1, b2 = X[s + 1, i], X[s + 1, i + 1], X[s + 1, i + 2]
            c0, c1, c2 = X[s + 2, i], X[s + 2, i + 1], X[s + 2, i + 2]
            d0, d1, d2 = X[s + 3, i], X[s + 3, i + 1], X[s + 3, i + 2]
            for j in range(n):
                w0, w1, w2 = row0[j], row1[j], row2[j]
                out0[j] += w0 * a0 + w1 * a1 + w2 * a2
                out1[j] += w0 * b0 + w1 * b1 + w2 * b2
                out2[j] += w0 * c0 + w1 * c1 + w2 * c2
                out3[j] += w0 * d0 + w1 * d1 + w2 * d2
    for s in range(whole, len(X)):
        only = out[s]
        for i in range(0, n - n % 6, 6):
            row0, row1, row2, row3, row4, row5 = W[i], W[i + 1], W[i + 2], W[i + 3], W[i + 4], W[i + 5]
            a0, a1, a2, a3, a4, a5 = X[s, i], X[s, i + 1], X[s, i + 2], X[s, i + 3], X[s, i + 4], X[s, i + 5]
            for j in range(n):
                one = only[j] + (row0[j] * a0 + row1[j] * a1 + row2[j] * a2)
                only[j] = one + (row3[j] * a3 + row4[j] * a4 + row5[j] * a5)
        for i in range(n - n % 6, n, 3):
            row0, row1, row2, a0, a1, a2 = W[i], W[i + 1], W[i + 2], X[s, i], X[s, i + 1], X[s, i + 2]
            for j in range(n):
                only[j] += row0[j] * a0 + row1[j] * a1 + row2[j] * a2


@kernel(void(MATRIX, MATRIX, COUNTS, MATRIX, MATRIX), from_python=True)
def responses(S, T, at, F, out):
    """``out = F Sᵀ``, one sample a row, skipping the entries of F that vanish; column k is row ``at[k]`` of S and T.

    Where few of many contacts carry force it takes a fraction of the time of a product; a row is the same bits whatever
    the others are, and in whatever order the columns are kept.
    """
    size = len(S)
    for s in range(len(F)):
        row, own = out[s], np.flatnonzero(F[s])
        row[:] = 0.0
        last = len(own) % 4
        for a in range(last):
            k = at[own[a]]
            force, column = F[s, own[a]], S[k] if k < size else T[k - size]
            for j in range(len(row)):
                row[j] += column[j] * force
        for a in range(last, len(own), 4):
            f0, f1, f2, f3 = F[s, own[a]], F[s, own[a + 1]], F[s, own[a + 2]], F[s, own[a + 3]]
            k0, k1, k2, k3 = at[own[a]], at[own[a + 1]], at[own[a + 2]], at[own[a + 3]]
            S0 = S[k0] if k0 < size else T[k0 - size]
            S1 = S[k1] if k1 < size else T[k1 - size]
            S2 = S[k2] if k2 < size else T[k2 - size]
            S3 = S[k3] if k3 < size else T[k3 - size]
            for j in range(len(row)):
                row[j] += S0[j] * f0 + S1[j] * f1 + S2[j] * f2 + S3[j] * f3


@kernel(MATRIX(MATRIX, MATRIX, COUNTS, COUNTS), from_python=True)
def symmetric(S, T, at, numbers):
    """Rows and columns `numbers` of a matrix, the mean of it and its transpose; column k is row ``at[k]`` of S, T."""
    n, size = len(numbers), len(S)
    out = np.empty((n, n))
    for a in range(n):
        k = at[numbers[a]]
        column, target = S[k] if k < size else T[k - size], out[a]
        for b in range(n):
            target[b] = column[numbers[b]]
    for first in range(0, n, TILE):  # pieces of both that stay in the cache
        for second in range(0, first + 1, TILE):
            for a in range(first, min(first + TILE, n)):
                for b in range(second, min(second + TILE, a)):
                    out[a, b] = out[b, a] = 0.5 * (out[a, b] + out[b, a])
    return out


@kernel(MATRIX(MATRIX, COUNTS, int64), from_python=True)
def block(S, own, size):
    """Rows and columns of the contacts `own`, `size` each, of a matrix over all: a fraction of the cost of taking rows,
    then columns, where few of many are asked for."""
    out = np.empty((size * len(own), size * len(own)))
    for a in range(len(out)):
        line, target = S[size * own[a // size] + a % size], out[a]
        if size == 3:
            for b in range(len(own)):
                i, j = 3 * b, 3 * own[b]
                target[i], target[i + 1], target[i + 2] = line[j], line[j + 1], line[j + 2]
        else:
            for b in range(len(target)):
                target[b] = line[size * own[b // size] + b % size]
    return out


@kernel(MATRIX(MATRIX, BLOCKS, BLOCKS, COUNTS, NUMBER))
def system(W, A, B, own, damping):
    """Matrix of ``A_k x_k + B_k (W x)_k`` over the contacts ``own``; ``damping`` is added to the diagonal of ``W``.

    A contact has three rows, or one without friction.
    """
    size, count = A.shape[1], len(own)
    J = np.empty((size * count, size * count))
    for a in range(count):
        k = own[a]
        i = size * k
        for row in range(size):
            target = J[size * a + row]
            if size == 1:
                for b in range(count):
                    target[b] = B[k, 0, 0] * W[i, own[b]]
                target[a] += A[k, 0, 0] + damping * B[k, 0, 0]
                continue
            b0, b1, b2 = B[k, row, 0], B[k, row, 1], B[k, row, 2]
            for b in range(count):
                j = 3 * own[b]
                target[3 * b] = b0 * W[i, j] + b1 * W[i + 1, j] + b2 * W[i + 2, j]
                target[3 * b + 1] = b0 * W[i, j + 1] + b1 * W[i + 1, j + 1] + b2 * W[i + 2, j + 1]
                target[3 * b + 2] = b0 * W[i, j + 2] + b1 * W[i + 1, j + 2] + b2 * W[i + 2, j + 2]
            for column in range(3):
                target[3 * a + column] += A[k, row, column] + damping * B[k, row, column]
    return J
