"""Abaqus and CalculiX input decks (``.inp``): shells of all parts in the positions of their instances, with properties.

Existing libraries silently skip unknown element types, and ignore sections, materials and shell offsets. A deck
consists of keyword lines with parameters, and data lines of numbers and names.
"""

from __future__ import annotations

import re
from collections.abc import Iterator
from dataclasses import dataclass, field, replace
from pathlib import Path

import numpy as np

from mic.errors import FormatError
from mic.geometry.deck import Sheet
from mic.geometry.readers.deck_text import axes_of, included_file, located, number_range, real, refuse_recursion
from mic.geometry.readers.elements import Gathered, define
from mic.geometry.readers.raw_mesh import RawMesh
from mic.geometry.triangles import rotation

__all__ = ["read"]

SHELL = re.compile(r"(?:S|STRI|DS)(\d)(?!D)\w*")
# Membranes, surfaces, rigid and plane elements: used as sheets only if a deck has no shells.
STAND_IN = re.compile(r"(?:M3D|SFM3D|R3D|CPS|CPE|DC2D|AC2D)(\d)\w*")
SOLID = re.compile(r"(C3D|SC|CSS|AC3D|DC3D|GK3D|COH3D)\d")  # continuum shells have no mid-surface
CORNERS = {3: 3, 4: 4, 6: 3, 8: 4, 9: 4}  # number of corners by number of nodes
GENERATORS = {"NGEN", "NFILL", "NCOPY", "NMAP", "ELGEN", "ELCOPY"}  # keywords that generate nodes or elements
SIDES = {"SPOS": 0.5, "SNEG": -0.5}  # named values of OFFSET


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
    """A part, an instance, or the model: the namespace of numbers and sets."""

    name: str = ""
    part: str = ""
    place: list[list[str]] = field(default_factory=list)
    nodes: dict[int, tuple[float, ...]] = field(default_factory=dict)
    elements: dict[int, tuple[str, tuple[int, ...]]] = field(default_factory=dict)
    node_sets: dict[str, list[tuple[str, str]]] = field(default_factory=dict)  # instance, and number or set name
    element_sets: dict[str, list[tuple[str, str]]] = field(default_factory=dict)
    sections: list[tuple[str, Sheet]] = field(default_factory=list)
    normals: list[tuple[str, str, tuple[float, ...]]] = field(default_factory=list)
    groups: list[str] = field(default_factory=list)  # sets named by *ELEMENT


def read(path: Path) -> RawMesh:
    """Nodes, shells, normals, sets, sections and materials of a deck; included files are read too.

    Raises
    ------
    FormatError
        Naming the line, if the deck generates nodes or elements by rules, defines a number twice, or has invalid data.
    """
    model, instances = _Scope(), list[_Scope]()
    scopes: dict[str, _Scope] = {}
    materials: dict[str, Sheet] = {}
    scope, system, material = model, None, ""
    for block in _blocks(path):
        with located(block.where, f"*{block.keyword}"):
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
                case keyword if keyword in GENERATORS:
                    raise FormatError(f"*{keyword} generates the mesh by a rule; export the nodes and elements")
    gathered = Gathered()
    placed = _instances(scopes, instances)
    shells = any(
        SHELL.fullmatch(kind) for of in (model, *(part for part, _, _ in placed)) for kind, _ in of.elements.values()
    )
    for scope, name, motion in [(model, "", None), *placed]:
        _gather(gathered, scope, name, motion, shells, materials)
    _gather_sets(gathered, model, placed)
    return gathered.mesh()


# ---- lines and blocks


def _blocks(path: Path, above: tuple[Path, ...] = ()) -> Iterator[_Block]:
    """Keyword blocks of a deck and of the files that it includes."""
    refuse_recursion(path, above)
    block = None
    for line, text in _lines(path):
        if not text.startswith("*"):
            if block is not None:
                block.data.append([item.strip().strip('"') for item in text.split(",")])
            elif not above:
                raise FormatError(f"line {line}: there are data before the first keyword; the file is no Abaqus deck")
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
            yield from _blocks(included_file(path, parameters.get("INPUT", ""), where), (*above, path))
            continue
        block = _Block(keyword, parameters, [], where)
        if keyword in ("NODE", "ELEMENT", "NSET", "ELSET") and "INPUT" in parameters:
            other = included_file(path, parameters["INPUT"], where)
            block.data.extend([item.strip() for item in text.split(",")] for _, text in _lines(other))
    if block is not None:
        yield block


