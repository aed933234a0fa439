"""Sheets as solids by CalculiX: quadrilaterals of a middle surface, drawn out through the thickness into C3D8I.

A node of the middle surface carries a column of nodes through the thickness, along its director d: the shortest vector
with n · d = 1 for the normals n of all elements at the node, so that elements on either side of a fold keep their
thickness and meet in its mitre. CalculiX gives the stiffness matrix; what else is read of a sheet are displacements of
nodes, averaged over discs.
"""

from __future__ import annotations

from collections.abc import Sequence
from functools import cached_property

import numpy as np
from scipy.sparse import csc_matrix, csr_matrix
from scipy.spatial import cKDTree

from fem_reference.peers.calculix import CalculixError, stiffness

__all__ = ["Sheet", "extruded", "graded"]

LINES = 16  # along and across an element, by whose crossings its share of a disc is counted
ALIKE = 1e-9  # normals that differ by less are one; a place so far beside an element, in its lengths, lies before it
NEAR, STEPS = 9, 6  # elements among which that below a place is looked for; of Newton's method


class Sheet:
    """A sheet of solids.

    Parameters
    ----------
    points : (n, 3) array
        Of the middle surface, mm.
    quads : (k, 4) int array
        Counter-clockwise about the normal.
    thickness, young, poisson : float
        mm, MPa, 1.
    layers : int
        Elements through the thickness, an even number.

    Attributes
    ----------
    nodes : (n (layers + 1), 3) array
        mm; node i of layer j has the number j n + i. Layers follow the normal.
    normals : (k, 3) array
        Of the quadrilaterals.

    Raises
    ------
    CalculixError
        When K is asked for.
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
        """(d, d) stiffness, N/mm, of nodes and of elements' own freedoms; ccx is called when it is first asked for."""
        return self._nominal[0]

    @cached_property
    def _nominal(self) -> tuple[csc_matrix, np.ndarray]:
        """K and the column (m, 3) of each freedom of the nodes."""
        K, freedom = self._stiffness(self.nodes)
        column = np.full((len(self.nodes), 3), -1)
        at_node = freedom[:, 0] <= len(self.nodes)
        column[freedom[at_node, 0] - 1, freedom[at_node, 1]] = np.flatnonzero(at_node)
        if (column < 0).any():
            raise CalculixError("ccx gave no stiffness for some nodes")
        return K, column

    def _stiffness(self, nodes: np.ndarray) -> tuple[csc_matrix, np.ndarray]:
        """K and whose its freedoms are, with these nodes (m, 3)."""
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
        """(d, d) K of the sheet whose nodes lie where a shape (d,) has moved them, mm; freedoms as before."""
        return self._stiffness(self.nodes + shape[self._nominal[1]])[0]

    @property
    def middle(self) -> int:
        """The layer of the middle surface."""
        return self.layers // 2

    def face(self, point, direction) -> int:
        """The layer of the face that looks along a direction where the middle surface is nearest to a point."""
        away = np.linalg.norm(self.points[self.quads].mean(axis=1) - point, axis=1)
        return self.layers if self.normals[away.argmin()] @ np.asarray(direction, float) > 0 else 0

    def onto(self, layer: int, places: np.ndarray) -> tuple[np.ndarray, csr_matrix, np.ndarray, np.ndarray]:
        """Which places (m, 3) lie before a face, and for these the weights (r, n) of its nodes, its normals (r, 3), and
        how far along these they lie from it (r,)."""
        corner = self.at(layer)[self.quads]
        tree = cKDTree(corner.mean(axis=1))
        near = tree.query(places, k=min(NEAR, len(corner)))[1].reshape(len(places), -1)
        found = np.full(len(places), -1)
        weight, height = np.zeros((len(places), 4)), np.zeros(len(places))
        for own in near.T:
            some = np.flatnonzero(found < 0)
            w, h = _below(corner[own[some]], self.normals[own[some]], places[some])
            hit = w.min(axis=1) >= -ALIKE
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
        """(r, d) weighted sums (r, n) of what a layer moves along a direction (3,), or each along its own (r, 3)."""
        weights = csr_matrix(weights).tocoo()
        direction = np.broadcast_to(np.asarray(direction, float), (weights.shape[0], 3))
        columns = self._nominal[1][layer * len(self.points) + weights.col]
        shape = weights.shape[0], self.K.shape[0]
        values = [weights.data * direction[weights.row, axis] for axis in range(3)]
        return csr_matrix(sum(csr_matrix((v, (weights.row, columns[:, a])), shape) for a, v in enumerate(values)))

    def mean(self, layer: int, point, radius: float, direction) -> csr_matrix:
        """(1, d) mean over a disc of what a layer moves along a direction.

        Raises
        ------
        ValueError
            If the sheet has nothing of the disc.
        """
        weight = self._disc(layer, point, radius)[0]
        if not weight.any():
            raise ValueError(f"no part of the sheet lies within {radius:g} mm of {tuple(point)}")
        return self.rows(layer, weight / weight.sum(), direction)

    def within(self, layer: int, point, radius: float) -> np.ndarray:
        """(n,) whether more than half of the cell about a node of a layer lies within a disc."""
        return self._disc(layer, point, radius)[1] > 0.5 * self.cells(layer)

    def cells(self, layer: int) -> np.ndarray:
        """(n,) areas of the cells about the nodes of a layer, mm²."""
        grid, area = self._crossings(layer, np.arange(len(self.quads)), 2)[1:]
        return np.bincount(self.quads.ravel(), (area @ _nearest(grid)).ravel(), len(self.points))

    def _crossings(
        self, layer: int, quads: np.ndarray, lines: int = LINES
    ) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Points (q, s, 3) of elements' faces, the weights (s, 4) of corners that give them, and areas (q, s)."""
        middle = (np.arange(lines) + 0.5) / lines
        x, y = (each.ravel() for each in np.meshgrid(middle, middle, indexing="ij"))
        grid = np.stack([(1 - x) * (1 - y), x * (1 - y), x * y, (1 - x) * y], -1)
        corner = self.at(layer)[self.quads[quads]]
        along = np.einsum("si,qid->qsd", np.stack([y - 1, 1 - y, y, -y], -1), corner)
        across = np.einsum("si,qid->qsd", np.stack([x - 1, -x, x, 1 - x], -1), corner)
        area = np.linalg.norm(np.cross(along, across), axis=2) / lines**2
        return np.einsum("si,qid->qsd", grid, corner), grid, area

    def _disc(self, layer: int, point, radius: float) -> tuple[np.ndarray, np.ndarray]:
        """(n,) areas of a disc, as corners' weights share them out, and as they lie in cells about the nodes, mm²."""
        point, corner = np.asarray(point, float), self.at(layer)[self.quads]
        size = np.linalg.norm(corner - corner.mean(axis=1, keepdims=True), axis=2).max(axis=1)
        near = np.flatnonzero(np.linalg.norm(corner.mean(axis=1) - point, axis=1) < radius + self.thickness + size)
        places, grid, area = self._crossings(layer, near)
        step = places - point
        along = np.einsum("qsd,qd->qs", step, self.normals[near])
        sideways = np.sqrt(np.maximum((step**2).sum(axis=2) - along**2, 0.0))
        area = np.where((sideways <= radius) & (np.abs(along) <= self.thickness), area, 0.0)
        own = self.quads[near].ravel()
        return tuple(np.bincount(own, (area @ by).ravel(), len(self.points)) for by in (grid, _nearest(grid)))


