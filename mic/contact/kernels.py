"""Compiled kernels: one sample of one contact problem, in scaled variables.

Symbols as in :mod:`mic.contact.native`: ``w = W y + q`` with ``y`` the scaled force and ``w`` the scaled displacement, three
entries per contact (n, t1, t2), and friction ``mu`` scaled likewise.  All arrays are float64 and C-contiguous.
"""

from __future__ import annotations

import numba
import numpy as np

__all__ = ["gauss_seidel", "local_factors", "newton", "relative_errors", "solve_frictional", "solve_frictionless", "split", "starting_scale"]

_jit = numba.njit(cache=True, nogil=True, error_model="numpy")


@_jit
def local_factors(W):
    """What the one-contact problem needs of each diagonal block ``W_kk``.

    Eliminating ``y_n`` by ``w_n = 0`` leaves the tangential Schur complement ``A = W_tt - W_tn W_nt / W_nn``, kept as its
    eigenvalues and the rotation to its eigenvectors.

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


@_jit
def _coulomb_contact(P, mu, qn, q1, q2, slip):
    """Exact solution of one contact: ``w = W_kk y + q``, Coulomb's law.

    Open if ``q_n >= 0``; stuck if ``W_kk y = -q`` lies in the cone; otherwise it slides with ``w_t = -λ y_t`` and

    .. math:: (A + λ) y_t = -(q_t - W_{tn} q_n / W_{nn}), \\quad \\|y_t\\| = μ y_n,

    a scalar equation in ``λ > 0``, positive at 0 and negative at infinity: safeguarded Newton on ``1/‖y_t‖ - 1/(μ y_n)``.

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
    for _ in range(80):
        x, y = h1 / (l1 + lam), h2 / (l2 + lam)
        t = np.sqrt(x * x + y * y)
        yn = -qn / nn - p1 * x - p2 * y
        excess = t - mu * yn
        if excess > 0.0:
            low = lam
        else:
            high = lam
        if abs(excess) <= 4e-16 * t:
            break
        new = -1.0
        if t > 0.0:
            dx, dy = -x / (l1 + lam), -y / (l2 + lam)
            dt = (x * dx + y * dy) / t
            dn = -(p1 * dx + p2 * dy)
            if yn > 0.0:
                slope = dn / (mu * yn * yn) - dt / (t * t)
                if slope != 0.0:
                    new = lam - (1.0 / t - 1.0 / (mu * yn)) / slope
            elif dt - mu * dn != 0.0:
                new = lam - excess / (dt - mu * dn)
        if high < 0.0:
            new = min(max(new, 2.0 * lam), 100.0 * lam)
        elif not low < new < high:
            new = 0.5 * (low + high)
        if abs(new - lam) <= 4e-16 * lam:
            break
        lam = new
    if yn <= 0.0:
        return 0.0, 0.0, 0.0, 0.0
    # Land on the cone exactly, whatever the last bits of λ.
    t = np.sqrt(x * x + y * y)
    scale = mu * yn / t if t > 0.0 else 0.0
    x, y = scale * x, scale * y
    return yn, c * x - s * y, s * x + c * y, lam


@_jit
def gauss_seidel(W, P, mu, y, w, slip, sweeps, tol):
    """Block Gauss-Seidel for Coulomb's law: solve contact after contact exactly, updating ``w = W y + q`` in place.

    Stops when a sweep changes ``y`` by less than ``tol`` relative to its norm.

    Returns
    -------
    int, float
        Sweeps done, and the relative change in the last of them.
    """
    m = len(mu)
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
            z0, z1, z2, slip[k] = _coulomb_contact(P[k], mu[k], qn, q1, q2, slip[k])
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


