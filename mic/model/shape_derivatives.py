"""First derivatives of what a reduction has of the parts' shapes, along the sources that vary them.

With the values a of these sources, and those at which the reduction is as it stands, m,

    H(a) = H(m) + Σ_i (a_i − m_i) ∂_i H,        ∂_i H = (H(m + s_i e_i) − H(m − s_i e_i)) / 2 s_i,        (1)

and G and the gaps of contacts and welds alike; s is one standard deviation.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, Any, TypeVar

import numpy as np

from mic.compliance.blocks import Blocks
from mic.errors import ImpossibleSample

if TYPE_CHECKING:
    from mic.model.reduction import Reduction

__all__ = ["Slopes"]

Model = TypeVar("Model", bound="Reduction")

_WHOLE, _BY_PART = ("source", "about", "low", "high", "gap", "weld_gap"), ("changing", "H", "G")


@dataclass(frozen=True)
class Slopes:
    """Derivatives along q of a scene's deviations, per unit of them.

    Attributes
    ----------
    source : (q,) int array
        Their numbers among the scene's.
    about : (q,) array
        m: the values at which the reduction is as it stands.
    low, high : (q,) array
        Between which values a the derivatives are believed.
    changing : tuple of (k_p,) int array
        Which of the q change the compliance of each of the P parts.
    H : tuple of (k_p, F_p, F_p) array
    G : tuple of (k_p, F_p, 6) array
    gap : (q, m) array
        Of the contacts.
    weld_gap : (q, r) array
        Of the welds' rows.
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

    def followed(self, model: Model, deviations: np.ndarray) -> Model:
        """The reduction that these are of, at a sample's deviations (p,), equation (1); itself where none moved.

        Raises
        ------
        ImpossibleSample
            Beyond the values for which the derivatives are believed.
        """
        value = deviations[self.source]
        way = value - self.about
        if not way.any():
            return model
        beyond = np.flatnonzero((value < self.low) | (value > self.high))
        if beyond.size:
            i = int(beyond[0])
            raise ImpossibleSample(
                f"{model.scene.deviations[self.source[i]].name} is {value[i]:.6g}, beyond {self.low[i]:.6g} to "
                f"{self.high[i]:.6g}, between which its shape changes the stiffness to first order; give it a larger "
                'sigma, or stiffness = "mean"'
            )
        blocks = [
            (H + np.tensordot(way[own], dH, 1), G + np.tensordot(way[own], dG, 1)) if own.size else (H, G)
            for H, G, own, dH, dG in zip(model.compliance.H, model.compliance.G, self.changing, self.H, self.G)
        ]
        return replace(
            model,
            compliance=Blocks(tuple(H for H, _ in blocks), tuple(G for _, G in blocks)),
            contacts=replace(model.contacts, gap=model.contacts.gap + way @ self.gap),
            weld_gap=model.weld_gap + way @ self.weld_gap,
            slopes=replace(self, about=value),
        )

    def arrays(self) -> dict[str, np.ndarray]:
        """All of it by names that :meth:`of` knows."""
        found = {name: getattr(self, name) for name in _WHOLE}
        return found | {f"{name}_{p}": own for name in _BY_PART for p, own in enumerate(getattr(self, name))}

    @classmethod
    def of(cls, arrays: Mapping[str, np.ndarray], parts: int) -> Slopes:
        """What :meth:`arrays` gave, of so many parts."""
        own: dict[str, Any] = {name: arrays[name] for name in _WHOLE}
        own |= {name: tuple(arrays[f"{name}_{p}"] for p in range(parts)) for name in _BY_PART}
        return cls(**own)
