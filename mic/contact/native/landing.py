"""Newton's method from a guess, where most of the contacts that carry force are the same in all samples.

Of these contacts, the held ones P, ``V = W_PP⁻¹`` is had once. Where their displacements are given, and the forces of
all others, N,

.. math::  dy_P = V (dw_P - W_{PN} dy_N), \\quad dw_N = W_{NP} dy_P + W_{NN} dy_N,

a sample has few unknowns of its own: displacements of held contacts that do not stick, forces of others that are not
open. Only for them a matrix is factorised; its blocks are those of V, of ``∓ V W_PN`` and of ``W_NN - W_NP V W_PN``.
Columns of ``V W_PN`` are found when a sample first needs them, and kept. What is found is judged by W itself.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from mic.contact.native.law_equation import derivative, force_scale, starting_scale
from mic.contact.native.linear_step import linear_step
from mic.contact.native.matrices import block, times
from mic.contact.native.problem import ScaledProblem
from mic.contact.states import OPEN, STICK

if TYPE_CHECKING:
    from mic.contact.compliance_columns import Columns

__all__ = ["Landing"]

STEPS = 12  # of Newton's method
TOGETHER = 8  # columns that are found at once, always so many: BLAS adds up others in another order
SETTLED = 1e-3  # of the tolerance: what is so near to nothing is no unknown
EVERY = -1  # no state: of no contact's unknowns is any known beforehand


class Landing:
    """Contacts that most samples press: their inverse, and how they answer to others.

    Parameters
    ----------
    held : ScaledProblem
        Of these contacts alone.
    unit : (3p,) array
        Their scaled forces' units, as :class:`mic.contact.native.solver.NativeSolver` has them.
    own : (m,) bool array
        Which they are of all m.
    S : (3m, 3m) Columns
        Compliance over all.
    """

    def __init__(self, held: ScaledProblem, unit: np.ndarray, own: np.ndarray, S: Columns):
        self._inverse, self._unit, self._own = held.splitting[0], unit, own
        self._answers = S.through(self._answer, len(unit))

    def __bool__(self) -> bool:
        """Whether the inverse is accurate."""
        return len(self._inverse) > 0

    def _answer(self, column: np.ndarray) -> np.ndarray:
        """(k, 3p) columns of ``V W_PN``, but for the units of the forces in N, from columns (k, 3m) of S."""
        padded = np.zeros((-(-len(column) // TOGETHER) * TOGETHER, len(self._unit)))
        padded[: len(column)] = column[:, np.repeat(self._own, 3)] * self._unit
        for first in range(0, len(padded), TOGETHER):
            padded[first : first + TOGETHER] = padded[first : first + TOGETHER] @ self._inverse
        return padded[: len(column)]

    def solve(self, problem: ScaledProblem, unit: np.ndarray, among: np.ndarray, Q: np.ndarray, Y: np.ndarray, tol):
        """Every sample by itself, from the forces Y (n, 3k), which become those with the least error.

        Parameters
        ----------
        problem : ScaledProblem
            Of the contacts `among` (k,) of all; the held ones are among them.
        unit : (3k,) array
            Its scaled forces' units.
        Q : (n, 3k) array
        tol : float
            Of the error, as :func:`mic.contact.native.newton.newton` has it.

        Returns
        -------
        (n,) int array
            Factorisations of each.
        """
        return np.array([self._land(problem, unit, among, q, y, tol) for q, y in zip(Q, Y)], dtype=np.int64)

    def _land(self, problem, unit, among, q, best, tol):
        """One sample; `best` is changed in place."""
        held, m = self._own[among], len(among)
        rows, place = _rows(np.flatnonzero(held)), np.cumsum(held) - 1
        scale, least, y = starting_scale(q), np.inf, best.copy()
        phi, w, state = np.empty(3 * m), np.empty(3 * m), np.empty(m, np.int64)
        A, B = np.empty((m, 3, 3)), np.empty((m, 3, 3))
        two = np.full(1, -1)  # contacts whose forces are unknown, and what that takes
        for step in range(STEPS + 1):
            times(problem.W, y, w)
            w += q
            derivative(problem.equation, problem.parameters, y, w, phi, A, B, state)
            # Without the contacts that obey their law, whose number hangs on what others need.
            error, size = np.linalg.norm(phi[phi != 0.0]), force_scale(scale, q, y, w)
            if error < least:
                least, best[:] = error, y
            if error <= tol * size or step == STEPS or not np.isfinite(error):
                break
            nought = np.where(np.repeat(held, 3), w, y).reshape(m, 3)
            unknown = np.where(held, state != STICK, state != OPEN)
            unknown |= (np.abs(nought) > SETTLED * tol * size).any(axis=1)
            if unknown.sum() > (state != OPEN).sum():  # more than without an inverse
                break
            one, before, two = np.flatnonzero(unknown & held), two, np.flatnonzero(unknown & ~held)
            mine, others, few = np.append(one, two), _rows(two), 3 * len(one)
            if not np.array_equal(before, two):
                touching = problem.W[others][:, rows]  # W_NP
                answers = self._answers.take(_rows(among[two])) * unit[others, None]  # (V W_PN)ᵀ
                free = block(problem.W, two, 3) - answers @ touching.T
            columns = np.empty((3 * len(mine),) * 2)
            columns[:few, :few] = block(self._inverse, place[one], 3)
            columns[few:, :few] = -answers[:, _rows(place[one])]
            columns[:few, few:] = -columns[few:, :few].T
            columns[few:, few:] = free
            first, second = A[mine], B[mine]
            first[: len(one)], second[: len(one)] = B[one], A[one]
            x, nothing = np.empty(len(columns)), np.empty(0)
            linear_step(columns, first, second, phi[_rows(mine)], state[mine], EVERY, nothing, 0.0, False, x)
            change, answer = -(x[few:] @ touching), np.empty(len(rows))
            change[_rows(place[one])] += x[:few]
            times(self._inverse, change, answer)
            y[rows] += answer
            y[others] += x[few:]
        return step


def _rows(contacts: np.ndarray) -> np.ndarray:
    """(3k,) rows of contacts (k,)."""
    return (3 * contacts[:, None] + np.arange(3)).ravel()
