"""Compiled kernels: one sample of one contact problem, in scaled variables.

Symbols as in :mod:`mic.contact.native.problem`: ``w = W y + q`` with ``y`` the scaled force and ``w`` the scaled
displacement, three entries per contact (n, t1, t2), and ``parameters`` (m, p) the law's, contact by contact, scaled
likewise: friction first. All arrays are float64 and C-contiguous.

A law enters as the pointer to its compiled equation, so that no kernel knows which laws there are.  Signatures are
explicit because a function pointer needs one; everything is compiled, or read from Numba's cache, when this module is
imported.  All kernels stay in one file: Numba's cache of a kernel does not notice a change of another file that it
calls.
"""

from __future__ import annotations

from functools import cache

import numpy as np
from numba import boolean, cfunc, float64, int64, njit, types, void

from mic.contact.states import OPEN, SLIP, STICK

__all__ = [
    "BLOCKS",
    "COUNTS",
    "EQUATION",
    "EQUATION_POINTER",
    "MATRIX",
    "NUMBER",
    "VECTOR",
    "block",
    "compiled",
    "derivative",
    "force_scale",
    "gauss_seidel",
    "jit",
    "linear_step",
    "local_factors",
    "newton",
    "solve_by_splitting",
    "solve_by_sweeps",
    "solve_frictionless",
    "starting_scale",
    "symmetric",
    "system",
    "times",
]

NUMBER, VECTOR, MATRIX, BLOCKS = float64, float64[::1], float64[:, ::1], float64[:, :, ::1]
COUNTS = int64[::1]
#: parameters, y, w, Φ, A, B, state, derivative.  All contacts in one call: one call for each would make a sample that
#: slips 1.5 times as dear.
EQUATION = void(MATRIX, VECTOR, VECTOR, VECTOR, BLOCKS, BLOCKS, COUNTS, boolean)
EQUATION_POINTER = types.FunctionType(EQUATION)
#: Of a contact's own matrix: what is less is rounding.
RANK = 1e-10
#: Of a slider's λ: a change after which the next one is rounding.
NEARLY = 1e-9
#: Steps of Newton's method without a gain before it is given up.
PATIENT = 6
#: Rows above which a linear system is approached before it is factorised, and a product serves so many samples at once.
LARGE, TOGETHER = 900, 4
#: Steps towards the solution of a large linear system, and how near, of its right-hand side; each step of Newton's
#: method then gains that much.
KRYLOV, NEAR = 40, 1e-8
#: Rows and columns of pieces of a matrix that are taken with those of its transpose.
TILE = 32


def _kept(decorator):
    """A decorator of Numba's with its cache; without it where no folder can be written, neither here nor at home."""

    def decorate(function):
        try:
            return decorator(cache=True)(function)
        except RuntimeError:  # compiled anew in each process then, which takes most of a minute
            return decorator(cache=False)(function)

    return decorate


def jit(signature):
    return _kept(lambda cache: njit(signature, cache=cache, nogil=True, error_model="numpy"))


@cache
def compiled(equation):
    """A law's equation as the kernels take it; a C callback is handed over faster than a jitted function."""
    return _kept(lambda cache: cfunc(EQUATION, cache=cache, error_model="numpy"))(equation)


@jit(MATRIX(MATRIX))
def local_factors(W):
    """What the one-contact problem needs of each diagonal block ``W_kk``.

    Eliminating ``y_n`` by ``w_n = 0`` leaves the tangential Schur complement ``A = W_tt - W_tn W_nt / W_nn``, kept as
    its eigenvalues and the rotation to its eigenvectors.

    Returns
    -------
    (m, 7) array
        ``W_nn``, ``W_nt1``, ``W_nt2``, ``λ1``, ``λ2``, cosine, sine.
    """
    m = len(W) // 3
    P = np.zeros((m, 7))
    for k in range(m):
        i = 3 * k
        nn, n1, n2 = W[i, i], W[i, i + 1], W[i, i + 2]
        P[k, 0], P[k, 1], P[k, 2] = nn, n1, n2
        if nn <= 0.0:
            continue
        a11 = W[i + 1, i + 1] - n1 * n1 / nn
        a22 = W[i + 2, i + 2] - n2 * n2 / nn
        a12 = W[i + 1, i + 2] - n1 * n2 / nn
        angle = 0.5 * np.arctan2(2.0 * a12, a11 - a22)
        c, s = np.cos(angle), np.sin(angle)
        P[k, 3] = max(a11 * c * c + 2.0 * a12 * c * s + a22 * s * s, 0.0)
        P[k, 4] = max(a11 * s * s - 2.0 * a12 * c * s + a22 * c * c, 0.0)
        P[k, 5], P[k, 6] = c, s
    return P


