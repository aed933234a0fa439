"""Sheets of CalculiX solid elements: quadrilaterals of a middle surface, extruded through the thickness into C3D8I.

A node of the middle surface carries a column of nodes through the thickness, along its director d: the shortest vector
with n · d = 1 for the normals n of all elements at the node. Elements on either side of a fold so have the full
thickness and meet in a mitre. CalculiX provides the stiffness matrix; displacements are averaged over discs.
"""

from __future__ import annotations

from collections.abc import Sequence
from functools import cached_property

import numpy as np
from scipy.sparse import csc_matrix, csr_matrix
from scipy.spatial import cKDTree

from fem_reference.peers.calculix import CalculixError, stiffness

__all__ = ["Sheet", "extruded", "graded"]

LINES = 16  # sampling points along each side of an element, which measure the share of the element in a disc
TOLERANCE = 1e-9  # of normals that count as equal, and of element coordinates that count as inside the element
NEAREST, STEPS = 9, 6  # candidate elements for the projection of a point; iterations of Newton's method


class Sheet:
    """A sheet of solid elements.

    Parameters
    ----------
    points : (n, 3) array
        Nodes of the middle surface, mm.
    quads : (k, 4) int array
        Counter-clockwise about the normal.
    thickness, young, poisson : float
        mm, MPa, 1.
    layers : int
        Elements through the thickness, an even number.

    Attributes
    ----------
    nodes : (n (layers + 1), 3) array
        mm; node i of layer j has the number j n + i. Layers are ordered along the normal.
    normals : (k, 3) array
        Unit normals of the quadrilaterals.

    Raises
    ------
    CalculixError
        On the first use of K.
    """

    def __init__(self, points, quads, thickness: float, young: float, poisson: float, layers: int = 2):
        self.points, self.quads, self.layers = np.asarray(points, float), np.asarray(quads), layers
        self.thickness, self._material = thickness, (young, poisson)
        self.normals = _normals(self.points, self.quads)
        heights = np.linspace(-thickness / 2, thickness / 2, layers + 1)
        self.nodes = (self.points + heights[:, None, None] * _directors(self.quads, self.normals, len(points))).reshape(
            -1, 3
        )

    @cached_property
    def K(self) -> csc_matrix:
        """(d, d) stiffness of nodal and internal element freedoms, N/mm; computed by ccx on first use."""
        return self._nominal[0]

    @cached_property
    def _nominal(self) -> tuple[csc_matrix, np.ndarray]:
        """K and the column (m, 3) of each nodal freedom."""
        K, freedom = self._stiffness(self.nodes)
        column = np.full((len(self.nodes), 3), -1)
        at_node = freedom[:, 0] <= len(self.nodes)
        column[freedom[at_node, 0] - 1, freedom[at_node, 1]] = np.flatnonzero(at_node)
        if (column < 0).any():
            raise CalculixError("the stiffness matrix of ccx has no entries for some nodes")
        return K, column

    def _stiffness(self, nodes: np.ndarray) -> tuple[csc_matrix, np.ndarray]:
        """K and the (node, axis) of each freedom, for nodes at (m, 3)."""
        young, poisson = self._material
        lines = ["*NODE"]  # a number has 20 characters at most
        lines += [f"{n}, {a:.12g}, {b:.12g}, {c:.12g}" for n, (a, b, c) in enumerate(nodes.tolist(), start=1)]
        lines.append("*ELEMENT, TYPE=C3D8I, ELSET=SHEET")
        below = [self.quads + 1 + layer * len(self.points) for layer in range(self.layers)]
        elements = np.vstack([np.hstack([each, each + len(self.points)]) for each in below])
        lines += [", ".join(map(str, [n, *element])) for n, element in enumerate(elements.tolist(), start=1)]
        lines += ["*MATERIAL, NAME=STEEL", f"*ELASTIC\n{young!r}, {poisson!r}", "*DENSITY\n1e-9"]
        lines.append("*SOLID SECTION, ELSET=SHEET, MATERIAL=STEEL")
        return stiffness("\n".join(lines) + "\n")

    def deviated(self, shape: np.ndarray) -> csc_matrix:
        """(d, d) K of the sheet with its nodes displaced by a shape (d,), mm; the order of the freedoms is the same."""
        return self._stiffness(self.nodes + shape[self._nominal[1]])[0]

    @property
    def middle(self) -> int:
        """The layer of the middle surface."""
        return self.layers // 2

    def face(self, point, direction) -> int:
        """The layer of the outer face whose normal points along a direction, at the element nearest to a point."""
        away = np.linalg.norm(self.points[self.quads].mean(axis=1) - point, axis=1)
        return self.layers if self.normals[away.argmin()] @ np.asarray(direction, float) > 0 else 0

    def project(self, layer: int, places: np.ndarray) -> tuple[np.ndarray, csr_matrix, np.ndarray, np.ndarray]:
        """Project points (m, 3) onto a face along its normals.

        Returns the indices (r,) of the points that have a foot on the face, the weights (r, n) of its nodes, the
        normals (r, 3) and the heights (r,) of the points above the face.
        """
        corner = self.at(layer)[self.quads]
        tree = cKDTree(corner.mean(axis=1))
        near = tree.query(places, k=min(NEAREST, len(corner)))[1].reshape(len(places), -1)
        found = np.full(len(places), -1)
        weight, height = np.zeros((len(places), 4)), np.zeros(len(places))
        for own in near.T:
            some = np.flatnonzero(found < 0)
            w, h = _foot(corner[own[some]], self.normals[own[some]], places[some])
            hit = w.min(axis=1) >= -TOLERANCE
            found[some[hit]], weight[some[hit]], height[some[hit]] = own[some[hit]], w[hit], h[hit]
        hit = np.flatnonzero(found >= 0)
        own = found[hit]
        rows = np.repeat(np.arange(len(hit)), 4)
        weights = csr_matrix((weight[hit].ravel(), (rows, self.quads[own].ravel())), (len(hit), len(self.points)))
        return hit, weights, self.normals[own], height[hit]

    def at(self, layer: int) -> np.ndarray:
        """(n, 3) nodes of a layer, mm."""
        return self.nodes[layer * len(self.points) + np.arange(len(self.points))]

    def rows(self, layer: int, weights, direction) -> csr_matrix:
        """(r, d) rows: weighted sums (r, n) of a layer's displacements along one direction (3,) or one each (r, 3)."""
        weights = csr_matrix(weights).tocoo()
        direction = np.broadcast_to(np.asarray(direction, float), (weights.shape[0], 3))
        columns = self._nominal[1][layer * len(self.points) + weights.col]
        shape = weights.shape[0], self.K.shape[0]
        values = [weights.data * direction[weights.row, axis] for axis in range(3)]
        return csr_matrix(sum(csr_matrix((v, (weights.row, columns[:, a])), shape) for a, v in enumerate(values)))

    def mean(self, layer: int, point, radius: float, direction) -> csr_matrix:
        """(1, d) row of the mean displacement of a layer over a disc along a direction.

        Raises
        ------
        ValueError
            If no part of the sheet lies in the disc.
        """
        weight = self._disc(layer, point, radius)[0]
        if not weight.any():
            raise ValueError(f"no part of the sheet lies within {radius:g} mm of {tuple(point)}")
        return self.rows(layer, weight / weight.sum(), direction)

    def within(self, layer: int, point, radius: float) -> np.ndarray:
        """(n,) whether more than half of the cell around each node of a layer lies in a disc."""
        return self._disc(layer, point, radius)[1] > 0.5 * self.cells(layer)

    def cells(self, layer: int) -> np.ndarray:
        """(n,) areas of the cells around the nodes of a layer, mm²."""
        grid, area = self._sampling_points(layer, np.arange(len(self.quads)), 2)[1:]
        return np.bincount(self.quads.ravel(), (area @ _nearest(grid)).ravel(), len(self.points))

    def _sampling_points(
        self, layer: int, quads: np.ndarray, lines: int = LINES
    ) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Sampling points (q, s, 3) on element faces, their corner weights (s, 4), and their areas (q, s)."""
        middle = (np.arange(lines) + 0.5) / lines
        x, y = (each.ravel() for each in np.meshgrid(middle, middle, indexing="ij"))
        grid = np.stack([(1 - x) * (1 - y), x * (1 - y), x * y, (1 - x) * y], -1)
        corner = self.at(layer)[self.quads[quads]]
        along = np.einsum("si,qid->qsd", np.stack([y - 1, 1 - y, y, -y], -1), corner)
        across = np.einsum("si,qid->qsd", np.stack([x - 1, -x, x, 1 - x], -1), corner)
        area = np.linalg.norm(np.cross(along, across), axis=2) / lines**2
        return np.einsum("si,qid->qsd", grid, corner), grid, area

    def _disc(self, layer: int, point, radius: float) -> tuple[np.ndarray, np.ndarray]:
        """(n,) areas of a disc by node, mm²: shared out by the corner weights, and by the cells around the nodes."""
        point, corner = np.asarray(point, float), self.at(layer)[self.quads]
        size = np.linalg.norm(corner - corner.mean(axis=1, keepdims=True), axis=2).max(axis=1)
        near = np.flatnonzero(np.linalg.norm(corner.mean(axis=1) - point, axis=1) < radius + self.thickness + size)
        places, grid, area = self._sampling_points(layer, near)
        step = places - point
        along = np.einsum("qsd,qd->qs", step, self.normals[near])
        sideways = np.sqrt(np.maximum((step**2).sum(axis=2) - along**2, 0.0))
        area = np.where((sideways <= radius) & (np.abs(along) <= self.thickness), area, 0.0)
        own = self.quads[near].ravel()
        return tuple(np.bincount(own, (area @ by).ravel(), len(self.points)) for by in (grid, _nearest(grid)))


def _foot(corner: np.ndarray, normal: np.ndarray, place: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Corner weights (r, 4) of the foot of each point (r, 3) on its element (r, 4, 3), and its height (r,)."""
    x = y = np.full(len(place), 0.5)
    for _ in range(STEPS):
        grid = np.stack([(1 - x) * (1 - y), x * (1 - y), x * y, (1 - x) * y], -1)
        along = np.einsum("ri,rid->rd", np.stack([y - 1, 1 - y, y, -y], -1), corner)
        across = np.einsum("ri,rid->rd", np.stack([x - 1, -x, x, 1 - x], -1), corner)
        left = place - np.einsum("ri,rid->rd", grid, corner)
        step = np.linalg.solve(np.stack([along, across, normal], -1), left[:, :, None])[:, :, 0]
        x, y = x + step[:, 0], y + step[:, 1]
    grid = np.stack([(1 - x) * (1 - y), x * (1 - y), x * y, (1 - x) * y], -1)
    return grid, np.einsum("rd,rd->r", place - np.einsum("ri,rid->rd", grid, corner), normal)


