"""Nastran bulk data (``.bdf``, ``.nas``, ``.fem``, ``.dat``) in small, large and free fields.

meshlane fails on material angles of shells (``THETA``), requires ``BEGIN BULK``, which many preprocessors omit, and
ignores coordinate systems. pyNastran is a large package and rejects incomplete decks. Only points, shells and their
properties are needed.
"""

from __future__ import annotations

import re
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field, replace
from itertools import takewhile
from pathlib import Path

import numpy as np

from mic.errors import FormatError
from mic.geometry.deck import Sheet
from mic.geometry.readers.deck_text import (
    LONGEST,
    axes_of,
    included_file,
    located,
    refuse_recursion,
    take,
    text_lines,
)
from mic.geometry.readers.elements import Gathered, define
from mic.geometry.readers.raw_mesh import RawMesh

__all__ = ["cards", "lines", "read"]

#: Fields of each kind of shell: corners, mid-side nodes, ZOFFS, TFLAG, thicknesses.
SHELLS: dict[str, tuple[Sequence[int], Sequence[int], int | None, int, Sequence[int]]] = {
    "CTRIA3": (range(3, 6), (), 7, 10, range(11, 14)),
    "CTRIAR": (range(3, 6), (), 7, 10, range(11, 14)),
    "CTRIA6": (range(3, 6), range(6, 9), 10, 14, range(11, 14)),
    "CQUAD4": (range(3, 7), (), 8, 10, range(11, 15)),
    "CQUADR": (range(3, 7), (), 8, 10, range(11, 15)),
    "CQUAD8": (range(3, 7), range(7, 11), 16, 17, range(11, 15)),
    "CQUAD9": (range(3, 7), range(7, 12), None, 0, ()),
    "CQUAD": (range(3, 7), range(7, 12), None, 0, ()),
}
SOLIDS = ("CTETRA", "CHEXA", "CPENTA", "CPYRA", "CPYRAM")
#: Elements other than shells and solids.
OTHERS = re.compile(
    r"C(BAR|BEAM3?|BEND|BUSH|BUSH[12]D|CONROD|ROD|TUBE|SHEAR|ELAS\d|DAMP\d|GAP|MASS\d|VISC|WELD|FAST|SEAM|HBDY.|RAC.D"
    r"|TRIAX6?|QUADX.?|ONM[12]|ONROD)|R(BE1|BE2|BE3|BAR1?|ROD|JOINT|TRPLT1?|SSCON|SPLINE)|PLOTEL"
)
REAL = re.compile(r"([+-]?(?:\d+\.?\d*|\.\d+))([+-]\d+)")  # 1.5-3: an exponent without its letter
BULK = re.compile(r"\s*(BEGIN|GRID)\b", re.IGNORECASE)  # the end of case control
CASE_SET = re.compile(r"^\s*SET\s+(\d+)\s*=\s*((?:.*,\s*\n)*.*)", re.IGNORECASE | re.MULTILINE)
RANGE = re.compile(r"(\d+)(?:\s+THRU\s+(\d+))?")
HYPERMESH = re.compile(r'\$HMNAME\s+(COMP|PROP|PROPERTY)\s+(\d+)\s*"([^"]*)"\s*(\d*)')
HYPERMESH_SET = re.compile(r'\$HMSET\s+(\d+)\s+([12])\s*"([^"]*)"')
ANSA = re.compile(r"\$ANSA_NAME(?:_COMMENT)?;(\d+);(PSHELL|PCOMP|SET);([^;]*);")


@dataclass
class _Content:
    """Cards of a deck that are interpreted once all are read."""

    systems: dict[int, tuple[str, list[str], str]] = field(default_factory=dict)
    grids: dict[int, tuple[str, tuple[float, ...]]] = field(default_factory=dict)
    normals: dict[int, tuple[str, np.ndarray]] = field(default_factory=dict)
    default_system: str = ""
    properties: dict[int, tuple[Sheet, str]] = field(default_factory=dict)
    materials: dict[int, Sheet] = field(default_factory=dict)
    shells: list[tuple[str, list[str], str]] = field(default_factory=list)

    def add(self, gathered: Gathered, card: list[str], where: str) -> None:
        """Store a card, and add its elements to the mesh."""
        name = card[0]
        if name == "GRID":
            place = tuple(_real(text) for text in card[3:6])
            define(self.grids, int(card[1]), (card[2], place), f"grid point {card[1]}")
        elif name == "GRDSET":
            self.default_system = card[2]
        elif name.startswith("CORD"):
            self.systems[int(card[1])] = (name, card, where)
            if name[4:5] == "1" and card[5]:
                self.systems[int(card[5])] = (name, [name, *card[5:9], *[""] * 8], where)
        elif name == "SNORM":
            self.normals[int(card[1])] = (card[2], np.array([_real(text) for text in card[3:6]]))
        elif name in SHELLS:
            self.shells.append((name, card, where))
            corners, midside, *_ = SHELLS[name]
            nodes = [[(int(card[i]),) for i in corners], [(int(card[i]),) for i in midside if card[i]]]
            gathered.add_sheet((int(card[1]),), *nodes)
        elif name == "PSHELL":
            self.properties[int(card[1])] = _shell_property(card)
        elif name in ("PCOMP", "PCOMPG"):
            self.properties[int(card[1])] = _composite(card)
        elif name == "MAT1":
            self.materials[int(card[1])] = _material(card)
        elif name in SOLIDS or OTHERS.fullmatch(name):
            _add_other(gathered, name, card)
        elif name.startswith(("CTRI", "CQUAD")):
            raise FormatError(f"{name} is no known shell; known shells are {', '.join(SHELLS)}")


