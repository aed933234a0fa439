"""Sources of deviation: one file a kind, registered here by the word that the scene uses for it.

A deviation of shape is not a force. Per unit amplitude a source gives its part readings y⁰ of the retained
functionals in the stress-free shape, so that with forces f and rigid motions q the functionals read ``y = H f + G q +
Σ a y⁰``, or it moves the fixture. :mod:`mic.model.shape` finds y⁰ from the force that makes the shape, or from what is
known of it. A few change the contacts themselves, or the parts.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from scipy.sparse import csr_matrix, diags

from mic.model.sources.clamp import ClampSetting
from mic.model.sources.force import CorrectiveForce
from mic.model.sources.friction import ZoneFriction
from mic.model.sources.gravity import Gravity
from mic.model.sources.locator import LocatorPosition
from mic.model.sources.shape import ShapeAtPoints
from mic.model.sources.source import Control, Source
from mic.model.sources.temperature import Temperature
from mic.model.sources.thickness import SheetThickness

__all__ = ["SOURCES", "Control", "Source", "changed", "ranges", "sources", "thicker"]

#: Kind in the scene's ``[[deviations]]`` → class; measured shapes and random fields have become shapes before
#: (:mod:`mic.model.shape_modes`).
SOURCES: dict[str, type[Source]] = {
    "force": CorrectiveForce,
    "locator": LocatorPosition,
    "clamp": ClampSetting,
    "shape": ShapeAtPoints,
    "gravity": Gravity,
    "temperature": Temperature,
    "thickness": SheetThickness,
    "friction": ZoneFriction,
}


def sources(scene) -> list[Source]:
    """The sources of a scene, in the order of its deviations."""
    return [SOURCES[item.kind](item, f"deviations[{i}]", scene) for i, item in enumerate(scene.deviations)]


def thicker(scene, deviations: np.ndarray) -> dict[str, float]:
    """By how much a sample's deviations (p,) make parts thicker, mm, by name; those that they leave are not in it."""
    return {
        name: float(amplitude)
        for source, amplitude in zip(sources(scene), deviations)
        for name in source.thickening()
        if amplitude != 0.0
    }


def ranges(scene) -> dict[str, tuple[float, float]]:
    """Smallest and largest thickness, mm, of the parts whose thickness varies, by name."""
    return {one.deviation.part: one.range for one in sources(scene) if isinstance(one, SheetThickness)}


def changed(assembly, deviations: np.ndarray):
    """An assembly, or its reduction, with the contacts and the weights that a sample's deviations (p,) make; the same
    object where they change nothing.

    Parameters
    ----------
    assembly : mic.model.assembly.Assembly or mic.model.reduction.Reduction
    deviations : (p,) array

    Raises
    ------
    ImpossibleSample
    """
    scene, contacts = assembly.scene, assembly.contacts
    for source, amplitude in zip(sources(scene), deviations):
        if source.changes and amplitude != 0.0:
            contacts = source.change(contacts, float(amplitude))
    if contacts is assembly.contacts:
        return assembly
    more = thicker(scene, deviations)
    weight = np.ones(len(assembly.labels["clamp"]))
    for part in scene.parts:
        if part.name in more:
            own = [source.row(assembly.labels, part.name) for source in sources(scene) if isinstance(source, Gravity)]
            weight[own] = 1.0 + more[part.name] / part.sheet[0]
    rows = {**assembly.rows, "clamp": csr_matrix(diags(weight) @ assembly.rows["clamp"])} if more else assembly.rows
    return replace(assembly, contacts=contacts, rows=rows)
