"""Domain of applicability: the ranges of the inputs of the cases that studies compare.

Every assembly that a study builds through :mod:`verification.comparison` is recorded; nothing is typed.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping
from contextlib import contextmanager

import numpy as np

from mic.model.assembly import Assembly
from mic.model.reduction import Reduction
from mic.scene.deviation import deviation_unit

__all__ = ["QUANTITIES", "Range", "collected", "merged", "ranges", "record", "unrecorded"]

#: Quantity and unit.
QUANTITIES = {
    "thickness": ("thickness", "mm"),
    "size": ("size of a part", "mm"),
    "slenderness": ("size over thickness", "1"),
    "curvature": ("thickness over radius of a bend", "1"),
    "bend": ("elements per right angle of the sharpest bend", "1"),
    "element": ("element size over thickness", "1"),
    "young": ("Young's modulus", "MPa"),
    "friction": ("coefficient of friction", "1"),
    "gap": ("nominal gap of a contact", "mm"),
    "pairs": ("contact pairs", "1"),
    "deviation": ("deviation (3σ of a source) over thickness", "1"),
}
FLAT = np.radians(0.1)  # an element that turns by less is flat
SIGMAS = 3.0
ROUNDING = 1e-12  # of the size: a smaller gap is closed

Range = tuple[float, float]

_recorded: dict[str, Range] = {}
_recording = True


def ranges(assembly: Assembly, model: Reduction) -> dict[str, Range]:
    """Smallest and largest value of each quantity of :data:`QUANTITIES` that an assembly has."""
    contacts = assembly.contacts
    thickness = np.array([part.thickness for part in assembly.parts])
    size = np.array([part.surface.diameter for part in assembly.parts])
    values: dict[str, list[float] | np.ndarray] = {
        "thickness": thickness,
        "size": size,
        "slenderness": size / thickness,
        "young": [part.young for part in assembly.parts],
        "element": np.concatenate([np.ravel(part.surface.edge_lengths) / part.thickness for part in assembly.parts]),
        "friction": contacts.friction,
        "gap": np.where(contacts.gap > ROUNDING * size.max(), contacts.gap, 0.0),
        "pairs": [len(contacts)],
        "deviation": _deviations(assembly, model, thickness.min()),
    }
    bends = [_bends(part) for part in assembly.parts]
    values["curvature"], values["bend"] = (np.concatenate(each) for each in zip(*bends))
    return {name: (float(np.min(each)), float(np.max(each))) for name, each in values.items() if np.size(each)}


def _bends(part) -> tuple[np.ndarray, np.ndarray]:
    """Thickness over radius of each curved edge of the mesh, and elements per right angle where it turns the most."""
    normals, corners = part.surface.corner_normals, part.surface.corners
    cosine = np.einsum("kci,kci->kc", normals, np.roll(normals, -1, axis=1))
    turn = np.arccos(np.clip(cosine, -1.0, 1.0))
    curvature = turn / np.linalg.norm(corners - np.roll(corners, -1, axis=1), axis=2)
    curved = turn > FLAT
    most = turn[curved].max(initial=0.0)
    return part.thickness * curvature[curved], np.array([np.pi / 2 / most] if most else [])


def _deviations(assembly: Assembly, model: Reduction, thickness: float) -> np.ndarray:
    """3σ of each source in mm, at the retained points or of its item, over a thickness."""
    moved = np.abs(model.shape[~np.concatenate([part.functionals.rotation for part in assembly.parts])])
    found = []
    for k, item in enumerate(model.scene.deviations):
        position = 1.0 if deviation_unit(item, model.scene) == "mm" else 0.0
        found.append(SIGMAS * (item.sigma or 0.0) * moved[:, k].max(initial=position) / thickness)
    return np.array(found)


def record(assembly: Assembly, model: Reduction) -> None:
    """Add an assembly to the recorded ranges."""
    if _recording:
        found = merged([_recorded, ranges(assembly, model)])
        _recorded.update(found)


@contextmanager
def unrecorded() -> Iterator[None]:
    """Within this context no assembly is recorded: its results are not judged, or expected to be wrong."""
    global _recording
    before, _recording = _recording, False
    try:
        yield
    finally:
        _recording = before


def collected() -> dict[str, Range]:
    """The ranges recorded since the last call."""
    found = dict(_recorded)
    _recorded.clear()
    return found


def merged(several: Iterable[Mapping[str, Range]]) -> dict[str, Range]:
    """The union of ranges, in the order of :data:`QUANTITIES`."""
    several = list(several)
    by_name = {name: [each[name] for each in several if name in each] for name in QUANTITIES}
    return {name: (min(low for low, _ in own), max(high for _, high in own)) for name, own in by_name.items() if own}
