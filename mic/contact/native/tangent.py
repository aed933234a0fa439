r"""One sample's path gone again with all its derivatives, compiled.

The equations of a step stand in :mod:`mic.contact.tangent`. Of one contact, linearised at (f, w), where f⁰ are the
forces when the step begins,

    P df + Q dw + P⁰ df⁰ + r dμ = -R,        dw = S df + dq,

and ``dq`` of the tangents is what the loads move in the step less ``S df⁰``: where the anchors stand is what contacts
and loads had moved before, ``a = (S f⁰ + b(s⁰))_t``. So none of it is handed on but forces, and only contacts that are
closed cost anything.
"""

from __future__ import annotations

import numpy as np
from numba import boolean, int64, types, void

from mic.contact.native.kernel import BLOCKS, COUNTS, MATRIX, NUMBER, VECTOR, kernel
from mic.contact.native.law_equation import EQUATION_POINTER
from mic.contact.states import LOADED, ON_CONE, OPEN, SLIP, STICK

__all__ = ["walks"]

#: Newton's steps, and by how much of the largest force the last may move them.
STEPS, SETTLED = 20, 1e-9
#: By how much of the largest force a step may move them for slopes to be taken in the next.
NEAR = 1e-4
#: Changes of the contacts on their cones that slide when a step begins.
PIVOTS = 10
#: Forces of contacts that hold each other are not unique, their displacements are.
HYPERSTATIC, UNSOLVED = 1e-11, 1e-9
#: Of its bound: a tangential force that is less tells no direction.
UNTOLD = 1e-6
#: A tangential force that is beyond every bound, in normal forces; and the share of one over which g' is differenced.
BEYOND, SHARE = 1e6, 1e-5

MASK = types.Array(types.boolean, 1, "C")


@kernel(types.UniTuple(NUMBER, 2)(NUMBER))
def _lag(z):
    """``φ(z) = 1/z - 1/(eᶻ - 1)`` and its derivative."""
    if abs(z) < 0.05:
        z2 = z * z
        value = 0.5 - z * (1.0 / 12.0 - z2 * (1.0 / 720.0 - z2 * (1.0 / 30240.0 - z2 / 1209600.0)))
        return value, -1.0 / 12.0 + z2 * (1.0 / 240.0 - z2 * (1.0 / 6048.0 - z2 / 172800.0))
    if z > 300.0:
        return 1.0 / z, -1.0 / (z * z)
    below = np.expm1(z)
    return 1.0 / z - 1.0 / below, (below + 1.0) / (below * below) - 1.0 / (z * z)


@kernel(types.UniTuple(NUMBER, 2)(EQUATION_POINTER, boolean, MATRIX, int64, NUMBER))
def _bound(equation, varies, parameters, k, normal):
    """``g(f_n)`` of contact k, and ``g'``: the law's equation tells both where it varies, of a force far outside."""
    if not varies:
        return parameters[k, 0] * normal, parameters[k, 0]
    y, phi, state = np.zeros(3), np.zeros(3), np.zeros(1, np.int64)
    A, B = np.zeros((1, 3, 3)), np.zeros((1, 3, 3))
    y[0] = max(normal, 1e-200)
    y[1] = BEYOND * y[0]
    equation(parameters[k : k + 1], y, np.zeros(3), phi, A, B, state, True)
    return B[0, 2, 2] * y[1] if normal > 0.0 else 0.0, B[0, 1, 0]


@kernel(MATRIX(MATRIX, MATRIX))
def _solved(matrix, right):
    """A linear system; where contacts hold each other, the least forces."""
    size = np.abs(right).max() if right.size else 0.0
    if size == 0.0:
        return np.zeros_like(right)
    try:
        found = np.ascontiguousarray(np.linalg.solve(matrix, right))
    except Exception:
        found = np.full_like(right, np.nan)
    worst = np.abs(np.dot(matrix, found) - right).max()
    if worst <= UNSOLVED * size:
        return found
    for i in range(len(matrix)):
        for j in range(len(matrix)):
            if not np.isfinite(matrix[i, j]):
                return np.full_like(right, np.nan)
    return np.ascontiguousarray(np.linalg.lstsq(matrix, right, HYPERSTATIC)[0])


