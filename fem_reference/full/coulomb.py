"""Contact forces of a condensed equilibrium: Alart and Curnier's Newton method, and proximal points where it fails.

With the gaps and slips w = b + M f of all contacts, M = S + c, c what a contact itself yields (1/ε in the penalty
method), Coulomb's law holds where f is its own projection, for any ρ > 0:

    y = f − ρ w,      f_n = max(0, y_n),      f_t = y_t, shortened to g(f_n) where it is longer.            (1)

Both sides are of one size where 1/ρ is the contact's own compliance M_kk, whereas a penalty makes y as much larger than
f as it is stiffer than the sheets: a slip that turns back then steps over the little disc of the forces that would stop
it, from either side, for ever. Newton's method is that of Alart and Curnier, its tangent of a slipping contact kept
positive as Hüeber, Stadler and Wohlmuth do, with a line search along the natural residual of (1), which may rise for a
few steps.

Where it does not converge, forces f̂ are held on to: M + κ/ρ and b − κ f̂/ρ in place of M and b give contacts that are
the less coupled the larger κ is. From each solution, f̂ ← f, and κ falls tenfold; where that fails, it rises. Each
of these problems is Newton's again, and their limit is the law itself (proximal points, Rockafellar 1976).

References
----------
Alart, Curnier (1991), Comput. Methods Appl. Mech. Engrg 92, 353–375. Hüeber, Stadler, Wohlmuth (2008), A primal-dual
active set algorithm for three-dimensional contact problems with Coulomb friction, SIAM J. Sci. Comput. 30, 572–596.
Rockafellar (1976), Monotone operators and the proximal point algorithm, SIAM J. Control Optim. 14, 877–898.
"""

from __future__ import annotations

import numpy as np

from mic.contact.states import OPEN, SLIP, STICK

__all__ = ["contact_forces"]

ITERATIONS = 50  # of Newton's method
TOLERANCE = 1e-13  # of the natural residual, of the largest force
MEMORY = 5  # the line search compares with the largest residual of so many iterations
SHORTEST = 1 / 64  # step along the line
SOFTEST, FIRST, HARDER, SOFTER = 1e3, 1.0, 0.1, 10.0  # κ: at most, at first, after a success, after a failure
HARDEST = 1e-6  # κ from which the law itself is tried again
NEAR = 1e-3  # residual of the law from which it is tried as well
PROXIMAL = 60  # problems at most


def contact_forces(S: np.ndarray, δ: np.ndarray, at: np.ndarray, law, start: np.ndarray):
    """Forces f that obey a law where the contacts read δ + S (f − at).

    Parameters
    ----------
    S : (m d, m d) array
        mm/N.
    δ : (m, d) array
        mm.
    at : (m, d) array
        N; the nearer to f, the less rounding.
    law : fem_reference.full.equilibrium.ContactLaw
        Its penalty may be infinite: no contact yields then but those that do so of themselves.
    start : (m, d) array
        Forces to begin with, N.

    Returns
    -------
    force : (m, d) array or None
        None where none were found.
    iterations : list of (float, float, (m,) array, int)
        Of each of Newton's: the natural residual, over the largest of the forces' roots of energies; the step's
        length; the contacts' states; how many it changed.
    """
    problem = _Problem(S, δ, at, law)
    found, converged = problem.newton(start, 0.0, start)
    held, κ = start if np.isfinite(start).all() else np.zeros_like(start), FIRST
    for _ in range(PROXIMAL):
        if converged:
            break
        held_on, solved = problem.newton(held, κ, held)
        if not solved:
            κ *= SOFTER
            if κ > SOFTEST:
                break
            continue
        held, κ = held_on, max(κ * HARDER, HARDEST)
        if problem.residual(held) <= TOLERANCE:
            found, converged = held, True
        elif κ <= HARDEST or problem.residual(held) < NEAR:
            found, converged = problem.newton(held, 0.0, held)
    return found if converged else None, problem.iterations