@jit(types.UniTuple(NUMBER, 4)(VECTOR, *5 * (NUMBER,)))
def _coulomb_contact(P, mu, qn, q1, q2, slip):
    """Exact solution of one contact: ``w = W_kk y + q``, Coulomb's law.

    Open if ``q_n >= 0``; stuck if ``W_kk y = -q`` lies in the cone; otherwise it slides with ``w_t = -λ y_t`` and

    .. math:: (A + λ) y_t = -(q_t - W_{tn} q_n / W_{nn}), \\quad \\|y_t\\| = μ y_n,

    a scalar equation in ``λ > 0``, positive at 0 and negative at infinity: safeguarded Newton on ``1/‖y_t‖ - 1/(μ
    y_n)``.

    Returns
    -------
    y_n, y_t1, y_t2, λ
    """
    nn = P[0]
    if qn >= 0.0 or nn <= 0.0:
        return 0.0, 0.0, 0.0, 0.0
    if mu <= 0.0:
        return -qn / nn, 0.0, 0.0, 0.0
    c, s = P[5], P[6]
    l1, l2 = P[3], P[4]
    g1, g2 = -(q1 - P[1] * qn / nn), -(q2 - P[2] * qn / nn)
    h1, h2 = c * g1 + s * g2, c * g2 - s * g1
    p1, p2 = (c * P[1] + s * P[2]) / nn, (c * P[2] - s * P[1]) / nn
    floor = 1e-14 * nn
    if l1 > floor and l2 > floor:
        x, y = h1 / l1, h2 / l2
        yn = -qn / nn - p1 * x - p2 * y
        if np.sqrt(x * x + y * y) <= mu * yn:
            return yn, c * x - s * y, s * x + c * y, 0.0
    elif h1 == 0.0 and h2 == 0.0:
        return -qn / nn, 0.0, 0.0, 0.0
    low, high = 0.0, -1.0
    lam = slip if slip > 0.0 else 0.1 * (l1 + l2) + floor
    x = y = yn = 0.0
    free, near = -qn / nn, False
    for _ in range(80):
        i1, i2 = 1.0 / (l1 + lam), 1.0 / (l2 + lam)
        x, y = h1 * i1, h2 * i2
        square = x * x + y * y
        t = np.sqrt(square)
        yn = free - p1 * x - p2 * y
        bound = mu * yn
        excess = t - bound
        if excess > 0.0:
            low = lam
        else:
            high = lam
        if near or abs(excess) <= 4e-16 * t:
            break
        new = -1.0
        if t > 0.0:
            dx, dy = -x * i1, -y * i2
            dt, dn = x * dx + y * dy, -(p1 * dx + p2 * dy)  # dt: t times the derivative of t
            if yn > 0.0:
                slope = dn * square * t - dt * bound * yn
                if slope != 0.0:
                    new = lam + excess * yn * square / slope
            elif dt - mu * dn * t != 0.0:
                new = lam - excess * t / (dt - mu * dn * t)
        if high < 0.0:
            new = min(max(new, 2.0 * lam), 100.0 * lam)
        elif not low < new < high:
            new = 0.5 * (low + high)
        near = abs(new - lam) <= NEARLY * lam  # Newton's next error is the square of this one
        lam = new
    if yn <= 0.0:
        return 0.0, 0.0, 0.0, 0.0
    # Land on the cone exactly, whatever the last bits of λ.
    t = np.sqrt(x * x + y * y)
    scale = mu * yn / t if t > 0.0 else 0.0
    x, y = scale * x, scale * y
    return yn, c * x - s * y, s * x + c * y, lam


@jit(types.Tuple((int64, NUMBER))(MATRIX, COUNTS, COUNTS, MATRIX, MATRIX, VECTOR, VECTOR, VECTOR, int64, NUMBER))
def gauss_seidel(W, starts, places, P, parameters, y, w, slip, sweeps, tol):
    """Block Gauss-Seidel for Coulomb's law: solve contact after contact exactly, updating ``w = W y + q`` in place.

    Stops when a sweep changes ``y`` by less than ``tol`` relative to its norm.

    Parameters
    ----------
    starts, places : (m + 1,) and (n,) int array
        Contact k moves the contacts ``places[starts[k] : starts[k + 1]]``; where both are empty, all.

    Returns
    -------
    int, float
        Sweeps done, and the relative change in the last of them.
    """
    m = len(parameters)
    change = size = 0.0
    for sweep in range(sweeps):
        change = size = 0.0
        for k in range(m):
            i = 3 * k
            y0, y1, y2 = y[i], y[i + 1], y[i + 2]
            if y0 == 0.0 and w[i] >= 0.0:
                continue
            qn = w[i] - W[i, i] * y0 - W[i, i + 1] * y1 - W[i, i + 2] * y2
            q1 = w[i + 1] - W[i + 1, i] * y0 - W[i + 1, i + 1] * y1 - W[i + 1, i + 2] * y2
            q2 = w[i + 2] - W[i + 2, i] * y0 - W[i + 2, i + 1] * y1 - W[i + 2, i + 2] * y2
            z0, z1, z2, slip[k] = _coulomb_contact(P[k], parameters[k, 0], qn, q1, q2, slip[k])
            d0, d1, d2 = z0 - y0, z1 - y1, z2 - y2
            if d0 != 0.0 or d1 != 0.0 or d2 != 0.0:
                row0, row1, row2 = W[i], W[i + 1], W[i + 2]
                if len(starts) == 0:
                    for j in range(len(w)):
                        w[j] += row0[j] * d0 + row1[j] * d1 + row2[j] * d2
                else:
                    for p in range(starts[k], starts[k + 1]):
                        for j in range(3 * places[p], 3 * places[p] + 3):
                            w[j] += row0[j] * d0 + row1[j] * d1 + row2[j] * d2
                y[i], y[i + 1], y[i + 2] = z0, z1, z2
            change += d0 * d0 + d1 * d1 + d2 * d2
            size += z0 * z0 + z1 * z1 + z2 * z2
        if change <= tol * tol * size:
            return sweep + 1, 0.0
    return sweeps, np.sqrt(change / size) if size > 0.0 else np.inf


