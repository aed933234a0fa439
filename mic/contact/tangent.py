r"""Exact derivatives of contact forces and displacements along a path, with respect to any inputs.

A path whose steps are known (:class:`mic.contact.trail.Trail`) is gone again, and its derivative with it. With the
states of the contacts known, one step is the problem ``w = S f + q(s) - a`` with one smooth equation for each contact

    open    f = 0
    stick   w_n = 0,  w' = 0
    slip    w_n = (1 - σ) μ ‖w'‖,   ‖f_t‖ = g(f_n),   f_t × w' = 0,

σ the law's share of the shift, g its bound, a the anchor, and ``w' = w_t - shift``. Linearised, ``P df + Q dw = r``, it
is one linear system over the contacts that are closed, with all inputs as right-hand sides. The last equation holds the
direction of slip to that of the force and not to ``w'/‖w'‖``: a contact that slid before, in a step that moves nothing,
lies on its cone with ``w' = 0``. P and Q are local and are taken by complex steps, to rounding.

Of second order the shift is that of the follower (:mod:`mic.contact.native.follower`), but solved for: a contact that
lies on its cone when the step begins, with ``e⁰ = f_t⁰/‖f_t⁰‖``, and slips by ``l = -e⁰·w_t``, has

    shift = -φ(l / ½(c‖f_t⁰‖ + c‖f_t‖)) l e⁰,        φ(z) = 1/z - 1/(eᶻ - 1),

c its own compliance; one that closes has the way that it makes until it touches, with the rates of the step's start.
The follower takes both from a prediction and accepts what is as near to the solution's as its tolerance asks; so this
path and the follower's differ by no more than errors of the size that it estimates.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from mic.contact.columns import Columns
from mic.contact.friction import Friction
from mic.contact.laws import Law
from mic.contact.solver import ContactSolver
from mic.contact.states import LOADED, ON_CONE, OPEN, SLIP, STICK
from mic.contact.trail import Trail

__all__ = ["Contact", "End", "Varied", "retrace"]

#: Newton's steps from what was found before, and by how much of the largest force the last may move them.
STEPS, SETTLED = 8, 1e-9
#: Where Newton's method leads nowhere: tolerance of the ladder, how often the sliders' shifts are renewed, and until
#: they change by no more than this share of the motion.
EXACT, RENEWALS, RENEWED = 1e-12, 30, 1e-6
#: By how much of the largest force a step may move them for the next to be the last.
NEAR = 1e-5
#: Changes of the contacts on their cones that slide when a step begins.
PIVOTS = 10
#: Of the imaginary step: no difference is taken, so that it may vanish beside everything.
STEP = 1e-60
#: Forces of contacts that hold each other are not unique, their displacements are.
HYPERSTATIC = 1e-11


@dataclass(frozen=True)
class Varied:
    """Values of n samples, and their derivatives with respect to p inputs.

    Attributes
    ----------
    value : (n, r) array
    slope : (n, r, p) array
    """

    value: np.ndarray
    slope: np.ndarray

    def __add__(self, other: Varied) -> Varied:
        return Varied(self.value + other.value, self.slope + other.slope)

    def __sub__(self, other: Varied) -> Varied:
        return Varied(self.value - other.value, self.slope - other.slope)

    def __getitem__(self, own) -> Varied:
        return Varied(self.value[own], self.slope[own])

    def times(self, share: np.ndarray) -> Varied:
        """Each sample's multiplied by its own number (n,)."""
        return Varied(share[:, None] * self.value, share[:, None, None] * self.slope)


@dataclass(frozen=True)
class Contact:
    """What m contacts are, under a law.

    Attributes
    ----------
    law : Law
    S : (d m, d m) Columns
        mm/N.
    friction : Friction
    rougher : (m, p) array
        Derivatives of the coefficients with respect to the inputs.
    dimension : {3, 1}
    """

    law: Law
    S: Columns
    friction: Friction
    rougher: np.ndarray
    dimension: int


