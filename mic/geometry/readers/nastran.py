"""Nastran bulk data (``.bdf``, ``.nas``, ``.fem``): small, large and free fields, with or without sections above it.

Read here and not by a library: meshlane stumbles over the material angles of shells (``THETA``), needs a ``BEGIN BULK``
that many preprocessors leave out, and passes over coordinate systems in silence; pyNastran refuses numpy 2. Of a deck
only points and element corners are wanted, which are a few fixed fields each.
"""

from __future__ import annotations

import re
from collections.abc import Iterator
from pathlib import Path

import numpy as np

from mic.errors import FormatError
from mic.geometry.readers.raw import RawMesh

__all__ = ["read"]

TRIANGLES = ("CTRIA3", "CTRIA6", "CTRIAR")
QUADRILATERALS = ("CQUAD4", "CQUAD8", "CQUADR", "CQUAD")
SOLIDS = ("CTETRA", "CHEXA", "CPENTA", "CPYRA", "CPYRAM")
OTHERS = ("CBAR", "CBEAM", "CBEND", "CBUSH", "CBUSH1D", "CONROD", "CROD", "CTUBE", "CSHEAR", "CELAS1", "CELAS2", "CGAP")
REAL = re.compile(r"([+-]?(?:\d+\.?\d*|\.\d+))([+-]\d+)")  # 1.5-3: an exponent without its letter


def read(path: Path) -> RawMesh:
    """Grid points and shells of a deck, and the normals that it gives at its points (``SNORM``).

    Raises
    ------
    FormatError
        If points stand in a coordinate system of their own, an element names a point that is not there, the deck
        includes other files, or a field is no number.
    """
    number: dict[int, int] = {}
    points: list[list[float]] = []
    triangles: list[list[int]] = []
    quadrilaterals: list[list[int]] = []
    normals: dict[int, list[float]] = {}
    kinds: set[str] = set()
    for line, card in _cards(path.read_text(encoding="utf-8", errors="replace")):
        name = card[0]
        try:
            if name == "GRID":
                _basic_system(card[2])
                number[int(card[1])] = len(points)
                points.append([_real(field) for field in card[3:6]])
            elif name == "GRDSET":
                _basic_system(card[2])
            elif name == "SNORM":
                _basic_system(card[2], "normals", "SNORM field CID")
                normals[int(card[1])] = [_real(field) for field in card[3:6]]
            elif name in TRIANGLES:
                triangles.append([int(field) for field in card[3:6]])
            elif name in QUADRILATERALS:
                quadrilaterals.append([int(field) for field in card[3:7]])
            elif name in SOLIDS or name in OTHERS:
                kinds.add(name)
            elif name.split()[:1] == ["INCLUDE"]:
                raise FormatError("it includes another file; write the deck into one file")
        except FormatError as problem:
            raise FormatError(f"line {line}: {problem}") from None
        except ValueError:
            raise FormatError(f"line {line}: a field of this {name} is no number, or is missing") from None
    corners = lambda elements, count: np.array(
        [[number[point] for point in element] for element in elements], dtype=np.int64
    ).reshape(-1, count)
    told = lambda elements, count: np.array(
        [[normals.get(point, [np.nan] * 3) for point in element] for element in elements], dtype=float
    ).reshape(-1, count, 3)
    try:
        return RawMesh(
            np.array(points, dtype=float).reshape(-1, 3),
            corners(triangles, 3),
            corners(quadrilaterals, 4),
            tuple(sorted(kinds.intersection(SOLIDS))),
            tuple(sorted(kinds.intersection(OTHERS))),
            told(triangles, 3) if normals else None,
            told(quadrilaterals, 4) if normals else None,
        )
    except KeyError as problem:
        raise FormatError(f"an element names the point {problem.args[0]}, which has no GRID") from None


def _cards(text: str) -> Iterator[tuple[int, list[str]]]:
    """Line number and fields of every card, its continuations joined; eight fields stand for a missing rest."""
    lines = text.splitlines()
    begin = [i for i, line in enumerate(lines) if re.match(r"\s*BEGIN\b", line, re.IGNORECASE)]
    number, card = 0, []
    for i, line in enumerate(lines[begin[0] + 1 :] if begin else lines, begin[0] + 2 if begin else 1):
        line = line.split("$")[0].rstrip()
        if not line.strip():
            continue
        head, fields = _fields(line)
        if head == "ENDDATA":
            break
        if head[:1] in ("", "+", "*"):
            card += fields
        else:
            if card:
                yield number, card + [""] * 8
            number, card = i, [head, *fields]
    if card:
        yield number, card + [""] * 8


def _fields(line: str) -> tuple[str, list[str]]:
    """Name in capitals (a continuation's is empty or begins with + or *) and data fields of one line."""
    line = line.expandtabs(8)
    if "," in line:
        fields = [field.strip() for field in line.split(",")]
        head, fields = fields[0], fields[1:9]
        large = head.endswith("*") or head.startswith("*")
        fields = fields[:4] if large else fields
        wanted = 4 if large else 8
    else:
        head = line[:8].strip()
        large = head.endswith("*") or head.startswith("*")
        width, wanted = (16, 4) if large else (8, 8)
        fields = [line[8 + width * i : 8 + width * (i + 1)].strip() for i in range(wanted)]
    name = head.upper() if head.startswith(("+", "*")) else head.upper().rstrip("*").strip()
    return name, fields + [""] * (wanted - len(fields))


def _real(field: str) -> float:
    if not field:
        return 0.0
    return float(REAL.sub(r"\1e\2", field.upper().replace("D", "E")) if "E" not in field.upper() else field)


def _basic_system(field: str, what: str = "points", place: str = "GRID field CP") -> None:
    if field not in ("", "0"):
        raise FormatError(
            f"{what} are given in coordinate system {field}; write the deck in the basic system ({place} = 0)"
        )
