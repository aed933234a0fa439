"""Contact pairs of a zone, check points between them, and the pair at a weld."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
from scipy.spatial import cKDTree

from mic.geometry.pairing.candidates import PAD, candidate_spacing, find_candidates, tributary_or_disc
from mic.geometry.pairing.cell_centres import (
    cell_centres,
    farthest_points,
    first_maximum,
    nearest_centre,
    ranked_by_distance,
)
from mic.geometry.pairing.contact_pair import ContactPair, PressedPoint, Side, set_tangents, weld_numbers
from mic.geometry.pairing.facing_points import FINE, Bodies
from mic.geometry.pairing.sheet_sides import sheet_sides, side_of_points
from mic.geometry.pairing.standing_edges import standing_pair
from mic.geometry.surface import EQUAL

__all__ = ["find_between", "find_pairs", "pair_at"]


def find_pairs(
    zone, first: Side, second: Side, landmarks=(), pressed: Sequence[PressedPoint] = ()
) -> list[ContactPair]:
    """Contact pairs of a zone: those that it states, or candidates.

    Parameters
    ----------
    zone : mic.scene.zone.Zone
    first, second : Side
        The bodies in the order of ``zone.parts``.
    landmarks : (l, 3) array, optional
        Points of the scene, mm, such as locators: their distances break ties. Three points that are not collinear
        suffice.
    pressed : sequence of PressedPoint
        A candidate is placed at each of these that lies in the zone.

    Raises
    ------
    ValueError
        If the zone is empty or too small for its pairs, a stated point faces nothing, or the spacing of candidates is
        finer than the elements.

    Notes
    -----
    Stated points that coincide, or are closer than the sampling, share their area.
    """
    bodies = Bodies.of(zone, first, second)
    sampled, tie = bodies.sampled, bodies.tie
    anchors = bodies.anchors(landmarks)
    if zone.candidates:
        spacing = candidate_spacing(zone, first, second, pressed)
        pads = sorted((one for one in pressed if one.weld < 0 and one.radius), key=lambda one: one.radius)
        under = zone.spacing_factor * PAD
        finer = [(one, min(spacing, under * max(one.radius, one.backed_radius))) for one in pads]
        return find_candidates(bodies, spacing, anchors, pressed, finer)
    area = bodies.sample().area.sum()
    count = len(zone.points or ()) or zone.pairs
    cloud = bodies.sample(np.sqrt(area / count) / FINE)
    cloud = cloud.take(ranked_by_distance(cloud.point, anchors, tie))  # ties now go to the first point
    if count > len(cloud.area):
        raise ValueError(f"{count} pairs do not fit into {area:.3g} mm² of facing sheets; state fewer pairs")
    face = sheet_sides(cloud, sampled.surface, np.sqrt(area / count))
    if zone.points:
        number, centres = _stated_centres(zone, cloud, face, np.sqrt(area / count), tie)
    else:
        number, centres = _distributed_centres(cloud, face, count, tie)
    pairs: list = [None] * count
    for side in np.unique(face):
        points, chosen = np.flatnonzero(face == side), np.flatnonzero(number == side)
        if not len(chosen):
            continue
        cell = nearest_centre(centres[chosen], cloud.point[points], tie)
        cell_of_centre = _cells_of_centres(centres[chosen], cell)
        sharers = np.bincount(cell_of_centre, minlength=len(chosen))
        for i, k in zip(chosen, cell_of_centre):
            member = cloud.take(points[cell == k])
            reading = tributary_or_disc(bodies, member, centres[i], tie)
            pairs[i] = bodies.pair(reading, member.area.sum() / sharers[k])
    set_tangents(pairs)
    return pairs


def _stated_centres(zone, cloud, face, farthest, tie):
    """Sheet side of each point that a zone states, and the points.

    If a sheet faces the other body on both its sides, it is the side on which the point lies.
    """
    centres = np.array(zone.points)
    many = min(2, len(cloud.area))
    away, near = (table.reshape(len(centres), many) for table in cKDTree(cloud.point).query(centres, many))
    lost = np.flatnonzero(away[:, 0] > farthest + tie)
    if len(lost):
        raise ValueError(f"points[{lost[0]}] lies where the parts do not face each other; move it, or raise max_gap")
    ahead = np.einsum("ikj,ikj->ik", centres[:, None] - cloud.point[near], cloud.normal[near])
    ahead[away > away[:, :1] + tie] = -np.inf
    return face[near[np.arange(len(near)), ahead.argmax(1)]], centres


def _cells_of_centres(centres, cell):
    """(k,) the centre whose cell each centre uses; centres that use one cell share its area.

    It is the centre itself, or the nearest one with a cell if no sampling point is nearest to it.
    """
    cell_of_centre, used = np.arange(len(centres)), np.unique(cell)
    without = np.setdiff1d(cell_of_centre, used)
    if len(without):
        cell_of_centre[without] = used[cKDTree(centres[used]).query(centres[without])[1]]
    return cell_of_centre


def _distributed_centres(cloud, face, count, tie):
    """`count` centres distributed over the sheet sides by area: the side of each, and the centres.

    Raises
    ------
    ValueError
        If there are more sides than centres.
    """
    area = np.bincount(face, cloud.area)
    if count < len(area):
        raise ValueError(f"{count} pairs are too few for {len(area)} facing sides of a sheet; state more pairs")
    share = np.maximum(1, np.floor(count * area / area.sum() + EQUAL)).astype(int)
    while share.sum() != count:
        step = int(np.sign(count - share.sum()))
        deficit = step * (count * area / area.sum() - share) - np.where(share + step < 1, np.inf, 0.0)
        share[first_maximum(deficit, EQUAL)] += step
    none, centres = np.zeros((0, 3)), []
    for side, number in enumerate(share):
        here = face == side
        centres.append(cell_centres(cloud.point[here], cloud.area[here], number, tie, none))
    return np.repeat(np.arange(len(area)), share), np.vstack(centres)


def find_between(
    zone, first: Side, second: Side, pairs: Sequence[ContactPair], landmarks=(), pressed: Sequence[PressedPoint] = ()
) -> list[ContactPair]:
    """Check points of a zone, as many as it has pairs, as far as possible from the pairs and from each other.

    They are pairs whose patches are points. They carry no force: the model measures there the penetration between
    pairs.
    """
    bodies = Bodies.of(zone, first, second)
    sampled, tie = bodies.sampled, bodies.tie
    spacing = np.sqrt(sum(pair.area for pair in pairs) / len(pairs))
    cloud = bodies.sample(spacing / FINE)
    anchors = bodies.anchors(landmarks)
    cloud = cloud.take(ranked_by_distance(cloud.point, anchors, tie))
    side = int(bodies.swapped)
    centres = [
        patch.weight @ sampled.surface.at(patch.triangle, patch.barycentric)
        for patch in (pair.patches[side] for pair in pairs)
    ]
    face = sheet_sides(cloud, sampled.surface, spacing)
    normals = np.array([-pair.frame[:, 0] if bodies.swapped else pair.frame[:, 0] for pair in pairs])
    of_pair = side_of_points(np.array(centres), normals, cloud, face, spacing)
    chosen = []
    for number in np.unique(face):
        points, here = np.flatnonzero(face == number), of_pair == number
        nearest = cKDTree(np.array(centres)[here]).query(cloud.point[points])[0]
        chosen.extend(points[farthest_points(cloud.point[points], nearest, min(here.sum(), len(points)), tie)])
    fused = weld_numbers(pressed, cloud, tie)
    between = [replace(bodies.pair(cloud.take([i]), cloud.area[i]), nugget=int(fused[i])) for i in chosen]
    set_tangents(between)
    return between


def pair_at(point, radius: float, first: Side, second: Side) -> ContactPair:
    """The pair at a given point, over a disc of the first surface, such as a weld's nugget.

    Where a body stands on the other by its free edge, it is that over the edge (:mod:`.standing_edges`).

    Parameters
    ----------
    point : (3,) array
        mm; projected onto the first surface.
    radius : float
        mm.
    first, second : Side

    Raises
    ------
    ValueError
        If no part of the disc faces the second surface.
    """
    disc = first.surface.patch(point, radius)
    reach = float(second.surface.project(point).distance[0] + first.surface.project(point).distance[0]) + radius
    bodies = Bodies(None, first, second, False, reach, np.pi / 3)
    reading = bodies.project(disc.triangle, disc.barycentric, disc.weight, both=False)
    if not len(reading.area):
        standing = standing_pair(point, radius, first, second)
        if standing is None:
            raise ValueError("the two parts do not face each other there")
        return standing
    pair = bodies.pair(reading, np.pi * radius**2)
    set_tangents([pair])
    return pair
