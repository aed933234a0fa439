"""Mesh files: one module for each family of formats, registered here by suffix.

A reader takes a path and returns a `RawMesh`. It refuses nothing and repairs nothing: what all formats share (files
that are missing, damaged, without sheets, with solids) is checked here once, and repaired in `mic.geometry.repair`.

All formats but Nastran's are read by meshlane, the maintained descendant of meshio. meshio itself is given up by its
author and fails with numpy 2.2 and later. Of what else there is, meshio++ reads more dialects, but it is 64 MB of
compiled code that went through eight major versions in four months; pyvista brings all of VTK; pyNastran refuses numpy
2. meshlane is 2.4 MB of Python, imports in 0.15 s, and read the same files alike with numpy 1.24 and 2.4.
"""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import numpy as np

from mic.errors import FormatError
from mic.geometry.readers import abaqus, exchange, gmsh, graphics, nastran, vtk, vtu
from mic.geometry.readers.raw import RawMesh
from mic.geometry.repair import MeshReport, repair
from mic.geometry.surface import Surface

__all__ = ["READERS", "RawMesh", "read_mesh"]

READERS: dict[str, Callable[[Path], RawMesh]] = {
    ".bdf": nastran.read,
    ".cdb": exchange.read_ansys,
    ".fem": nastran.read,
    ".inp": abaqus.read,
    ".med": exchange.read_med,
    ".mesh": exchange.read_medit,
    ".meshb": exchange.read_medit,
    ".msh": gmsh.read,
    ".nas": nastran.read,
    ".obj": graphics.read_obj,
    ".off": graphics.read_off,
    ".ply": graphics.read_ply,
    ".stl": graphics.read_stl,
    ".su2": exchange.read_su2,
    ".vtk": vtk.read,
    ".vtu": vtu.read,
    ".xdmf": exchange.read_xdmf,
}


def read_mesh(path: Path | str) -> tuple[Surface, MeshReport]:
    """The repaired surface of a mesh file in any of the formats in `READERS`, and what the repair took.

    Of elements with mid-side nodes the corners are taken; beams and points are passed over. Normals that a deck tells
    (Abaqus ``*NORMAL``, Nastran ``SNORM``) are those of the surface's corners.

    Raises
    ------
    FormatError
        If the file is missing or cannot be read, holds no surface elements or solid elements, or `repair` refuses them.
    """
    path = Path(path)
    if not path.is_file():
        raise FormatError(f"{path}: this mesh file does not exist; correct the name")
    reader = READERS.get(path.suffix.lower())
    if reader is None:
        raise FormatError(
            f"{path}: there is no reader of {path.suffix or 'files without a suffix'}; "
            f"save the mesh as one of {', '.join(READERS)}"
        )
    try:
        mesh = reader(path)
    except ImportError as problem:
        raise FormatError(
            f"{path}: reading {path.suffix} files needs the package {problem.name}; install it (pip install "
            f"{problem.name}), or save the mesh in another format"
        ) from problem
    except (Exception, SystemExit) as problem:  # libraries raise whatever their parsing trips over, some exit
        raise FormatError(
            f"{path}: this mesh file cannot be read: it is cut short, damaged or not what its suffix says "
            f"({_words(problem)}); export it again, or in another format"
        ) from problem
    if mesh.solids:
        raise FormatError(
            f"{path}: this mesh file holds solid elements ({', '.join(mesh.solids)}); give the mid-surface"
        )
    if any(kind.startswith("polygon") for kind in mesh.others):
        raise FormatError(f"{path}: this mesh file holds polygons of more than four corners; split them into triangles")
    if not len(mesh.triangles) and not len(mesh.quadrilaterals):
        raise FormatError(
            f"{path}: this mesh file holds no triangles or quadrilaterals, only {', '.join(mesh.others) or 'points'}; "
            "export the shell elements too"
        )
    try:
        points, triangles, report = repair(
            mesh.points, mesh.triangles, mesh.quadrilaterals if len(mesh.quadrilaterals) else None
        )
        return Surface(points, triangles, _normals(mesh, report)), report
    except ValueError as problem:
        raise FormatError(f"{path}: {problem}") from problem


def _normals(mesh: RawMesh, report: MeshReport) -> np.ndarray | None:
    """(k, 3, 3) what the file tells of the normals at the corners of the repaired triangles."""
    if mesh.triangle_normals is None and mesh.quadrilateral_normals is None:
        return None
    nothing = lambda elements: np.full((*elements.shape, 3), np.nan)
    told = [
        nothing(elements) if normals is None else normals
        for elements, normals in (
            (mesh.triangles, mesh.triangle_normals),
            (mesh.quadrilaterals, mesh.quadrilateral_normals),
        )
    ]
    flat = np.concatenate([normals.reshape(-1, 3) for normals in told] + [np.full((1, 3), np.nan)])
    return flat[report.corner_map]  # -1, a corner that splitting made, finds the row that tells nothing


def _words(problem: BaseException) -> str:
    """What a reader said, on one line; with the kind of error where its words alone would be none, such as ``17``."""
    words = " ".join(str(problem).split())
    if isinstance(problem, FormatError):
        return words
    kind = "exit" if isinstance(problem, SystemExit) else type(problem).__name__
    return f"{kind}: {words}" if words else kind
