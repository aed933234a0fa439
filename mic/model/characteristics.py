"""Key characteristics: functions of the readings at a scene's measured points.

A *reading* ``r = u(x) · d`` is the mean displacement u of a disc, or of a hole's rim, about x along a unit vector d.

- ``point`` is its reading.
- ``flush``, ``gap`` and ``distance`` are ``u(x_to) · d − u(x) · d``: the motion of the second point away from the first
  along d. Displacements are small, so a distance changes by the motion of its ends along the line between them.
- ``parallelism`` over points x_i is ``max_i r_i − min_i r_i``.
- ``profile`` is ``2 max_i |r_i|``, d the normal at each point.

Under a rigid motion ``a + ω × x`` of the assembly a point reads ``N_i (a, ω)`` with ``N_i = [d, x × d]``. *Best fit*:
before reading i, the assembly moves as a rigid body to the position with the least sum of squares of the fitted
readings F. That subtracts ``N_i N_F⁺ r_F``; motions that the readings F do not see are not made. With weights w it
subtracts ``N_i (√w N_F)⁺ √w r_F``. A *frame* is such an alignment for several characteristics; a 3-2-1 alignment is the
one to six readings that see all motions, and makes these zero.

Except for ``max``, ``min`` and ``|·|`` everything is linear and part of the rows (:mod:`mic.model.rows`).
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any, Self

import numpy as np
from scipy.linalg import null_space

from mic.errors import SceneError
from mic.model.rows import Rows
from mic.scene import Measurement, Scene
from mic.scene.checks import entry, free_motions
from mic.scene.frame import Frame

__all__ = ["Characteristics", "aligned", "retain", "single_readings"]

Term = tuple[str, int, float]  #: part, functional of the part, coefficient
NOTHING = 1e-9  # remaining coefficient below which a best fit has removed a reading
DETERMINED = 1e-6  # relative to the largest singular value of N_F: a motion that six readings determine
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
    frames: dict[str, tuple[list[_Reading], Any]] = {}  # fitted readings, and roots of their weights or None
    for i, item in enumerate(rows.scene.measurements):
        with problems:
            readings[item.name] = _readings(rows, f"measurements[{i}]", item)
    for i, frame in enumerate(rows.scene.frames):
        with problems:
            try:
                frames[frame.name] = _fitted(rows, entry("frames", i, frame, "points"), frame, readings)
            except KeyError:
                continue  # the error of a point is already reported
    for i, item in enumerate(rows.scene.measurements):
        own = rows.scene.frame_of(item)
        if any(name not in readings for name in (item.name, *(item.best_fit or ()))):
            continue  # its error is already reported
        if own is not None and own.name not in frames:
            continue
        fitted, weights = [reading for name in item.best_fit or () for reading in readings[name]], None
        if own is not None:
            fitted, weights = frames[own.name]
        with problems:
            at = entry("measurements", i, item, "best_fit" if own is None else "frame")
            for label, terms in _fit(at, readings[item.name], fitted, weights):
                rows.add("measurement", label, *terms)


def _fitted(rows: Rows, key: str, frame: Frame, readings: Mapping[str, list[_Reading]]):
    """The readings that a frame fits, and their weights or None; raises KeyError for a point without readings."""
    locators = {item.name: item for item in rows.scene.locators}
    found: list[list[_Reading]] = []
    for point in rows.scene.points_of(frame):
        if isinstance(point, str) and point not in locators:
            found.append(readings[point])
            continue
        item = locators[point] if isinstance(point, str) else point
        patch = rows.item_patch(key, item.name, item)
        found.append([_reading(rows, f"{frame.name} {item.name}", item.part, patch, np.array(item.direction))])
    fitted = [reading for each in found for reading in each]
    if not fitted:
        raise SceneError(f"{key}: the scene has no measurement of kind point; name the points of the frame")
    if frame.kind == "3-2-1":
        N = _scaled(fitted, fitted)[0]
        free = null_space(N, rcond=DETERMINED)
        if free.shape[1] or len(fitted) != N.shape[1]:
            raise SceneError(
                f"{key}: its {len(fitted)} readings determine {N.shape[1] - free.shape[1]} of 6 rigid-body motions"
                f"{free_motions(free)}; give three points across one plane, two across another, and one along the third"
            )
    weights = None
    if frame.weights is not None:
        weights = np.repeat(np.sqrt(frame.weights), [len(each) for each in found])
    return fitted, weights


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


def _scaled(measured: list[_Reading], fitted: list[_Reading]) -> tuple[np.ndarray, np.ndarray]:
    """N of both about the centre of the fitted points, in units of their spread: then all motions weigh alike."""
    points = np.array([reading.point for reading in fitted])
    centre = points.mean(axis=0)
    spread = np.sqrt(((points - centre) ** 2).sum(axis=1).mean()) or 1.0
    N, N_F = (np.array([reading.rigid for reading in readings]) for readings in (measured, fitted))
    for matrix in (N, N_F):
        matrix[:, 3:] = (matrix[:, 3:] - np.cross(centre, matrix[:, :3])) / spread
    return N, N_F


def _shares(measured: list[_Reading], fitted: list[_Reading], weights: np.ndarray | None) -> np.ndarray:
    """(m, f) what the motion of a best fit takes from each reading for a unit of each fitted one."""
    N, N_F = _scaled(measured, fitted)
    if weights is None:
        return N @ np.linalg.pinv(N_F, rcond=UNSEEN)
    return N @ (np.linalg.pinv(weights[:, None] * N_F, rcond=UNSEEN) * weights)


def _fit(
    key: str, measured: list[_Reading], fitted: list[_Reading], weights: np.ndarray | None
) -> list[tuple[str, tuple[Term, ...]]]:
    """Rows of a measurement after a best fit of other readings, with roots of their weights: ``r_i − N_i N_F⁺ r_F``."""
    if not fitted:
        return [(reading.label, reading.terms) for reading in measured]
    rows, largest = [], 0.0
    for reading, shares in zip(measured, _shares(measured, fitted, weights)):
        terms: dict[tuple[str, int], float] = {(part, f): value for part, f, value in reading.terms}
        for other, share in zip(fitted, shares):
            for part, f, value in other.terms:
                terms[part, f] = terms.get((part, f), 0.0) - share * value
        largest = max([largest, *map(abs, terms.values())])
        rows.append((reading.label, tuple((part, f, value) for (part, f), value in terms.items())))
    if largest < NOTHING:
        raise SceneError(
            f"{key}: the best fit removes everything that this measurement reads, so it is always 0; fit on more "
            'points, or on others, or give the measurement frame = "none"'
        )
    return rows


def single_readings(scene: Scene) -> dict[str, _Reading]:
    """The readings of measurements with one, of locators and of the points of frames, by name, in a placed scene."""
    own = [point for frame in scene.frames for point in frame.points or () if not isinstance(point, str)]
    items: list[Any] = [*own, *scene.locators, *scene.measurements]
    found = {}
    for item in items:
        if getattr(item, "kind", "point") in Measurement.OVER:
            continue
        d, ends = np.array(item.direction), [np.array(item.point)]
        if getattr(item, "to", None) is not None:
            ends.append(np.array(item.to.point))
        rigid = [np.concatenate([d, np.cross(x, d)]) for x in ends]
        found[item.name] = _Reading(
            item.name, (), rigid[0] if len(ends) == 1 else rigid[1] - rigid[0], np.mean(ends, axis=0)
        )
    return found


def aligned(scene: Scene, measured: Mapping[str, float]) -> dict[str, float]:
    """Measured values in the frames and best fits of their characteristics.

    Parameters
    ----------
    scene : Scene
        Placed.
    measured : mapping of str to float
        Deviations as the machine read them, mm: of key characteristics, and of the points of the frames.

    Raises
    ------
    SceneError
        If a point of a frame is not measured, or a characteristic is no single reading.
    """
    readings, found = single_readings(scene), {}
    for item in scene.measurements:
        if item.name not in measured:
            continue
        frame = scene.frame_of(item)
        fitted = item.best_fit or []
        if frame is not None:
            fitted = [point if isinstance(point, str) else point.name for point in scene.points_of(frame)]
        lacking = [name for name in fitted if name not in measured or name not in readings]
        if lacking or (fitted and item.name not in readings):
            raise SceneError(
                f"{item.name}: it cannot be aligned, since {(lacking or [item.name])[0]!r} has no single measured "
                "value; add it, or align the values before and leave out --align"
            )
        value = measured[item.name]
        if fitted:
            weights = None if frame is None or frame.weights is None else np.sqrt(frame.weights)
            shares = _shares([readings[item.name]], [readings[name] for name in fitted], weights)[0]
            value -= float(shares @ [measured[name] for name in fitted])
        found[item.name] = value
    return found


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
