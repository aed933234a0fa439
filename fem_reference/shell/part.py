"""One sheet-metal part as a finite-element body: stiffness, functionals, rigid modes, pinned solves.

Units mm, N, MPa, radians. A part is free: it has no supports of its own. Where a solve needs one, six nodal
displacement components that suppress exactly the rigid motions are *pinned*. The reactions of such a statically
determinate support vanish under self-equilibrated loads, so that the choice changes only the rigid motion.
"""

from __future__ import annotations

from functools import cached_property
from typing import Any

import numpy as np
import scipy.linalg
from mpi4py import MPI
from dolfinx import fem
from petsc4py import PETSc
from scipy.sparse import coo_matrix, csr_matrix, vstack
from scipy.sparse.csgraph import connected_components

from fem_reference.shell import compat
from fem_reference.shell.element import ELEMENTS, Material, opt_beta0
from fem_reference.shell.factorisation import BLOCK, Factorisation, FactorisationError, upper_triangle
from fem_reference.shell.influence import influence_matrix
from fem_reference.shell.interpolation import P1
from fem_reference.shell.local_freedoms import LocalFreedoms, local_freedoms
from mic.compliance.functional import Functionals
from mic.geometry.surface import Surface

__all__ = ["RIGID_MOTION_TOLERANCE", "ShellPart"]

POINTS = 20_000  # patch points assembled at a time: each has entries for all freedoms of its triangle
RIGID_MOTION_TOLERANCE = 1e-2  # relative; exceeded at t/L ~ 1e-5 on curved shells


def _pieces(triangles: np.ndarray) -> int:
    """Number of sets of triangles that are connected by edges."""
    edges = np.sort(np.concatenate([triangles[:, [1, 2]], triangles[:, [2, 0]], triangles[:, [0, 1]]]), axis=1)
    edge = np.unique(edges, axis=0, return_inverse=True)[1].ravel()
    triangle = np.tile(np.arange(len(triangles)), 3)
    incidence = csr_matrix((np.ones(len(edge)), (triangle, edge)))
    return connected_components(incidence @ incidence.T, directed=False)[0]


