"""Refinement of triangle meshes on the curved surface that their normals describe.

The edge from x_i to x_j, L = x_j − x_i, becomes the Hermite cubic whose end tangents are the projections of L onto the
surface, T = L − P L. P projects on the normals at that end: one on a smooth surface, two at a fold, whose line is then
tangent to both sheets. New vertices are the midpoints of the cubics,

    x = ½ (x_i + x_j) + ⅛ (T_i − T_j),

equal for all triangles at the edge. The normals there are the means of the ends', made normal to the tangent of the
cubic, 3/2 L − ¼ (T_i + T_j). Normals that agree within `FOLD` count as one: P then uses their mean.

The border remains a polygon in the plane of the sheet, because the mesh does not describe its curvature: holes do not
become rounder.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np

from mic.geometry.triangles import area_vectors, closest_barycentric, sides, unit

__all__ = ["Division", "divided", "halved"]

FOLD = np.radians(20.0)  # smaller angles between normals count as smooth
EDGES = ((0, 1), (1, 2), (2, 0))
FOUR = np.array([(0, 3, 5), (3, 1, 4), (5, 4, 2), (3, 4, 5)])  # children: corners 0 to 2, midpoints 3 to 5
TWO = np.array([[(0, 3, 2), (3, 1, 2)], [(1, 4, 0), (4, 2, 0)], [(2, 5, 1), (5, 0, 1)]])  # by the edge that is divided
SHIFT = 32  # bits: the key of an edge is its lower vertex, shifted, plus its higher vertex
UNSURE = 1e-9  # difference of barycentric coordinates above the rounding errors of two methods
NARROW = 0.1  # a side shorter than this share of the longest is short; half a long side then makes a flat triangle
EVEN = 1e-6  # relative difference below which sizes and distances are equal


def halved(points: np.ndarray, triangles: np.ndarray, normals: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Divide every triangle into four on the curved surface.

    Parameters
    ----------
    points : (n, 3) array
        mm.
    triangles : (k, 3) int array
    normals : (k, 3, 3) array
        Unit normal of the surface at each corner of each triangle, on the side of the triangle's own.

    Returns
    -------
    points : (n + e, 3) array
        The given ones, then one on each of the e edges.
    triangles : (4 k, 3) int array
        Oriented as their parents; triangle i becomes 4 i … 4 i + 3.
    normals : (4 k, 3, 3) array
    """
    triangles = np.asarray(triangles)
    edges, opposite, _ = sides(triangles)
    of_side = np.roll(opposite, 1, axis=1)  # in the order of `EDGES`
    L = points[edges[:, 1]] - points[edges[:, 0]]
    T = np.stack([L - _across(L, end, edges, triangles, of_side, normals) for end in (0, 1)])
    middle = points[edges].mean(axis=1) + (T[0] - T[1]) / 8

    along = unit(1.5 * L - (T[0] + T[1]) / 4)[of_side]
    mean = np.stack([normals[:, i] + normals[:, j] for i, j in EDGES], axis=1)  # (k, 3, 3), one for each side
    mean = unit(mean - (mean * along).sum(axis=2, keepdims=True) * along)

    vertex = np.concatenate([triangles, len(points) + of_side], axis=1)
    normal = np.concatenate([normals, mean], axis=1)
    return np.vstack([points, middle]), vertex[:, FOUR].reshape(-1, 3), normal[:, FOUR].reshape(-1, 3, 3)


def _across(L, end, edges, triangles, of_side, normals):
    """(e, 3) projection of the edges L (e, 3) on the span of their triangles' normals at one end."""
    total = np.zeros((len(edges), 3, 3))
    for s, corners in enumerate(EDGES):
        first = triangles[:, corners[0]] == edges[of_side[:, s], end]
        n = np.where(first[:, None], normals[:, corners[0]], normals[:, corners[1]])
        np.add.at(total, of_side[:, s], n[:, :, None] * n[:, None, :])
    size, direction = np.linalg.eigh(total)  # for two normals at an angle φ: 1 ± cos φ
    spanned = size > 1 - np.cos(FOLD)
    spanned[:, 2] = True
    share = np.einsum("eic,ei->ec", direction, L) * spanned
    return np.einsum("eic,ec->ei", direction, share)


