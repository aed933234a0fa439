"""Triangulated mid-surface of a part: normals, projection, and quadrature over discs, triangles and edges.

:class:`Surface` holds no finite-element unknowns, so the production path can place functionals and find contact pairs
where no finite-element package is installed.

Rounding must not decide which triangle is closest or which points lie within a radius: results are the same if a scene
is rotated, mirrored, renumbered or written in other units. Lengths that differ by less than a small share of the
surface's size count as equal, and ties are broken by quantities that are invariant under these changes.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np
from scipy.spatial import cKDTree

from mic.geometry.blocks import Blocks
from mic.geometry.normals import CornerNormals, corner_normals
from mic.geometry.triangles import (
    area_vectors,
    closest_barycentric,
    dot,
    edge_barycentric,
    length,
    linked_rows,
    listed,
    sides,
    subtriangles,
    unit,
)

__all__ = ["EQUAL", "Patch", "Projection", "Surface"]

INNER = np.array([[4, 1, 1], [1, 4, 1], [1, 1, 4]]) / 6  #: quadrature points of a triangle, equal weights
EQUAL = 1e-7  #: relative difference below which lengths, cosines and ratios count as equal
BATCH = 500_000  # pairs of points and nearby triangles processed at once, about 300 bytes each
DISC_DIVISIONS = 3  # least divisions of the edges of triangles that the rim of a disc may cross


@dataclass(frozen=True)
class Patch:
    """Quadrature points on a surface over which a functional averages.

    Attributes
    ----------
    triangle : (q,) int array
        Triangle that contains each point.
    barycentric : (q, 3) array
        Barycentric coordinates of each point in its triangle.
    weight : (q,) array
        Weights of the points. They sum to one for an average, and to zero for a first moment over a nugget.
    """

    triangle: np.ndarray
    barycentric: np.ndarray
    weight: np.ndarray


@dataclass(frozen=True)
class Projection:
    """Closest points on a surface.

    Attributes
    ----------
    triangle : (n,) int array
        Triangle that holds the closest point; -1 where no triangle passed the filter.
    barycentric : (n, 3) array
    point : (n, 3) array
        The closest point, mm.
    distance : (n,) array
        Distance to it, mm; infinite where none passed the filter.
    at_border : (n,) bool array
        Whether it lies on the border of the surface.
    """

    triangle: np.ndarray
    barycentric: np.ndarray
    point: np.ndarray
    distance: np.ndarray
    at_border: np.ndarray


@dataclass(frozen=True)
class Surface:
    """Triangulated mid-surface.

    Parameters
    ----------
    points : (n, 3) array
        Vertices, mm.
    triangles : (k, 3) int array
        Vertex numbers, consistently oriented: the normal is ``(p1 - p0) x (p2 - p0)``.
    given_normals : (k, 3, 3) array, optional
        Normals of the sheet at the corners of each triangle, from its geometry or its deck; NaN or zero where unknown.
        Any length and either sense.

    Raises
    ------
    ValueError
        For wrong shapes, non-finite vertices, vertex numbers out of range or triangles without area.
    """

    points: np.ndarray
    triangles: np.ndarray
    given_normals: np.ndarray | None = None

    def __post_init__(self):
        points = np.ascontiguousarray(self.points, dtype=float)
        triangles = np.ascontiguousarray(self.triangles, dtype=np.int64)
        if points.ndim != 2 or points.shape[1] != 3:
            raise ValueError(f"points must have shape (n, 3), not {points.shape}")
        if triangles.ndim != 2 or triangles.shape[1] != 3 or len(triangles) == 0:
            raise ValueError(f"triangles must have shape (k, 3) with k > 0, not {triangles.shape}")
        bad = np.flatnonzero(~np.isfinite(points).all(1))
        if len(bad):
            raise ValueError(f"point {bad[0]} has a coordinate that is not finite")
        if triangles.min() < 0 or triangles.max() >= len(points):
            raise ValueError(f"triangles refer to vertices outside 0..{len(points) - 1}")
        object.__setattr__(self, "points", points)
        object.__setattr__(self, "triangles", triangles)
        if self.given_normals is not None:
            given = np.ascontiguousarray(self.given_normals, dtype=float)
            if given.shape != (len(triangles), 3, 3):
                shape = f"({len(triangles)}, 3, 3), one at each corner of each triangle"
                raise ValueError(f"normals must have shape {shape}, not {given.shape}")
            object.__setattr__(self, "given_normals", given)
        longest = self.edge_lengths.max(1)
        flat = np.flatnonzero(self.areas <= 1e-12 * longest**2)
        if len(flat):
            raise ValueError(f"triangle {flat[0]} has no area ({len(flat)} such triangles): repair the mesh first")

    @cached_property
    def corners(self) -> np.ndarray:
        """(k, 3, 3) vertex coordinates of each triangle."""
        return self.points[self.triangles]

    @cached_property
    def box(self) -> np.ndarray:
        """(2, 3) least and greatest coordinates of the vertices, mm."""
        return np.stack([self.points.min(axis=0), self.points.max(axis=0)])

    @cached_property
    def edge_lengths(self) -> np.ndarray:
        """(k, 3) lengths of the edges opposite to each vertex, mm."""
        c = self.corners
        return np.linalg.norm(c[:, [2, 0, 1]] - c[:, [1, 2, 0]], axis=2)

    @cached_property
    def _area_vectors(self) -> np.ndarray:
        return 0.5 * area_vectors(self.corners)

    @cached_property
    def areas(self) -> np.ndarray:
        """(k,) triangle areas, mm²."""
        return np.linalg.norm(self._area_vectors, axis=1)

    @cached_property
    def normals(self) -> np.ndarray:
        """(k, 3) unit normals of the triangles."""
        return self._area_vectors / self.areas[:, None]

    @cached_property
    def curvature(self) -> CornerNormals:
        """Normals of the curved sheet that the triangles approximate: given ones, and estimates elsewhere."""
        return corner_normals(self.points, self.triangles, self.given_normals)

    @property
    def corner_normals(self) -> np.ndarray:
        """(k, 3, 3) unit normals of the curved sheet at the corners of each triangle, on the side of its own."""
        return self.curvature.normal

    @cached_property
    def vertex_normals(self) -> np.ndarray:
        """(n, 3) area-weighted unit normals at the vertices; zero at a vertex that no triangle uses."""
        total = np.zeros_like(self.points)
        for corner in range(3):
            np.add.at(total, self.triangles[:, corner], self._area_vectors)
        length = np.linalg.norm(total, axis=1, keepdims=True)
        return np.divide(total, length, out=np.zeros_like(total), where=length > 0)

    @cached_property
    def sides(self) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Edges as :func:`mic.geometry.triangles.sides` returns them."""
        return sides(self.triangles)

    @cached_property
    def border(self) -> np.ndarray:
        """(k, 3) bool: whether the edge opposite to each vertex belongs to this triangle alone."""
        _, edge, count = self.sides
        return count[edge] == 1

    def edges(self, max_angle: float) -> tuple[np.ndarray, np.ndarray]:
        """Edges where the sheet ends or folds: border edges, and edges at which no neighbour continues the triangle.

        Parameters
        ----------
        max_angle : float
            Radians: a neighbour at a larger angle does not continue a triangle.

        Returns
        -------
        triangle : (e,) int array
            An edge on which two triangles end appears once for each.
        opposite : (e,) int array
            Corner of the triangle opposite to the edge.
        """
        _, edge, count = self.sides
        normals = np.repeat(self.normals, 3, axis=0)
        total = np.column_stack([np.bincount(edge.ravel(), normals[:, i], len(count)) for i in range(3)])
        # The sum of two unit normals at an angle φ has length 2 cos(φ/2).
        smooth = (count == 2) & (np.linalg.norm(total, axis=1) >= 2 * np.cos(max_angle / 2) - EQUAL)
        triangle, opposite = np.nonzero(~smooth[edge])
        return triangle, opposite

    def ends(self, triangle, opposite) -> np.ndarray:
        """(e, 2) vertices of edges as `edges` returns them, in the orientation of their triangles."""
        return self.triangles[triangle[:, None], (opposite[:, None] + [1, 2]) % 3]

    @cached_property
    def border_vertices(self) -> np.ndarray:
        """(n,) bool: whether each vertex is an end of a border edge."""
        return np.isin(np.arange(len(self.points)), self.ends(*np.nonzero(self.border)))

    @cached_property
    def diameter(self) -> float:
        """Diagonal of the bounding box, mm."""
        return float(np.linalg.norm(np.ptp(self.points, axis=0)))

    @cached_property
    def tie(self) -> float:
        """Lengths that differ by less than this count as equal, mm."""
        size = np.linalg.norm(self.points[np.unique(self.triangles)] - self.centroid, axis=1).max()
        return EQUAL * float(size)

    @cached_property
    def centroid(self) -> np.ndarray:
        """(3,) centroid of the surface, mm."""
        return np.average(self._centroids, axis=0, weights=self.areas)

    @cached_property
    def _centroids(self) -> np.ndarray:
        return self.corners.mean(1)

    @cached_property
    def reach(self) -> np.ndarray:
        """(k,) radius about its centroid that contains each triangle, mm."""
        return np.linalg.norm(self.corners - self._centroids[:, None], axis=2).max(1)

    @cached_property
    def _blocks(self) -> Blocks:
        return Blocks(self.corners, self.areas)

    @cached_property
    def _tree(self) -> cKDTree:
        return cKDTree(self._centroids)

    def project(
        self, x, normal=None, max_angle: float = np.pi / 4, reach: float = np.inf, side=None, among=None
    ) -> Projection:
        """Closest points on the surface, exact over all triangles that pass the filter.

        If several triangles share the closest point, the one whose normal is best aligned with `normal` is returned,
        then the one with the nearest centroid, then the first.

        Parameters
        ----------
        x : (n, 3) array
            Points, mm.
        normal : (n, 3) array, optional
            Only triangles whose normal lies within `max_angle` of this direction (either sense) count; a row of NaN
            disables the filter for that point.
        max_angle : float
            Radians.
        reach : float
            Closest points farther than this need not be found, mm. Must be finite if `side` is given.
        side : (n,) array, optional
            +1 or -1: the closest point of a triangle counts only if it lies ahead of x along `normal`, or behind.
        among : (q,) int arrays, optional
            Numbers of points, ascending, and triangles in which their closest points lie, of :meth:`candidates`.
        """
        x = np.atleast_2d(np.asarray(x, dtype=float))
        if normal is not None:
            normal = np.broadcast_to(np.asarray(normal, dtype=float), x.shape)
        owner, triangle, barycentric, foot = self._closest(x, normal, max_angle, reach, side, among)
        best = Projection(
            np.full(len(x), -1, dtype=np.int64),
            np.full((len(x), 3), np.nan),
            np.full((len(x), 3), np.nan),
            np.full(len(x), np.inf),
            np.zeros(len(x), dtype=bool),
        )
        chosen = np.arange(len(owner))
        if normal is not None:
            turned = 1 - np.abs(dot(self.normals[triangle], normal[owner]))
            chosen = chosen[_least(turned, owner, EQUAL)]
        away = np.linalg.norm(self._centroids[triangle[chosen]] - x[owner[chosen]], axis=1)
        chosen = chosen[_least(away, owner[chosen], self.tie)]
        chosen = chosen[np.lexsort((triangle[chosen], owner[chosen]))]
        chosen = chosen[np.unique(owner[chosen], return_index=True)[1]]
        into, triangle, barycentric = owner[chosen], triangle[chosen], barycentric[chosen]
        best.triangle[into] = triangle
        best.barycentric[into] = barycentric
        best.point[into] = foot[chosen]
        best.distance[into] = np.linalg.norm(foot[chosen] - x[into], axis=1)
        on_edge = (barycentric < 1e-9) & self.border[triangle]
        at_corner = (barycentric > 1 - 2e-9) & self.border_vertices[self.triangles[triangle]]
        best.at_border[into] = (on_edge | at_corner).any(1)
        return best

    def candidates(self, x, move: float) -> tuple[np.ndarray, np.ndarray]:
        """Numbers of points x (n, 3), and triangles that may hold their closest points after a relative move, mm.

        The closest triangle is at most at d + move afterwards, d being the distance now: it is at most at d + 2 move.
        """
        bound, found = self._near(x, None, 0.0, np.inf) + 2 * move, []
        for owner, triangle in self._centred_near(x, bound + self.reach.max()):
            near = length(self._centroids[triangle] - x[owner]) <= bound[owner] + self.reach[triangle]
            found.append((owner[near], triangle[near]))
        owner, triangle = map(np.concatenate, zip(*found))
        return owner, triangle

    def behind(self, other: Surface, triangle, side, reach: float, max_angle: float) -> np.ndarray:
        """(n,) bool: whether any of this surface may lie behind the plane of each triangle of another surface.

        Parameters
        ----------
        other : Surface
        triangle : (n,) int array
            Triangles of `other`.
        side : (n,) array
            +1 where the front is along their normals, -1 where it is opposite.
        reach : float
            Distance from them within which this surface is searched, mm.
        max_angle : float
            Radians: triangles at a larger angle do not count.
        """
        front, use = np.unique(2 * np.asarray(triangle) + (np.asarray(side) > 0), return_inverse=True)
        one, sign = front // 2, np.where(front % 2, 1.0, -1.0)
        centre, normal = other._centroids[one], other.normals[one] * sign[:, None]
        farthest = other.reach[one] + reach + self.reach.max() * (1 + 1e-9) + self.tie
        some = np.zeros(len(one), dtype=bool)
        # most triangles have whole blocks of this surface ahead of them
        unsure = np.flatnonzero(self._blocks.behind(centre, normal, farthest))
        for row, found in self._centred_near(centre[unsure], farthest[unsure]):
            owner = unsure[row]
            aligned = self._aligned(found, normal[owner], np.cos(max_angle))
            owner, found = owner[aligned], found[aligned]
            step = self.corners[found] - centre[owner][:, None]
            ahead = np.einsum("qcj,qj->qc", step, normal[owner])
            some[owner[ahead.min(1) < -self.tie]] = True
        return some[use]

    def _closest(self, x, normal, max_angle, reach=np.inf, side=None, among=None):
        """All triangles that contain the closest point of each x: owner, triangle, barycentric, closest point.

        Two closest points are the same if they lie within `tie` of each other. The squares of their distances, d² and
        d² + e² for an offset e along the surface, then differ by less than tie².
        """
        # A triangle can hold the closest point only if its centroid lies within (upper bound + its reach).
        cosine = np.cos(max_angle)
        bound = np.full(len(x), reach) if side is not None else self._near(x, normal, cosine, reach)
        search = np.where(bound >= 0, bound + self.reach.max() * (1 + 1e-9) + self.tie, 0.0)
        near = self._centred_near(x, search) if among is None else [among]
        found = [self._nearest_of(x, normal, cosine, side, bound, *some) for some in near]
        owner, triangle, barycentric, foot = map(np.concatenate, zip(*found))
        return owner, triangle, barycentric, foot

    def _centred_near(self, x, radius):
        """Triangles whose centroids lie within a radius (n,) of each x (n, 3), as owner and triangle, in batches.

        On meshes with elements smaller than the sheet thickness there are thousands per point.
        """
        pieces = [np.arange(len(x))]
        if len(x) * len(self.triangles) > BATCH:
            count = np.cumsum(self._tree.query_ball_point(x, radius, return_length=True))
            pieces = np.split(pieces[0], np.flatnonzero(np.diff(count // BATCH)) + 1)
        for rows in pieces:
            owner, triangle = listed(self._tree.query_ball_point(x[rows], radius[rows]))
            yield rows[owner], triangle

    def _nearest_of(self, x, normal, cosine, side, bound, owner, triangle):
        """The owners' triangles that contain their closest points, as `_closest` returns them."""
        distance = length(self._centroids[triangle] - x[owner])
        near = distance <= bound[owner] + self.reach[triangle] * (1 + 1e-9) + self.tie
        owner, triangle = owner[near], triangle[near]
        if normal is not None:
            keep = self._aligned(triangle, normal[owner], cosine)
            owner, triangle = owner[keep], triangle[keep]
        barycentric = closest_barycentric(self.corners[triangle], x[owner])
        foot = np.einsum("qi,qij->qj", barycentric, self.corners[triangle])
        if side is not None:
            along = dot(foot - x[owner], normal[owner])
            ahead = side[owner] * along > self.tie
            owner, triangle, barycentric, foot = (of[ahead] for of in (owner, triangle, barycentric, foot))
        closest = _least(((foot - x[owner]) ** 2).sum(1), owner, self.tie**2)
        return owner[closest], triangle[closest], barycentric[closest], foot[closest]

    def _aligned(self, triangle, normal, cosine):
        """Mask of the triangles whose normals lie within the angle of `normal`; NaN passes."""
        return ~(np.abs(dot(self.normals[triangle], normal)) < cosine - EQUAL)

    def _near(self, x, normal, cosine, reach) -> np.ndarray:
        """(n,) upper bounds of the distance from each point to the triangles that pass the filter, mm.

        It is the distance to the triangle with the nearest centroid, or `reach`; -inf if none within reach passes.
        """
        triangle = self._tree.query(x)[1] if normal is None else self._nearest_aligned(x, normal, cosine, reach)
        bound, found = np.full(len(x), -np.inf), np.flatnonzero(triangle >= 0)
        corners = self.corners[triangle[found]]
        foot = np.einsum("qi,qij->qj", closest_barycentric(corners, x[found]), corners)
        bound[found] = np.minimum(np.linalg.norm(foot - x[found], axis=1) + self.tie, reach)
        return bound

    def _nearest_aligned(self, x, normal, cosine, reach) -> np.ndarray:
        """(n,) the triangle with the nearest centroid that passes the normal filter.

        -1 if none passes that could lie within reach.
        """
        nearest, todo, count = np.full(len(x), -1), np.arange(len(x)), 4
        farthest = reach + self.reach.max() * (1 + 1e-9) + self.tie
        while len(todo):
            count = min(count, len(self.triangles))
            distance, triangle = (table.reshape(len(todo), count) for table in self._tree.query(x[todo], k=count))
            aligned = self._aligned(triangle.ravel(), np.repeat(normal[todo], count, axis=0), cosine).reshape(
                triangle.shape
            )
            found, first = aligned.any(1), aligned.argmax(1)
            nearest[todo[found]] = triangle[found, first[found]]
            todo = todo[~found & (distance[:, -1] <= farthest)] if count < len(self.triangles) else todo[:0]
            count *= 8
        return nearest

    def patch(self, center, radius: float, normal=None) -> Patch:
        """The disc of the surface within `radius` of the projection of `center`, with equal weight per area.

        Parameters
        ----------
        center : (3,) array
            mm; projected onto the surface first.
        radius : float
            mm; zero gives the projected point alone (a nodal functional if the point is a vertex).
        normal : (3,) array, optional
            Approximate surface normal (either sense), to choose the right sheet near folds.

        Returns
        -------
        Patch
            Only triangles that are connected to the projected point and lie within 60 degrees of its triangle take
            part. A point on a fold belongs to both sides.

        Raises
        ------
        ValueError
            If no triangle passes the normal filter, or the radius is negative.
        """
        if radius < 0:
            raise ValueError(f"radius must not be negative, got {radius}")
        center = np.atleast_2d(np.asarray(center, dtype=float))
        normal = None if normal is None else np.atleast_2d(np.asarray(normal, dtype=float))
        foot = self.project(center, normal)
        seed = int(foot.triangle[0])
        if seed < 0:
            raise ValueError(f"no triangle near {center[0].tolist()} is aligned with the given normal")
        if radius == 0:
            return Patch(foot.triangle, foot.barycentric, np.ones(1))
        seeds = self._closest(center, normal, np.pi / 4)[1]
        wide = radius + self.tie
        near = np.asarray(self._tree.query_ball_point(foot.point[0], wide + self.reach.max()), dtype=np.int64)
        near = near[np.linalg.norm(self._centroids[near] - foot.point[0], axis=1) <= wide + self.reach[near]]
        near = near[(self.normals[near] @ self.normals[seeds].T).max(1) > 0.5 + EQUAL]
        piece = linked_rows(self.triangles[near])[1]
        near = np.sort(near[piece == piece[near == seed]])
        triangle, barycentric, area = self._within(near, foot.point[0], radius)
        if not len(area):
            return Patch(foot.triangle, foot.barycentric, np.ones(1))
        return Patch(triangle, barycentric, area / area.sum())

    def _within(self, triangles, center, radius):
        """Midpoint quadrature, as by `sample`, over the part of the triangles within a ball.

        Sub-triangles that the circle crosses are cut along the chord between its exact ends. Accepting or rejecting
        them by their midpoints would shift the disc's centre by up to a hundredth of its radius, which exceeds the
        error of a fine mesh. Small triangles still get three points each: one each would be point loads at the spacing
        of the nodes, which change a nugget's compliance by up to 0.3 %.
        """
        reach = np.linalg.norm(self.corners[triangles] - center, axis=2).max(1)
        small = self.edge_lengths[triangles].max(1) <= (DISC_DIVISIONS - 1 + EQUAL) * radius / 8
        small &= reach < (1 - EQUAL) * radius
        inner = triangles[small]
        triangle, corners, area = self._divided(triangles[~small], radius / 8, DISC_DIVISIONS)
        x = np.einsum("qvi,qij->qvj", corners, self.corners[triangle]) - center
        inside = np.linalg.norm(x, axis=2) <= radius
        found = inside.sum(axis=1)
        centroid, share = corners.mean(axis=1), (found == 3).astype(float)
        # The corner that is alone on its side of the circle is cut off; it counts if it lies inside.
        cut = np.flatnonzero((found == 1) | (found == 2))
        alone = np.argmax(inside[cut] == (found[cut] == 1)[:, None], axis=1)
        rows, sense = np.arange(len(cut)), np.where(found[cut] == 1, 1.0, -1.0)
        start, tip = x[cut][rows, alone], corners[cut][rows, alone]
        piece, whole = tip.copy(), np.ones(len(cut))
        for step in (1, 2):
            other = (alone + step) % 3
            edge = x[cut][rows, other] - start
            a, b, c = ((p * q).sum(axis=1) for p, q in ((edge, edge), (start, edge), (start, start)))
            t = (sense * np.sqrt(np.maximum(b**2 - a * (c - radius**2), 0.0)) - b) / a  # |start + t edge| = radius
            t = np.clip(t, 0.0, 1.0)
            piece += t[:, None] * (corners[cut][rows, other] - tip) / 3
            whole *= t
        share[cut] = np.where(sense > 0, whole, 1 - whole)
        rest = (centroid[cut] - whole[:, None] * piece) / np.maximum(1 - whole, EQUAL)[:, None]
        centroid[cut] = np.where(sense[:, None] > 0, piece, rest)
        covered = share > EQUAL
        return (
            np.concatenate([triangle[covered], np.repeat(inner, 3)]),
            np.concatenate([centroid[covered], np.tile(INNER, (len(inner), 1))]),
            np.concatenate([(share * area)[covered], np.repeat(self.areas[inner] / 3, 3)]),
        )

    def whole(self) -> Patch:
        """The whole surface: three points per triangle, exact for quadratic integrands."""
        count = len(self.triangles)
        weight = np.repeat(self.areas / (3 * self.areas.sum()), 3)
        return Patch(np.repeat(np.arange(count), 3), np.tile(INNER, (count, 1)), weight)

    def sample(self, triangles, spacing: float):
        """Midpoint quadrature on congruent sub-triangles no longer than `spacing` (at most 32 per edge).

        Returns
        -------
        triangle : (q,) int array
        barycentric : (q, 3) array
        area : (q,) array
            Tributary area of each point, mm².
        """
        triangle, corners, area = self._divided(triangles, spacing)
        return triangle, corners.mean(axis=1), area

    def _divided(self, triangles, spacing, least=1):
        """Congruent sub-triangles with edges up to `spacing`, at least `least` per edge.

        Returns the triangle that contains each, the barycentric coordinates (q, 3, 3) of its corners, and its area.
        """
        triangles = np.asarray(triangles, dtype=np.int64)
        divisions = np.clip(np.ceil(self.edge_lengths[triangles].max(1) / spacing - EQUAL), least, 32).astype(int)
        triangle, corners, area = [], [], []
        for n in np.unique(divisions):
            chosen = triangles[divisions == n]
            local = subtriangles(int(n))
            triangle.append(np.repeat(chosen, len(local)))
            corners.append(np.tile(local, (len(chosen), 1, 1)))
            area.append(np.repeat(self.areas[chosen] / n**2, len(local)))
        if not triangle:
            return np.zeros(0, np.int64), np.zeros((0, 3, 3)), np.zeros(0)
        return np.concatenate(triangle), np.concatenate(corners), np.concatenate(area)

    def sample_edges(self, triangle, opposite, spacing: float):
        """Midpoint quadrature on edges of triangles, in equal parts no longer than `spacing`.

        Parameters
        ----------
        triangle, opposite : (e,) int array
            As `edges` returns them.
        spacing : float
            mm.

        Returns
        -------
        triangle : (q,) int array
        barycentric : (q, 3) array
        length : (q,) array
            Tributary length of each point, mm.
        """
        length = self.edge_lengths[triangle, opposite]
        parts = np.maximum(np.ceil(length / spacing - EQUAL), 1).astype(int)
        owner = np.repeat(np.arange(len(parts)), parts)
        at = (np.arange(len(owner)) - np.repeat(np.cumsum(parts) - parts, parts) + 0.5) / parts[owner]
        return triangle[owner], edge_barycentric(opposite[owner], at), (length / parts)[owner]

    def smooth_normals(self, triangle, barycentric) -> np.ndarray:
        """(q, 3) unit normals of the curved sheet, interpolated between those at the corners of the triangles."""
        return unit(np.einsum("qi,qij->qj", barycentric, self.corner_normals[triangle]))

    def at(self, triangle, barycentric) -> np.ndarray:
        """(q, 3) coordinates of points given by triangle and barycentric coordinates, mm."""
        return np.einsum("qi,qij->qj", barycentric, self.corners[triangle])


def _least(value, owner, tie):
    """Mask of the values (q,) within `tie` of their owner's minimum; NaN passes."""
    least = np.full(owner.max(initial=-1) + 1, np.inf)
    np.minimum.at(least, owner, value)
    return ~(value > least[owner] + tie)
