"""Nastran bulk data (``.bdf``, ``.nas``, ``.fem``, ``.dat``): small, large and free fields, with or without sections
above it.

Read here and not by a library: meshlane stumbles over the material angles of shells (``THETA``), needs a ``BEGIN BULK``
that many preprocessors leave out, and passes over coordinate systems in silence; pyNastran brings an own world of
cards and refuses decks that are not whole. Of a deck only points, shells and what these say of themselves are wanted.
"""

from __future__ import annotations

import re
from collections.abc import Iterator, Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np

from mic.errors import FormatError
from mic.geometry.deck import Sheet
from mic.geometry.readers.elements import Gathered
from mic.geometry.readers.raw_mesh import RawMesh

__all__ = ["cards", "read"]

#: Of each kind of shell: the fields of its corners, of its other nodes, of ZOFFS, of TFLAG, and of its thicknesses.
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
#: Elements that are no sheet, counted.
OTHERS = re.compile(
    r"C(BAR|BEAM3?|BEND|BUSH|BUSH[12]D|CONROD|ROD|TUBE|SHEAR|ELAS\d|DAMP\d|GAP|MASS\d|VISC|WELD|FAST|SEAM|HBDY.|RAC.D"
    r"|TRIAX6?|QUADX.?|ONM[12]|ONROD)|R(BE1|BE2|BE3|BAR1?|ROD|JOINT|TRPLT1?|SSCON|SPLINE)|PLOTEL"
)
REAL = re.compile(r"([+-]?(?:\d+\.?\d*|\.\d+))([+-]\d+)")  # 1.5-3: an exponent without its letter
CASE_SET = re.compile(r"\s*SET\s+(\d+)\s*=\s*(.*)", re.IGNORECASE)
HYPERMESH = re.compile(r'\$HMNAME\s+(COMP|PROP|PROPERTY)\s+(\d+)\s*"([^"]*)"\s*(\d*)')
HYPERMESH_SET = re.compile(r'\$HMSET\s+(\d+)\s+([12])\s*"([^"]*)"')
ANSA = re.compile(r"\$ANSA_NAME(?:_COMMENT)?;(\d+);(PSHELL|PCOMP|SET);([^;]*);")
DEPTH = 20  # files that include files


def read(path: Path) -> RawMesh:
    """Grid points and shells of a deck, in the basic coordinate system, and what it tells of them.

    Raises
    ------
    FormatError
        Naming the line, if a field is no number, a coordinate system or an included file is not there, or something is
        numbered twice.
    """
    gathered, text = Gathered(), list(_lines(path))
    systems: dict[int, tuple[str, list[str], str]] = {}
    grids: dict[int, tuple[str, np.ndarray]] = {}
    normals: dict[int, tuple[str, np.ndarray]] = {}
    default = ""
    properties: dict[int, tuple[Sheet, str]] = {}
    materials: dict[int, Sheet] = {}
    shells: list[tuple[str, list[str], str]] = []
    for where, card in _cards(text):
        name = card[0]
        try:
            if name == "GRID":
                grid = (card[2], np.array([_real(field) for field in card[3:6]]))
                before = grids.setdefault(int(card[1]), grid)
                if before[0] != grid[0] or (before[1] != grid[1]).any():
                    raise FormatError(f"grid point {card[1]} is given twice, at different places; give each once")
            elif name == "GRDSET":
                default = card[2]
            elif name.startswith("CORD"):
                systems[int(card[1])] = (name, card, where)
                if name[4:5] == "1" and card[5]:
                    systems[int(card[5])] = (name, [name, *card[5:9], *[""] * 8], where)
            elif name == "SNORM":
                normals[int(card[1])] = (card[2], np.array([_real(field) for field in card[3:6]]))
            elif name in SHELLS:
                shells.append((name, card, where))
                corners, midside, *_ = SHELLS[name]
                gathered.add_sheet(
                    (int(card[1]),),
                    [(int(card[field]),) for field in corners],
                    [(int(card[field]),) for field in midside if card[field]],
                )
            elif name == "PSHELL":
                properties[int(card[1])] = _shell_property(card)
            elif name in ("PCOMP", "PCOMPG"):
                properties[int(card[1])] = _composite(card)
            elif name == "MAT1":
                materials[int(card[1])] = _material(card)
            elif name in SOLIDS or OTHERS.fullmatch(name):
                _pass_over(gathered, name, card)
            elif name.startswith(("CTRI", "CQUAD")):
                raise FormatError(f"{name} is not known as a shell; known are {', '.join(SHELLS)}")
        except FormatError as problem:
            raise FormatError(f"{where}: {problem}") from None
        except ValueError:
            raise FormatError(f"{where}: a field of this {name} is no number, or is missing") from None
    frames = _Frames(systems, grids, default)
    for number, (system, place) in grids.items():
        gathered.add_point((number,), tuple(frames.point(system or default, place).tolist()))
    for number, (system, direction) in normals.items():
        point = gathered.points.get((number,))
        if point is not None:
            gathered.normals[number,] = tuple(frames.direction(system, direction, np.array(point)).tolist())
    names, sets = _names(text)
    for name, card, where in shells:
        try:
            _tell(gathered, name, card, properties, materials)
        except FormatError as problem:
            raise FormatError(f"{where}: {problem}") from None
        except ValueError:
            raise FormatError(f"{where}: a field of this {name} is no number") from None
    for number in dict.fromkeys(int(card[2] or card[1]) for _, card, _ in shells):
        label, called = f"PID {number}", names.get(number)
        # a name that two properties share stands for neither
        alone = list(names.values()).count(called or "") == 1
        gathered.parts.append(called if called and alone else label)
        if called:
            gathered.element_sets.setdefault(called, []).extend(gathered.element_sets[label])
    for name, (kind, numbers) in sets.items():
        for into in {"1": (gathered.node_sets,), "2": (gathered.element_sets,)}.get(
            kind, (gathered.node_sets, gathered.element_sets)
        ):
            into.setdefault(name, []).extend((number,) for number in numbers)
    return gathered.mesh("grid point")


