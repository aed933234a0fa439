"""A sheet that stands on another one by its free edge, as in a T joint: where, and the pair at a weld along it."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from mic.geometry.pairing.contact_pair import ContactPair, Side, set_tangents
from mic.geometry.surface import Patch, Surface

__all__ = ["STEEP", "EdgePoints", "standing_edge", "standing_pair"]

STEEP = 0.5  # cosine of the angle between the normals of two sheets: below it one stands on the other
SAMPLES = 8  # points of an edge across a weld


@dataclass(frozen=True)
class EdgePoints:
    """Points of the free edges of a sheet, and whether they stand on another sheet.

    Attributes
    ----------
    triangle, barycentric, length : (n,), (n, 3) and (n,) array
        Points of the standing sheet, and the length of edge, mm, that each represents.
    point : (n, 3) array
        mm.
    foot_triangle, foot_barycentric : (n,) and (n, 3) array
        Closest point on the other sheet.
    height : (n,) array
        Above the other sheet's drawn surface, on the side of the standing sheet, mm.
    side : (n,) array
        +1 if the standing sheet is on the side of the other sheet's normals, else −1.
    standing : (n,) bool array
    """

    triangle: np.ndarray
    barycentric: np.ndarray
    length: np.ndarray
    point: np.ndarray
    foot_triangle: np.ndarray
    foot_barycentric: np.ndarray
    height: np.ndarray
    side: np.ndarray
    standing: np.ndarray


def standing_edge(edge: Surface, sheet: Surface, spacing: float, reach: float, near=None) -> EdgePoints:
    """The points of one surface's free edges, with those that stand on another surface within reach.

    Parameters
    ----------
    edge, sheet : Surface
    spacing : float
        Of the points, mm, at most.
    reach : float
        mm, from the sheet's drawn surface.
    near : tuple of (3,) array and float, optional
        Centre and radius, mm, about which edges are considered.
    """
    triangle, opposite = np.nonzero(edge.border)
    if near is not None:
        middle = edge.points[edge.ends(triangle, opposite)].mean(axis=1)
        close = np.linalg.norm(middle - near[0], axis=1) <= near[1] + edge.edge_lengths[triangle, opposite]
        triangle, opposite = triangle[close], opposite[close]
    inward = edge.points[edge.triangles[triangle, opposite]] - edge.points[edge.ends(triangle, opposite)].mean(axis=1)
    parts = np.maximum(np.ceil(edge.edge_lengths[triangle, opposite] / spacing - 1e-9), 1).astype(int)
    triangle, barycentric, length = edge.sample_edges(triangle, opposite, spacing)
    point, inward = edge.at(triangle, barycentric), np.repeat(inward, parts, axis=0)
    foot = sheet.project(point, reach=reach)
    found = foot.triangle >= 0
    n = sheet.normals[foot.triangle]
    side = np.where(np.einsum("ij,ij->i", inward, n) >= 0, 1.0, -1.0)
    steep = np.abs(np.einsum("ij,ij->i", n, edge.normals[triangle])) < STEEP
    upright = np.abs(np.einsum("ij,ij->i", inward, n)) > STEEP * np.linalg.norm(inward, axis=1)
    step = np.where(found[:, None], point - foot.point, 0.0)
    height = side * np.einsum("ij,ij->i", step, n)
    standing = found & steep & upright & ~foot.at_border & (foot.distance <= reach)
    return EdgePoints(triangle, barycentric, length, point, foot.triangle, foot.barycentric, height, side, standing)


def standing_pair(point, radius: float, first: Side, second: Side) -> ContactPair | None:
    """The pair at a weld by which one body stands on the other; None if neither does there.

    It covers the edge within the radius; both bodies are read at the points of the edge.

    Parameters
    ----------
    point : (3,) array
        mm.
    radius : float
        mm.
    first, second : Side
    """
    centre = np.asarray(point, dtype=float)
    for swapped, sheet, stands in ((False, first, second), (True, second, first)):
        distance = float(stands.surface.project(centre).distance[0] + sheet.surface.project(centre).distance[0])
        spacing = max(radius, 1e-3 * stands.surface.diameter) * 2 / SAMPLES
        at = standing_edge(stands.surface, sheet.surface, spacing, distance + radius, (centre, distance + radius))
        if not at.standing.any():
            continue
        away = np.where(at.standing, np.linalg.norm(at.point - centre, axis=1), np.inf)
        nearest = int(np.argmin(away))
        if away[nearest] > distance + radius:
            continue
        step = np.linalg.norm(at.point - at.point[nearest], axis=1)
        chosen = np.flatnonzero(at.standing & (step <= radius) & (at.side == at.side[nearest]))
        weight = at.length[chosen] / at.length[chosen].sum()
        n = weight @ (at.side[chosen, None] * sheet.surface.normals[at.foot_triangle[chosen]])
        n /= np.linalg.norm(n)
        height = float(weight @ at.height[chosen])
        foot = Patch(at.foot_triangle[chosen], at.foot_barycentric[chosen], weight)
        edge = Patch(at.triangle[chosen], at.barycentric[chosen], weight)
        side, half = int(at.side[nearest]), sheet.half_thickness
        offsets = (side * height / half if half else 0.0, 0.0)
        patches, sides = (foot, edge), (side, 0)
        if swapped:
            n, patches, sides, offsets = -n, patches[::-1], sides[::-1], offsets[::-1]
        centre = weight @ (first.surface.at(patches[0].triangle, patches[0].barycentric))
        frame = np.column_stack([n, np.zeros((3, 2))])
        area, gap = float(at.length[chosen].sum() * 2 * stands.half_thickness), max(0.0, height - half)
        pair = ContactPair(centre, frame, gap, 0.0, 0.0, area, patches, sides, offsets=offsets)
        set_tangents([pair])
        return pair
    return None
