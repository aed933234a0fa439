"""VTK XML files of unstructured grids (``.vtu``): meshes of parts, and fields on surfaces for ParaView."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path

import numpy as np

from mic.geometry.readers.raw_mesh import RawMesh, read_with_meshlane
from mic.system.files import Group, replacing

__all__ = ["read", "write_vtu"]


def read(path: Path) -> RawMesh:
    """Cells of an unstructured grid."""
    return read_with_meshlane("vtu", path)


def write_vtu(
    path: Path,
    points: np.ndarray,
    triangles: np.ndarray,
    point_data: Mapping[str, np.ndarray] | None = None,
    group: Group | None = None,
) -> None:
    """Write a surface with fields at its vertices; the file appears whole or not at all.

    Parameters
    ----------
    path : Path
        Ends in ``.vtu``.
    points : (n, 3) array
        mm.
    triangles : (k, 3) int array
    point_data : mapping of str to (n,) or (n, m) array, optional
    group : optional
        As :func:`mic.system.files.replacing` takes it.
    """
    import meshlane  # see read_with_meshlane

    # Not compressed: compression would save a tenth of the size, and take fifteen times as long.
    mesh = meshlane.Mesh(points, [("triangle", triangles.astype(np.int32))], point_data=dict(point_data or {}))
    with replacing(Path(path), durable=False, group=group) as temporary:
        meshlane.vtu.write(temporary, mesh, compression=None)
