"""I-DEAS universal files (``.unv``) of Salome, gmsh and many test systems: nodes, shells, groups."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path

import numpy as np

from mic.errors import FormatError
from mic.geometry.readers.deck_text import located, real, take, text_lines
from mic.geometry.readers.elements import Gathered
from mic.geometry.readers.raw_mesh import RawMesh

__all__ = ["read"]

#: Number of nodes by the kind of a shell or membrane; mid-side nodes lie between the corners.
SHEETS = {41: 3, 51: 3, 61: 3, 74: 3, 91: 3, 42: 6, 52: 6, 62: 6, 72: 6, 92: 6}
SHEETS |= {44: 4, 54: 4, 64: 4, 71: 4, 94: 4, 45: 8, 55: 8, 65: 8, 75: 8, 95: 8}
BEAMS = (11, 21, 22, 23, 24)  # these have an additional line
SOLIDS = range(101, 119)
GROUPS = ("2429", "2430", "2432", "2435", "2452", "2467", "2477")


def read(path: Path) -> RawMesh:
    """Nodes, shells and groups of a universal file.

    Raises
    ------
    FormatError
        Naming the dataset, if it is truncated, holds an invalid number, or nodes in a local coordinate system.
    """
    gathered = Gathered()
    systems, turned = set[int](), set[int]()  # those of nodes, and those other than the global one
    for where, name, lines in _datasets(path):
        with located(where, f"dataset {name}"):
            if name in ("781", "2411"):
                for head, place in zip(lines[::2], lines[1::2]):
                    gathered.add_point((int(head.split()[0]),), _place(place.split()))
                    systems.add(int(head.split()[1]))
            elif name == "15":
                for line in lines:
                    gathered.add_point((int(line.split()[0]),), _place(line.split()[4:7]))
                    systems.add(int(line.split()[1]))
            elif name == "2412":
                _elements(gathered, lines)
            elif name in GROUPS:
                _groups(gathered, name, lines)
            elif name in ("780", "2416"):
                raise FormatError("elements of this former format are not supported; export dataset 2412")
            elif name == "2420":
                turned |= _turned_systems(lines)
    if systems & turned:
        system = f"coordinate system {min(systems & turned)}, which is not the global one"
        raise FormatError(f"nodes are defined in {system}; export the mesh in global coordinates")
    return gathered.mesh()


def _datasets(path: Path) -> Iterator[tuple[str, str, list[str]]]:
    """Place, number and lines of every dataset."""
    lines = text_lines(path)
    marks = [number for number, line in enumerate(lines) if line.strip() == "-1"]
    if len(marks) < 2:
        raise FormatError("no dataset between lines of -1: this is no universal file, or it is cut short; export it")
    if len(marks) % 2:
        raise FormatError(f"line {marks[-1] + 1}: this dataset has no end; the file is cut short, export it again")
    for start, end in zip(marks[::2], marks[1::2]):
        if end > start + 1:
            yield f"line {start + 2}", lines[start + 1].strip(), lines[start + 2 : end]


def _place(fields: list[str]) -> tuple[float, ...]:
    """Coordinates of a node."""
    x, y, z = (real(text) for text in fields)
    return x, y, z


def _elements(gathered: Gathered, lines: list[str]) -> None:
    """Elements of dataset 2412, with sets by property."""
    rest = iter(lines)
    for head in rest:
        label, kind, prop, _, _, count = (int(text) for text in head.split()[:6])
        if kind in BEAMS:
            next(rest, "")
        nodes: list[int] = []
        while len(nodes) < count:
            line = take(rest, f"element {label} has fewer than its {count} nodes; export the file again")
            nodes += [int(text) for text in line.split()]
        if kind not in SHEETS:
            name = f"kind {kind}"
            gathered.add_other((name, label), name, kind in SOLIDS)
            continue
        if count != SHEETS[kind] and (SHEETS[kind], count) != (4, 9):  # nine nodes in files of gmsh
            raise FormatError(f"element {label}: an element of kind {kind} has {SHEETS[kind]} nodes, not {count}")
        if count == 9:
            nodes = [node for pair in zip(nodes[:4], nodes[4:8]) for node in pair]
        step = 2 if count > 4 else 1
        midside = nodes[1::2] if step == 2 else []
        gathered.add_sheet((label,), [(node,) for node in nodes[::step]], [(node,) for node in midside])
        gathered.add_to_property(prop, (label,))
    gathered.parts = list(gathered.element_sets)


def _groups(gathered: Gathered, name: str, lines: list[str]) -> None:
    """Groups: a line of numbers with the member count, the name, and members of kind, label and further numbers."""
    rest = iter(lines)
    for head in rest:
        count, title = int(head.split()[7]), next(rest, "").strip()
        numbers: list[int] = []
        each = 4 if name in ("2435", "2452", "2467", "2477") else 2
        while len(numbers) < each * count:
            line = take(rest, f"the group {title!r} has fewer than its {count} members; export the file again")
            numbers += [int(text) for text in line.split()]
        members = np.reshape(numbers[: each * count], (-1, each))[:, :2].tolist()
        for kind, into in ((7, gathered.node_sets), (8, gathered.element_sets)):
            keys = [(label,) for of, label in members if of == kind]
            if keys:
                into.setdefault(title or f"group {head.split()[0]}", []).extend(keys)


def _turned_systems(lines: list[str]) -> set[int]:
    """Numbers of the coordinate systems other than the global one."""
    found, rest = set(), iter(lines[2:])
    for head in rest:
        label, kind = (int(text) for text in head.split()[:2])
        next(rest, None)
        rows = [[real(text) for text in next(rest, "").split()] for _ in range(4)]
        if kind or not np.array_equal(rows, np.eye(4, 3)):
            found.add(label)
    return found
