"""Contents of a mesh file as a reader returns them, neither checked nor repaired."""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterable
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np

from mic.errors import FormatError
from mic.geometry.deck import Sheet

__all__ = ["RawMesh", "from_meshlane", "read_with_meshlane"]

SOLIDS = ("tetra", "hexa", "wedge", "pyramid", "polyhedron")  # prefixes of meshlane's names of solid elements


@dataclass(frozen=True)
class RawMesh:
    """Contents of a mesh file.

    Attributes
    ----------
    points : (n, 3) array
        In the unit of the file.
    elements : (k, 4) int array
        Corners, as point numbers from zero, of triangles, whose fourth number is -1, and then of quadrilaterals.
    solids : tuple of str
        Kinds of solid elements in the file.
    others : dict of str to int
        Number of other ignored elements, such as beams, by kind.
    normals : (k, 4, 3) array, optional
        Normals of the sheet at the elements' corners; NaN where not given.
    nodes : (n,) int array, optional
        Numbers of the points in the file.
    node_sets, element_sets : dict of str to int array
        Points and elements by set name.
    others_of_sets : dict of str to tuple of str
        Kinds of elements other than shells, by the name of the set that holds them.
    parts : tuple of str
        Element sets that are parts, see :class:`mic.geometry.deck.Deck`.
    sheets : tuple of Sheet
        In the unit of the file.
    sheet_of : (k,) int array, optional
        Sheet of each element, -1 for none.
    midside_nodes : int
        Number of dropped mid-side nodes.
    """

    points: np.ndarray
    elements: np.ndarray
    solids: tuple[str, ...] = ()
    others: dict[str, int] = field(default_factory=dict)
    normals: np.ndarray | None = None
    nodes: np.ndarray | None = None
    node_sets: dict[str, np.ndarray] = field(default_factory=dict)
    element_sets: dict[str, np.ndarray] = field(default_factory=dict)
    others_of_sets: dict[str, tuple[str, ...]] = field(default_factory=dict)
    parts: tuple[str, ...] = ()
    sheets: tuple[Sheet, ...] = ()
    sheet_of: np.ndarray | None = None
    midside_nodes: int = 0

    @property
    def triangles(self) -> np.ndarray:
        """(t, 3) corners of the triangles, the first elements."""
        return self.elements[self.elements[:, 3] < 0, :3]

    @property
    def quadrilaterals(self) -> np.ndarray:
        """(q, 4) corners of the quadrilaterals."""
        return self.elements[self.elements[:, 3] >= 0]

    def set_name(self, name: str) -> str:
        """The element set of a name, ignoring case; a property may be given by its number alone.

        Raises
        ------
        FormatError
            If there is none, or several.
        """
        known = [*self.element_sets, *(other for other in self.others_of_sets if other not in self.element_sets)]
        for wanted in (name, f"PID {name}"):
            if wanted in known:
                return wanted
            alike = [other for other in known if other.upper() == wanted.upper()]
            if len(alike) == 1:
                return alike[0]
        listed = ", ".join(map(repr, known[:20])) + (", …" if len(known) > 20 else "")
        raise FormatError(f"there is no element set {name!r}; the file holds {listed or 'no sets: remove `set`'}")

    def selected(self, sets: Iterable[str]) -> RawMesh:
        """The elements of some sets and their points; the sets are restricted to these.

        Raises
        ------
        FormatError
            If a set does not exist, holds solid elements, or no shells.
        """
        chosen = np.zeros(len(self.elements), dtype=bool)
        for name in map(self.set_name, sets):
            solids = sorted(set(self.others_of_sets.get(name, ())).intersection(self.solids))
            if solids:
                raise FormatError(f"the set {name!r} holds solid elements ({', '.join(solids)}); give the mid-surface")
            elements = self.element_sets.get(name, np.zeros(0, dtype=np.int64))
            if not len(elements):
                kinds = ", ".join(self.others_of_sets.get(name, ())) or "nothing"
                raise FormatError(f"the set {name!r} holds no triangles or quadrilaterals, only {kinds}")
            chosen[elements] = True
        number = np.where(chosen, np.cumsum(chosen) - 1, -1)
        used = np.setdiff1d(self.elements[chosen], -1)
        place = np.full(len(self.points) + 1, -1)  # the last entry is that of the missing corner of a triangle
        place[used] = np.arange(len(used))
        return replace(
            self,
            points=self.points[used],
            elements=place[self.elements[chosen]],
            solids=(),
            normals=None if self.normals is None else self.normals[chosen],
            nodes=None if self.nodes is None else self.nodes[used],
            node_sets=_renumbered(self.node_sets, place),
            element_sets=_renumbered(self.element_sets, number),
            sheet_of=None if self.sheet_of is None else self.sheet_of[chosen],
        )


def _renumbered(sets: dict[str, np.ndarray], number: np.ndarray) -> dict[str, np.ndarray]:
    """Sets with new numbers of their members; those with the number -1 are left out."""
    return {name: number[members][number[members] >= 0] for name, members in sets.items()}


def read_with_meshlane(name: str, source: Any) -> RawMesh:
    """The shell elements of a file, and its sets.

    Parameters
    ----------
    name : str
        Module of meshlane that reads the format.
    source : Path or text file
    """
    import meshlane  # takes as long to import as numpy and pandas together, and many scenes have no such file

    return from_meshlane(getattr(meshlane, name).read(source))


def from_meshlane(mesh: Any) -> RawMesh:
    """The shell elements of a ``meshlane.Mesh``, and its sets."""
    blocks = [(block.type, np.asarray(block.data)) for block in mesh.cells]
    points = np.zeros((len(mesh.points), 3))
    if len(mesh.points):
        points[:, : mesh.points.shape[1]] = mesh.points
    first: dict[int, int] = {}  # element number of the first element of each block of shells
    elements, midside = np.zeros((0, 4), dtype=np.int64), [np.zeros(0, dtype=np.int64)]
    for kind, count in (("triangle", 3), ("quad", 4)):
        for number, (name, data) in enumerate(blocks):
            if name.startswith(kind):
                first[number] = len(elements)
                corners = np.pad(data[:, :count].astype(np.int64), ((0, 0), (0, 4 - count)), constant_values=-1)
                elements = np.concatenate([elements, corners])
                midside.append(data[:, count:].ravel())
    others: Counter[str] = Counter()
    for number, (name, data) in enumerate(blocks):
        if number not in first and not name.startswith(SOLIDS):
            others[name] += len(data)
    element_sets, others_of_sets = {}, {}
    for name, of_blocks in mesh.cell_sets.items():
        rows = [np.asarray([] if of is None else of, dtype=np.int64) for of in of_blocks]
        held = [first[number] + of for number, of in enumerate(rows) if number in first]
        kinds = tuple(sorted({blocks[number][0] for number, of in enumerate(rows) if len(of) and number not in first}))
        if any(len(of) for of in held):
            element_sets[name] = np.concatenate(held)
        if kinds:
            others_of_sets[name] = kinds
    return RawMesh(
        points,
        elements,
        tuple(sorted({name for name, _ in blocks if name.startswith(SOLIDS)})),
        dict(others),
        node_sets={name: np.asarray(of, dtype=np.int64) for name, of in mesh.point_sets.items()},
        element_sets=element_sets,
        others_of_sets=others_of_sets,
        midside_nodes=len(np.unique(np.concatenate(midside))),
    )