@jit(NUMBER(EQUATION_POINTER, MATRIX, VECTOR, VECTOR, VECTOR, COUNTS))
def _merit(equation, parameters, y, w, phi, state):
    """Fill ``phi`` with all contacts' equations and return its Euclidean norm; ``state`` is scratch."""
    nothing = np.empty((0, 3, 3))
    equation(parameters, y, w, phi, nothing, nothing, state, False)
    total = 0.0
    for k in range(len(state)):
        i = 3 * k
        if state[k] == OPEN:
            phi[i], phi[i + 1], phi[i + 2] = y[i], y[i + 1], y[i + 2]
        elif state[k] == STICK:
            phi[i], phi[i + 1], phi[i + 2] = w[i], w[i + 1], w[i + 2]
        total += phi[i] * phi[i] + phi[i + 1] * phi[i + 1] + phi[i + 2] * phi[i + 2]
    return np.sqrt(total)


@jit(void(EQUATION_POINTER, MATRIX, VECTOR, VECTOR, VECTOR, BLOCKS, BLOCKS, COUNTS))
def derivative(equation, parameters, y, w, phi, A, B, state):
    """Fill all contacts' equations, their derivatives and states.

    Open: ``Φ = y``, ``A = I``, ``B = 0``; stick: ``Φ = w``, ``A = 0``, ``B = I``; slip: the law's.
    """
    equation(parameters, y, w, phi, A, B, state, True)
    for k in range(len(state)):
        i = 3 * k
        if state[k] == SLIP:
            continue
        open_, z = (1.0, y) if state[k] == OPEN else (0.0, w)
        phi[i], phi[i + 1], phi[i + 2] = z[i], z[i + 1], z[i + 2]
        for row in range(3):
            for column in range(3):
                A[k, row, column] = B[k, row, column] = 0.0
            A[k, row, row], B[k, row, row] = open_, 1.0 - open_


@jit(VECTOR(MATRIX, VECTOR))
def _solve_dense(columns, r):
    """``J⁻¹ r`` of a matrix given by its columns, ``Jᵀ``, as LAPACK has it; zeros if it is singular to the last bit."""
    try:
        return np.linalg.solve(columns.T, r)
    except Exception:
        return np.zeros_like(r)


@jit(NUMBER(NUMBER, VECTOR, VECTOR, VECTOR))
def force_scale(scale, q, y, w):
    """What errors are relative to, as in the certificate: the larger of ``scale`` and ``(yᵀ W y)^{1/2}``."""
    energy = 0.0
    rounding = 0.0
    for i in range(len(q)):
        energy += y[i] * (w[i] - q[i])
        rounding += y[i] * y[i]
    energy -= 1e-15 * len(q) * rounding
    return max(scale, np.sqrt(max(energy, 0.0)))


@jit(NUMBER(NUMBER, NUMBER))
def _relative(error, size):
    """``error / size``; beside nothing no error is none, and any other is beyond all bounds."""
    if size > 0.0:
        return error / size
    return 0.0 if error == 0.0 else np.inf


@jit(void(MATRIX, VECTOR, VECTOR))
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


@jit(void(MATRIX, MATRIX, MATRIX))
def _times_together(W, X, out):
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


@jit(void(MATRIX, MATRIX, COUNTS, MATRIX, MATRIX))
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


@jit(MATRIX(MATRIX, MATRIX, COUNTS, COUNTS))
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


@jit(MATRIX(MATRIX, COUNTS, int64))
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


