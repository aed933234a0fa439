"""Sheets from CAD (``.step``, ``.iges``, ``.brep``), meshed by the program gmsh."""

from __future__ import annotations

from pathlib import Path

from mic.errors import FormatError
from mic.geometry.readers import gmsh
from mic.geometry.readers.gmsh_program import LIMIT, written
from mic.geometry.readers.raw_mesh import RawMesh

__all__ = ["LIMIT", "SUFFIXES", "read"]

SUFFIXES = (".step", ".stp", ".iges", ".igs", ".brep")


def read(path: Path, size: float) -> RawMesh:
    """The surfaces of a CAD file in mm, meshed with elements of a size, mm.

    Raises
    ------
    FormatError
        If gmsh is missing, fails or takes too long, or the file holds a solid, whose skin is no mid-surface.
    """
    options = ["-2", "-clmax", repr(size), "-setstring", "Geometry.OCCTargetUnit", "MM"]
    options += ["-setnumber", "Mesh.MeshSizeFromCurvature", "12", "-setnumber", "Mesh.MeshSizeMin", repr(size / 20)]
    with written(path, "CAD", options) as mesh:
        if gmsh.volumes(mesh):
            raise FormatError(
                "it holds a solid, and the skin of a solid is no mid-surface; export the mid-surface as a sheet"
            )
        return gmsh.read(mesh)
