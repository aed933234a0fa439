"""A reduced model with the stiffness of a deviated shape, in place of that of the nominal one.

Its parts stand on meshes that carry the shape; normals, frames and gaps of contacts and welds go with them. What the
fixture prescribes, and what is measured, reads the shape as before.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from mpi4py import MPI

from fem_reference.full.deviated import deviated_parts, opening
from fem_reference.full.model import FullModel
from mic.compliance import provider
from mic.compliance.blocks import Blocks
from mic.errors import SceneError
from mic.model.assembly import Assembly
from mic.process.model import ReducedModel

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
        parts = deviated_parts(assembly, self._full.shape_fields(deviations))
        found = [provider.find(part).coefficients([part])[part.name] for part in parts]
        gap, weld_gap = (
            opening(assembly, kind, parts) - model.rows[kind] @ (model.shape @ deviations)
            for kind in ("contact", "weld")
        )
        contacts, joints = model.contacts, model.joints
        normal = [row for weld in range(len(joints.size)) for row in joints.normal(weld)]
        weld_gap[np.setdiff1d(np.arange(len(weld_gap)), normal)] = 0.0
        return replace(
            model,
            compliance=Blocks(tuple(one.H for one in found), tuple(one.G for one in found)),
            contacts=replace(contacts, gap=contacts.gap + gap[:: contacts.dimension]),
            weld_gap=model.weld_gap + weld_gap,
        )