@dataclass(frozen=True)
class Division:
    """A mesh some of whose triangles are divided.

    Attributes
    ----------
    points : (n + e, 3) array
        The given ones, then the new ones, mm.
    triangles : (k, 3) int array
        Oriented as their parents.
    normals : (k, 3, 3) array
        Unit normals at their corners.
    of : (k,) int array
        Parent of each triangle.
    corners : (k, 3, 3) array
        Barycentric coordinates of the corners within the parent.
    """

    points: np.ndarray
    triangles: np.ndarray
    normals: np.ndarray
    of: np.ndarray
    corners: np.ndarray

    @cached_property
    def _pieces(self) -> tuple[np.ndarray, np.ndarray]:
        """Children sorted by parent, and their parents."""
        order = np.argsort(self.of, kind="stable")
        return order, self.of[order]

    @cached_property
    def _inverses(self) -> np.ndarray:
        """(k, 3, 3) maps from barycentric coordinates in the parent to those in the child."""
        return np.linalg.inv(self.corners.transpose(0, 2, 1))

    def locate(self, triangle: np.ndarray, barycentric: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Child triangle (q,) that contains each point of the parents, and barycentric coordinates (q, 3) in it."""
        order, of = self._pieces
        first, last = (np.searchsorted(of, triangle, side) for side in ("left", "right"))
        owner = np.repeat(np.arange(len(triangle)), last - first)
        start = np.repeat(np.cumsum(last - first) - (last - first), last - first)
        piece = order[np.repeat(first, last - first) + np.arange(len(owner)) - start]
        # The inverses, cheap but less accurate, leave one child for most points.
        worst = np.einsum("qij,qj->qi", self._inverses[piece], barycentric[owner]).min(axis=1)
        likely = worst >= np.maximum.reduceat(worst, np.cumsum(last - first) - (last - first))[owner] - UNSURE
        owner, piece = owner[likely], piece[likely]
        local = np.linalg.solve(self.corners[piece].transpose(0, 2, 1), barycentric[owner][:, :, None])[:, :, 0]
        best = np.lexsort((-local.min(axis=1), owner))
        best = best[np.unique(owner[best], return_index=True)[1]]
        return piece[best], local[best]


def divided(
    points: np.ndarray,
    triangles: np.ndarray,
    normals: np.ndarray,
    places: np.ndarray,
    reach: np.ndarray,
    size: np.ndarray,
) -> Division:
    """Divide triangles near places until none exceeds the size required there.

    The size of a triangle of area A is √(2 A). Large triangles are divided into four. Neighbours follow if two of their
    edges are divided, one is twice, or a long one of a narrow triangle is; at another edge they are bisected.
    The shape stays: new vertices are midpoints of edges, and the normals there are means of the ends'.

    Parameters
    ----------
    points, triangles, normals
        As for `halved`.
    places : (p, 3) array
        mm.
    reach : (p,) array
        Distance from each within which triangles are refined, mm.
    size : (p,) array
        Largest size there, mm.
    """
    mesh = _AdaptiveMesh(points, triangles)
    while True:
        large = mesh.too_large(places, reach, size)
        if not large.any():
            mesh.close()
            between = unit(np.einsum("kij,kjl->kil", mesh.corners, normals[mesh.of]))
            return Division(mesh.points, mesh.triangles, between, mesh.of, mesh.corners)
        while large.any():
            mesh.divide(large)
            large = mesh.unbalanced()


class _AdaptiveMesh:
    """Triangles after repeated division into four; vertices may lie on edges of larger triangles (hanging nodes)."""

    def __init__(self, points, triangles):
        self.points, self.triangles = np.asarray(points), np.asarray(triangles)
        self.of = np.arange(len(self.triangles))
        self.corners = np.tile(np.eye(3), (len(self.triangles), 1, 1))
        self._edges = np.zeros(0, dtype=np.int64)  # keys of divided edges, sorted, and the vertices at their midpoints
        self._middle = np.zeros(0, dtype=np.int64)

    def too_large(self, places, reach, size) -> np.ndarray:
        """(k,) bool: which triangles near a place exceed its size."""
        corner = self.points[self.triangles]
        own = np.sqrt(np.linalg.norm(area_vectors(corner), axis=1))
        found = np.zeros(len(own), dtype=bool)
        middle, order = corner.mean(axis=1), np.argsort(-own)
        around = np.linalg.norm(corner - middle[:, None], axis=2).max(axis=1)
        count = np.searchsorted(-own[order], -size * (1 + EVEN))  # triangles that are larger than each size
        for place, far, larger in zip(places, reach, count):
            near = order[:larger]
            near = near[np.linalg.norm(middle[near] - place, axis=1) <= far * (1 + EVEN) + around[near]]
            if not len(near):
                continue
            share = closest_barycentric(corner[near], np.broadcast_to(place, (len(near), 3)))
            away = np.linalg.norm(np.einsum("qi,qij->qj", share, corner[near]) - place, axis=1)
            found[near[away <= far * (1 + EVEN)]] = True
        return found

    def unbalanced(self) -> np.ndarray:
        """(k,) bool: which triangles have two divided edges, one divided twice, or a long one and are narrow."""
        sides = self.triangles[:, EDGES]
        middle = self._middles(sides)
        divided_edge = middle >= 0
        twice = np.zeros(divided_edge.shape, dtype=bool)
        for end in (0, 1):
            half = np.stack([sides[:, :, end], np.maximum(middle, 0)], axis=2)
            twice |= divided_edge & (self._middles(half) >= 0)
        length = np.linalg.norm(self.points[sides[:, :, 1]] - self.points[sides[:, :, 0]], axis=2)
        long = length >= NARROW * length.max(axis=1, keepdims=True)
        flat = (divided_edge & long).any(axis=1) & ~long.all(axis=1)
        return (divided_edge.sum(axis=1) > 1) | twice.any(axis=1) | flat

    def divide(self, chosen) -> None:
        """Divide the chosen triangles into four each."""
        new = np.setdiff1d(self._keys(self.triangles[chosen][:, EDGES]), self._edges)
        ends = np.stack([new >> SHIFT, new & (2**SHIFT - 1)], axis=1)
        number = len(self.points) + np.arange(len(new))
        self.points = np.vstack([self.points, self.points[ends].mean(axis=1)])
        order = np.argsort(np.concatenate([self._edges, new]))
        self._edges = np.concatenate([self._edges, new])[order]
        self._middle = np.concatenate([self._middle, number])[order]
        self._replace(chosen, FOUR)

    def close(self) -> None:
        """Remove hanging nodes: bisect triangles with a divided edge."""
        cut = self._middles(self.triangles[:, EDGES]) >= 0
        self._replace(cut.any(axis=1), TWO[cut[cut.any(axis=1)].argmax(axis=1)])

    def _replace(self, chosen, children) -> None:
        """Replace the chosen triangles by children (m, 3), or (c, m, 3) of each, of their corners and midpoints."""
        whole, corner = self.triangles[chosen], self.corners[chosen]
        between = np.stack([corner[:, i] + corner[:, j] for i, j in EDGES], axis=1) / 2
        vertex = np.concatenate([whole, self._middles(whole[:, EDGES])], axis=1)
        row, many = np.arange(len(whole))[:, None, None], children.shape[-2]
        vertex, corner = vertex[row, children], np.concatenate([corner, between], axis=1)[row, children]
        self.of = np.concatenate([self.of[~chosen], np.repeat(self.of[chosen], many)])
        self.triangles = np.concatenate([self.triangles[~chosen], vertex.reshape(-1, 3)])
        self.corners = np.concatenate([self.corners[~chosen], corner.reshape(-1, 3, 3)])

    def _keys(self, sides) -> np.ndarray:
        """Key of each edge, from its two ends."""
        return (sides.min(axis=-1) << SHIFT) + sides.max(axis=-1)

    def _middles(self, sides) -> np.ndarray:
        """Vertex at the midpoint of each edge; -1 for an undivided edge."""
        if not len(self._edges):
            return np.full(sides.shape[:-1], -1)
        keys = self._keys(sides)
        at = np.minimum(np.searchsorted(self._edges, keys), len(self._edges) - 1)
        return np.where(self._edges[at] == keys, self._middle[at], -1)