@jit(MATRIX(MATRIX, BLOCKS, BLOCKS, COUNTS, NUMBER))
def system(W, A, B, own, damping):
    """Matrix of ``A_k x_k + B_k (W x)_k`` over the contacts ``own``; ``damping`` is added to the diagonal of ``W``."""
    count = len(own)
    J = np.empty((3 * count, 3 * count))
    for a in range(count):
        k = own[a]
        i = 3 * k
        for row in range(3):
            b0, b1, b2 = B[k, row, 0], B[k, row, 1], B[k, row, 2]
            target = J[3 * a + row]
            for b in range(count):
                j = 3 * own[b]
                target[3 * b] = b0 * W[i, j] + b1 * W[i + 1, j] + b2 * W[i + 2, j]
                target[3 * b + 1] = b0 * W[i, j + 1] + b1 * W[i + 1, j + 1] + b2 * W[i + 2, j + 1]
                target[3 * b + 2] = b0 * W[i, j + 2] + b1 * W[i + 1, j + 2] + b2 * W[i + 2, j + 2]
            for column in range(3):
                target[3 * a + column] += A[k, row, column] + damping * B[k, row, column]
    return J


@jit(void(NUMBER, NUMBER, NUMBER, BLOCKS, int64))
def _across(l0, l1, l2, N, a):
    """The first two columns of ``N[a]`` (3, 3) become unit vectors perpendicular to l and to each other."""
    length = np.sqrt(l0 * l0 + l1 * l1 + l2 * l2)
    n0, n1, n2 = l0 / length, l1 / length, l2 / length
    if abs(l0) <= abs(l1) and abs(l0) <= abs(l2):
        u0, u1, u2 = 1.0 - n0 * n0, -n0 * n1, -n0 * n2
    elif abs(l1) <= abs(l2):
        u0, u1, u2 = -n1 * n0, 1.0 - n1 * n1, -n1 * n2
    else:
        u0, u1, u2 = -n2 * n0, -n2 * n1, 1.0 - n2 * n2
    size = np.sqrt(u0 * u0 + u1 * u1 + u2 * u2)
    u0, u1, u2 = u0 / size, u1 / size, u2 / size
    N[a, 0, 0], N[a, 1, 0], N[a, 2, 0] = u0, u1, u2
    N[a, 0, 1], N[a, 1, 1], N[a, 2, 1] = n1 * u2 - n2 * u1, n2 * u0 - n0 * u2, n0 * u1 - n1 * u0


@jit(int64(BLOCKS, BLOCKS, VECTOR, int64, BLOCKS, BLOCKS, int64, VECTOR))
def _unknowns(A, B, phi, k, M, N, a, x):
    """How many unknowns ``A x + B p = -Φ`` of the contact k leaves where p hangs on others, 2 or 3.

    A slider's B has rank 2: with l perpendicular to its columns ``l·A x = -l·Φ``, whatever p is.  Then its entries of
    ``x`` receive one that obeys it, ``N[a]`` what may be added to it, and ``M[a]`` the combinations of rows that are
    left, both (3, 3) in their first two columns.
    """
    l0 = l1 = l2 = largest = 0.0
    for j in range(3):
        i = (j + 1) % 3
        c0 = B[k, 1, i] * B[k, 2, j] - B[k, 2, i] * B[k, 1, j]
        c1 = B[k, 2, i] * B[k, 0, j] - B[k, 0, i] * B[k, 2, j]
        c2 = B[k, 0, i] * B[k, 1, j] - B[k, 1, i] * B[k, 0, j]
        size = c0 * c0 + c1 * c1 + c2 * c2
        if size > largest:
            largest, l0, l1, l2 = size, c0, c1, c2
    if largest == 0.0:
        return 3
    size = np.sqrt(largest)
    l0, l1, l2 = l0 / size, l1 / size, l2 / size
    for j in range(3):
        b0, b1, b2 = B[k, 0, j], B[k, 1, j], B[k, 2, j]
        across = l0 * b0 + l1 * b1 + l2 * b2
        if across * across > RANK * RANK * (b0 * b0 + b1 * b1 + b2 * b2):
            return 3
    g0 = l0 * A[k, 0, 0] + l1 * A[k, 1, 0] + l2 * A[k, 2, 0]
    g1 = l0 * A[k, 0, 1] + l1 * A[k, 1, 1] + l2 * A[k, 2, 1]
    g2 = l0 * A[k, 0, 2] + l1 * A[k, 1, 2] + l2 * A[k, 2, 2]
    square, i = g0 * g0 + g1 * g1 + g2 * g2, 3 * k
    if square < RANK * RANK:
        return 3
    ahead = -(l0 * phi[i] + l1 * phi[i + 1] + l2 * phi[i + 2]) / square
    x[i], x[i + 1], x[i + 2] = ahead * g0, ahead * g1, ahead * g2
    _across(l0, l1, l2, M, a)
    _across(g0, g1, g2, N, a)
    return 2


@jit(void(VECTOR, COUNTS, VECTOR))
def _apart(row, own, out):
    """The columns of a row that are those of the contacts `own`: all columns n come first, then t1, then t2."""
    count = len(own)
    first, second, third = out[:count], out[count : 2 * count], out[2 * count :]
    for b in range(count):
        j = 3 * own[b]
        first[b], second[b], third[b] = row[j], row[j + 1], row[j + 2]


