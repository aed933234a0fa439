"""Rows of contact pairs and of the points between them."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from mic.contact.laws.pressure_dependent import rescaled
from mic.errors import Problems
from mic.geometry.pairing import ContactPair, PressedPoint, find_between
from mic.model.assembly_types import Contacts, GapPoints
from mic.model.overlap import close_overlap
from mic.model.rows import AXES, Rows
from mic.model.zone_pairs import landmarks

__all__ = ["contact_rows", "gap_point_rows"]


def contact_rows(
    rows: Rows, pairs_of_zones: Sequence[Sequence[ContactPair]], every_node: bool, problems: Problems
) -> Contacts:
    """Add the rows of all contact pairs; returns the data of the pairs.

    Parameters
    ----------
    rows : Rows
    pairs_of_zones : sequence of sequences of ContactPair
    every_node : bool
        Whether all pairs are candidates.
    problems : Problems
        Collects errors.
    """
    scene = rows.scene
    dimension = 3 if scene.reads_slip else 1
    pairs = [pair for zone_pairs in pairs_of_zones for pair in zone_pairs]
    zone_of = np.array([i for i, zone_pairs in enumerate(pairs_of_zones) for _ in zone_pairs], dtype=np.int64)
    zones = [scene.zones[i] for i in zone_of]
    for k, (zone, pair) in enumerate(zip(zones, pairs)):
        _pair_rows(rows, "contact", f"{zone.name} {k}", zone, pair, dimension)
    area = np.array([pair.area for pair in pairs])
    gap = np.array([pair.gap for pair in pairs])
    drawn = np.array([[pair.overlap, pair.overlapping * pair.area] for pair in pairs]).reshape(-1, 2)
    point = np.array([pair.point for pair in pairs]).reshape(-1, 3)
    for i, zone in enumerate(scene.zones):
        in_zone = zone_of == i
        if zone.gap is not None:
            gap[in_zone], drawn[in_zone] = zone.gap, 0.0
            continue
        key = f"zones[{i}] ({zone.name}): nominal_overlap"
        with problems:
            gap[in_zone] = close_overlap(scene, key, zone, zone.nominal_overlap, gap[in_zone], point[in_zone])
    by_stage = [zone.friction for zone in scene.zones if isinstance(zone.friction, dict)]
    stages = sorted({stage for table in by_stage for stage in table} - {"default"})
    tributary = [every_node or zone.patch == "tributary" for zone in zones]
    bearing = np.array([own if whole else np.pi * zone.patch**2 for own, whole, zone in zip(area, tributary, zones)])
    stiffness = [zone.tangential_stiffness for zone in zones]
    watched = np.array([every_node or zone.candidates for zone in zones], dtype=bool)
    through = [
        sum(part.sheet[0] / (2 * part.sheet[1]) for part in scene.parts if part.name in zone.parts)
        for zone in scene.zones
    ]
    return Contacts(
        zone=zone_of,
        stages=np.array(stages, dtype=str),
        friction=np.array([[scene.zones[i].coefficient(stage) for i in zone_of] for stage in [*stages, "default"]]),
        pressure=_pressure_pieces(scene, zone_of, bearing),
        compliance=np.array([0.0 if k is None else 1.0 / (k * A) for k, A in zip(stiffness, bearing)]),
        gap=gap,
        overlap=drawn[:, 0],
        overlapping=drawn[:, 1],
        area=area,
        watched=watched,
        layer=np.where(watched, np.array([through[i] for i in zone_of]) / area, 0.0),
        nugget=np.array([pair.nugget for pair in pairs], dtype=np.int64),
        bearing=bearing,
        point=point,
        frame=np.array([pair.frame for pair in pairs]).reshape(-1, 3, 3),
        dimension=dimension,
    )


def gap_point_rows(
    rows: Rows, pressed: Sequence[Sequence[PressedPoint]], pairs_of_zones: Sequence[Sequence[ContactPair]]
) -> GapPoints:
    """Add the normal readings of the points between the contact pairs; arguments as of :func:`contact_rows`."""
    points: list[ContactPair] = []
    zones: list[int] = []
    gaps: list[float] = []
    for i, (zone, pairs, places) in enumerate(zip(rows.scene.zones, pairs_of_zones, pressed)):
        first, second = (rows.bodies[name] for name in zone.parts)
        for point in find_between(zone, first, second, pairs, landmarks(rows.scene), places):
            _pair_rows(rows, "between", f"{zone.name} between {len(points)}", zone, point, 1)
            points.append(point)
            zones.append(i)
            drawn = point.gap if zone.nominal_overlap == "keep" else max(point.gap, 0.0)
            gaps.append(drawn if zone.gap is None else zone.gap)
    return GapPoints(
        np.array(zones, dtype=np.int64),
        np.array(gaps, dtype=float),
        np.array([point.nugget for point in points], dtype=np.int64),
        np.array([point.point for point in points]).reshape(-1, 3),
    )


def _pair_rows(rows: Rows, kind, label, zone, pair: ContactPair, dimension) -> None:
    """Add the rows n, t1, t2 of a pair: motion of its second body less that of its first."""
    terms: list[list[tuple[str, int, float]]] = [[] for _ in range(dimension)]
    for name, patch, side, sign in zip(zone.parts, pair.patches, pair.sides, (-1.0, 1.0)):
        if not rows.bodies[name].rigid:  # a rigid fixture does not move
            index, side = rows.patch(name, patch), 0 if zone.mid_surface else side
            for own, axis, direction in zip(terms, AXES, pair.frame.T):
                own.append((name, rows.functional(name, index, direction, f"{label} {axis}", side=side), sign))
    for own, axis in zip(terms, AXES):
        rows.add(kind, f"{label} {axis}", *own)


def _pressure_pieces(scene, zone_of, bearing) -> np.ndarray:
    """(m, q, 5) friction coefficient of each pair as a function of its normal force, in the form of `Contacts`."""
    of_zone = [zone.pressure_pieces() for zone in scene.zones]
    count = max((len(pieces) for pieces in of_zone if pieces is not None), default=0)
    pressure = np.full((len(zone_of), count, 5), np.nan)
    for k, i in enumerate(zone_of):
        if of_zone[i] is not None:
            pressure[k] = [np.inf, 0.0, 0.0, 0.0, 0.0]
            pressure[k, : len(of_zone[i])] = rescaled(of_zone[i], 1.0 / bearing[k])
    return pressure
