r"""Random fields on a sheet: Matérn correlation by the Laplacian of the surface.

A field x on the surface with

.. math::  (κ² - Δ)\, x = \mathcal W,        \qquad ∂x/∂n = 0 \text{ at the border},

𝒲 white noise, is Gaussian; on a plane its correlation over a distance r is Matérn's with ν = 1,

.. math::  ρ(r) = κ r\, K_1(κ r),            \qquad κ = \sqrt 8 / L,                                   (1)

which has fallen to 0.14 at the correlation length L. On the triangles of the mesh, with the mass M and the stiffness K
of linear elements, ``A = κ² M + K`` and the covariance of the vertices is ``A⁻¹ M A⁻¹`` up to a factor. The field
follows the sheet round its bends and ends at its holes, and only the required columns are computed. At the border the
variance would double: every point is scaled to the same variance. Linear elements leave out variation between their
vertices, which makes points more alike than (1), by 0.02 to 0.05 for elements of a tenth to a quarter of L: the mesh is
halved until elements are a twentieth of L, with an error below 0.01.

Along a direction d, projected into the sheet, the correlation length may be s L instead:
:math:`(κ² - ∇·(1 + (s² - 1)\, d dᵀ)∇)\, x = \mathcal W`, which is (1) of the distance with its component along d
divided by s. Where d is perpendicular to the sheet the field is isotropic.

References
----------
F. Lindgren, H. Rue, J. Lindström: An explicit link between Gaussian fields and Gaussian Markov random fields: the
stochastic partial differential equation approach. *J. R. Stat. Soc. B* 73 (2011).
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from scipy.sparse import coo_matrix, csc_matrix
from scipy.sparse.linalg import splu

from mic.geometry.refinement import halved
from mic.geometry.surface import Surface

__all__ = ["correlation", "modes_of"]

PERPENDICULAR = 0.1  # cosine between a direction and a sheet below which the field is isotropic
BLOCK = 64  # columns that are solved together
RESOLVED = 20.0  # elements within the shortest correlation length
LARGEST = 400_000  # largest number of triangles after halving


def correlation(
    surface: Surface,
    vertices: np.ndarray,
    length: float,
    direction: Sequence[float] | None = None,
    stretch: float = 1.0,
) -> np.ndarray:
    """(c, c) correlation of the field at vertices of a surface.

    Parameters
    ----------
    surface : Surface
    vertices : (c,) int array
    length : float
        Correlation length L, mm.
    direction : (3,) array, optional
        d; projected into each triangle.
    stretch : float
        s: the correlation length along d, as a multiple of L.
    """
    κ = np.sqrt(8.0) / length
    surface = _fine_mesh(surface, length * min(1.0, stretch))
    K, M = _laplacian(surface, direction, stretch)
    used = M.diagonal() > 0.0  # vertices without triangles are left out
    number = np.cumsum(used) - 1
    K, M = K[used][:, used], M[used][:, used]
    solver = splu(csc_matrix(κ**2 * M + K))
    columns = np.zeros((M.shape[0], len(vertices)))
    for first in range(0, len(vertices), BLOCK):
        some = number[vertices[first : first + BLOCK]]
        unit = np.zeros((M.shape[0], len(some)))
        unit[some, np.arange(len(some))] = 1.0
        columns[:, first : first + BLOCK] = solver.solve(unit)
    covariance = columns.T @ (M @ columns)
    scale = 1.0 / np.sqrt(np.diag(covariance))
    return scale[:, None] * covariance * scale


def _fine_mesh(surface: Surface, shortest: float) -> Surface:
    """A mesh of the same surface whose elements resolve a length, mm; the original vertices come first."""
    points, triangles, normals = surface.points, surface.triangles, None
    edge = float(np.median(surface.edge_lengths))
    while shortest < RESOLVED * edge and 4 * len(triangles) <= LARGEST:
        normals = surface.corner_normals if normals is None else normals
        points, triangles, normals = halved(points, triangles, normals)
        edge /= 2
    return surface if normals is None else Surface(points, triangles)


def _laplacian(surface: Surface, direction, stretch: float):
    """Stiffness and mass (n, n) of the surface's linear triangles, for ``∫∇x·∇y`` and ``∫x y``.

    A triangle of area A with edges e_i opposite to its corners has the stiffness ``e_i·e_j / 4A`` and the mass
    ``(1 + δ_ij) A/12``. A lumped mass would triple the error of the correlation. The gradient of the shape function of
    corner i is ``n × e_i / 2A``, so that d adds ``(s² − 1) (d·n×e_i)(d·n×e_j) / 4A``.
    """
    corners, triangles, n = surface.corners, surface.triangles, len(surface.points)
    edges = corners[:, [2, 0, 1]] - corners[:, [1, 2, 0]]
    values = np.einsum("tic,tjc->tij", edges, edges) / (4.0 * surface.areas)[:, None, None]
    if direction is not None:
        n_t = surface.normals
        d = np.asarray(direction, dtype=float) - (n_t @ np.asarray(direction, dtype=float))[:, None] * n_t
        size = np.linalg.norm(d, axis=1, keepdims=True)
        d = np.where(size > PERPENDICULAR, d / np.maximum(size, PERPENDICULAR), 0.0)
        slope = np.einsum("tc,tic->ti", d, np.cross(n_t[:, None], edges))
        values += (stretch**2 - 1) * slope[:, :, None] * slope[:, None] / (4.0 * surface.areas)[:, None, None]
    rows, columns = np.repeat(triangles, 3, axis=1).ravel(), np.tile(triangles, 3).ravel()
    mass = surface.areas[:, None, None] / 12.0 * (1.0 + np.eye(3))
    return tuple(coo_matrix((entries.ravel(), (rows, columns)), shape=(n, n)).tocsr() for entries in (values, mass))


def modes_of(correlation: np.ndarray, share: float) -> np.ndarray:
    """(c, k) principal modes of a correlation matrix: as few as hold a share of the variance of every point.

    Every point is scaled to variance 1; ``Φ Φᵀ`` then equals the correlation within ``2 (1 − share)``.
    """
    value, vector = np.linalg.eigh(correlation)
    value, vector = value[::-1].clip(0.0), vector[:, ::-1]
    modes = vector * np.sqrt(value)
    least = np.cumsum(modes**2, axis=1).min(axis=0)
    count = min(int(np.searchsorted(least, share)) + 1, len(value))
    modes = modes[:, :count]
    sign = np.where(modes[np.argmax(np.abs(modes), axis=0), np.arange(count)] < 0, -1.0, 1.0)
    return sign * modes / np.linalg.norm(modes, axis=1)[:, None]
