"""What a reader returns: the sheet elements of a mesh file as they stand there, not repaired, nothing refused."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Any

import numpy as np

__all__ = ["RawMesh", "from_meshlane"]

SOLIDS = ("tetra", "hexa", "wedge", "pyramid", "polyhedron")  # beginnings of meshlane's names of solid elements


@dataclass(frozen=True)
class RawMesh:
    """Content of a mesh file.

    Attributes
    ----------
    points : (n, 3) array
        mm.
    triangles : (k, 3) int array
        Point numbers from zero; of elements with mid-side nodes the corners.
    quadrilaterals : (q, 4) int array
        As for triangles.
    solids : tuple of str
        Kinds of solid elements that the file holds.
    others : tuple of str
        Kinds of further elements that were passed over, such as beams.
    triangle_normals, quadrilateral_normals : (k, 3, 3) and (q, 4, 3) array, optional
        Normals of the sheet at the elements' corners, where the file tells them; NaN where it does not.
    """

    points: np.ndarray
    triangles: np.ndarray
    quadrilaterals: np.ndarray
    solids: tuple[str, ...] = field(default=())
    others: tuple[str, ...] = field(default=())
    triangle_normals: np.ndarray | None = None
    quadrilateral_normals: np.ndarray | None = None


def from_meshlane(mesh: Any) -> RawMesh:
    """The sheet elements of a ``meshlane.Mesh``."""
    kinds = sorted({block.type for block in mesh.cells})
    points = np.zeros((len(mesh.points), 3))
    if len(mesh.points):
        points[:, : mesh.points.shape[1]] = mesh.points
    corners = lambda kind, count: np.concatenate(
        [np.zeros((0, count), dtype=np.int64)]
        + [np.asarray(block.data)[:, :count] for block in mesh.cells if block.type.startswith(kind)]
    )
    return RawMesh(
        points,
        corners("triangle", 3),
        corners("quad", 4),
        tuple(kind for kind in kinds if kind.startswith(SOLIDS)),
        tuple(kind for kind in kinds if not kind.startswith((*SOLIDS, "triangle", "quad"))),
    )
