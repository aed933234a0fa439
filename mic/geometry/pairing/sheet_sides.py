"""Sides of sheets: a sheet in a hem or slot faces the other body on both its sides."""

from __future__ import annotations

import numpy as np
from scipy.spatial import cKDTree

from mic.geometry.pairing.facing_points import OPPOSITE
from mic.geometry.surface import EQUAL
from mic.geometry.triangles import linked_rows

__all__ = ["distance_same_side", "sheet_sides", "side_of_points"]


def sheet_sides(cloud, surface, spacing) -> np.ndarray:
    """(n,) number of the sheet side that each point belongs to, from 0.

    Points near each other whose normals are opposite lie on different sides; connected points lie on one. Triangle
    sides are connected if they share a vertex. A closed surface is divided by the axis along which most of its normals
    lie.
    """
    ahead = np.einsum("ij,ij->i", cloud.normal, surface.normals[cloud.triangle]) > 0
    side, of = np.unique(2 * cloud.triangle + ahead, return_inverse=True)
    of, first = of.ravel(), np.full(len(side), len(cloud.area))
    np.minimum.at(first, of, np.arange(len(of)))
    normal = surface.normals[side // 2] * np.where(side % 2, 1.0, -1.0)[:, None]
    reach = 2 * (spacing + surface.reach[side // 2].max())
    place = surface.corners[side // 2].mean(1) / reach
    many = min(8, len(side))
    away, against = (
        table.reshape(len(side), many)
        for table in cKDTree(np.hstack([place, normal])).query(
            np.hstack([place, -normal]), many, distance_upper_bound=1.0
        )
    )
    own, turn = np.nonzero(np.isfinite(away))
    if not len(own):
        return np.zeros(len(of), dtype=np.int64)
    against = against[own, turn]
    piece = _connected_sides(side, surface)
    for one in np.unique(piece[own][piece[own] == piece[against]]):
        about = np.flatnonzero(piece == one)
        n = normal[about]
        axis = np.linalg.eigh((n * surface.areas[side[about] // 2, None]).T @ n)[1][:, -1]
        along = (n @ axis) * np.sign(n[first[about].argmin()] @ axis)
        piece[about[along < -EQUAL]] = piece.max() + 1
    face = np.full(piece.max() + 1, -1)
    for one in piece[np.argsort(first)]:
        if face[one] < 0:
            taken = face[np.concatenate([piece[against[piece[own] == one]], piece[own[piece[against] == one]]])]
            face[one] = np.setdiff1d(np.arange(len(taken) + 1), taken)[0]
    return face[piece][of]


def _connected_sides(side, surface) -> np.ndarray:
    """(s,) number of the connected piece of each triangle side: sides that share a vertex are connected."""
    vertex = 2 * surface.triangles[side // 2] + (side % 2)[:, None]
    return linked_rows(vertex)[1]


def side_of_points(point, normal, cloud, face, spacing) -> np.ndarray:
    """(k,) sheet side of further points: that of the nearest point of `cloud` with a similar normal."""
    if not face.any() or not len(point):
        return np.zeros(len(point), dtype=np.int64)
    tree = cKDTree(np.hstack([cloud.point / (2 * spacing), cloud.normal]))
    return face[tree.query(np.hstack([point / (2 * spacing), normal]))[1]]


def distance_same_side(point, normal, among, looking):
    """(n,) distance of each point to the nearest of others whose normal is not opposite, mm."""
    many = min(8, len(among))
    away, nearest = (table.reshape(len(point), many) for table in cKDTree(among).query(point, many))
    opposite = np.einsum("ij,ikj->ik", normal, looking[nearest]) < OPPOSITE
    return np.where(opposite, np.inf, away).min(1)
