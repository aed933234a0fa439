"""LS-DYNA keyword files (``.k``, ``.key``, ``.dyn``): shells with their parts, sections, materials and sets.

Existing libraries read only nodes and elements, in fixed fields.
"""

from __future__ import annotations

import re
from collections.abc import Iterator
from dataclasses import replace
from itertools import accumulate, pairwise
from pathlib import Path

from mic.errors import FormatError
from mic.geometry.deck import Sheet
from mic.geometry.readers.deck_text import included_file, located, real, refuse_recursion, text_lines
from mic.geometry.readers.elements import Gathered
from mic.geometry.readers.raw_mesh import RawMesh

__all__ = ["read"]

#: Materials whose first card is number, density, Young's modulus and Poisson's ratio.
ELASTIC = re.compile(
    r"(ELASTIC|PLASTIC_KINEMATIC|POWER_LAW_PLASTICITY|PIECEWISE_LINEAR_PLASTICITY|MODIFIED_PIECEWISE_LINEAR_PLASTICITY"
    r"|RIGID|3-PARAMETER_BARLAT|TRANSVERSELY_ANISOTROPIC_ELASTIC_PLASTIC|0?(01|03|18|20|24|36|37)|123)"
)
REFUSED = ("INCLUDE_TRANSFORM", "NODE_TRANSFORM", "NODE_SCALAR", "ELEMENT_GENERATE", "NODE_MERGE_TOLERANCE")
WIDE, NARROW = 20, 10  # columns of a field on cards other than nodes and elements


def read(path: Path) -> RawMesh:
    """Nodes and shells of a keyword file with their properties; included files are read too.

    Raises
    ------
    FormatError
        Naming the line, if a number is invalid, or a keyword moves or generates the mesh by a rule.
    """
    gathered = Gathered()
    sections: dict[str, Sheet] = {}
    materials: dict[str, Sheet] = {}
    parts: dict[str, tuple[str, str, str]] = {}
    shells: list[tuple[tuple[int], str, Sheet | None, float | None]] = []
    for where, keyword, cards, wide in _blocks(path):
        base, *options = keyword.split("_")
        with located(where, f"*{keyword}"):
            if keyword.startswith(REFUSED):
                raise FormatError(f"*{keyword} generates or moves the mesh by a rule; export the nodes and elements")
            if keyword == "NODE":
                for line in cards:
                    fields = _split(line, (20, 20, 20, 20) if wide else (8, 16, 16, 16))
                    gathered.add_point((int(fields[0]),), tuple(_real(text) for text in fields[1:4]))
            elif keyword.startswith("ELEMENT_SHELL"):
                shells += _shells(gathered, keyword, cards, wide)
            elif base == "ELEMENT":
                _others(gathered, keyword, cards, wide)
            elif base == "PART" and keyword in ("PART", "PART_INERTIA", "PART_CONTACT", "PART_COMPOSITE"):
                step = 2 if keyword == "PART" else len(cards)
                for title, card in zip(cards[::step], cards[1::step]):
                    fields = _fields(card, wide)
                    parts[fields[0]] = (title.strip(), fields[1], fields[2])
            elif keyword.startswith("SECTION_SHELL"):
                sections |= _sections(cards, wide, "TITLE" in options)
            elif base == "MAT" and ELASTIC.fullmatch("_".join(option for option in options if option != "TITLE")):
                fields = _fields(cards["TITLE" in options], wide)
                materials[fields[0]] = Sheet(young=_real(fields[2]), poisson=_real(fields[3]), material=fields[0])
            elif keyword.startswith(("SET_NODE_LIST", "SET_SHELL_LIST", "SET_NODE_TITLE")) or keyword == "SET_NODE":
                _set(gathered, keyword, cards, wide)
            elif keyword.startswith("CONSTRAINED_"):
                gathered.unnumbered[keyword] += 1
    for key, part, thickness, offset in shells:
        title, section, material = parts.get(part, ("", "", ""))
        of = materials.get(material, Sheet(material=material or None))
        sheet = replace(sections.get(section, Sheet()), young=of.young, poisson=of.poisson, material=of.material)
        if thickness is not None:
            sheet = replace(sheet, thickness=thickness.thickness)  # None if it differs between the nodes
        if offset is not None:
            if not sheet.thickness:
                raise FormatError(f"element {key[0]} has an offset and no thickness; give its section a thickness")
            sheet = replace(sheet, offset=offset / sheet.thickness)
        gathered.sheets[key] = sheet
    gathered.name_parts((part for _, part, *_ in shells), {part: title for part, (title, *_) in parts.items()})
    return gathered.mesh()


