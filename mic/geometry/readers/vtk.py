"""Legacy files of VTK with unstructured grids (``.vtk``)."""

from __future__ import annotations

from pathlib import Path

import meshlane

from mic.geometry.readers.raw_mesh import RawMesh, from_meshlane

__all__ = ["read"]


def read(path: Path) -> RawMesh:
    """Cells of an unstructured grid."""
    return from_meshlane(meshlane.vtk.read(path))