def _nearest(grid: np.ndarray) -> np.ndarray:
    """(s, 4) 1 for the corner with the largest weight, which is the nearest one; 0 for the others."""
    return np.eye(4)[grid.argmax(axis=1)]


def _normals(points: np.ndarray, quads: np.ndarray) -> np.ndarray:
    """(k, 3) unit normals."""
    a, b, c, d = points[quads].transpose(1, 0, 2)
    normal = np.cross(c - a, d - b)
    return normal / np.linalg.norm(normal, axis=1, keepdims=True)


def _directors(quads: np.ndarray, normals: np.ndarray, n: int) -> np.ndarray:
    """(n, 3) directors of the nodes, by unit thickness."""
    found, of = normals[np.repeat(np.arange(len(quads)), 4)], quads.ravel()
    director = np.zeros((n, 3))
    np.add.at(director, of, found)
    director /= np.bincount(of, minlength=n)[:, None]
    folded = np.unique(of[np.linalg.norm(found - director[of], axis=1) > TOLERANCE])
    for node in folded:
        own = found[of == node]
        director[node] = np.linalg.pinv(own, rcond=1e-6) @ np.ones(len(own))
    return director


def extruded(profile: Sequence, x: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Points (n, 3) and quadrilaterals (k, 4) of a polyline of the (y, z) plane, extruded along x.

    Parameters
    ----------
    profile : (m, 2) array
        All its nodes, mm. Normals point along x cross its direction.
    x : (l,) array
        mm.
    """
    profile = np.asarray(profile, float)
    m, l = len(profile), len(x)
    points = np.column_stack([np.repeat(x, m), np.tile(profile, (l, 1))])
    a = (np.arange(l - 1)[:, None] * m + np.arange(m - 1)).ravel()
    return points, np.stack([a, a + m, a + m + 1, a + 1], -1)


def graded(knots, places, fine: float, coarse: float) -> np.ndarray:
    """Grid coordinates through all knots, mm, at most `fine` apart within the stretches and `coarse` elsewhere.

    Parameters
    ----------
    knots : sequence of float
    places : sequence of (float, float)
        Middle and half length of each stretch.
    """
    stretches = [(middle - reach, middle + reach) for middle, reach in places]
    inner = [end for end in np.ravel(stretches) if min(knots) < end < max(knots)]
    knots = np.unique(np.round([*knots, *inner], 9))
    lines = []
    for a, b in zip(knots, knots[1:]):
        near = any(low < (a + b) / 2 < high for low, high in stretches)
        lines.append(np.linspace(a, b, int(np.ceil((b - a) / (fine if near else coarse) - 1e-9)) + 1))
    return np.unique(np.round(np.concatenate(lines), 9))