def read(path: Path) -> RawMesh:
    """Grid points and shells of a deck in the basic coordinate system, with their properties.

    Raises
    ------
    FormatError
        Naming the line, if a number is invalid, a coordinate system or an included file does not exist, or something is
        defined twice.
    """
    gathered, text, content = Gathered(), list(lines(path)), _Content()
    for where, card in cards(text):
        with located(where, card[0]):
            content.add(gathered, card, where)
    frames = _Frames(content)
    for number in content.grids:
        gathered.add_point((number,), tuple(frames.grid(number).tolist()))
    for number, (system, direction) in content.normals.items():
        point = gathered.points.get((number,))
        if point is not None:
            gathered.normals[number,] = tuple(frames.direction(system, direction, np.array(point)).tolist())
    for name, card, where in content.shells:
        with located(where, name):
            _assign_sheet(gathered, card, content)
    names, sets = _names([line for _, line in text])
    gathered.name_parts((int(card[2] or card[1]) for _, card, _ in content.shells), names)
    for name, (kind, numbers) in sets.items():
        for wanted, into in (("1", gathered.node_sets), ("2", gathered.element_sets)):
            if kind in (wanted, ""):
                into.setdefault(name, []).extend((number,) for number in numbers)
    return gathered.mesh("grid point")


# ---- contents of cards


def _assign_sheet(gathered: Gathered, card: list[str], content: _Content) -> None:
    """Assign the sheet of a shell: that of its property, with the shell's own thickness and offset if given."""
    _, _, zoffs, tflag, own = SHELLS[card[0]]
    number, pid = int(card[1]), int(card[2] or card[1])
    gathered.add_to_property(pid, (number,))
    sheet, mid = content.properties.get(pid, (Sheet(), ""))
    if mid.isdigit():
        of = content.materials.get(int(mid), Sheet())
        sheet = replace(sheet, young=of.young, poisson=of.poisson, material=mid)
    thicknesses = {_real(card[field]) for field in own if card[field]} if own and len(card) > own[-1] else set()
    if len(thicknesses) > 1:
        sheet = replace(sheet, thickness=None)
    elif thicknesses and thicknesses != {0.0}:
        relative = len(card) > tflag and card[tflag] == "1"
        sheet = replace(sheet, thickness=thicknesses.pop() * ((sheet.thickness or 1.0) if relative else 1.0))
    text = card[zoffs] if zoffs is not None and len(card) > zoffs else ""
    if text:
        sheet = replace(sheet, offset=_offset(text, sheet.thickness))
    gathered.sheets[number,] = sheet


def _offset(text: str, thickness: float | None) -> float:
    """ZOFFS over the thickness."""
    if text.upper() in ("TOP", "BOTTOM"):  # the skin on which the grid points lie
        return -0.5 if text.upper() == "TOP" else 0.5
    distance = _real(text)
    if not distance:
        return 0.0
    if not thickness:
        raise FormatError("a shell has an offset (ZOFFS) and no thickness; give its PSHELL a T, or remove ZOFFS")
    return distance / thickness


def _shell_property(card: list[str]) -> tuple[Sheet, str]:
    """Sheet and material number of a PSHELL."""
    thickness = _real(card[3]) or None
    text = card[13] if len(card) > 13 else ""  # OptiStruct
    return Sheet(thickness, _offset(text, thickness) if text else None), card[2]


def _composite(card: list[str]) -> tuple[Sheet, str]:
    """Sheet and material number of a PCOMP; a blank thickness or material repeats that of the ply before."""
    each, skipped = (4, 0) if card[0] == "PCOMP" else (8, 1)  # PCOMPG numbers its plies
    plies, mid, thickness = [], "", 0.0
    for i in range(9 + skipped, len(card) - 3, each):
        if not any(card[i : i + 2]):
            continue
        mid, thickness = card[i] or mid, _real(card[i + 1]) if card[i + 1] else thickness
        plies.append((mid, thickness))
    total = sum(thickness for _, thickness in plies) * (2 if card[8].upper() == "SYM" else 1)
    mids = {mid for mid, _ in plies}
    offset = _real(card[2]) / total + 0.5 if card[2] and total else None
    return Sheet(total or None, offset), mids.pop() if len(mids) == 1 else ""


