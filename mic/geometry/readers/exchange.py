"""Formats in which further programs exchange meshes: Salome, Medit, SU2, XDMF. XDMF needs h5py.

h5py is no dependency: its wheels bring an HDF5 of their own, which fails beside that of a distribution's dolfinx. Where
finite elements are installed, the distribution's h5py is the right one. MED, on HDF5 too, is left to the program gmsh.
"""

from __future__ import annotations

from pathlib import Path

import meshlane

from mic.geometry.readers import gmsh
from mic.geometry.readers.gmsh_program import written
from mic.geometry.readers.raw_mesh import RawMesh, from_meshlane

__all__ = ["read_med", "read_medit", "read_su2", "read_xdmf"]


def read_med(path: Path) -> RawMesh:
    """MED files of Salome and code_aster, by the program gmsh; groups of elements are physical groups then.

    Raises
    ------
    FormatError
        If gmsh is missing, fails or takes too long.
    """
    with written(path, "MED", ["-save", "-setnumber", "Mesh.SaveAll", "1"]) as mesh:
        return gmsh.read(mesh)


def read_medit(path: Path) -> RawMesh:
    """Medit, text or binary (``.mesh``, ``.meshb``)."""
    return from_meshlane(meshlane.medit.read(path))


def read_su2(path: Path) -> RawMesh:
    """SU2."""
    return from_meshlane(meshlane.su2.read(path))


def read_xdmf(path: Path) -> RawMesh:
    """XDMF; needs h5py, even where no HDF5 stands beside it."""
    return from_meshlane(meshlane.xdmf.read(path))
