"""A rough stiffness of a sheet on its own mesh, without finite elements of a provider: what it gives is an estimate.

Triangles of constant membrane strain resist stretching. Bending follows from the turns θ_i of the hinges at the edges
of length l_i and in-plane normals m_i of a triangle of area A,

    κ = Σ_i l_i θ_i / (2 A) m_i m_iᵀ,

which is exact for a constant curvature if all diagonals of a grid run the same way; else twist is up to three times too
stiff. At free edges θ is 0.

References
----------
E. Oñate, F. Zárate: Rotation-free triangular plate and shell elements. *Int. J. Numer. Methods Eng.* 47 (2000),
557–603.
"""

from __future__ import annotations

from itertools import zip_longest

import numpy as np
from scipy.sparse import coo_matrix, csc_matrix, csr_matrix, vstack
from scipy.sparse.linalg import splu

from mic.geometry.surface import Surface

__all__ = ["HeldSheet"]

STIFF = 10.0  # of a support, relative to the stiffest degree of freedom


class HeldSheet:
    """A sheet on supports, and its response to forces.

    Parameters
    ----------
    surface : Surface
    thickness, young, poisson : float
        mm, MPa.
    points, directions : (s, 3) array
        Of the supports, which hold all rigid motions, mm.
    radii : sequence of float, optional
        Of the discs over which each support holds the mean displacement, mm; 0 by default.
    """

    def __init__(self, surface: Surface, thickness, young, poisson, points, directions, radii=()):
        self.surface = surface
        self._used = np.flatnonzero(np.repeat(np.isin(np.arange(len(surface.points)), surface.triangles), 3))
        K = _stiffness(surface, thickness, young, poisson)
        supports = self.rows(points, directions, radii)
        held = (K + STIFF * K.diagonal().max() * supports.T @ supports)[self._used][:, self._used]
        symmetric = {"SymmetricMode": True}
        self._solver = splu(csc_matrix(held), permc_spec="MMD_AT_PLUS_A", diag_pivot_thresh=0.0, options=symmetric)

    def rows(self, points: np.ndarray, directions: np.ndarray, radii=()) -> csr_matrix:
        """Rows (c, 3v) that read the displacement at points of the sheet (c, 3) along directions (c, 3)."""
        rows = []
        for point, direction, radius in zip_longest(points, directions, radii, fillvalue=0.0):
            patch = self.surface.patch(point, radius)
            values = (patch.weight[:, None] * patch.barycentric)[:, :, None] * np.asarray(direction)
            each = _rows(values, self.surface.triangles[patch.triangle], len(self.surface.points))
            rows.append(csr_matrix(each.sum(axis=0)))
        return vstack(rows, format="csr")

    def response(self, rows: csr_matrix) -> np.ndarray:
        """(3v, c) displacement of the vertices under unit forces that act on what rows (c, 3v) read, mm/N."""
        moved = np.zeros((rows.shape[1], rows.shape[0]))
        moved[self._used] = self._solver.solve(rows[:, self._used].T.toarray())
        return moved


def _stiffness(surface: Surface, thickness: float, young: float, poisson: float) -> csr_matrix:
    """(3v, 3v) stiffness: of membrane strains and of curvatures."""
    first = surface.corners[:, 1] - surface.corners[:, 0]
    e1 = first / np.linalg.norm(first, axis=1)[:, None]
    e2 = np.cross(surface.normals, e1)
    shear = young / (2 * (1 + poisson))
    K = 0
    for rows, depth in ((_strains(surface, e1, e2), thickness), (_curvatures(surface, e1, e2), thickness**3 / 12)):
        for B, modulus in zip(rows, (young / (2 * (1 - poisson)), shear, shear)):
            K = K + B.T @ B.multiply((modulus * depth * surface.areas)[:, None]).tocsr()
    return K


def _strains(surface: Surface, e1: np.ndarray, e2: np.ndarray) -> list[csr_matrix]:
    """Rows (k, 3v) of ε₁ + ε₂, ε₁ − ε₂ and γ of each triangle."""
    opposite = surface.corners[:, [2, 0, 1]] - surface.corners[:, [1, 2, 0]]
    gradient = np.cross(surface.normals[:, None], opposite) / (2 * surface.areas)[:, None, None]
    g1, g2 = (np.einsum("tci,ti->tc", gradient, axis)[:, :, None] for axis in (e1, e2))
    e1, e2 = e1[:, None], e2[:, None]
    strains = (g1 * e1 + g2 * e2, g1 * e1 - g2 * e2, g2 * e1 + g1 * e2)
    return [_rows(values, surface.triangles, len(surface.points)) for values in strains]


def _curvatures(surface: Surface, e1: np.ndarray, e2: np.ndarray) -> list[csr_matrix]:
    """Rows (k, 3v) of κ₁ + κ₂, κ₁ − κ₂ and 2 κ₁₂ of each triangle, from the turns of the hinges at its edges."""
    _, edge, count = surface.sides
    order = np.argsort(edge.ravel(), kind="stable")
    order = order[count[edge.ravel()[order]] == 2]
    triangle, opposite = (index.reshape(-1, 2) for index in np.divmod(order, 3))
    ends = surface.ends(triangle[:, 0], opposite[:, 0])
    a, b = surface.points[ends[:, 0]], surface.points[ends[:, 1]]
    length, tips = np.linalg.norm(b - a, axis=1), surface.triangles[triangle, opposite]
    turn = np.zeros((len(ends), 4, 3))
    for side in (0, 1):
        own = triangle[:, side]
        share = np.einsum("ij,ij->i", surface.points[tips[:, side]] - a, b - a) / length**2
        rise = surface.normals[own] * (length / (2 * surface.areas[own]))[:, None]
        turn[:, 2 + side] = rise
        turn[:, 0] -= (1 - share)[:, None] * rise
        turn[:, 1] -= share[:, None] * rise
    hinges = _rows(turn, np.column_stack([ends, tips]), len(surface.points))
    of, hinge = triangle.ravel(), np.repeat(np.arange(len(ends)), 2)
    along = ((b - a) / length[:, None])[hinge]
    c, s = (np.einsum("ij,ij->i", np.cross(surface.normals[of], along), axis[of]) for axis in (e1, e2))
    weight = length[hinge] / (2 * surface.areas[of])
    shape = (len(surface.triangles), len(ends))
    curvatures = (c**2 + s**2, c**2 - s**2, 2 * c * s)
    return [csr_matrix((weight * value, (of, hinge)), shape=shape) @ hinges for value in curvatures]


def _rows(values: np.ndarray, vertices: np.ndarray, count: int) -> csr_matrix:
    """Rows (k, 3 count) of values (k, m, 3) at vertices (k, m)."""
    columns = (3 * vertices[:, :, None] + np.arange(3)).ravel()
    row = np.repeat(np.arange(len(values)), 3 * vertices.shape[1])
    return coo_matrix((values.ravel(), (row, columns)), shape=(len(values), 3 * count)).tocsr()
