"""Candidate contact pairs of a zone: spacing and positions. :mod:`mic.geometry.pairing` gives the rules."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
from scipy.spatial import cKDTree

from mic.geometry.pairing.cell_centres import (
    cell_centres,
    first_maximum,
    nearest_centre,
    ranked_by_distance,
    well_separated,
)
from mic.geometry.pairing.contact_pair import ContactPair, PressedPoint, Side, set_tangents, weld_numbers
from mic.geometry.pairing.edge_points import corner_points, edge_points
from mic.geometry.pairing.facing_points import FINE, Bodies
from mic.geometry.pairing.sheet_sides import sheet_sides, side_of_points
from mic.geometry.surface import EQUAL

__all__ = ["candidate_spacing", "find_candidates", "tributary_or_disc"]

ACROSS = 4.0  # thicknesses between two candidates: a sheet hardly bends over this distance
UNDER = 1.5  # radii of the smallest clamp between two candidates
PAD = 2 / 3  # radii of a clamp between two candidates under it: one in the middle, six about it
BENDS = 1.3  # √(R t) between two candidates on bends
FACET = 0.85  # element sizes between two candidates on bends, so that each facet is read
TIGHT = 0.05  # share of a zone's area: smaller bends do not decide the spacing
RESOLVED = 0.4  # element sizes: closer cells read the same few degrees of freedom
NEAR = 0.005  # of the thinner sheet: a gap that exceeds the smallest one of its cell by this is not read


def candidate_spacing(zone, first: Side, second: Side, pressed: Sequence[PressedPoint] = ()) -> float:
    """Distance between the candidates of a zone, mm.

    It is the spacing that the zone states, or the one that elements, sheets and clamps require, times `spacing_factor`.

    Parameters
    ----------
    zone, first, second, pressed
        As for `find_pairs`.

    Raises
    ------
    ValueError
        If the zone is empty, or its spacing is finer than the elements resolve.
    """
    bodies = Bodies.of(zone, first, second)
    cloud = bodies.sample()
    surfaces = [(bodies.sampled, cloud.triangle)] + [(bodies.other, cloud.other_triangle)] * (not bodies.other.rigid)
    element = max(float(np.median(body.surface.edge_lengths[np.unique(own)])) for body, own in surfaces)
    spacing = zone.spacing
    if spacing is None:
        thinner = bodies.thinner
        radii = [place.radius for place in pressed if place.radius and place.weld < 0 and not place.backed_radius]
        flat = max(element, min(ACROSS * thinner, UNDER * min(radii, default=np.inf)))
        radius = min(_bend_radius(body.surface, own, cloud.area) for body, own in surfaces)
        spacing = min(flat, max(FACET * element, BENDS * np.sqrt(radius * thinner)))
    scaled = zone.spacing_factor * spacing
    if scaled < RESOLVED * element:
        times = f" times spacing_factor = {zone.spacing_factor:g}" if zone.spacing_factor != 1 else ""
        raise ValueError(
            f"spacing = {spacing:g} mm{times} between candidates is finer than the elements there "
            f"({element:.2g} mm), which cannot distinguish such neighbours: refine the mesh, or state "
            f"{RESOLVED * element:.2g} mm or more"
        )
    return scaled


def _bend_radius(surface, triangle, area) -> float:
    """Radius of the tightest bends, mm: a share `TIGHT` of the area is bent at least as much; infinite if less is bent.

    The curvature along an edge L between corners whose normals differ by Δn is |Δn|/L.
    """
    normal, corner = surface.corner_normals[triangle], surface.corners[triangle]
    turned = np.linalg.norm(normal - normal[:, [1, 2, 0]], axis=2)
    bent = (turned / np.linalg.norm(corner - corner[:, [1, 2, 0]], axis=2)).max(1)
    order = np.argsort(-bent)
    tightest = bent[order][np.searchsorted(np.cumsum(area[order]), TIGHT * area.sum())]
    return 1 / tightest if tightest > EQUAL else np.inf


def find_candidates(bodies, spacing, anchors, pressed, pads) -> list[ContactPair]:
    """Candidates along the edges of both sheets, at pressed points, and over the remaining area.

    `pads` holds clamps and the rests beneath them, smallest first, each with the spacing of candidates under it.
    """
    tie = bodies.tie
    cloud = bodies.sample(spacing / FINE, pads)
    cloud = cloud.take(ranked_by_distance(cloud.point, anchors, tie))
    face = sheet_sides(cloud, bodies.sampled.surface, spacing)
    lines = []
    for points in (edge_points(bodies, spacing, anchors), corner_points(bodies, spacing, anchors)):
        points = points.take(np.flatnonzero(weld_numbers(pressed, points, tie) < 0))
        points = points.take(ranked_by_distance(points.point, anchors, tie))
        lines.append((points, side_of_points(points.point, points.normal, cloud, face, spacing)))
    pairs = []
    for number in np.unique(face):
        edge, corner = (points.take(np.flatnonzero(side == number)) for points, side in lines)
        area = cloud.take(np.flatnonzero(face == number))
        pairs += _candidates_of_side(bodies, spacing, area, edge, corner, pressed, pads)
    set_tangents(pairs)
    return pairs


def _candidates_of_side(bodies, spacing, cloud, edge, corner, pressed, pads) -> list[ContactPair]:
    """Candidates of one side of the sheet; their tangents are not set."""
    tie = bodies.tie
    fused = weld_numbers(pressed, cloud, tie)
    corner = corner.take(well_separated(corner.point, corner.area, spacing / 2 + tie))
    corner = replace(corner, area=np.ones(len(corner.area)))
    length, ends = edge.area.sum(), corner.point
    if len(edge.area):
        count = max(1, len(ends), int(length / spacing + 0.5 + EQUAL))
        ends = cell_centres(edge.point, edge.area, count, tie, ends)
    along = nearest_centre(ends, edge.point, tie) if len(ends) else np.zeros(0, dtype=np.int64)
    under = _pressed_centres(pressed, cloud, spacing, tie)
    group = _disc_numbers(pads, cloud, fused, tie)
    pairs = []
    for number in np.unique(group):
        member = np.flatnonzero(group == number)
        nugget, free = fused[member[0]], number < 0
        pad = number - fused.max(initial=-1) - 1
        apart = pads[pad][1] if pad >= 0 else spacing
        whole = cloud.take(member)
        fixed = under[cKDTree(whole.point).query(under)[0] <= tie]
        area = whole.area.sum()
        if free and len(ends):
            fixed = fixed[cKDTree(ends).query(fixed)[0] > spacing / 4 + tie]
            area -= spacing * length / 2
            fixed = np.vstack([ends, fixed])
        rest = area / apart**2 - (len(fixed) - (len(ends) if free else 0))
        count = min(max(1, len(fixed) + max(0, int(rest + 0.5 + EQUAL))), len(whole.area))
        centres = cell_centres(whole.point, whole.area, count, tie, fixed)
        cell = nearest_centre(centres, whole.point, tie)
        for k, centre in enumerate(centres):
            member = whole.take(np.flatnonzero(cell == k))
            if not len(member.area):
                continue
            if free and k < len(corner.area) and bodies.zone.patch == "tributary":
                reading = corner.take([k])
            elif free and k < len(ends) and bodies.zone.patch == "tributary":
                reading = edge.take(np.flatnonzero(along == k))
            else:
                reading = tributary_or_disc(bodies, member, centre, tie)
            cut = bodies.pair(member, member.area.sum())
            pair = bodies.pair(_nearest_part(reading, bodies), cut.area)
            pairs.append(
                replace(pair, overlap=cut.overlap, overlapping=cut.overlapping, nugget=int(nugget), spacing=apart)
            )
    return pairs


def _pressed_centres(pressed, cloud, spacing, tie) -> np.ndarray:
    """(k, 3) points of the zone at pressed points, at least half a spacing from each other."""
    centres: list[np.ndarray] = []
    for place in pressed:
        step = cloud.point - place.point
        sideways = np.linalg.norm(step - np.einsum("ij,ij->i", step, cloud.normal)[:, None] * cloud.normal, axis=1)
        sideways[np.linalg.norm(step, axis=1) > 2 * cloud.distance + spacing + tie] = np.inf
        at = first_maximum(-sideways, tie)
        if sideways[at] > spacing / 4 + tie:
            continue
        if all(np.linalg.norm(cloud.point[at] - centre) > spacing / 2 + tie for centre in centres):
            centres.append(cloud.point[at])
    return np.array(centres).reshape(-1, 3)


def _disc_numbers(pads, cloud, fused, tie) -> np.ndarray:
    """(n,) number of the disc that contains each point; -1 for none. No candidate reads across the rim of a disc.

    Nuggets take precedence, then smaller pads. A pad of which less than half a cell remains is ignored.
    """
    group, welds = fused.copy(), fused.max(initial=-1) + 1
    for i, (pad, spacing) in enumerate(pads):
        left = pad.covers(cloud, tie) & (group < 0)
        if cloud.area[left].sum() >= spacing**2 / 2:
            group[left] = welds + i
    return group


def tributary_or_disc(bodies, own, centre, tie):
    """Points at which a pair reads the bodies: its cell, or the disc that the zone states."""
    if bodies.zone.patch == "tributary":
        return own
    nearest = first_maximum(-np.linalg.norm(own.point - centre, axis=1), tie)
    seed = centre if bodies.zone.points else own.point[nearest]
    disc = bodies.sampled.surface.patch(seed, float(bodies.zone.patch), own.normal.mean(0))
    reading = bodies.project(disc.triangle, disc.barycentric, disc.weight)
    reading = reading.take(np.flatnonzero(reading.normal @ own.normal.mean(0) > 0))
    return reading if len(reading.area) else own.take([nearest])


def _nearest_part(cloud, bodies):
    """The cell with weights that decrease with the gap; overlapping points have full weight."""
    apart = np.maximum(bodies.gap(cloud), 0.0)
    share = np.maximum(1 - (apart - apart.min()) / (NEAR * bodies.thinner), 0.0)
    return replace(cloud, area=share * cloud.area)