@kernel(MATRIX(MATRIX, BLOCKS, BLOCKS, COUNTS))
def _system(S, P, Q, own):
    """Matrix of ``P_k x_k + Q_k (S x)_k`` over the contacts ``own``."""
    size, count = P.shape[1], len(own)
    J = np.empty((size * count, size * count))
    for a in range(count):
        i = size * own[a]
        for row in range(size):
            target = J[size * a + row]
            if size == 1:
                for b in range(count):
                    target[b] = Q[a, 0, 0] * S[i, own[b]]
            else:
                q0, q1, q2 = Q[a, row, 0], Q[a, row, 1], Q[a, row, 2]
                S0, S1, S2 = S[i], S[i + 1], S[i + 2]
                for b in range(count):
                    j = 3 * own[b]
                    for c in range(3):
                        target[3 * b + c] = q0 * S0[j + c] + q1 * S1[j + c] + q2 * S2[j + c]
            for c in range(size):
                target[size * a + c] += P[a, row, c]
    return J


@kernel(MATRIX(MATRIX, COUNTS, int64, COUNTS, MATRIX))
def _moved(S, rows, size, loaded, F):
    """(r, p) some rows of ``S F``, F the slopes of the forces of the contacts ``loaded`` and zero elsewhere."""
    columns = np.empty((len(rows), size * len(loaded)))
    force = np.empty((size * len(loaded), F.shape[1]))
    for b in range(len(loaded)):
        for c in range(size):
            force[size * b + c] = F[size * loaded[b] + c]
    for a in range(len(rows)):
        line = S[rows[a]]
        for b in range(len(loaded)):
            for c in range(size):
                columns[a, size * b + c] = line[size * loaded[b] + c]
    return np.dot(columns, force)


@kernel(MATRIX(MATRIX, MATRIX, COUNTS, VECTOR, int64))
def _bent(left, right, whose, force, p):
    """(r, p) ``dS f`` of each input."""
    found = np.zeros((left.shape[1], p))
    for i in range(len(whose)):
        share = 0.0
        for j in range(len(force)):
            share += right[i, j] * force[j]
        for j in range(len(force)):
            found[j, whose[i]] += share * left[i, j]
    return found


@kernel(void(VECTOR, VECTOR, VECTOR, boolean, NUMBER, NUMBER, NUMBER, NUMBER, NUMBER, *3 * (MATRIX,), VECTOR, MATRIX))
def _slip(f, w, f0, turns, κ, μ, share, bound, rise, P, Q, P0, R, r):
    """A contact that slips under load; `share` is 1 - σ, and r (3, 2) receives what its equations change with its
    coefficient of friction and with its own compliance."""
    t = np.sqrt(f[1] * f[1] + f[2] * f[2])
    # w' = w_t + λ e, with its derivatives by w_t (D), f_t (E) and f⁰_t (E0).
    v1, v2 = w[1], w[2]
    D, E, E0 = np.eye(2), np.zeros((2, 2)), np.zeros((2, 2))
    e, by_κ = np.zeros(2), 0.0
    if turns:
        t0 = np.sqrt(f0[1] * f0[1] + f0[2] * f0[2])
        e[0], e[1] = f0[1] / t0, f0[2] / t0
        l = -(e[0] * w[1] + e[1] * w[2])
        z = l / (0.5 * κ * (t0 + t))
        φ, dφ = _lag(z)
        λ, by_l, by_c, by_κ = φ * l, φ + dφ * z, -dφ * z * z * 0.5 * κ, -dφ * z * l / κ
        v1, v2 = v1 + λ * e[0], v2 + λ * e[1]
        across = e[1] * w[1] - e[0] * w[2]  # of w_t
        for i in range(2):
            for j in range(2):
                D[i, j] -= by_l * e[i] * e[j]
                E[i, j] = e[i] * by_c * f[1 + j] / t
            E0[i, 0] = e[i] * (by_c * e[0] - by_l * across * e[1] / t0)
            E0[i, 1] = e[i] * (by_c * e[1] + by_l * across * e[0] / t0)
        E0[0, 0] += λ * e[1] * e[1] / t0
        E0[0, 1] -= λ * e[0] * e[1] / t0
        E0[1, 0] -= λ * e[0] * e[1] / t0
        E0[1, 1] += λ * e[0] * e[0] / t0
    along = (f[1] * v1 + f[2] * v2) / t
    R[0] = w[0] + share * μ * along
    Q[0, 0] = 1.0
    if share != 0.0:
        r[0, 0], r[0, 1] = share * along, share * μ * (f[1] * e[0] + f[2] * e[1]) / t * by_κ
        for j in range(2):
            by_w = (f[1] * D[0, j] + f[2] * D[1, j]) / t
            by_f = (f[1] * E[0, j] + f[2] * E[1, j]) / t
            by_f0 = (f[1] * E0[0, j] + f[2] * E0[1, j]) / t
            own = ((v1 if j == 0 else v2) - along * f[1 + j] / t) / t
            Q[0, 1 + j], P[0, 1 + j], P0[0, 1 + j] = share * μ * by_w, share * μ * (by_f + own), share * μ * by_f0
    R[1] = κ * (t - bound)
    P[1, 0], P[1, 1], P[1, 2] = -κ * rise, κ * f[1] / t, κ * f[2] / t
    r[1, 0] = -κ * f[0]
    weight = np.sqrt(v1 * v1 + v2 * v2) / κ + bound
    R[2], r[2, 1] = (f[1] * v2 - f[2] * v1) / weight, (f[1] * e[1] - f[2] * e[0]) * by_κ / weight
    P[2, 1], P[2, 2] = v2 / weight, -v1 / weight
    for j in range(2):
        Q[2, 1 + j] = (f[1] * D[1, j] - f[2] * D[0, j]) / weight
        P[2, 1 + j] += (f[1] * E[1, j] - f[2] * E[0, j]) / weight
        P0[2, 1 + j] = (f[1] * E0[1, j] - f[2] * E0[0, j]) / weight


