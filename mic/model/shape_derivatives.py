"""First derivatives of compliance and gaps along the sources that change the parts' shapes.

With the values a of these sources, and m those of the undeviated model,

    H(a) = H(m) + Σ_i (a_i − m_i) ∂_i H,        ∂_i H = (H(m + s_i e_i) − H(m − s_i e_i)) / 2 s_i,        (1)

and likewise G and the gaps of contacts and welds; s_i is one standard deviation.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from mic.compliance.blocks import Blocks
from mic.errors import ImpossibleSample

__all__ = ["ShapeDerivatives"]


@dataclass(frozen=True)
class ShapeDerivatives:
    """Derivatives with respect to q of a scene's deviations, per unit amplitude.

    Attributes
    ----------
    source : (q,) int array
        Numbers of these deviations in the scene.
    about : (q,) array
        m: the values for which the model holds without change.
    low, high : (q,) array
        Smallest and largest values a for which the derivatives are valid.
    changing : tuple of (k_p,) int array
        For each of the P parts, which of the q deviations change its compliance.
    H : tuple of (k_p, F_p, F_p) array
    G : tuple of (k_p, F_p, 6) array
    gap : (q, m) array
        Of the contacts.
    weld_gap : (q, r) array
        Of the weld rows.
    """

    source: np.ndarray
    about: np.ndarray
    low: np.ndarray
    high: np.ndarray
    changing: tuple[np.ndarray, ...]
    H: tuple[np.ndarray, ...]
    G: tuple[np.ndarray, ...]
    gap: np.ndarray
    weld_gap: np.ndarray

    def values(self, deviations: np.ndarray, names: Sequence[str]) -> np.ndarray:
        """a (q,) of a sample's deviations (p,), whose names are for messages.

        Raises
        ------
        ImpossibleSample
            If a value lies outside the range for which the derivatives are valid.
        """
        value = deviations[self.source]
        outside = np.flatnonzero((value < self.low) | (value > self.high))
        if outside.size and (value != self.about).any():
            i = int(outside[0])
            raise ImpossibleSample(
                f"{names[self.source[i]]} is {value[i]:.6g}, outside the range {self.low[i]:.6g} to "
                f"{self.high[i]:.6g} in which its shape changes the stiffness to first order; give it a larger sigma, "
                'or stiffness = "mean"'
            )
        return value

    def compliance(self, blocks: Blocks, change: np.ndarray) -> Blocks:
        """H and G at values that differ from m by a change (q,), equation (1)."""
        pairs = [
            (H + np.tensordot(change[own], dH, 1), G + np.tensordot(change[own], dG, 1)) if own.size else (H, G)
            for H, G, own, dH, dG in zip(blocks.H, blocks.G, self.changing, self.H, self.G)
        ]
        return Blocks(tuple(H for H, _ in pairs), tuple(G for _, G in pairs))
