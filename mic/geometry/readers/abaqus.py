"""Abaqus and CalculiX input decks (``.inp``): the sheets of all parts, placed as their instances say, and what the deck
tells of them.

Read here and not by a library: what exists passes over element types that it does not know, in silence, and over
sections, materials and shell offsets. A deck is keyword lines with parameters, and data lines of numbers and names.
"""

from __future__ import annotations

import re
from collections.abc import Iterator
from dataclasses import dataclass, field, replace
from pathlib import Path

import numpy as np

from mic.errors import FormatError
from mic.geometry.deck import Sheet
from mic.geometry.readers.elements import Gathered
from mic.geometry.readers.raw_mesh import RawMesh

__all__ = ["read"]

SHELL = re.compile(r"(?:S|STRI|DS)(\d)(?!D)\w*")
# Membranes, surfaces, rigid and plane elements: sheets of their own where a deck has no shells, else they lie on these.
STAND_IN = re.compile(r"(?:M3D|SFM3D|R3D|CPS|CPE|DC2D|AC2D)(\d)\w*")
SOLID = re.compile(r"(C3D|SC|CSS|AC3D|DC3D|GK3D|COH3D)\d")  # continuum shells have a top and a bottom, no mid-surface
CORNERS = {3: 3, 4: 4, 6: 3, 8: 4, 9: 4}  # by number of nodes
MADE = {"NGEN", "NFILL", "NCOPY", "NMAP", "ELGEN", "ELCOPY"}  # keywords that make mesh from mesh
SIDES = {"SPOS": 0.5, "SNEG": -0.5}  # OFFSET by name
DEPTH = 20  # files that include files


@dataclass(frozen=True)
class _Block:
    """A keyword with its parameters and data lines."""

    keyword: str
    parameters: dict[str, str]
    data: list[list[str]]
    where: str

    def __getitem__(self, parameter: str) -> str:
        return self.parameters.get(parameter, "")


@dataclass
class _Scope:
    """A part, an instance, or the model itself: what its numbers and names of sets refer to."""

    name: str = ""
    part: str = ""
    place: list[list[str]] = field(default_factory=list)
    nodes: dict[int, tuple[float, ...]] = field(default_factory=dict)
    elements: dict[int, tuple[str, tuple[int, ...]]] = field(default_factory=dict)
    node_sets: dict[str, list[tuple[str, str]]] = field(default_factory=dict)  # instance, and a number or a name
    element_sets: dict[str, list[tuple[str, str]]] = field(default_factory=dict)
    sections: list[tuple[str, Sheet]] = field(default_factory=list)
    normals: list[tuple[str, str, tuple[float, ...]]] = field(default_factory=list)
    groups: list[str] = field(default_factory=list)  # sets that elements are given in


