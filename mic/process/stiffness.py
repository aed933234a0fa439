"""The stiffness of the mean shape, in place of that of the nominal one.

Parts stand on meshes that carry the shape m which the means of the deviations give them; normals, frames and gaps of
contacts and welds go with them:

    H = L(m) K(m)⁻¹ L(m)ᵀ,      g = g⁰ + (g(m) − g⁰ − N y⁰(m)),

for all samples alike. What the deviations themselves read, y⁰ = Σ a_i y⁰_i, is counted from nominal as before: the
bracket is what that leaves out of the gaps of the mesh at m. What the fixture prescribes, and what is measured, keeps
its direction in space.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path
from typing import Any, TypeVar

import numpy as np

from mic.compliance import provider
from mic.compliance.blocks import Blocks
from mic.compliance.cache import influence_coefficients
from mic.compliance.coefficients import InfluenceCoefficients
from mic.model.assembly import Assembly
from mic.model.deviated import deviated_parts, opening
from mic.model.reduction import Reduction
from mic.model.shape import dilation
from mic.model.sources import sources
from mic.process.actions import Joints

__all__ = ["carrying", "coefficients", "shape_fields"]

Model = TypeVar("Model", bound=Reduction)


def coefficients(
    assembly: Assembly, cache: Path, progress=None, comm: Any = None
) -> tuple[dict[str, InfluenceCoefficients], dict[str, bool]]:
    """Influence coefficients of all parts as the scene's ``stiffness`` asks for them, from the cache where they fit.

    Arguments, results and errors are those of :func:`mic.compliance.cache.influence_coefficients`. Where the stiffness
    of the mean shape is asked for, each has that besides (:attr:`InfluenceCoefficients.deviated`).
    """
    found, cached = influence_coefficients(assembly, cache, progress, comm)
    if assembly.scene.stiffness == "nominal":
        return found, cached
    first = comm is None or comm.rank == 0
    fields: dict[str, np.ndarray] = {}
    if first:
        mean = np.array([deviation.mean for deviation in assembly.scene.deviations])
        fields = shape_fields(assembly, Reduction.build(assembly, found), mean)
    fields = fields if comm is None else comm.bcast(fields)
    parts = deviated_parts(assembly, fields)
    own, known = influence_coefficients(replace(assembly, parts=tuple(parts)), cache, progress, comm)
    both = {name: replace(one, deviated=(fields[name], own[name])) for name, one in found.items() if name in own}
    return both, {name: cached[name] and known[name] for name in cached}


def shape_fields(assembly: Assembly, model: Reduction, deviations: np.ndarray) -> dict[str, np.ndarray]:
    """Displacements and rotations (v, 6) that deviations (p,) of shape give the vertices of each part, mm and rad.

    Parameters
    ----------
    assembly : Assembly
    model : Reduction
        Of its nominal meshes.
    deviations : (p,) array
    """
    forces, read, found = model.shape_forces @ deviations, model.shape @ deviations, {}
    for p, part in enumerate(assembly.parts):
        own, surface = model.compliance.functionals[p], part.surface
        H, G = model.compliance.H[p], model.compliance.G[p]
        strain = sum(
            a * source.expansion().get(part.name, 0.0) for a, source in zip(deviations, sources(assembly.scene))
        )
        f, y = forces[own], read[own]
        if not y.any():
            found[part.name] = np.zeros((len(surface.points), 6))
            continue
        solved, rigid = provider.find(part).field(part, f[:, None])
        motion = np.linalg.lstsq(G, y - H @ f - strain * dilation(part), rcond=None)[0]
        field = solved[:, :, 0] + rigid @ motion
        field[:, :3] += strain * surface.points
        found[part.name] = field
    return found


def carrying(
    model: Model,
    assembly: Assembly,
    fields: Mapping[str, np.ndarray],
    own: Mapping[str, InfluenceCoefficients],
    deviations: np.ndarray,
) -> Model:
    """The model with the stiffness and the gaps of parts that carry a shape.

    Parameters
    ----------
    model : Reduction
        Of the nominal meshes, or with the stiffness of another shape.
    assembly : Assembly
        With nominal gaps.
    fields : mapping of str to (v, 6) array
        The shape at the vertices of each part, mm and rad.
    own : mapping of str to InfluenceCoefficients
        Of the parts that :func:`mic.model.deviated.deviated_parts` makes of it.
    deviations : (p,) array
        Those that give the shape.
    """
    parts = deviated_parts(assembly, fields)
    gap, weld_gap = (
        opening(assembly, kind, parts, read) - read
        for kind in ("contact", "weld")
        for read in [model.rows[kind] @ (model.shape @ deviations)]
    )
    contacts, normal = assembly.contacts, Joints(tuple(model.weld_size)).normals
    weld_gap[np.setdiff1d(np.arange(len(weld_gap)), normal)] = 0.0
    found = [own[part.name] for part in parts]
    return replace(
        model,
        compliance=Blocks(tuple(one.H for one in found), tuple(one.G for one in found)),
        contacts=replace(model.contacts, gap=contacts.gap + gap[:: contacts.dimension]),
        weld_gap=assembly.weld_gap + weld_gap,
    )
