"""A triangle mesh of half the size on the curved surface that its normals tell of.

The edge from x_i to x_j, L = x_j − x_i, is the Hermite cubic whose end tangents are L without its share across the
surface, T = L − P L, where P projects on the normals at that end: one on a smooth surface, two at a fold, whose line is
then tangent to both sheets. New vertices are the cubics' midpoints,

    x = ½ (x_i + x_j) + ⅛ (T_i − T_j),

equal for all triangles at the edge, and the normals there are the means of the ends' made normal to the cubic, whose
tangent is 3/2 L − ¼ (T_i + T_j). Normals that agree to `FOLD` count as one: P then takes their mean.

Where nothing is known beyond the mesh it stays as it is: in the sheet's own plane the border is a polygon, and a
hole's rim does not become rounder.
"""

from __future__ import annotations

import numpy as np

__all__ = ["halved"]

FOLD = np.radians(20.0)  # sheets that meet at a smaller angle are one smooth surface
EDGES = ((0, 1), (1, 2), (2, 0))


def halved(points: np.ndarray, triangles: np.ndarray, normals: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Divide every triangle into four.

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
        Oriented as those that they come from; triangle i becomes 4 i … 4 i + 3.
    normals : (4 k, 3, 3) array
    """
    triangles = np.asarray(triangles)
    sides = np.stack([triangles[:, edge] for edge in EDGES], axis=1)  # (k, 3, 2)
    edges, of_side = np.unique(np.sort(sides, axis=2).reshape(-1, 2), axis=0, return_inverse=True)
    of_side = of_side.reshape(-1, 3)
    L = points[edges[:, 1]] - points[edges[:, 0]]
    T = np.stack([L - _across(L, end, edges, sides, of_side, normals) for end in (0, 1)])
    middle = points[edges].mean(axis=1) + (T[0] - T[1]) / 8

    tangent = 1.5 * L - (T[0] + T[1]) / 4
    tangent /= np.linalg.norm(tangent, axis=1, keepdims=True)
    mean = np.stack([normals[:, i] + normals[:, j] for i, j in EDGES], axis=1)  # (k, 3, 3), one for each side
    along = tangent[of_side]
    mean = mean - (mean * along).sum(axis=2, keepdims=True) * along
    mean /= np.linalg.norm(mean, axis=2, keepdims=True)

    a, b, c = triangles.T
    ab, bc, ca = (len(points) + of_side).T
    children = np.stack([(a, ab, ca), (ab, b, bc), (ca, bc, c), (ab, bc, ca)]).transpose(2, 0, 1)
    (n_a, n_b, n_c), (n_ab, n_bc, n_ca) = normals.transpose(1, 0, 2), mean.transpose(1, 0, 2)
    turned = np.stack([(n_a, n_ab, n_ca), (n_ab, n_b, n_bc), (n_ca, n_bc, n_c), (n_ab, n_bc, n_ca)])
    return np.vstack([points, middle]), children.reshape(-1, 3), turned.transpose(2, 0, 1, 3).reshape(-1, 3, 3)


def _across(L, end, edges, sides, of_side, normals):
    """(e, 3) share of the edges L (e, 3) in the span of the normals that the triangles at each edge have at one end."""
    total = np.zeros((len(edges), 3, 3))
    for s, corners in enumerate(EDGES):
        first = sides[:, s, 0] == edges[of_side[:, s], end]
        n = np.where(first[:, None], normals[:, corners[0]], normals[:, corners[1]])
        np.add.at(total, of_side[:, s], n[:, :, None] * n[:, None, :])
    size, direction = np.linalg.eigh(total)  # of two normals at an angle φ: 1 ± cos φ
    kept = size > 1 - np.cos(FOLD)
    kept[:, 2] = True
    share = np.einsum("eic,ei->ec", direction, L) * kept
    return np.einsum("eic,ec->ei", direction, share)
