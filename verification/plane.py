"""Elastic bodies in plane strain or of revolution, reduced to their contacts: for benchmarks that are no sheets.

A body is meshed by triangles with quadratic displacements (dolfinx). Of the whole it is what the contacts see that is
kept: with the rows ``R`` that read displacements at nodes, ``R u = H f + U p + G d`` under forces f in the rows, loads
p and displacements d of what is steered. Two bodies that face each other node by node make the contact problem
``δ = S f + b`` of :mod:`mic.contact`, with a second tangent that nothing moves.

A body that no support holds is *steered*: its displacement along a direction, weighted as the load that acts there, is
an unknown d, and the load F along it is given. A spring k that is soft beside the contacts stands in for it,
``k d = F + Gᵀ f``, so that the contact solver sees ``S + G Gᵀ/k``; its load is then put right by k d.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import scipy.sparse as sp
import ufl
from mpi4py import MPI
from dolfinx import fem
from petsc4py import PETSc
from scipy.sparse.linalg import splu

from fem_reference.shell import compat
from mic.contact import ContactSolver
from mic.contact.path import Followed, Increments

__all__ = ["PATH", "Body", "Pairs", "Reduced", "followed", "graded", "rectangle"]

PATH = 1e-3  # of the follower; a tenth of it moves no figure of the study by more than 2e-5
SOFT = 1e-4  # stiffness of the spring that stands in for a load, over that of the contacts


class Body:
    """A body of quadratic triangles.

    Parameters
    ----------
    points : (n, 2) array
        Corners, mm; of a body of revolution (r, z).
    triangles : (c, 3) int array
    young, poisson : float
        MPa, 1.
    revolved : bool
        Whether it is a body of revolution, forces being those of the whole circle; else in plane strain, forces being
        those of a slice of 1 mm.

    Attributes
    ----------
    nodes : (k, 2) array
        Corners and middles of edges, mm. Freedoms are numbered node by node.
    """

    def __init__(self, points, triangles, young: float, poisson: float, revolved: bool = False):
        points = np.column_stack([points, np.zeros(len(points))])
        mesh = compat.shell_mesh(MPI.COMM_SELF, points, triangles)
        space = compat.quadratic_plane(mesh)
        self.nodes, self.revolved = space.tabulate_dof_coordinates()[:, :2].copy(), revolved
        u, v = ufl.TrialFunction(space), ufl.TestFunction(space)
        shear = fem.Constant(mesh, PETSc.ScalarType(young / (2 * (1 + poisson))))
        bulk = fem.Constant(mesh, PETSc.ScalarType(young * poisson / ((1 + poisson) * (1 - 2 * poisson))))
        radius = ufl.SpatialCoordinate(mesh)[0]

        def strain(w):
            g = ufl.grad(w)
            around = w[0] / radius if revolved else 0 * w[0]
            half = (g[0, 1] + g[1, 0]) / 2
            return ufl.as_matrix([[g[0, 0], half, 0], [half, g[1, 1], 0], [0, 0, around]])

        a, b = strain(u), strain(v)
        energy = bulk * ufl.tr(a) * ufl.tr(b) + 2 * shear * ufl.inner(a, b)
        form = energy * (2 * np.pi * radius if revolved else 1) * ufl.dx(metadata={"quadrature_degree": 4})
        matrix = compat.assemble_matrix(form)
        start, columns, values = matrix.getValuesCSR()
        self.stiffness = sp.csr_matrix((values, columns, start), shape=matrix.size)

    def along(self, on, order=0) -> np.ndarray:
        """Nodes where ``on(x, y)`` holds, by their coordinate `order`."""
        found = np.flatnonzero(on(*self.nodes.T))
        return found[np.argsort(self.nodes[found, order])]

    def side(self, axis: int, value: float) -> np.ndarray:
        """Nodes whose coordinate `axis` has a value, by their other coordinate."""
        return self.along(lambda *place: abs(place[axis] - value) < 1e-9, order=1 - axis)

    @staticmethod
    def freedoms(nodes) -> np.ndarray:
        """Both freedoms of each node, node by node."""
        return (2 * np.asarray(nodes)[:, None] + [0, 1]).ravel()

    def pressed(self, chain, direction) -> np.ndarray:
        """Forces (freedoms,) of a unit traction along `direction` (2,) on the edges of a chain of nodes that starts at
        a corner."""
        load = np.zeros((len(self.nodes), 2))
        for i in range(0, len(chain) - 2, 2):
            edge = chain[i : i + 3]
            length = np.linalg.norm(self.nodes[edge[2]] - self.nodes[edge[0]])
            circle = 2 * np.pi * self.nodes[edge, 0] if self.revolved else 1.0
            load[edge] += (length * np.array([1, 4, 1]) / 6 * circle)[:, None] * direction
        return load.ravel()

    def springs(self, nodes, component: int, stiffness: float) -> None:
        """Support nodes by springs, N/mm each."""
        diagonal = np.zeros(2 * len(self.nodes))
        diagonal[2 * np.asarray(nodes) + component] = stiffness
        self.stiffness = self.stiffness + sp.diags(diagonal)

    def rows(self, nodes, normal_first: bool = False) -> sp.csr_matrix:
        """Rows that read both components at nodes, node by node: x and y, or y and x."""
        columns = self.freedoms(nodes)
        if normal_first:
            columns = columns.reshape(-1, 2)[:, ::-1].ravel()
        return sp.csr_matrix(
            (np.ones(len(columns)), (np.arange(len(columns)), columns)), (len(columns), 2 * len(self.nodes))
        )

    def reduced(self, rows, held=(), loads=(), steered=()) -> Reduced:
        """Compliance of the body with respect to rows.

        Parameters
        ----------
        rows : (k, freedoms) sparse matrix
        held : sequence of int
            Freedoms that do not move.
        loads : sequence of (freedoms,) arrays
        steered : sequence of (freedoms,) arrays
            Loads of resultant 1 whose work-conjugate displacement is prescribed.
        """
        free = np.setdiff1d(np.arange(2 * len(self.nodes)), held)
        border = sp.csc_matrix(np.array(steered).reshape(len(steered), -1).T[free]) if len(steered) else None
        K = self.stiffness[free][:, free].tocsc()
        if border is not None:
            K = sp.bmat([[K, border], [border.T, None]], format="csc")
        solve, n, s = splu(K, permc_spec="MMD_AT_PLUS_A").solve, len(free), len(steered)
        R = sp.hstack([rows[:, free], sp.csr_matrix((rows.shape[0], s))]).tocsr()
        H = R @ solve(R.T.toarray())
        given = np.zeros((n + s, len(loads)))
        given[:n] = np.array(loads).reshape(len(loads), -1).T[free] if len(loads) else 0.0
        steer = np.vstack([np.zeros((n, s)), np.eye(s)])
        return Reduced(
            0.5 * (H + H.T), R @ solve(given) if len(loads) else given[:0], R @ solve(steer) if s else steer[:0]
        )


@dataclass(frozen=True)
class Reduced:
    """Readings of k rows of a body, ``H f + U p + G d``, mm and N."""

    H: np.ndarray
    U: np.ndarray
    G: np.ndarray


@dataclass(frozen=True)
class Pairs:
    """A contact problem in the plane, m pairs.

    Attributes
    ----------
    S : (2m, 2m) array
        Compliance, normal and tangential rows alternate, mm/N.
    b : (2m,) array
        Gap and offset without forces, mm.
    G : (2m, s) array
        Effect of steered displacements, mm/mm.
    """

    S: np.ndarray
    b: np.ndarray
    G: np.ndarray

    def solver(self, mu, soft: float) -> ContactSolver:
        """Contact solver of the problem, with steered loads applied through springs `soft` (N/mm)."""
        m = len(self.b) // 2
        S = np.zeros((m, 3, m, 3))
        S[:, :2, :, :2] = (self.S + self.G @ self.G.T / soft).reshape(m, 2, m, 2)
        S[np.arange(m), 2, np.arange(m), 2] = np.diag(self.S)[1::2].mean()
        return ContactSolver(S.reshape(3 * m, 3 * m), mu, semidefinite=True)


def followed(pairs: Pairs, mu: float, legs, steered=None, tolerance: float = PATH) -> tuple[np.ndarray, np.ndarray]:
    """Solve a sequence of loads.

    Parameters
    ----------
    pairs : Pairs
    mu : float
    legs : (q, 2m) array
        Change of b by the loads at the end of each leg, mm.
    steered : (q, s) array
        Steered loads at the end of each leg, N.
    tolerance : float
        Tolerance of the path with friction, as in :class:`mic.contact.path.Followed`.

    Returns
    -------
    force, displacement : (2m,) arrays
        At the end, N and mm.

    Raises
    ------
    ArithmeticError
        If the contact solver does not converge.
    """
    m, s, legs = len(pairs.b) // 2, pairs.G.shape[1], np.asarray(legs, dtype=float)
    soft = SOFT / np.diag(pairs.S).mean()
    solver = pairs.solver(mu, soft)
    given = np.zeros((len(legs), s)) if steered is None else np.asarray(steered, dtype=float)
    motion = np.zeros((len(legs), s))
    path = Followed(tolerance=tolerance) if mu else Increments(1)
    for _ in range(2 if s else 1):
        b = np.zeros((1, len(legs) + 1, m, 3))
        b[0, 0, :, :2] = pairs.b.reshape(m, 2)
        for q, leg in enumerate(legs):
            b[0, q + 1, :, :2] = (pairs.b + leg + pairs.G @ (given[q] + soft * motion[q]) / soft).reshape(m, 2)
        solved = solver.follow(b.reshape(1, len(legs) + 1, 3 * m), path=path)
        if not solved.converged.all():
            raise ArithmeticError(f"the contacts did not converge (residual {solved.residual.max():.1e})")
        force, shift = (x.reshape(m, 3)[:, :2].ravel() for x in (solved.force[0], solved.displacement[0]))
        if s:
            end = (given[-1] + soft * motion[-1] + pairs.G.T @ force) / soft
            # loads of one direction: to the accuracy of a soft spring, its displacement is proportional to the load
            motion = np.where(given[-1] != 0, given / np.where(given[-1] != 0, given[-1], 1.0), 1.0) * end
    return force, shift


def rectangle(x, y) -> tuple[np.ndarray, np.ndarray]:
    """Points and triangles of a grid between the coordinates x and y, with alternating diagonals."""
    x, y = np.asarray(x), np.asarray(y)
    points = np.array([(xi, yj) for yj in y for xi in x])
    triangles, n = [], len(x)
    for j in range(len(y) - 1):
        for i in range(n - 1):
            a, b, c, d = j * n + i, j * n + i + 1, (j + 1) * n + i + 1, (j + 1) * n + i
            triangles += [(a, b, c), (a, c, d)] if (i + j) % 2 else [(a, b, d), (b, c, d)]
    return points, np.array(triangles)


def graded(outline, sizes, undivided: int) -> tuple[np.ndarray, np.ndarray]:
    """Points and triangles of a graded mesh within an outline whose corners are all nodes.

    Parameters
    ----------
    outline : (k, 2) array
        Corners in order, the first at a contact.
    sizes : (k,) array
        Element size at each corner, mm.
    undivided : int
        Number of sides from the first corner that are single element edges.
    """
    import gmsh

    gmsh.initialize(interruptible=False)
    try:
        gmsh.option.setNumber("General.Terminal", 0)
        gmsh.option.setNumber("Mesh.Algorithm", 6)
        corner = [gmsh.model.geo.addPoint(x, y, 0, h) for (x, y), h in zip(outline, sizes)]
        side = [gmsh.model.geo.addLine(a, b) for a, b in zip(corner, np.roll(corner, -1))]
        for line in side[:undivided]:
            gmsh.model.geo.mesh.setTransfiniteCurve(line, 2)
        gmsh.model.geo.addPlaneSurface([gmsh.model.geo.addCurveLoop(side)])
        gmsh.model.geo.synchronize()
        gmsh.model.mesh.generate(2)
        tags, points, _ = gmsh.model.mesh.getNodes()
        number = np.zeros(int(tags.max()) + 1, dtype=int)
        number[tags.astype(int)] = np.arange(len(tags))
        triangles = number[gmsh.model.mesh.getElementsByType(2)[1].astype(int)].reshape(-1, 3)
        return points.reshape(-1, 3)[:, :2], triangles
    finally:
        gmsh.finalize()