@_jit
def _contact_equation(associated, mu, y0, y1, y2, w0, w1, w2, phi, A, B, derivative):
    """One contact's equation ``Φ(y, w) = 0`` and its derivative ``dΦ = A dy + B dw``.

    Coulomb (Alart and Curnier 1991), with ``a = y_n - w_n`` and ``v = y_t - w_t``:
    ``Φ_n = y_n - max(a, 0)`` and ``Φ_t = y_t - P_ball(μ max(a, 0))(v)``.
    Associated: ``Φ = y - P_K(y - w)``.

    Returns
    -------
    bool
        False if the contact is open: ``Φ = y``, ``A = I``, ``B = 0``, and ``A``, ``B`` are not written.
    """
    a = y0 - w0
    v1, v2 = y1 - w1, y2 - w2
    t = np.sqrt(v1 * v1 + v2 * v2)
    open_ = mu * t <= -a if associated else a <= 0.0
    if open_:
        phi[0], phi[1], phi[2] = y0, y1, y2
        return False
    if t <= mu * a:
        phi[0], phi[1], phi[2] = w0, w1, w2
        if derivative:
            A[:] = 0.0
            B[:] = 0.0
            B[0, 0] = B[1, 1] = B[2, 2] = 1.0
        return True
    e1, e2 = v1 / t, v2 / t
    if associated:
        p = (a + mu * t) / (1.0 + mu * mu)
    else:
        p = a
    phi[0] = y0 - p
    if not associated:
        phi[0] = w0
    phi[1] = y1 - mu * p * e1
    phi[2] = y2 - mu * p * e2
    if derivative:
        # V = derivative of the projection by y - w; A = I - V, B = V.
        r = mu * p / t
        if associated:
            g = 1.0 / (1.0 + mu * mu)
            h = mu * g
        else:
            g, h = 1.0, 0.0
        B[0, 0], B[0, 1], B[0, 2] = g, h * e1, h * e2
        B[1, 0], B[2, 0] = mu * g * e1, mu * g * e2
        k = mu * h - r
        B[1, 1], B[1, 2] = r + k * e1 * e1, k * e1 * e2
        B[2, 1], B[2, 2] = k * e1 * e2, r + k * e2 * e2
        for i in range(3):
            for j in range(3):
                A[i, j] = -B[i, j]
            A[i, i] += 1.0
    return True


@_jit
def _merit(associated, mu, y, w, phi):
    """Fill ``phi`` with all contacts' equations and return its Euclidean norm."""
    total = 0.0
    dummy = np.empty((3, 3))
    for k in range(len(mu)):
        i = 3 * k
        f = phi[i:i + 3]
        _contact_equation(associated, mu[k], y[i], y[i + 1], y[i + 2], w[i], w[i + 1], w[i + 2], f, dummy, dummy, False)
        total += f[0] * f[0] + f[1] * f[1] + f[2] * f[2]
    return np.sqrt(total)


@_jit
def _solve_dense(J, r):
    """``J⁻¹ r``; zeros if the matrix is singular to the last bit."""
    try:
        return np.linalg.solve(J, r)
    except Exception:
        return np.zeros_like(r)


@_jit
def _force_scale(scale, q, y, w):
    """What errors are relative to, as in :mod:`mic.contact.certificate`: the larger of ``scale`` and ``(yᵀ W y)^{1/2}``."""
    energy = 0.0
    rounding = 0.0
    for i in range(len(q)):
        energy += y[i] * (w[i] - q[i])
        rounding += y[i] * y[i]
    energy -= 1e-15 * len(q) * rounding
    return max(scale, np.sqrt(max(energy, 0.0)))


