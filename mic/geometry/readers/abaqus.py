"""Abaqus and CalculiX input decks (``.inp``): nodes and sheet elements of all parts, placed as their instances say."""

from __future__ import annotations

import re
from dataclasses import replace
from io import StringIO
from pathlib import Path

import meshlane

from mic.geometry.readers.raw import RawMesh, from_meshlane

__all__ = ["read"]

TYPE = re.compile(r"^(\*\s*ELEMENT\b.*?\bTYPE\s*=\s*)(\w+)", re.IGNORECASE | re.MULTILINE)
SOLID = re.compile(r"(C3D|SC|CSS|AC3D|DC3D)\d")  # continuum shells have a top and a bottom, hence no mid-surface
SHEET = re.compile(
    r"(?:S|STRI|DS|M3D|SFM3D|R3D|CPS|CPE|DC2D|AC2D)(\d)\w*"
)  # shells, membranes, rigid and plane elements
ALIKE = {"3": "S3", "4": "S4", "6": "STRI65", "8": "S8R", "9": "S9R5"}  # by the number of nodes


def read(path: Path) -> RawMesh:
    """Nodes and elements of a deck; included files are followed.

    meshlane passes over element types that it does not know, which would leave holes. What counts here is a type's
    number of nodes, so each sheet is read under the name of a shell that meshlane knows.
    """
    text = path.read_text(encoding="utf-8", errors="replace")
    deck = StringIO(TYPE.sub(lambda found: found[1] + _alike(found[2].upper()), text))
    deck.name = str(path)  # included files are found from here
    solids = {found[2].upper() for found in TYPE.finditer(text) if SOLID.match(found[2].upper())}
    mesh = from_meshlane(meshlane.abaqus.read(deck))
    return replace(mesh, solids=tuple(sorted({*mesh.solids, *solids})))


def _alike(kind: str) -> str:
    sheet = SHEET.fullmatch(kind)
    return ALIKE.get(sheet[1], kind) if sheet else kind
