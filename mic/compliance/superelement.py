"""Parts given as a reduced stiffness K or compliance C on named nodes, from another finite-element program.

A functional is read at the superelement's own nodes: by interpolation within a mesh triangle if all its vertices are
such nodes, else at the nearest node through a rigid arm. With the shape functions b_i there, the point p on the
sheet's surface, and the nodes' points x_i,

    u(p) = Σ b_i u_i + (Σ b_i θ_i) × (p − Σ b_i x_i),

which is exact for every rigid motion. The readings L give H = L K⁻¹ Lᵀ on six pinned freedoms, or H = L C Lᵀ, and
G = L R with the rigid motions R of the nodes. The K of a free part resists none of them, K R = 0; this is checked.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from scipy.sparse import coo_matrix, csr_matrix, diags
from scipy.sparse.linalg import splu
from scipy.spatial import cKDTree

from mic.compliance.coefficients import InfluenceCoefficients
from mic.compliance.matrices import NodalMatrix
from mic.compliance.support import statically_determinate
from mic.errors import MissingProvider, SceneError
from mic.geometry.surface import Surface

__all__ = ["ELEMENT", "Superelement", "Superelements", "superelement"]

ELEMENT = "superelement"  #: the element of such parts
FREE = 1e-5  # allowed energy of K in a rigid motion, relative to that of its diagonal: rounding errors of the file
SINGULAR = 1e-11  # of the scaled diagonal: a smaller pivot is a further free motion
SAME = 1e-5  # relative to a part's diameter: nodes this near to a mesh vertex coincide with it


@dataclass(frozen=True)
class Superelement:
    """A part as a matrix on nodes, in mm, N and rad.

    Attributes
    ----------
    points : (n, 3) array
        Of the nodes.
    numbers : (n,) int array
        Node numbers in the file.
    freedom : (n, 6) int array
        Matrix row of each degree of freedom u_x, u_y, u_z, θ_x, θ_y, θ_z; -1 if the node lacks it.
    matrix : (m, m) csr_matrix
    stiffness : bool
        Whether the matrix is K; else it is C, on a statically determinate support.
    of_vertex : (v,) int array
        The node at each vertex of the part's surface; -1 for none.
    """

    points: np.ndarray
    numbers: np.ndarray
    freedom: np.ndarray
    matrix: csr_matrix
    stiffness: bool
    of_vertex: np.ndarray

    def rigid(self, centre: np.ndarray) -> np.ndarray:
        """(m, 6) R: translations along x, y, z and rotations about them through a centre."""
        modes = np.zeros((len(self.points), 6, 6))
        modes[:, :3, :3] = modes[:, 3:, 3:] = np.eye(3)
        for axis in range(3):
            modes[:, :3, 3 + axis] = np.cross(np.eye(3)[axis], self.points - centre)
        motions = np.zeros((self.matrix.shape[0], 6))
        present = self.freedom >= 0
        motions[self.freedom[present]] = modes[present]
        return motions

    def readings(self, part: Any) -> csr_matrix:
        """(F, m) L: readings of a part's functionals by degree of freedom.

        Raises
        ------
        SceneError
            If a patch has no node near it, or its node lacks a degree of freedom that is read.
        """
        f, surface = part.functionals, part.surface
        tree = cKDTree(self.points)
        rows, columns, values = [], [], []
        for row in range(len(f)):
            patch, d = f.patches[f.patch[row]], f.direction[row]
            nodes, share = self._interpolation(part, patch, tree, f.label[row])
            if f.rotation[row]:
                turns, moves = np.broadcast_to(d, (len(nodes), 3)), np.zeros(3)
            else:
                off = f.side[row] * part.thickness / 2 * surface.normals[patch.triangle]
                point = surface.at(patch.triangle, patch.barycentric) + off
                arm = point - np.einsum("qi,qij->qj", share, self.points[nodes])
                turns, moves = np.cross(arm, d), d
            for first, lever in ((0, np.broadcast_to(moves, (len(nodes), 3))), (3, turns)):
                value = (patch.weight[:, None] * share)[:, :, None] * lever[:, None, :]
                freedom = self.freedom[nodes][:, :, first : first + 3]
                read = np.abs(value) > 1e-12 * max(1.0, np.abs(lever).max(initial=0.0)) * np.abs(patch.weight).max()
                if (freedom[read] < 0).any():
                    at, corner, axis = (index[0] for index in np.nonzero(read & (freedom < 0)))
                    raise SceneError(
                        f"part {part.name!r}: {f.label[row]} reads degree of freedom {first + axis + 1} of node "
                        f"{self.numbers[nodes[at, corner]]}, which the superelement does not have; retain it"
                    )
                rows.append(np.full(int(read.sum()), row))
                columns.append(freedom[read])
                values.append(value[read])
        entries = [np.concatenate(one) if one else np.zeros(0) for one in (values, rows, columns)]
        shape = (len(f), self.matrix.shape[0])
        return coo_matrix((entries[0], (entries[1].astype(int), entries[2].astype(int))), shape=shape).tocsr()

    def _interpolation(self, part, patch, tree, label):
        """Nodes (q, 3) between which each point of a patch is interpolated, and their weights."""
        surface = part.surface
        nodes, share = self.of_vertex[surface.triangles[patch.triangle]], patch.barycentric.copy()
        lacking = ((nodes < 0) & (np.abs(share) > 1e-12)).any(axis=1)
        if lacking.any():
            points = surface.at(patch.triangle, patch.barycentric)
            centre = points.mean(axis=0)
            size = np.linalg.norm(points - centre, axis=1).max()
            away, nearest = tree.query(points)
            if away.min() > size + SAME * surface.diameter + part.thickness:
                number, distance = self.numbers[nearest[np.argmin(away)]], away.min()
                where = ", ".join(f"{x:.1f}" for x in centre)
                raise SceneError(
                    f"part {part.name!r}: {label} is read at ({where}), where the superelement has no node: "
                    f"{number} is the nearest, {distance:.3g} mm away; retain a node there, or move it onto one"
                )
            nodes = nodes.copy()
            nodes[lacking], share[lacking] = np.column_stack([nearest] * 3)[lacking], [1.0, 0.0, 0.0]
        return np.where(nodes < 0, 0, nodes), share


def superelement(
    name: str, given: NodalMatrix, stiffness: bool, unit: tuple[float, float], drawn: Surface, numbered: dict[int, Any]
) -> Superelement:
    """A superelement from a matrix, in mm and N, with its nodes located on the part's surface.

    Parameters
    ----------
    name : str
        Of the part, for messages.
    given : NodalMatrix
    stiffness : bool
        Whether it is a stiffness, else a compliance.
    unit : tuple of float
        mm and MPa of the file's units of length and stress (`mic.geometry.deck.UNITS`).
    drawn : Surface
        The part's mesh as drawn, mm.
    numbered : dict of int to (3,) array
        Points of the nodes of the part's mesh file by number, mm.

    Raises
    ------
    SceneError
        If the coordinates of a node are unknown, or the matrix is not that of a free elastic body.
    """
    length, stress = unit
    key = "stiffness" if stiffness else "compliance"
    numbers = np.unique(given.node)
    places = numbered | {number: length * np.array(place) for number, place in given.places.items()}
    unknown = [number for number in numbers.tolist() if number not in places]
    if unknown:
        raise SceneError(
            f"part {name!r}: {key}: the coordinates of node {unknown[0]} are unknown: it is neither in a node table "
            "beside the file nor a node of the mesh; add the table, node, x, y, z"
        )
    points = np.array([places[number] for number in numbers.tolist()])
    # an energy of K is in N mm when displacements are in mm
    force = stress * length**2
    scale = np.where(given.component < 3, length, 1.0)
    scaling = diags(1 / scale if stiffness else scale)
    scaled = scaling @ given.matrix @ scaling
    matrix = csr_matrix(scaled * (force * length) if stiffness else scaled / (force * length))
    if (matrix.diagonal() < 0).any():
        raise SceneError(
            f"part {name!r}: {key}: its diagonal has negative entries, which no elastic body has; export it again"
        )
    used = np.full(len(given.node), True)
    if stiffness:  # drop degrees of freedom without stiffness, such as rotations of solids
        used = np.asarray(abs(matrix).sum(axis=1)).ravel() > 0
    matrix, freedom = matrix[used][:, used], np.full((len(numbers), 6), -1)
    freedom[np.searchsorted(numbers, given.node[used]), given.component[used]] = np.arange(used.sum())
    away, nearest = cKDTree(points).query(drawn.points)
    of_vertex = np.where(away <= SAME * drawn.diameter, nearest, -1)
    body = Superelement(points, numbers, freedom, matrix, stiffness, of_vertex)
    if stiffness:
        _check_free(name, body)
    return body


def _check_free(name: str, body: Superelement) -> None:
    """Refuse a stiffness that resists rigid motions."""
    R = body.rigid(body.points.mean(axis=0))
    share = np.abs((R * (body.matrix @ R)).sum(axis=0)) / (body.matrix.diagonal() @ R**2)
    worst = int(np.argmax(share))
    if share[worst] > FREE:
        motion = ("translation along", "rotation about")[worst // 3] + f" {'xyz'[worst % 3]}"
        raise SceneError(
            f"part {name!r}: stiffness: it resists a rigid {motion} by {share[worst]:.2g} of its diagonal, and that of "
            "a free part does not: export it without supports, in the coordinates and the unit of its nodes"
        )


class Superelements:
    """The provider of parts that are superelements."""

    elements = (ELEMENT,)

    def accepts(self, part: Any) -> bool:
        """Whether the part is one."""
        return part.superelement is not None

    def coefficients(self, parts: Any, comm: Any = None) -> dict[str, InfluenceCoefficients]:
        """Coefficients by part name; every process computes all of them, with one small factorisation each.

        Raises
        ------
        SceneError
            If a patch has no node near it, or a stiffness leaves other than rigid motions free.
        """
        coefficients = {}
        for part in parts:
            body = part.superelement
            L, R = body.readings(part), body.rigid(part.surface.centroid)
            H = _solved(part.name, body, L, R) if body.stiffness else (L @ body.matrix @ L.T).toarray()
            provenance = {"element": ELEMENT, "nodes": len(body.points), "triangles": len(part.surface.triangles)}
            coefficients[part.name] = InfluenceCoefficients(part.name, 0.5 * (H + H.T), L @ R, provenance)
        return coefficients

    def field(self, part: Any, forces: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Refused: a superelement has displacements at its own nodes only."""
        raise MissingProvider(f"part {part.name!r}: a superelement has no displacement field; leave report.fields out")


