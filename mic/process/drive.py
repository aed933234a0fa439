"""What drives a process: the positions, forces and gaps that a sample's deviations ask of the assembly.

With amplitudes a of the scene's deviations, and the readings y⁰ of the parts' stress-free shapes,

- a locator or a clamp that holds a position prescribes ``stroke + offset − y⁰`` to its row,
- a clamp pushes with its force and the deviation of it,
- a contact or a weld has the gap ``g⁰ + n·(shape deviation of b − of a)``, a weld one for each row along its normal:
  its mean, and how it tilts.

A tangential *shape* deviation is not a motion and drives nothing: it would make friction pull the parts together.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from mic.model.sources import sources
from mic.process.actions import Joints

__all__ = ["Asks", "Drive", "drive"]


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
    weld_gap : (n, r) array
        Likewise, what each of the welds' rows reads of the gap over the nugget, mm and rad; 0 of tangential rows.
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


@dataclass(frozen=True)
class Asks:
    """What deviations ask beside shapes, whatever their values.

    Attributes
    ----------
    stroke : (k,) array
        Of the clamps.
    force : (c,) array
        Of the clamp rows: those of the clamps, and behind them the parts' weights.
    target : tuple of (str, int, int, float)
        Kind and number of a row, number of a deviation, and how far its unit moves the row's target.
    push : tuple of (int, int, float)
        Number of a clamp row, number of a deviation, and how much its unit adds to the force.
    """

    stroke: np.ndarray
    force: np.ndarray
    target: tuple[tuple[str, int, int, float], ...]
    push: tuple[tuple[int, int, float], ...]

    @classmethod
    def of(cls, assembly) -> Asks:
        """Of a :class:`mic.model.assembly.Assembly` or :class:`mic.model.reduction.Reduction`."""
        scene, labels = assembly.scene, assembly.labels
        stroke = np.array([clamp.stroke or 0.0 for clamp in scene.clamps])
        force = np.zeros(len(labels["clamp"]))
        force[: len(stroke)] = [clamp.force or 0.0 for clamp in scene.clamps]
        every = list(enumerate(sources(scene)))
        target = ((*row, j, share) for j, source in every for row, share in source.target(labels).items())
        push = ((row, j, share) for j, source in every for (_, row), share in source.push(labels).items())
        return cls(stroke, force, tuple(target), tuple(push))


def drive(assembly, deviations: np.ndarray, shape: Mapping[str, np.ndarray], asks: Asks | None = None) -> Drive:
    """What the deviations ask of an assembly.

    Parameters
    ----------
    assembly : mic.model.assembly.Assembly or mic.model.reduction.Reduction
    deviations : (n, p) array
    shape : mapping of str to (n, r) array
        What the rows of each kind, and rest rows (:class:`mic.model.rest_rows.RestRows`), read of the parts' stress-free
        shapes, mm.
    asks : Asks, optional
        Of the assembly, where they are known.
    """
    asks = asks or Asks.of(assembly)
    target = {kind: -shape[kind] for kind in ("locator", "clamp", "rest") if kind in shape}
    target["clamp"][:, : len(asks.stroke)] += asks.stroke
    push = np.tile(asks.force, (len(deviations), 1))
    for kind, row, j, share in asks.target:
        target[kind][:, row] += share * deviations[:, j]
    for row, j, share in asks.push:
        push[:, row] += share * deviations[:, j]
    contacts, normal = assembly.contacts, Joints(tuple(assembly.weld_size)).normals
    weld_gap = np.tile(assembly.weld_gap, (len(deviations), 1))
    weld_gap[:, normal] += shape["weld"][:, normal]
    return Drive(
        target,
        push,
        contacts.gap + shape["contact"][:, :: contacts.dimension],
        weld_gap,
        assembly.between.gap + shape["between"],
        shape["measurement"],
    )
