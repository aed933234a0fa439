"""Mesh files: one module for each family of formats, registered here by suffix.

A reader takes a path and returns a `RawMesh`. It refuses nothing and repairs nothing: what all formats share (files
that are missing, damaged, without sheets, with solids) is checked here once, and repaired in `mic.geometry.repair`.

Decks of Nastran, Abaqus, LS-DYNA and Ansys are read here, for all that they tell beside the mesh. Other formats are
read by meshlane, the maintained descendant of meshio. meshio itself is given up by its author and fails with numpy 2.2
and later. Of what else there is, meshio++ reads more dialects, but it is 64 MB of compiled code that went through eight
major versions in four months; pyvista brings all of VTK. meshlane is 2.4 MB of Python, imports in 0.15 s, and read the
same files alike with numpy 1.24 and 2.4.
"""

from __future__ import annotations

import signal
import threading
from collections.abc import Callable, Iterable, Iterator
from contextlib import contextmanager
from dataclasses import replace
from pathlib import Path

import numpy as np

from mic.errors import FormatError
from mic.geometry.deck import UNITS, Deck, Sheet
from mic.geometry.readers import abaqus, ansys, cad, dyna, exchange, gmsh, graphics, nastran, unv, vtk, vtu
from mic.geometry.readers.raw_mesh import RawMesh
from mic.geometry.repair import MeshReport, repair
from mic.geometry.surface import Surface

LIMIT = (
    60.0  # s that a reader may take, and as much more for each MB of its file: libraries may look for an end forever
)
LIMIT_PER_MB = 30.0

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
    ".unv": unv.read,
    ".vtk": vtk.read,
    ".vtu": vtu.read,
    ".xdmf": exchange.read_xdmf,
}


def read_mesh(
    path: Path | str, sets: Iterable[str] = (), unit: str = "mm", size: float | None = None
) -> tuple[Surface, Deck]:
    """The repaired surface of a mesh file in any of the formats in `READERS`, and what else the file tells.

    Of elements with mid-side nodes the corners are taken; beams, masses and rigid elements are passed over, and
    counted. Normals that a deck tells (Abaqus ``*NORMAL``, Nastran ``SNORM``) are those of the surface's corners.

    Parameters
    ----------
    path : Path or str
    sets : iterable of str
        Take the elements of these sets alone, such as one part of several, before anything is repaired.
    unit : str
        Of length in the file, one of `UNITS`. Surface and deck are in mm and MPa.
    size : float, optional
        Of the elements that a CAD file is meshed with, mm.

    Returns
    -------
    surface : Surface
    deck : mic.geometry.deck.Deck
        Empty where the file tells nothing beside the mesh, but for its `repair`.

    Raises
    ------
    FormatError
        If the file is missing or cannot be read, holds no surface elements or solid elements, or `repair` refuses them;
        if a set is not there.
    """
    path = Path(path)
    mesh = read_raw(path, size)
    try:
        if sets:
            mesh = mesh.selected(sets)
        if mesh.solids:
            raise FormatError(
                f"this mesh file holds solid elements ({', '.join(mesh.solids)}); give the mid-surface"
                + (", or the sets that are sheets" if mesh.element_sets else "")
            )
        if any(kind.startswith("polygon") for kind in mesh.others):
            raise FormatError("this mesh file holds polygons of more than four corners; split them into triangles")
        if not len(mesh.triangles) and not len(mesh.quadrilaterals):
            raise FormatError(
                f"this mesh file holds no triangles or quadrilaterals, only {', '.join(mesh.others) or 'points'}; "
                "export the shell elements too"
            )
        points, triangles, report = repair(
            mesh.points * UNITS[unit][0], mesh.triangles, mesh.quadrilaterals if len(mesh.quadrilaterals) else None
        )
        return Surface(points, triangles, _normals(mesh, report)), _deck(mesh, report, unit)
    except ValueError as problem:
        raise FormatError(f"{path}: {problem}") from problem