# ---- what cards say


def _tell(gathered: Gathered, name: str, card: list[str], properties, materials) -> None:
    """The sheet of a shell: its property's, its own thickness and offset where it gives them."""
    _, _, zoffs, tflag, own = SHELLS[name]
    number, pid = int(card[1]), int(card[2] or card[1])
    gathered.element_sets.setdefault(f"PID {pid}", []).append((number,))
    sheet, mid = properties.get(pid, (Sheet(), ""))
    if mid.isdigit():
        of = materials.get(int(mid), Sheet())
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
    if sheet != Sheet():
        gathered.sheets[number,] = sheet


def _offset(text: str, thickness: float | None) -> float:
    """ZOFFS as a share of the thickness."""
    if text.upper() in ("TOP", "BOTTOM"):  # the skin that the grid points lie on
        return -0.5 if text.upper() == "TOP" else 0.5
    distance = _real(text)
    if not distance:
        return 0.0
    if not thickness:
        raise FormatError("a shell has an offset (ZOFFS) and no thickness; give its PSHELL a T, or take ZOFFS out")
    return distance / thickness


def _shell_property(card: list[str]) -> tuple[Sheet, str]:
    thickness = _real(card[3]) or None
    text = card[13] if len(card) > 13 else ""  # as OptiStruct has it
    return Sheet(thickness, _offset(text, thickness) if text else None), card[2]


def _composite(card: list[str]) -> tuple[Sheet, str]:
    """PCOMP: four fields each of plies from the ninth on; a blank thickness or material is that of the ply before."""
    each, skipped = (4, 0) if card[0] == "PCOMP" else (8, 1)  # PCOMPG numbers its plies
    plies, mid, thickness = [], "", 0.0
    for field in range(9 + skipped, len(card) - 3, each):
        if not any(card[field : field + 2]):
            continue
        mid, thickness = card[field] or mid, _real(card[field + 1]) if card[field + 1] else thickness
        plies.append((mid, thickness))
    total = sum(thickness for _, thickness in plies) * (2 if card[8].upper() == "SYM" else 1)
    mids = {mid for mid, _ in plies}
    offset = _real(card[2]) / total + 0.5 if card[2] and total else None
    return Sheet(total or None, offset), mids.pop() if len(mids) == 1 else ""


