"""Collection of the elements, sets, sheets and normals of a deck, used by the readers of decks."""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterable, Mapping
from typing import Any

import numpy as np

from mic.errors import FormatError
from mic.geometry.deck import Sheet
from mic.geometry.readers.raw_mesh import RawMesh

__all__ = ["Gathered"]


class Gathered:
    """Points and elements of a deck by their numbers, from which a `RawMesh` is made.

    The key of a point or element is its number, or its instance and number.
    """

    def __init__(self):
        self.points: dict[tuple, tuple[float, ...]] = {}
        self.elements: dict[tuple, tuple[tuple, ...]] = {}  # corners of shells
        self.normals: dict[tuple, tuple[float, ...]] = {}  # by point, or by element and point
        self.node_sets: dict[str, list[tuple]] = {}
        self.element_sets: dict[str, list[tuple]] = {}
        self.parts: list[str] = []
        self.sheets: dict[tuple, Sheet] = {}  # by element
        self.kinds: dict[tuple, str] = {}  # of elements other than shells
        self.solids: set[str] = set()
        self.unnumbered: Counter[str] = Counter()  # elements without numbers by kind
        self.midside: set[tuple] = set()

    def add_point(self, key: tuple, place: tuple[float, ...]) -> None:
        """Add a point.

        Raises
        ------
        FormatError
            If it is already defined at another position.
        """
        if self.points.setdefault(key, place) != place:
            raise FormatError(f"node {key[-1]} is defined twice, at different positions; remove one definition")

    def add_sheet(self, key: tuple, corners: Iterable[tuple], midside: Iterable[tuple] = ()) -> None:
        """Add a shell element by its corners; repeated corners make a quadrilateral a triangle.

        Raises
        ------
        FormatError
            If it is already defined on other nodes.
        """
        corners = tuple(dict.fromkeys(corners))
        if self.elements.setdefault(key, corners) != corners:
            raise FormatError(f"element {key[-1]} is defined twice, on different nodes; remove one definition")
        self.midside.update(midside)

    def add_other(self, key: tuple, kind: str, solid: bool = False) -> None:
        """Add an element that is no shell."""
        self.kinds[key] = kind
        if solid:
            self.solids.add(kind)

    def add_to_property(self, number: int | str, key: tuple) -> None:
        """Add an element to the set of its property or part."""
        self.element_sets.setdefault(f"PID {number}", []).append(key)

    def name_parts(self, numbers: Iterable[int | str], names: Mapping[Any, str]) -> None:
        """Make properties parts, under their names if these are unique; named ones get a set of that name too."""
        every = list(names.values())
        for number in dict.fromkeys(numbers):
            label, name = f"PID {number}", names.get(number)
            self.parts.append(name if name and every.count(name) == 1 else label)
            if name:
                self.element_sets.setdefault(name, []).extend(self.element_sets[label])

    def mesh(self, what: str = "node") -> RawMesh:
        """The collected mesh.

        Parameters
        ----------
        what : str
            The format's word for a point, for messages.

        Raises
        ------
        FormatError
            If an element uses an undefined point.
        """
        index = {key: number for number, key in enumerate(self.points)}
        ordered = sorted(
            (key for key, corners in self.elements.items() if len(corners) > 2), key=lambda key: len(self.elements[key])
        )
        number = {key: row for row, key in enumerate(ordered)}
        try:
            corners = [[index[point] for point in self.elements[key]] for key in ordered]
        except KeyError as problem:
            raise FormatError(
                f"an element uses the {what} {problem.args[0][-1]}, which is not defined; export the mesh again"
            ) from None
        split = next((row for row, of in enumerate(corners) if len(of) == 4), len(corners))
        unknown = (np.nan,) * 3
        normals = [
            [self.normals.get((key, point), self.normals.get(point, unknown)) for point in self.elements[key]]
            for key in (ordered if self.normals else [])
        ]
        of_sheet: dict[Sheet, int] = {}
        sheet_of = [
            of_sheet.setdefault(self.sheets[key], len(of_sheet)) if key in self.sheets else -1 for key in ordered
        ]
        others = self.unnumbered + Counter(self.kinds.values())
        if len(ordered) < len(self.elements):
            others["elements on fewer than three nodes"] = len(self.elements) - len(ordered)
        sets = {name: [number[key] for key in of if key in number] for name, of in self.element_sets.items()}
        without = {
            name: tuple(sorted({self.kinds[key] for key in of if key in self.kinds}))
            for name, of in self.element_sets.items()
        }
        array = lambda rows, count, kind: np.array(rows, dtype=kind).reshape(-1, count)
        return RawMesh(
            array(list(self.points.values()), 3, float),
            array(corners[:split], 3, np.int64),
            array(corners[split:], 4, np.int64),
            tuple(sorted(self.solids)),
            {kind: count for kind, count in others.items() if kind not in self.solids},
            array(normals[:split], 9, float).reshape(-1, 3, 3) if self.normals else None,
            array(normals[split:], 12, float).reshape(-1, 4, 3) if self.normals else None,
            np.array([key[-1] for key in self.points], dtype=np.int64),
            {
                name: np.array(sorted({index[key] for key in of if key in index}), dtype=np.int64)
                for name, of in self.node_sets.items()
                if any(key in index for key in of)
            },
            {name: np.array(sorted(set(of)), dtype=np.int64) for name, of in sets.items() if of},
            {name: kinds for name, kinds in without.items() if kinds},
            tuple(name for name in self.parts if sets.get(name)),
            tuple(of_sheet),
            np.array(sheet_of, dtype=np.int64),
            len(self.midside - {point for corners in self.elements.values() for point in corners}),
        )