def _lines(path: Path) -> Iterator[tuple[int, str]]:
    """Number and text of every line other than comments; a keyword line that ends in a comma is continued."""
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


def _joined_lines(data: list[list[str]]) -> Iterator[list[str]]:
    """Data lines, joined if they end in a comma."""
    row: list[str] = []
    for fields in data:
        row += fields
        if row[-1] or len(fields) == 1:
            yield row
            row = []
    if row:
        yield row


# ---- contents of blocks


def _set_named(sets: dict[str, list[tuple[str, str]]], name: str) -> list[tuple[str, str]]:
    """Members so far of a set, whose name is not case-sensitive."""
    return sets.setdefault(next((key for key in sets if key.upper() == name.upper()), name), []) if name else []


def _add_nodes(block: _Block, scope: _Scope, system) -> None:
    """Nodes of *NODE, in the active coordinate system."""
    of_set = _set_named(scope.node_sets, block["NSET"])
    curved = block["SYSTEM"].upper()
    if curved not in ("", "R", "C", "S"):
        raise FormatError(f"*NODE, SYSTEM={curved} is unknown; use R, C or S")
    for fields in block.data:
        number, values = int(fields[0]), [real(text) for text in fields[1:7]]
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
        define(scope.nodes, number, tuple(point.tolist()), f"node {number}")
        of_set.append(("", fields[0]))
        if any(values[3:]) and not curved and system is None:
            scope.normals.append(("", fields[0], tuple(values[3:])))


def _add_elements(block: _Block, scope: _Scope) -> None:
    """Elements of *ELEMENT; corners of shells only."""
    kind = block["TYPE"].upper()
    sheet = SHELL.fullmatch(kind) or STAND_IN.fullmatch(kind)
    count = int(sheet[1]) if sheet else 0
    name = block["ELSET"]
    of_set = _set_named(scope.element_sets, name)
    scope.groups += [name] if name else []
    if sheet and count not in CORNERS:
        raise FormatError(f"{kind} is no known shell; shells have 3, 4, 6, 8 or 9 nodes")
    row: list[str] = []
    for fields in block.data if sheet else _joined_lines(block.data):
        row += [text for text in fields if text]
        if sheet and len(row) < count + 1:
            continue
        number = int(row[0])
        if sheet and len(row) != count + 1:
            raise FormatError(f"element {number}: a {kind} has {count} nodes, not {len(row) - 1}")
        nodes = tuple(map(int, row[1:])) if sheet else ()
        define(scope.elements, number, (kind, nodes), f"element {number}")
        of_set.append(("", row[0]))
        row = []
    if row:
        raise FormatError(f"element {row[0]}: a {kind} has {count} nodes, not {len(row) - 1}")


def _add_set(block: _Block, sets: dict[str, list[tuple[str, str]]], name: str) -> None:
    """Members of *NSET or *ELSET."""
    if not name:
        raise FormatError(f"this *{block.keyword} has no name; add one")
    into, instance = _set_named(sets, name), block["INSTANCE"]
    for fields in block.data:
        if "GENERATE" in block.parameters:
            numbers = [int(text) for text in fields if text]
            first, last, step = numbers if len(numbers) == 3 else (*numbers, 1)
            into.extend((instance, str(number)) for number in number_range(first, last, step))
        else:
            into.extend((instance, text) for text in fields if text)


def _normal(fields: list[str]) -> tuple[str, str, tuple[float, ...]]:
    """Element, node and direction of a line of *NORMAL."""
    x, y, z = (real(text) for text in fields[2:5])
    return fields[0], fields[1], (x, y, z)