@dataclass(frozen=True)
class End:
    """Where n samples end.

    Attributes
    ----------
    force, displacement : Varied
        (n, d m), N and mm.
    anchor : Varied
        (n, (d - 1) m), mm.
    state : (n, m) int8 array
        A :class:`mic.contact.states.ContactState` each, of the last step.
    normal : Varied
        (n, m): what is left until the contact closes or opens: the gap, mm, or the normal force, N.
    cone : Varied
        (n, m): what is left until one that sticks slips, N; infinite for others.
    solved : (n,) bool array
        Whether the steps could be solved for; the others hold what was found before.
    """

    force: Varied
    displacement: Varied
    anchor: Varied
    state: np.ndarray
    normal: Varied
    cone: Varied
    solved: np.ndarray


def retrace(contact: Contact, start: Varied, end: Varied, anchor: Varied, trail: Sequence[Trail]) -> End:
    """Go the paths of n samples again, with derivatives.

    Parameters
    ----------
    contact : Contact
    start, end : Varied
        (n, d m): b where the leg begins and where it ends, mm.
    anchor : Varied
        (n, (d - 1) m), mm.
    trail : sequence of Trail
        Of each sample; its forces are where Newton's method starts.

    Returns
    -------
    End
    """
    d, m, n = contact.dimension, len(contact.friction), len(trail)
    touched = np.zeros(m, dtype=bool)
    for one in trail:
        touched |= (one.force[:, ::d] > 0.0).any(axis=0)
    own = np.flatnonzero(touched)
    found = _Walk(contact, own, start, end, anchor).go(trail)
    p = start.slope.shape[2]
    whole = Varied(np.zeros((n, d * m)), np.zeros((n, d * m, p)))
    rows = (d * own[:, None] + np.arange(d)).ravel()
    whole.value[:, rows], whole.slope[:, rows] = found.f.value, found.f.slope
    moved = _under(contact.S, whole)
    u = Varied(moved.value + end.value, moved.slope + end.slope)
    place = Varied(u.value.reshape(n, m, d)[:, :, 1:].copy(), u.slope.reshape(n, m, d, p)[:, :, 1:].copy())
    if contact.law.frictional:
        place.value[:, own], place.slope[:, own] = (
            found.a.value.reshape(n, len(own), 2),
            found.a.slope.reshape(n, len(own), 2, p),
        )
    state = np.zeros((n, m), dtype=np.int8)
    state[:, own] = found.state
    gap = slice(0, None, d)
    closed = state != OPEN
    normal = Varied(
        np.where(closed, whole.value[:, gap], u.value[:, gap]),
        np.where(closed[:, :, None], whole.slope[:, gap], u.slope[:, gap]),
    )
    cone = Varied(np.full((n, m), np.inf), np.zeros((n, m, p)))
    cone.value[:, own], cone.slope[:, own] = found.cone.value, found.cone.slope
    return End(
        whole,
        u,
        Varied(place.value.reshape(n, (d - 1) * m), place.slope.reshape(n, (d - 1) * m, p)),
        state,
        normal,
        cone,
        found.solved,
    )


def _under(S: Columns, force: Varied) -> Varied:
    """``S f``."""
    n, r, p = force.slope.shape
    slope = S.under(force.slope.transpose(0, 2, 1).reshape(n * p, r))
    return Varied(S.under(force.value), slope.reshape(n, p, r).transpose(0, 2, 1))


def _lag(z):
    """``φ(z) = 1/z - 1/(eᶻ - 1)``, complex."""
    small, large = z.real < 1e-2, z.real > 300.0
    there = np.where(small | large, 1.0, z)
    series = 0.5 - z / 12.0 + z**3 / 720.0
    return np.where(small, series, np.where(large, 1.0 / np.where(large, z, 1.0), 1.0 / there - 1.0 / np.expm1(there)))


