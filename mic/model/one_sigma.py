"""Displacement of parts by one standard deviation of each source, and its largest value.

The shape is that of :mod:`mic.model.shape`: zero at the part's datum rows D. With the field ``Φ f⁰`` of the forces that
cause it, or ``ε x`` for a part that expands, and the rigid modes R,

    u(x) = Φ(x) f⁰ + R(x) q,        D G q = −D H f⁰.

For a thicker sheet it is the motion of one face or both along the normals.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from mic.compliance import provider
from mic.model.assembly_types import Assembly
from mic.model.reduction import Reduction
from mic.model.shape import datum_rows, dilation
from mic.model.sources import sources

__all__ = ["SourceShape", "one_sigma"]


@dataclass(frozen=True)
class SourceShape:
    """Displacement by one standard deviation of a source.

    Attributes
    ----------
    name : str
        Of the deviation.
    fields : dict of str to (v, 3) array
        Displacement of the vertices of each part that it shapes, mm.
    face : bool
        Whether a face of the sheet is displaced, not the mid-surface.
    """

    name: str
    fields: Mapping[str, np.ndarray]
    face: bool = False

    @property
    def largest(self) -> tuple[str, int, float]:
        """Part, vertex and length of the largest displacement, mm."""
        lengths = {name: np.linalg.norm(field, axis=1) for name, field in self.fields.items()}
        part = max(lengths, key=lambda name: lengths[name].max())
        return part, int(lengths[part].argmax()), float(lengths[part].max())


def one_sigma(assembly: Assembly, model: Reduction) -> list[SourceShape]:
    """The shapes of all sources that change shapes, in the scene's order; for a source without spread, its mean.

    Raises
    ------
    MissingProvider
        If no provider of displacement fields is installed.
    """
    items, of_scene = model.scene.deviations, sources(model.scene)
    amplitude = np.array([item.sigma or item.mean for item in items])
    expansion = [source.expansion() for source in of_scene]
    fields: list[dict[str, np.ndarray]] = [{} for _ in items]
    bodies = {part.name: part.surface for part in assembly.parts}
    for source, factor, own_fields in zip(of_scene, amplitude, fields):
        for name, skin in source.thickening().items():
            own_fields[name] = factor * (-skin if skin else 0.5) * bodies[name].vertex_normals
    for p, part in enumerate(assembly.parts):
        functionals, G = model.compliance.functionals[p], model.compliance.G[p]
        force = model.shape_forces[functionals] * amplitude
        strain = np.array([strains.get(part.name, 0.0) for strains in expansion]) * amplitude
        chosen = np.flatnonzero(force.any(axis=0) | (strain != 0.0))
        if not len(chosen):
            continue
        datum = datum_rows(assembly, p, G)
        solved, rigid = provider.find(part).field(part, force[:, chosen])
        readings = model.compliance.H[p] @ force[:, chosen] + np.outer(dilation(part), strain[chosen])
        q = -np.linalg.solve(datum @ G, datum @ readings)
        expanded = part.surface.points[:, :, None] * strain[chosen]
        displacement = solved[:, :3] + expanded + np.einsum("vim,mk->vik", rigid[:, :3], q)
        for k, j in enumerate(chosen):
            fields[j][part.name] = displacement[:, :, k]
    return [SourceShape(item.name, shape, item.kind == "thickness") for item, shape in zip(items, fields) if shape]
