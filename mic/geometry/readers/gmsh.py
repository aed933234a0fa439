"""gmsh meshes, versions 2.2, 4.0 and 4.1 of the format, text or binary (``.msh``)."""

from __future__ import annotations

import re
from dataclasses import replace
from pathlib import Path

import numpy as np

from mic.geometry.readers.raw_mesh import RawMesh, from_meshlane
from mic.system.foreign_files import temporary_folder

__all__ = ["read", "volumes"]

# Sections of geometry and physical groups: meshlane rejects files in which only some elements are in a group.
GROUPS = re.compile(rb"\$(Entities|PhysicalNames)\s.*?\$End\1\s*\n", re.DOTALL)
NAME = re.compile(r'(\d+)\s+(\d+)\s+"([^"]*)"')
SHEETS = ("triangle", "quad")


def read(path: Path) -> RawMesh:
    """All elements of a gmsh file, in physical groups or not, and the groups."""
    import meshlane  # see read_with_meshlane

    content = path.read_bytes()
    with temporary_folder() as folder:  # meshlane reads this format from files only
        bare = folder / "mesh.msh"
        bare.write_bytes(_without_parameters(GROUPS.sub(b"", content)))
        mesh = meshlane.gmsh.read(bare)
    raw = from_meshlane(mesh)
    numbers = _node_numbers(content)
    raw = replace(raw, nodes=numbers if len(numbers) == len(raw.points) else None)
    named = _section(content, "PhysicalNames").decode("utf-8", errors="replace")
    names = {int(tag): name.strip() for dimension, tag, name in NAME.findall(named) if dimension == "2"}
    groups = _groups_of_surfaces(content) if b"$Entities" in content else None
    tags = mesh.cell_data.get("gmsh:physical" if groups is None else "gmsh:geometrical")
    if tags is None:
        return raw
    tags_of_blocks = [
        np.asarray(of) for kind in SHEETS for block, of in zip(mesh.cells, tags) if block.type.startswith(kind)
    ]
    tag = np.concatenate([*tags_of_blocks, np.zeros(0, dtype=int)]).astype(np.int64)
    members: dict[int, list[np.ndarray]] = {}
    for value in np.unique(tag):
        for group in [int(value)] if groups is None else groups.get(int(value), []):
            if group:
                members.setdefault(group, []).append(np.flatnonzero(tag == value))
    sets = {names.get(group, f"PID {group}"): np.sort(np.concatenate(of)) for group, of in members.items()}
    return replace(raw, element_sets=sets, parts=tuple(sets))


def _without_parameters(content: bytes) -> bytes:
    """A text file of version 4.0 in a form that meshlane reads; any other unchanged.

    gmsh labels this version 4, which meshlane reads as 4.1, and adds parametric coordinates, which meshlane rejects.
    """
    if _section(content, "MeshFormat").split()[:2] not in ([b"4", b"0"], [b"4.0", b"0"]):
        return content
    nodes = _section(content, "Nodes")
    rows = [line.split() for line in nodes.splitlines()]
    at = 1
    while at < len(rows):
        count = int(rows[at][3])
        rows[at][2] = b"0"
        rows[at + 1 : at + 1 + count] = [row[:4] for row in rows[at + 1 : at + 1 + count]]
        at += 1 + count
    content = content.replace(nodes, b"\n".join(b" ".join(row) for row in rows) + b"\n")
    return re.sub(rb"(\$MeshFormat\s+)4\s", rb"\g<1>4.0 ", content)


def _section(content: bytes, name: str) -> bytes:
    """Content of a section; empty if there is none."""
    found = re.search(rb"\$%s[ \r]*\n(.*?)\$End%s" % (name.encode(), name.encode()), content, re.DOTALL)
    return found[1] if found else b""


def _node_numbers(content: bytes) -> np.ndarray:
    """Numbers of the nodes in the order of the file, which is that of meshlane's points."""
    version, binary = _section(content, "MeshFormat").split()[:2]
    nodes = _section(content, "Nodes")
    if version.startswith(b"2"):
        if binary == b"0":
            return np.array([int(line.split()[0]) for line in nodes.splitlines()[1:]], dtype=np.int64)
        count, _, rows = nodes.partition(b"\n")
        table = np.dtype([("number", np.int32), ("place", float, 3)])
        return np.frombuffer(rows, table, int(count))["number"].astype(np.int64)
    found: list[int] = []
    if version in (b"4", b"4.0"):
        lines, at = nodes.splitlines(), 1
        while at < len(lines):
            stop = at + 1 + int(lines[at].split()[3])
            found += [int(line.split()[0]) for line in lines[at + 1 : stop]]
            at = stop
    else:
        read = _Numbers(nodes, binary != b"0")
        for _ in range(read.sizes(4)[0]):
            read.take(3)
            own = read.sizes(read.sizes()[0])
            read.take(3 * len(own), float)
            found += own
    return np.array(found, dtype=np.int64)


def volumes(path: Path) -> int:
    """Number of solids in the geometry of a file of version 4.1."""
    content = path.read_bytes()
    binary = _section(content, "MeshFormat").split()[1] != b"0"
    return _Numbers(_section(content, "Entities"), binary).sizes(4)[3]


def _groups_of_surfaces(content: bytes) -> dict[int, list[int]]:
    """Physical groups of each surface of a file of version 4."""
    head = _section(content, "MeshFormat").split()
    old, binary = head[0] in (b"4", b"4.0"), head[1] != b"0"
    read = _Numbers(_section(content, "Entities"), binary)
    groups: dict[int, list[int]] = {}
    counts = read.sizes(4)
    for dimension, count in enumerate(counts[:3]):
        for _ in range(count):
            (tag,) = read.take(1)
            read.take(6 if dimension or old else 3, float)
            physical = read.take(read.sizes()[0])
            if dimension:
                read.take(read.sizes()[0])
            if dimension == 2:
                groups[tag] = [abs(number) for number in physical]
    return groups


class _Numbers:
    """Sequential numbers of a section, as text or binary."""

    def __init__(self, content: bytes, binary: bool):
        self.content, self.binary, self.at = content if binary else content.split(), binary, 0

    def take(self, count: int, kind: type = np.int32) -> list:
        """The next numbers, of a kind that decides their size in a binary section."""
        start = self.at
        self.at += count * (np.dtype(kind).itemsize if self.binary else 1)
        if self.at > len(self.content):
            raise ValueError("the section of entities is cut short; export the file again")
        piece = self.content[start : self.at]
        return (np.frombuffer(piece, kind) if isinstance(piece, bytes) else np.array(piece).astype(kind)).tolist()

    def sizes(self, count: int = 1) -> list[int]:
        """The next counts."""
        return self.take(count, np.uint64)