@kernel(
    void(
        EQUATION_POINTER,
        boolean,
        NUMBER,
        VECTOR,
        MATRIX,
        COUNTS,
        COUNTS,
        MASK,
        *3 * (VECTOR,),
        *3 * (BLOCKS,),
        MATRIX,
        BLOCKS,
    )
)
def _equations(equation, varies, shift, length, parameters, own, state, slides, f, w, f0, P, Q, P0, R, r):
    """Fill what the contacts ``own`` leave of their equations R, mm, and the derivatives P, Q, P⁰ and r."""
    size = P.shape[1]
    P[:], Q[:], P0[:], R[:], r[:] = 0.0, 0.0, 0.0, 0.0, 0.0
    for a in range(len(own)):
        k = own[a]
        i = size * k
        if size == 1 or state[k] == STICK:
            for c in range(size):
                R[a, c], Q[a, c, c] = w[i + c], 1.0
            continue
        bound, rise = _bound(equation, varies, parameters, k, f[i])
        if bound > 0.0:
            here, there, before = f[i : i + 3], w[i : i + 3], f0[i : i + 3]
            _slip(
                here,
                there,
                before,
                slides[k],
                length[k],
                bound / f[i],
                1.0 - shift,
                bound,
                rise,
                P[a],
                Q[a],
                P0[a],
                R[a],
                r[a],
            )
        else:
            R[a, 0], Q[a, 0, 0] = w[i], 1.0
            for c in range(1, 3):
                R[a, c], P[a, c, c] = length[k] * f[i + c], length[k]


@kernel(void(EQUATION_POINTER, boolean, NUMBER, VECTOR, MATRIX, int64, VECTOR, VECTOR, COUNTS))
def _states(equation, varies, shift, length, parameters, size, f, w, state):
    """Branches of the natural map, no tolerance."""
    for k in range(len(state)):
        i = size * k
        normal = f[i] - w[i] / length[k]
        if size == 1:
            state[k] = SLIP if normal > 0.0 else OPEN
            continue
        v1, v2 = f[i + 1] - w[i + 1] / length[k], f[i + 2] - w[i + 2] / length[k]
        across = np.sqrt(v1 * v1 + v2 * v2)
        if normal <= (-parameters[k, 0] * across if shift == 0.0 else 0.0):
            state[k] = OPEN
        else:
            bound, _ = _bound(equation, varies, parameters, k, max(normal, 0.0))
            state[k] = STICK if across <= bound else SLIP


