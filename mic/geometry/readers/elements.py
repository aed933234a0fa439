"""What the readers of decks share: elements gathered as they come, with their sets, sheets and normals."""

from __future__ import annotations

from collections.abc import Iterable

import numpy as np

from mic.errors import FormatError
from mic.geometry.deck import Sheet
from mic.geometry.readers.raw_mesh import RawMesh

__all__ = ["Gathered"]


class Gathered:
    """Points and elements of a deck under the numbers that it gives them, and at last a `RawMesh` of them.

    Points are known by keys: a node's number, or its instance and number. So are elements.
    """

    def __init__(self):
        self.points: dict[tuple, tuple[float, ...]] = {}
        self.elements: dict[tuple, tuple[tuple, ...]] = {}  # the corners of sheets
        self.normals: dict[tuple, tuple[float, ...]] = {}  # by point, or by element and point
        self.node_sets: dict[str, list[tuple]] = {}
        self.element_sets: dict[str, list[tuple]] = {}
        self.parts: list[str] = []
        self.sheets: dict[tuple, Sheet] = {}  # by element
        self.kinds: dict[tuple, str] = {}  # of the elements that are no sheets
        self.solids: set[str] = set()
        self.uncounted: dict[str, int] = {}  # kinds of elements that have no numbers
        self.midside: set[tuple] = set()

    def add_point(self, key: tuple, place: tuple[float, ...]) -> None:
        """A point.

        Raises
        ------
        FormatError
            If it stands elsewhere already.
        """
        if self.points.setdefault(key, place) != place:
            raise FormatError(f"node {key[-1]} is given twice, at different places; give each node once")

    def add_sheet(self, key: tuple, corners: Iterable[tuple], midside: Iterable[tuple] = ()) -> None:
        """A sheet element by its corners; those that repeat make a quadrilateral a triangle.

        Raises
        ------
        FormatError
            If the element is given already, on other nodes.
        """
        corners = tuple(dict.fromkeys(corners))
        if self.elements.setdefault(key, corners) != corners:
            raise FormatError(f"element {key[-1]} is given twice, on different nodes; give each element once")
        self.midside.update(midside)

    def mesh(self, what: str = "node") -> RawMesh:
        """All that was gathered.

        Parameters
        ----------
        what : str
            The format's word for a point.

        Raises
        ------
        FormatError
            If an element names a point that is not there.
        """
        index = {key: number for number, key in enumerate(self.points)}
        ordered = sorted(
            (key for key, corners in self.elements.items() if len(corners) > 2), key=lambda key: len(self.elements[key])
        )
        number = {key: row for row, key in enumerate(ordered)}
        try:
            corners = [[index[point] for point in self.elements[key]] for key in ordered]
        except KeyError as problem:
            raise FormatError(f"an element names the {what} {problem.args[0][-1]}, which is not given") from None
        split = next((row for row, of in enumerate(corners) if len(of) == 4), len(corners))
        nothing = (np.nan,) * 3
        told = [
            [self.normals.get((key, point), self.normals.get(point, nothing)) for point in self.elements[key]]
            for key in (ordered if self.normals else [])
        ]
        of_sheet: dict[Sheet, int] = {}
        sheet_of = [
            of_sheet.setdefault(self.sheets[key], len(of_sheet)) if key in self.sheets else -1 for key in ordered
        ]
        others = dict(self.uncounted)
        if len(ordered) < len(self.elements):
            others["elements on fewer than three nodes"] = len(self.elements) - len(ordered)
        for kind in self.kinds.values():
            others[kind] = others.get(kind, 0) + 1
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
            array(told[:split], 9, float).reshape(-1, 3, 3) if self.normals else None,
            array(told[split:], 12, float).reshape(-1, 4, 3) if self.normals else None,
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
