"""One sheet with its surface, thickness, material and retained functionals: the input of a provider."""

from __future__ import annotations

import hashlib
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING

import numpy as np

from mic.compliance.functional import Functionals
from mic.geometry.surface import Surface

if TYPE_CHECKING:
    from mic.compliance.superelement import Superelement

__all__ = ["GENERATION", "Part"]

#: Increased whenever the coefficients of the same part change, by another formulation of its element or another
#: meaning of a functional: cached coefficients then become invalid.
GENERATION = 9


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
        Name of the shell element, known to the part's provider (:mod:`mic.compliance.provider`).
    functionals : Functionals
    superelement : Superelement, optional
        The part as a matrix on nodes, if its finite-element model comes from another program.
    thickness_range : tuple of float, optional
        Smallest and largest thickness, mm, if the thickness varies.
    """

    name: str
    surface: Surface
    thickness: float
    young: float
    poisson: float
    element: str
    functionals: Functionals
    superelement: Superelement | None = None
    thickness_range: tuple[float, float] | None = None

    def at(self, thickness: float) -> Part:
        """The part at another thickness, mm: its mid-surface stays, readings of a face move with that face."""
        f, more = self.functionals, thickness - self.thickness
        off = np.abs(f.side)
        moved = np.sign(f.side) * (off * self.thickness + more) / thickness
        return replace(
            self,
            name=f"{self.name} at {thickness:.6g} mm",
            thickness=thickness,
            functionals=replace(f, side=np.where((off == 0.0) | (off == 1.0), f.side, moved)),
            thickness_range=None,
        )

    def fingerprint(self) -> str:
        """Hash of everything that the part's influence coefficients at its thickness depend on."""
        digest = hashlib.sha256()
        f = self.functionals
        digest.update(repr((GENERATION, self.element, self.thickness, self.young, self.poisson)).encode())
        arrays = [self.surface.points, self.surface.triangles, f.patch, f.direction, f.rotation, f.side]
        if self.surface.given_normals is not None:  # estimated normals follow from points and triangles
            arrays.append(self.surface.given_normals)
        arrays += [array for patch in f.patches for array in (patch.triangle, patch.barycentric, patch.weight)]
        if self.superelement is not None:
            body = self.superelement
            arrays += [body.points, body.freedom, body.of_vertex, np.array([body.stiffness])]
            arrays += [body.matrix.data, body.matrix.indices, body.matrix.indptr]
        for array in arrays:
            digest.update(repr((array.shape, array.dtype.str)).encode())
            digest.update(np.ascontiguousarray(array).tobytes())
        return digest.hexdigest()[:32]
