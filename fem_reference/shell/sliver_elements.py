"""Elements so narrow that their stiffness drowns that of the sheet, taken out of a mesh.

A triangle of sides h and w ≪ h is stiffer than its neighbours by powers of h/w, and the sum of both keeps the digits of
the larger alone: a rigid motion of the part costs energy, which is rounding. Its two nodes at the ends of w move as one
all the same. Where they are made one, the node m in their middle, nothing narrow is left, and with d = x_i − x_m

    u_i = u_m + θ_m × d,      θ_i = θ_m,                                                                             (1)

so that what reads the sheet at its own nodes reads it there as before, and a rigid motion of m is one of i.
"""

from __future__ import annotations

import numpy as np
from scipy.sparse import coo_matrix
from scipy.sparse.csgraph import connected_components

from mic.geometry.surface import Surface

__all__ = ["NEEDLE", "without_needles"]

NEEDLE = 1e-3  # a side that is shorter than this share of its triangle's longest has its ends made one
TURNED = 0.9  # cosine: what stays turns by less


def without_needles(surface: Surface) -> tuple[Surface, np.ndarray] | None:
    """The surface with the ends of its needles' short sides made one, and the new number (n,) of each of its vertices.

    No vertex moves by more than `NEEDLE` times the longest side of the needles at it.

    Returns
    -------
    tuple or None
        None where there are no needles, or where what is left would be no sound mesh.
    """
    # of each triangle the sides opposite to its corners, and their ends
    length, ends = surface.edge_lengths, surface.triangles[:, [[1, 2], [2, 0], [0, 1]]]
    longest = length.max(axis=1)
    short = length < NEEDLE * longest[:, None]
    if not short.any():
        return None
    points, (first, second) = surface.points, ends[short].T
    n = len(points)
    _, together = connected_components(coo_matrix((np.ones(len(first)), (first, second)), (n, n)), directed=False)
    count = np.bincount(together)
    middle = np.stack([np.bincount(together, x) for x in points.T], axis=1) / count[:, None]
    allowed = np.zeros(n)
    np.maximum.at(
        allowed, ends[short].ravel(), np.repeat(NEEDLE * np.broadcast_to(longest[:, None], short.shape)[short], 2)
    )
    if (np.linalg.norm(points - middle[together], axis=1) > allowed).any():
        return None  # many in a row, which would draw the mesh together
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
    if (np.einsum("ij,ij->i", left.normals, surface.normals[kept]) < TURNED).any():
        return None
    return left, together
