"""One sheet as the finite elements see it: surface, thickness, material and the functionals retained of it."""

from __future__ import annotations

import hashlib
from dataclasses import dataclass

import numpy as np

from mic.compliance.functional import Functionals
from mic.geometry.surface import Surface

__all__ = ["GENERATION", "Part"]

#: Raised whenever the coefficients of the same part come out otherwise than before, by another formulation of its
#: element or another meaning of a functional: caches then hold none of them.
GENERATION = 5


@dataclass(frozen=True)
class Part:
    """One sheet with its retained functionals.

    Attributes
    ----------
    name : str
    surface : Surface
    thickness : float
        mm.
    young : float
        MPa.
    poisson : float
    element : str
        Shell element, a name that the part's provider knows (:mod:`mic.compliance.provider`).
    functionals : Functionals
    """

    name: str
    surface: Surface
    thickness: float
    young: float
    poisson: float
    element: str
    functionals: Functionals

    def fingerprint(self) -> str:
        """Hash of everything that the part's influence coefficients depend on."""
        digest = hashlib.sha256()
        f = self.functionals
        digest.update(repr((GENERATION, self.element, self.thickness, self.young, self.poisson)).encode())
        arrays = [self.surface.points, self.surface.triangles, f.patch, f.direction, f.rotation, f.side]
        if self.surface.given_normals is not None:  # estimated ones follow from points and triangles
            arrays.append(self.surface.given_normals)
        arrays += [array for patch in f.patches for array in (patch.triangle, patch.barycentric, patch.weight)]
        for array in arrays:
            digest.update(repr((array.shape, array.dtype.str)).encode())
            digest.update(np.ascontiguousarray(array).tobytes())
        return digest.hexdigest()[:32]
