r"""Exact derivatives of contact forces and displacements along a path, with respect to any inputs.

A path whose steps are known (:class:`mic.contact.path_record.Trail`) is gone again, and its derivative with it. With the
states of the contacts known, one step is the problem ``w = S f + q(s) - a`` with one smooth equation for each contact

    open    f = 0
    stick   w_n = 0,  w' = 0
    slip    w_n = (1 - σ) μ ‖w'‖,   ‖f_t‖ = g(f_n),   f_t × w' = 0,

σ the law's share of the shift, g its bound, a the anchor, and ``w' = w_t - shift``. Linearised, ``P df + Q dw = r``, it
is one linear system over the contacts that are closed, with all inputs as right-hand sides. The last equation holds the
direction of slip to that of the force and not to ``w'/‖w'‖``: a contact that slid before, in a step that moves nothing,
lies on its cone with ``w' = 0``. The steps are compiled (:mod:`mic.contact.native.tangent`).

Of second order the shift is that of the follower (:mod:`mic.contact.native.follower`), but solved for: a contact that
lies on its cone when the step begins, with ``e⁰ = f_t⁰/‖f_t⁰‖``, and slips by ``l = -e⁰·w_t``, has

    shift = -φ(l / ½(c‖f_t⁰‖ + c‖f_t‖)) l e⁰,        φ(z) = 1/z - 1/(eᶻ - 1),

c its own compliance; one that closes has the way that it makes until it touches, with the rates of the step's start.
The follower takes both from a prediction and accepts what is as near to the solution's as its tolerance asks; so this
path and the follower's differ by no more than errors of the size that it estimates.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, fields, replace
from functools import cached_property

import numpy as np

from mic.contact.compliance_columns import Columns
from mic.contact.friction import Friction
from mic.contact.laws import COULOMB, Law
from mic.contact.native.kernels import compiled
from mic.contact.path_record import Trail
from mic.contact.solver import ContactSolver
from mic.contact.states import LOADED, ON_CONE, OPEN, STICK

__all__ = ["Bend", "Contact", "End", "Varied", "lag", "retrace"]

#: Where Newton's method leads nowhere: tolerance of the ladder, how often the sliders' shifts are renewed, and until
#: they change by no more than this share of the motion.
EXACT, RENEWALS, RENEWED = 1e-12, 30, 1e-6
#: Slip, in shares of what turns a slider, below which its shift is a series: it is a guess.
SMALL = 1e-4


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


@dataclass(frozen=True)
class Bend:
    """By how much inputs change a compliance: each of l terms ``left leanᵀ`` per unit of one of them.

    Attributes
    ----------
    left, lean : (l, d m) array
    whose : (l,) int array
        Number of the input.
    """

    left: np.ndarray
    lean: np.ndarray
    whose: np.ndarray

    def under(self, force: np.ndarray, inputs: int) -> np.ndarray:
        """(n, d m, p) ``dS f`` under forces (n, d m)."""
        found = np.zeros((*force.shape, inputs))
        for left, lean, i in zip(self.left, self.lean, self.whose):
            found[:, :, i] += (force @ lean)[:, None] * left
        return found


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
    bend : Bend, optional
        Derivatives of S; left out, no input changes it.
    """

    law: Law
    S: Columns
    friction: Friction
    rougher: np.ndarray
    dimension: int
    bend: Bend | None = None


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

    @classmethod
    def join(cls, pieces: Sequence[End]) -> End:
        """One after the other."""

        def joined(arrays):
            if isinstance(arrays[0], Varied):
                return Varied(*(np.concatenate([getattr(one, name) for one in arrays]) for name in ("value", "slope")))
            return np.concatenate(arrays)

        return cls(**{one.name: joined([getattr(piece, one.name) for piece in pieces]) for one in fields(cls)})


def lag(z: np.ndarray) -> np.ndarray:
    """``φ(z) = 1/z - 1/(eᶻ - 1)``: how far behind the end of its slip a slider's reference is, in shares of it.

    Of ``φ(|z|)``, in which nothing overflows, and ``φ(z) + φ(-z) = 1``.

    Parameters
    ----------
    z : (n,) array
        Slips, in shares of what turns a slider, of either sign.
    """
    size = np.abs(z)
    small = size < SMALL
    long = np.where(small, 1.0, size)
    value = np.where(small, 0.5 - size / 12.0, 1.0 / long + np.exp(-long) / np.expm1(-long))
    return np.where(z < 0.0, 1.0 - value, value)


