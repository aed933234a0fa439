"""Meshes of gmsh, versions 2.2, 4.0 and 4.1 of its format, text or binary (``.msh``)."""

from __future__ import annotations

import re
from pathlib import Path
from tempfile import TemporaryDirectory

import meshlane

from mic.geometry.readers.raw import RawMesh, from_meshlane

__all__ = ["read"]

# Geometry and physical groups. Nothing here needs them, and meshlane refuses a file in which some elements are in a
# group.
GROUPS = re.compile(rb"\$(Entities|PhysicalNames)\s.*?\$End\1\s*\n", re.DOTALL)


def read(path: Path) -> RawMesh:
    """All elements of a gmsh file, in physical groups or not."""
    with TemporaryDirectory() as folder:  # meshlane reads this format from files only
        bare = Path(folder) / "mesh.msh"
        bare.write_bytes(GROUPS.sub(b"", path.read_bytes()))
        return from_meshlane(meshlane.gmsh.read(bare))