def read(path: Path) -> RawMesh:
    """Nodes, sheets, normals, sets, sections and materials of a deck; included files are followed.

    Raises
    ------
    FormatError
        Naming the line, if the deck makes nodes or elements by rules, numbers something twice, or holds data that is
        none.
    """
    model, instances = _Scope(), list[_Scope]()
    scopes: dict[str, _Scope] = {}
    materials: dict[str, Sheet] = {}
    scope, system, material = model, None, ""
    for block in _blocks(path):
        try:
            match block.keyword:
                case "PART":
                    scope = scopes.setdefault(block["NAME"].upper(), _Scope(block["NAME"]))
                case "INSTANCE":
                    scope = _Scope(block["NAME"], block["PART"].upper(), block.data)
                    instances.append(scope)
                case "END PART" | "END INSTANCE" | "ASSEMBLY" | "END ASSEMBLY":
                    scope = model
                case "SYSTEM":
                    system = _system(block)
                case "NODE":
                    _add_nodes(block, scope, system)
                case "ELEMENT":
                    _add_elements(block, scope)
                case "NSET":
                    _add_set(block, scope.node_sets, block["NSET"])
                case "ELSET":
                    _add_set(block, scope.element_sets, block["ELSET"])
                case "NORMAL" if block["TYPE"].upper().replace(" ", "") != "CONTACTSURFACE":
                    scope.normals += [_normal(fields) for fields in block.data]
                case "MATERIAL":
                    material = block["NAME"]
                case "ELASTIC":
                    materials[material.upper()] = _elastic(block, material)
                case "SHELL SECTION" | "SHELL GENERAL SECTION" | "MEMBRANE SECTION":
                    scope.sections.append((block["ELSET"], _section(block)))
                case keyword if keyword in MADE:
                    raise FormatError(f"*{keyword} makes mesh by a rule; export the nodes and elements themselves")
        except FormatError as problem:
            raise FormatError(f"{block.where}: {problem}") from None
        except (ValueError, IndexError) as problem:
            raise FormatError(f"{block.where}: the data of *{block.keyword} are no numbers, or too few") from problem
    gathered = Gathered()
    placed = _placed(scopes, instances)
    shells = any(
        SHELL.fullmatch(kind) for of in (model, *(part for part, _, _ in placed)) for kind, _ in of.elements.values()
    )
    for scope, name, motion in [(model, "", None), *placed]:
        _gather(gathered, scope, name, motion, shells, materials)
    _gather_sets(gathered, model, placed)
    return gathered.mesh()


# ---- the text of a deck


def _blocks(path: Path, above: tuple[Path, ...] = ()) -> Iterator[_Block]:
    if path in above or len(above) > DEPTH:
        raise FormatError(f"{above[-1].name} includes {path.name}, which includes it in turn")
    block = None
    for line, text in _lines(path):
        if not text.startswith("*"):
            if block is None and not above:
                raise FormatError(f"line {line}: it holds data before the first keyword; it is no deck of Abaqus")
            if block is not None:
                block.data.append([item.strip().strip('"') for item in text.split(",")])
            continue
        if block is not None:
            yield block
            block = None
        head, *rest = text[1:].split(",")
        keyword = " ".join(head.upper().split())
        pairs = [item.partition("=") for item in rest if item.strip()]
        parameters = {" ".join(name.upper().split()): value.strip().strip('"') for name, _, value in pairs}
        where = f"line {line}" + (f" of {path.name}" if above else "")
        if keyword == "INCLUDE":
            yield from _blocks(_beside(path, parameters.get("INPUT", ""), where), (*above, path))
            continue
        block = _Block(keyword, parameters, [], where)
        if keyword in ("NODE", "ELEMENT", "NSET", "ELSET") and "INPUT" in parameters:
            other = _beside(path, parameters["INPUT"], where)
            block.data.extend([item.strip() for item in text.split(",")] for _, text in _lines(other))
    if block is not None:
        yield block


def _beside(path: Path, name: str, where: str) -> Path:
    other = path.parent / name.replace("\\", "/")
    if not name or not other.is_file():
        raise FormatError(f"{where}: it includes {name or 'a file without a name'}, and there is no file {other}")
    return other


def _lines(path: Path) -> Iterator[tuple[int, str]]:
    """Number and text of every line that says something; a keyword line that ends in a comma goes on in the next."""
    begun, first = "", 0
    raw = path.read_bytes()
    try:
        text = raw.decode("utf-8-sig")
    except UnicodeDecodeError:
        text = raw.decode("cp1252", errors="replace")
    for number, line in enumerate(text.splitlines(), 1):
        line = line.strip()
        if not line or line.startswith("**"):
            continue
        if begun:
            line, number, begun = begun + line, first, ""
        if line.startswith("*") and line.endswith(","):
            begun, first = line, number
            continue
        yield number, line
    if begun:
        yield first, begun


def _gathered_rows(data: list[list[str]]) -> Iterator[list[str]]:
    """Data lines that end in a comma go on in the next."""
    row: list[str] = []
    for fields in data:
        row += fields
        if row[-1] == "" and len(fields) > 1:
            row.pop()
            continue
        yield row
        row = []
    if row:
        yield row