def _below(corner: np.ndarray, normal: np.ndarray, place: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Of each place (r, 3) above an element (r, 4, 3): weights (r, 4) of the corners below it, and its height (r,)."""
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
    """(s, 4) 1 for the corner that is nearest to a crossing, that is of the largest weight."""
    return np.eye(4)[grid.argmax(axis=1)]


def _normals(points: np.ndarray, quads: np.ndarray) -> np.ndarray:
    """(k, 3) unit normals."""
    a, b, c, d = points[quads].transpose(1, 0, 2)
    normal = np.cross(c - a, d - b)
    return normal / np.linalg.norm(normal, axis=1, keepdims=True)


def _directors(quads: np.ndarray, normals: np.ndarray, n: int) -> np.ndarray:
    """(n, 3) what a node's column is drawn along, by unit thickness."""
    found, of = normals[np.repeat(np.arange(len(quads)), 4)], quads.ravel()
    director = np.zeros((n, 3))
    np.add.at(director, of, found)
    director /= np.bincount(of, minlength=n)[:, None]
    folded = np.unique(of[np.linalg.norm(found - director[of], axis=1) > ALIKE])
    for node in folded:
        own = found[of == node]
        director[node] = np.linalg.pinv(own, rcond=1e-6) @ np.ones(len(own))
    return director


def extruded(profile: Sequence, x: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Points (n, 3) and quadrilaterals (k, 4) of a polyline of the (y, z) plane, extruded along x.

    Parameters
    ----------
    profile : (m, 2) array
        Every node of it, mm. Normals point along x cross its direction.
    x : (l,) array
        mm.
    """
    profile = np.asarray(profile, float)
    m, l = len(profile), len(x)
    points = np.column_stack([np.repeat(x, m), np.tile(profile, (l, 1))])
    a = (np.arange(l - 1)[:, None] * m + np.arange(m - 1)).ravel()
    return points, np.stack([a, a + m, a + m + 1, a + 1], -1)


def graded(knots, places, fine: float, coarse: float) -> np.ndarray:
    """Lines of a grid through all knots, mm: no farther apart than `fine` within stretches, than `coarse` elsewhere.

    Parameters
    ----------
    knots : sequence of float
    places : sequence of (float, float)
        Middle and half the length of each stretch.
    """
    stretches = [(middle - reach, middle + reach) for middle, reach in places]
    inner = [end for end in np.ravel(stretches) if min(knots) < end < max(knots)]
    knots = np.unique(np.round([*knots, *inner], 9))
    lines = []
    for a, b in zip(knots, knots[1:]):
        near = any(low < (a + b) / 2 < high for low, high in stretches)
        lines.append(np.linspace(a, b, int(np.ceil((b - a) / (fine if near else coarse) - 1e-9)) + 1))
    return np.unique(np.round(np.concatenate(lines), 9))