@jit(boolean(MATRIX, VECTOR, VECTOR))
def _approached(columns, r, d):
    """GMRES (Saad and Schultz 1986): fill ``d`` with ``J⁻¹ r`` up to :data:`NEAR`, of a matrix given by its columns.

    Returns whether it was reached; it is given up where a quarter of the steps brings no quarter of the digits.
    """
    size, n = np.linalg.norm(r), len(r)
    if size == 0.0:
        d[:] = 0.0
        return True
    V, R = np.empty((KRYLOV + 1, n)), np.zeros((KRYLOV, KRYLOV))
    c, s, g = np.zeros(KRYLOV), np.zeros(KRYLOV), np.zeros(KRYLOV + 1)
    V[0], g[0] = r / size, 1.0
    for k in range(KRYLOV):
        v = np.dot(V[k], columns)
        for i in range(k + 1):
            R[i, k] = np.dot(V[i], v)
            v -= R[i, k] * V[i]
        beyond = np.linalg.norm(v)
        for i in range(k):
            R[i, k], R[i + 1, k] = c[i] * R[i, k] + s[i] * R[i + 1, k], c[i] * R[i + 1, k] - s[i] * R[i, k]
        length = np.sqrt(R[k, k] ** 2 + beyond**2)
        if not 0.0 < length < np.inf:
            return False
        c[k], s[k], R[k, k] = R[k, k] / length, beyond / length, length
        g[k], g[k + 1] = c[k] * g[k], -s[k] * g[k]
        if abs(g[k + 1]) <= NEAR:
            d[:] = 0.0
            for i in range(k, -1, -1):
                for j in range(i + 1, k + 1):
                    g[i] -= R[i, j] * g[j]
                g[i] /= R[i, i]
                d += size * g[i] * V[i]
            return True
        if 4 * (k + 1) == KRYLOV and abs(g[k + 1]) > NEAR**0.25:
            return False
        V[k + 1] = v / beyond
    return False


