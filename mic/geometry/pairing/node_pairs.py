"""Contact pairs at the vertices of the meshes."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
from scipy.spatial import cKDTree

from mic.geometry.pairing.contact_pair import ContactPair, PressedPoint, Side, set_tangents, weld_numbers
from mic.geometry.pairing.edge_points import FOLD
from mic.geometry.pairing.facing_points import OPPOSITE, Bodies, FacingPoints

__all__ = ["node_pairs"]


def node_pairs(zone, first: Side, second: Side, pressed: Sequence[PressedPoint] = ()) -> list[ContactPair]:
    """A pair at every vertex of either surface that lies in the zone and faces the other body; its patches are points.

    Vertices of one surface alone would miss the border of the other. A rigid fixture contributes none. The zone's
    number, spacing or points are ignored. A vertex has a third of the area around it, half of that where both bodies
    are deformable, and the normal of its sheet; on a fold it has one pair for each sheet that faces the other body.
    Coincident vertices of the two bodies form one pair.

    Raises
    ------
    ValueError
        If the zone is empty.
    """
    bodies = Bodies.of(zone, first, second)
    tie = bodies.tie
    cloud = _facing_vertices(bodies)
    if not bodies.other.rigid:
        back = _facing_vertices(bodies.reversed()).seen_from(bodies.sampled)
        if len(cloud.area):
            same = _coincident_points(back, cloud, tie)
            np.add.at(cloud.area, same[same >= 0], back.area[same >= 0])
            back = back.take(np.flatnonzero(same < 0))
        cloud = FacingPoints.joined([cloud, back])
        cloud = replace(cloud, area=cloud.area / 2)
    cloud = cloud.take(np.flatnonzero(bodies.in_region(cloud.point, bodies.sampled.surface.tie)))
    if not len(cloud.area):
        raise ValueError("no vertex faces the other surface there; refine the mesh, move the region, or raise max_gap")
    fused = weld_numbers(pressed, cloud, tie)
    pairs = [replace(bodies.pair(cloud.take([i]), cloud.area[i]), nugget=int(fused[i])) for i in range(len(cloud.area))]
    set_tangents(pairs)
    return pairs


def _coincident_points(cloud, other, tie):
    """(n,) index of the coincident point of another set on the same side of the sheet; -1 for none."""
    many = min(2, len(other.area))
    away, nearest = (table.reshape(len(cloud.area), many) for table in cKDTree(other.point).query(cloud.point, many))
    alike = np.einsum("ij,ikj->ik", cloud.normal, other.normal[nearest]) > OPPOSITE
    upon = (away <= tie) & alike
    return np.where(upon.any(1), nearest[np.arange(len(nearest)), upon.argmax(1)], -1)


def _facing_vertices(bodies):
    """Vertices of one body that face the other; the area of each is a third of the triangles around it.

    A vertex on a fold is projected along the normal of each sheet that ends there, with the area of that sheet. Their
    mean would deviate by more than the angle of friction at half of a bend.
    """
    surface = bodies.sampled.surface
    vertex, normal = surface.triangles.ravel(), surface.corner_normals.reshape(-1, 3)
    alike = np.column_stack([vertex, normal.round(6)])  # those of one sheet are projected once
    _, use, of = np.unique(alike, axis=0, return_index=True, return_inverse=True)
    area = np.bincount(of.ravel(), np.repeat(surface.areas / 3, 3))
    triangle, corner = np.divmod(use, 3)
    cloud = bodies.project(triangle, np.eye(3)[corner], area, normal[use])
    return _best_facing_points(cloud, surface.triangles[cloud.triangle, cloud.barycentric.argmax(1)], bodies)


def _best_facing_points(cloud, vertex, bodies):
    """For each vertex and closest point, the projection whose normal agrees best with the joining line.

    The areas of the other projections are added to it if their normals agree with its normal.
    """
    foot, area = bodies.other.surface.at(cloud.other_triangle, cloud.other_barycentric), cloud.area.copy()
    order = np.lexsort((-cloud.distance, vertex))
    chosen: list[int] = []
    for i in order:
        for k in reversed(chosen):
            if vertex[k] != vertex[i]:
                chosen.append(i)
                break
            turn = cloud.normal[k] @ cloud.normal[i]
            if turn > OPPOSITE and np.linalg.norm(foot[k] - foot[i]) <= bodies.tie:
                area[k] += area[i] * (turn > np.cos(np.radians(FOLD)))
                break
        else:
            chosen.append(i)
    return replace(cloud, area=area).take(np.sort(np.array(chosen, dtype=np.int64)))
