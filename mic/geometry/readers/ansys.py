"""Ansys Mechanical APDL decks (``.cdb``, as ``CDWRITE`` writes them): shells, components, sections, materials.

Read here and not by a library: meshlane reads nodes, elements and components of these files, and neither the sections
nor the materials nor the numbers of nodes.
"""

from __future__ import annotations

import re
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path

from mic.errors import FormatError
from mic.geometry.deck import Sheet
from mic.geometry.readers.elements import Gathered
from mic.geometry.readers.raw_mesh import RawMesh

__all__ = ["read"]

SHELLS = {28, 41, 43, 63, 93, 131, 132, 143, 150, 157, 181, 281}
SOLIDS = {5, 45, 46, 64, 65, 70, 73, 87, 90, 92, 95, 96, 97, 98, 117, 122, 123, 147, 148, 162, 164, 168, 185, 186, 187}
SOLIDS |= {190, 191, 226, 227, 231, 232, 236, 237, 272, 273, 278, 279, 285}  # 190: a solid shell
FORMAT = re.compile(r"\(\s*(\d+)i(\d+)\s*(?:,\s*(\d+)[efg](\d+))?", re.IGNORECASE)
SIDES = {"TOP": -0.5, "BOT": 0.5, "MID": 0.0}  # SECOFFSET: the skin that the nodes lie on


def read(path: Path) -> RawMesh:
    """Nodes, shells, components, shell sections and isotropic materials of a deck.

    Raises
    ------
    FormatError
        Naming the line, if a block is cut short or holds what is no number, or an element's type is not given.
    """
    gathered = Gathered()
    types: dict[int, int] = {}
    sections: dict[str, Sheet] = {}
    material_of: dict[str, str] = {}
    materials: dict[str, dict[str, float]] = {}
    elements: dict[int, tuple[int, str, str]] = {}
    section = ""
    lines = _Lines(path)
    for where, line in lines:
        words = [word.strip() for word in line.split("!")[0].split(",")]
        command = words[0].upper()
        try:
            if command == "ET":
                types[int(words[1])] = int(re.sub(r"\D", "", words[2]))
            elif command == "ETBLOCK":
                lines.take()
                for text in lines.block():
                    fields = text.split()
                    types[int(fields[0])] = int(fields[1])
            elif command == "NBLOCK":
                _nodes(gathered, lines)
            elif command == "EBLOCK":
                if "SOLID" not in (word.upper() for word in words):
                    raise FormatError("elements are read from EBLOCK in the format SOLID; write the deck by CDWRITE")
                _elements(gathered, lines, types, elements)
            elif command == "CMBLOCK":
                _component(gathered, lines, words)
            elif command == "SECTYPE":
                section = words[1] if words[2].upper() == "SHELL" else ""
            elif command == "SECDATA" and section:
                _layer(sections, material_of, section, words[1:])
            elif command == "SECBLOCK" and section:
                for _ in range(int(words[1])):
                    _layer(sections, material_of, section, [word.strip() for word in lines.take().split(",")])
            elif command == "SECOFFSET" and section:
                _offset(sections, section, words)
            elif command == "MPDATA" and words[3].upper() in ("EX", "NUXY", "PRXY"):
                materials.setdefault(words[4], {}).setdefault(words[3].upper(), float(words[6]))
            elif command == "MP" and words[1].upper() in ("EX", "NUXY", "PRXY"):
                materials.setdefault(words[2], {}).setdefault(words[1].upper(), float(words[3]))
        except FormatError as problem:
            raise FormatError(f"{where}: {problem}") from None
        except (ValueError, IndexError):
            raise FormatError(f"{where}: a field of this {command} is no number, or is missing") from None
    if not gathered.points:
        raise FormatError("it holds no block of nodes (NBLOCK); it is no deck that CDWRITE wrote")
    _tell(gathered, elements, sections, material_of, materials)
    return gathered.mesh()


class _Lines:
    """The lines of a deck, one by one or block by block."""

    def __init__(self, path: Path):
        self.lines = path.read_text(encoding="utf-8-sig", errors="replace").splitlines()
        self.at = 0

    def __iter__(self) -> Iterator[tuple[str, str]]:
        while self.at < len(self.lines):
            self.at += 1
            yield f"line {self.at}", self.lines[self.at - 1]

    def take(self) -> str:
        """The next line."""
        if self.at >= len(self.lines):
            raise FormatError("this block has no end: the file is cut short; export it again")
        self.at += 1
        return self.lines[self.at - 1]

    def block(self) -> Iterator[str]:
        """Lines up to the one that says -1, or ends a block of nodes."""
        while True:
            line = self.take()
            if line.split(",")[0].strip() == "-1" or line.upper().startswith("N,"):
                return
            yield line