# ---- what its blocks say


def _members_of(sets: dict[str, list[tuple[str, str]]], name: str) -> list[tuple[str, str]]:
    """What a set holds so far, its name in any case of the letters."""
    return sets.setdefault(next((key for key in sets if key.upper() == name.upper()), name), []) if name else []


def _number(text: str) -> float:
    try:
        return float(text or 0)
    except ValueError:
        return float(text.upper().replace("D", "E"))


def _add_nodes(block: _Block, scope: _Scope, system) -> None:
    of_set = _members_of(scope.node_sets, block["NSET"])
    curved = block["SYSTEM"].upper()
    if curved not in ("", "R", "C", "S"):
        raise FormatError(f"there are no coordinates of *NODE, SYSTEM={curved}; known are R, C and S")
    for fields in block.data:
        number, values = int(fields[0]), [_number(text) for text in fields[1:7]]
        values += [0.0] * (6 - len(values))
        point = np.array(values[:3])
        if curved in ("C", "S"):
            r, first, second = point
            about, up = np.radians(first), np.radians(second)
            flat = r if curved == "C" else r * np.cos(up)
            point = np.array([flat * np.cos(about), flat * np.sin(about), second if curved == "C" else r * np.sin(up)])
        if system is not None:
            origin, axes = system
            point = origin + axes @ point
        place = tuple(point.tolist())
        if scope.nodes.setdefault(number, place) != place:
            raise FormatError(f"node {number} is given twice, at different places; give each node once")
        of_set.append(("", fields[0]))
        if any(values[3:]) and not curved and system is None:
            scope.normals.append(("", fields[0], tuple(values[3:])))


def _add_elements(block: _Block, scope: _Scope) -> None:
    kind = block["TYPE"].upper()
    sheet = SHELL.fullmatch(kind) or STAND_IN.fullmatch(kind)
    count = int(sheet[1]) if sheet else 0
    name = block["ELSET"]
    of_set = _members_of(scope.element_sets, name)
    scope.groups += [name] if name else []
    if sheet and count not in CORNERS:
        raise FormatError(f"{kind} is not known as a shell; known are those of 3, 4, 6, 8 and 9 nodes")
    row: list[str] = []
    for fields in block.data if sheet else _gathered_rows(block.data):
        row += [text for text in fields if text]
        if sheet and len(row) < count + 1:
            continue
        number = int(row[0])
        if sheet and len(row) != count + 1:
            raise FormatError(f"element {number}: a {kind} has {count} nodes, not {len(row) - 1}")
        element = (kind, tuple(map(int, row[1:])) if sheet else ())
        if scope.elements.setdefault(number, element) != element:
            raise FormatError(f"element {number} is given twice, on different nodes; give each element once")
        of_set.append(("", row[0]))
        row = []
    if row:
        raise FormatError(f"element {row[0]}: a {kind} has {count} nodes, not {len(row) - 1}")


def _add_set(block: _Block, sets: dict[str, list[tuple[str, str]]], name: str) -> None:
    if not name:
        raise FormatError(f"a *{block.keyword} has no name")
    into, instance = _members_of(sets, name), block["INSTANCE"]
    for fields in block.data:
        if "GENERATE" in block.parameters:
            numbers = [int(text) for text in fields if text]
            first, last, step = numbers if len(numbers) == 3 else (*numbers, 1)
            if step < 1 or last < first:
                raise FormatError(f"{first}, {last}, {step} generates no numbers")
            into.extend((instance, str(number)) for number in range(first, last + 1, step))
        else:
            into.extend((instance, text) for text in fields if text)


def _normal(fields: list[str]) -> tuple[str, str, tuple[float, ...]]:
    x, y, z = (_number(text) for text in fields[2:5])
    return fields[0], fields[1], (x, y, z)


