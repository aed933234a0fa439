"""Remove sliver elements, whose stiffness exceeds that of the sheet by so much that digits are lost.

A triangle with sides h and w ≪ h is stiffer than its neighbours by powers of h/w. The assembled sum keeps only the
digits of the larger term, so that rounding gives rigid motions of the part a strain energy. The two nodes at the ends
of w move together in any case. Collapsing w into a node m at its midpoint removes the sliver. With d = x_i − x_m, the
freedoms of the original nodes i are

    u_i = u_m + θ_m × d,      θ_i = θ_m,                                                                             (1)

so that functionals still read the original nodes, and a rigid motion of m is one of i.
"""

from __future__ import annotations

import numpy as np
from scipy.sparse import coo_matrix
from scipy.sparse.csgraph import connected_components

from mic.geometry.surface import Surface

__all__ = ["SLIVER", "without_slivers"]

SLIVER = 1e-3  # a side shorter than this share of the longest side of its triangle is collapsed
SMALLEST_COSINE = 0.9  # between the normals of a remaining triangle before and after


def without_slivers(surface: Surface) -> tuple[Surface, np.ndarray] | None:
    """The surface with the short sides of its slivers collapsed, and the new number (n,) of each vertex.

    No vertex moves by more than `SLIVER` times the longest side of the slivers at it.

    Returns
    -------
    tuple or None
        None if there are no slivers, or if the remaining triangles are not a valid mesh.
    """
    # sides opposite to the corners of each triangle, and their end vertices
    length, ends = surface.edge_lengths, surface.triangles[:, [[1, 2], [2, 0], [0, 1]]]
    longest = length.max(axis=1)
    short = length < SLIVER * longest[:, None]
    if not short.any():
        return None
    points, (first, second) = surface.points, ends[short].T
    n = len(points)
    _, together = connected_components(coo_matrix((np.ones(len(first)), (first, second)), (n, n)), directed=False)
    count = np.bincount(together)
    middle = np.stack([np.bincount(together, x) for x in points.T], axis=1) / count[:, None]
    allowed = np.zeros(n)
    np.maximum.at(
        allowed, ends[short].ravel(), np.repeat(SLIVER * np.broadcast_to(longest[:, None], short.shape)[short], 2)
    )
    if (np.linalg.norm(points - middle[together], axis=1) > allowed).any():
        return None  # many in a row, whose collapse would distort the mesh
    alone = count[together] == 1
    middle[together[alone]] = points[alone]  # to the last bit
    triangles = together[surface.triangles]
    kept = (triangles != np.roll(triangles, 1, axis=1)).all(axis=1)
    triangles = triangles[kept]
    if len(np.unique(triangles)) < len(middle) or len(np.unique(np.sort(triangles, axis=1), axis=0)) < len(triangles):
        return None
    given = surface.given_normals
    try:
        left = Surface(middle, triangles, None if given is None else given[kept])
    except ValueError:
        return None
    if (np.einsum("ij,ij->i", left.normals, surface.normals[kept]) < SMALLEST_COSINE).any():
        return None
    return left, together