@jit(boolean(MATRIX, BLOCKS, BLOCKS, VECTOR, COUNTS, int64, VECTOR, NUMBER, boolean, VECTOR))
def linear_step(W, A, B, phi, state, known, z, damping, approach, x):
    """Solve ``A_k x_k + B_k (W x)_k = -Φ_k`` for all contacts, given that ``x = -z`` where ``state`` is ``known``.

    Fills ``x``.  Contacts that slide have two unknowns, others three: the matrix has the first ones of all contacts,
    then the second ones, then the third, so that what is computed for one of them is computed for all in a row.  More
    than :data:`LARGE` unknowns are approached, which no factorisation takes where the contacts are about as stiff as
    what couples them; returned is ``approach``, False once that was in vain.
    """
    m = len(state)
    unknown = np.flatnonzero(state != known)
    count = len(unknown)
    for i in range(len(x)):
        x[i] = -z[i] if state[i // 3] == known else 0.0
    if count == 0:
        return approach
    M, N, some = np.zeros((count, 3, 3)), np.zeros((count, 3, 3)), np.full(count, 3)
    threes = 0
    for a in range(count):
        k = unknown[a]
        if state[k] == SLIP:
            some[a] = _unknowns(A, B, phi, k, M, N, a, x)
        if some[a] == 3:
            for c in range(3):
                M[a, c, c] = N[a, c, c] = 1.0
        threes += some[a] == 3
    own, size = np.empty((3, 3 * count)), 2 * count + threes
    product = np.zeros(3 * count)  # W x, as far as it is known
    for k in range(m):
        for i in range(3 * k, 3 * k + 3):
            if x[i] != 0.0 and state[k] == known:
                for b in range(count):
                    for c in range(3):
                        product[c * count + b] += W[i, 3 * unknown[b] + c] * x[i]
    for a in range(3 * count):
        i = 3 * unknown[a // 3] + a % 3
        value, line = x[i], own[0]
        if value != 0.0:
            _apart(W[i], unknown, line)
            for j in range(3 * count):
                product[j] += line[j] * value
    place, last = np.empty((3, count), np.int64), 2 * count  # of each contact's unknowns
    r, rest = np.empty(size), np.empty(3)
    C, D = np.zeros((3, 3, count)), np.zeros((3, 3, count))  # Mᵀ B and Mᵀ A N: unknown, column, contact
    for a in range(count):
        k, i = unknown[a], 3 * unknown[a]
        place[0, a], place[1, a], place[2, a] = a, count + a, -1
        if some[a] == 3:
            place[2, a] = last
            last += 1
        for c in range(3):
            rest[c] = -phi[i + c]
            for j in range(3):
                rest[c] -= A[k, c, j] * x[i + j] + B[k, c, j] * product[j * count + a]
        for p in range(some[a]):
            m0, m1, m2 = M[a, 0, p], M[a, 1, p], M[a, 2, p]
            r[place[p, a]] = m0 * rest[0] + m1 * rest[1] + m2 * rest[2]
            for c in range(3):
                C[p, c, a] = m0 * B[k, 0, c] + m1 * B[k, 1, c] + m2 * B[k, 2, c]
                MA = m0 * A[k, 0, c] + m1 * A[k, 1, c] + m2 * A[k, 2, c]
                for q in range(some[a]):
                    D[p, q, a] += MA * N[a, c, q]
    columns, line = np.empty((size, size)), np.empty(3 * count)
    line0, line1, line2 = line[:count], line[count : 2 * count], line[2 * count :]
    for a in range(count):
        for c in range(3):
            _apart(W[3 * unknown[a] + c], unknown, own[c])
            own[c, c * count + a] += damping
        W0, W1, W2 = own[0], own[1], own[2]
        for q in range(some[a]):
            n0, n1, n2 = N[a, 0, q], N[a, 1, q], N[a, 2, q]
            for j in range(3 * count):
                line[j] = n0 * W0[j] + n1 * W1[j] + n2 * W2[j]
            target = columns[place[q, a]]
            for p in range(2):
                row, C0, C1, C2 = target[p * count : (p + 1) * count], C[p, 0], C[p, 1], C[p, 2]
                for b in range(count):
                    row[b] = C0[b] * line0[b] + C1[b] * line1[b] + C2[b] * line2[b]
            if threes > 0:
                for b in range(count):
                    if some[b] == 3:
                        target[place[2, b]] = C[2, 0, b] * line0[b] + C[2, 1, b] * line1[b] + C[2, 2, b] * line2[b]
            for p in range(some[a]):
                target[place[p, a]] += D[p, q, a]
    d = np.empty(size)
    large = approach and size > LARGE
    approach = approach and (not large or _approached(columns, r, d))
    if not large or not approach:
        d = _solve_dense(columns, r)
    for a in range(count):
        for q in range(some[a]):
            for c in range(3):
                x[3 * unknown[a] + c] += N[a, c, q] * d[place[q, a]]
    return approach


@jit(
    types.Tuple((NUMBER, int64))(
        EQUATION_POINTER,
        MATRIX,
        MATRIX,
        VECTOR,
        MATRIX,
        VECTOR,
        VECTOR,
        NUMBER,
        NUMBER,
        NUMBER,
        int64,
        int64,
        NUMBER,
    )
)
def newton(equation, W, inverse, q, parameters, y, w, damping, scale, tol, steps, halvings, crowd):
    """Semismooth Newton on ``Φ(y, W y + q) = 0``; ``y`` and ``w`` end at the best point found.

    Each step solves ``A dy + B dw = -Φ``, ``dw = W dy``, for few of the unknowns, because ``dy = -y`` where a contact
    is open and ``dw = -w`` where it sticks: for the forces of the contacts that are not open, or, where more contacts
    stick than are open and ``inverse = W⁻¹`` is at hand, for the displacements of those that do not stick, with ``dy =
    W⁻¹ dw``.

    ``damping`` is added to the diagonal of ``W`` in the derivative only: with a singular ``W`` the step is then that of
    a proximal point about the current ``y`` and stays bounded, and the solution is not moved.  Steps are halved up to
    ``halvings`` times until the norm of ``Φ`` falls.  Without halving they are taken whole: from afar the norm may rise
    for a step or two while states change, and then falls to zero where a search along the line would get stuck; after
    :data:`PATIENT` steps without a gain the search ends.

    Parameters
    ----------
    inverse : (3m, 3m) array
        ``W⁻¹``, or an empty array.
    crowd : float
        Newton gives up before a step for the forces of more contacts than this.

    Returns
    -------
    float, int
        ``‖Φ‖ / max(scale, (yᵀ W y)^{1/2})`` and the steps taken.
    """
    m, n = len(parameters), len(q)
    phi, trial_phi = np.empty(n), np.empty(n)
    A, B = np.empty((m, 3, 3)), np.empty((m, 3, 3))
    state, trial_state = np.empty(m, np.int64), np.empty(m, np.int64)
    step, change = np.empty(n), np.empty(n)
    trial_y, trial_w = y.copy(), w.copy()
    error, size, gained, approach = np.inf, 0.0, 0, True
    iteration = 0
    while True:
        derivative(equation, parameters, trial_y, trial_w, phi, A, B, state)
        trial = np.sqrt(np.dot(phi, phi))
        if iteration == 0 or trial < error or (halvings > 0 and np.isfinite(trial)):
            error, gained = trial, iteration
            y[:], w[:] = trial_y, trial_w
            size = force_scale(scale, q, y, w)
        if error <= tol * size or iteration - gained > PATIENT or iteration == steps or not np.isfinite(trial):
            return _relative(error, size), iteration
        stuck = free = 0
        for k in range(m):
            stuck += state[k] == STICK
            free += state[k] == OPEN
        if stuck > free and len(inverse) > 0:
            approach = linear_step(inverse, B, A, phi, state, STICK, trial_w, 0.0, approach, change)
            times(inverse, change, step)
        elif m - free > crowd:
            return _relative(error, size), iteration
        else:
            approach = linear_step(W, A, B, phi, state, OPEN, trial_y, damping, approach, step)
        if halvings == 0:
            trial_y += step
        else:
            times(W, step, change)
            length = 1.0
            for _ in range(halvings):
                trial_y[:] = y + length * step
                trial_w[:] = w + length * change
                trial = _merit(equation, parameters, trial_y, trial_w, trial_phi, trial_state)
                if trial <= (1.0 - 1e-4 * length) * error:
                    break
                length *= 0.5
            else:
                return _relative(error, size), iteration + 1
        times(W, trial_y, trial_w)
        trial_w += q
        iteration += 1


@jit(NUMBER(VECTOR))
def starting_scale(q):
    """Norm of ``Φ`` at ``y = 0``: the force with which each overlapping contact alone would answer ``q``."""
    total = 0.0
    for i in range(0, len(q), 3):
        if q[i] < 0.0:
            total += q[i] * q[i]
    return np.sqrt(total)


@jit(void(NUMBER, VECTOR, MATRIX, NUMBER, VECTOR, VECTOR, VECTOR, VECTOR))
def _split(shift, q, parameters, rho, z, l, r, x):
    """A step of over-relaxed ADMM, in place, with ``x = (W + ρ I)⁻¹ r``.

    ``x̂ = 1.6 x - 0.6 z``; ``z = P_K(x̂ + l/ρ)``; ``l += ρ (x̂ - z)``, which tends to ``-ŵ``, so that De Saxcé's shift is
    ``μ‖l_t‖``; ``r = ρ z - l - q - s μ‖l_t‖ n`` with the law's ``shift`` ``s``.
    """
    for k in range(len(parameters)):
        i = 3 * k
        mu = parameters[k, 0]
        v0 = 1.6 * x[i] - 0.6 * z[i] + l[i] / rho
        v1 = 1.6 * x[i + 1] - 0.6 * z[i + 1] + l[i + 1] / rho
        v2 = 1.6 * x[i + 2] - 0.6 * z[i + 2] + l[i + 2] / rho
        t = np.sqrt(v1 * v1 + v2 * v2)
        if mu * t <= -v0:
            z0, shrink = 0.0, 0.0
        elif t <= mu * v0:
            z0, shrink = v0, 1.0
        else:
            z0 = (v0 + mu * t) / (1.0 + mu * mu)
            shrink = mu * z0 / t
        z[i], z[i + 1], z[i + 2] = z0, shrink * v1, shrink * v2
        l[i], l[i + 1], l[i + 2] = rho * (v0 - z0), rho * (1.0 - shrink) * v1, rho * (1.0 - shrink) * v2
        opening = shift * mu * np.sqrt(l[i + 1] * l[i + 1] + l[i + 2] * l[i + 2])
        r[i] = rho * z0 - l[i] - q[i] - opening
        r[i + 1] = rho * z[i + 1] - l[i + 1] - q[i + 1]
        r[i + 2] = rho * z[i + 2] - l[i + 2] - q[i + 2]


@jit(
    void(
        EQUATION_POINTER,
        NUMBER,
        MATRIX,
        MATRIX,
        MATRIX,
        NUMBER,
        MATRIX,
        MATRIX,
        MATRIX,
        NUMBER,
        int64,
        int64,
        VECTOR,
        COUNTS,
        COUNTS,
    )
)
def solve_by_splitting(
    equation,
    shift,
    W,
    inverse,
    resolvent,
    rho,
    Q,
    parameters,
    Y,
    tol,
    steps,
    rounds,
    errors,
    iterations,
    factorisations,
):
    """Every sample of the batch: splitting, then Newton, in rounds with twice the splitting ``steps`` each.

    ``Y`` holds the initial guess and receives the forces; each step of Newton's method factorises a matrix.  Of more
    than :data:`LARGE` rows some samples take the steps of the splitting together; each remains what it is alone.
    """
    m, size = len(parameters), len(W)
    for first in range(0, len(Q), TOGETHER):
        own = Q[first : first + TOGETHER]
        count, left = len(own), len(own)
        Z, L, X = Y[first : first + count].copy(), np.zeros_like(own), np.empty_like(own)
        R, best, run = rho * Z - own, np.full(count, np.inf), steps
        for _ in range(rounds):
            if size > LARGE:
                for _ in range(run):
                    _times_together(resolvent, R, X)
                    for s in range(count):
                        _split(shift, own[s], parameters, rho, Z[s], L[s], R[s], X[s])
            else:
                for s in range(count):
                    q, z, l, r, x = own[s], Z[s], L[s], R[s], X[s]
                    for _ in range(run if best[s] > tol else 0):
                        times(resolvent, r, x)
                        _split(shift, q, parameters, rho, z, l, r, x)
            for s in range(count):
                if best[s] <= tol:
                    continue
                q, y, w = own[s], Z[s].copy(), np.empty(size)
                scale = starting_scale(q)
                times(W, y, w)
                w += q
                error, more = newton(equation, W, inverse, q, parameters, y, w, 1e-12, scale, tol, 15, 0, m)
                iterations[first + s] += run + more
                factorisations[first + s] += more
                if error < best[s]:
                    best[s] = error
                    Y[first + s] = y
                left -= error <= tol
            if left == 0:
                break
            run *= 2
        errors[first : first + count] = best


@jit(
    void(
        EQUATION_POINTER,
        MATRIX,
        MATRIX,
        MATRIX,
        MATRIX,
        MATRIX,
        NUMBER,
        int64,
        int64,
        NUMBER,
        VECTOR,
        COUNTS,
        COUNTS,
    )
)
def solve_by_sweeps(equation, W, P, Q, parameters, Y, tol, rounds, sweeps, crowd, errors, iterations, factorisations):
    """Every sample of the batch: Gauss-Seidel, then Newton, in rounds with twice the ``sweeps`` each.

    ``Y`` holds the initial guess and receives the forces.  A law whose single contact Gauss-Seidel does not solve has
    no ``sweeps`` and one round: Newton alone.  Where Newton would need the forces of more than ``crowd`` contacts at
    once, its steps are dear and the sample is left for :func:`solve_by_splitting`.
    """
    m = len(parameters)
    slip = np.zeros(m)
    none, every = np.empty((0, 0)), np.empty(0, np.int64)
    for s in range(len(Q)):
        q = Q[s]
        y = Y[s].copy()
        scale = starting_scale(q)
        w = np.empty_like(q)
        times(W, y, w)
        w += q
        slip[:] = 0.0
        run = sweeps
        best = np.inf
        for _ in range(rounds):
            done, _ = gauss_seidel(W, every, every, P, parameters, y, w, slip, run, 1e-15)
            iterations[s] += done
            times(W, y, w)
            w += q
            guess = y.copy()
            error, more = newton(equation, W, none, q, parameters, y, w, 1e-12, scale, tol, 15, 0, crowd)
            iterations[s] += more
            factorisations[s] += more
            if error < best:
                best = error
                Y[s] = y
            if error <= tol:
                break
            y[:] = guess
            times(W, y, w)
            w += q
            run *= 2
        errors[s] = best


@jit(void(MATRIX, MATRIX, MATRIX, NUMBER, int64, VECTOR, COUNTS, COUNTS))
def solve_frictionless(W, Q, Y, tol, rounds, errors, iterations, factorisations):
    """Every sample of the batch, ``0 <= y ⊥ W y + q >= 0``: projected Gauss-Seidel, then Newton on the active set.

    ``W`` (m, m) holds the normal rows only.  ``Y`` holds the initial guess and receives the forces.
    """
    m = len(W)
    active = np.empty(m, np.int64)
    for s in range(len(Q)):
        q = Q[s]
        y = Y[s].copy()
        scale = np.linalg.norm(np.minimum(q, 0.0))
        w = np.dot(W, y) + q
        total, sweeps = 0, 5
        best = np.inf
        for _ in range(rounds):
            for _ in range(sweeps):
                for i in range(m):
                    if W[i, i] <= 0.0 or (y[i] == 0.0 and w[i] >= 0.0):
                        continue
                    change = max(y[i] - w[i] / W[i, i], 0.0) - y[i]
                    if change != 0.0:
                        y[i] += change
                        for j in range(m):
                            w[j] += change * W[i, j]
            total += sweeps
            guess = y.copy()
            w = np.dot(W, y) + q
            for _ in range(12):
                error = np.linalg.norm(np.minimum(y, w))
                size = force_scale(scale, q, y, w)
                error = _relative(error, size)
                if error < best:
                    best = error
                    Y[s] = y
                if error <= tol:
                    break
                count = 0
                for i in range(m):
                    if y[i] > w[i]:
                        active[count] = i
                        count += 1
                J = np.empty((count, count))
                r = np.empty(count)
                for a in range(count):
                    i = active[a]
                    r[a] = -q[i] + 1e-12 * y[i]
                    for b in range(count):
                        J[a, b] = W[i, active[b]]
                    J[a, a] += 1e-12
                d = _solve_dense(J, r)
                y[:] = 0.0
                for a in range(count):
                    y[active[a]] = d[a]
                w = np.dot(W, y) + q
                total += 1
                factorisations[s] += 1
            if best <= tol:
                break
            y[:] = guess
            w = np.dot(W, y) + q
            sweeps *= 2
        errors[s] = best
        iterations[s] += total
