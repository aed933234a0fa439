"""Every call that differs between the supported dolfinx versions, which `fem_reference.shell.versions` names.

Nothing else in the project looks at a version number. What changed, in order:

====  =============================================================================================================
0.9   since 0.5: ``basix.ufl`` for UFL's element classes, arrays for adjacency lists, ``functionspace`` for
      ``FunctionSpace``, ``jit_options`` for ``jit_params``, and ``create_mesh`` calls its element ``e``
0.10  ``create_mesh`` takes the element before the points: both are passed by name
0.11  ``Geometry.dofmaps``, one for each cell type; ``Geometry.dofmap`` warns
====  =============================================================================================================
"""

from __future__ import annotations

import logging
from contextlib import contextmanager

import dolfinx
import numpy as np
import ufl
from mpi4py import MPI
from dolfinx import fem
from dolfinx import mesh as dmesh
from dolfinx.fem import petsc as fem_petsc
from petsc4py import PETSc

from fem_reference.shell import mumps
from fem_reference.shell.versions import UnsupportedVersion, supported

__all__ = [
    "assemble_matrix",
    "cell_constants",
    "cell_dofs",
    "cell_points",
    "compile_form",
    "lagrange_6",
    "linear_function",
    "p2_crouzeix_raviart",
    "quadratic_plane",
    "shell_mesh",
    "versions",
]

_VERSION = supported(dolfinx.__version__)
_LEGACY = _VERSION < (0, 6)  # UFL's own element classes, adjacency lists; afterwards basix.ufl and plain arrays
if not _LEGACY:
    import basix.ufl
if np.dtype(PETSc.ScalarType) != np.float64:
    raise UnsupportedVersion("this PETSc has complex numbers; install dolfinx with real ones (dolfinx-solver-real)")

_COMPILER_TIMEOUT = 120  # s; with one process per part, all but one wait for the compiler


def versions() -> dict[str, str]:
    """Versions of the libraries that compute the shells, by name."""
    petsc = ".".join(map(str, PETSc.Sys.getVersion()))
    return {"dolfinx": dolfinx.__version__, "PETSc": petsc, "MUMPS": mumps.version()}


@contextmanager
def _quietly():
    """Silence the form compiler, which logs every pass, and undo what it does to the root logger."""
    level, disabled = logging.root.level, logging.root.manager.disable
    logging.disable(logging.WARNING)
    try:
        yield
    finally:
        logging.disable(disabled)
        logging.root.setLevel(level)


def shell_mesh(comm: MPI.Comm, points: np.ndarray, triangles: np.ndarray) -> dmesh.Mesh:
    """Flat triangles in space. `points` (n, 3) and `triangles` (k, 3) are read on rank 0 of `comm` only."""
    if comm.rank != 0:
        points, triangles = np.zeros((0, 3)), np.zeros((0, 3), dtype=np.int64)
    points = np.ascontiguousarray(points, dtype=float)
    triangles = np.ascontiguousarray(triangles, dtype=np.int64)
    if _LEGACY:
        coordinates = ufl.VectorElement("Lagrange", ufl.Cell("triangle", 3), 1)
    else:
        coordinates = basix.ufl.element("Lagrange", "triangle", 1, shape=(3,))
    with _quietly():
        if _LEGACY:
            return dmesh.create_mesh(comm, triangles, points, ufl.Mesh(coordinates))
        return dmesh.create_mesh(comm, cells=triangles, x=points, e=ufl.Mesh(coordinates))


def lagrange_6(mesh: dmesh.Mesh) -> fem.FunctionSpace:
    """Linear Lagrange elements with six components: (u1, u2, u3, θ1, θ2, θ3) at each vertex."""
    if _LEGACY:
        return _function_space(mesh, ufl.VectorElement("Lagrange", mesh.ufl_cell(), 1, dim=6))
    return _function_space(mesh, basix.ufl.element("Lagrange", "triangle", 1, shape=(6,)))


