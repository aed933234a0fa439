"""Key characteristics: functions of the readings at a scene's measured points.

A *reading* ``r = u(x) · d`` is the mean displacement u of a disc, or of a hole's rim, about x along a unit vector d.

- ``point`` is its reading.
- ``flush``, ``gap`` and ``distance`` are ``u(x_to) · d − u(x) · d``: the motion of the second point away from the first
  along d. Displacements are small, so a distance changes by the motion of its ends along the line between them.
- ``parallelism`` over points x_i is ``max_i r_i − min_i r_i``.
- ``profile`` is ``2 max_i |r_i|``, d the normal at each point.

Under a rigid motion ``a + ω × x`` of the assembly a point reads ``N_i (a, ω)`` with ``N_i = [d, x × d]``. *Best fit*:
before reading i, the assembly moves as a rigid body to the position with the least sum of squares of the fitted
readings F. That subtracts ``N_i N_F⁺ r_F``; motions that the readings F do not see are not made.

Except for ``max``, ``min`` and ``|·|`` everything is linear and part of the rows (:mod:`mic.model.rows`).
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Self

import numpy as np

from mic.errors import SceneError
from mic.model.rows import Rows
from mic.scene import Measurement, Scene
from mic.scene.checks import entry

__all__ = ["Characteristics", "retain"]

Term = tuple[str, int, float]  #: part, functional of the part, coefficient
NOTHING = 1e-9  # remaining coefficient below which a best fit has removed a reading
UNSEEN = 1e-9  # relative to the largest singular value of N_F: a motion that the fitted readings do not see


@dataclass(frozen=True)
class _Reading:
    """One reading: its label, its terms over functionals, N (6,), and its point (3,)."""

    label: str
    terms: tuple[Term, ...]
    rigid: np.ndarray
    point: np.ndarray


def retain(rows: Rows, problems) -> None:
    """Add the rows of the scene's measurements.

    Parameters
    ----------
    rows : Rows
    problems : context manager
        Collects each :class:`SceneError`: points off their part, characteristics that their best fit removes.
    """
    readings: dict[str, list[_Reading]] = {}
    for i, item in enumerate(rows.scene.measurements):
        with problems:
            readings[item.name] = _readings(rows, f"measurements[{i}]", item)
    for i, item in enumerate(rows.scene.measurements):
        if any(name not in readings for name in (item.name, *(item.best_fit or ()))):
            continue  # its error is already reported
        fitted = [reading for name in item.best_fit or () for reading in readings[name]]
        with problems:
            for label, terms in _fit(entry("measurements", i, item, "best_fit"), readings[item.name], fitted):
                rows.add("measurement", label, *terms)


def _readings(rows: Rows, key: str, item: Measurement) -> list[_Reading]:
    """The readings of one measurement, before any best fit."""
    if item.points is not None:
        discs, normals = rows.item_discs(key, item)
        along = normals if item.kind == "profile" else [np.array(item.direction)] * len(discs)
        at = [f"{item.name} at {k}" for k in range(len(discs))]
        return [_reading(rows, label, item.part, disc, d) for label, disc, d in zip(at, discs, along)]
    d = np.array(item.direction)
    first = _reading(rows, item.name, item.part, rows.item_patch(key, item.name, item), d)
    if item.to is None:
        return [first]
    patch = rows.item_patch(f"{key}.to", item.name, item.to)
    second = _reading(rows, f"{item.name} to", item.to.part, patch, d)
    difference = (*second.terms, *((part, functional, -value) for part, functional, value in first.terms))
    return [_Reading(item.name, difference, second.rigid - first.rigid, (first.point + second.point) / 2)]


def _reading(rows: Rows, label: str, part: str, patch: int, d: np.ndarray) -> _Reading:
    functional = rows.functional(part, patch, d, f"measurement {label}")
    x = rows.mean_point(part, patch)
    return _Reading(label, ((part, functional, 1.0),), np.concatenate([d, np.cross(x, d)]), x)


def _fit(key: str, measured: list[_Reading], fitted: list[_Reading]) -> list[tuple[str, tuple[Term, ...]]]:
    """Rows of a measurement after a best fit of other readings: ``r_i − N_i N_F⁺ r_F``."""
    if not fitted:
        return [(reading.label, reading.terms) for reading in measured]
    # About the centre of the fitted points, in units of their spread: then translations and rotations weigh alike.
    points = np.array([reading.point for reading in fitted])
    centre = points.mean(axis=0)
    spread = np.sqrt(((points - centre) ** 2).sum(axis=1).mean()) or 1.0
    N, N_F = (np.array([reading.rigid for reading in readings]) for readings in (measured, fitted))
    for matrix in (N, N_F):
        matrix[:, 3:] = (matrix[:, 3:] - np.cross(centre, matrix[:, :3])) / spread
    rows, largest = [], 0.0
    for reading, shares in zip(measured, N @ np.linalg.pinv(N_F, rcond=UNSEEN)):
        terms: dict[tuple[str, int], float] = {(part, f): value for part, f, value in reading.terms}
        for other, share in zip(fitted, shares):
            for part, f, value in other.terms:
                terms[part, f] = terms.get((part, f), 0.0) - share * value
        largest = max([largest, *map(abs, terms.values())])
        rows.append((reading.label, tuple((part, f, value) for (part, f), value in terms.items())))
    if largest < NOTHING:
        raise SceneError(
            f"{key}: the best fit removes everything that this measurement reads, so it is always 0; fit on more "
            "points, or on others"
        )
    return rows


@dataclass(frozen=True)
class Characteristics:
    """Key characteristics as functions of their readings.

    Attributes
    ----------
    kind : tuple of str
        Of each characteristic, in the scene's order.
    start : (k + 1,) int array
        First of the readings of each among all r, and the end of the last.
    """

    kind: tuple[str, ...]
    start: np.ndarray

    @classmethod
    def of(cls, scene: Scene) -> Self:
        """The characteristics of a placed scene."""
        count = [len(item.points) if item.points is not None else 1 for item in scene.measurements]
        return cls(tuple(item.kind for item in scene.measurements), np.concatenate([[0], np.cumsum(count)]).astype(int))

    def readings(self, k: int) -> slice:
        """The readings of a characteristic."""
        return slice(self.start[k], self.start[k + 1])

    def values(self, readings: np.ndarray) -> np.ndarray:
        """(n, k) characteristics of (n, r) readings, mm."""
        values = np.empty((len(readings), len(self.kind)))
        for k, kind in enumerate(self.kind):
            selected = readings[:, self.readings(k)]
            if kind == "parallelism":
                values[:, k] = selected.max(axis=1) - selected.min(axis=1)
            elif kind == "profile":
                values[:, k] = 2 * np.abs(selected).max(axis=1)
            else:
                values[:, k] = selected[:, 0]
        return values

    def tangent(self, readings: np.ndarray) -> np.ndarray:
        """(n, k, r) derivatives of the characteristics by their readings; for the first of several extreme points."""
        derivatives = np.zeros((len(readings), len(self.kind), readings.shape[1]))
        sample = np.arange(len(readings))
        for k, kind in enumerate(self.kind):
            first, selected = self.start[k], readings[:, self.readings(k)]
            if kind == "parallelism":
                derivatives[sample, k, first + selected.argmax(axis=1)] += 1.0
                derivatives[sample, k, first + selected.argmin(axis=1)] -= 1.0
            elif kind == "profile":
                most = np.abs(selected).argmax(axis=1)
                derivatives[sample, k, first + most] = 2 * np.sign(selected[sample, most])
            else:
                derivatives[:, k, first] = 1.0
        return derivatives
