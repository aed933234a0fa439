"""Contact forces of a condensed equilibrium: Alart and Curnier's Newton method with a proximal-point fallback.

With the gaps and slips w = b + M f of all contacts, M = S + c, and c the compliance of a contact itself (1/ε in the
penalty method), Coulomb's law is a fixed point of a projection for any ρ > 0:

    y = f − ρ w,      f_n = max(0, y_n),      f_t = y_t, shortened to g(f_n) if longer.                     (1)

y and f are of the same size if 1/ρ is the contact's compliance M_kk. A penalty stiffness ρ = ε makes y much larger than
f, and Newton's method then oscillates across the friction disc when slip reverses. The tangent of slipping contacts is
made positive as by Hüeber, Stadler and Wohlmuth; a non-monotone line search acts on the natural residual of (1).

If Newton's method does not converge, M + κ/ρ and b − κ f̂/ρ replace M and b, which reduces the coupling of the contacts
as κ grows. After each solution f̂ ← f and κ is divided by ten; after a failure it is multiplied by ten. The limit of
these problems is the law itself (proximal-point method, Rockafellar 1976).

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
TOLERANCE = 1e-13  # natural residual relative to the largest force
MEMORY = 5  # number of previous residuals that the line search compares with
SHORTEST = 1 / 64  # shortest step of the line search
SOFTEST, FIRST, HARDER, SOFTER = 1e3, 1.0, 0.1, 10.0  # κ: largest, initial; factors after success and failure
HARDEST = 1e-6  # at this κ the law itself (κ = 0) is tried again
NEAR = 1e-3  # below this residual it is tried as well
PROXIMAL = 60  # largest number of proximal problems


def contact_forces(S: np.ndarray, δ: np.ndarray, at: np.ndarray, law, start: np.ndarray):
    """Forces f that satisfy a law with relative displacements δ + S (f − at).

    Parameters
    ----------
    S : (m d, m d) array
        mm/N.
    δ : (m, d) array
        mm.
    at : (m, d) array
        Reference forces, N; rounding is smaller the nearer they are to f.
    law : fem_reference.full.contact_law.ContactLaw
        An infinite penalty enforces the law exactly.
    start : (m, d) array
        Initial forces, N.

    Returns
    -------
    force : (m, d) array or None
        None if the method does not converge.
    iterations : list of (float, float, (m,) array, int)
        For each Newton iteration: relative natural residual, step length, contact states, number of changed states.
    """
    problem = _Problem(S, δ, at, law)
    force, converged = problem.newton(start, 0.0, start)
    centre, κ = start if np.isfinite(start).all() else np.zeros_like(start), FIRST
    for _ in range(PROXIMAL):
        if converged:
            break
        proximal, solved = problem.newton(centre, κ, centre)
        if not solved:
            κ *= SOFTER
            if κ > SOFTEST:
                break
            continue
        centre, κ = proximal, max(κ * HARDER, HARDEST)
        if problem.residual(centre) <= TOLERANCE:
            force, converged = centre, True
        elif κ <= HARDEST or problem.residual(centre) < NEAR:
            force, converged = problem.newton(centre, 0.0, centre)
    return force if converged else None, problem.iterations


class _Problem:
    """Contact law with w = b + M f; all forces are (m, d)."""

    def __init__(self, S, δ, at, law):
        m, d = δ.shape
        self.law, self.m, self.d, self.iterations = law, m, d, []
        self.compliance, self.S, self.at = 1 / law.row_penalty, S, at
        self.read = law.displacement(δ) - self.compliance * law.multiplier
        k = np.arange(m)
        block = S.reshape(m, d, m, d)[k, :, k, :] + self.compliance[:, :, None] * np.eye(d)
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

    def _natural_residual(self, f, κ, centre):
        """f minus its projection, scaled to square roots of energies; and w."""
        w = self._w(f, κ, centre)
        y, g, _, size = self._trial(f, w)
        projected = y.copy()
        projected[:, 0] = np.maximum(y[:, 0], 0)
        projected[:, 1:] *= np.where(size > g, g / np.where(size > 0, size, 1), 1)[:, None]
        return (f - projected) / np.sqrt(self.ρ), w

    def _w(self, f, κ, centre):
        moved = (self.S @ (f - self.at).ravel()).reshape(f.shape)
        return self.read + moved + self.compliance * f + κ / self.ρ * (f - centre)

    def residual(self, f) -> float:
        """Residual of the law relative to the forces, or to the overlap if there are no forces."""
        residual, _ = self._natural_residual(f, 0.0, f)
        return float(np.linalg.norm(residual) / self._size(f))

    def _size(self, f):
        closes = np.minimum(self.read[:, 0], 0) * np.sqrt(self.ρ[:, 0])
        return max(np.linalg.norm(f / np.sqrt(self.ρ)), np.linalg.norm(closes), np.finfo(float).tiny)

    def newton(self, f, κ, centre) -> tuple[np.ndarray, bool]:
        """Best forces of Newton's method with the proximal term κ about `centre`, and whether it converged."""
        residual, w = self._natural_residual(f, κ, centre)
        size = np.linalg.norm(residual)
        sizes, state = [size], self._state(f, w)
        tolerance = TOLERANCE if κ == 0 else 1e-8
        for iteration in range(ITERATIONS):
            if not np.isfinite(size):
                return f, False
            if iteration and size <= tolerance * self._size(f):
                return f, True
            try:
                step = self._step(f, w, κ, centre)
            except np.linalg.LinAlgError:
                return f, False
            best, α = None, 1.0
            while α >= SHORTEST:
                trial = f + α * step
                residual, w_new = self._natural_residual(trial, κ, centre)
                new = np.linalg.norm(residual)
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

    def _step(self, f, w, κ, centre):
        m, d, ρ = self.m, self.d, self.ρ
        y, g, slope, length = self._trial(f, w)
        closed = y[:, 0] > 0
        rough = closed & (g > 0)
        free = np.zeros((m, d), dtype=bool)
        free[closed, 0] = True
        free[rough, 1:] = True
        active = np.where(free, f, 0.0)
        before, w = w, self._w(active, κ, centre)
        index = np.flatnonzero(free.ravel())
        place = np.full(m * d, -1)
        place[index] = np.arange(len(index))
        M = self.S[np.ix_(index, index)]
        M[np.diag_indices(len(index))] += (self.compliance + κ / ρ).ravel()[index]
        J = ρ.ravel()[index, None] * M
        right = (-ρ * w).ravel()[index]
        k = np.flatnonzero(rough & (length > g))  # the others of these stick
        if len(k):
            τ, f_t, e = y[k, 1:] / length[k, None], active[k, 1:], g[k] / length[k]
            F = f_t[:, :, None] * τ[:, None, :] / np.maximum(g[k], np.linalg.norm(f_t, axis=1))[:, None, None]
            e = e / (1 + np.maximum(-np.einsum("kii->k", F), 0))  # 1 − A stays positive
            A = e[:, None, None] * (np.eye(d - 1) - F)
            # f_t + df_t − (g + g' dy_n) τ − A (df_t − ρ dw_t) = 0, where dy_n = f_n + df_n − y_n
            normal, tangential = place.reshape(m, d)[k, 0], place.reshape(m, d)[k, 1:]
            lines = A @ J[tangential]
            contact, i, j = np.ix_(np.arange(len(k)), np.arange(d - 1), np.arange(d - 1))
            lines[contact, i, tangential[:, None, :]] += np.eye(d - 1) - A
            lines[contact[:, :, 0], i[:, :, 0], normal[:, None]] -= slope[k, None] * τ
            J[tangential] = lines
            pressed = g[k] + slope[k] * (active[k, 0] - y[k, 0])
            moved = np.einsum("kij,kj->ki", A, (ρ * (w - before))[k, 1:])
            right[tangential] = pressed[:, None] * τ - f_t - moved
        solution = np.zeros(m * d)
        solution[index] = np.linalg.solve(J, right)
        return active + solution.reshape(m, d) - f