class _Problem:
    """w = b + M f under a law; all forces (m, d)."""

    def __init__(self, S, δ, at, law):
        m, d = δ.shape
        self.law, self.m, self.d, self.iterations = law, m, d, []
        self.own, self.S, self.at = 1 / law._ε, S, at
        self.read = law.displacement(δ) - self.own * law._held
        k = np.arange(m)
        block = S.reshape(m, d, m, d)[k, :, k, :] + self.own[:, :, None] * np.eye(d)
        compliance = np.empty((m, d))
        compliance[:, 0] = block[:, 0, 0]
        compliance[:, 1:] = np.linalg.norm(block[:, 1:, 1:], axis=(1, 2))[:, None]
        least = 1e-12 * compliance.max(initial=0.0)
        self.ρ = 1 / np.maximum(compliance, least if least > 0 else 1.0)

    def _trial(self, f, w):
        y = f - self.ρ * w
        g, slope = self.law.friction.bound(np.maximum(y[:, 0], 0))
        return y, g, slope, np.linalg.norm(y[:, 1:], axis=1)

    def _state(self, f, w):
        y, g, _, size = self._trial(f, w)
        return np.where(y[:, 0] > 0, np.where((size <= g) & (g > 0), STICK, SLIP), OPEN)

    def _off(self, f, κ, held):
        """f less its projection, in energies' roots."""
        w = self._w(f, κ, held)
        y, g, _, size = self._trial(f, w)
        projected = y.copy()
        projected[:, 0] = np.maximum(y[:, 0], 0)
        projected[:, 1:] *= np.where(size > g, g / np.where(size > 0, size, 1), 1)[:, None]
        return (f - projected) / np.sqrt(self.ρ), w

    def _w(self, f, κ, held):
        moved = (self.S @ (f - self.at).ravel()).reshape(f.shape)
        return self.read + moved + self.own * f + κ / self.ρ * (f - held)

    def residual(self, f) -> float:
        """Of the law, over the forces or, where there are none, what closes."""
        off, _ = self._off(f, 0.0, f)
        return float(np.linalg.norm(off) / self._size(f))

    def _size(self, f):
        closes = np.minimum(self.read[:, 0], 0) * np.sqrt(self.ρ[:, 0])
        return max(np.linalg.norm(f / np.sqrt(self.ρ)), np.linalg.norm(closes), np.finfo(float).tiny)

    def newton(self, f, κ, held) -> tuple[np.ndarray, bool]:
        """The best forces found, with the proximal term κ about `held`, and whether they solve the problem."""
        off, w = self._off(f, κ, held)
        size = np.linalg.norm(off)
        sizes, state = [size], self._state(f, w)
        tolerance = TOLERANCE if κ == 0 else 1e-8
        for iteration in range(ITERATIONS):
            if not np.isfinite(size):
                return f, False
            if iteration and size <= tolerance * self._size(f):
                return f, True
            try:
                step = self._step(f, w, κ, held)
            except np.linalg.LinAlgError:
                return f, False
            best, α = None, 1.0
            while α >= SHORTEST:
                trial = f + α * step
                off, w_new = self._off(trial, κ, held)
                new = np.linalg.norm(off)
                if best is None or new < best[0]:
                    best = new, trial, w_new
                if new <= (1 - 0.1 * α) * max(sizes[-MEMORY:]):
                    break
                α *= 0.5
            if best[0] >= size and size <= 1e-9 * self._size(f):  # rounding
                return f, True
            before, state = state, self._state(best[1], best[2])
            size, f, w = best
            sizes.append(size)
            self.iterations.append((size / self._size(f), α, state, int((state != before).sum())))
        return f, False

    def _step(self, f, w, κ, held):
        m, d, ρ = self.m, self.d, self.ρ
        y, g, slope, length = self._trial(f, w)
        closed = y[:, 0] > 0
        rough = closed & (g > 0)
        free = np.zeros((m, d), dtype=bool)
        free[closed, 0] = True
        free[rough, 1:] = True
        gone = np.where(free, f, 0.0)
        before, w = w, self._w(gone, κ, held)
        index = np.flatnonzero(free.ravel())
        place = np.full(m * d, -1)
        place[index] = np.arange(len(index))
        M = self.S[np.ix_(index, index)]
        M[np.diag_indices(len(index))] += (self.own + κ / ρ).ravel()[index]
        J = ρ.ravel()[index, None] * M
        right = (-ρ * w).ravel()[index]
        k = np.flatnonzero(rough & (length > g))  # the others of these stick
        if len(k):
            τ, f_t, e = y[k, 1:] / length[k, None], gone[k, 1:], g[k] / length[k]
            F = f_t[:, :, None] * τ[:, None, :] / np.maximum(g[k], np.linalg.norm(f_t, axis=1))[:, None, None]
            e = e / (1 + np.maximum(-np.einsum("kii->k", F), 0))  # 1 − A stays positive
            A = e[:, None, None] * (np.eye(d - 1) - F)
            # f_t + df_t − (g + g' dy_n) τ − A (df_t − ρ dw_t) = 0, where dy_n = f_n + df_n − y_n
            normal, tangential = place.reshape(m, d)[k, 0], place.reshape(m, d)[k, 1:]
            lines = A @ J[tangential]
            one, i, j = np.ix_(np.arange(len(k)), np.arange(d - 1), np.arange(d - 1))
            lines[one, i, tangential[:, None, :]] += np.eye(d - 1) - A
            lines[one[:, :, 0], i[:, :, 0], normal[:, None]] -= slope[k, None] * τ
            J[tangential] = lines
            pressed = g[k] + slope[k] * (gone[k, 0] - y[k, 0])
            moved = np.einsum("kij,kj->ki", A, (ρ * (w - before))[k, 1:])
            right[tangential] = pressed[:, None] * τ - f_t - moved
        found = np.zeros(m * d)
        found[index] = np.linalg.solve(J, right)
        return gone + found.reshape(m, d) - f
