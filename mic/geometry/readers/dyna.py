"""LS-DYNA keyword files (``.k``, ``.key``, ``.dyn``): shells with their parts, sections, materials and sets.

Read here and not by a library: what there is reads nodes and elements alone, in fixed fields.
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

#: Materials whose first card is number, density, Young's modulus and Poisson's ratio.
ELASTIC = re.compile(
    r"(ELASTIC|PLASTIC_KINEMATIC|POWER_LAW_PLASTICITY|PIECEWISE_LINEAR_PLASTICITY|MODIFIED_PIECEWISE_LINEAR_PLASTICITY"
    r"|RIGID|3-PARAMETER_BARLAT|TRANSVERSELY_ANISOTROPIC_ELASTIC_PLASTIC|0?(01|03|18|20|24|36|37)|123)"
)
REFUSED = ("INCLUDE_TRANSFORM", "NODE_TRANSFORM", "NODE_SCALAR", "ELEMENT_GENERATE", "NODE_MERGE_TOLERANCE")
DEPTH = 20  # files that include files
WIDE, USUAL = 20, 10  # columns of a field on all cards but those of nodes and elements


def read(path: Path) -> RawMesh:
    """Nodes and shells of a keyword file, and what it tells of them; included files are followed.

    Raises
    ------
    FormatError
        Naming the line, if a field is no number, or a keyword moves or makes mesh by a rule.
    """
    gathered = Gathered()
    sections: dict[str, Sheet] = {}
    materials: dict[str, Sheet] = {}
    parts: dict[str, tuple[str, str, str]] = {}
    own: list[tuple[tuple[int], str, Sheet | None, float | None]] = []
    for where, keyword, cards, wide in _blocks(path):
        base, *options = keyword.split("_")
        try:
            if keyword.startswith(REFUSED):
                raise FormatError(f"*{keyword} makes or moves mesh by a rule; export the mesh itself")
            if keyword == "NODE":
                for line in cards:
                    fields = _split(line, (20, 20, 20, 20) if wide else (8, 16, 16, 16))
                    gathered.add_point((int(fields[0]),), tuple(_real(text) for text in fields[1:4]))
            elif keyword.startswith("ELEMENT_SHELL"):
                own += _shells(gathered, keyword, cards, wide)
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
                gathered.uncounted[keyword] = gathered.uncounted.get(keyword, 0) + 1
        except FormatError as problem:
            raise FormatError(f"{where}: {problem}") from None
        except (ValueError, IndexError):
            raise FormatError(f"{where}: a field of this *{keyword} is no number, or is missing") from None
    for key, part, thickness, offset in own:
        title, section, material = parts.get(part, ("", "", ""))
        of = materials.get(material, Sheet(material=material or None))
        sheet = replace(sections.get(section, Sheet()), young=of.young, poisson=of.poisson, material=of.material)
        if thickness is not None:
            sheet = replace(sheet, thickness=thickness.thickness)  # its own, which differs from node to node if None
        if offset is not None:
            if not sheet.thickness:
                raise FormatError(f"element {key[0]} has an offset and no thickness; give its section a thickness")
            sheet = replace(sheet, offset=offset / sheet.thickness)
        if sheet != Sheet():
            gathered.sheets[key] = sheet
    titles = [title for title, *_ in parts.values()]
    for number in dict.fromkeys(part for _, part, *_ in own):
        label, title = f"PID {number}", parts.get(number, ("",))[0]
        alone = bool(title) and titles.count(title) == 1
        gathered.parts.append(title if alone else label)
        if title:
            gathered.element_sets.setdefault(title, []).extend(gathered.element_sets[label])
    return gathered.mesh()


def _shells(gathered: Gathered, keyword: str, cards: list[str], wide: bool):
    """Shells with what their own cards tell: key, part, thickness, offset."""
    extra = sum(option in keyword for option in ("_THICKNESS", "_BETA", "_MCID", "_DOF"))
    extra = min(extra, 1) + ("_OFFSET" in keyword)
    if "_COMPOSITE" in keyword:
        raise FormatError(f"*{keyword}: layers by element are not read; use *SECTION_SHELL or *PART_COMPOSITE")
    cards = list(cards)
    while cards:
        fields = _split(cards.pop(0), (WIDE if wide else 8,) * 10)
        key, part = (int(fields[0]),), fields[1]
        nodes = [int(text) for text in fields[2:10] if text]
        corners = [(node,) for node in nodes[:4] if node]
        midside = [(node,) for node in nodes[4:] if node]
        if len(corners) < 3:
            raise FormatError(f"element {key[0]} has fewer than three nodes")
        gathered.add_sheet(key, corners, midside)
        gathered.element_sets.setdefault(f"PID {part}", []).append(key)
        more = [cards.pop(0) for _ in range(extra)]
        thickness, offset = None, None
        if "_THICKNESS" in keyword and more:
            values = {_real(text) for text in _split(more[0], (16,) * 5)[: len(corners)] if text}
            thickness = Sheet(thickness=values.pop() if len(values) == 1 else None) if values - {0.0} else None
            if "_THICKNESS" in keyword and len(midside):
                cards.pop(0)  # thicknesses at the midside nodes
        if "_OFFSET" in keyword:
            offset = _real(_split(more[-1], (16,))[0])
        yield key, part, thickness, offset


def _others(gathered: Gathered, keyword: str, cards: list[str], wide: bool) -> None:
    """Elements that are no shells; thick shells are solids."""
    kind = "_".join(keyword.split("_")[1:2])
    step = 2 if kind == "SOLID" and len(cards) > 1 and len(cards[0].replace(",", " ").split()) == 2 else 1
    if kind in ("SOLID", "TSHELL"):
        gathered.solids.add(kind)
    for line in cards[::step]:
        fields = _split(line, (WIDE if wide else 8,) * 2)
        gathered.kinds[kind, int(fields[0])] = kind
        if kind in gathered.solids:
            gathered.element_sets.setdefault(f"PID {fields[1]}", []).append((kind, int(fields[0])))


def _sections(cards: list[str], wide: bool, titled: bool) -> dict[str, Sheet]:
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
    title = cards[0].strip() if "TITLE" in keyword else ""
    rest = cards[1:] if "TITLE" in keyword else cards
    number = _fields(rest[0], wide)[0]
    members = [int(text) for line in rest[1:] for text in _fields(line, wide) if text and int(text)]
    into = gathered.node_sets if "NODE" in keyword else gathered.element_sets
    into.setdefault(title or f"SET {number}", []).extend((member,) for member in members)


# ---- the text of a file


def _blocks(path: Path, above: tuple[Path, ...] = ()) -> Iterator[tuple[str, str, list[str], bool]]:
    """Place, name and cards of every keyword, and whether its fields are wide."""
    if path in above or len(above) > DEPTH:
        raise FormatError(f"{above[-1].name} includes {path.name}, which includes it in turn")
    wide, where, keyword, cards = False, "", "", list[str]()
    lines = path.read_text(encoding="utf-8-sig", errors="replace").splitlines()
    if not above and not any(line.startswith("*") for line in lines):
        raise FormatError("it holds no keyword; it is no keyword file of LS-DYNA")
    for number, line in enumerate([*lines, "*END"], 1):
        if line.startswith("$") or (not line.strip() and keyword not in ("PART",)):
            continue
        if not line.startswith("*"):
            cards.append(line)
            continue
        if keyword == "INCLUDE":
            for name in cards:
                other = path.parent / name.strip().replace("\\", "/")
                if not other.is_file():
                    raise FormatError(f"{where}: it includes {name.strip()}, and there is no file {other}")
                yield from _blocks(other, (*above, path))
        elif keyword.startswith("INCLUDE") and not keyword.startswith("INCLUDE_TRANSFORM"):
            raise FormatError(f"{where}: *{keyword} is not followed; use *INCLUDE")
        elif keyword:
            yield where, keyword.removesuffix("%").strip(), cards, wide or keyword.endswith("%")
        where = f"line {number}" + (f" of {path.name}" if above else "")
        keyword, cards = line[1:].strip().upper(), []
        if keyword.startswith("KEYWORD"):
            wide = bool(re.search(r"LONG\s*=\s*Y", keyword))
            if re.search(r"I10\s*=\s*Y", keyword):
                raise FormatError(f"{where}: fields of ten columns (I10=Y) are not read; write LONG=Y, or neither")
            keyword = ""
        if keyword == "END":
            return


def _split(line: str, widths: tuple[int, ...]) -> list[str]:
    """Fields of a card, as many as widths, blank where nothing stands."""
    if "," in line:
        fields = [text.strip() for text in line.split(",")]
    else:
        ends = [sum(widths[:i]) for i in range(len(widths) + 1)]
        fields = [line[a:b].strip() for a, b in zip(ends, ends[1:])]
    return (fields + [""] * len(widths))[: len(widths)]


def _fields(line: str, wide: bool) -> list[str]:
    return _split(line, (WIDE if wide else USUAL,) * 8)


def _real(text: str) -> float:
    if text.startswith("&"):
        raise FormatError(f"{text} is a parameter; write the file with numbers")
    return float(text.upper().replace("D", "E")) if text else 0.0