@_jit
def newton(associated, W, q, mu, y, w, damping, scale, tol, steps, hasty):
    """Semismooth Newton on ``Φ(y, W y + q) = 0``, restricted in each step to the contacts that are not open.

    ``damping`` is added to the diagonal of ``W`` in the derivative only: with a singular ``W`` the step is then that of a
    proximal point about the current ``y`` and stays bounded, and the solution is not moved.  Steps are halved until the
    norm of ``Φ`` falls; ``y`` and ``w`` end at the best point found.  ``hasty`` gives up unless two
    steps halve the norm.

    Returns
    -------
    float, int
        ``‖Φ‖ / max(scale, (yᵀ W y)^{1/2})`` and the steps taken.
    """
    m, n = len(mu), len(q)
    phi = np.empty(n)
    A = np.empty((m, 3, 3))
    B = np.empty((m, 3, 3))
    active = np.empty(m, np.int64)
    step = np.empty(n)
    trial_phi = np.empty(n)
    error = first = _merit(associated, mu, y, w, phi)
    for iteration in range(steps):
        if hasty and iteration == 2 and error > 0.5 * first:
            return np.inf, iteration
        size = _force_scale(scale, q, y, w)
        if error <= tol * size:
            return error / size if size > 0.0 else 0.0, iteration
        count = 0
        for k in range(m):
            i = 3 * k
            if _contact_equation(associated, mu[k], y[i], y[i + 1], y[i + 2], w[i], w[i + 1], w[i + 2],
                                 phi[i:i + 3], A[k], B[k], True):
                active[count] = k
                count += 1
                step[i] = step[i + 1] = step[i + 2] = 0.0
            else:
                step[i], step[i + 1], step[i + 2] = -y[i], -y[i + 1], -y[i + 2]
        # Contacts that open drop their force; the others feel that as a displacement.
        leaving = np.dot(W, step)
        if count > 0:
            J = np.empty((3 * count, 3 * count))
            r = np.empty(3 * count)
            for a in range(count):
                k = active[a]
                i = 3 * k
                for row in range(3):
                    b0, b1, b2 = B[k, row, 0], B[k, row, 1], B[k, row, 2]
                    target = J[3 * a + row]
                    r[3 * a + row] = -phi[i + row] - b0 * leaving[i] - b1 * leaving[i + 1] - b2 * leaving[i + 2]
                    for b in range(count):
                        j = 3 * active[b]
                        target[3 * b] = b0 * W[i, j] + b1 * W[i + 1, j] + b2 * W[i + 2, j]
                        target[3 * b + 1] = b0 * W[i, j + 1] + b1 * W[i + 1, j + 1] + b2 * W[i + 2, j + 1]
                        target[3 * b + 2] = b0 * W[i, j + 2] + b1 * W[i + 1, j + 2] + b2 * W[i + 2, j + 2]
                    for column in range(3):
                        target[3 * a + column] += A[k, row, column] + damping * B[k, row, column]
            d = _solve_dense(J, r)
            for a in range(count):
                i = 3 * active[a]
                step[i], step[i + 1], step[i + 2] = d[3 * a], d[3 * a + 1], d[3 * a + 2]
        change = np.dot(W, step)
        length = 1.0
        accepted = False
        for _ in range(7):
            trial_y = y + length * step
            trial_w = w + length * change
            trial = _merit(associated, mu, trial_y, trial_w, trial_phi)
            if trial <= (1.0 - 1e-4 * length) * error:
                accepted = True
                break
            length *= 0.5
        if not accepted:
            return error / size, iteration + 1
        y[:] = trial_y
        w[:] = np.dot(W, y) + q
        error = _merit(associated, mu, y, w, phi)
    size = _force_scale(scale, q, y, w)
    return error / size if size > 0.0 else 0.0, steps


@_jit
def starting_scale(mu, q):
    """Norm of ``Φ`` at ``y = 0``: the force with which each overlapping contact alone would answer ``q``."""
    total = 0.0
    for k in range(len(mu)):
        if q[3 * k] < 0.0:
            total += q[3 * k] * q[3 * k]
    return np.sqrt(total)