def _material(card: list[str]) -> Sheet:
    """Isotropic material; E or ν may follow from G."""
    young, shear, poisson = (_real(field) if field else None for field in card[2:5])
    if poisson is None and young and shear:
        poisson = young / (2 * shear) - 1
    elif young is None and shear and poisson is not None:
        young = 2 * shear * (1 + poisson)
    return Sheet(young=young, poisson=poisson)


def _add_other(gathered: Gathered, name: str, card: list[str]) -> None:
    """Add an element that is no shell; elements without numbers are only counted."""
    if not card[1].isdigit():
        gathered.unnumbered[name] += 1
        gathered.solids.update({name} & {*SOLIDS})
        return
    key = (name, int(card[1]))
    gathered.add_other(key, name, name in SOLIDS)
    if name in SOLIDS and card[2].isdigit():
        gathered.add_to_property(int(card[2]), key)


class _Frames:
    """Coordinate systems, each defined in another one or by three grid points."""

    def __init__(self, content: _Content):
        self.content = content
        self.known: dict[int, tuple[str, np.ndarray, np.ndarray]] = {0: ("R", np.zeros(3), np.eye(3))}

    def point(self, system: str, place: np.ndarray, above: tuple[int, ...] = ()) -> np.ndarray:
        """A point in the basic system; `above` are the systems whose definition needs it."""
        kind, origin, axes = self._frame(system, above)
        r, about, third = place
        if kind == "R":
            return place if system in ("", "0") else origin + axes @ place
        about = np.radians(about)
        if kind == "C":
            return origin + axes @ np.array([r * np.cos(about), r * np.sin(about), third])
        third = np.radians(third)  # of a sphere: from the z axis, then about it
        away = np.array([np.sin(about) * np.cos(third), np.sin(about) * np.sin(third), np.cos(about)])
        return origin + axes @ (r * away)

    def direction(self, system: str, vector: np.ndarray, point: np.ndarray) -> np.ndarray:
        """A direction at a point of the basic system."""
        kind, origin, axes = self._frame(system)
        if kind == "R":
            return axes @ vector
        x, y, z = axes.T @ (point - origin)
        flat = np.hypot(x, y)
        radial = np.array([x, y, 0.0]) / flat if flat else np.array([1.0, 0, 0])
        around = np.array([-radial[1], radial[0], 0])
        if kind == "C":
            return axes @ (vector[0] * radial + vector[1] * around + vector[2] * np.array([0, 0, 1.0]))
        away = np.array([*(radial[:2] * flat), z]) / (np.hypot(flat, z) or 1.0)
        return axes @ (vector[0] * away + vector[1] * np.cross(around, away) + vector[2] * around)

    def _frame(self, text: str, above: tuple[int, ...] = ()) -> tuple[str, np.ndarray, np.ndarray]:
        """Kind, origin and axes of a coordinate system."""
        if text and not text.isdigit():
            raise FormatError(f"the coordinate system {text!r} must be a number")
        number = int(text or 0)
        if number in self.known:
            return self.known[number]
        if number not in self.content.systems:
            raise FormatError(f"points refer to coordinate system {number}, which does not exist; add it")
        name, card, where = self.content.systems[number]
        if number in above:
            raise FormatError(f"{where}: coordinate system {number} is defined by itself; correct its reference")
        by_points = name[4:5] == "1"
        with located(where, name):
            points = [int(text) for text in card[2:5]] if by_points else []
            values = np.zeros((0, 3)) if by_points else np.reshape([_real(text) for text in card[3:12]], (3, 3))
        places = [self.grid(point, (*above, number)) for point in points]
        places += [self.point(card[2], place, (*above, number)) for place in values]
        with located(where, name):
            z, x, y = axes_of(places, f"coordinate system {number}")
        self.known[number] = (name[5:6] or "R", places[0], np.column_stack([x, y, z]))
        return self.known[number]

    def grid(self, number: int, above: tuple[int, ...] = ()) -> np.ndarray:
        """A grid point in the basic system."""
        if number not in self.content.grids:
            raise FormatError(f"a coordinate system refers to grid point {number}, which does not exist; add it")
        system, place = self.content.grids[number]
        return self.point(system or self.content.default_system, np.array(place), above)


