"""Sources of deviation: one file for each kind, registered here by the kind's name in the scene.

A deviation of shape is not a force. Per unit amplitude a source gives its part readings y⁰ of the retained
functionals in the stress-free shape, so that with forces f and rigid motions q the functionals read ``y = H f + G q +
Σ a y⁰``, or it moves the fixture. :mod:`mic.model.shape` computes y⁰ from the force that causes the shape, or from
known values of the shape. A few kinds change the contacts or the parts themselves.
"""

from __future__ import annotations

from dataclasses import replace
from typing import get_args

import numpy as np
from scipy.sparse import csr_matrix, diags

from mic.model.sources.clamp import ClampSetting
from mic.model.sources.force import CorrectiveForce
from mic.model.sources.friction import ZoneFriction
from mic.model.sources.gravity import Gravity
from mic.model.sources.locator import LocatorPosition
from mic.model.sources.shape import ShapeAtPoints
from mic.model.sources.source import KnownShape, Source
from mic.model.sources.temperature import Temperature
from mic.model.sources.thickness import SheetThickness
from mic.scene import deviation

__all__ = ["SOURCES", "KnownShape", "Source", "sources", "thickness_changes", "thickness_ranges", "with_deviations"]

#: Class by kind, which the table in the scene names; measured shapes and random fields are first expanded into shapes
#: (:mod:`mic.model.shape_modes`).
SOURCES: dict[str, type[Source]] = {
    get_args(table.model_fields["kind"].annotation)[0]: source
    for table, source in (
        (deviation.ForceDeviation, CorrectiveForce),
        (deviation.LocatorDeviation, LocatorPosition),
        (deviation.ClampDeviation, ClampSetting),
        (deviation.ShapeDeviation, ShapeAtPoints),
        (deviation.GravityDeviation, Gravity),
        (deviation.TemperatureDeviation, Temperature),
        (deviation.ThicknessDeviation, SheetThickness),
        (deviation.FrictionDeviation, ZoneFriction),
    )
}


def sources(scene) -> list[Source]:
    """The sources of a scene, in the order of its deviations; their keys name entries of the scene file."""
    return [SOURCES[item.kind](item, f"deviations[{item.entry(i)}]", scene) for i, item in enumerate(scene.deviations)]


def thickness_changes(scene, deviations: np.ndarray) -> dict[str, float]:
    """Changes of thickness due to a sample's deviations (p,), mm, by part; parts without a change are left out."""
    return {
        name: float(amplitude)
        for source, amplitude in zip(sources(scene), deviations)
        for name in source.thickening()
        if amplitude != 0.0
    }


def thickness_ranges(scene) -> dict[str, tuple[float, float]]:
    """Smallest and largest thickness, mm, of the parts whose thickness varies, by name."""
    return {one.deviation.part: one.range for one in sources(scene) if isinstance(one, SheetThickness)}


def with_deviations(assembly, deviations: np.ndarray):
    """An assembly, or its reduction, with the contacts and weights of a sample's deviations (p,).

    It is the same object if they change nothing.

    Parameters
    ----------
    assembly : mic.model.assembly_types.Assembly or mic.model.reduction.Reduction
    deviations : (p,) array

    Raises
    ------
    ImpossibleSample
    """
    scene, contacts, of_scene = assembly.scene, assembly.contacts, sources(assembly.scene)
    for source, amplitude in zip(of_scene, deviations):
        if source.changes and amplitude != 0.0:
            contacts = source.change(contacts, float(amplitude))
    if contacts is assembly.contacts:
        return assembly
    more = thickness_changes(scene, deviations)
    weight = np.ones(len(assembly.labels["clamp"]))
    for part in scene.parts:
        if part.name in more:
            weight_rows = [source.row(assembly.labels, part.name) for source in of_scene if isinstance(source, Gravity)]
            weight[weight_rows] = 1.0 + more[part.name] / part.sheet[0]
    rows = {**assembly.rows, "clamp": csr_matrix(diags(weight) @ assembly.rows["clamp"])} if more else assembly.rows
    return replace(assembly, contacts=contacts, rows=rows)
