"""Displacement of parts by one standard deviation of each source, and its largest value.

The shape is that of :mod:`mic.model.shape`: zero at the part's datum rows D. With the field ``Φ f⁰`` of the forces that
cause it, or ``ε x`` for a part that expands, and the rigid modes R,

    u(x) = Φ(x) f⁰ + R(x) q,        D G q = −D H f⁰.

For a thicker sheet it is the motion of one face or both along the normals. A misplaced locator moves its part by
R(x) q with ``D G q`` the motion of the locators. Corrective forces, and shapes between the points at which they are
known, need the stiffness; without a model they are estimated by that of :mod:`mic.model.stiffness_estimate`.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import cache
from typing import Any

import numpy as np

from mic.compliance import provider
from mic.geometry.measured_points import sheet_normals
from mic.model.assembly_types import Assembly
from mic.model.reduction import Reduction
from mic.model.rigid_motion import amplification, rigid_readings
from mic.model.shape import controlling_forces, datum_rows, dilation
from mic.model.sources import KnownShape, sources
from mic.model.stiffness_estimate import HeldSheet
from mic.scene.deviation import targets
from mic.scene.stages import placing_stages

__all__ = ["Displacement", "SourceShape", "displacements", "known_shape_fields", "one_sigma"]

LARGEST = 20_000  # vertices of a sheet whose stiffness is estimated


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


@dataclass(frozen=True)
class Displacement:
    """The largest displacement of a free part by one standard deviation of a source.

    Attributes
    ----------
    name : str
        Of the deviation; of a random field or measured shapes, that of all modes together.
    items : tuple
        Its deviations: the modes.
    length : float
        mm; NaN if it needs the stiffness, or if the source moves no free part.
    part : str
        Where it is largest.
    point : (3,) array or None
        mm.
    rule : str
        ``exact``, ``estimate``, ``target`` (the item moves so much, and bends its part), ``stiffness`` (not known
        without it) or ``none``.
    """

    name: str
    items: tuple[Any, ...]
    length: float = np.nan
    part: str = ""
    point: np.ndarray | None = None
    rule: str = "stiffness"


def one_sigma(assembly: Assembly, model: Reduction | None = None) -> list[SourceShape]:
    """The shapes of all sources that change shapes, in the scene's order; for a source without spread, its mean.

    Without a model only those that need no stiffness: expansion and thickness.

    Raises
    ------
    MissingProvider
        If no provider of displacement fields is installed.
    """
    items, of_scene = assembly.scene.deviations, sources(assembly.scene)
    amplitude = np.array([item.sigma or item.mean for item in items])
    expansion = [source.expansion() for source in of_scene]
    fields: list[dict[str, np.ndarray]] = [{} for _ in items]
    bodies = {part.name: part.surface for part in assembly.parts}
    for source, factor, own_fields in zip(of_scene, amplitude, fields):
        for name, skin in source.thickening().items():
            own_fields[name] = factor * (-skin if skin else 0.5) * bodies[name].vertex_normals
    for p, part in enumerate(assembly.parts):
        strain = np.array([strains.get(part.name, 0.0) for strains in expansion]) * amplitude
        force = np.zeros((len(part.functionals), len(items)))
        if model is not None:
            force = model.shape_forces[model.compliance.functionals[p]] * amplitude
        chosen = np.flatnonzero(force.any(axis=0) | (strain != 0.0))
        if not len(chosen):
            continue
        readings = np.outer(dilation(part), strain[chosen])
        displacement = part.surface.points[:, :, None] * strain[chosen]
        if model is None:
            G, arms = rigid_readings(part), part.surface.points - part.surface.centroid
            rigid = np.concatenate([np.tile(np.eye(3), (len(arms), 1, 1)), _turned(arms)], axis=2)
        else:
            G = model.compliance.G[p]
            solved, rigid = provider.find(part).field(part, force[:, chosen])
            readings += model.compliance.H[p] @ force[:, chosen]
            displacement += solved[:, :3]
        datum = datum_rows(assembly, p, G)
        q = -np.linalg.solve(datum @ G, datum @ readings)
        displacement += np.einsum("vim,mk->vik", rigid[:, :3], q)
        for k, j in enumerate(chosen):
            fields[j][part.name] = displacement[:, :, k]
    return [SourceShape(item.name, shape, item.kind == "thickness") for item, shape in zip(items, fields) if shape]


def _turned(arms: np.ndarray) -> np.ndarray:
    """(v, 3, 3) displacement of points under unit rotations about x, y and z."""
    return np.cross(np.eye(3), arms[:, None]).transpose(0, 2, 1)


def displacements(assembly: Assembly, shapes: Sequence[SourceShape] = ()) -> list[Displacement]:
    """Displacement of the free parts by one standard deviation of each source, the largest first.

    Sources that need the stiffness follow, then those that move nothing. The modes of a random field or of measured
    shapes count as one source, by the root of the sum of their squares.

    Parameters
    ----------
    assembly : Assembly
    shapes : sequence of SourceShape
        The shapes that are known, of :func:`one_sigma`.
    """
    groups: dict[str, list[Any]] = {}
    for item in assembly.scene.deviations:
        batch = getattr(item, "batch", None) if item.sigma else None
        groups.setdefault(batch or item.name, []).append(item)
    known = {shape.name: shape for shape in shapes}
    by_locator = _locator_motions(assembly)
    sheets = cache(lambda name: _held_sheet(assembly, name, by_locator))
    found = [_displacement(assembly, name, items, known, by_locator, sheets) for name, items in groups.items()]
    order = {"stiffness": 1, "none": 2}
    return sorted(found, key=lambda one: (order.get(one.rule, 0), -np.nan_to_num(one.length)))


def _displacement(assembly, name, items, known, by_locator, sheets) -> Displacement:
    item, fields, rule = items[0], {}, "exact"
    if all(one.name in known for one in items):
        shapes = [known[one.name] for one in items]
        for part in dict.fromkeys(part for shape in shapes for part in shape.fields):
            fields[part] = [shape.fields[part] for shape in shapes if part in shape.fields]
    elif item.kind in ("shape", "force") and (held := sheets(item.part)) is not None:
        fields, rule = {item.part: _estimated(held, items)}, "estimate"
    elif item.kind == "locator":
        fields = _misplaced(assembly, item, by_locator)
    if fields:
        size = {part: np.sqrt(sum((field**2).sum(axis=1) for field in each)) for part, each in fields.items()}
        part = max(size, key=lambda part: size[part].max())
        vertex = int(np.argmax(size[part]))
        surface = next(own.surface for own in assembly.parts if own.name == part)
        return Displacement(name, tuple(items), float(size[part][vertex]), part, surface.points[vertex], rule)
    strokes = {clamp.name for clamp in assembly.scene.clamps if clamp.stroke is not None}
    if item.kind == "locator" or (item.kind == "clamp" and strokes & {*targets(item)}):
        return Displacement(name, tuple(items), float(item.sigma or abs(item.mean)), rule="target")
    return Displacement(name, tuple(items), rule="none" if item.kind == "friction" else "stiffness")


def _locator_motions(assembly) -> dict[str, dict[int, np.ndarray]]:
    """(v, 3) motion of each part's vertices per mm at each row of the locators that place it, by part and row.

    Parts that fewer than six of these hold are left out.
    """
    motions, scene = {}, assembly.scene
    stations = placing_stages(scene)
    for p, part in enumerate(assembly.parts):
        functionals = slice(assembly.offsets[p], assembly.offsets[p + 1])
        numbers = [
            i for i, one in enumerate(scene.locators) if (one.part, one.stage) == (part.name, stations[part.name])
        ]
        G = assembly.rows["locator"][numbers][:, functionals] @ rigid_readings(part)
        size = np.array([1.0] * 3 + [part.surface.diameter] * 3)
        if np.linalg.matrix_rank(G / size, 1e-9) == 6:
            moved = amplification(G, part.surface.points - part.surface.centroid)
            motions[part.name] = {number: moved[:, k] for k, number in enumerate(numbers)}
    return motions


def _misplaced(assembly, item, by_locator) -> dict[str, list[np.ndarray]]:
    """The displacement (v, 3) of each part that one standard deviation of a locator's position moves."""
    source = next(source for source in sources(assembly.scene) if source.deviation is item)
    shares = {number: share for (_, number), share in source.target(assembly.labels).items()}
    fields = {}
    for part, moved in by_locator.items():
        if own := [share * moved[number] for number, share in shares.items() if number in moved]:
            fields[part] = [(item.sigma or item.mean) * sum(own)]
    return fields