def _names(text: list[str]) -> tuple[dict[int, str], dict[str, tuple[str, list[int]]]]:
    """Names of properties and sets, with their kind, that preprocessors write into comments; members of the sets."""
    names: dict[int, str] = {}
    properties: dict[int, str] = {}
    called: dict[int, tuple[str, str]] = {}
    for line in text:
        if found := HYPERMESH.match(line):
            # the number of a component's property follows its name
            (names if found[1] == "COMP" else properties)[int(found[4] or found[2])] = found[3]
        elif found := HYPERMESH_SET.match(line):
            called[int(found[1])] = (found[2], found[3])
        elif found := ANSA.match(line):
            if found[2] == "SET":
                called[int(found[1])] = ("", found[3])
            else:
                properties[int(found[1])] = found[3]
    sets = {}
    for number, members in _case_sets(text).items():
        kind, name = called.get(number, ("", f"SET {number}"))
        sets[name] = (kind, members)
    return properties | names, sets


def _case_sets(text: list[str]) -> dict[int, list[int]]:
    """Members of the sets of numbers in case control; a line that ends in a comma is continued."""
    lines = (line for line in text if not line.startswith("$"))
    sets = {}
    for number, listed in CASE_SET.findall("\n".join(takewhile(lambda line: not BULK.match(line), lines))):
        words = listed.upper().replace(",", " ").split()
        if all(word.isdigit() or word == "THRU" for word in words):
            sets[int(number)] = [
                member
                for first, last in RANGE.findall(" ".join(words))
                for member in range(int(first), min(int(last or first), int(first) + LONGEST) + 1)
            ]
    return sets


# ---- lines and cards


def lines(path: Path, above: tuple[Path, ...] = ()) -> Iterator[tuple[str, str]]:
    """Place and text of every line, with included files in their places."""
    refuse_recursion(path, above)
    rest = iter(enumerate(text_lines(path), 1))
    for number, line in rest:
        where = f"line {number}" + (f" of {path.name}" if above else "")
        begun = re.match(r"\s*INCLUDE\s*(['\"]?)(.*)", line, re.IGNORECASE)
        if not begun:
            yield where, line
            continue
        name = begun[2].strip()
        while begun[1] and not name.endswith(begun[1]):  # a name may go on in the next line
            unclosed = f"{where}: the name of the included file has no closing quote; add it"
            name += take((line for _, line in rest), unclosed).strip()
        name = (name[: -len(begun[1])] if begun[1] else name.split("$")[0]).strip()
        yield from lines(included_file(path, name, where), (*above, path))


def cards(text: list[tuple[str, str]]) -> Iterator[tuple[str, list[str]]]:
    """Place and fields of every card with its continuations; eight blank fields are appended."""
    begin = [i for i, (_, line) in enumerate(text) if re.match(r"\s*BEGIN\b", line, re.IGNORECASE)]
    place, card = "", []
    mark = ""
    for where, line in text[begin[0] + 1 :] if begin else text:
        line = line.split("$")[0].rstrip()
        if not line.strip():
            continue
        before = mark
        head, fields, mark = _fields(line)
        if head == "ENDDATA":
            break
        if head[:1] in ("", "+", "*"):
            if head[1:] and before[1:] and head[1:] != before[1:]:
                raise FormatError(f"{where}: the continuation {head} does not follow {before}; restore the order")
            card += fields
        else:
            if card:
                yield place, card + [""] * 8
            place, card = where, [head, *fields]
    if card:
        yield place, card + [""] * 8


def _fields(line: str) -> tuple[str, list[str], str]:
    """Name, data fields and last field of a line.

    The name is in capitals; that of a continuation is empty or begins with + or *, and equals the last field of the
    line before.
    """
    line = line.expandtabs(8)
    if "," in line:
        head, *fields = (field.strip() for field in line.split(","))
        wanted = 4 if head.endswith("*") or head.startswith("*") else 8
        if any(fields[wanted + 1 :]):
            raise FormatError(f"a line of free fields has more than {wanted + 2} fields: continue {line.strip()[:60]}")
        fields, mark = fields[:wanted], "".join(fields[wanted : wanted + 1])
    else:
        head = line[:8].strip()
        width, wanted = (16, 4) if head.endswith("*") or head.startswith("*") else (8, 8)
        fields = [line[8 + width * i : 8 + width * (i + 1)].strip() for i in range(wanted)]
        mark = line[72:80].strip()
    name = head.upper() if head.startswith(("+", "*")) else head.upper().rstrip("*").strip()
    return name, fields + [""] * (wanted - len(fields)), mark.upper()


def _real(field: str) -> float:
    """The number of a field, also with an exponent without its letter (1.5-3); 0 for a blank field."""
    if not field:
        return 0.0
    try:
        return float(field)
    except ValueError:
        text = field.upper().replace("D", "E")
        return float(text if "E" in text else REAL.sub(r"\1e\2", text))