def _elastic(block: _Block, material: str) -> Sheet:
    kind = block["TYPE"].upper() or "ISOTROPIC"
    if kind not in ("ISOTROPIC", "ISO") or not block.data:
        return Sheet(material=material)  # which is not told by two constants
    return Sheet(young=_number(block.data[0][0]), poisson=_number(block.data[0][1]), material=material)


def _section(block: _Block) -> Sheet:
    """Thickness, offset and the name of the material; what is given by fields over nodes or elements is not told."""
    thickness, material = None, block["MATERIAL"] or None
    if "COMPOSITE" in block.parameters:
        layers = [fields for fields in block.data if fields[0]]
        thickness = sum(_number(fields[0]) for fields in layers)
        names = {fields[2] for fields in layers if len(fields) > 2}
        material = names.pop() if len(names) == 1 else None
    elif block.keyword == "SHELL GENERAL SECTION" and not material:
        pass  # its data are stiffnesses
    elif block.data and not {"NODAL THICKNESS", "SHELL THICKNESS", "MEMBRANE THICKNESS"}.intersection(block.parameters):
        thickness = _number(block.data[0][0]) or None
    side = block["OFFSET"].upper()
    try:
        middle = SIDES[side] if side in SIDES else float(side or 0)
    except ValueError:
        raise FormatError(f"OFFSET = {side} is a field over the elements; give one number") from None
    return Sheet(thickness, -middle if side else None, material=material)  # Abaqus counts from the middle


def _system(block: _Block):
    """Origin and axes of *SYSTEM; None for the global one."""
    values = [_number(text) for fields in block.data for text in fields]
    if not values:
        return None
    values += [0.0] * (-len(values) % 3)
    if len(values) == 3:
        return np.array(values), np.eye(3)
    if len(values) < 9:
        raise FormatError("*SYSTEM needs three points: its origin, one on its x axis, one in its xy plane")
    return _axes(np.reshape(values[:9], (3, 3)))


def _axes(points):
    """Origin, and axes as columns, by three points: the origin, one on the x axis, one in the xy plane."""
    x = points[1] - points[0]
    z = np.cross(x, points[2] - points[0])
    if not np.linalg.norm(z) > 0:
        raise FormatError("the three points of a coordinate system lie on a line")
    x, z = x / np.linalg.norm(x), z / np.linalg.norm(z)
    return points[0], np.column_stack([x, np.cross(z, x), z])


# ---- parts placed, their names found


def _placed(scopes: dict[str, _Scope], instances: list[_Scope]):
    """(part, name of the instance, motion or None) of everything that stands in the assembly."""
    if not instances:
        return [(part, part.name, None) for part in scopes.values()]
    placed = []
    for instance in instances:
        if instance.part and instance.part not in scopes:
            raise FormatError(f"the instance {instance.name!r} is of a part {instance.part!r}, which is not there")
        motion = _motion(instance)
        if instance.part:
            part = scopes[instance.part]
            own = instance.nodes or instance.elements
            placed.append((part, instance.name, motion))
            if own:
                placed.append((instance, instance.name, motion))
        else:
            placed.append((instance, instance.name, motion))
    return placed


def _motion(instance: _Scope):
    """Rotation matrix and translation: an instance is shifted, then turned about an axis by two points."""
    if not instance.place:
        return None
    try:
        shift = np.array([_number(text) for text in (instance.place[0] + [""] * 3)[:3]])
        if len(instance.place) < 2:
            return np.eye(3), shift
        values = [_number(text) for text in instance.place[1][:7]]
        start, axis, angle = np.array(values[:3]), np.array(values[3:6]) - values[:3], np.radians(values[6])
    except (ValueError, IndexError):
        raise FormatError(f"the instance {instance.name!r} is placed by data that are no numbers, or too few") from None
    length = np.linalg.norm(axis)
    if not length > 0:
        raise FormatError(f"the instance {instance.name!r} is turned about an axis without length")
    x, y, z = axis / length
    cross = np.array([[0, -z, y], [z, 0, -x], [-y, x, 0]])
    turn = np.eye(3) + np.sin(angle) * cross + (1 - np.cos(angle)) * cross @ cross
    return turn, turn @ (shift - start) + start


