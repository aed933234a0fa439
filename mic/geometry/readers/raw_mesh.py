"""Contents of a mesh file as a reader returns them, neither checked nor repaired."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np

from mic.errors import FormatError
from mic.geometry.deck import Sheet

__all__ = ["RawMesh", "from_meshlane"]

SOLIDS = ("tetra", "hexa", "wedge", "pyramid", "polyhedron")  # prefixes of meshlane's names of solid elements


@dataclass(frozen=True)
class RawMesh:
    """Contents of a mesh file.

    Elements are numbered from zero, triangles first, then quadrilaterals.

    Attributes
    ----------
    points : (n, 3) array
        In the unit of the file.
    triangles : (k, 3) int array
        Point numbers from zero; only the corners of elements with mid-side nodes.
    quadrilaterals : (q, 4) int array
        Likewise.
    solids : tuple of str
        Kinds of solid elements in the file.
    others : dict of str to int
        Number of other ignored elements, such as beams, by kind.
    triangle_normals, quadrilateral_normals : (k, 3, 3) and (q, 4, 3) array, optional
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
    sheet_of : (k + q,) int array, optional
        Sheet of each element, -1 for none.
    midside_nodes : int
        Number of dropped mid-side nodes.
    """

    points: np.ndarray
    triangles: np.ndarray
    quadrilaterals: np.ndarray
    solids: tuple[str, ...] = field(default=())
    others: dict[str, int] = field(default_factory=dict)
    triangle_normals: np.ndarray | None = None
    quadrilateral_normals: np.ndarray | None = None
    nodes: np.ndarray | None = None
    node_sets: dict[str, np.ndarray] = field(default_factory=dict)
    element_sets: dict[str, np.ndarray] = field(default_factory=dict)
    others_of_sets: dict[str, tuple[str, ...]] = field(default_factory=dict)
    parts: tuple[str, ...] = ()
    sheets: tuple[Sheet, ...] = ()
    sheet_of: np.ndarray | None = None
    midside_nodes: int = 0

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
        listed = ", ".join(repr(other) for other in known[:20]) + (", …" if len(known) > 20 else "")
        raise FormatError(
            f"there is no element set {name!r}; "
            + (f"the file holds {listed}" if known else "the file holds no sets: remove `set`")
        )

    def selected(self, sets: Iterable[str]) -> RawMesh:
        """The elements of some sets and their points; the sets are restricted to these.

        Raises
        ------
        FormatError
            If a set does not exist, holds solid elements, or no shells.
        """
        chosen = np.zeros(len(self.triangles) + len(self.quadrilaterals), dtype=bool)
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
        in_sets = {name: number[elements] for name, elements in self.element_sets.items()}
        of_triangles, of_quadrilaterals = np.split(chosen, [len(self.triangles)])
        corners = self.triangles[of_triangles], self.quadrilaterals[of_quadrilaterals]
        used = np.unique(np.concatenate([of.ravel() for of in corners]))
        place = np.full(len(self.points), -1)
        place[used] = np.arange(len(used))
        of_points = {name: place[points] for name, points in self.node_sets.items()}
        return replace(
            self,
            points=self.points[used],
            nodes=None if self.nodes is None else self.nodes[used],
            node_sets={name: points[points >= 0] for name, points in of_points.items()},
            triangles=place[corners[0]],
            quadrilaterals=place[corners[1]],
            triangle_normals=None if self.triangle_normals is None else self.triangle_normals[of_triangles],
            quadrilateral_normals=(
                None if self.quadrilateral_normals is None else self.quadrilateral_normals[of_quadrilaterals]
            ),
            solids=(),
            element_sets={name: elements[elements >= 0] for name, elements in in_sets.items()},
            sheet_of=None if self.sheet_of is None else self.sheet_of[chosen],
        )


def from_meshlane(mesh: Any) -> RawMesh:
    """The shell elements of a ``meshlane.Mesh``, and its sets."""
    blocks = [(block.type, np.asarray(block.data)) for block in mesh.cells]
    points = np.zeros((len(mesh.points), 3))
    if len(mesh.points):
        points[:, : mesh.points.shape[1]] = mesh.points
    first: dict[int, int] = {}  # element number of the first element of each block of shells
    corners: dict[str, np.ndarray] = {}
    for kind, count in (("triangle", 3), ("quad", 4)):
        found = [np.zeros((0, count), dtype=np.int64)]
        for number, (name, data) in enumerate(blocks):
            if name.startswith(kind):
                first[number] = sum(len(of) for of in (*corners.values(), *found))
                found.append(data[:, :count])
        corners[kind] = np.concatenate(found)
    others: dict[str, int] = {}
    for name, data in blocks:
        if not name.startswith((*SOLIDS, "triangle", "quad")):
            others[name] = others.get(name, 0) + len(data)
    element_sets, others_of_sets = {}, {}
    for name, of_blocks in mesh.cell_sets.items():
        rows = [np.asarray([] if of is None else of, dtype=np.int64) for of in of_blocks]
        held = [first[number] + of for number, of in enumerate(rows) if number in first]
        kinds = tuple(sorted({blocks[number][0] for number, of in enumerate(rows) if len(of) and number not in first}))
        if any(len(of) for of in held):
            element_sets[name] = np.concatenate(held)
        if kinds:
            others_of_sets[name] = kinds
    midside = [data[:, (3 if name.startswith("triangle") else 4) :] for name, data in blocks]
    midside = [nodes for (name, _), nodes in zip(blocks, midside) if name.startswith(("triangle", "quad"))]
    return RawMesh(
        points,
        corners["triangle"],
        corners["quad"],
        tuple(sorted({name for name, _ in blocks if name.startswith(SOLIDS)})),
        others,
        node_sets={name: np.asarray(of, dtype=np.int64) for name, of in mesh.point_sets.items()},
        element_sets=element_sets,
        others_of_sets=others_of_sets,
        midside_nodes=len(np.unique(np.concatenate([nodes.ravel() for nodes in midside]))) if midside else 0,
    )
