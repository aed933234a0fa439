"""The linear problem of a Newton step: elimination of what is known, factorisation, or GMRES for many unknowns."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numba import boolean, int64, typeof, types, void

from mic.contact.native.kernel import BLOCKS, COUNTS, MATRIX, NUMBER, VECTOR, kernel
from mic.contact.native.lapack import factors, solution, substitute
from mic.contact.states import SLIP

__all__ = ["factorised", "linear_step", "steps_by_factors"]


class Unknowns(NamedTuple):
    """Unknowns of a linear problem.

    Attributes
    ----------
    contacts, some : (k,) int array
        The contacts, and how many unknowns each has, 2 or 3.
    place : (3, k) int array
        Rows of the system.
    M, N : (k, 3, 3) array
        Columns: combinations of its equations, and directions of its unknowns.
    """

    contacts: np.ndarray
    some: np.ndarray
    place: np.ndarray
    M: np.ndarray
    N: np.ndarray


_NONE = np.empty(0, np.int64), np.empty(0, np.int64), np.empty((3, 0), np.int64), *np.empty((2, 0, 3, 3))
UNKNOWNS = typeof(Unknowns(*_NONE))

#: Relative to a contact's own matrix: what is less is rounding.
RANK = 1e-10
#: Rows above which GMRES is tried before a factorisation.
LARGE = 900
#: Iterations of GMRES, and its residual relative to the right-hand side; each Newton step gains that much.
KRYLOV, NEAR = 40, 1e-8


@kernel(void(NUMBER, NUMBER, NUMBER, BLOCKS, int64))
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


@kernel(int64(BLOCKS, BLOCKS, VECTOR, int64, BLOCKS, BLOCKS, int64, VECTOR))
def _slider(A, B, phi, k, M, N, a, x):
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


@kernel(void(VECTOR, COUNTS, VECTOR))
def _apart(row, own, out):
    """The columns of a row that are those of the contacts `own`: all columns n come first, then t1, then t2."""
    count = len(own)
    first, second, third = out[:count], out[count : 2 * count], out[2 * count :]
    for b in range(count):
        j = 3 * own[b]
        first[b], second[b], third[b] = row[j], row[j + 1], row[j + 2]


@kernel(boolean(MATRIX, VECTOR, VECTOR))
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
    g[0] = 1.0
    for j in range(n):
        V[0, j] = r[j] / size
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
        for j in range(n):
            V[k + 1, j] = v[j] / beyond
    return False


@kernel(UNKNOWNS(BLOCKS, BLOCKS, VECTOR, COUNTS, COUNTS, VECTOR))
def _unknowns(A, B, phi, state, contacts, x):
    """The unknowns of these contacts; for sliders ``x`` receives what obeys the equation that W is not in."""
    count = len(contacts)
    M, N, some = np.zeros((count, 3, 3)), np.zeros((count, 3, 3)), np.full(count, 3)
    place, last = np.empty((3, count), np.int64), 2 * count
    for a in range(count):
        if state[contacts[a]] == SLIP:
            some[a] = _slider(A, B, phi, contacts[a], M, N, a, x)
        place[0, a], place[1, a], place[2, a] = a, count + a, -1
        if some[a] == 3:
            for c in range(3):
                M[a, c, c] = N[a, c, c] = 1.0
            place[2, a] = last
            last += 1
    return Unknowns(contacts, some, place, M, N)


@kernel(VECTOR(MATRIX, COUNTS, int64, COUNTS, VECTOR))
def _known_response(W, state, known, contacts, x):
    """``W x`` at the unknown contacts, as far as ``x`` is known: all n, then t1, then t2."""
    count = len(contacts)
    line, product = np.empty(3 * count), np.zeros(3 * count)
    for k in range(len(state)):
        for i in range(3 * k, 3 * k + 3):
            if x[i] != 0.0 and state[k] == known:
                for b in range(count):
                    for c in range(3):
                        product[c * count + b] += W[i, 3 * contacts[b] + c] * x[i]
    for a in range(3 * count):
        i = 3 * contacts[a // 3] + a % 3
        value = x[i]
        if value != 0.0:
            _apart(W[i], contacts, line)
            for j in range(3 * count):
                product[j] += line[j] * value
    return product


@kernel(types.Tuple((VECTOR, BLOCKS, BLOCKS))(BLOCKS, BLOCKS, VECTOR, UNKNOWNS, VECTOR, VECTOR))
def _projected(A, B, phi, unknowns, x, product):
    """Right-hand side, ``Mᵀ B`` and ``Mᵀ A N``: unknown, column, contact."""
    contacts, some, place, M, N = unknowns
    count = len(contacts)
    r, rest = np.empty(2 * count + np.sum(some == 3)), np.empty(3)
    C, D = np.zeros((3, 3, count)), np.zeros((3, 3, count))
    for a in range(count):
        k, i = contacts[a], 3 * contacts[a]
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
    return r, C, D


@kernel(MATRIX(MATRIX, UNKNOWNS, BLOCKS, BLOCKS, NUMBER, int64))
def _columns(W, unknowns, C, D, damping, size):
    """Columns of ``Mᵀ (A + B W) N``, with ``damping`` on the diagonal of W."""
    contacts, some, place, _, N = unknowns
    count = len(contacts)
    own, columns, line = np.empty((3, 3 * count)), np.empty((size, size)), np.empty(3 * count)
    line0, line1, line2 = line[:count], line[count : 2 * count], line[2 * count :]
    for a in range(count):
        for c in range(3):
            _apart(W[3 * contacts[a] + c], contacts, own[c])
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
            if size > 2 * count:
                for b in range(count):
                    if some[b] == 3:
                        target[place[2, b]] = C[2, 0, b] * line0[b] + C[2, 1, b] * line1[b] + C[2, 2, b] * line2[b]
            for p in range(some[a]):
                target[place[p, a]] += D[p, q, a]
    return columns


@kernel(types.Tuple((UNKNOWNS, VECTOR, BLOCKS, BLOCKS))(MATRIX, BLOCKS, BLOCKS, VECTOR, COUNTS, int64, VECTOR, VECTOR))
def _reduced(W, A, B, phi, state, known, z, x):
    """The unknowns of :func:`linear_step`, their right-hand side and what their matrix is made of; ``x`` receives what
    is known of the solution."""
    contacts = np.flatnonzero(state != known)
    for i in range(len(x)):
        x[i] = -z[i] if state[i // 3] == known else 0.0
    unknowns = _unknowns(A, B, phi, state, contacts, x)
    r, C, D = _projected(A, B, phi, unknowns, x, _known_response(W, state, known, contacts, x))
    return unknowns, r, C, D


@kernel(void(UNKNOWNS, VECTOR, VECTOR))
def _add(unknowns, d, x):
    """Add the unknowns ``d`` to what is known of ``x``."""
    for a in range(len(unknowns.contacts)):
        for q in range(unknowns.some[a]):
            for c in range(3):
                x[3 * unknowns.contacts[a] + c] += unknowns.N[a, c, q] * d[unknowns.place[q, a]]


@kernel(types.Tuple((MATRIX, COUNTS))(MATRIX, BLOCKS, BLOCKS, COUNTS, int64, NUMBER))
def factorised(W, A, B, state, known, damping):
    """Factors of the matrix of :func:`linear_step`, as :func:`mic.contact.native.lapack.factors` has them."""
    nothing = np.zeros(3 * len(state))
    unknowns, r, C, D = _reduced(W, A, B, nothing, state, known, nothing, np.empty_like(nothing))
    return factors(_columns(W, unknowns, C, D, damping, len(r)))


@kernel(void(MATRIX, BLOCKS, BLOCKS, types.Tuple((MATRIX, COUNTS)), MATRIX, COUNTS, int64, VECTOR, MATRIX))
def steps_by_factors(W, A, B, found, phi, state, known, z, X):
    """As :func:`linear_step`, for each row of ``phi`` one of ``X``, with factors that :func:`factorised` found for the
    same A, B and state."""
    right = np.empty((len(phi), len(found[1])))
    for s in range(len(phi)):
        _, r, _, _ = _reduced(W, A, B, phi[s], state, known, z, X[s])
        right[s] = r
    substitute(found[0], found[1], right)
    unknowns = _unknowns(A, B, np.zeros(len(z)), state, np.flatnonzero(state != known), np.empty(len(z)))
    for s in range(len(phi)):
        _add(unknowns, right[s], X[s])


@kernel(boolean(MATRIX, BLOCKS, BLOCKS, VECTOR, COUNTS, int64, VECTOR, NUMBER, boolean, VECTOR), from_python=True)
def linear_step(W, A, B, phi, state, known, z, damping, approach, x):
    """Solve ``A_k x_k + B_k (W x)_k = -Φ_k`` for all contacts, given that ``x = -z`` where ``state`` is ``known``.

    Fills ``x``.  Contacts that slide have two unknowns, others three: the matrix has the first ones of all contacts,
    then the second ones, then the third, so that what is computed for one of them is computed for all in a row.  More
    than :data:`LARGE` unknowns are solved by GMRES, which no factorisation takes where the contacts are about as stiff
    as what couples them; returned is ``approach``, False once that was in vain.
    """
    unknowns, r, C, D = _reduced(W, A, B, phi, state, known, z, x)
    if len(r) == 0:
        return approach
    columns, d = _columns(W, unknowns, C, D, damping, len(r)), np.empty(len(r))
    large = approach and len(r) > LARGE
    approach = approach and (not large or _approached(columns, r, d))
    if not large or not approach:
        d = solution(columns, r.reshape((len(r), 1))).ravel()
    _add(unknowns, d, x)
    return approach
