"""Clustering of points into cells of about equal size, with ties broken independently of rounding."""

from __future__ import annotations

import numpy as np
from scipy.spatial import cKDTree

__all__ = ["cell_centres", "farthest_points", "first_maximum", "nearest_centre", "ranked_by_distance", "well_separated"]


def ranked_by_distance(point, anchors, tie):
    """(n,) order of points by distance from the first anchor, ties by distance from the second, and so on."""
    keys = []
    for anchor in anchors:
        distance = np.linalg.norm(point - anchor, axis=1)
        order = np.argsort(distance)
        rank = np.empty(len(point), dtype=np.int64)
        rank[order] = np.concatenate([[0], np.cumsum(np.diff(distance[order]) > tie)])
        keys.append(rank)
        order = np.lexsort(keys[::-1])
        if (np.diff(np.array(keys)[:, order]) != 0).any(axis=0).all():  # the order is unique
            break
    return order


def first_maximum(value, tie):
    """Index of the greatest value; the first of those within `tie` of it."""
    return int(np.argmax(value >= np.max(value) - tie))


def farthest_points(point, nearest, count, tie):
    """(count,) points, each the farthest from those before it and from the points that exist already.

    `nearest` (n,) holds the distance of each point to the existing ones, mm. Choosing a point can only reduce the
    distances within a ball around it whose radius is its own distance.
    """
    tree, nearest, chosen = cKDTree(point), nearest.copy(), np.empty(max(count, 0), dtype=np.int64)
    for k in range(len(chosen)):
        chosen[k] = one = first_maximum(nearest, tie)
        near = tree.query_ball_point(point[one], nearest[one] + 3 * tie)
        nearest[near] = np.minimum(nearest[near], np.linalg.norm(point[near] - point[one], axis=1))
    return chosen


def well_separated(point, rank, apart) -> np.ndarray:
    """Indices of points that are more than `apart` from each other, chosen in order of decreasing rank."""
    chosen: list[int] = []
    for i in np.argsort(-rank, kind="stable"):
        if not chosen or np.linalg.norm(point[chosen] - point[i], axis=1).min() > apart:
            chosen.append(int(i))
    return np.array(chosen, dtype=np.int64)


def nearest_centre(centres, point, tie):
    """(n,) the centre nearest to each point; the first of those within `tie`."""
    return _nearest_and_bound(centres, point, tie)[0]


def _nearest_and_bound(centres, point, tie):
    """`nearest_centre`, and a lower bound (n,) of the distance to the second nearest centre, mm."""
    tree, few = cKDTree(centres), min(len(centres), 2)
    distance, index = (table.reshape(len(point), few) for table in tree.query(point, few))
    nearest, beyond = index[:, 0], distance[:, 1] if few > 1 else np.full(len(point), np.inf)
    tied = np.flatnonzero(beyond <= distance[:, 0] + tie)
    if len(tied):
        count = min(len(centres), 8)
        distance, index = (table.reshape(len(tied), count) for table in tree.query(point[tied], count))
        nearest[tied] = np.where(distance <= distance[:, :1] + tie, index, len(centres)).min(1)
    return nearest, beyond


class _Assignment:
    """Nearest centre of each point while centres move; recomputed only where another may have become nearest."""

    def __init__(self, centres, point, tie):
        self._point, self._tie, self._centres = point, tie, centres
        self.of, self._beyond = _nearest_and_bound(centres, point, tie)

    def move(self, centres) -> None:
        """Update the assignment for moved centres."""
        self._beyond -= np.linalg.norm(centres - self._centres, axis=1).max()
        away = np.linalg.norm(self._point - centres[self.of], axis=1)
        stale = np.flatnonzero(away + 2 * self._tie >= self._beyond)
        self.of[stale], self._beyond[stale] = _nearest_and_bound(centres, self._point[stale], self._tie)
        self._centres = centres


def cell_centres(point, weight, count, tie, fixed):
    """Centres of `count` cells of about equal size, the `fixed` (k, 3) among them.

    Farthest-point initialisation, then Lloyd's iteration.
    """
    if len(fixed):
        centres = [*fixed]
    else:
        middle = np.average(point, axis=0, weights=weight)
        centres = [point[first_maximum(np.linalg.norm(point - middle, axis=1), tie)]]
    nearest = cKDTree(np.array(centres)).query(point)[0]
    centres = np.array([*centres, *point[farthest_points(point, nearest, count - len(centres), tie)]])
    cells = _Assignment(centres, point, tie)
    for _ in range(50):
        cell = cells.of
        total = np.bincount(cell, weight, count)
        empty = total == 0  # it coincides with other centres
        total[empty] = 1.0
        moved = np.column_stack([np.bincount(cell, weight * point[:, i], count) for i in range(3)]) / total[:, None]
        moved[empty] = centres[empty]
        moved[: len(fixed)] = fixed
        if np.linalg.norm(moved - centres, axis=1).max() < tie:
            break
        centres = moved
        cells.move(centres)
    return centres
