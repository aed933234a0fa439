"""Key characteristics: what a scene's measurements make of the points that they read.

A *reading* ``r = u(x) · d`` is the mean displacement u of a disc, or of a hole's rim, about x along a unit vector d.

- ``point`` is its reading.
- ``flush``, ``gap`` and ``distance`` are ``u(x_to) · d − u(x) · d``: how far the second point moves away from the first
  along d. Displacements are small, so a distance changes by what its ends move along the line between them.
- ``parallelism`` over points x_i is ``max_i r_i − min_i r_i``.
- ``profile`` is ``2 max_i |r_i|``, d the normal at each point.

Under a rigid motion ``a + ω × x`` of the assembly a point reads ``N_i (a, ω)`` with ``N_i = [d, x × d]``. *Best fit*:
the assembly is moved, as a rigid body, to where the sum of squares of the readings F to be fitted is least, before i is
read. That takes away ``N_i N_F⁺ r_F``; of the motions that the readings F do not tell, none is made.

All but ``max``, ``min`` and ``|·|`` is linear and stands in the rows (:mod:`mic.model.rows`).
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Self

import numpy as np

from mic.errors import SceneError
from mic.geometry.measured_points import sheet_normals
from mic.model.rows import Rows
from mic.scene import Measurement, Scene
from mic.scene.checks import entry

__all__ = ["Characteristics", "retain"]

Term = tuple[str, int, float]  #: part, functional of the part, coefficient
NOTHING = 1e-9  # of a reading, left after a best fit: it is fitted away
UNTOLD = 1e-9  # of the largest singular value of N_F: a motion that the fitted readings do not tell


@dataclass(frozen=True)
class _Reading:
    """One reading: its label, its terms over functionals, N (6,), and its point (3,)."""

    label: str
    terms: tuple[Term, ...]
    rigid: np.ndarray
    point: np.ndarray


def retain(rows: Rows, scene: Scene, problems) -> None:
    """Add the rows of a placed scene's measurements.

    Parameters
    ----------
    rows : Rows
    scene : Scene
    problems : context manager
        Collects each :class:`SceneError`: of points off their part, of characteristics that their best fit takes away.
    """
    own: dict[str, list[_Reading]] = {}
    for i, item in enumerate(scene.measurements):
        with problems:
            own[item.name] = _readings(rows, f"measurements[{i}]", item)
    for i, item in enumerate(scene.measurements):
        if any(name not in own for name in (item.name, *(item.best_fit or ()))):
            continue  # which is told above
        fitted = [reading for name in item.best_fit or () for reading in own[name]]
        with problems:
            for label, terms in _fit(entry("measurements", i, item, "best_fit"), own[item.name], fitted):
                rows.add("measurement", label, *terms)


def _readings(rows: Rows, key: str, item: Measurement) -> list[_Reading]:
    """What one measurement reads, before any best fit."""
    if item.points is not None:
        points = np.array(item.points)
        foot, n = sheet_normals(rows.surfaces[item.part], points)
        rows.near(key, item.name, item.part, points, foot)
        along = n if item.kind == "profile" else np.tile(item.direction, (len(points), 1))
        discs = [rows.disc(item.part, x, item.radius) for x in foot]
        return [
            _reading(rows, f"{item.name} at {k}", item.part, patch, d) for k, (patch, d) in enumerate(zip(discs, along))
        ]
    first = _reading(rows, item.name, item.part, rows.place(key, item.name, item), np.array(item.direction))
    if item.to is None:
        return [first]
    patch = rows.place(f"{key}.to", item.name, item.to)
    second = _reading(rows, f"{item.name} to", item.to.part, patch, np.array(item.direction))
    apart = (*second.terms, *((part, functional, -value) for part, functional, value in first.terms))
    return [_Reading(item.name, apart, second.rigid - first.rigid, (first.point + second.point) / 2)]


def _reading(rows: Rows, label: str, part: str, patch: int, d: np.ndarray) -> _Reading:
    functional = rows.functional(part, patch, d, f"measurement {label}")
    x = rows.middle(part, patch)
    return _Reading(label, ((part, functional, 1.0),), np.concatenate([d, np.cross(x, d)]), x)


def _fit(key: str, own: list[_Reading], fitted: list[_Reading]) -> list[tuple[str, tuple[Term, ...]]]:
    """Rows of a measurement, less what the best fit on other readings takes away: ``r_i − N_i N_F⁺ r_F``."""
    if not fitted:
        return [(reading.label, reading.terms) for reading in own]
    # About the middle of the fitted points, in lengths of their spread: then a shift and a turn weigh alike.
    points = np.array([reading.point for reading in fitted])
    middle = points.mean(axis=0)
    spread = np.sqrt(((points - middle) ** 2).sum(axis=1).mean()) or 1.0
    N, N_F = (np.array([reading.rigid for reading in each]) for each in (own, fitted))
    for each in (N, N_F):
        each[:, 3:] = (each[:, 3:] - np.cross(middle, each[:, :3])) / spread
    taken = N @ np.linalg.pinv(N_F, rcond=UNTOLD)
    found, left = [], 0.0
    for reading, shares in zip(own, taken):
        terms: dict[tuple[str, int], float] = {(part, f): value for part, f, value in reading.terms}
        for other, share in zip(fitted, shares):
            for part, f, value in other.terms:
                terms[part, f] = terms.get((part, f), 0.0) - share * value
        left = max([left, *map(abs, terms.values())])
        found.append((reading.label, tuple((part, f, value) for (part, f), value in terms.items())))
    if left < NOTHING:
        raise SceneError(
            f"{key}: the best fit takes away all that this reads, which is then always 0; fit on more points, or on "
            "others"
        )
    return found


@dataclass(frozen=True)
class Characteristics:
    """Key characteristics as functions of their readings.

    Attributes
    ----------
    kind : tuple of str
        Of each, in the scene's order.
    start : (k + 1,) int array
        Where the readings of each begin among all r, and where the last ends.
    """

    kind: tuple[str, ...]
    start: np.ndarray

    @classmethod
    def of(cls, scene: Scene) -> Self:
        """Those of a placed scene."""
        count = [len(item.points) if item.points is not None else 1 for item in scene.measurements]
        return cls(tuple(item.kind for item in scene.measurements), np.concatenate([[0], np.cumsum(count)]).astype(int))

    def readings(self, k: int) -> slice:
        """Which readings are those of a characteristic."""
        return slice(self.start[k], self.start[k + 1])

    def values(self, readings: np.ndarray) -> np.ndarray:
        """(n, k) characteristics of (n, r) readings, mm."""
        found = np.empty((len(readings), len(self.kind)))
        for k, kind in enumerate(self.kind):
            own = readings[:, self.readings(k)]
            if kind == "parallelism":
                found[:, k] = own.max(axis=1) - own.min(axis=1)
            elif kind == "profile":
                found[:, k] = 2 * np.abs(own).max(axis=1)
            else:
                found[:, k] = own[:, 0]
        return found

    def tangent(self, readings: np.ndarray) -> np.ndarray:
        """(n, k, r) derivatives of the characteristics by their readings; of the first point where two are extreme."""
        found = np.zeros((len(readings), len(self.kind), readings.shape[1]))
        sample = np.arange(len(readings))
        for k, kind in enumerate(self.kind):
            first, own = self.start[k], readings[:, self.readings(k)]
            if kind == "parallelism":
                found[sample, k, first + own.argmax(axis=1)] += 1.0
                found[sample, k, first + own.argmin(axis=1)] -= 1.0
            elif kind == "profile":
                most = np.abs(own).argmax(axis=1)
                found[sample, k, first + most] = 2 * np.sign(own[sample, most])
            else:
                found[:, k, first] = 1.0
        return found
