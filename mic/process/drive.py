"""What drives a process: the positions, forces and gaps that a sample's deviations ask of the assembly.

With amplitudes a of the scene's deviations, and the readings y⁰ of the parts' stress-free shapes,

- a locator or a clamp that holds a position prescribes ``stroke + offset − y⁰`` to its row,
- a clamp pushes with its force and the deviation of it,
- a contact or a weld has the gap ``g⁰ + n·(shape deviation of b − of a)``.

A tangential *shape* deviation is not a motion and drives nothing: it would make friction pull the parts together.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from mic.model.sources import sources
from mic.process.actions import Joints

__all__ = ["Drive", "drive"]


@dataclass(frozen=True)
class Drive:
    """What n assemblies are driven by.

    Attributes
    ----------
    target : dict of str to (n, r) array
        Positions that ``"locator"`` and ``"clamp"`` rows prescribe, mm, and where ``"rest"`` rows read parts as drawn.
    push : (n, c) array
        Forces of the clamp rows, N.
    gap : (n, m) array
        Of the contacts before anything moves, mm, positive when open.
    weld_gap : (n, w) array
        Likewise, of the welds.
    between : (n, q) array
        Likewise, of the points between the contacts.
    measured : (n, k) array
        What the measurements read of the parts' shapes, mm.
    """

    target: dict[str, np.ndarray]
    push: np.ndarray
    gap: np.ndarray
    weld_gap: np.ndarray
    between: np.ndarray
    measured: np.ndarray

    def __len__(self):
        return len(self.push)


def drive(assembly, deviations: np.ndarray, shape: Mapping[str, np.ndarray]) -> Drive:
    """What the deviations ask of an assembly.

    Parameters
    ----------
    assembly : mic.model.assembly.Assembly or mic.model.reduction.Reduction
    deviations : (n, p) array
    shape : mapping of str to (n, r) array
        What the rows of each kind, and rest rows (:class:`mic.model.resting.RestRows`), read of the parts' stress-free
        shapes, mm.
    """
    scene, labels = assembly.scene, assembly.labels
    target = {kind: -shape[kind] for kind in ("locator", "clamp", "rest") if kind in shape}
    clamps = range(len(scene.clamps))  # behind them lie the parts' weights
    push = np.zeros((len(deviations), len(labels["clamp"])))
    push[:, clamps] = [clamp.force or 0.0 for clamp in scene.clamps]
    target["clamp"][:, clamps] += np.array([clamp.stroke or 0.0 for clamp in scene.clamps])
    for amplitude, source in zip(deviations.T, sources(scene)):
        for (kind, row), share in source.target(labels).items():
            target[kind][:, row] += share * amplitude
        for (_, row), share in source.push(labels).items():
            push[:, row] += share * amplitude
    contacts, joints = assembly.contacts, Joints(tuple(assembly.weld_size))
    return Drive(
        target,
        push,
        contacts.gap + shape["contact"][:, :: contacts.dimension],
        assembly.weld_gap + shape["weld"][:, joints.first],
        assembly.between.gap + shape["between"],
        shape["measurement"],
    )