def _material(card: list[str]) -> Sheet:
    young, shear, poisson = (_real(field) if field else None for field in card[2:5])
    if poisson is None and young and shear:
        poisson = young / (2 * shear) - 1
    elif young is None and shear and poisson is not None:
        young = 2 * shear * (1 + poisson)
    return Sheet(young=young, poisson=poisson)


def _pass_over(gathered: Gathered, name: str, card: list[str]) -> None:
    """An element that is no sheet, by its number where it has one of its own."""
    if name in SOLIDS:
        gathered.solids.add(name)
    if not card[1].isdigit():
        gathered.uncounted[name] = gathered.uncounted.get(name, 0) + 1
        return
    number = (name, int(card[1]))
    gathered.kinds[number] = name
    if name in SOLIDS and card[2].isdigit():
        gathered.element_sets.setdefault(f"PID {int(card[2])}", []).append(number)


class _Frames:
    """Coordinate systems, each given in another or by three grid points."""

    def __init__(self, systems, grids, default):
        self.systems, self.grids, self.default = systems, grids, default
        self.known: dict[int, tuple[str, np.ndarray, np.ndarray]] = {0: ("R", np.zeros(3), np.eye(3))}

    def point(self, system: str, place: np.ndarray) -> np.ndarray:
        """A point in the basic system."""
        kind, origin, axes = self._frame(system)
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
        if text and not text.isdigit():
            raise FormatError(f"a coordinate system is called {text!r}, and it must be a number")
        number = int(text or 0)
        if number in self.known:
            return self.known[number]
        if number not in self.systems:
            raise FormatError(f"points are given in coordinate system {number}, which is not there")
        name, card, where = self.systems[number]
        if number in above:
            raise FormatError(f"{where}: coordinate system {number} is given in terms of itself")
        try:
            if name[4:5] == "1":
                places = [self._grid(int(field), (*above, number)) for field in card[2:5]]
            else:
                values = np.array([_real(field) for field in card[3:12]]).reshape(3, 3)
                places = [self._through(card[2], place, (*above, number)) for place in values]
        except FormatError:
            raise
        except (ValueError, IndexError):
            raise FormatError(f"{where}: a field of this {name} is no number, or is missing") from None
        origin, on_z, in_xz = places
        z = on_z - origin
        y = np.cross(z, in_xz - origin)
        if not np.linalg.norm(y) > 0:
            raise FormatError(f"{where}: the three points of coordinate system {number} lie on a line")
        y, z = y / np.linalg.norm(y), z / np.linalg.norm(z)
        self.known[number] = (name[5:6] or "R", origin, np.column_stack([np.cross(y, z), y, z]))
        return self.known[number]

    def _grid(self, number: int, above: tuple[int, ...]) -> np.ndarray:
        if number not in self.grids:
            raise FormatError(f"a coordinate system names the grid point {number}, which is not given")
        system, place = self.grids[number]
        return self._through(system or self.default, place, above)

    def _through(self, system: str, place: np.ndarray, above: tuple[int, ...]) -> np.ndarray:
        self._frame(system, above)
        return self.point(system, place)


def _names(text: list[tuple[str, str]]) -> tuple[dict[int, str], dict[str, tuple[str, list[int]]]]:
    """Names of properties, and sets of the case control with their kind, as preprocessors write them into comments."""
    names: dict[int, str] = {}
    properties: dict[int, str] = {}
    called: dict[int, tuple[str, str]] = {}
    members: dict[int, list[int]] = {}
    begun, ended = 0, False
    for _, line in text:
        if line.startswith("$"):
            if found := HYPERMESH.match(line):
                # a component names its property behind its own number
                (names if found[1] == "COMP" else properties)[int(found[4] or found[2])] = found[3]
            elif found := HYPERMESH_SET.match(line):
                called[int(found[1])] = (found[2], found[3])
            elif found := ANSA.match(line):
                if found[2] == "SET":
                    called[int(found[1])] = ("", found[3])
                else:
                    properties[int(found[1])] = found[3]
            continue
        ended = ended or bool(re.match(r"\s*(BEGIN|GRID)\b", line, re.IGNORECASE))
        found = CASE_SET.match(line)
        if found and not ended:
            begun, listed = int(found[1]), found[2]
            members[begun] = []
        elif begun:
            listed = line
        else:
            continue
        words = listed.replace(",", " ").upper().split()
        if any(not word.isdigit() and word != "THRU" for word in words):
            members.pop(begun, None)
            begun = 0
            continue
        _extend(members[begun], words)
        begun = begun if listed.rstrip().endswith(",") else 0
    sets = {}
    for number, of in members.items():
        kind, name = called.get(number, ("", f"SET {number}"))
        sets[name] = (kind, of)
    return properties | names, sets


