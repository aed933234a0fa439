"""Surfaces from scanners, CAD and graphics: STL, PLY, OBJ, OFF. STL has no common points; `repair` merges them."""

from __future__ import annotations

from io import StringIO
from pathlib import Path

import meshlane

from mic.errors import FormatError
from mic.geometry.readers.raw_mesh import RawMesh, from_meshlane

__all__ = ["read_obj", "read_off", "read_ply", "read_stl"]


def read_stl(path: Path) -> RawMesh:
    """STL, text or binary."""
    return from_meshlane(meshlane.stl.read(path))


def read_ply(path: Path) -> RawMesh:
    """PLY, text or binary."""
    if b"end_header" not in path.read_bytes():  # meshlane would look for it without end
        raise FormatError("the header has no end: the file is cut short; export it again")
    return from_meshlane(meshlane.ply.read(path))


def read_obj(path: Path) -> RawMesh:
    """Wavefront OBJ: points and faces. Textures and normals are passed over: there need not be one per point."""
    lines = path.read_text(encoding="utf-8", errors="replace").splitlines()
    kept = [line for line in lines if line.split(maxsplit=1)[:1] in (["v"], ["f"])]
    return from_meshlane(meshlane.obj.read(StringIO("\n".join(kept) + "\n")))


def read_off(path: Path) -> RawMesh:
    """Object file format, triangles only."""
    lines = path.read_text(encoding="utf-8", errors="replace").splitlines()
    if sum(bool(line.split("#")[0].strip()) for line in lines) < 2:  # meshlane would look for the rest without end
        raise FormatError("it ends with its header, and holds no mesh; export it again")
    return from_meshlane(meshlane.off.read(path))
