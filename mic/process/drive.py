"""The drive of a process: prescribed positions, forces and gaps that follow from a sample's deviations.

With amplitudes a of the scene's deviations, and the readings y⁰ of the parts' stress-free shapes,

- a locator or a clamp that holds a position prescribes ``stroke + offset − y⁰`` to its row,
- a clamp pushes with its force plus the deviation of it,
- a contact or a weld has the gap ``g⁰ + n·(shape deviation of b − of a)``; a weld has one for each row along its
  normal: its mean, and how it tilts.

A tangential *shape* deviation is not a motion and drives nothing: otherwise friction would pull the parts together.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, fields

import numpy as np

from mic.model.sources import sources

__all__ = ["DriveTerms", "Drive", "drive"]


@dataclass(frozen=True)
class Drive:
    """Prescribed positions, forces and gaps of n assemblies.

    Attributes
    ----------
    target : dict of str to (n, r) array
        Positions prescribed to ``"locator"`` and ``"clamp"`` rows, mm, and readings of ``"rest"`` rows for parts in
        their nominal position.
    push : (n, c) array
        Forces of the clamp rows, N.
    gap : (n, m) array
        Initial gaps of the contacts, mm, positive when open.
    weld_gap : (n, r) array
        Readings of the welds' rows of the initial gap over the nugget, mm and rad; 0 for tangential rows.
    between : (n, q) array
        Initial gaps at the points between the contacts, mm.
    measured : (n, k) array
        Readings of the measurements of the parts' shapes, mm.
    """

    target: dict[str, np.ndarray]
    push: np.ndarray
    gap: np.ndarray
    weld_gap: np.ndarray
    between: np.ndarray
    measured: np.ndarray

    def __len__(self):
        return len(self.push)

    def combined(self, function: Callable[..., np.ndarray], *others: Drive) -> Drive:
        """A function of each array of this drive and the same arrays of others."""
        drives = (self, *others)
        target = {kind: function(*(drive.target[kind] for drive in drives)) for kind in self.target}
        names = [field.name for field in fields(Drive) if field.name != "target"]
        return Drive(target, *(function(*(getattr(drive, name) for drive in drives)) for name in names))


@dataclass(frozen=True)
class DriveTerms:
    """Terms of the drive that do not depend on shapes: nominal values and coefficients of the deviations.

    Attributes
    ----------
    stroke : (k,) array
        Of the clamps, mm.
    force : (c,) array
        Of the clamp rows, N: those of the clamps, then the parts' weights.
    target : tuple of (str, int, int, float)
        Kind and number of a row, number of a deviation, and how far its unit moves the row's target.
    push : tuple of (int, int, float)
        Number of a clamp row, number of a deviation, and how much its unit adds to the force.
    normal : (w,) int array
        Weld rows along a normal.
    """

    stroke: np.ndarray
    force: np.ndarray
    target: tuple[tuple[str, int, int, float], ...]
    push: tuple[tuple[int, int, float], ...]
    normal: np.ndarray

    @classmethod
    def of(cls, assembly) -> DriveTerms:
        """The terms of a :class:`mic.model.assembly.Assembly` or :class:`mic.model.reduction.Reduction`."""
        scene, labels = assembly.scene, assembly.labels
        stroke = np.array([clamp.stroke or 0.0 for clamp in scene.clamps])
        force = np.zeros(len(labels["clamp"]))
        force[: len(stroke)] = [clamp.force or 0.0 for clamp in scene.clamps]
        numbered = list(enumerate(sources(scene)))
        target = ((*row, j, share) for j, source in numbered for row, share in source.target(labels).items())
        push = ((row, j, share) for j, source in numbered for (_, row), share in source.push(labels).items())
        return cls(stroke, force, tuple(target), tuple(push), assembly.joints.normals)


def drive(assembly, deviations: np.ndarray, shape: Mapping[str, np.ndarray], terms: DriveTerms | None = None) -> Drive:
    """The drive of an assembly for given deviations.

    Parameters
    ----------
    assembly : mic.model.assembly.Assembly or mic.model.reduction.Reduction
    deviations : (n, p) array
    shape : mapping of str to (n, r) array
        Readings of the parts' stress-free shapes by the rows of each kind, and by rest rows
        (:class:`mic.model.rest_rows.RestRows`), mm.
    terms : DriveTerms, optional
        Of the assembly, if known already.
    """
    terms = terms or DriveTerms.of(assembly)
    target = {kind: -shape[kind] for kind in ("locator", "clamp", "rest") if kind in shape}
    target["clamp"][:, : len(terms.stroke)] += terms.stroke
    push = np.tile(terms.force, (len(deviations), 1))
    for kind, row, j, share in terms.target:
        target[kind][:, row] += share * deviations[:, j]
    for row, j, share in terms.push:
        push[:, row] += share * deviations[:, j]
    contacts, normal = assembly.contacts, terms.normal
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
