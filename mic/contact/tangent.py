r"""Exact derivatives of contact forces and displacements along a path, with respect to any inputs.

A recorded path (:class:`mic.contact.path_record.PathRecord`) is solved again together with its derivative. For
known states of the contacts, one step is the problem ``w = S f + q(s) - a`` with one smooth equation for each
contact

    open    f = 0
    stick   w_n = 0,  w' = 0
    slip    w_n = (1 - σ) μ ‖w'‖,   ‖f_t‖ = g(f_n),   f_t × w' = 0,

where σ is the law's share of the shift, g its bound, a the anchor, and ``w' = w_t - shift``. Linearised, ``P df + Q dw
= r``, it is one linear system over the closed contacts, with all inputs as right-hand sides. The last equation uses the
direction of the force and not ``w'/‖w'‖``: a contact that slipped before lies on its cone with ``w' = 0`` in a step
without motion. The steps are compiled (:mod:`mic.contact.native.path_derivative`).

Second-order steps use the shift of the follower (:mod:`mic.contact.native.follower`), as an unknown: a contact that
lies on its cone at the start of the step, with ``e⁰ = f_t⁰/‖f_t⁰‖``, and slips by ``l = -e⁰·w_t``, has

    shift = -φ(l / ½(c‖f_t⁰‖ + c‖f_t‖)) l e⁰,        φ(z) = 1/z - 1/(eᶻ - 1),

where c is its own compliance; the shift of a contact that closes is its motion before closure, at the rates of the
start of the step. The follower predicts both and accepts predictions within its tolerance; so the two paths differ by
errors of the size that the follower estimates.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, fields, replace
from functools import cached_property

import numpy as np

from mic.contact.compliance_columns import Columns
from mic.contact.friction import Friction
from mic.contact.laws import COULOMB, Law
from mic.contact.native.law_equation import compiled
from mic.contact.path_record import PathRecord
from mic.contact.solver import ContactSolver
from mic.contact.states import OPEN, SLIP, STICK, classify

__all__ = ["ComplianceDerivative", "Contact", "End", "Dual", "lag", "differentiate_path"]

#: Fallback if Newton's method fails: tolerance of the ladder, and fixed-point iterations of the sliders' shifts, at
#: most this many, until they change by less than this fraction of the motion.
FALLBACK_TOLERANCE, MAX_ITERATIONS, CONVERGED = 1e-12, 30, 1e-6
#: Relative slip below which φ is evaluated by its Taylor series.
SMALL = 1e-4


@dataclass(frozen=True)
class Dual:
    """Values of n samples with their derivatives by p inputs, as in dual numbers.

    Attributes
    ----------
    value : (n, r) array
    slope : (n, r, p) array
    """

    value: np.ndarray
    slope: np.ndarray


@dataclass(frozen=True)
class ComplianceDerivative:
    """Derivative of a compliance by inputs: a sum of l terms, each ``left rightᵀ`` per unit of one input.

    Attributes
    ----------
    left, right : (l, d m) array
    inputs : (l,) int array
        Number of the input of each term.
    """

    left: np.ndarray
    right: np.ndarray
    inputs: np.ndarray

    def apply(self, force: np.ndarray, inputs: int) -> np.ndarray:
        """(n, d m, p) ``dS f`` for forces (n, d m)."""
        derivative = np.zeros((*force.shape, inputs))
        for left, right, i in zip(self.left, self.right, self.inputs):
            derivative[:, :, i] += (force @ right)[:, None] * left
        return derivative


@dataclass(frozen=True)
class Contact:
    """m contacts with their law, compliance and friction.

    Attributes
    ----------
    law : Law
    S : (d m, d m) Columns
        mm/N.
    friction : Friction
    friction_slope : (m, p) array
        Derivatives of the coefficients with respect to the inputs.
    dimension : {3, 1}
    compliance_slope : ComplianceDerivative, optional
        Derivatives of S; None if S depends on no input.
    """

    law: Law
    S: Columns
    friction: Friction
    friction_slope: np.ndarray
    dimension: int
    compliance_slope: ComplianceDerivative | None = None


@dataclass(frozen=True)
class End:
    """State of n samples at the end of a path.

    Attributes
    ----------
    force, displacement : Dual
        (n, d m), N and mm.
    anchor : Dual
        (n, (d - 1) m), mm.
    state : (n, m) int8 array
        The :class:`mic.contact.states.ContactState` in the last step.
    normal : Dual
        (n, m): distance to opening or closing: the gap of an open contact, mm, or the normal force of a closed one, N.
    cone : Dual
        (n, m): distance of a sticking contact to slip, N; infinite for others.
    solved : (n,) bool array
        Whether all steps could be solved; other samples keep the recorded forces.
    """

    force: Dual
    displacement: Dual
    anchor: Dual
    state: np.ndarray
    normal: Dual
    cone: Dual
    solved: np.ndarray

    @classmethod
    def join(cls, pieces: Sequence[End]) -> End:
        """Concatenate samples."""

        def joined(arrays):
            if isinstance(arrays[0], Dual):
                return Dual(
                    *(np.concatenate([getattr(array, name) for array in arrays]) for name in ("value", "slope"))
                )
            return np.concatenate(arrays)

        return cls(**{field.name: joined([getattr(piece, field.name) for piece in pieces]) for field in fields(cls)})


def lag(z: np.ndarray) -> np.ndarray:
    """``φ(z) = 1/z - 1/(eᶻ - 1)``: lag of a slider's reference behind its slip, as a fraction of the slip.

    Computed from ``φ(|z|)``, which cannot overflow, and ``φ(z) + φ(-z) = 1``.

    Parameters
    ----------
    z : (n,) array
        Slips of either sign, relative to ``½(c‖f_t⁰‖ + c‖f_t‖)``.
    """
    size = np.abs(z)
    small = size < SMALL
    long = np.where(small, 1.0, size)
    value = np.where(small, 0.5 - size / 12.0, 1.0 / long + np.exp(-long) / np.expm1(-long))
    return np.where(z < 0.0, 1.0 - value, value)


def differentiate_path(
    contact: Contact,
    start: Dual,
    end: Dual,
    anchor: Dual,
    records: Sequence[PathRecord],
    also: np.ndarray | None = None,
) -> End:
    """Solve the recorded paths of n samples again, with derivatives.

    Parameters
    ----------
    contact : Contact
    start, end : Dual
        (n, d m): b at the start and at the end of the leg, mm.
    anchor : Dual
        (n, (d - 1) m), mm.
    records : sequence of PathRecord
        One per sample; its forces are the initial guess of Newton's method.
    also : (m,) bool array, optional
        Contacts that take part in addition to those that carry force in any record.

    Returns
    -------
    End
    """
    d, m, n = contact.dimension, len(contact.friction), len(records)
    touched = np.zeros(m, dtype=bool) if also is None else also.copy()
    for record in records:
        touched |= (record.force[:, ::d] > 0.0).any(axis=0)
    own = np.flatnonzero(touched)
    path, p = _PathSolver(contact, own), start.slope.shape[2]
    whole = Dual(np.zeros((n, d * m)), np.zeros((n, d * m, p)))
    state, cone = np.zeros((n, m), dtype=np.int8), Dual(np.full((n, m), np.inf), np.zeros((n, m, p)))
    force, slope, states, solved = path.solve(records, start, end, anchor)
    whole.value[:, path.rows], whole.slope[:, path.rows], state[:, own] = force, slope, states
    cone.value[:, own], cone.slope[:, own] = path.margin(force, slope, states)
    moved = _under(contact.S, whole)
    if contact.compliance_slope is not None:
        moved = replace(moved, slope=moved.slope + contact.compliance_slope.apply(whole.value, p))
    u = Dual(moved.value + end.value, moved.slope + end.slope)
    place = Dual(u.value.reshape(n, m, d)[:, :, 1:].copy(), u.slope.reshape(n, m, d, p)[:, :, 1:].copy())
    if path.size == 3:  # positions of the sliders, in series with springs
        series = path.series[:, None]
        place.value[:, own] += series * whole.value.reshape(n, m, 3)[:, own, 1:]
        place.slope[:, own] += series[..., None] * whole.slope.reshape(n, m, 3, p)[:, own, 1:]
    gap = slice(0, None, d)
    closed = state != OPEN
    normal = Dual(
        np.where(closed, whole.value[:, gap], u.value[:, gap]),
        np.where(closed[:, :, None], whole.slope[:, gap], u.slope[:, gap]),
    )
    moved_anchor = Dual(place.value.reshape(n, (d - 1) * m), place.slope.reshape(n, (d - 1) * m, p))
    return End(whole, u, moved_anchor, state, normal, cone, solved)


def _under(S: Columns, force: Dual) -> Dual:
    """``S f``."""
    n, r, p = force.slope.shape
    slope = S.under(force.slope.transpose(0, 2, 1).reshape(n * p, r))
    return Dual(S.under(force.value), slope.reshape(n, p, r).transpose(0, 2, 1))


class _PathSolver:
    """Solves the steps of the contacts ``own``, those that carry force anywhere on the path."""

    def __init__(self, contact: Contact, own: np.ndarray):
        d, law = contact.dimension, contact.law
        friction = contact.friction.take(own)
        self.friction = replace(friction, compliance=None)  # included in S
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
        self.friction_slope = np.ascontiguousarray(contact.friction_slope[own])
        self.equation = compiled((law if law.frictional else COULOMB).equation)
        #: Rows of the contacts, and of their anchors, among all.
        self.rows = (d * own[:, None] + np.arange(size)).ravel()
        self.sides = ((d - 1) * own[:, None] + np.arange(size - 1)).ravel()
        none = np.zeros((0, d * len(contact.friction)))
        slope = contact.compliance_slope or ComplianceDerivative(none, none, np.zeros(0))
        sides = (np.ascontiguousarray(side[:, self.rows]) for side in (slope.left, slope.right))
        left, right, inputs = (*sides, slope.inputs.astype(np.int64))
        # The contacts' own compliance changes, too.
        longest = size * np.arange(m) + self.S.diagonal().reshape(m, size).argmax(axis=1)
        softer = np.zeros_like(self.friction_slope)
        np.add.at(softer.T, inputs, left[:, longest] * right[:, longest])
        self.compliance_slope = softer, left, right, inputs

    def solve(self, records: Sequence[PathRecord], start: Dual, end: Dual, anchor: Dual):
        """Forces (n, s m), their slopes (n, s m, p) and states (n, m) at the end of the paths, and whether all steps
        could be solved (n,); s rows per contact."""
        n, m, p = len(records), len(self.length), start.slope.shape[2]
        rows = len(self.rows)
        f, F, q = np.zeros((n, rows)), np.zeros((n, rows, p)), np.zeros((n, rows))
        state, first = np.zeros((n, m), dtype=np.int64), np.zeros(n, dtype=np.int64)
        if not m:  # no contact carries force
            return f, F, state, np.ones(n, dtype=bool)
        from mic.contact.native.linearised_law import LinearisedContacts  # compiles, or reads the cache, when called
        from mic.contact.native.path_derivative import Loads, Records, differentiate

        law = self.equation, self.law.coefficient_varies, float(self.law.shift)
        contacts = LinearisedContacts(
            *law, self.S, self.length, self.parameters, self.friction_slope, *self.compliance_slope
        )
        followed = np.array([record.order == 2 for record in records])
        edges = np.concatenate([[0], np.cumsum([len(record.ends) for record in records])]).astype(np.int64)
        ends = np.concatenate([record.ends for record in records]).astype(float)
        guess = np.concatenate([record.force[:, self.rows] for record in records])
        b0, b1, B0, B1 = (load[:, self.rows] for load in (start.value, end.value, start.slope, end.slope))
        anchors = (array[:, self.sides] for array in (anchor.value, anchor.slope))
        loads = Loads(*(np.ascontiguousarray(load) for load in (b0, b1 - b0, B0, B1 - B0, *anchors)))

        def advance(own: np.ndarray, guess: np.ndarray, forced: bool = False) -> np.ndarray:
            """Solve further steps of some samples (k,); the number of steps that each has reached."""
            step, steps = first[own], [np.arange(a, b) for a, b in zip(edges[own], edges[own + 1])]
            every_step = np.concatenate(steps)
            cut = np.concatenate([[0], np.cumsum([len(numbers) for numbers in steps])]).astype(np.int64)
            some_records = Records(followed[own], cut, ends[every_step], np.ascontiguousarray(guess[every_step]))
            some = f[own], F[own], state[own], q[own]
            differentiate(contacts, some_records, Loads(*(load[own] for load in loads)), step, forced, *some)
            f[own], F[own], state[own], q[own] = some
            return step

        solved, every = np.ones(n, dtype=bool), np.arange(n)
        first = advance(every, guess)
        for i in np.flatnonzero(first < np.diff(edges)):
            own = np.array([i])
            while first[i] < edges[i + 1] - edges[i]:
                at, better = edges[i] + first[i], guess.copy()
                better[at] = self._search(q[i], guess[at], f[i], bool(followed[i]) and first[i] > 0)
                reached = advance(own, better)[0]
                if reached == first[i]:  # keep the recorded forces
                    solved[i], reached = False, advance(own, guess, True)[0]
                first[i] = reached
        return f, F, state, solved

    def margin(self, f, slope, state) -> tuple[np.ndarray, np.ndarray]:
        """Distance of sticking contacts to slip (n, m), N, infinite for others, and its slope (n, m, p)."""
        (n, m), p = state.shape, slope.shape[2]
        if self.size == 1:
            return np.full((n, m), np.inf), np.zeros((n, m, p))
        f, slope = f.reshape(n, m, 3), slope.reshape(n, m, 3, p)
        t = np.hypot(f[:, :, 1], f[:, :, 2])
        bound, bound_slope = (method(f[:, :, 0], self.parameters) for method in (self.law.bound, self.law.bound_slope))
        e = f[:, :, 1:] / np.where(t > 0.0, t, 1.0)[:, :, None]
        growth = bound_slope[..., None] * slope[:, :, 0] + self.friction_slope * f[:, :, :1]
        stick = (state == STICK) & (bound > 0.0)
        margin_slope = growth - np.einsum("nkj,nkjp->nkp", e, slope[:, :, 1:])
        return np.where(stick, bound - t, np.inf), np.where(stick[..., None], margin_slope, 0.0)

    @cached_property
    def _solver(self) -> ContactSolver:
        return ContactSolver(
            self.S, self.friction, self.law, tol=FALLBACK_TOLERANCE, dimension=self.size, semidefinite=True
        )

    def _search(self, b, guess, f0, second: bool) -> np.ndarray:
        """Forces at the end of a step that starts with the forces f⁰, for steps at which Newton's method fails.

        The whole ladder is used, in a fixed-point iteration of the sliders' shifts, which are zero unless the step is
        of `second` order.
        """
        size, m = self.size, len(self.length)
        before = f0.reshape(m, size)
        slides = self._on_cone(before) & second
        shift, f = np.zeros((m, size)), guess
        for _ in range(MAX_ITERATIONS):
            found = self._solver.solve((b - shift.ravel())[None], f[None], refine=False)
            f = found.force[0]
            if not slides.any():
                break
            now = found.displacement[0].reshape(m, size) + shift
            t0, t = (np.hypot(force[:, 1], force[:, 2]) for force in (before, f.reshape(m, size)))
            rotates = slides & (t > 0.0)
            e = before[:, 1:] / np.where(rotates, t0, 1.0)[:, None]
            l = -(e * now[:, 1:]).sum(axis=1)
            z = np.where(rotates, l / (0.5 * self.length * np.where(rotates, t0 + t, 1.0)), 1.0)
            last, shift = shift, np.zeros((m, size))
            shift[:, 1:] = -np.where(rotates, lag(z) * l, 0.0)[:, None] * e
            if np.abs(shift - last).max() <= CONVERGED * max(np.abs(now).max(), 1e-300):
                break
        return f

    def _on_cone(self, f: np.ndarray) -> np.ndarray:
        """(m,) whether contacts are loaded and on their friction cones."""
        if self.size == 1:
            return np.zeros(len(f), dtype=bool)
        bound = self.law.bound(f[:, 0], self.parameters)
        return (classify(f[None], bound[None])[0] == SLIP) & (bound > 0.0)