class ShellPart:
    """A free elastic sheet on the triangles of a surface.

    Parameters
    ----------
    surface : Surface
        Mid-surface, mm; every point belongs to a triangle, and the triangles are connected by edges.
    thickness : float
        t, mm, > 0.
    young : float
        E, MPa, > 0.
    poisson : float
        ν, −1 < ν < ½.
    element : str
        A name of `ELEMENTS` (see `fem_reference.shell.element`): ``"dkt-opt-curved"``, the six-freedom production
        element on the surface's normals, ``"dkt-opt"``, the same on flat triangles, or ``"p2-cr"``, the independent
        check.
    comm : MPI.Comm
        Processes that share the assembled stiffness. The tables (`functional_matrix`, `rigid_modes`, …) are whole on
        each of them, in the same global order of freedoms; that order depends on the number of processes.
    connected : bool
        Whether the surface must be in one piece, as a part that is solved must be.

    Raises
    ------
    ValueError
        For a material, thickness or surface that does not describe a sheet.
    """

    def __init__(
        self,
        surface: Surface,
        thickness: float,
        young: float,
        poisson: float,
        element: str = "dkt-opt-curved",
        comm: MPI.Comm = MPI.COMM_SELF,
        connected: bool = True,
    ):
        if element not in ELEMENTS:
            raise ValueError(f"element {element!r}: choose one of {', '.join(ELEMENTS)}")
        if not (np.isfinite(thickness) and thickness > 0):
            raise ValueError(f"thickness must be positive, not {thickness} mm")
        if not (np.isfinite(young) and young > 0):
            raise ValueError(f"Young's modulus must be positive, not {young} MPa")
        if not -1 < poisson < 0.5:
            raise ValueError(f"Poisson's ratio must lie between -1 and 0.5, not {poisson}")
        unused = np.setdiff1d(np.arange(len(surface.points)), surface.triangles)
        if len(unused):
            raise ValueError(
                f"point {unused[0]} belongs to no triangle ({len(unused)} such points): mic.geometry.repair.repair "
                "drops them"
            )
        pieces = _pieces(surface.triangles) if connected else 1
        if pieces > 1:
            raise ValueError(
                f"the surface is in {pieces} pieces that share no edge: make each a part of its own, or join them"
            )
        self.surface, self.element, self.comm = surface, element, comm
        self._kind, self._normals = ELEMENTS[element], None
        self.thickness, self.young, self.poisson = float(thickness), float(young), float(poisson)
        self._build_tables()

    # ------------------------------------------------------------------------------------------ freedoms

    def _build_tables(self):
        """Global freedoms of every triangle of the surface, in the surface's own order.

        `_displacement_dofs` (k, nodes, 3) and `_rotation_dofs` (k, nodes, 3); dolfinx renumbers cells and vertices.
        """
        surface = self.surface
        self._mesh = compat.shell_mesh(self.comm, surface.points, surface.triangles)
        topology, geometry = self._mesh.topology, self._mesh.geometry
        cells = np.arange(topology.index_map(2).size_local)
        self._space = self._kind.space(self._mesh)
        if self._space.dofmap.index_map_bs == 6:  # all six components at the same nodes
            nodes = compat.cell_dofs(self._space)[cells]
            nodes = self._space.dofmap.index_map.local_to_global(nodes.ravel().astype(np.int32)).reshape(nodes.shape)
            both = 6 * nodes[:, :, None] + np.arange(6)
            displacement, rotation = both[:, :, :3], both[:, :, 3:]
        else:
            displacement, rotation = (
                np.stack([self._component_dofs(field, component)[cells] for component in range(3)], axis=2)
                for field in (0, 1)
            )
        # the surface's triangle of each cell, and which of its corners each corner of the cell is
        triangle = np.asarray(topology.original_cell_index)[cells]
        vertex = np.asarray(geometry.input_global_indices)[compat.cell_points(self._mesh)[cells]]
        if self._kind.normals is not None:
            self._normals = compat.cell_constants(self._mesh, self._cell_normals(triangle, vertex))
        triangle, vertex, displacement, rotation = (
            np.concatenate(self._gathered(table)) for table in (triangle, vertex, displacement, rotation)
        )
        corner = np.argmax(surface.triangles[triangle][:, :, None] == vertex[:, None, :], axis=2)
        assert (np.take_along_axis(vertex, corner, 1) == surface.triangles[triangle]).all()
        order = np.argsort(triangle)

        def in_surface_order(table):  # nodes come in threes, each three ordered like the vertices
            threes = [
                np.take_along_axis(table[:, s : s + 3], corner[:, :, None], 1) for s in range(0, table.shape[1], 3)
            ]
            return np.concatenate(threes, axis=1)[order]

        self._displacement_dofs = in_surface_order(displacement)
        self._rotation_dofs = in_surface_order(rotation)
        index_map = self._space.dofmap.index_map
        self.ndof = index_map.size_global * self._space.dofmap.index_map_bs

    def _cell_normals(self, triangle, vertex) -> np.ndarray:
        """(cells, 9) normals at the corners of each cell, in the order of the cell and on the side given by that order.

        `triangle` (cells,) and `vertex` (cells, 3) are the surface's triangle and vertices of each cell.
        """
        corner = np.argmax(self.surface.triangles[triangle][:, None, :] == vertex[:, :, None], axis=2)
        same_side = (corner[:, 1] - corner[:, 0]) % 3 == 1
        normals = self._kind.normals(self.surface)[triangle[:, None], corner]
        return (np.where(same_side, 1.0, -1.0)[:, None, None] * normals).reshape(-1, 9)

    def _component_dofs(self, field: int, component: int) -> np.ndarray:
        """Global freedoms (cells, nodes) of one component of one field of a mixed space."""
        local = compat.cell_dofs(self._space.sub(field).sub(component))
        return self._space.dofmap.index_map.local_to_global(local.ravel().astype(np.int32)).reshape(local.shape)

    @cached_property
    def vertex_displacement_dofs(self) -> np.ndarray:
        """(n_points, 3) global freedoms of the displacement of each vertex, in the surface's order."""
        dofs = np.empty((len(self.surface.points), 3), dtype=np.int64)
        dofs[self.surface.triangles] = self._displacement_dofs[:, :3]
        return dofs

    @cached_property
    def vertex_values(self) -> csr_matrix:
        """(6 n_points, ndof): the vector of freedoms to (u1, u2, u3, θ1, θ2, θ3) at each vertex in turn.

        Crouzeix–Raviart rotations jump at vertices: the mean over the triangles around a vertex is taken.
        """
        triangles, n = self.surface.triangles, len(self.surface.points)
        corners = np.eye(3)
        share = 1 / np.bincount(triangles.ravel(), minlength=n)[triangles]  # (k, 3)
        rows, columns, values = [], [], []
        for first, dofs, shape in (
            (0, self._displacement_dofs, self._kind.displacement.shape(corners)),
            (3, self._rotation_dofs, self._kind.rotation.shape(corners)),
        ):
            row = 6 * triangles[:, :, None, None] + first + np.arange(3)  # (k, corner, node, component)
            column = dofs[:, None, :, :]
            value = share[:, :, None, None] * shape[None, :, :, None]
            row, column, value = np.broadcast_arrays(row, column, value)
            keep = value != 0
            rows.append(row[keep]), columns.append(column[keep]), values.append(value[keep])
        return self._sparse(rows, columns, values, 6 * n)

    def _sparse(self, rows, columns, values, n_rows) -> csr_matrix:
        if not rows:
            return csr_matrix((n_rows, self.ndof))
        rows, columns, values = (np.concatenate([np.ravel(a) for a in arrays]) for arrays in (rows, columns, values))
        return coo_matrix((values, (rows, columns)), shape=(n_rows, self.ndof)).tocsr()

    # ------------------------------------------------------------------------------------------ operators

    @cached_property
    def stiffness(self) -> PETSc.Mat:
        """K, N/mm and N mm/rad: symmetric positive semidefinite with the six rigid motions as null space.

        The matrix is destroyed with the part.
        """
        return self._assemble()

    def __del__(self):  # petsc4py would keep it to the end of the process
        if "stiffness" in self.__dict__:
            self.stiffness.destroy()

    def _assemble(self) -> PETSc.Mat:
        constant = lambda value: fem.Constant(self._mesh, PETSc.ScalarType(value))
        material = Material(
            young=constant(self.young),
            poisson=constant(self.poisson),
            thickness=constant(self.thickness),
            beta0=constant(opt_beta0(self.poisson)),
        )
        matrix = compat.assemble_matrix(self._kind.form(self._space, material, self._normals))
        matrix.setOption(PETSc.Mat.Option.SYMMETRIC, True)
        return matrix

    def _gathered(self, own: Any) -> list[Any]:
        """The values of all processes, in rank order. A single process skips pickling, a tenth of the time."""
        return [own] if self.comm.size == 1 else self.comm.allgather(own)

    def stiffness_csr(self) -> csr_matrix:
        """The whole K as a scipy matrix on each process, newly assembled; symmetric to rounding."""
        matrix = self._assemble()
        pieces = self._gathered(matrix.getValuesCSR())  # consecutive rows from each process
        matrix.destroy()  # petsc4py would keep it to the end of the process
        return vstack(
            [
                csr_matrix((data, indices, indptr), shape=(len(indptr) - 1, self.ndof))
                for indptr, indices, data in pieces
            ]
        )

    @cached_property
    def dof_component(self) -> np.ndarray:
        """(ndof,) component of each freedom: 0, 1, 2 for u along x, y, z and 3, 4, 5 for θ about them."""
        component = np.empty(self.ndof, dtype=int)
        component[self._displacement_dofs] = np.arange(3)
        component[self._rotation_dofs] = np.arange(3, 6)
        return component

    @cached_property
    def dof_position(self) -> np.ndarray:
        """(ndof, 3) position of each freedom, mm: a vertex or the midpoint of an edge."""
        corners = self.surface.corners
        position = np.empty((self.ndof, 3))
        position[self._displacement_dofs] = (self._kind.displacement.nodes @ corners)[:, :, None]
        position[self._rotation_dofs] = (self._kind.rotation.nodes @ corners)[:, :, None]
        return position

    @cached_property
    def rigid_modes(self) -> np.ndarray:
        """(ndof, 6): unit translations along x, y, z, then unit rotations about x, y, z through `centroid`.

        u = a + ω × (x − c), θ = ω.
        """
        modes = np.zeros((self.ndof, 6))
        translation = self.dof_component < 3
        modes[np.arange(self.ndof), self.dof_component] = 1.0
        for axis in range(3):
            velocity = np.cross(np.eye(3)[axis], self.dof_position - self.centroid)
            modes[translation, 3 + axis] = velocity[translation, self.dof_component[translation]]
        return modes

    @cached_property
    def centroid(self) -> np.ndarray:
        """(3,) mean of the surface, mm: the point about which the rigid rotations turn."""
        surface = self.surface
        return np.average(surface.points[surface.triangles].mean(axis=1), axis=0, weights=surface.areas)

    def functional_matrix(self, functionals: Functionals) -> csr_matrix:
        """L (n, ndof): row i evaluates functional i from the vector of freedoms; its transpose is the unit load.

        With the patch's quadrature points q (weights c_q, shape functions N) and s = side · t/2,

            displacement:  Σ_q c_q d·(u_q + θ_q × s n_q) = Σ_q c_q (N_u d·u + N_θ (s n_q × d)·θ)
            rotation:      Σ_q c_q d·θ_q
        """
        points = np.cumsum([len(functionals.patches[i].weight) for i in functionals.patch])
        blocks = np.split(np.arange(len(functionals)), np.flatnonzero(np.diff(points // POINTS)) + 1)
        matrix = vstack([self._reading(functionals, block) for block in blocks], format="csr")
        matrix.eliminate_zeros()
        return matrix

    def _reading(self, functionals, chosen) -> csr_matrix:
        """The `chosen` rows of L; the entries of all points of a patch are added up."""
        rows, columns, values = [], [], []
        for at, row in enumerate(chosen):
            patch = functionals.patches[functionals.patch[row]]
            direction = functionals.direction[row]
            if functionals.rotation[row]:
                lever = np.broadcast_to(direction, (len(patch.weight), 3))
            else:
                N = patch.weight[:, None] * self._kind.displacement.shape(patch.barycentric)
                dofs = self._displacement_dofs[patch.triangle]  # (q, nodes, 3)
                rows.append(np.full(dofs.size, at)), columns.append(dofs)
                values.append(N[:, :, None] * direction)
                if functionals.side[row] == 0:
                    continue
                offset = functionals.side[row] * self.thickness / 2
                lever = np.cross(offset * self.surface.normals[patch.triangle], direction)
            N = patch.weight[:, None] * self._kind.rotation.shape(patch.barycentric)
            dofs = self._rotation_dofs[patch.triangle]
            rows.append(np.full(dofs.size, at)), columns.append(dofs)
            values.append(N[:, :, None] * lever[:, None, :])
        return self._sparse(rows, columns, values, len(chosen))

    def gravity(self, acceleration: np.ndarray, density: float) -> np.ndarray:
        """(ndof,) weight of the sheet, N: ∫ ρ t a·u dA for the acceleration a (3,) in mm/s² and ρ in t/mm³.

        Steel has ρ = 7.85e-9 t/mm³; the earth's gravity is 9806.65 mm/s².
        """
        if not density > 0:
            raise ValueError(f"density must be positive, not {density} t/mm³")
        per_triangle = density * self.thickness * self.surface.areas
        share = self._kind.displacement.mean
        load = np.zeros(self.ndof)
        np.add.at(
            load,
            self._displacement_dofs,
            per_triangle[:, None, None] * share[:, None] * np.asarray(acceleration, dtype=float),
        )
        return load

    # ------------------------------------------------------------------------------------------ pinned solves

    @cached_property
    def pins(self) -> np.ndarray:
        """(6,) freedoms held in pinned solves: vertex displacements chosen by pivoted QR of the rigid modes.

        Rotations are scaled by the largest distance from the centroid, so that all six modes have the same weight.
        """
        candidates = self.vertex_displacement_dofs
        if self._local is not None:
            candidates = candidates[~self._local.relative]
        candidates = candidates.ravel()
        size = np.linalg.norm(self.surface.points - self.centroid, axis=1).max()
        modes = self._rigid_modes[candidates] / np.array([1, 1, 1, size, size, size])
        _, r, pivots = scipy.linalg.qr(modes.T, mode="economic", pivoting=True)
        assert abs(r[5, 5]) > 1e-6 * abs(r[0, 0]), "vertices on a line cannot pin a part"
        return np.sort(candidates[pivots[:6]])

    @cached_property
    def _free(self) -> np.ndarray:
        return np.setdiff1d(np.arange(self.ndof), self.pins)

    @cached_property
    def _local(self) -> LocalFreedoms | None:
        """Freedoms of a solve, in place of those along the scene's axes; None if these cost no digits."""
        plain = self._kind.displacement is P1 and self._kind.rotation is P1 and self.comm.size == 1
        return local_freedoms(self.surface, self.thickness) if plain else None

    @cached_property
    def _absolute(self) -> csr_matrix | None:
        """(ndof, ndof) T that gives the freedoms from those of a solve; None if they are the same."""
        return None if self._local is None else self._by_freedom(self._local.absolute())

    @cached_property
    def _rigid_modes(self) -> np.ndarray:
        """(ndof, 6) the rigid modes in the freedoms of a solve: relative ones do not move."""
        if self._local is None:
            return self.rigid_modes
        modes, vertex = np.zeros_like(self.rigid_modes), np.flatnonzero(~self._local.relative)
        turn = self._local.axes[vertex].transpose(0, 2, 1)
        for own in (self._vertex_dofs[vertex, :3], self._vertex_dofs[vertex, 3:]):
            modes[own] = turn @ self.rigid_modes[own]
        return modes

    def _by_freedom(self, matrix: csr_matrix) -> csr_matrix:
        """A matrix (6n, 6n) by vertex, in the order of the freedoms."""
        matrix, place = matrix.tocoo(), self._vertex_dofs.ravel()
        return coo_matrix((matrix.data, (place[matrix.row], place[matrix.col])), (self.ndof, self.ndof)).tocsr()

    def _solved_stiffness(self) -> csr_matrix:
        """K in the freedoms of a solve."""
        if self._local is None:
            return self.stiffness_csr()
        flat, normals = self._local.flattened, None
        if self._kind.normals is not None:
            corner = np.take_along_axis(self._kind.normals(self.surface), self._local.order[:, :, None], axis=1)
            normals = (corner @ self._local.triangle_axes).astype(float)
        count = len(flat)
        apart = Surface(flat.reshape(-1, 3), np.arange(3 * count).reshape(count, 3), normals)
        part = ShellPart(apart, self.thickness, self.young, self.poisson, self.element, connected=False)
        place = part._vertex_dofs.ravel()
        blocks = part.stiffness_csr()[place][:, place].tobsr((18, 18)).data
        return self._by_freedom(self._local.stiffness(blocks))

    @cached_property
    def _pinned(self) -> tuple[csr_matrix, csr_matrix, csr_matrix | None]:
        """Upper triangle of K_ff, and K_fp, for free freedoms f and pins p; only half of K is stored. Of a thin sheet
        also K_ff in extended precision."""
        rows = self._solved_stiffness()[self._free]
        free = rows[:, self._free]
        exact = free if self._local is not None and self._local.thin else None
        return upper_triangle(free.astype(float)), rows[:, self.pins].astype(float), exact

    @cached_property
    def _factorisation(self) -> Factorisation:
        factorisation = Factorisation(self._pinned[0])
        self._check_conditioning(factorisation)
        return factorisation

    def _solved(self, loads: np.ndarray) -> np.ndarray:
        """K_ff⁻¹ of loads (m, r), for a thin sheet refined once by residuals in extended precision."""
        found, exact = self._factorisation.solve(loads), self._pinned[2]
        if exact is None:
            return found
        residual = loads - exact @ found.astype(np.longdouble)
        return found + self._factorisation.solve(residual.astype(float))

    @property
    def memory(self) -> float:
        """Peak memory of the factorisation, MB."""
        return self._factorisation.memory

    def _check_conditioning(self, factorisation: Factorisation) -> None:
        """Check six solves with a known solution: the part follows rigid motions of its pins.

        With free freedoms f and pins p, K_ff R_f = −K_fp R_p. Smooth rigid motions show the largest loss of digits, and
        a part with a mechanism does not follow at all.
        """
        exact = self._rigid_modes[self._free]
        followed = factorisation.solve(-self._pinned[1] @ self._rigid_modes[self.pins])
        error = (abs(followed - exact).max(axis=0) / abs(exact).max(axis=0)).max()
        if not error < RIGID_MOTION_TOLERANCE:
            raise FactorisationError(
                f"a rigid motion of the pins moves the part with a relative error of {error:.1e} (allowed "
                f"{RIGID_MOTION_TOLERANCE:.0e}): the part has a mechanism, is too thin for its size in double "
                "precision, or has elements that are too narrow; mesh it again"
            )

    @cached_property
    def _vertex_dofs(self) -> np.ndarray:
        """(n_points, 6) global freedoms u and θ of each vertex, for elements with all freedoms at vertices."""
        dofs = np.empty((len(self.surface.points), 6), dtype=np.int64)
        dofs[self.surface.triangles] = np.concatenate([self._displacement_dofs, self._rotation_dofs], axis=2)
        return dofs

    def solve(self, nodal_forces: np.ndarray) -> np.ndarray:
        """Freedoms (ndof, r) of the pinned part under the load vectors (ndof, r); one factorisation serves all calls.

        Forces in N and N mm, freedoms in mm and rad.
        """
        loads = np.asarray(nodal_forces, dtype=float)
        loads = loads if self._absolute is None else self._absolute.T @ loads
        freedoms = np.zeros_like(loads)
        freedoms[self._free] = self._solved(loads[self._free])
        return freedoms if self._absolute is None else self._absolute @ freedoms

    def influence(self, functionals: Functionals) -> tuple[np.ndarray, np.ndarray]:
        """Compliance H (n, n) of the pinned part at the functionals, and their values G (n, 6) of the rigid modes.

        Forces f (n,) with Gᵀ f = 0 move the functionals by H f + G q, where q (6,) is the rigid motion.
        """
        L = self.functional_matrix(functionals)
        solved = L if self._absolute is None else (L @ self._absolute).tocsr()
        solved = solved[:, self._free]
        if self._pinned[2] is None:
            H, self._factorisation = influence_matrix(self._pinned[0], solved)
            self._check_conditioning(self._factorisation)
            return H, L @ self.rigid_modes
        H = np.empty((len(functionals), len(functionals)))
        for first in range(0, len(H), BLOCK):
            columns = slice(first, first + BLOCK)
            H[:, columns] = solved @ self._solved(solved[columns].T.toarray())
        return 0.5 * (H + H.T), L @ self.rigid_modes

    def field(self, functionals: Functionals, forces: np.ndarray) -> np.ndarray:
        """Displacements and rotations (n_points, 6, r) at the vertices of the pinned part.

        `forces` (n, r) act on the functionals; the caller adds `rigid_field() @ q`.
        """
        freedoms = self.solve(self.functional_matrix(functionals).T @ np.asarray(forces, dtype=float))
        return (self.vertex_values @ freedoms).reshape(len(self.surface.points), 6, -1)

    def rigid_field(self) -> np.ndarray:
        """(n_points, 6, 6): the field of each of the `rigid_modes`, mode last."""
        return (self.vertex_values @ self.rigid_modes).reshape(len(self.surface.points), 6, 6)
