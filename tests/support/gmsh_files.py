"""Mesh files that gmsh writes."""

from collections.abc import Iterator
from contextlib import contextmanager

import pytest

__all__ = ["gmsh_model", "rectangles"]


@contextmanager
def gmsh_model() -> Iterator:
    """The module gmsh with an empty model; the test is skipped where it, or a library that it needs, is missing."""
    gmsh = pytest.importorskip("gmsh", exc_type=(ImportError, OSError))
    gmsh.initialize()
    try:
        gmsh.option.setNumber("General.Terminal", 0)
        yield gmsh
    finally:
        gmsh.finalize()


def rectangles(gmsh, count, z=0.0) -> list[int]:
    """Meshed surfaces of 3 mm by 2 mm beside each other along x; the second one has quadrilaterals."""
    sheets = [gmsh.model.occ.addRectangle(3 * i, 0, z, 3, 2) for i in range(count)]
    gmsh.model.occ.fragment([(2, sheets[0])], [(2, sheet) for sheet in sheets[1:]])
    gmsh.model.occ.synchronize()
    gmsh.model.mesh.setRecombine(2, sheets[1])
    gmsh.model.mesh.generate(2)
    return sheets