def _shells(gathered: Gathered, keyword: str, cards: list[str], wide: bool):
    """Shells with the data on their own cards: key, part, thickness, offset."""
    extra = sum(option in keyword for option in ("_THICKNESS", "_BETA", "_MCID", "_DOF"))
    extra = min(extra, 1) + ("_OFFSET" in keyword)
    if "_COMPOSITE" in keyword:
        raise FormatError(f"*{keyword}: layers by element are not supported; use *SECTION_SHELL or *PART_COMPOSITE")
    cards = list(cards)
    while cards:
        fields = _split(cards.pop(0), (WIDE if wide else 8,) * 10)
        key, part = (int(fields[0]),), fields[1]
        nodes = [int(text) for text in fields[2:10] if text]
        corners = [(node,) for node in nodes[:4] if node]
        midside = [(node,) for node in nodes[4:] if node]
        if len(corners) < 3:
            raise FormatError(f"element {key[0]} has fewer than three nodes; correct it")
        gathered.add_sheet(key, corners, midside)
        gathered.add_to_property(part, key)
        more = [cards.pop(0) for _ in range(extra)]
        thickness, offset = None, None
        if "_THICKNESS" in keyword and more:
            values = {_real(text) for text in _split(more[0], (16,) * 5)[: len(corners)] if text}
            thickness = Sheet(thickness=values.pop() if len(values) == 1 else None) if values - {0.0} else None
            if midside:
                cards.pop(0)  # thicknesses at the midside nodes
        if "_OFFSET" in keyword:
            offset = _real(_split(more[-1], (16,))[0])
        yield key, part, thickness, offset


def _others(gathered: Gathered, keyword: str, cards: list[str], wide: bool) -> None:
    """Elements other than shells; thick shells count as solids."""
    kind = "_".join(keyword.split("_")[1:2])
    step = 2 if kind == "SOLID" and len(cards) > 1 and len(cards[0].replace(",", " ").split()) == 2 else 1
    solid = kind in ("SOLID", "TSHELL")
    for line in cards[::step]:
        fields = _split(line, (WIDE if wide else 8,) * 2)
        key = kind, int(fields[0])
        gathered.add_other(key, kind, solid)
        if solid:
            gathered.add_to_property(fields[1], key)


def _sections(cards: list[str], wide: bool, titled: bool) -> dict[str, Sheet]:
    """Shell sections by number."""
    found, cards = {}, list(cards)
    while cards:
        if titled:
            cards.pop(0)
        head, body = _fields(cards.pop(0), wide), _fields(cards.pop(0), wide)
        if head[6] == "1":  # angles of layers, eight a card
            del cards[: -(-int(float(head[3] or 2)) // 8)]
        values = {_real(text) for text in body[:4] if text}
        place = _real(body[4]) if body[4] else 0.0
        # NLOC: the skin that the nodes lie on, 1 the upper one, −1 the lower one
        offset = -place / 2 if abs(place) == 1 else None
        found[head[0]] = Sheet(values.pop() if len(values - {0.0}) == 1 and len(values) == 1 else None, offset)
    return found


def _set(gathered: Gathered, keyword: str, cards: list[str], wide: bool) -> None:
    """A set of nodes or shells."""
    title = cards[0].strip() if "TITLE" in keyword else ""
    rest = cards[1:] if "TITLE" in keyword else cards
    number = _fields(rest[0], wide)[0]
    members = [int(text) for line in rest[1:] for text in _fields(line, wide) if text and int(text)]
    into = gathered.node_sets if "NODE" in keyword else gathered.element_sets
    into.setdefault(title or f"SET {number}", []).extend((member,) for member in members)


# ---- the text of a file


def _blocks(path: Path, above: tuple[Path, ...] = ()) -> Iterator[tuple[str, str, list[str], bool]]:
    """Place, name and cards of every keyword, and whether its fields are wide."""
    refuse_recursion(path, above)
    wide, where, keyword, cards = False, "", "", list[str]()
    lines = text_lines(path)
    if not above and not any(line.startswith("*") for line in lines):
        raise FormatError("there is no keyword; the file is no keyword file of LS-DYNA")
    for number, line in enumerate([*lines, "*END"], 1):
        if line.startswith("$") or (not line.strip() and keyword not in ("PART",)):
            continue
        if not line.startswith("*"):
            cards.append(line)
            continue
        if keyword == "INCLUDE":
            for name in cards:
                yield from _blocks(included_file(path, name.strip(), where), (*above, path))
        elif keyword.startswith("INCLUDE") and not keyword.startswith("INCLUDE_TRANSFORM"):
            raise FormatError(f"{where}: *{keyword} is not supported; use *INCLUDE")
        elif keyword:
            yield where, keyword.removesuffix("%").strip(), cards, wide or keyword.endswith("%")
        where = f"line {number}" + (f" of {path.name}" if above else "")
        keyword, cards = line[1:].strip().upper(), []
        if keyword.startswith("KEYWORD"):
            wide = bool(re.search(r"LONG\s*=\s*Y", keyword))
            if re.search(r"I10\s*=\s*Y", keyword):
                raise FormatError(f"{where}: fields of ten columns (I10=Y) are not supported; use LONG=Y, or neither")
            keyword = ""
        if keyword == "END":
            return


def _split(line: str, widths: tuple[int, ...]) -> list[str]:
    """Fields of a card, as many as widths; blank if missing."""
    if "," in line:
        fields = [text.strip() for text in line.split(",")]
    else:
        ends = list(accumulate(widths, initial=0))
        fields = [line[a:b].strip() for a, b in pairwise(ends)]
    return (fields + [""] * len(widths))[: len(widths)]


def _fields(line: str, wide: bool) -> list[str]:
    """Eight fields of equal width."""
    return _split(line, (WIDE if wide else NARROW,) * 8)


def _real(text: str) -> float:
    """The number of a field; refuses parameters."""
    if text.startswith("&"):
        raise FormatError(f"{text} is a parameter, which is not supported; export the file with numbers")
    return real(text)
