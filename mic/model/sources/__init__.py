"""Sources of deviation: one file a kind, registered here by the word that the scene uses for it.

A deviation of shape is not a force. Per unit amplitude a source gives its part readings y⁰ of the retained
functionals in the stress-free shape, so that with forces f and rigid motions q the functionals read ``y = H f + G q +
Σ a y⁰``, or it moves the fixture. :mod:`mic.model.shape` finds y⁰ from the force that makes the shape, or from what is
known of it. A few change the contacts themselves.
"""

from __future__ import annotations

import numpy as np

from mic.model.sources.clamp import ClampSetting
from mic.model.sources.force import CorrectiveForce
from mic.model.sources.friction import ZoneFriction
from mic.model.sources.gravity import Gravity
from mic.model.sources.locator import LocatorPosition
from mic.model.sources.shape import ShapeAtPoints
from mic.model.sources.source import Control, Source
from mic.model.sources.temperature import Temperature

__all__ = ["SOURCES", "Control", "Source", "changed", "sources"]

#: Kind in the scene's ``[[deviations]]`` → class; measured shapes and random fields have become shapes before
#: (:mod:`mic.model.modes`).
SOURCES: dict[str, type[Source]] = {
    "force": CorrectiveForce,
    "locator": LocatorPosition,
    "clamp": ClampSetting,
    "shape": ShapeAtPoints,
    "gravity": Gravity,
    "temperature": Temperature,
    "friction": ZoneFriction,
}


def sources(scene) -> list[Source]:
    """The sources of a scene, in the order of its deviations."""
    return [SOURCES[item.kind](item, f"deviations[{i}]", scene) for i, item in enumerate(scene.deviations)]


def changed(scene, contacts, deviations: np.ndarray):
    """The contacts as a sample's deviations (p,) make them; the same object where they change nothing.

    Raises
    ------
    ImpossibleSample
    """
    for source, amplitude in zip(sources(scene), deviations):
        if source.changes and amplitude != 0.0:
            contacts = source.change(contacts, float(amplitude))
    return contacts
