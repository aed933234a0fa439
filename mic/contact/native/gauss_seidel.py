"""One contact under Coulomb's law solved exactly, and sweeps of it over all contacts (block Gauss-Seidel)."""

from __future__ import annotations

import numpy as np
from numba import int64, types

from mic.contact.native.kernel import MATRIX, NUMBER, VECTOR, kernel

__all__ = ["gauss_seidel", "local_factors"]

#: A change of a slider's λ, relative, after which the next one is rounding.
NEARLY = 1e-9


@kernel(MATRIX(MATRIX), from_python=True)
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


@kernel(types.UniTuple(NUMBER, 4)(VECTOR, *5 * (NUMBER,)))
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


@kernel(types.Tuple((int64, NUMBER))(MATRIX, MATRIX, MATRIX, VECTOR, VECTOR, VECTOR, int64, NUMBER), from_python=True)
def gauss_seidel(W, P, parameters, y, w, slip, sweeps, tol):
    """Block Gauss-Seidel for Coulomb's law: solve contact after contact exactly, updating ``w = W y + q`` in place.

    Stops when a sweep changes ``y`` by less than ``tol`` relative to its norm.

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
                for j in range(len(w)):
                    w[j] += row0[j] * d0 + row1[j] * d1 + row2[j] * d2
                y[i], y[i + 1], y[i + 2] = z0, z1, z2
            change += d0 * d0 + d1 * d1 + d2 * d2
            size += z0 * z0 + z1 * z1 + z2 * z2
        if change <= tol * tol * size:
            return sweep + 1, 0.0
    return sweeps, np.sqrt(change / size) if size > 0.0 else np.inf
