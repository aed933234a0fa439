"""Ansys Mechanical APDL decks (``.cdb``, written by ``CDWRITE``): shells, components, sections, materials.

meshlane reads only nodes, elements and components of these files, without sections, materials or node numbers.
"""

from __future__ import annotations

import re
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path

from mic.errors import FormatError
from mic.geometry.deck import Sheet
from mic.geometry.readers.deck_text import located, number_range, take, text_lines
from mic.geometry.readers.elements import Gathered
from mic.geometry.readers.raw_mesh import RawMesh

__all__ = ["read"]

SHELLS = {28, 41, 43, 63, 93, 131, 132, 143, 150, 157, 181, 281}
SOLIDS = {5, 45, 46, 64, 65, 70, 73, 87, 90, 92, 95, 96, 97, 98, 117, 122, 123, 147, 148, 162, 164, 168, 185, 186, 187}
SOLIDS |= {190, 191, 226, 227, 231, 232, 236, 237, 272, 273, 278, 279, 285}  # 190: a solid shell
FORMAT = re.compile(r"\(\s*(\d+)i(\d+)\s*(?:,\s*(\d+)[efg](\d+))?", re.IGNORECASE)
SIDES = {"TOP": -0.5, "BOT": 0.5, "MID": 0.0}  # offset by SECOFFSET, which names the skin of the nodes


def read(path: Path) -> RawMesh:
    """Nodes, shells, components, shell sections and isotropic materials of a deck.

    Raises
    ------
    FormatError
        Naming the line, if a block is truncated, a number is invalid, or the type of an element is undefined.
    """
    gathered = Gathered()
    types: dict[int, int] = {}
    sections: dict[str, Sheet] = {}
    material_of: dict[str, str] = {}
    materials: dict[str, dict[str, float]] = {}
    elements: dict[int, tuple[int, str]] = {}  # material and section
    section = ""
    lines = iter(enumerate(text_lines(path), 1))
    for number, line in lines:
        words = [word.strip() for word in line.split("!")[0].split(",")]
        command = words[0].upper()
        with located(f"line {number}", command):
            if command == "ET":
                types[int(words[1])] = int(re.sub(r"\D", "", words[2]))
            elif command == "ETBLOCK":
                _next(lines)
                for text in _block(lines):
                    fields = text.split()
                    types[int(fields[0])] = int(fields[1])
            elif command == "NBLOCK":
                _nodes(gathered, lines)
            elif command == "EBLOCK":
                if "SOLID" not in (word.upper() for word in words):
                    raise FormatError("only EBLOCK in the format SOLID is supported; write the deck with CDWRITE")
                _elements(gathered, lines, types, elements)
            elif command == "CMBLOCK":
                _component(gathered, lines, words)
            elif command == "SECTYPE":
                section = words[1] if words[2].upper() == "SHELL" else ""
            elif command == "SECDATA" and section:
                _layer(sections, material_of, section, words[1:])
            elif command == "SECBLOCK" and section:
                for _ in range(int(words[1])):
                    _layer(sections, material_of, section, [word.strip() for word in _next(lines).split(",")])
            elif command == "SECOFFSET" and section:
                _offset(sections, section, words)
            elif command == "MPDATA" and words[3].upper() in ("EX", "NUXY", "PRXY"):
                materials.setdefault(words[4], {}).setdefault(words[3].upper(), float(words[6]))
            elif command == "MP" and words[1].upper() in ("EX", "NUXY", "PRXY"):
                materials.setdefault(words[2], {}).setdefault(words[1].upper(), float(words[3]))
    if not gathered.points:
        raise FormatError("there is no block of nodes (NBLOCK); write the deck with CDWRITE")
    _assign_sheets(gathered, elements, sections, material_of, materials)
    return gathered.mesh()


def _next(lines: Iterator[tuple[int, str]]) -> str:
    """The next line."""
    return take((line for _, line in lines), "this block has no end: the file is cut short; export it again")


def _block(lines: Iterator[tuple[int, str]]) -> Iterator[str]:
    """Lines up to the end of a block: -1, or N in a block of nodes."""
    while True:
        line = _next(lines)
        if line.split(",")[0].strip() == "-1" or line.upper().startswith("N,"):
            return
        yield line


