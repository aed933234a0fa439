"""Retained functionals: the displacements and rotations of a part that the stages use.

A functional is a row ``ℓ`` with ``ℓ·u`` = the average over a patch of a displacement or rotation component. The same
weights distribute a unit load, so a part's influence coefficients ``H = L K⁻¹ Lᵀ`` are symmetric.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike

from mic.geometry.surface import Patch

__all__ = ["Functionals"]


@dataclass(frozen=True)
class Functionals:
    """The retained functionals of one part.

    Row i reads, averaged over ``patches[patch[i]]``,

    - ``d · (u + θ × (s t/2) n)`` if ``rotation[i]`` is false (mm): the motion of a point off the mid-surface by ``s``
      half-thicknesses,
    - ``d · θ`` if it is true (rad),

    with ``d = direction[i]``, ``s = side[i]``, ``t`` the part's thickness and ``n`` the unit normal of the triangle
    that holds the quadrature point. A load of one N (or N mm) on the row is the transpose of the reading.

    Attributes
    ----------
    patches : tuple of Patch
        Several rows may share one.
    patch : (n,) int array
        Patch of each row.
    direction : (n, 3) array
        Unit directions.
    rotation : (n,) bool array
    side : (n,) array
        Distance of the reading from the mid-surface, in half-thicknesses along the triangle normals: -1 and +1 are
        the sheet's two surfaces, larger values lie off the sheet (the middle of a nominal gap).
    label : tuple of str
        One name per row, such as ``"weld W1 x"``.
    """

    patches: tuple[Patch, ...]
    patch: np.ndarray
    direction: np.ndarray
    rotation: np.ndarray
    side: np.ndarray
    label: tuple[str, ...]

    @classmethod
    def displacements(cls, patches: tuple[Patch, ...], directions: ArrayLike) -> Functionals:
        """Mean displacement of the mid-surface over each patch along a unit direction of its own."""
        n = len(patches)
        return cls(patches, np.arange(n), np.asarray(directions), np.zeros(n, bool), np.zeros(n), ("",) * n)

    def __len__(self):
        return len(self.patch)