def _held_sheet(assembly, name: str, by_locator) -> HeldSheet | None:
    """The sheet of a part on its locators, with an estimated stiffness; None if that takes long."""
    part = next(part for part in assembly.parts if part.name == name)
    if name not in by_locator or len(part.surface.points) > LARGEST or part.superelement is not None:
        return None
    located = [assembly.scene.locators[number] for number in by_locator[name]]
    points, directions = (np.array([getattr(one, key) for one in located]) for key in ("point", "direction"))
    radii = [0.0 if one.hole is not None else one.radius for one in located]
    return HeldSheet(part.surface, part.thickness, part.young, part.poisson, points, directions, radii)


def _estimated(sheet: HeldSheet, items) -> list[np.ndarray]:
    """The estimated displacement (v, 3) by one standard deviation of each force, or of each mode of a shape."""
    item = items[0]
    amplitude = np.array([one.sigma or one.mean for one in items])
    if item.kind == "force":
        row = sheet.rows(np.array([item.point]), np.array([item.direction]), [item.radius])
        return [(amplitude[0] * sheet.response(row)).reshape(-1, 3)]
    values = np.array([one.known for one in items]).T
    fields = known_shape_fields(sheet, np.array(item.points), values, item.loose, item.name)
    return list(np.moveaxis(fields * amplitude, 2, 0))


def known_shape_fields(sheet: HeldSheet, points: np.ndarray, values: np.ndarray, loose: bool, name: str) -> np.ndarray:
    """(v, 3, q) displacement by shapes of q columns of values (c, q), mm along the normals at points (c, 3).

    Parameters
    ----------
    sheet : HeldSheet
    points, values : (c, 3) array, (c, q) array
        mm.
    loose : bool
        Whether the values hold for the part in any position.
    name : str
        For messages.

    Raises
    ------
    SceneError
        As :func:`mic.model.shape.controlling_forces`.
    """
    at, normals = sheet_normals(sheet.surface, points)
    rows = sheet.rows(at, normals)
    moved = sheet.response(rows)
    rigid = np.column_stack([normals, np.cross(at - sheet.surface.centroid, normals)])
    shapes = [KnownShape(rows, column, np.zeros(len(points)), loose) for column in values.T]
    fields = moved @ controlling_forces(rows @ moved, rigid, shapes, name)
    return fields.reshape(-1, 3, values.shape[1])