def _columns(text: str, width: int) -> list[str]:
    """Fields of fixed width."""
    return [text[i : i + width].strip() for i in range(0, len(text.rstrip()), width)]


def _format(text: str) -> tuple[int, int, int]:
    """Integers per line, their width, and the width of reals, of a format such as ``(3i9,6e21.13e3)``."""
    found = FORMAT.match(text.strip())
    if found is None:
        raise FormatError(f"{text.strip()[:40]!r} is not the format of a block, such as (3i9,6e21.13)")
    return int(found[1]), int(found[2]), int(found[4] or 0)


def _nodes(gathered: Gathered, lines: Iterator[tuple[int, str]]) -> None:
    """Nodes of an NBLOCK."""
    count, width, real = _format(_next(lines))
    if not real:
        raise FormatError("the format of this block of nodes has no coordinates")
    for line in _block(lines):
        number = int(line[:width])
        fields = _columns(line[count * width :], real)[:3]
        x, y, z = (float(text or 0) for text in fields + [""] * (3 - len(fields)))
        gathered.add_point((number,), (x, y, z))


def _elements(gathered: Gathered, lines: Iterator[tuple[int, str]], types, elements) -> None:
    """Elements of an EBLOCK: material, type, real set, section, …, node count, …, number, nodes, perhaps continued."""
    _, width, _ = _format(_next(lines))
    for line in _block(lines):
        fields = [int(text) for text in _columns(line, width)]
        count, number, nodes = fields[8], fields[10], fields[11:]
        while len(nodes) < count:
            nodes += [int(text) for text in _columns(_next(lines), width)]
        kind = types.get(fields[1])
        if kind is None:
            raise FormatError(f"element {number} has the type {fields[1]}, which no ET defines; export the deck again")
        if kind not in SHELLS:
            name = f"type {kind}"
            gathered.add_other((name, number), name, kind in SOLIDS)
            continue
        gathered.add_sheet((number,), [(node,) for node in nodes[:4]], [(node,) for node in nodes[4:count] if node])
        elements[number] = (fields[0], str(fields[3]))


def _component(gathered: Gathered, lines: Iterator[tuple[int, str]], words: list[str]) -> None:
    """A named set of numbers; a negative number ends a range that begins at the number before it."""
    name, kind, count = words[1], words[2].upper(), int(words[3].split()[0])
    _, width, _ = _format(_next(lines))
    numbers: list[int] = []
    taken = 0
    while taken < count:
        for text in _columns(_next(lines), width):
            taken += 1
            value = int(text)
            numbers += [value] if value > 0 else number_range(numbers[-1] + 1, -value)
    into = gathered.node_sets if kind.startswith("NODE") else gathered.element_sets
    into.setdefault(name, []).extend((number,) for number in numbers)


def _layer(sections: dict[str, Sheet], material_of: dict[str, str], section: str, words: list[str]) -> None:
    """Add a layer of a shell section: thickness, material."""
    before = sections.get(section, Sheet())
    sections[section] = replace(before, thickness=(before.thickness or 0.0) + float(words[0]))
    material = words[1] if len(words) > 1 else ""
    material_of[section] = material if material_of.get(section, material) == material else ""


def _offset(sections: dict[str, Sheet], section: str, words: list[str]) -> None:
    """Offset of a section, which may precede its layers."""
    place = words[1].upper()
    if place not in SIDES:
        raise FormatError(f"SECOFFSET {place} is not supported; use TOP, MID or BOT")
    sections[section] = replace(sections.get(section, Sheet()), offset=SIDES[place])


def _assign_sheets(gathered: Gathered, elements, sections, material_of, materials) -> None:
    """Sections and materials of the shells; sections are parts."""
    for number, (material, section) in elements.items():
        gathered.add_to_property(section, (number,))
        sheet = sections.get(section, Sheet())
        name = material_of.get(section) or str(material)
        of = materials.get(name, {})
        poisson = of.get("PRXY", of.get("NUXY"))
        material = name if of else None
        gathered.sheets[number,] = replace(sheet, young=of.get("EX"), poisson=poisson, material=material)
    gathered.parts = [name for name in gathered.element_sets if name.startswith("PID ")]