@kernel(void(EQUATION_POINTER, boolean, MATRIX, VECTOR, MASK))
def _on_cone(equation, varies, parameters, f, found):
    """Contacts that are loaded and on their cones."""
    largest = 0.0
    for k in range(len(found)):
        largest = max(largest, f[3 * k])
    for k in range(len(found)):
        i = 3 * k
        found[k] = False
        if f[i] > LOADED * largest:
            bound, _ = _bound(equation, varies, parameters, k, f[i])
            found[k] = bound > 0.0 and np.sqrt(f[i + 1] ** 2 + f[i + 2] ** 2) >= (1.0 - ON_CONE) * bound


@kernel(
    void(
        EQUATION_POINTER,
        boolean,
        MATRIX,
        VECTOR,
        MATRIX,
        MATRIX,
        VECTOR,
        MATRIX,
        VECTOR,
        MATRIX,
        MASK,
        COUNTS,
        NUMBER,
        VECTOR,
        MATRIX,
        MATRIX,
        MATRIX,
        MATRIX,
        MATRIX,
        COUNTS,
    )
)
def _touching(
    equation,
    varies,
    S,
    length,
    parameters,
    rougher,
    rate,
    drate,
    f0,
    F0,
    on_cone,
    closing,
    h,
    gap,
    dgap,
    shift,
    dshift,
    left,
    lean,
    whose,
):
    """Where contacts touch that are open when a step of length h begins: with the rates of its start,

        x h w_t', x = -w_n/(h w_n'),

    closed contacts staying closed, those on their cones sliding against their forces or not at all.

    Parameters
    ----------
    closing : (c,) int array
    gap, dgap : (c,), (c, p) array
        What they have to go.
    shift, dshift : (c, 2), (2 c, p) array
        Filled.
    """
    m, p = len(length), F0.shape[1]
    own = np.flatnonzero(f0[::3] > 0.0)
    count = len(own)
    P, Q, slides = np.zeros((count, 3, 3)), np.zeros((count, 3, 3)), on_cone.copy()
    e, rise, smooth = np.zeros((m, 2)), np.zeros(m), np.zeros(m, np.bool_)
    for k in own:
        bound, rise[k] = _bound(equation, varies, parameters, k, f0[3 * k])
        smooth[k] = bound <= 0.0
        if on_cone[k]:
            t0 = np.sqrt(f0[3 * k + 1] ** 2 + f0[3 * k + 2] ** 2)
            e[k, 0], e[k, 1] = f0[3 * k + 1] / t0, f0[3 * k + 2] / t0
    df, right, J = np.zeros(3 * m), np.zeros((3 * count, 1)), np.zeros((3 * count, 3 * count))
    dw = rate.copy()
    for _ in range(PIVOTS):
        P[:], Q[:] = 0.0, 0.0
        for a in range(count):
            k = own[a]
            Q[a, 0, 0] = 1.0
            if smooth[k]:
                P[a, 1, 1] = P[a, 2, 2] = length[k]
            elif slides[k]:
                P[a, 1, 0], P[a, 1, 1], P[a, 1, 2] = -length[k] * rise[k], length[k] * e[k, 0], length[k] * e[k, 1]
                Q[a, 2, 1], Q[a, 2, 2] = -e[k, 1], e[k, 0]
            else:
                Q[a, 1, 1] = Q[a, 2, 2] = 1.0
            for row in range(3):
                right[3 * a + row, 0] = 0.0
                for c in range(3):
                    right[3 * a + row, 0] -= Q[a, row, c] * rate[3 * k + c]
        J = _system(S, P, Q, own)
        found = _solved(J, right)
        for a in range(count):
            for c in range(3):
                df[3 * own[a] + c] = found[3 * a + c, 0]
        dw = np.dot(S, df) + rate
        changed = False
        for k in own:
            if not on_cone[k]:
                continue
            i = 3 * k
            if slides[k]:
                turns = e[k, 0] * dw[i + 1] + e[k, 1] * dw[i + 2] > 0.0
            else:
                turns = e[k, 0] * df[i + 1] + e[k, 1] * df[i + 2] - rise[k] * df[i] > 0.0
            if turns:
                slides[k], changed = not slides[k], True
        if not changed:
            break
    if len(whose):
        drate = drate + _bent(left, lean, whose, df, p)
    right = np.zeros((3 * count, p))
    for a in range(count):
        k = own[a]
        i, κ = 3 * k, length[k]
        for row in range(3):
            for c in range(3):
                if Q[a, row, c] != 0.0:
                    right[3 * a + row] -= Q[a, row, c] * drate[i + c]
        if slides[k] and not smooth[k]:
            t0 = np.sqrt(f0[i + 1] ** 2 + f0[i + 2] ** 2)
            # The direction turns with its force: de = n (n·df⁰)/t⁰, n across e.
            by_force = κ * (e[k, 0] * df[i + 2] - e[k, 1] * df[i + 1]) / t0
            by_way = -(e[k, 0] * dw[i + 1] + e[k, 1] * dw[i + 2]) / t0
            bends = 0.0
            if varies:
                step = SHARE * f0[i]
                above, below = (
                    _bound(equation, varies, parameters, k, f0[i] + step),
                    _bound(equation, varies, parameters, k, f0[i] - step),
                )
                bends = (above[1] - below[1]) / (2.0 * step)
            for j in range(p):
                turn = e[k, 0] * F0[i + 2, j] - e[k, 1] * F0[i + 1, j]
                right[3 * a + 1, j] -= by_force * turn - κ * (rougher[k, j] + bends * F0[i, j]) * df[i]
                right[3 * a + 2, j] -= by_way * turn
    slope = _solved(J, right) if count else right
    spread = np.zeros((3 * m, p))
    for a in range(count):
        for c in range(3):
            spread[3 * own[a] + c] = slope[3 * a + c]
    rows = np.empty(3 * len(closing), np.int64)
    for a in range(len(closing)):
        for c in range(3):
            rows[3 * a + c] = 3 * closing[a] + c
    moved = _moved(S, rows, 3, own, spread)
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
                dx = by_gap * dgap[a, j] + by_fall * (drate[i, j] + moved[3 * a, j])
                slide = drate[i + 1 + c, j] + moved[3 * a + 1 + c, j]
                dshift[2 * a + c, j] = h * (dx * dw[i + 1 + c] + x * slide)


