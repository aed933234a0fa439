"""Freedoms in which neither slivers nor thin sheets cost digits.

In the axes of the scene every sum of the assembly keeps only the digits of its largest term. A sliver with sides h and
w ≪ h is stiffer than its neighbours by powers of h/w, and a sheet is stiffer in its plane than across by (h/t)².
Rounding then gives rigid motions and bending a false energy. Cholesky's method is indifferent to the scale of a
freedom, so it suffices to separate what is stiff from what is soft:

- Each vertex has axes of its own, the third along the normal of the sheet.
- The vertices at the ends of a short side have one set of absolute freedoms v = (u, θ) and one of relative ones,

      v_j = R_ji v_i + w_j,      R_ji v_i = (u_i + θ_i × d, θ_i),      d = x_j − x_i.                                (1)

  Clusters of them are joined the same way, shortest sides first. Vertex a is an ancestor of j if its freedoms enter
  v_j = Σ_a R_ja w_a.
- The energy of a triangle is that of the motions of two of its vertices relative to the third, i, an end of its
  shortest side, in the triangle's own axes: a part of its 18 × 18 matrix, which is computed there. The motions are
  sums over ancestors that are not shared, so that nothing large cancels:

      v_j − R_ji v_i = Σ_{a of j, not of i} R_ja w_a − Σ_{a of i, not of j} R_ja w_a.                                (2)

Nothing is neglected. A rigid rotation by θ still strains a stiffness of doubles by their rounding times θ, which costs
bending some 12 (L/t)² of it over the length L of a sheet. A thin sheet's matrices are therefore in extended precision,
with which :class:`fem_reference.shell.part.ShellPart` refines its solutions.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np
from scipy.sparse import bsr_matrix, csr_matrix

from mic.geometry.surface import Surface

__all__ = ["NARROW", "THIN", "LocalFreedoms", "local_freedoms"]

NARROW = 0.1  # the ends of a side shorter than this share of the longest side of its triangle form a cluster
THIN = 50.0  # sides over thickness beyond which a sheet has local freedoms without slivers, too, and solutions refined


@dataclass(frozen=True)
class LocalFreedoms:
    """Freedoms of the vertices of a surface.

    Attributes
    ----------
    surface : Surface
    ancestors : tuple of tuple of int
        Of each vertex, itself last.
    thin : bool
        Whether the sheet is thin: axes and matrices are then in extended precision.
    """

    surface: Surface
    ancestors: tuple[tuple[int, ...], ...]
    thin: bool

    @cached_property
    def _points(self) -> np.ndarray:
        return self.surface.points.astype(np.longdouble if self.thin else float)

    @property
    def _corners(self) -> np.ndarray:
        """(k, 3, 3) corners of each triangle in the order of :attr:`order`."""
        return self._points[np.take_along_axis(self.surface.triangles, self.order, axis=1)]

    @property
    def relative(self) -> np.ndarray:
        """(n,) bool: vertices whose own freedoms are relative."""
        return np.array([len(one) > 1 for one in self.ancestors])

    @cached_property
    def axes(self) -> np.ndarray:
        """(n, 3, 3) axes of each vertex as columns, the third the mean normal of its triangles."""
        surface = self.surface
        normal = np.zeros_like(self._points)
        for corner in range(3):
            np.add.at(normal, surface.triangles[:, corner], surface.normals * surface.areas[:, None])
        normal = _unit(normal)
        first = _unit(np.cross(normal, np.eye(3)[np.abs(normal).argmin(axis=1)]))
        return np.stack([first, np.cross(normal, first), normal], axis=2)

    @cached_property
    def order(self) -> np.ndarray:
        """(k, 3) corners of each triangle, from an end of its shortest side along that side."""
        start = (self.surface.edge_lengths.argmin(axis=1) + 1) % 3  # the side opposite to a corner begins at the next
        return (start[:, None] + np.arange(3)) % 3

    @cached_property
    def triangle_axes(self) -> np.ndarray:
        """(k, 3, 3) axes of each triangle as columns: along its shortest side, across, and its normal."""
        corner = self._corners
        along = _unit(corner[:, 1] - corner[:, 0])
        normal = _unit(np.cross(along, corner[:, 2] - corner[:, 0])) if self.thin else self.surface.normals
        return np.stack([along, np.cross(normal, along), normal], axis=2)

    @property
    def flattened(self) -> np.ndarray:
        """(k, 3, 3) corners of each triangle in its own axes, in the order of :attr:`order`."""
        corner = self._corners
        flat = ((corner - corner[:, :1]) @ self.triangle_axes).astype(float)
        flat[:, :, 2], flat[:, 1, 1] = 0.0, 0.0
        return flat

    def absolute(self) -> csr_matrix:
        """(6n, 6n) matrix that gives the freedoms along the scene's axes, in double precision."""
        rows = [(j, a, j, a, 1.0) for j, above in enumerate(self.ancestors) for a in above]
        return self._matrix(rows, np.broadcast_to(np.eye(3), (len(rows), 3, 3)), len(self.ancestors)).astype(float)

    def stiffness(self, blocks: np.ndarray) -> csr_matrix:
        """(6n, 6n) stiffness, from the matrices (k, 18, 18) of the flattened triangles."""
        rows, owner = [], []
        for e, (i, *others) in enumerate(np.take_along_axis(self.surface.triangles, self.order, axis=1).tolist()):
            for place, j in enumerate(others):
                of_j, of_i = self.ancestors[j], self.ancestors[i]
                new = [(2 * e + place, a, j, a, 1.0) for a in of_j if a not in of_i]
                new += [(2 * e + place, a, j, a, -1.0) for a in of_i if a not in of_j]
                rows += new
                owner += [e] * len(new)
        motion = self._matrix(rows, self.triangle_axes[owner], 2 * len(blocks))
        count, blocks = len(blocks), blocks[:, 6:, 6:].astype(self._points.dtype)
        middle = bsr_matrix((blocks, np.arange(count), np.arange(count + 1)), shape=(12 * count, 12 * count))
        return (motion.T @ (middle @ motion)).tocsr()

    def _matrix(self, rows: list[tuple[int, int, int, int, float]], axes: np.ndarray, height: int) -> csr_matrix:
        """Blocks ``factor · R_ja`` at given block rows and columns, read along axes (r, 3, 3)."""
        row, column, end, start, factor = (np.array(each) for each in zip(*rows))
        own, turn = self.axes[start], axes.transpose(0, 2, 1)
        d = self._points[end] - self._points[start]
        block = np.zeros((len(row), 6, 6), dtype=d.dtype)
        block[:, :3, :3] = block[:, 3:, 3:] = turn @ own
        block[:, :3, 3:] = turn @ np.cross(own, d[:, :, None], axis=1)  # θ × d
        entries = block * factor[:, None, None]
        places = (6 * row[:, None, None] + np.arange(6)[:, None], 6 * column[:, None, None] + np.arange(6))
        places = [np.broadcast_to(each, entries.shape).ravel() for each in places]
        return csr_matrix((entries.ravel(), tuple(places)), shape=(6 * height, 6 * len(self.ancestors)))


