"""Repair of triangle meshes from files, so that they define a `Surface`.

Repaired: quadrilaterals (split), coincident points (merged), triangles that are degenerate or repeated (dropped),
points of one triangle on an edge of another (that triangle split), inconsistent orientation (reversed), unused points
(dropped).
Reported: edges shared by three or more triangles, separate pieces.
Refused: non-finite coordinates, point numbers out of range, meshes without triangles, one-sided (Möbius) sheets.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.sparse import coo_matrix
from scipy.sparse.csgraph import breadth_first_order, connected_components
from scipy.spatial import cKDTree

from mic.geometry.triangles import area_vectors, components, linked_rows, paired_sides, place_text, sides

__all__ = ["MeshReport", "repair"]

MERGE = 1e-7  # share of the mesh's diagonal below which points coincide
FLAT = 1e-6  # height over longest side below which a triangle has no area
ALIKE = 1.25  # ratio of diagonals above which the shorter one is chosen
EQUAL = 1e-7  # relative difference below which lengths are equal
ON_EDGE = 1e-4  # distance over length below which a point lies on an edge


@dataclass(frozen=True)
class MeshReport:
    """Changes made by `repair`. Counts, except the maps.

    Attributes
    ----------
    quadrilaterals_split, points_merged, points_dropped : int
    triangles_without_area, triangles_repeated : int
        Dropped.
    triangles_split : int
        At points of other triangles on their edges.
    triangles_turned : int
        Reversed.
    junction_edges : int
        Edges of three or more triangles. Orientation is consistent on each sheet that meets there, not across.
    pieces : int
        Sets of triangles connected by edges.
    point_map : (n,) int array
        New number of each original point, -1 if dropped.
    corner_map : (k, 3) int array
        Original corner of each corner of the new triangles: 3 i + c of triangle i, numbered before 4 i + c of
        quadrilateral i; -1 for corners created by splitting.
    element_map : (k,) int array
        Original element of each new triangle: triangle i, numbered before quadrilateral i.
    turned : (k,) bool array
        Whether the new triangle is reversed.
    """

    quadrilaterals_split: int
    points_merged: int
    points_dropped: int
    triangles_without_area: int
    triangles_repeated: int
    triangles_split: int
    triangles_turned: int
    junction_edges: int
    pieces: int
    point_map: np.ndarray
    corner_map: np.ndarray
    element_map: np.ndarray
    turned: np.ndarray

    def __str__(self) -> str:
        lines = [
            (self.quadrilaterals_split, "quadrilaterals split"),
            (self.points_merged, "points merged with coincident ones"),
            (self.triangles_without_area, "triangles without area dropped"),
            (self.triangles_repeated, "repeated triangles dropped"),
            (self.triangles_split, "triangles split at points on their edges"),
            (self.triangles_turned, "triangles reversed to agree with their neighbours"),
            (self.points_dropped, "points that no triangle uses dropped"),
            (self.junction_edges, "edges where three or more triangles meet"),
            (self.pieces if self.pieces > 1 else 0, "separate pieces"),
        ]
        return "\n".join(f"{count} {text}" for count, text in lines if count) or "nothing to repair"


def repair(points, triangles, quadrilaterals=()) -> tuple[np.ndarray, np.ndarray, MeshReport]:
    """Points (n, 3) and triangles (k, 3) fit for a `Surface`, and a report of the changes.

    Parameters
    ----------
    points : (n, 3) array
        mm.
    triangles : (k, 3) int array
    quadrilaterals : (q, 4) int array, optional
        Each becomes two triangles, split along the diagonal if one is much shorter. Diagonals of similar length meet at
        every other point (union jack): a mesh with parallel diagonals is stiffer, with up to twice the error on curved
        sheets.

    Raises
    ------
    ValueError
        For arrays that do not describe a mesh, or a one-sided sheet.
    """
    points, triangles = np.array(points, dtype=float), np.array(triangles, dtype=np.int64)
    quadrilaterals = np.array(quadrilaterals, dtype=np.int64).reshape(-1, 4)
    bad = np.flatnonzero(~np.isfinite(points).all(axis=1))
    if len(bad):
        raise ValueError(f"point {bad[0]} has a coordinate that is not finite")
    corners = np.concatenate([triangles.ravel(), quadrilaterals.ravel()])
    if not np.isin(corners, np.arange(len(points))).all():
        raise ValueError(f"elements refer to points outside 0..{len(points) - 1}; export the mesh again")
    # original corner of each corner of the triangles; last column: original element
    split = len(quadrilaterals)
    origin = np.column_stack([np.arange(triangles.size).reshape(-1, 3), np.arange(len(triangles))])
    if split:
        quadrilaterals = _merge(points)[quadrilaterals]  # neighbours share their points
        triangles = np.concatenate([triangles, _split_quadrilaterals(points, quadrilaterals)])
        halves = np.tile(quadrilaterals, (2, 1))[:, None, :] == triangles[-2 * split :, :, None]
        corner = triangles.size - 6 * split + 4 * np.tile(np.arange(split), 2)[:, None] + halves.argmax(axis=2)
        origin = np.concatenate([origin, np.column_stack([corner, len(origin) + np.tile(np.arange(split), 2)])])
    representative = _merge(points)
    triangles = representative[triangles]
    sound = _with_area(points, triangles)
    flat, triangles, origin = int((~sound).sum()), triangles[sound], origin[sound]
    first = np.sort(np.unique(np.sort(triangles, axis=1), axis=0, return_index=True)[1])
    repeated, triangles, origin = len(triangles) - len(first), triangles[first], origin[first]
    if len(triangles) == 0:
        raise ValueError("no triangle of the mesh has an area; export it again")
    triangles, origin, divided = _split_at_points_on_edges(points, triangles, origin)
    turn = _turned(points, triangles)
    triangles[turn], origin[turn, :3] = triangles[turn][:, ::-1], origin[turn, 2::-1]

    used = np.unique(triangles)
    number = np.full(len(points), -1)
    number[used] = np.arange(len(used))
    merged = representative != np.arange(len(points))
    edge, count = _sides(triangles)
    report = MeshReport(
        quadrilaterals_split=split,
        points_merged=int(merged.sum()),
        points_dropped=int(len(points) - len(used) - merged.sum()),
        triangles_without_area=flat,
        triangles_repeated=repeated,
        triangles_split=divided,
        triangles_turned=int(turn.sum()),
        junction_edges=int((count > 2).sum()),
        pieces=int(linked_rows(edge)[0]),
        point_map=number[representative],
        corner_map=origin[:, :3],
        element_map=origin[:, 3],
        turned=turn,
    )
    return points[used], number[triangles], report


def _split_quadrilaterals(points, quadrilaterals):
    a, b, c, d = quadrilaterals.T
    ac, bd = (np.linalg.norm(points[i] - points[j], axis=1) for i, j in ((a, c), (b, d)))
    along_ac = ac <= (1 + EQUAL) * bd
    sheet, colour = (table[quadrilaterals].T for table in _checkerboard(len(points), quadrilaterals))
    # quadrilaterals without alternating colours get the shorter diagonal
    regular = (colour[0] == colour[2]) & (colour[1] == colour[3]) & (colour[0] != colour[1])
    regular &= (ac <= ALIKE * bd) & (bd <= ALIKE * ac)
    # diagonals join the colour that makes them shorter, else that of the first point
    longer = np.bincount(sheet[0], np.where(regular, np.where(colour[0] == 0, ac - bd, bd - ac), 0))
    total = np.bincount(sheet[0], np.where(regular, ac + bd, 0))
    joined = (longer > EQUAL * total).astype(int)
    along_ac = np.where(regular, colour[0] == joined[sheet[0]], along_ac)[:, None]
    first = np.where(along_ac, np.column_stack([a, b, c]), np.column_stack([a, b, d]))
    second = np.where(along_ac, np.column_stack([a, c, d]), np.column_stack([b, c, d]))
    return np.concatenate([first, second])


def _checkerboard(n, quadrilaterals):
    """(n,) sheet of each point, and its colour, 0 or 1, such that the ends of sides have different colours if possible.

    The colour is the parity of the number of sides to the first point of the sheet.
    """
    used, corner = np.unique(quadrilaterals, return_inverse=True)
    corner = corner.reshape(quadrilaterals.shape)
    start, end = corner.ravel(), np.roll(corner, -1, axis=1).ravel()
    graph = coo_matrix((np.ones(len(start)), (start, end)), shape=(len(used), len(used))).tocsr()
    sheet, colour = np.zeros((2, n), dtype=int)
    sheet[used] = connected_components(graph, directed=False)[1]
    for root in np.unique(sheet[used], return_index=True)[1]:
        order, before = breadth_first_order(graph, root, directed=False)
        for point in order[1:]:
            colour[used[point]] = 1 - colour[used[before[point]]]
    return sheet, colour


def _merge(points):
    """(n,) the lowest number among the points that coincide with each point."""
    pairs = cKDTree(points).query_pairs(MERGE * np.linalg.norm(np.ptp(points, axis=0)), output_type="ndarray")
    cluster = components(*pairs.T, len(points))[1]
    return np.unique(cluster, return_index=True)[1][cluster]


def _with_area(points, triangles):
    """(k,) bool: whether each triangle has an area."""
    corner = points[triangles]
    longest = np.linalg.norm(corner - np.roll(corner, 1, axis=1), axis=2).max(axis=1)
    return np.linalg.norm(area_vectors(corner), axis=1) > FLAT * longest**2


def _sides(triangles):
    """Edge of each side, and the number of triangles of each edge; side 3k + s runs from vertex s to s + 1 of k."""
    _, edge, count = sides(triangles)
    return np.roll(edge, 1, axis=1), count


def _split_at_points_on_edges(points, triangles, origin):
    """Split every triangle with a point of another triangle's boundary on a free side into a fan, in passes.

    Returns triangles, the origin of their corners, and how many were split.
    """
    divided = 0
    while True:
        edge, count = _sides(triangles)
        free = np.flatnonzero(count[edge.ravel()] == 1)
        start, end = triangles.ravel()[free], np.roll(triangles, -1, axis=1).ravel()[free]
        candidates = np.unique(start)
        middle, half = (points[start] + points[end]) / 2, np.linalg.norm(points[end] - points[start], axis=1) / 2
        near = cKDTree(points[candidates]).query_ball_point(middle, half)
        keep, fans, origins = np.ones(len(triangles), dtype=bool), [], []
        for side, a, b, length, around in zip(free, start, end, 2 * half, near):
            direction = (points[b] - points[a]) / length
            offset = points[candidates[around]] - points[a]
            along = offset @ direction
            distance = np.linalg.norm(offset - along[:, None] * direction, axis=1)
            on_edge = (distance < ON_EDGE * length) & (along > ON_EDGE * length) & (along < (1 - ON_EDGE) * length)
            triangle = side // 3
            if not on_edge.any() or not keep[triangle]:
                continue
            keep[triangle] = False
            turn = (side % 3 + np.arange(3)) % 3  # a, b and the corner opposite
            apex = triangles[triangle, turn[2]]
            chain = np.concatenate([[a], candidates[around][on_edge][np.argsort(along[on_edge])], [b]])
            fans.append(np.column_stack([chain[:-1], chain[1:], np.full(len(chain) - 1, apex)]))
            of_fan = np.full((len(chain) - 1, 4), -1)
            of_fan[0, 0], of_fan[-1, 1], of_fan[:, 2] = origin[triangle, turn]
            of_fan[:, 3] = origin[triangle, 3]
            origins.append(of_fan)
        if not fans:
            return triangles, origin, divided
        divided += len(fans)
        triangles, origin = np.concatenate([triangles[keep], *fans]), np.concatenate([origin[keep], *origins])
        sound = _with_area(points, triangles)
        triangles, origin = triangles[sound], origin[sound]


def _turned(points, triangles):
    """(k,) bool: which triangles to reverse so that neighbours are oriented consistently.

    Each triangle is a node twice, as given and reversed; links join consistent nodes across an edge. Each sheet then
    has two components, mirror images of each other, unless it is one-sided. The one with the greater area as given is
    chosen.
    """
    k = len(triangles)
    first, second = paired_sides(*_sides(triangles)).T
    forward = (triangles < np.roll(triangles, -1, axis=1)).ravel()  # from the lower to the higher vertex
    agree = forward[first] != forward[second]
    first, second = first // 3, second // 3
    as_given = np.concatenate([first, first + k])
    partner = np.concatenate([np.where(agree, second, second + k), np.where(agree, second + k, second)])
    n_sets, label = components(as_given, partner, 2 * k)
    given, turned = label[:k], label[k:]
    if (given == turned).any():
        where = place_text(points[triangles[np.flatnonzero(given == turned)[0]]].mean(axis=0))
        raise ValueError(f"the sheet near {where} has one side only (a Möbius strip), hence no normals; cut it")
    area = np.linalg.norm(area_vectors(points[triangles]), axis=1)
    area_as_given = np.bincount(given, weights=area, minlength=n_sets)
    gain = area_as_given[turned] - area_as_given[given]
    return (gain > 0) | ((gain == 0) & (turned < given))
