"""Readers of mesh files: one module per family of formats, registered here by suffix.

A reader takes a path and returns a `RawMesh`, without checks or repairs. Checks that all formats share (files that are
missing, damaged, without shells, or with solids) are made here, repairs in `mic.geometry.repair`.

The decks of Nastran, Abaqus, LS-DYNA and Ansys have readers of their own, because libraries ignore sections, materials
and offsets. meshlane, the maintained successor of meshio, reads the other formats. meshio is unmaintained and fails
with numpy 2.2. meshio++ reads more dialects, but is 64 MB of compiled code with frequent incompatible releases; pyvista
requires VTK.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable
from contextlib import AbstractContextManager
from dataclasses import replace
from pathlib import Path

import numpy as np

from mic.errors import FormatError
from mic.geometry.deck import UNITS, Deck, Sheet
from mic.geometry.readers import abaqus, ansys, dyna, gmsh, gmsh_program, meshlane_formats, nastran, unv, vtu
from mic.geometry.readers.raw_mesh import RawMesh
from mic.geometry.repair import MeshReport, repair
from mic.geometry.surface import Surface
from mic.system.foreign_files import reading

__all__ = ["READERS", "UNITS", "Deck", "RawMesh", "Sheet", "read_mesh", "read_raw"]

READERS: dict[str, Callable[[Path], RawMesh]] = {
    ".bdf": nastran.read,
    ".cdb": ansys.read,
    ".dat": nastran.read,
    ".dyn": dyna.read,
    ".fem": nastran.read,
    ".inp": abaqus.read,
    ".k": dyna.read,
    ".key": dyna.read,
    ".med": gmsh_program.read_med,
    ".msh": gmsh.read,
    ".nas": nastran.read,
    ".unv": unv.read,
    ".vtu": vtu.read,
    **meshlane_formats.READERS,
}


def read_mesh(
    path: Path | str,
    sets: Iterable[str] = (),
    unit: str = "mm",
    size: float | None = None,
    folder: Path | None = None,
) -> tuple[Surface, Deck]:
    """The repaired surface of a mesh file in one of the formats of `READERS` or CAD, and the file's other contents.

    Elements with mid-side nodes are reduced to their corners; beams, masses and rigid elements are ignored and counted.
    Normals in a deck (Abaqus ``*NORMAL``, Nastran ``SNORM``) become normals of the surface's corners.

    Parameters
    ----------
    path : Path or str
    sets : iterable of str
        Use only the elements of these sets, such as one part of several; applied before the repair.
    unit : str
        Unit of length in the file, one of `UNITS`. Surface and deck are in mm and MPa.
    size : float, optional
        Element size for the mesh of a CAD file, mm.
    folder : Path, optional
        Folder of the scene, from which included files may come. Default: the folder of the file.

    Returns
    -------
    surface : Surface
    deck : mic.geometry.deck.Deck
        Has only its `repair` if the file holds nothing besides the mesh.

    Raises
    ------
    FormatError
        If the file is missing or cannot be read, holds no surface elements or solid elements, or cannot be repaired; if
        a set does not exist.
    """
    with _reading(path, folder):
        mesh = _read(Path(path), size)
        if sets:
            mesh = mesh.selected(sets)
        if mesh.solids:
            sets = ", or the sets that are sheets" if mesh.element_sets else ""
            raise FormatError(f"it holds solid elements ({', '.join(mesh.solids)}); give the mid-surface{sets}")
        if any(kind.startswith("polygon") for kind in mesh.others):
            raise FormatError("it holds polygons of more than four corners; export triangles")
        if not len(mesh.elements):
            held = f"no triangles or quadrilaterals, only {', '.join(mesh.others) or 'points'}"
            raise FormatError(f"it holds {held}; export the shell elements too")
        points, triangles, report = repair(mesh.points * UNITS[unit][0], mesh.triangles, mesh.quadrilaterals)
        return Surface(points, triangles, _normals(mesh, report)), _deck(mesh, report, unit)


def read_raw(path: Path | str, size: float | None = None, folder: Path | None = None) -> RawMesh:
    """Contents of a mesh file before selection and repair, such as its sets.

    Parameters are those of :func:`read_mesh`.

    Raises
    ------
    FormatError
        If the file is missing or cannot be read.
    """
    with _reading(path, folder):
        return _read(Path(path), size)


def _reading(path: Path | str, folder: Path | None) -> AbstractContextManager[None]:
    """The gate for a mesh file."""
    is_cad = Path(path).suffix.lower() in gmsh_program.CAD_SUFFIXES
    return reading(Path(path), "mesh file", folder, seconds=gmsh_program.LIMIT if is_cad else 0.0)


def _read(path: Path, size: float | None) -> RawMesh:
    suffix = path.suffix.lower()
    if suffix in gmsh_program.CAD_SUFFIXES:
        if size is None:
            raise FormatError("a CAD file needs an element size for its mesh; add size, mm")
        return gmsh_program.read_cad(path, float(size))
    if suffix not in READERS:
        known = ", ".join((*sorted(READERS), *gmsh_program.CAD_SUFFIXES))
        kind = suffix or "files without a suffix"
        raise FormatError(f"there is no reader of {kind}; save the mesh as one of {known}")
    return READERS[suffix](path)


def _deck(mesh: RawMesh, report: MeshReport, unit: str) -> Deck:
    """Contents of a file in terms of the repaired points and triangles."""
    length, stress = UNITS[unit]
    present = report.point_map >= 0
    sheets = [
        replace(sheet, thickness=_scaled(sheet.thickness, length), young=_scaled(sheet.young, stress))
        for sheet in mesh.sheets
    ]
    sheet_of = np.full(len(report.element_map), -1) if mesh.sheet_of is None else mesh.sheet_of[report.element_map]
    for triangle in np.flatnonzero(report.turned & (sheet_of >= 0)):
        sheet = sheets[sheet_of[triangle]]
        if sheet.offset:  # the sign changes with the normal of a reversed triangle
            other = replace(sheet, offset=-sheet.offset)
            sheets += [] if other in sheets else [other]
            sheet_of[triangle] = sheets.index(other)
    node_sets = {name: np.unique(report.point_map[points[present[points]]]) for name, points in mesh.node_sets.items()}
    within = {name: np.isin(report.element_map, elements) for name, elements in mesh.element_sets.items()}
    element_sets = {name: np.flatnonzero(triangles) for name, triangles in within.items() if triangles.any()}
    return Deck(
        np.zeros(0, dtype=np.int64) if mesh.nodes is None else mesh.nodes[present],
        np.zeros(0, dtype=np.int64) if mesh.nodes is None else report.point_map[present],
        {name: points for name, points in node_sets.items() if len(points)},
        element_sets,
        tuple(name for name in mesh.parts if name in element_sets),
        tuple(sheets),
        sheet_of,
        report,
        mesh.others,
        mesh.midside_nodes,
    )


def _scaled(value: float | None, unit: float) -> float | None:
    """A value in terms of another unit; None if it is unknown."""
    return None if value is None else value * unit


def _normals(mesh: RawMesh, report: MeshReport) -> np.ndarray | None:
    """(k, 3, 3) normals from the file at the corners of the repaired triangles; None if it has none."""
    if mesh.normals is None:
        return None
    many, unknown = len(mesh.triangles), np.full((1, 3), np.nan)
    flat = np.concatenate([mesh.normals[:many, :3].reshape(-1, 3), mesh.normals[many:].reshape(-1, 3), unknown])
    return flat[report.corner_map]  # -1, a corner created by splitting, selects the last row, NaN