def _unit(vector: np.ndarray) -> np.ndarray:
    return vector / np.linalg.norm(vector, axis=-1, keepdims=True)


def local_freedoms(surface: Surface, thickness: float) -> LocalFreedoms | None:
    """Local freedoms of a surface of a thickness, mm; None if it has no short sides and is not thin.

    A cluster does not grow wider than a side of its triangles may be to be short.
    """
    length, ends = surface.edge_lengths, surface.triangles[:, [[1, 2], [2, 0], [0, 1]]]
    allowed = NARROW * np.broadcast_to(length.max(axis=1)[:, None], length.shape)
    short = length < allowed
    thin = bool(length.max() > THIN * thickness)
    if not (thin or short.any()):
        return None
    root, above, members = list(range(len(surface.points))), {}, {}
    ends, allowed = ends[short], allowed[short]
    for k in np.argsort(length[short], kind="stable"):
        first, second = (root[vertex] for vertex in ends[k].tolist())
        if first == second or np.linalg.norm(surface.points[first] - surface.points[second]) >= allowed[k]:
            continue
        above[second] = first
        members[first] = members.get(first, [first]) + members.pop(second, [second])
        for vertex in members[first]:
            root[vertex] = first
    ancestors = []
    for vertex in range(len(surface.points)):
        chain = [vertex]
        while chain[-1] in above:
            chain.append(above[chain[-1]])
        ancestors.append(tuple(chain[::-1]))
    return LocalFreedoms(surface, tuple(ancestors), thin)