class _Walk:
    """The contacts that touch anywhere on the way, taken along all samples' steps side by side."""

    def __init__(self, contact: Contact, own, start: Varied, end: Varied, anchor: Varied):
        d, law = contact.dimension, contact.law
        friction, series = contact.friction.take(own), law.compliance(contact.friction)
        self.friction = replace(friction, compliance=None)  # it stands in S
        self.law, self.d, self.size = law, d, 3 if law.frictional else 1
        self.m, (self.n, _, self.p) = len(own), start.slope.shape
        rows = (d * own[:, None] + np.arange(d)).ravel()
        S = contact.S.block(rows).reshape(self.m, d, self.m, d)[:, : self.size, :, : self.size]
        if self.size == 3:
            S = S.copy()
            k = np.arange(self.m)
            S[k, 1, k, 1] += series[own]
            S[k, 2, k, 2] += series[own]
        self.S = S.reshape(self.m * self.size, self.m * self.size)
        self.rows_of_S = self.S.reshape(self.m, self.size, self.m * self.size)
        self.diagonal = self.S.diagonal().reshape(self.m, self.size)
        self.length = np.maximum(self.diagonal.max(axis=1), 1e-300)  # mm/N
        self.μ, self.parameters = friction.coefficient, law.parameters(friction)
        self.rougher = contact.rougher[own]
        pick = (d * own[:, None] + np.arange(self.size)).ravel()
        self.b0, self.b1 = start[:, pick], end[:, pick]
        self.f = Varied(np.zeros((self.n, len(pick))), np.zeros((self.n, len(pick), self.p)))
        sides = ((d - 1) * own[:, None] + np.arange(d - 1)).ravel()
        self.a = anchor[:, sides]
        self.state = np.zeros((self.n, self.m), dtype=np.int8)
        self.cone = Varied(np.full((self.n, self.m), np.inf), np.zeros((self.n, self.m, self.p)))
        self.solved = np.ones(self.n, dtype=bool)
        self.gap = Varied(np.zeros((self.n, self.m)), np.zeros((self.n, self.m, self.p)))
        self.rows = (d * own[:, None] + np.arange(d)).ravel()

    def go(self, trail: Sequence[Trail]) -> _Walk:
        n, m = self.n, self.m
        f, slope = self.f.value, self.f.slope
        for k in range(max((len(one.ends) for one in trail), default=0)):
            act = np.array([i for i, one in enumerate(trail) if k < len(one.ends)])
            s = np.array([trail[i].ends[k] for i in act])
            second = np.array([trail[i].order == 2 and k > 0 for i in act])
            guess = np.stack([trail[i].force[k][self.rows] for i in act]).reshape(len(act), m, self.d)[
                :, :, : self.size
            ]
            q = self.b0[act].times(1.0 - s) + self.b1[act].times(s)
            if self.size == 3:
                q.value.reshape(len(act), m, 3)[:, :, 1:] -= self.a.value[act].reshape(len(act), m, 2)
                q.slope.reshape(len(act), m, 3, self.p)[:, :, 1:] -= self.a.slope[act].reshape(len(act), m, 2, self.p)
            h = np.array([s_ - trail[i].ends[k - 1] if k else s_ for i, s_ in zip(act, s)])
            new, w = self._step(act, q, guess[:, :, : self.size].copy(), second, h)
            f[act], slope[act] = new.value, new.slope
            self.gap.value[act] = w.value[:, :: self.size]
            self.gap.slope[act] = w.slope[:, :: self.size]
            if self.size == 3:
                self.a.value[act] += w.value.reshape(len(act), m, 3)[:, :, 1:].reshape(len(act), 2 * m)
                self.a.slope[act] += w.slope.reshape(len(act), m, 3, self.p)[:, :, 1:].reshape(len(act), 2 * m, self.p)
        if self.size < self.d:  # tangential forces there are none
            wide, lean = np.zeros((n, m, self.d)), np.zeros((n, m, self.d, self.p))
            wide[:, :, 0], lean[:, :, 0] = f, slope
            f, slope = wide.reshape(n, self.d * m), lean.reshape(n, self.d * m, self.p)
        self.f = Varied(f, slope)
        return self

    def _step(self, act, q: Varied, f: np.ndarray, second: np.ndarray, h: np.ndarray) -> tuple[Varied, Varied]:
        """Solve a step of length h (a,) of samples `act` from the forces f (a, m, size); forces and w, with slopes."""
        a, m, size, p = len(act), self.m, self.size, self.p
        f0, slope0 = self.f.value[act].reshape(a, m, size), self.f.slope[act].reshape(a, m, size, p)
        closes = (f0[:, :, 0] <= 0.0) & (f[:, :, 0] > 0.0) & second[:, None]
        touched = np.flatnonzero(closes.any(axis=1) & (size == 3))
        shift = Varied(np.zeros((a, m, size)), np.zeros((a, m, size, p)))
        if touched.size:
            own = self._touching(act[touched], f0[touched], slope0[touched], h[touched])
            shift.value[touched, :, 1:] = np.where(closes[touched][..., None], own.value, 0.0)
            shift.slope[touched, :, 1:] = np.where(closes[touched][..., None, None], own.slope, 0.0)
        moved = q - Varied(shift.value.reshape(a, m * size), shift.slope.reshape(a, m * size, p))
        slides = self._on_cone(f0) & second[:, None]
        first, state = f.copy(), np.zeros((a, m), dtype=np.int8)
        df = np.zeros((a, m, size, p))

        def settled(todo: np.ndarray, steps: int) -> np.ndarray:
            """Newton's method for the samples `todo`, and those of them that it leaves unsolved; slopes are taken once
            it is near, which in steps of first order it is from the beginning."""
            near = ~second
            for _ in range(steps):
                for own, slopes in ((todo[near[todo]], True), (todo[~near[todo]], False)):
                    if not own.size:
                        continue
                    scale = np.maximum(np.abs(f[own]).max(axis=(1, 2), initial=0.0), 1e-300)
                    state[own], f[own], slope, change = self._newton(
                        moved[own], f[own], f0[own], slope0[own] if slopes else None, slides[own]
                    )
                    near[own] = change <= NEAR * scale
                    if slopes:
                        df[own] = slope
                        # Where two states both hold, on the cone without slip, either has these forces and slopes.
                        todo = np.setdiff1d(todo, own[change <= SETTLED * scale])
                if not todo.size:
                    break
            return todo

        lost = settled(np.arange(a), STEPS)
        if lost.size:
            f[lost] = first[lost]
            self._search(moved[lost], f, f0, slides, lost)
            lost = settled(lost, STEPS)
        if lost.size:  # back to what was found
            f[lost] = first[lost]
            state[lost], _, df[lost], _ = self._newton(moved[lost], f[lost], f0[lost], slope0[lost], slides[lost])
            self.solved[act[lost]] = False
        self.state[act] = state
        force = Varied(f.reshape(a, m * size), df.reshape(a, m * size, p))
        self._tell(act, f, df, state)
        return force, Varied(force.value @ self.S, np.matmul(self.S, force.slope)) + q

    def _newton(self, q: Varied, f, f0, slope0, slides):
        """One step of Newton's method from f (a, m, size): states (a, m), forces and, unless `slope0` is None, their
        slopes; and how far (a,) the forces moved."""
        a, m, size = len(f), self.m, self.size
        b = q.value.reshape(a, m, size)
        w = b + (f.reshape(a, m * size) @ self.S).reshape(a, m, size)
        state = self._states(f, w)
        f = np.where((state == OPEN)[:, :, None], 0.0, f)
        w = b + (f.reshape(a, m * size) @ self.S).reshape(a, m, size)
        idx, i = self._closed(state != OPEN)
        now, sliding = state[i, idx], slides[i, idx]

        def residual(f, w, f0, μ):
            return self._residual(idx, f, w, f0, μ, now, sliding)

        found = self._linear(idx, state != OPEN, q, residual, f, w, f0, slope0)
        return state, f + found[..., 0], found[..., 1:], np.abs(found[..., 0]).max(axis=(1, 2), initial=0.0)

    def _search(self, q: Varied, f, f0, slides, lost) -> None:
        """Improve the forces f[lost] where Newton's method leads nowhere: with the whole ladder, the sliders' shifts
        held and renewed."""
        rows, size, m = len(lost), self.size, self.m
        solver = ContactSolver(self.S, self.friction, self.law, tol=EXACT, dimension=size, semidefinite=True)
        shift = np.zeros((rows, m, size))
        for _ in range(RENEWALS):
            guess = f[lost].reshape(rows, m * size)
            found = solver.solve(q.value - shift.reshape(rows, m * size), guess)
            f[lost] = found.force.reshape(rows, m, size)
            if size == 1 or not slides.any():
                break
            now = found.displacement.reshape(rows, m, size) + shift
            state = self._states(f[lost], now - shift)
            turns = slides[lost] & (state == SLIP)
            before, shift = shift, np.zeros_like(shift)
            t0, t = _length(f0[lost], turns), _length(f[lost], turns)
            e = f0[lost][:, :, 1:] / t0[:, :, None]
            l = -(e * now[:, :, 1:]).sum(axis=2)
            back = np.where(turns, _lag(l / (0.5 * self.length * (t0 + t)) + 0j).real * l, 0.0)
            shift[:, :, 1:] = -back[:, :, None] * e
            if np.abs(shift - before).max() <= RENEWED * max(np.abs(now).max(), 1e-300):
                break

    def _touching(self, act, f0, slope0, h) -> Varied:
        """(a, m, 2) where contacts touch that are open when a step of length h begins: with the rates of its start,

            x h w_t', x = -w_n/(h w_n'),

        closed contacts staying closed, those on their cones sliding against their forces or not at all.
        """
        a, m, p = len(act), self.m, self.p
        rate = self.b1[act] - self.b0[act]
        none = np.zeros_like(f0)
        closed, on_cone = f0[:, :, 0] > 0.0, self._on_cone(f0)
        slides = on_cone.copy()
        idx, i = self._closed(closed)
        for _ in range(PIVOTS):
            now = slides[i, idx]

            def residual(f, w, f0, μ, now=now):
                return self._rate(idx, f, w, f0, μ, closed[i, idx], now)

            w = rate.value.reshape(a, m, 3)
            found = self._linear(idx, closed, rate, residual, none, w, f0, None)[..., 0]
            w = w + (found.reshape(a, m * 3) @ self.S).reshape(a, m, 3)
            e = f0[:, :, 1:] / np.where(on_cone, np.hypot(f0[:, :, 1], f0[:, :, 2]), 1.0)[:, :, None]
            back = slides & ((e * w[:, :, 1:]).sum(axis=2) > 0.0)
            leaves = (e * found[:, :, 1:]).sum(axis=2) - self.law.rise(f0[:, :, 0], self.parameters) * found[:, :, 0]
            out = on_cone & ~slides & (leaves > 0.0)
            if not (back | out).any():
                break
            slides = (slides & ~back) | out
        slope = self._linear(idx, closed, rate, residual, found, w, f0, slope0)[..., 1:]
        dw = rate.slope + np.matmul(self.S, slope.reshape(a, m * 3, p))
        dw = dw.reshape(a, m, 3, p)
        gap, dgap, hs = self.gap.value[act], self.gap.slope[act], h[:, None]
        falls = w[:, :, 0] < 0.0
        fall = np.where(falls, w[:, :, 0], -1.0)
        x = np.where(falls, -gap / (hs * fall), 0.0)
        dx = -dgap / (hs * fall)[:, :, None] + (gap / (hs * fall**2))[:, :, None] * dw[:, :, 0]
        dx = np.where(((x > 0.0) & (x < 1.0))[:, :, None], dx, 0.0)
        x = np.clip(x, 0.0, 1.0)
        value = (x * hs)[:, :, None] * w[:, :, 1:]
        return Varied(
            value,
            hs[:, :, None, None] * (dx[:, :, None] * w[:, :, 1:, None] + x[:, :, None, None] * dw[:, :, 1:]),
        )

    @staticmethod
    def _closed(closed) -> tuple[np.ndarray, np.ndarray]:
        """Numbers (a, K) of the contacts that are closed, filled up with others, and of their samples (a, 1)."""
        K = int(closed.sum(axis=1).max(initial=0))
        return np.argsort(~closed, axis=1, kind="stable")[:, :K], np.arange(len(closed))[:, None]

    def _linear(self, idx, closed, q: Varied, residual, f, w, f0, slope0):
        """(a, m, size, 1 + p) a step of Newton's method to the solution of ``residual(f, w, f⁰, μ) = 0``, ``w = S f +
        q``, and the slopes of f; the step alone where there are no slopes of f⁰."""
        a, m, size, p = len(f), self.m, self.size, 0 if slope0 is None else self.p
        solution = np.zeros((a, m, size, 1 + p))
        K = idx.shape[1]
        if not K:
            return solution
        i = np.arange(a)[:, None]
        value, J = _derivative(residual, f[i, idx], w[i, idx], f0[i, idx], self.μ[idx], slope0 is not None)
        P, Q, F0, M = J[..., :size], J[..., size : 2 * size], J[..., 2 * size : 3 * size], J[..., -1]
        matrix = np.matmul(Q, self.rows_of_S[idx]).reshape(a, K, size, m, size)
        matrix = matrix[i[:, :, None], np.arange(K)[:, None], :, idx[:, None, :]].transpose(0, 1, 3, 2, 4)
        matrix = np.ascontiguousarray(matrix)
        matrix[:, np.arange(K), :, np.arange(K)] += P.transpose(1, 0, 2, 3)
        right = np.zeros((a, K, size, 1 + p))
        right[..., 0] = -value
        if slope0 is not None:
            right[..., 1:] = -np.matmul(Q, q.slope.reshape(a, m, size, p)[i, idx])
            right[..., 1:] -= np.matmul(F0, slope0[i, idx])
            right[..., 1:] -= M[..., None] * self.rougher[idx][:, :, None]
        right[~closed[i, idx]] = 0.0
        found = _solved(matrix.reshape(a, K * size, K * size), right.reshape(a, K * size, 1 + p))
        solution[i, idx] = found.reshape(a, K, size, 1 + p)
        return solution

    def _on_cone(self, f0):
        """Which contacts lie on their cones (a, m), loaded."""
        if self.size == 1:
            return np.zeros(f0.shape[:2], dtype=bool)
        bound = self.law.bound(f0[:, :, 0], self.parameters)
        loaded = f0[:, :, 0] > LOADED * f0[:, :, 0].max(axis=1, keepdims=True, initial=0.0)
        return loaded & (np.hypot(f0[:, :, 1], f0[:, :, 2]) >= (1.0 - ON_CONE) * bound) & (bound > 0.0)

    def _states(self, f, w):
        """(a, m) branches of the natural map, no tolerance."""
        normal = f[:, :, 0] - w[:, :, 0] / self.length
        if self.size == 1:
            return np.where(normal > 0.0, SLIP, OPEN).astype(np.int8)
        across = np.hypot(*np.moveaxis(f[:, :, 1:] - w[:, :, 1:] / self.length[:, None], 2, 0))
        opens = normal <= (-self.μ * across if self.law.shift == 0.0 else 0.0)
        bound = self.law.bound(np.maximum(normal, 0.0), self.parameters)
        return np.where(opens, OPEN, np.where(across <= bound, STICK, SLIP)).astype(np.int8)

    def _residual(self, idx, f, w, f0, μ, state, slides):
        """(..., a, K, size) of the contacts `idx`, mm, complex; `slides` are those that slid when the step began."""
        κ, closed, slip = self.length[idx], state != OPEN, state == SLIP
        R = np.zeros(f.shape, dtype=complex)
        R[..., 0] = w[..., 0]
        if self.size == 3:
            normal = f[-1, ..., 0].real
            bound, rise = self._bound(idx, normal)
            # To first order about what it is, which is all that derivatives take.
            g = bound + rise * (f[..., 0] - normal) + (μ - μ[-1]) * normal
            rough = (bound > 0.0) & slip
            t = _length(f, rough)
            w1, w2 = w[..., 1], w[..., 2]
            turns = slides & rough
            if turns.any():
                t0 = _length(f0, turns)
                e1, e2 = f0[..., 1] / t0, f0[..., 2] / t0
                l = -(e1 * w1 + e2 * w2)
                back = np.where(turns, _lag(l / (0.5 * κ * (t0 + t))) * l, 0.0)
                w1, w2 = w1 + back * e1, w2 + back * e2
            if self.law.shift == 0.0:
                R[..., 0] += μ * np.where(rough, f[..., 1] * w1 + f[..., 2] * w2, 0.0) / t
            weight = np.where(rough, np.hypot(w1[-1].real, w2[-1].real) / κ + bound, 1.0)
            R[..., 1] = np.where(slip, κ * np.where(rough, t - g, f[..., 1]), w[..., 1])
            R[..., 2] = np.where(
                slip, np.where(rough, (f[..., 1] * w2 - f[..., 2] * w1) / weight, κ * f[..., 2]), w[..., 2]
            )
        return np.where(closed[..., None], R, κ[..., None] * f)

    def _rate(self, idx, f, w, f0, μ, closed, slides):
        """(..., a, K, 3) of rates f and w when a step begins from the forces f⁰, mm, complex."""
        κ = self.length[idx]
        rise = self._bound(idx, f0[-1, ..., 0].real)[1] + (μ - μ[-1])
        t0 = _length(f0, slides)
        e1, e2 = f0[..., 1] / t0, f0[..., 2] / t0
        R = w.copy()
        R[..., 1] = np.where(slides, κ * (e1 * f[..., 1] + e2 * f[..., 2] - rise * f[..., 0]), w[..., 1])
        R[..., 2] = np.where(slides, e1 * w[..., 2] - e2 * w[..., 1], w[..., 2])
        smooth = closed & (self._bound(idx, f0[-1, ..., 0].real)[0] <= 0.0)
        for j in (1, 2):
            R[..., j] = np.where(smooth, κ * f[..., j], R[..., j])
        return np.where(closed[..., None], R, κ[..., None] * f)

    def _bound(self, idx, normal):
        """Largest tangential forces of the contacts `idx` (a, K), and how they rise with the normal forces."""
        every = np.zeros((len(idx), self.m))
        np.put_along_axis(every, idx, normal, axis=1)
        return tuple(
            np.take_along_axis(np.broadcast_to(of(every, self.parameters), every.shape), idx, axis=1)
            for of in (self.law.bound, self.law.rise)
        )

    def _tell(self, act, f, df, state) -> None:
        """What is left of the bound of contacts that stick."""
        if self.size == 1:
            return
        t = np.hypot(f[:, :, 1], f[:, :, 2])
        e = f[:, :, 1:] / np.where(t > 0.0, t, 1.0)[:, :, None]
        bound, rise = (of(f[:, :, 0], self.parameters) for of in (self.law.bound, self.law.rise))
        grown = rise[..., None] * df[:, :, 0] + self.rougher * f[:, :, 0, None]
        stick = (state == STICK) & (bound > 0.0)
        self.cone.value[act] = np.where(stick, bound - t, np.inf)
        self.cone.slope[act] = np.where(stick[..., None], grown - np.einsum("akj,akjp->akp", e, df[:, :, 1:]), 0.0)