@_jit
def split(associated, X, Q, mu, rho, Z, L, R):
    """Second half of an over-relaxed ADMM step for each row of the batch, and the right-hand side ``R`` of the next step.

    ``x̂ = 1.6 x - 0.6 z``; ``z = P_K(x̂ + l/ρ)``; ``l += ρ (x̂ - z)``, which tends to ``-ŵ``, so that De Saxcé's shift is
    ``μ‖l_t‖``; ``R = ρ z - l - q - shift``.
    """
    for s in range(len(X)):
        for k in range(len(mu)):
            i = 3 * k
            v0 = 1.6 * X[s, i] - 0.6 * Z[s, i] + L[s, i] / rho
            v1 = 1.6 * X[s, i + 1] - 0.6 * Z[s, i + 1] + L[s, i + 1] / rho
            v2 = 1.6 * X[s, i + 2] - 0.6 * Z[s, i + 2] + L[s, i + 2] / rho
            t = np.sqrt(v1 * v1 + v2 * v2)
            if mu[k] * t <= -v0:
                z0, shrink = 0.0, 0.0
            elif t <= mu[k] * v0:
                z0, shrink = v0, 1.0
            else:
                z0 = (v0 + mu[k] * t) / (1.0 + mu[k] * mu[k])
                shrink = mu[k] * z0 / t
            Z[s, i], Z[s, i + 1], Z[s, i + 2] = z0, shrink * v1, shrink * v2
            l0 = rho * (v0 - z0)
            l1, l2 = rho * (1.0 - shrink) * v1, rho * (1.0 - shrink) * v2
            L[s, i], L[s, i + 1], L[s, i + 2] = l0, l1, l2
            shift = 0.0 if associated else mu[k] * np.sqrt(l1 * l1 + l2 * l2)
            R[s, i] = rho * z0 - l0 - Q[s, i] - shift
            R[s, i + 1] = rho * Z[s, i + 1] - l1 - Q[s, i + 1]
            R[s, i + 2] = rho * Z[s, i + 2] - l2 - Q[s, i + 2]


@_jit
def relative_errors(associated, Q, mu, Z, WZ):
    """``‖Φ‖`` relative to the force scale for each row, with ``WZ = Z W``."""
    errors = np.empty(len(Z))
    phi = np.empty(Z.shape[1])
    for s in range(len(Z)):
        w = WZ[s] + Q[s]
        size = _force_scale(starting_scale(mu, Q[s]), Q[s], Z[s], w)
        error = _merit(associated, mu, Z[s], w, phi)
        errors[s] = error / size if size > 0.0 else error
    return errors


@_jit
def solve_frictional(associated, W, P, Q, mu, Y, tol, first, last, rounds, sweeps, calm, hasty, errors, iterations):
    """Samples ``first:last`` of the batch: Gauss-Seidel, then Newton, in rounds with twice the sweeps each.

    ``Y`` holds the initial guess and receives the forces.  Without ``sweeps``, or for the associated law, which the
    Gauss-Seidel kernel does not know, only Newton runs.  A sample whose last sweep still changed ``y`` by more than ``calm``
    is too far off for Newton and left for other methods; where more than three contacts in five are loaded, Newton's steps are dear
    and the limit is 3 % of that.  With ``hasty``, Newton is given up where it starts slowly.
    """
    m = len(mu)
    slip = np.zeros(m)
    if associated:
        sweeps = 0
    for s in range(first, last):
        q = Q[s]
        y = Y[s].copy()
        scale = starting_scale(mu, q)
        w = np.dot(W, y) + q
        slip[:] = 0.0
        total = 0
        run = sweeps
        best = np.inf
        for _ in range(rounds if sweeps > 0 else 1):
            if run > 0:
                done, change = gauss_seidel(W, P, mu, y, w, slip, run, 1e-15)
                total += done
                w = np.dot(W, y) + q
                loaded = 0
                for k in range(m):
                    loaded += y[3 * k] > 0.0
                if change > (calm if 5 * loaded <= 3 * m else 0.03 * calm):
                    Y[s] = y
                    break
            guess = y.copy()
            error, steps = newton(associated, W, q, mu, y, w, 1e-12, scale, tol, 12, hasty)
            total += steps
            if error < best:
                best = error
                Y[s] = y
            if error <= tol:
                break
            y[:] = guess
            w = np.dot(W, y) + q
            run *= 2
        errors[s] = best
        iterations[s] += total


@_jit
def solve_frictionless(W, Q, Y, tol, first, last, rounds, errors, iterations):
    """Samples ``first:last`` of ``0 <= y ⊥ W y + q >= 0``: projected Gauss-Seidel, then Newton on the active set.

    ``W`` (m, m) holds the normal rows only.  ``Y`` holds the initial guess and receives the forces.
    """
    m = len(W)
    active = np.empty(m, np.int64)
    for s in range(first, last):
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
                size = _force_scale(scale, q, y, w)
                error = error / size if size > 0.0 else 0.0
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
            if best <= tol:
                break
            y[:] = guess
            w = np.dot(W, y) + q
            sweeps *= 2
        errors[s] = best
        iterations[s] += total
