"""Coulomb's law of the full finite-element solve: return mapping, its linearisation, and the states it gives.

Equations (2) to (4) of :mod:`fem_reference.full.equilibrium`.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np

from fem_reference.full.friction import ContactFriction
from mic.contact.states import OPEN, SLIP, STICK

__all__ = ["ContactLaw"]


@dataclass(frozen=True)
class ContactLaw:
    """Law (2)–(3) of m contacts in one increment.

    Attributes
    ----------
    friction : ContactFriction
    gap : (m,) array
        g⁰ including the parts' deviations, mm.
    anchor : (m, d) array
        Position from which slip is measured (the slider's if a contact yields), mm; the normal column is not used.
    estimate : (m, d) array
        f̂, N; not used in rows that yield.
    penalty : (m,) array
        ε, N/mm; not used in rows that yield.
    stiffness : (m,) array
        k, N/mm.
    layer : (m,) array or 0
        c, mm/N.
    """

    friction: ContactFriction
    gap: np.ndarray
    anchor: np.ndarray
    estimate: np.ndarray
    penalty: np.ndarray
    stiffness: np.ndarray
    layer: np.ndarray | float = 0.0

    def displacement(self, δ: np.ndarray) -> np.ndarray:
        """(m, d) gap and slip from the relative displacements δ."""
        moved = δ - self.anchor
        moved[:, 0] = self.gap + δ[:, 0]
        return moved

    @cached_property
    def row_penalty(self) -> np.ndarray:
        """(m, d) ε of every row, N/mm."""
        ε = np.repeat(self.penalty[:, None], self.estimate.shape[1], axis=1)
        yields = self.friction.compliance > 0
        ε[yields, 1:] = 1 / self.friction.compliance[yields, None]
        layer = np.broadcast_to(self.layer, len(ε))
        ε[layer > 0, 0] = 1 / layer[layer > 0]
        return ε

    @cached_property
    def multiplier(self) -> np.ndarray:
        """(m, d) f̂ of every row, N: 0 where the row itself yields."""
        f = self.estimate.copy()
        f[self.friction.compliance > 0, 1:] = 0.0
        f[np.broadcast_to(self.layer, len(f)) > 0, 0] = 0.0
        return f

    def augmented(self, force: np.ndarray) -> ContactLaw:
        """f̂ ← f."""
        law = replace(self, estimate=force)
        return replace(law, estimate=law.multiplier)

    def _trial(self, δ):
        y = self.multiplier - self.row_penalty * self.displacement(δ)
        return y, np.linalg.norm(y[:, 1:], axis=1)

    def force(self, δ: np.ndarray) -> np.ndarray:
        """The return mapping (3)."""
        y, size = self._trial(δ)
        f = y.copy()
        f[:, 0] = np.maximum(0, y[:, 0])
        bound, _ = self.friction.bound(f[:, 0])
        f[:, 1:] *= np.where(size > bound, bound / np.where(size > 0, size, 1), 1)[:, None]
        return f

    def state(self, δ: np.ndarray) -> np.ndarray:
        """(m,) open, stick or slip; a closed contact without friction slips."""
        y, size = self._trial(δ)
        closed = y[:, 0] > 0
        bound, _ = self.friction.bound(np.maximum(y[:, 0], 0))
        stick = (size <= bound) & (bound > 0)
        return np.where(closed, np.where(stick, STICK, SLIP), OPEN)

    def reverses(self, δ: np.ndarray, new: np.ndarray) -> bool:
        """Whether a contact slips at δ and at `new` in directions more than 90° apart, a kink that Newton misses."""
        (y, _), (z, _) = self._trial(δ), self._trial(new)
        bound, _ = self.friction.bound(np.maximum(y[:, 0], 0))
        slips = (self.state(δ) == SLIP) & (self.state(new) == SLIP) & (bound > 0)
        return bool((slips & (np.einsum("kj,kj->k", y[:, 1:], z[:, 1:]) < 0)).any())

    def linearise(self, δ: np.ndarray, f: np.ndarray, state: np.ndarray):
        """Residual (m, d) of equations (4) and its derivatives with respect to δ and f, both (m, d, d)."""
        m, d = f.shape
        y, size = self._trial(δ)
        moved = self.displacement(δ)
        residual, by_δ, by_f = f.copy(), np.zeros((m, d, d)), np.tile(np.eye(d), (m, 1, 1))
        k, ε = self.stiffness, self.row_penalty
        g, slope = self.friction.bound(np.maximum(f[:, 0], 0))
        g = g + slope * np.minimum(f[:, 0], 0)  # iterates may have tensile normal forces
        trial, _ = self.friction.bound(np.maximum(y[:, 0], 0))
        closed, stick, slip = state != OPEN, state == STICK, (state == SLIP) & (size > 0) & (trial > 0)

        def elastic(which, component):
            soft = k / ε[:, component]
            residual[which, component] = (k * moved[:, component] + soft * (f - self.multiplier)[:, component])[which]
            by_δ[which, component, component] = k[which]
            by_f[which, component, component] = soft[which]

        elastic(closed, 0)
        for j in range(1, d):
            elastic(stick, j)
        τ = y[slip, 1:] / size[slip, None]
        residual[slip, 1:] = f[slip, 1:] - g[slip, None] * τ
        by_f[slip, 1:, 0] = -slope[slip, None] * τ
        turning = trial[slip] * ε[slip, -1] / size[slip]
        by_δ[slip, 1:, 1:] = turning[:, None, None] * (np.eye(d - 1) - τ[:, :, None] * τ[:, None, :])
        return residual, by_δ, by_f