@kernel(
    int64(
        EQUATION_POINTER,
        boolean,
        NUMBER,
        MATRIX,
        VECTOR,
        MATRIX,
        MATRIX,
        boolean,
        VECTOR,
        MATRIX,
        VECTOR,
        VECTOR,
        MATRIX,
        MATRIX,
        VECTOR,
        MATRIX,
        MATRIX,
        MATRIX,
        COUNTS,
        int64,
        boolean,
        VECTOR,
        MATRIX,
        COUNTS,
        VECTOR,
    )
)
def _walk(
    equation,
    varies,
    shift,
    S,
    length,
    parameters,
    rougher,
    followed,
    ends,
    guess,
    b0,
    b1,
    B0,
    B1,
    anchor,
    dA,
    left,
    lean,
    whose,
    first,
    forced,
    f,
    F,
    state,
    q,
):
    """Go the steps of one sample's path again, with derivatives.

    Parameters
    ----------
    equation, varies, shift
        The law's.
    S : (d m, d m) array
        mm/N, symmetric; d is 1 for normal forces alone.
    length : (m,) array
        The contacts' own compliance, mm/N.
    parameters, rougher : (m, ...), (m, p) array
        Of the law, and derivatives of the coefficients.
    followed : bool
        Whether steps are the follower's, the first of which leads nowhere.
    ends, guess : (k,), (k, d m) array
        Where steps end, and the forces there.
    b0, b1, B0, B1 : (d m,), (d m, p) array
        Displacements without contact forces where the path begins and ends, and their slopes.
    anchor, dA : (2 m,), (2 m, p) array
        Where the contacts stand at first; empty where d is 1.
    left, lean, whose : (l, d m), (l, d m), (l,) array
        Changes of S, each an input's: ``left leanᵀ`` per unit.
    first : int
        Step to begin with; f and F are those of the one before.
    forced : bool
        Whether this step is taken as it was found, whatever it leaves.
    f, F, state : (d m,), (d m, p), (m,) array
        Receive forces, slopes and states at the end.
    q : (d m,) array
        Receives what loads alone move in the last step, slip from where it is measured.

    Returns
    -------
    int
        The step for which no solution was found, or how many there are.
    """
    m, p = len(length), F.shape[1]
    size = len(b0) // m
    now, w, f0, on_cone, slides = (
        np.zeros(m, np.int64),
        np.zeros(len(b0)),
        np.zeros(len(b0)),
        np.zeros(m, np.bool_),
        np.zeros(m, np.bool_),
    )
    rate, drate, unbent = b1 - b0, B1 - B0, np.zeros((len(b0), p))
    P, Q, P0 = np.zeros((m, size, size)), np.zeros((m, size, size)), np.zeros((m, size, size))
    R, r, dκ = np.zeros((m, size)), np.zeros((m, size, 2)), np.zeros((m, p))
    for i in range(len(whose)):  # the contacts' own compliance changes, too
        for k in range(m):
            own_row = size * k
            for j in range(own_row, own_row + size):
                if S[j, j] > S[own_row, own_row]:
                    own_row = j
            dκ[k, whose[i]] += left[i, own_row] * lean[i, own_row]
    for number in range(first, len(ends)):
        s, begin = ends[number], ends[number - 1] if number else 0.0
        h, second = s - begin, followed and number > 0
        f0[:] = f
        q[:] = b0 + s * rate
        if size == 3:
            moved = np.dot(S, f0)
            for k in range(m):
                i = 3 * k
                for c in range(1, 3):
                    if number:
                        q[i + c] = h * rate[i + c] - moved[i + c]
                    else:
                        q[i + c] -= anchor[2 * k + c - 1]
        x = guess[number].copy()
        closing, slides[:] = np.zeros(0, np.int64), False
        shifts, dshift = np.zeros((0, 2)), np.zeros((0, p))
        before = np.flatnonzero(f0[::size] != 0.0)
        bent = unbent if not len(whose) else _bent(left, lean, whose, f0, p)
        if second:
            _on_cone(equation, varies, parameters, f0, on_cone)
            slides[:] = on_cone
            closing = np.flatnonzero((f0[::3] <= 0.0) & (x[::3] > 0.0))
            if len(closing):
                rows = 3 * closing
                gap, dgap = np.empty(len(rows)), _moved(S, rows, 3, before, F)
                for a in range(len(rows)):
                    gap[a] = moved[rows[a]] + b0[rows[a]] + begin * rate[rows[a]]
                    dgap[a] += B0[rows[a]] + begin * drate[rows[a]] + bent[rows[a]]
                shifts, dshift = np.zeros((len(closing), 2)), np.zeros((2 * len(closing), p))
                _touching(
                    equation,
                    varies,
                    S,
                    length,
                    parameters,
                    rougher,
                    rate,
                    drate,
                    f0,
                    F,
                    on_cone,
                    closing,
                    h,
                    gap,
                    dgap,
                    shifts,
                    dshift,
                    left,
                    lean,
                    whose,
                )
                for a in range(len(closing)):
                    for c in range(2):
                        q[rows[a] + 1 + c] -= shifts[a, c]
        alone = forced and number == first
        done, slopes = False, alone or not second
        for _ in range(STEPS):
            scale = max(np.abs(x).max() if len(x) else 0.0, 1e-300)
            w[:] = np.dot(S, x) + q
            _states(equation, varies, shift, length, parameters, size, x, w, now)
            moves = False
            for k in range(m):
                i = size * k
                if now[k] == OPEN:
                    for c in range(i, i + size):
                        moves = moves or x[c] != 0.0
                        x[c] = 0.0
                elif now[k] == SLIP and size == 3:  # without a direction of its own it has that of the map
                    bound, _ = _bound(equation, varies, parameters, k, x[i])
                    if bound > 0.0 and np.sqrt(x[i + 1] ** 2 + x[i + 2] ** 2) <= UNTOLD * bound:
                        v1, v2 = x[i + 1] - w[i + 1] / length[k], x[i + 2] - w[i + 2] / length[k]
                        t = np.sqrt(v1 * v1 + v2 * v2)
                        x[i + 1], x[i + 2], moves = bound * v1 / t, bound * v2 / t, True
            if moves:
                w[:] = np.dot(S, x) + q
            own = np.flatnonzero(now != OPEN)
            count = len(own)
            _equations(
                equation,
                varies,
                shift,
                length,
                parameters,
                own,
                now,
                slides,
                x,
                w,
                f0,
                P[:count],
                Q[:count],
                P0[:count],
                R[:count],
                r[:count],
            )
            right = np.empty((size * count, 1 + (p if slopes else 0)))
            for a in range(count):
                for row in range(size):
                    right[size * a + row, 0] = -R[a, row]
            if slopes and count:
                tangents = np.empty((size - 1) * count, np.int64)
                for a in range(count):
                    for c in range(size - 1):
                        tangents[(size - 1) * a + c] = 3 * own[a] + 1 + c
                dmoved = np.zeros((len(tangents), p))
                if number and size == 3:
                    dmoved = _moved(S, tangents, 3, before, F)
                bends = bent if not len(whose) else _bent(left, lean, whose, x, p)
                place = np.full(m, -1)
                for a in range(len(closing)):
                    place[closing[a]] = a
                dq = np.empty((size, p))
                for a in range(count):
                    k = own[a]
                    i = size * k
                    dq[0] = B0[i] + s * drate[i]
                    for c in range(1, size):
                        if number:
                            dq[c] = h * drate[i + c] - dmoved[2 * a + c - 1]
                            if place[k] >= 0:
                                dq[c] -= dshift[2 * place[k] + c - 1]
                        else:
                            dq[c] = B0[i + c] + s * drate[i + c] - dA[2 * k + c - 1]
                    if len(whose):
                        for c in range(size):
                            dq[c] += bends[i + c]
                            if number and c:
                                dq[c] -= bent[i + c]
                    for row in range(size):
                        target = right[size * a + row, 1:]
                        target[:] = 0.0
                        for c in range(size):
                            if Q[a, row, c] != 0.0:
                                target -= Q[a, row, c] * dq[c]
                            if P0[a, row, c] != 0.0:
                                target -= P0[a, row, c] * F[i + c]
                        if r[a, row, 0] != 0.0:
                            target -= r[a, row, 0] * rougher[k]
                        if r[a, row, 1] != 0.0 and len(whose):
                            target -= r[a, row, 1] * dκ[k]
            found = _solved(_system(S, P[:count], Q[:count], own), right)
            change = 0.0
            for a in range(count):
                for c in range(size):
                    step = found[size * a + c, 0]
                    change = max(change, abs(step)) if np.isfinite(step) else np.inf
                    if not alone:
                        x[size * own[a] + c] += step
            if not np.isfinite(change):
                break
            # Where two states both hold, on the cone without slip, either has these forces and slopes.
            if slopes and (alone or change <= SETTLED * scale):
                f[:], F[:], state[:], done = x, 0.0, now, True
                for a in range(count):
                    for c in range(size):
                        F[size * own[a] + c] = found[size * a + c, 1:]
                break
            slopes = slopes or change <= NEAR * scale
        if not done:
            f[:] = f0
            return number
    return len(ends)