def _elastic(block: _Block, material: str) -> Sheet:
    """Isotropic material of *ELASTIC."""
    kind = block["TYPE"].upper() or "ISOTROPIC"
    if kind not in ("ISOTROPIC", "ISO") or not block.data:
        return Sheet(material=material)  # anisotropic: two constants do not describe it
    return Sheet(young=real(block.data[0][0]), poisson=real(block.data[0][1]), material=material)


def _section(block: _Block) -> Sheet:
    """Thickness, offset and material name; the thickness is None if it varies over nodes or elements."""
    thickness, material = None, block["MATERIAL"] or None
    if "COMPOSITE" in block.parameters:
        layers = [fields for fields in block.data if fields[0]]
        thickness = sum(real(fields[0]) for fields in layers)
        names = {fields[2] for fields in layers if len(fields) > 2}
        material = names.pop() if len(names) == 1 else None
    elif block.keyword == "SHELL GENERAL SECTION" and not material:
        pass  # its data are stiffnesses
    elif block.data and not {"NODAL THICKNESS", "SHELL THICKNESS", "MEMBRANE THICKNESS"}.intersection(block.parameters):
        thickness = real(block.data[0][0]) or None
    side = block["OFFSET"].upper()
    try:
        middle = SIDES[side] if side in SIDES else float(side or 0)
    except ValueError:
        raise FormatError(f"OFFSET = {side} varies over the elements; give one number") from None
    return Sheet(thickness, -middle if side else None, material=material)  # Abaqus measures from the mid-surface


def _system(block: _Block):
    """Origin and axes of *SYSTEM; None for the global system."""
    values = [real(text) for fields in block.data for text in fields]
    if not values:
        return None
    values += [0.0] * (-len(values) % 3)
    if len(values) == 3:
        return np.array(values), np.eye(3)
    if len(values) < 9:
        raise FormatError("*SYSTEM needs three points: the origin, one on the x axis, one in the xy plane")
    points = np.reshape(values[:9], (3, 3))
    return points[0], np.column_stack(axes_of(points, "this coordinate system"))


# ---- instances and sets


def _instances(scopes: dict[str, _Scope], instances: list[_Scope]):
    """(part, name of the instance, motion or None) of everything in the assembly."""
    if not instances:
        return [(part, part.name, None) for part in scopes.values()]
    placed = []
    for instance in instances:
        if instance.part and instance.part not in scopes:
            raise FormatError(f"the part {instance.part!r} of instance {instance.name!r} is missing; correct its name")
        motion = _motion(instance)
        if instance.part:
            placed.append((scopes[instance.part], instance.name, motion))
        if not instance.part or instance.nodes or instance.elements:
            placed.append((instance, instance.name, motion))
    return placed


def _motion(instance: _Scope):
    """Rotation matrix and translation of an instance: a shift, then a rotation about an axis through two points."""
    if not instance.place:
        return None
    try:
        shift = np.array([real(text) for text in (instance.place[0] + [""] * 3)[:3]])
        if len(instance.place) < 2:
            return np.eye(3), shift
        values = [real(text) for text in instance.place[1][:7]]
        start, axis, angle = np.array(values[:3]), np.array(values[3:6]) - values[:3], np.radians(values[6])
    except (ValueError, IndexError):
        raise FormatError(f"the instance {instance.name!r} has an invalid position; correct its data") from None
    if not np.linalg.norm(axis) > 0:
        raise FormatError(f"the instance {instance.name!r} has a rotation axis without length; correct it")
    turn = rotation(axis, angle)
    return turn, turn @ (shift - start) + start


def _members(sets, name: str, within=None, seen: tuple[str, ...] = ()) -> list[tuple[str, int]]:
    """Instance and number of all members of a set, which may contain other sets, also of an instance (``within``)."""
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
    """Add points and elements of one instance; the last section of an element counts."""
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
            gathered.add_other(key, kind, bool(SOLID.match(kind)))
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
    """Add sets by name; those of instances as ``INSTANCE.NAME`` and, for all instances together, as ``NAME``."""
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
    whole = gathered.elements.keys() <= gathered.sheets.keys()  # otherwise some element has no section
    wanted = {name.upper() for name in (sections if whole else [name for scope in scopes for name in scope.groups])}
    gathered.parts = [name for name in gathered.element_sets if name.upper() in wanted]