def p2_crouzeix_raviart(mesh: dmesh.Mesh) -> fem.FunctionSpace:
    """Quadratic displacement (3 components) × Crouzeix–Raviart rotation (3 components)."""
    if _LEGACY:
        cell = mesh.ufl_cell()
        displacement = ufl.VectorElement("Lagrange", cell, 2, dim=3)
        rotation = ufl.VectorElement("CR", cell, 1, dim=3)
        return _function_space(mesh, ufl.MixedElement([displacement, rotation]))
    displacement = basix.ufl.element("Lagrange", "triangle", 2, shape=(3,))
    rotation = basix.ufl.element("CR", "triangle", 1, shape=(3,))
    return _function_space(mesh, basix.ufl.mixed_element([displacement, rotation]))


def linear_function(mesh: dmesh.Mesh, components: int, name: str) -> fem.Function:
    """A linear Lagrange function that is zero: a scalar for no components, else a vector."""
    if _LEGACY:
        cell = mesh.ufl_cell()
        scalar = ufl.FiniteElement("Lagrange", cell, 1)
        element = ufl.VectorElement("Lagrange", cell, 1, dim=components) if components else scalar
    else:
        element = basix.ufl.element("Lagrange", "triangle", 1, shape=(components,) if components else ())
    return fem.Function(_function_space(mesh, element), name=name)


def quadratic_plane(mesh: dmesh.Mesh) -> fem.FunctionSpace:
    """Quadratic Lagrange elements with two components, for bodies in the plane."""
    if _LEGACY:
        return _function_space(mesh, ufl.VectorElement("Lagrange", mesh.ufl_cell(), 2, dim=2))
    return _function_space(mesh, basix.ufl.element("Lagrange", "triangle", 2, shape=(2,)))


def cell_constants(mesh: dmesh.Mesh, values: np.ndarray) -> fem.Function:
    """A function that is constant in each cell; `values` (c, m) are those of the c cells that this process owns."""
    m = values.shape[1]
    if _LEGACY:
        element = ufl.VectorElement("DG", mesh.ufl_cell(), 0, dim=m)
    else:
        element = basix.ufl.element("DG", "triangle", 0, shape=(m,))
    function = fem.Function(_function_space(mesh, element))
    dof = cell_dofs(function.function_space)[: len(values), :1]
    function.x.array[m * dof + np.arange(m)] = values
    function.x.scatter_forward()  # to the processes that have a cell as a ghost
    return function


def _function_space(mesh, element) -> fem.FunctionSpace:
    with _quietly():
        return (fem.FunctionSpace if _LEGACY else fem.functionspace)(mesh, element)


def cell_dofs(space: fem.FunctionSpace) -> np.ndarray:
    """Local numbers of each cell's freedoms (cells, freedoms per cell) in a function space."""
    return _table(space.dofmap.list)


def cell_points(mesh: dmesh.Mesh) -> np.ndarray:
    """Local numbers of each cell's points (cells, 3) in the mesh's geometry."""
    geometry = mesh.geometry
    return _table(geometry.dofmap if _VERSION < (0, 11) else geometry.dofmaps[0])


def _table(dofmap) -> np.ndarray:
    return np.asarray(dofmap.array.reshape(dofmap.num_nodes, -1) if _LEGACY else dofmap)


def compile_form(form) -> fem.Form:
    """Compile a UFL form, or fetch it from the user's cache; interpret it where dolfinx 0.11 finds no C compiler."""
    if _VERSION >= (0, 11):
        from fem_reference.shell import interpreted_forms  # imported where it is needed

        if interpreted_forms.no_compiler():
            with _quietly():
                return interpreted_forms.form(form)
    options = {"timeout": _COMPILER_TIMEOUT}
    with _quietly():
        return fem.form(form, jit_params=options) if _LEGACY else fem.form(form, jit_options=options)


def assemble_matrix(form) -> PETSc.Mat:
    """Assembled AIJ matrix of a UFL bilinear form, no boundary conditions."""
    matrix = fem_petsc.assemble_matrix(compile_form(form))
    matrix.assemble()
    return matrix