def _solved(name: str, body: Superelement, L: csr_matrix, R: np.ndarray) -> np.ndarray:
    """(F, F) L K⁻¹ Lᵀ on six pinned displacements, with the diagonal scaled to one."""
    moves = np.sort(body.freedom[:, :3][body.freedom[:, :3] >= 0])
    size = np.repeat([1.0, max(float(np.ptp(body.points, axis=0).max()), 1e-9)], 3)
    pinned = moves[statically_determinate(R[moves], size)]
    free = np.setdiff1d(np.arange(body.matrix.shape[0]), pinned)
    K = body.matrix[free][:, free]
    scale = diags(1 / np.sqrt(K.diagonal()))
    try:
        # in symmetric mode the pivots come from the diagonal: their signs are those of the eigenvalues
        options: Any = {"permc_spec": "MMD_AT_PLUS_A", "diag_pivot_thresh": 0.0, "options": {"SymmetricMode": True}}
        factor = splu((scale @ K @ scale).tocsc(), **options)
        pivot = factor.U.diagonal()
    except RuntimeError:
        pivot = np.zeros(1)
    if np.abs(pivot).min() < SINGULAR:
        raise SceneError(
            f"part {name!r}: stiffness: it leaves more motions free than the six of a rigid body: a node is "
            "unconnected, or the part is in pieces; retain the connecting nodes"
        )
    if pivot.min() < 0:
        raise SceneError(f"part {name!r}: stiffness: it is negative for some motion; export it again")
    load = (L[:, free] @ scale).T.toarray()
    return load.T @ factor.solve(load)
