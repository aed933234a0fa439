"""Formats that meshlane reads: STL, PLY, OBJ, OFF, Medit, SU2, legacy VTK and XDMF.

STL has no common points; `repair` merges them. XDMF needs h5py, which is no dependency: its wheels contain an HDF5
library that conflicts with that of a distribution's dolfinx, which brings its own h5py.
"""

from __future__ import annotations

from collections.abc import Callable
from io import StringIO
from pathlib import Path
from xml.etree import ElementTree

from mic.errors import FormatError
from mic.geometry.readers.deck_text import text_lines
from mic.geometry.readers.raw_mesh import RawMesh, read_with_meshlane
from mic.system.foreign_files import reason_to_refuse

__all__ = ["READERS"]


def _read_ply(path: Path) -> RawMesh:
    """PLY; refuses a file without the end of its header, in which meshlane would loop forever."""
    if b"end_header" not in path.read_bytes():
        raise FormatError("the header has no end: the file is cut short; export it again")
    return read_with_meshlane("ply", path)


def _read_obj(path: Path) -> RawMesh:
    """Points and faces of a Wavefront OBJ; textures and normals need not be given by point, and are ignored."""
    lines = [line for line in text_lines(path) if line.split(maxsplit=1)[:1] in (["v"], ["f"])]
    return read_with_meshlane("obj", StringIO("\n".join(lines) + "\n"))


def _read_off(path: Path) -> RawMesh:
    """Triangles of an OFF file; refuses a bare header, in which meshlane would loop forever."""
    if sum(bool(line.split("#")[0].strip()) for line in text_lines(path)) < 2:
        raise FormatError("it ends with its header, and holds no mesh; export it again")
    return read_with_meshlane("off", path)


def _read_xdmf(path: Path) -> RawMesh:
    """XDMF; the files of data that it names must lie where files may be read."""
    for item in ElementTree.parse(path).iter():
        text = (item.text or "").strip()
        place = {"HDF": path.parent / text.rpartition(":")[0], "Binary": Path(text)}.get(item.get("Format", ""))
        if place is not None and (reason := reason_to_refuse(place)):
            raise FormatError(f"it names {text}, which {reason}")
    return read_with_meshlane("xdmf", path)


READERS: dict[str, Callable[[Path], RawMesh]] = {
    ".mesh": lambda path: read_with_meshlane("medit", path),
    ".meshb": lambda path: read_with_meshlane("medit", path),
    ".obj": _read_obj,
    ".off": _read_off,
    ".ply": _read_ply,
    ".stl": lambda path: read_with_meshlane("stl", path),
    ".su2": lambda path: read_with_meshlane("su2", path),
    ".vtk": lambda path: read_with_meshlane("vtk", path),
    ".xdmf": _read_xdmf,
}
