"""A reduced model with the stiffness of a deviated shape, in place of that of the nominal one.

Its parts stand on meshes that carry the shape; normals, frames and gaps of contacts and welds go with them. What the
fixture prescribes, and what is measured, reads the shape as before.
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
        Of its nominal meshes.

    Raises
    ------
    SceneError
        Of an assembly with superelements, which have no shape that could deviate.
    """

    def __init__(self, assembly: Assembly, model: ReducedModel):
        own = [part.name for part in assembly.parts if part.superelement is not None]
        if own:
            raise SceneError(f"part {own[0]!r} is a superelement: its stiffness cannot follow a deviated shape")
        if model.thicknesses:
            raise SceneError(f"the thickness of part {next(iter(model.thicknesses))!r} varies: its stiffness does too")
        self._assembly, self._model = assembly, model
        self._full = FullModel(assembly, comm=MPI.COMM_SELF)

    def at(self, deviations: np.ndarray) -> ReducedModel:
        """The model for one sample, whose deviations (p,) are to be given to it."""
        assembly, model = self._assembly, self._model
        fields = self._full.shape_fields(deviations)
        parts = deviated_parts(assembly, fields)
        found = {part.name: provider.find(part).coefficients([part])[part.name] for part in parts}
        return with_shape(model, assembly, fields, found, deviations)

    def shaping(self) -> np.ndarray:
        """(p,) bool: the deviations that give a part another shape."""
        return self._full.unit_shapes.any(axis=0)

    def largest(self, deviations: np.ndarray) -> float:
        """Largest displacement from nominal that deviations (p,) give any vertex, mm."""
        fields = self._full.shape_fields(deviations)
        return max(float(np.linalg.norm(field[:, :3], axis=1).max()) for field in fields.values())
