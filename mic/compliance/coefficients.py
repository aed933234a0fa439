"""Influence coefficients of a part, the only result that production needs from the finite elements."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field

import numpy as np

from mic.compliance.thickness import Thicknesses

__all__ = ["InfluenceCoefficients", "InfluenceDerivative", "solver_versions"]


@dataclass(frozen=True)
class InfluenceDerivative:
    """Derivative of a part's coefficients with respect to one of the scene's deviations.

    Attributes
    ----------
    step : float
        Step of the deviation to either side in the finite difference.
    field : (v, 6) array
        Change of shape at the part's vertices for one step, displacements and rotations, mm and rad.
    H : (n, n) array
        Derivative of the compliance per unit of the deviation.
    G : (n, 6) array
        Derivative of the rigid-body readings.
    """

    step: float
    field: np.ndarray
    H: np.ndarray
    G: np.ndarray


@dataclass(frozen=True)
class InfluenceCoefficients:
    """Compliance of one free part at its retained functionals.

    The readings of the functionals under forces ``f`` on them are ``y = H f + G q`` with ``Gᵀ f = 0``: `H` was
    computed on some statically determinate support, whose reactions vanish because the forces, fixture reactions
    included, balance; ``q`` is the rigid-body motion. ``H = L K⁻¹ Lᵀ`` is equation (2) of the paper.

    Attributes
    ----------
    part : str
    H : (n, n) array
        Symmetric; mm/N for displacement rows under forces, rad/N, rad/(N mm) for rotations.
    G : (n, 6) array
        Readings of the six rigid-body modes (translations along x, y, z, rotations about x, y, z through the
        centroid).
    provenance : dict
        Element, mesh sizes, and `versions` of the finite-element program and its solver by name, for the record.
    thicknesses : Thicknesses, optional
        Coefficients at other thicknesses, for a part whose thickness varies.
    deviated : ((v, 6) array, InfluenceCoefficients), optional
        A shape at the part's vertices, displacements and rotations, mm and rad, and the coefficients of the part with
        this shape.
    slopes : mapping of str to InfluenceDerivative, optional
        Derivatives about that shape, by name of the deviations that change the part's coefficients.

    Raises
    ------
    ValueError
        If the arrays do not fit together or hold values that are not finite.
    """

    part: str
    H: np.ndarray
    G: np.ndarray
    provenance: dict = field(default_factory=dict)
    thicknesses: Thicknesses | None = None
    deviated: tuple[np.ndarray, InfluenceCoefficients] | None = None
    slopes: Mapping[str, InfluenceDerivative] | None = None

    def __post_init__(self):
        n = len(self.H)
        if self.H.shape != (n, n) or self.G.shape != (n, 6):
            raise ValueError(f"part {self.part!r}: H {self.H.shape} and G {self.G.shape} do not fit together")
        if not (np.isfinite(self.H).all() and np.isfinite(self.G).all()):
            raise ValueError(f"part {self.part!r}: the influence coefficients hold values that are not finite")


def solver_versions(coefficients: Iterable[InfluenceCoefficients]) -> dict[str, str]:
    """Versions of the programs that computed coefficients, by name; several of one program as a list in text."""
    found: dict[str, set[str]] = {}
    for one in coefficients:
        for name, text in one.provenance.get("versions", {}).items():
            found.setdefault(name, set()).add(text)
    return {name: " and ".join(sorted(texts)) for name, texts in found.items()}