def _columns(text: str, width: int) -> list[str]:
    return [text[i : i + width].strip() for i in range(0, len(text.rstrip()), width)]


def _format(text: str) -> tuple[int, int, int]:
    """Integers a line, their width, and the width of reals, of a line such as ``(3i9,6e21.13e3)``."""
    found = FORMAT.match(text.strip())
    if found is None:
        raise FormatError(f"{text.strip()[:40]!r} is not the format of a block, such as (3i9,6e21.13)")
    return int(found[1]), int(found[2]), int(found[4] or 0)


def _nodes(gathered: Gathered, lines: _Lines) -> None:
    count, width, real = _format(lines.take())
    if not real:
        raise FormatError("the format of this block of nodes has no coordinates")
    for line in lines.block():
        number = int(line[:width])
        fields = _columns(line[count * width :], real)[:3]
        x, y, z = (float(text or 0) for text in fields + [""] * (3 - len(fields)))
        gathered.add_point((number,), (x, y, z))


def _elements(gathered: Gathered, lines: _Lines, types, elements) -> None:
    """Material, type, real set, section, …, number of nodes, …, number, and the nodes, which may go on in a line."""
    _, width, _ = _format(lines.take())
    for line in lines.block():
        fields = [int(text) for text in _columns(line, width)]
        count, number, nodes = fields[8], fields[10], fields[11:]
        while len(nodes) < count:
            nodes += [int(text) for text in _columns(lines.take(), width)]
        kind = types.get(fields[1])
        if kind is None:
            raise FormatError(f"element {number} is of a type {fields[1]} that no ET gives")
        if kind not in SHELLS:
            name = f"type {kind}"
            gathered.kinds[name, number] = name
            if kind in SOLIDS:
                gathered.solids.add(name)
            continue
        gathered.add_sheet((number,), [(node,) for node in nodes[:4]], [(node,) for node in nodes[4:count] if node])
        elements[number] = (fields[0], str(fields[3]), str(fields[2]))


def _component(gathered: Gathered, lines: _Lines, words: list[str]) -> None:
    """A named set: numbers, a negative one being the end of a row from the one before."""
    name, kind, count = words[1], words[2].upper(), int(words[3].split()[0])
    _, width, _ = _format(lines.take())
    numbers: list[int] = []
    taken = 0
    while taken < count:
        for text in _columns(lines.take(), width):
            taken += 1
            value = int(text)
            numbers += [value] if value > 0 else range(numbers[-1] + 1, -value + 1)
    into = gathered.node_sets if kind.startswith("NODE") else gathered.element_sets
    into.setdefault(name, []).extend((number,) for number in numbers)


def _layer(sections: dict[str, Sheet], material_of: dict[str, str], section: str, words: list[str]) -> None:
    """A layer of a shell section: thickness, material."""
    before = sections.get(section, Sheet())
    sections[section] = replace(before, thickness=(before.thickness or 0.0) + float(words[0]))
    material = words[1] if len(words) > 1 else ""
    material_of[section] = material if material_of.get(section, material) == material else ""


def _offset(sections: dict[str, Sheet], section: str, words: list[str]) -> None:
    """Where the nodes lie in the section; it may stand before the layers."""
    place = words[1].upper()
    if place not in SIDES:
        raise FormatError(f"SECOFFSET {place} is not read; use TOP, MID or BOT")
    sections[section] = replace(sections.get(section, Sheet()), offset=SIDES[place])


def _tell(gathered: Gathered, elements, sections, material_of, materials) -> None:
    """Sections and materials of the shells; parts are the sections where the deck has them."""
    for number, (material, section, _) in elements.items():
        gathered.element_sets.setdefault(f"PID {section}", []).append((number,))
        sheet = sections.get(section, Sheet())
        name = material_of.get(section) or str(material)
        of = materials.get(name, {})
        poisson = of.get("PRXY", of.get("NUXY"))
        sheet = replace(sheet, young=of.get("EX"), poisson=poisson, material=name if of else None)
        if sheet != Sheet():
            gathered.sheets[number,] = sheet
    gathered.parts = [name for name in gathered.element_sets if name.startswith("PID ")]
