"""Points on edges, folds, rims, corners and crossings of two bodies, where thin sheets press most."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from scipy.spatial import cKDTree

from mic.geometry.pairing.facing_points import FINE, OPPOSITE, FacingPoints
from mic.geometry.pairing.sheet_sides import distance_same_side
from mic.geometry.surface import EQUAL
from mic.geometry.triangles import edge_barycentric, listed, unit

__all__ = ["corner_points", "edge_points"]

FOLD = 10.0  # degrees between triangles: a larger angle is a fold
CORNER = 30.0  # degrees: a border that turns by more has a corner


def edge_points(bodies, spacing, anchors):
    """Points of both bodies' edges that face the other body, as points of the sampled one; `area` is a length, mm.

    Coincident edges count once. A point on a fold appears once for each of the two triangles.
    """

    def along(body):
        if body.disc is not None:
            return _pad_rim(body, spacing / FINE, anchors)
        return body.surface.sample_edges(*body.surface.edges(np.radians(FOLD)), spacing / FINE)

    def shared(cloud, tie):
        one, two = cKDTree(cloud.point).query_pairs(tie, output_type="ndarray").T
        same = np.einsum("ij,ij->i", cloud.normal[one], cloud.normal[two]) > OPPOSITE
        met = np.concatenate([one[same], two[same]])
        return replace(cloud, area=cloud.area / (1 + np.bincount(met, minlength=len(cloud.area))))

    return _points_on_both(bodies, along, shared, spacing / 4)


def _pad_rim(body, spacing, anchors):
    """Points of a round pad's rim at most `spacing` apart: triangle, barycentric, length.

    They are symmetric about the direction to the first anchor that is not on the pad's axis.
    """
    (centre, radius), normal = body.disc, body.surface.normals[0]
    steps = np.array(anchors) - centre
    steps -= np.outer(steps @ normal, normal)
    aside = np.linalg.norm(steps, axis=1)
    if not (aside > body.surface.tie).any():
        steps, aside = np.cross(normal, np.eye(3)), np.ones(3)
    t = steps[np.argmax(aside > body.surface.tie)]
    t = t / np.linalg.norm(t)
    count = int(np.ceil(2 * np.pi * radius / spacing - EQUAL))
    angle = 2 * np.pi * (np.arange(count) + 0.5)[:, None] / count
    point = centre + radius * (np.cos(angle) * t + np.sin(angle) * np.cross(normal, t))
    foot = body.surface.project(point)
    return foot.triangle, foot.barycentric, np.full(count, 2 * np.pi * radius / count)


def corner_points(bodies, spacing, anchors):
    """Corners of both bodies' borders that face the other body, and crossings of their edges; `area` is a rank.

    They are points of the sampled body. Where an edge presses, it presses at its end first, and the middle of a length
    read around a corner lies off the corner.
    """
    own = _points_on_both(bodies, _border_corners, lambda cloud, tie: cloud, spacing / 4)
    return FacingPoints.joined([own, _edge_crossings(bodies, spacing, anchors)])


def _edge_crossings(bodies, spacing, anchors):
    """Points where edges of the two bodies cross, with their rank: the overlap of the bodies has a corner there."""
    surface, other = bodies.sampled.surface, bodies.other.surface
    triangle, opposite = surface.edges(np.radians(FOLD))
    start, end = surface.points[surface.ends(triangle, opposite).T]
    if bodies.other.disc is None:
        edges = other.edges(np.radians(FOLD))
        (first, last), border = other.points[other.ends(*edges).T], other.border[edges]
    else:
        first = other.at(*_pad_rim(bodies.other, spacing / FINE, anchors)[:2])
        last, border = np.roll(first, -1, axis=0), np.ones(len(first), dtype=bool)
    reach = bodies.reach + bodies.tie
    half = np.linalg.norm(last - first, axis=1) / 2
    longest = np.linalg.norm(end - start, axis=1).max(initial=0.0) / 2
    near = cKDTree((start + end) / 2).query_ball_point((first + last) / 2, half + longest + reach) if len(start) else []
    k, i = listed(near)
    u, v, w = end[i] - start[i], last[k] - first[k], start[i] - first[k]
    uu, uv, vv, uw, vw = (np.einsum("ij,ij->i", *two) for two in ((u, u), (u, v), (v, v), (u, w), (v, w)))
    turns = uu * vv - uv**2 > np.sin(np.radians(CORNER)) ** 2 * uu * vv
    i, k, u, v, w, uu, uv, vv, uw, vw = (one[turns] for one in (i, k, u, v, w, uu, uv, vv, uw, vw))
    along, ahead = np.array([uv * vw - vv * uw, uu * vw - uv * uw]) / (uu * vv - uv**2)
    inside = [np.abs(at - 0.5) <= 0.5 + bodies.tie / np.sqrt(length) for at, length in ((along, uu), (ahead, vv))]
    apart = np.linalg.norm(w + along[:, None] * u - ahead[:, None] * v, axis=1)
    use = np.flatnonzero(inside[0] & inside[1] & (apart <= reach))
    at, own = np.clip(along[use], 0.0, 1.0), i[use]
    rank = 1.0 + (surface.border[triangle[own], opposite[own]] & border[k[use]])
    cloud = bodies.project(triangle[own], edge_barycentric(opposite[own], at), rank)
    cloud = replace(cloud, normal=-cloud.seen_from(bodies.other).normal)
    return cloud.take(bodies.in_region(cloud.point, surface.tie))


def _border_corners(body):
    """Corners of a surface's border in each of their triangles: triangle, barycentric, and rank.

    The rank is 2 where the border turns, 1 where a fold ends on it.
    """
    surface = body.surface
    ends = np.unique(np.sort(surface.ends(*surface.edges(np.radians(FOLD))), axis=1), axis=0)
    away = unit(surface.points[ends[:, 1]] - surface.points[ends[:, 0]])
    total = np.zeros_like(surface.points)  # sum of unit edge vectors: length 2 sin(φ/2) for two edges at an angle φ
    np.add.at(total, ends[:, 0], away)
    np.add.at(total, ends[:, 1], -away)
    count = np.bincount(ends.ravel(), minlength=len(surface.points))
    turns = (count == 2) & (np.linalg.norm(total, axis=1) > 2 * np.sin(np.radians(CORNER) / 2) + EQUAL)
    rank = np.where(surface.border_vertices, 2.0 * turns + (count > 2), 0.0)[surface.triangles.ravel()]
    use = np.flatnonzero(rank)
    return use // 3, np.eye(3)[use % 3], rank[use]


def _points_on_both(bodies, points_of, reweight, near):
    """Points that `points_of` returns for each body and that face the other body, as points of the sampled one.

    Points of the second body that are nearer than `near` to one of the first are left out.
    """
    found = []
    for pair in (bodies, bodies.reversed()):
        body, opposite = pair.sampled, pair.other
        cloud = pair.project(*points_of(body))
        if len(cloud.area):
            cloud = reweight(cloud, body.surface.tie)
        seen = cloud.seen_from(opposite)
        if body is bodies.sampled:
            cloud = replace(cloud, normal=-seen.normal)  # an edge presses along the other body's normal
        else:
            cloud = seen
            if len(found[0].area):
                away = distance_same_side(cloud.point, cloud.normal, found[0].point, found[0].normal)
                cloud = cloud.take(away > near + bodies.sampled.surface.tie)
        found.append(cloud.take(bodies.in_region(cloud.point, bodies.sampled.surface.tie)))
    return FacingPoints.joined(found)