def _length(f: np.ndarray, where: np.ndarray) -> np.ndarray:
    """``‖f_t‖``, complex, and 1 elsewhere."""
    return np.sqrt(np.where(where, f[..., 1] ** 2 + f[..., 2] ** 2, 1.0))


def _derivative(residual, f, w, f0, μ, inputs: bool) -> tuple[np.ndarray, np.ndarray]:
    """What a residual (a, K, size) is, and its derivatives (a, K, size, 2 size) with respect to f and w, with `inputs`
    (a, K, size, 3 size + 1) f⁰ and μ as well: each moved by an imaginary step, all at once."""
    size = f.shape[-1]
    count = 3 * size + 1 if inputs else 2 * size
    moved = [np.broadcast_to(x, (count + 1, *x.shape)).astype(complex) for x in (f, w, f0, μ)]
    for number, one in enumerate(moved[: 3 if inputs else 2]):
        for j in range(size):
            one[number * size + j, ..., j] += 1j * STEP
    if inputs:
        moved[3][count - 1] += 1j * STEP
    R = residual(*moved)
    return R[-1].real, np.moveaxis(R[:-1].imag / STEP, 0, -1)


def _solved(matrix: np.ndarray, right: np.ndarray) -> np.ndarray:
    """Linear systems of a batch; where contacts hold each other, the least forces."""
    try:
        found = np.linalg.solve(matrix, right)
        size = np.abs(right).max(axis=(1, 2), initial=0.0)
        error = np.abs(matrix @ found - right).max(axis=(1, 2), initial=0.0)
        bad = np.flatnonzero(~(error <= 1e-9 * np.maximum(size, 1e-300)))
    except np.linalg.LinAlgError:
        found, bad = np.zeros_like(right), np.arange(len(matrix))
    for i in bad:
        if np.isfinite(matrix[i]).all() and np.isfinite(right[i]).all():
            found[i] = np.linalg.lstsq(matrix[i], right[i], rcond=HYPERSTATIC)[0]
    return found