def retrace(
    contact: Contact,
    start: Varied,
    end: Varied,
    anchor: Varied,
    trail: Sequence[Trail],
    also: np.ndarray | None = None,
) -> End:
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
    also : (m,) bool array, optional
        Contacts that take part beside those that carry force on any trail.

    Returns
    -------
    End
    """
    d, m, n = contact.dimension, len(contact.friction), len(trail)
    touched = np.zeros(m, dtype=bool) if also is None else also.copy()
    for one in trail:
        touched |= (one.force[:, ::d] > 0.0).any(axis=0)
    own = np.flatnonzero(touched)
    walk, p = _Walk(contact, own), start.slope.shape[2]
    whole = Varied(np.zeros((n, d * m)), np.zeros((n, d * m, p)))
    state, cone = np.zeros((n, m), dtype=np.int8), Varied(np.full((n, m), np.inf), np.zeros((n, m, p)))
    force, slope, states, solved = walk.go(trail, start, end, anchor)
    whole.value[:, walk.rows], whole.slope[:, walk.rows], state[:, own] = force, slope, states
    cone.value[:, own], cone.slope[:, own] = walk.margin(force, slope, states)
    moved = _under(contact.S, whole)
    if contact.bend is not None:
        moved = replace(moved, slope=moved.slope + contact.bend.under(whole.value, p))
    u = Varied(moved.value + end.value, moved.slope + end.slope)
    place = Varied(u.value.reshape(n, m, d)[:, :, 1:].copy(), u.slope.reshape(n, m, d, p)[:, :, 1:].copy())
    if walk.size == 3:  # where sliders stand, behind what yields
        yields = walk.series[:, None]
        place.value[:, own] += yields * whole.value.reshape(n, m, 3)[:, own, 1:]
        place.slope[:, own] += yields[..., None] * whole.slope.reshape(n, m, 3, p)[:, own, 1:]
    gap = slice(0, None, d)
    closed = state != OPEN
    normal = Varied(
        np.where(closed, whole.value[:, gap], u.value[:, gap]),
        np.where(closed[:, :, None], whole.slope[:, gap], u.slope[:, gap]),
    )
    return End(
        whole,
        u,
        Varied(place.value.reshape(n, (d - 1) * m), place.slope.reshape(n, (d - 1) * m, p)),
        state,
        normal,
        cone,
        solved,
    )


def _under(S: Columns, force: Varied) -> Varied:
    """``S f``."""
    n, r, p = force.slope.shape
    slope = S.under(force.slope.transpose(0, 2, 1).reshape(n * p, r))
    return Varied(S.under(force.value), slope.reshape(n, p, r).transpose(0, 2, 1))


class _Walk:
    """The contacts ``own`` that touch anywhere on the way, and what their steps are solved with."""

    def __init__(self, contact: Contact, own: np.ndarray):
        d, law = contact.dimension, contact.law
        friction = contact.friction.take(own)
        self.friction = replace(friction, compliance=None)  # it stands in S
        self.law, self.size = law, 3 if law.frictional else 1
        m, size = len(own), self.size
        self.series = law.compliance(contact.friction)[own]
        S = contact.S.block((d * own[:, None] + np.arange(d)).ravel()).reshape(m, d, m, d)[:, :size, :, :size].copy()
        k = np.arange(m)
        for c in range(1, size):
            S[k, c, k, c] += self.series
        self.S = np.ascontiguousarray(S.reshape(m * size, m * size))
        self.length = np.maximum(self.S.diagonal().reshape(m, size).max(axis=1, initial=0.0), 1e-300)  # mm/N
        self.parameters = np.ascontiguousarray(law.parameters(friction), dtype=float)
        self.rougher = np.ascontiguousarray(contact.rougher[own])
        self.equation = compiled((law if law.frictional else COULOMB).equation)
        #: Rows of the contacts, and of their anchors.
        self.rows = (d * own[:, None] + np.arange(size)).ravel()
        self.sides = ((d - 1) * own[:, None] + np.arange(size - 1)).ravel()
        none, bend = np.zeros((0, len(self.rows))), contact.bend
        self.bend = (
            (none, none, np.zeros(0, dtype=np.int64))
            if bend is None
            else (
                np.ascontiguousarray(bend.left[:, self.rows]),
                np.ascontiguousarray(bend.lean[:, self.rows]),
                bend.whose.astype(np.int64),
            )
        )

    def go(self, trail: Sequence[Trail], start: Varied, end: Varied, anchor: Varied):
        """Forces (n, s m), their slopes (n, s m, p) and states (n, m) at the end of the trails, s rows a contact; and
        (n,) whether their steps could be solved for."""
        n, m, p = len(trail), len(self.length), start.slope.shape[2]
        rows = len(self.rows)
        f, F, q = np.zeros((n, rows)), np.zeros((n, rows, p)), np.zeros((n, rows))
        state, first = np.zeros((n, m), dtype=np.int64), np.zeros(n, dtype=np.int64)
        if not m:  # nothing touches anywhere
            return f, F, state, np.ones(n, dtype=bool)
        from mic.contact.native.tangent import walks  # compiles, or reads the cache, when it is imported

        followed = np.array([one.order == 2 for one in trail])
        edges = np.concatenate([[0], np.cumsum([len(one.ends) for one in trail])]).astype(np.int64)
        ends = np.concatenate([one.ends for one in trail]).astype(float)
        guess = np.concatenate([one.force[:, self.rows] for one in trail])
        loads = [np.ascontiguousarray(each[:, self.rows]) for each in (start.value, end.value, start.slope, end.slope)]
        stands = [np.ascontiguousarray(each[:, self.sides]) for each in (anchor.value, anchor.slope)]

        def on(own: np.ndarray, guess: np.ndarray, forced: bool = False) -> np.ndarray:
            """Samples (k,) taken on from where they are; the steps that they reach."""
            step, steps = first[own], [np.arange(a, b) for a, b in zip(edges[own], edges[own + 1])]
            each = np.concatenate(steps)
            some = f[own], F[own], state[own], q[own]
            walks(
                self.equation,
                self.law.varies,
                float(self.law.shift),
                self.S,
                self.length,
                self.parameters,
                self.rougher,
                followed[own],
                np.concatenate([[0], np.cumsum([len(one) for one in steps])]).astype(np.int64),
                ends[each],
                np.ascontiguousarray(guess[each]),
                *(one[own] for one in (*loads, *stands)),
                *self.bend,
                step,
                np.full(len(own), forced),
                *some,
            )
            f[own], F[own], state[own], q[own] = some
            return step

        solved, every = np.ones(n, dtype=bool), np.arange(n)
        first = on(every, guess)
        for i in np.flatnonzero(first < np.diff(edges)):
            own = np.array([i])
            while first[i] < edges[i + 1] - edges[i]:
                at, better = edges[i] + first[i], guess.copy()
                better[at] = self._search(q[i], guess[at], f[i], bool(followed[i]) and first[i] > 0)
                reached = on(own, better)[0]
                if reached == first[i]:  # back to what was found
                    solved[i], reached = False, on(own, guess, True)[0]
                first[i] = reached
        return f, F, state, solved

    def margin(self, f, slope, state) -> tuple[np.ndarray, np.ndarray]:
        """What is left of the bound of contacts that stick (n, m), N, infinite for others, and its slope (n, m, p)."""
        (n, m), p = state.shape, slope.shape[2]
        if self.size == 1:
            return np.full((n, m), np.inf), np.zeros((n, m, p))
        f, slope = f.reshape(n, m, 3), slope.reshape(n, m, 3, p)
        t = np.hypot(f[:, :, 1], f[:, :, 2])
        bound, rise = (of(f[:, :, 0], self.parameters) for of in (self.law.bound, self.law.rise))
        e = f[:, :, 1:] / np.where(t > 0.0, t, 1.0)[:, :, None]
        grown = rise[..., None] * slope[:, :, 0] + self.rougher * f[:, :, :1]
        stick = (state == STICK) & (bound > 0.0)
        left = grown - np.einsum("nkj,nkjp->nkp", e, slope[:, :, 1:])
        return np.where(stick, bound - t, np.inf), np.where(stick[..., None], left, 0.0)

    @cached_property
    def _solver(self) -> ContactSolver:
        return ContactSolver(self.S, self.friction, self.law, tol=EXACT, dimension=self.size, semidefinite=True)

    def _search(self, b, guess, f0, second: bool) -> np.ndarray:
        """Forces at the end of a step from the forces f⁰ of which Newton's method finds none: with the whole ladder,
        the sliders' shifts held and renewed; it is `second`, of second order, or has none."""
        size, m = self.size, len(self.length)
        before = f0.reshape(m, size)
        slides = self._on_cone(before) & second
        shift, f = np.zeros((m, size)), guess
        for _ in range(RENEWALS):
            found = self._solver.solve((b - shift.ravel())[None], f[None])
            f = found.force[0]
            if not slides.any():
                break
            now = found.displacement[0].reshape(m, size) + shift
            t0, t = (np.hypot(each[:, 1], each[:, 2]) for each in (before, f.reshape(m, size)))
            turns = slides & (t > 0.0)
            e = before[:, 1:] / np.where(turns, t0, 1.0)[:, None]
            l = -(e * now[:, 1:]).sum(axis=1)
            z = np.where(turns, l / (0.5 * self.length * np.where(turns, t0 + t, 1.0)), 1.0)
            last, shift = shift, np.zeros((m, size))
            shift[:, 1:] = -np.where(turns, lag(z) * l, 0.0)[:, None] * e
            if np.abs(shift - last).max() <= RENEWED * max(np.abs(now).max(), 1e-300):
                break
        return f

    def _on_cone(self, f: np.ndarray) -> np.ndarray:
        """(m,) contacts that are loaded and on their cones."""
        if self.size == 1:
            return np.zeros(len(f), dtype=bool)
        bound = self.law.bound(f[:, 0], self.parameters)
        loaded = f[:, 0] > LOADED * f[:, 0].max(initial=0.0)
        return loaded & (np.hypot(f[:, 1], f[:, 2]) >= (1.0 - ON_CONE) * bound) & (bound > 0.0)