def _extend(numbers: list[int], words: list[str]) -> None:
    for place, word in enumerate(words):
        if word == "THRU":
            continue
        if place and words[place - 1] == "THRU" and numbers:
            numbers.extend(range(numbers[-1] + 1, min(int(word), numbers[-1] + 10_000_000) + 1))
        else:
            numbers.append(int(word))


# ---- the text of a deck


def _lines(path: Path, above: tuple[Path, ...] = ()) -> Iterator[tuple[str, str]]:
    """Place and text of every line, included files in their places."""
    if path in above or len(above) > DEPTH:
        raise FormatError(f"{above[-1].name} includes {path.name}, which includes it in turn")
    lines = iter(enumerate(path.read_text(encoding="utf-8-sig", errors="replace").splitlines(), 1))
    for number, line in lines:
        where = f"line {number}" + (f" of {path.name}" if above else "")
        begun = re.match(r"\s*INCLUDE\s*(['\"]?)(.*)", line, re.IGNORECASE)
        if not begun:
            yield where, line
            continue
        name = begun[2].strip()
        while begun[1] and not name.endswith(begun[1]):  # a name may go on in the next line
            rest = next(lines, None)
            if rest is None:
                raise FormatError(f"{where}: the name of the included file has no end")
            name += rest[1].strip()
        name = (name[: -len(begun[1])] if begun[1] else name.split("$")[0]).strip()
        other = path.parent / name.replace("\\", "/")
        if not name or not other.is_file():
            raise FormatError(f"{where}: it includes {name or 'a file without a name'}, and there is no file {other}")
        yield from _lines(other, (*above, path))


def cards(path: Path) -> Iterator[tuple[str, list[str]]]:
    """Place and fields of every card of a deck, see :func:`read`; at least eight fields, blank where nothing stands."""
    return _cards(list(_lines(path)))


def _cards(text: list[tuple[str, str]]) -> Iterator[tuple[str, list[str]]]:
    """Place and fields of every card, its continuations joined; eight fields stand for a missing rest."""
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
                raise FormatError(f"{where}: the line {head} does not follow the one that it goes on from, {before}")
            card += fields
        else:
            if card:
                yield place, card + [""] * 8
            place, card = where, [head, *fields]
    if card:
        yield place, card + [""] * 8


def _fields(line: str) -> tuple[str, list[str], str]:
    """Name in capitals (a continuation's is empty or begins with + or *), data fields of one line, and its last field,
    which the continuation of the line bears as its name."""
    line = line.expandtabs(8)
    if "," in line:
        head, *fields = (field.strip() for field in line.split(","))
        wanted = 4 if head.endswith("*") or head.startswith("*") else 8
        if any(fields[wanted + 1 :]):
            raise FormatError(f"a line of free fields has more than {wanted + 2}: {line.strip()[:60]}")
        fields, mark = fields[:wanted], "".join(fields[wanted : wanted + 1])
    else:
        head = line[:8].strip()
        width, wanted = (16, 4) if head.endswith("*") or head.startswith("*") else (8, 8)
        fields = [line[8 + width * i : 8 + width * (i + 1)].strip() for i in range(wanted)]
        mark = line[72:80].strip()
    name = head.upper() if head.startswith(("+", "*")) else head.upper().rstrip("*").strip()
    return name, fields + [""] * (wanted - len(fields)), mark.upper()


def _real(field: str) -> float:
    if not field:
        return 0.0
    try:
        return float(field)
    except ValueError:
        text = field.upper().replace("D", "E")
        return float(text if "E" in text else REAL.sub(r"\1e\2", text))
