"""Sheets on dolfinx meshes, and the supports and loads that act on them.

A dolfinx mesh may be distributed over processes and may orient its triangles arbitrarily. The surface of a sheet is
whole on each process, consistently oriented, and without duplicate points.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from mpi4py import MPI
from dolfinx import fem
from dolfinx import mesh as dmesh

from fem_reference.shell import compat
from fem_reference.shell.part import ShellPart
from mic.geometry.repair import repair
from mic.geometry.surface import Surface

__all__ = ["Force", "Place", "Sheet", "Support", "Traction"]

#: Where something acts: ``marker(x)`` with x (3, n) gives n booleans, as in dolfinx, or mesh tags and one of their
#: values.
Place = Callable[[np.ndarray], np.ndarray] | tuple[Any, int]
ELEMENTS = ("dkt-opt-curved", "dkt-opt")  # with all freedoms at vertices, so that a support holds an edge


class Sheet:
    """Elastic sheet whose mid-surface is a dolfinx mesh of linear triangles, in the plane or in space.

    Parameters
    ----------
    mesh : dolfinx.mesh.Mesh
        All sheets of a problem on one communicator.
    thickness, young, poisson : float
        mm, MPa, 1.
    element : str
        Shell element: ``"dkt-opt-curved"``, or ``"dkt-opt"`` on flat triangles.
    name : str
        Name in error messages and output files.

    Attributes
    ----------
    comm : MPI.Comm
        Processes of the mesh.
    shell : ShellPart
        The elements, on a surface that is the same on each process.

    Raises
    ------
    ValueError
        For a mesh or material that does not describe a sheet.
    """

    def __init__(
        self,
        mesh: dmesh.Mesh,
        thickness: float,
        young: float,
        poisson: float,
        element: str = "dkt-opt-curved",
        name: str = "sheet",
    ):
        if element not in ELEMENTS:
            raise ValueError(f"element {element!r}: choose one of {', '.join(ELEMENTS)}")
        corners = compat.cell_points(mesh)
        if mesh.topology.dim != 2 or corners.shape[1] != 3:
            raise ValueError(
                f"sheet {name!r}: its mesh has cells of dimension {mesh.topology.dim} with {corners.shape[1]} points; "
                "mesh the mid-surface with linear triangles"
            )
        self.mesh, self.name, self.comm = mesh, name, _outliving(mesh.comm)
        index_map = mesh.geometry.index_map()
        local = np.arange(index_map.size_local + index_map.num_ghosts, dtype=np.int32)
        number = index_map.local_to_global(local)
        points = self._whole(mesh.geometry.x[: index_map.size_local])
        triangles = self._whole(number[corners[: mesh.topology.index_map(2).size_local]])
        points, triangles, report = repair(points, triangles)
        self._vertex = report.point_map[number]  # vertex of the surface of each local point, -1 for none
        self.shell = ShellPart(Surface(points, triangles), thickness, young, poisson, element, self.comm)

    def _whole(self, own: np.ndarray) -> np.ndarray:
        return np.concatenate(self.comm.allgather(own))

    def marked(self, place: Place) -> np.ndarray:
        """(n,) int vertices of the surface at a place, ascending; tagged entities count with their vertices.

        Raises
        ------
        ValueError
            If there are none.
        """
        if callable(place):
            found = np.flatnonzero(np.broadcast_to(place(self.shell.surface.points.T), len(self.shell.surface.points)))
            name = "the marker"
        else:
            tags, value = place
            found = np.unique(self._whole(self._tagged(tags, value)))
            name = f"the tag {value}"
        if not len(found):
            raise ValueError(f"sheet {self.name!r}: {name} holds for no vertex of its mesh")
        return found

    def _tagged(self, tags, value: int) -> np.ndarray:
        """Vertices of the surface on the local entities that have a tag."""
        topology = self.mesh.topology
        topology.create_connectivity(2, 0)
        topology.create_connectivity(tags.dim, 0)
        cells = topology.connectivity(2, 0).array.reshape(-1, 3)
        point = np.empty(cells.max() + 1, dtype=np.int64)
        point[cells] = compat.cell_points(self.mesh)[: len(cells)]  # corners have the same order in both tables
        entities = topology.connectivity(tags.dim, 0)
        vertices = [entities.links(int(entity)) for entity in tags.indices[tags.values == value]]
        return self._vertex[point[np.concatenate(vertices)]] if vertices else np.zeros(0, dtype=np.int64)

    def function(self, values: np.ndarray, name: str) -> fem.Function:
        """Values (n,) or (n, m) at the vertices of the surface as a linear function on the mesh."""
        components = values.shape[1] if values.ndim == 2 else 0
        function = compat.linear_function(self.mesh, components, name)
        dofs, points = compat.cell_dofs(function.function_space), compat.cell_points(self.mesh)
        width = max(components, 1)
        table = np.zeros((len(function.x.array) // width, width))
        own = np.where(self._vertex[:, None] >= 0, values.reshape(len(values), -1)[self._vertex], 0.0)
        table[dofs] = own[points]
        function.x.array[:] = table.ravel()
        return function


def _outliving(comm: MPI.Comm) -> MPI.Comm:
    """The same processes on a communicator that is not freed with the mesh, as PETSc's matrices may live longer."""
    if comm.size == 1:
        return MPI.COMM_SELF
    same = MPI.Comm.Compare(comm, MPI.COMM_WORLD) in (MPI.IDENT, MPI.CONGRUENT)
    return MPI.COMM_WORLD if same else comm.Dup()


@dataclass(eq=False)
class Support:
    """Prescribed displacements and rotations of the vertices at a place; None leaves a component free.

    Attributes
    ----------
    sheet : Sheet
    where : Place
        A marker of positions, or mesh tags and a value.
    displacement : sequence of three float or None
        mm. May be changed between solves, but not which components are free.
    rotation : sequence of three float or None
        rad.
    """

    sheet: Sheet
    where: Place
    displacement: Sequence[float | None] = (0.0, 0.0, 0.0)
    rotation: Sequence[float | None] = (None, None, None)


@dataclass(eq=False)
class Traction:
    """Force per area on the triangles whose vertices are all at a place.

    Attributes
    ----------
    sheet : Sheet
    where : Place
    value : sequence of three float
        N/mm². May be changed between solves.
    """

    sheet: Sheet
    where: Place
    value: Sequence[float]

    def weights(self) -> np.ndarray:
        """(n,) area of each vertex, mm²; 0 for those that are not loaded.

        Raises
        ------
        ValueError
            If no triangle is loaded.
        """
        surface = self.sheet.shell.surface
        inside = np.isin(surface.triangles, self.sheet.marked(self.where)).all(axis=1)
        if not inside.any():
            raise ValueError(f"sheet {self.sheet.name!r}: no triangle has all its vertices where the traction acts")
        weight = np.zeros(len(surface.points))
        np.add.at(weight, surface.triangles[inside], surface.areas[inside, None] / 3)
        return weight


@dataclass(eq=False)
class Force:
    """A force, shared equally by the vertices at a place.

    Attributes
    ----------
    sheet : Sheet
    where : Place
    value : sequence of three float
        N. May be changed between solves.
    """

    sheet: Sheet
    where: Place
    value: Sequence[float]

    def weights(self) -> np.ndarray:
        """(n,) share of each vertex."""
        vertices = self.sheet.marked(self.where)
        weight = np.zeros(len(self.sheet.shell.surface.points))
        weight[vertices] = 1 / len(vertices)
        return weight