def _members(sets, name: str, within=None, seen: tuple[str, ...] = ()) -> list[tuple[str, int]]:
    """Instance and number of all that a set holds; it may name other sets, of an instance too (``within``)."""
    members: list[tuple[str, int]] = []
    for instance, text in (item for key in sets if key.upper() == name.upper() for item in sets[key]):
        head, _, tail = text.rpartition(".")
        if text.isdigit():
            members.append((instance, int(text)))
        elif head and tail.isdigit():
            members.append((head, int(tail)))
        elif within and (instance or head).upper() in within:
            inside = within[(instance or head).upper()]
            members += [(instance or head, number) for _, number in _members(inside, text if instance else tail)]
        elif text.upper() not in (*seen, name.upper()):
            members += _members(sets, text, within, (*seen, name.upper()))
    return members


def _gather(gathered: Gathered, scope: _Scope, instance: str, motion, shells: bool, materials) -> None:
    """Points and elements of one placed part; sections give their sheets, the last one counts."""
    where = instance.upper()
    turn, shift = motion if motion is not None else (np.eye(3), np.zeros(3))
    for number, place in scope.nodes.items():
        gathered.add_point((where, number), place if motion is None else tuple((turn @ place + shift).tolist()))
    for number, (kind, nodes) in scope.elements.items():
        key = (where, number)
        if SHELL.fullmatch(kind) or (not shells and STAND_IN.fullmatch(kind)):
            ends = CORNERS[len(nodes)]
            points = [(where, node) for node in nodes]
            gathered.add_sheet(key, points[:ends], points[ends:])
        else:
            gathered.kinds[key] = kind
            if SOLID.match(kind):
                gathered.solids.add(kind)
    for name, sheet in scope.sections:
        of = materials.get((sheet.material or "").upper(), Sheet())
        whole = replace(sheet, young=of.young, poisson=of.poisson)
        for _, number in _members(scope.element_sets, name):
            gathered.sheets[where, number] = whole
    numbers = lambda sets, text: [int(text)] if text.isdigit() else [number for _, number in _members(sets, text)]
    for element, node, normal in scope.normals:
        direction = tuple((turn @ normal).tolist())
        for point in numbers(scope.node_sets, node):
            if not element:
                gathered.normals[where, point] = direction
            for of in numbers(scope.element_sets, element) if element else ():
                gathered.normals[(where, of), (where, point)] = direction


def _gather_sets(gathered: Gathered, model: _Scope, placed) -> None:
    """Sets by their names, those of instances as ``INSTANCE.NAME`` and, all instances together, as ``NAME``."""
    instances = list(dict.fromkeys(name for _, name, _ in placed if name))
    for scope, instance, _ in [(model, "", None), *placed]:
        for kind in ("node_sets", "element_sets"):
            sets, into = getattr(scope, kind), getattr(gathered, kind)
            within = {name.upper(): getattr(part, kind) for part, name, _ in placed} if scope is model else None
            for name in sets:
                keys = [((inside or instance).upper(), number) for inside, number in _members(sets, name, within)]
                for called in [name, f"{instance}.{name}"] if instance else [name]:
                    into.setdefault(called, []).extend(keys)
    for instance in instances:
        keys = [key for key in (*gathered.elements, *gathered.kinds) if key[0] == instance.upper()]
        gathered.element_sets.setdefault(instance, []).extend(keys)
    if len(instances) > 1:
        gathered.parts = instances
        return
    scopes = [model, *(scope for scope, _, _ in placed)]
    sections = [name for scope in scopes for name, _ in scope.sections]
    whole = gathered.elements.keys() <= gathered.sheets.keys()  # else some part has no section
    wanted = {name.upper() for name in (sections if whole else [name for scope in scopes for name in scope.groups])}
    gathered.parts = [name for name in gathered.element_sets if name.upper() in wanted]
