"""What one standard deviation of each source does to its part: the shape, and how far it is off at most.

The shape is that of :mod:`mic.model.shape`: the part stands on its datum rows D, at which nothing moves. With the
field ``Φ f⁰`` of the forces that make it, or ``ε x`` of a part that grows, and the rigid modes R,

    u(x) = Φ(x) f⁰ + R(x) q,        D G q = −D H f⁰.

Of a sheet that is thicker it is how far the face goes that moves, or one of both, along the normals.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from mic.compliance import provider
from mic.model.assembly import Assembly
from mic.model.reduction import Reduction
from mic.model.shape import datum_rows, dilation
from mic.model.sources import sources

__all__ = ["Shape", "one_sigma"]


@dataclass(frozen=True)
class Shape:
    """One standard deviation of a source.

    Attributes
    ----------
    name : str
        Of the deviation.
    fields : dict of str to (v, 3) array
        How far the vertices of the parts that it shapes are off, mm.
    face : bool
        Whether it is a face that is off, and not the middle of the sheet.
    """

    name: str
    fields: Mapping[str, np.ndarray]
    face: bool = False

    @property
    def largest(self) -> tuple[str, int, float]:
        """Part, vertex and length of the largest displacement, mm."""
        found = {name: np.linalg.norm(field, axis=1) for name, field in self.fields.items()}
        part = max(found, key=lambda name: found[name].max())
        return part, int(found[part].argmax()), float(found[part].max())


def one_sigma(assembly: Assembly, model: Reduction) -> list[Shape]:
    """The shapes of all sources that give any, in the scene's order; of one without spread, its mean.

    Raises
    ------
    MissingProvider
        If nothing that solves for fields is installed.
    """
    items = model.scene.deviations
    amplitude = np.array([item.sigma or item.mean for item in items])
    grows = [source.expansion() for source in sources(model.scene)]
    fields: list[dict[str, np.ndarray]] = [{} for _ in items]
    bodies = {part.name: part.surface for part in assembly.parts}
    for source, by, own_fields in zip(sources(model.scene), amplitude, fields):
        for name, skin in source.thickening().items():
            own_fields[name] = by * (-skin if skin else 0.5) * bodies[name].vertex_normals
    for p, part in enumerate(assembly.parts):
        own, G = model.compliance.functionals[p], model.compliance.G[p]
        force = model.shape_forces[own] * amplitude
        strain = np.array([growth.get(part.name, 0.0) for growth in grows]) * amplitude
        chosen = np.flatnonzero(force.any(axis=0) | (strain != 0.0))
        if not len(chosen):
            continue
        datum = datum_rows(assembly, p, G)
        solved, rigid = provider.find(part).field(part, force[:, chosen])
        read = model.compliance.H[p] @ force[:, chosen] + np.outer(dilation(part), strain[chosen])
        q = -np.linalg.solve(datum @ G, datum @ read)
        grown = part.surface.points[:, :, None] * strain[chosen]
        moved = solved[:, :3] + grown + np.einsum("vim,mk->vik", rigid[:, :3], q)
        for k, j in enumerate(chosen):
            fields[j][part.name] = moved[:, :, k]
    return [Shape(item.name, found, item.kind == "thickness") for item, found in zip(items, fields) if found]
