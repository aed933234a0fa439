"""Reduced models with the stiffness of a deviated shape instead of the nominal one.

Meshes, normals, frames and gaps of contacts and welds follow the deviated shape. Prescribed values and measurements
read the shape as in the nominal model.
"""

from __future__ import annotations

import numpy as np
from mpi4py import MPI

from fem_reference.full.model import FullModel
from mic.compliance import provider
from mic.errors import SceneError
from mic.model.assembly import Assembly
from mic.model.deviated_geometry import deviated_parts
from mic.process.model import ReducedModel
from mic.process.stiffness import with_shape

__all__ = ["DeviatedStiffness"]


class DeviatedStiffness:
    """Reduced models with the stiffness of each sample's own shape.

    Parameters
    ----------
    assembly : Assembly
    model : ReducedModel
        Model with the nominal meshes.

    Raises
    ------
    SceneError
        If the assembly has a superelement or a part of varying thickness.
    """

    def __init__(self, assembly: Assembly, model: ReducedModel):
        superelements = [part.name for part in assembly.parts if part.superelement is not None]
        if superelements:
            raise SceneError(
                f"part {superelements[0]!r} is a superelement: its stiffness cannot follow a deviated shape"
            )
        if model.thicknesses:
            raise SceneError(
                f"the thickness of part {next(iter(model.thicknesses))!r} varies: no deviated stiffness is available"
            )
        self._assembly, self._model = assembly, model
        self._full = FullModel(assembly, comm=MPI.COMM_SELF)

    def at(self, deviations: np.ndarray) -> ReducedModel:
        """Model with the stiffness of the shape under deviations (p,), to be evaluated for the same deviations."""
        assembly, model = self._assembly, self._model
        fields = self._full.shape_fields(deviations)
        parts = deviated_parts(assembly, fields)
        influence = {part.name: provider.find(part).coefficients([part])[part.name] for part in parts}
        return with_shape(model, assembly, fields, influence, deviations)

    def shaping(self) -> np.ndarray:
        """(p,) bool: whether each deviation changes the shape of a part."""
        return self._full.unit_shapes.any(axis=0)

    def largest(self, deviations: np.ndarray) -> float:
        """Largest displacement of a vertex from nominal under deviations (p,), mm."""
        fields = self._full.shape_fields(deviations)
        return max(float(np.linalg.norm(field[:, :3], axis=1).max()) for field in fields.values())