def read_raw(path: Path | str, size: float | None = None) -> RawMesh:
    """All that a mesh file holds, before anything is chosen or repaired: which sets there are, which of them are parts.

    Raises
    ------
    FormatError
        If the file is missing or cannot be read.
    """
    path = Path(path)
    if not path.is_file():
        raise FormatError(f"{path}: this mesh file does not exist; correct the name")
    suffix = path.suffix.lower()
    if suffix in cad.SUFFIXES and size is None:
        raise FormatError(f"{path}: a CAD file is meshed here and needs a size of elements; add size, mm")
    reader = READERS.get(suffix) if suffix not in cad.SUFFIXES else lambda path: cad.read(path, float(size or 0))
    if reader is None:
        raise FormatError(
            f"{path}: there is no reader of {path.suffix or 'files without a suffix'}; "
            f"save the mesh as one of {', '.join((*READERS, *cad.SUFFIXES))}"
        )
    seconds = LIMIT + LIMIT_PER_MB * path.stat().st_size / 1e6 + (cad.LIMIT if suffix in cad.SUFFIXES else 0.0)
    try:
        with limited(seconds):
            return reader(path)
    except TimeoutError:
        raise FormatError(
            f"{path}: this mesh file was not read in {seconds:.0f} s: it is damaged or not what its suffix says; "
            "export it again, or in another format"
        ) from None
    except ImportError as problem:
        raise FormatError(
            f"{path}: reading {path.suffix} files needs the package {problem.name}; install it (pip install "
            f"{problem.name}), or save the mesh in another format"
        ) from problem
    except FormatError as problem:
        raise FormatError(f"{path}: {problem}") from problem
    except (Exception, SystemExit) as problem:  # libraries raise whatever their parsing trips over, some exit
        raise FormatError(
            f"{path}: this mesh file cannot be read: it is cut short, damaged or not what its suffix says "
            f"({_words(problem)}); export it again, or in another format"
        ) from problem


@contextmanager
def limited(seconds: float) -> Iterator[None]:
    """A time limit: what runs longer ends in a TimeoutError. Only where signals reach, in the main thread."""
    if threading.current_thread() is not threading.main_thread() or not hasattr(signal, "setitimer"):
        yield
        return

    def ring(number, frame):
        raise TimeoutError

    before = signal.signal(signal.SIGALRM, ring)
    signal.setitimer(signal.ITIMER_REAL, seconds)
    try:
        yield
    finally:
        signal.setitimer(signal.ITIMER_REAL, 0)
        signal.signal(signal.SIGALRM, before)


def _deck(mesh: RawMesh, report: MeshReport, unit: str) -> Deck:
    """What a file tells, in terms of the repaired points and triangles."""
    length, stress = UNITS[unit]
    number = lambda points: np.unique(report.point_map[points][report.point_map[points] >= 0])
    kept = report.point_map >= 0
    sheets = [
        replace(
            sheet,
            thickness=None if sheet.thickness is None else sheet.thickness * length,
            young=None if sheet.young is None else sheet.young * stress,
        )
        for sheet in mesh.sheets
    ]
    sheet_of = np.full(len(report.element_map), -1) if mesh.sheet_of is None else mesh.sheet_of[report.element_map]
    for triangle in np.flatnonzero(report.turned & (sheet_of >= 0)):
        sheet = sheets[sheet_of[triangle]]
        if sheet.offset:  # the other side of a triangle that was turned
            other = replace(sheet, offset=-sheet.offset)
            sheets += [] if other in sheets else [other]
            sheet_of[triangle] = sheets.index(other)
    node_sets = {name: number(points) for name, points in mesh.node_sets.items()}
    within = {name: np.isin(report.element_map, elements) for name, elements in mesh.element_sets.items()}
    element_sets = {name: np.flatnonzero(triangles) for name, triangles in within.items() if triangles.any()}
    return Deck(
        np.zeros(0, dtype=np.int64) if mesh.nodes is None else mesh.nodes[kept],
        np.zeros(0, dtype=np.int64) if mesh.nodes is None else report.point_map[kept],
        {name: points for name, points in node_sets.items() if len(points)},
        element_sets,
        tuple(name for name in mesh.parts if name in element_sets),
        tuple(sheets),
        sheet_of,
        report,
        mesh.others,
        mesh.midside_nodes,
    )


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
    kind = "exit" if isinstance(problem, SystemExit) else type(problem).__name__
    return f"{kind}: {words}" if words else kind