@kernel(
    void(
        EQUATION_POINTER,
        boolean,
        NUMBER,
        MATRIX,
        VECTOR,
        MATRIX,
        MATRIX,
        MASK,
        COUNTS,
        VECTOR,
        MATRIX,
        MATRIX,
        MATRIX,
        BLOCKS,
        BLOCKS,
        MATRIX,
        BLOCKS,
        MATRIX,
        MATRIX,
        COUNTS,
        COUNTS,
        MASK,
        MATRIX,
        BLOCKS,
        types.Array(int64, 2, "C"),
        MATRIX,
    )
)
def walks(
    equation,
    varies,
    shift,
    S,
    length,
    parameters,
    rougher,
    followed,
    edges,
    ends,
    guess,
    b0,
    b1,
    B0,
    B1,
    anchor,
    dA,
    left,
    lean,
    whose,
    first,
    forced,
    f,
    F,
    state,
    q,
):
    """Go the paths of n samples again; arguments as of :func:`_walk`, with the sample as first axis.

    Parameters
    ----------
    edges : (n + 1,) int array
        Where the steps of each sample begin among all, ``ends`` and ``guess``.
    first : (n,) int array
        The step to begin with, and in place the one for which no solution was found, or how many there are.
    """
    for i in range(len(first)):
        own = slice(edges[i], edges[i + 1])
        first[i] = _walk(
            equation,
            varies,
            shift,
            S,
            length,
            parameters,
            rougher,
            followed[i],
            ends[own],
            guess[own],
            b0[i],
            b1[i],
            B0[i],
            B1[i],
            anchor[i],
            dA[i],
            left,
            lean,
            whose,
            first[i],
            forced[i],
            f[i],
            F[i],
            state[i],
            q[i],
        )
