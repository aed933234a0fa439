"""Abaqus and CalculiX input decks (``.inp``): nodes and sheet elements of all parts, placed as their instances say, and
the normals that they give (``*NORMAL``)."""

from __future__ import annotations

import re
from dataclasses import replace
from io import StringIO
from pathlib import Path

import meshlane
import numpy as np

from mic.errors import FormatError
from mic.geometry.readers.raw import RawMesh, from_meshlane

__all__ = ["read"]

TYPE = re.compile(r"^(\*\s*ELEMENT\b.*?\bTYPE\s*=\s*)(\w+)", re.IGNORECASE | re.MULTILINE)
SOLID = re.compile(r"(C3D|SC|CSS|AC3D|DC3D)\d")  # continuum shells have a top and a bottom, hence no mid-surface
SHEET = re.compile(
    r"(?:S|STRI|DS|M3D|SFM3D|R3D|CPS|CPE|DC2D|AC2D)(\d)\w*"
)  # shells, membranes, rigid and plane elements
ALIKE = {"3": "S3", "4": "S4", "6": "STRI65", "8": "S8R", "9": "S9R5"}  # by the number of nodes

# A block of normals of elements: its data lines name an element, a node of it and three components.
NORMAL = re.compile(
    r"^\*\s*NORMAL\b(?![^\n]*CONTACT)[^\n]*\n((?:(?:\*\*|[^*])[^\n]*\n?)*)", re.IGNORECASE | re.MULTILINE
)
TURNED = re.compile(r"^\*\s*INSTANCE\b[^\n]*\n(?:[^*][^\n]*\n)?(?:[^,*\n]*,){6}", re.IGNORECASE | re.MULTILINE)
MARK = "mic normal"  # sets that carry the numbers of a normal's element and node through instances


def read(path: Path) -> RawMesh:
    """Nodes, elements and normals of a deck; included files are followed, except for normals in them.

    meshlane passes over element types that it does not know, which would leave holes. What counts here is a type's
    number of nodes, so each sheet is read under the name of a shell that meshlane knows.

    Raises
    ------
    FormatError
        If normals are given by names of sets, in numbers that are none, or in an instance that is turned.
    """
    text = path.read_text(encoding="utf-8", errors="replace")
    normals: list[list[float]] = []
    text = NORMAL.sub(lambda found: _as_sets(found[1], normals), text)
    if normals and TURNED.search(text):
        raise FormatError("it gives normals, and turns an instance; write it without instances, or without normals")
    deck = StringIO(TYPE.sub(lambda found: found[1] + _alike(found[2].upper()), text))
    deck.name = str(path)  # included files are found from here
    solids = {found[2].upper() for found in TYPE.finditer(text) if SOLID.match(found[2].upper())}
    read = meshlane.abaqus.read(deck)
    mesh = from_meshlane(read)
    if normals:
        triangles, quadrilaterals = (
            _at_corners(read, kind, elements, normals)
            for kind, elements in (("triangle", mesh.triangles), ("quad", mesh.quadrilaterals))
        )
        mesh = replace(mesh, triangle_normals=triangles, quadrilateral_normals=quadrilaterals)
    return replace(mesh, solids=tuple(sorted({*mesh.solids, *solids})))


def _as_sets(block: str, normals: list[list[float]]) -> str:
    """A block of normals as one set of elements and one of nodes for each, in the same place of the deck."""
    sets = []
    for line in block.splitlines():
        if not line.strip() or line.startswith("**"):
            continue
        fields = [field.strip() for field in line.split(",")]
        try:
            element, node, normal = int(fields[0]), int(fields[1]), [float(field) for field in fields[2:5]]
        except (ValueError, IndexError):
            normal = []
        if len(normal) != 3:
            raise FormatError(
                f"*NORMAL: {line.strip()!r} is not the numbers of an element and a node with three components; write "
                "normals so, or take them out"
            )
        name = f"{MARK} {len(normals)}"
        sets += [f'*ELSET, ELSET="{name}"', str(element), f'*NSET, NSET="{name}"', str(node)]
        normals.append(normal)
    return "".join(f"{line}\n" for line in sets)


def _at_corners(read, kind: str, elements: np.ndarray, normals: list[list[float]]) -> np.ndarray:
    """(k, c, 3) the normals at the corners (k, c) of one kind of elements, NaN where none is given."""
    told, first = np.full((*elements.shape, 3), np.nan), 0
    for number, block in enumerate(read.cells):
        if not block.type.startswith(kind):
            continue
        for name, points in read.point_sets.items():
            if name.strip('"').upper().startswith(MARK.upper()):
                rows = first + np.asarray(read.cell_sets[name][number], dtype=np.int64)
                at, corner = np.nonzero(np.isin(elements[rows], points))
                told[rows[at], corner] = normals[int(name.strip('"').split()[-1])]
        first += len(block.data)
    return told


def _alike(kind: str) -> str:
    sheet = SHEET.fullmatch(kind)
    return ALIKE.get(sheet[1], kind) if sheet else kind
