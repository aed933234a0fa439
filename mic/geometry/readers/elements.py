"""Collection of the elements, sets, sheets and normals of a deck, used by the readers of decks."""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterable, Mapping
from typing import Any

import numpy as np

from mic.errors import FormatError
from mic.geometry.deck import Sheet
from mic.geometry.readers.raw_mesh import RawMesh

__all__ = ["Gathered", "define"]


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
        define(self.points, key, place, f"node {key[-1]}")

    def add_sheet(self, key: tuple, corners: Iterable[tuple], midside: Iterable[tuple] = ()) -> None:
        """Add a shell element by its corners; repeated corners make a quadrilateral a triangle.

        Raises
        ------
        FormatError
            If it is already defined on other nodes.
        """
        define(self.elements, key, tuple(dict.fromkeys(corners)), f"element {key[-1]}")
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
        shells = {key: corners for key, corners in self.elements.items() if len(corners) > 2}
        ordered = sorted(shells, key=lambda key: len(shells[key]))
        try:
            corners = [[index[point] for point in shells[key]] + [-1] * (4 - len(shells[key])) for key in ordered]
        except KeyError as problem:
            missing = problem.args[0][-1]
            text = f"an element uses the {what} {missing}, which is not defined; export the mesh again"
            raise FormatError(text) from None
        normals = np.full((len(ordered), 4, 3), np.nan)
        for row, key in enumerate(ordered if self.normals else []):
            for corner, point in enumerate(shells[key]):
                normals[row, corner] = self.normals.get((key, point), self.normals.get(point, np.nan))
        numbers: dict[Sheet, int] = {Sheet(): -1}
        sheet_of = [numbers.setdefault(self.sheets.get(key, Sheet()), len(numbers) - 1) for key in ordered]
        others = self.unnumbered + Counter(self.kinds.values())
        if len(shells) < len(self.elements):
            others["elements on fewer than three nodes"] = len(self.elements) - len(shells)
        element_sets = _numbered(self.element_sets, {key: row for row, key in enumerate(ordered)})
        without = {
            name: tuple(sorted({self.kinds[key] for key in of if key in self.kinds}))
            for name, of in self.element_sets.items()
        }
        return RawMesh(
            np.array(list(self.points.values()), dtype=float).reshape(-1, 3),
            np.array(corners, dtype=np.int64).reshape(-1, 4),
            tuple(sorted(self.solids)),
            {kind: count for kind, count in others.items() if kind not in self.solids},
            normals if self.normals else None,
            np.array([key[-1] for key in self.points], dtype=np.int64),
            _numbered(self.node_sets, index),
            element_sets,
            {name: kinds for name, kinds in without.items() if kinds},
            tuple(name for name in self.parts if name in element_sets),
            tuple(numbers)[1:],
            np.array(sheet_of, dtype=np.int64),
            len(self.midside - {point for corners in self.elements.values() for point in corners}),
        )


def define(table: dict, key: Any, value: Any, what: str) -> None:
    """Add an entry to a table of nodes or elements.

    Raises
    ------
    FormatError
        If it is already defined with another position or other nodes.
    """
    if table.setdefault(key, value) != value:
        raise FormatError(f"{what} is defined twice, and differently; remove one definition")


def _numbered(sets: dict[str, list[tuple]], number: dict[tuple, int]) -> dict[str, np.ndarray]:
    """Numbers of the members of each set; sets of which none has a number are left out."""
    found = {name: sorted({number[key] for key in keys if key in number}) for name, keys in sets.items()}
    return {name: np.array(numbers, dtype=np.int64) for name, numbers in found.items() if numbers}
