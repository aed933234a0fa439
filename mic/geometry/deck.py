"""Contents of a mesh file besides its surface: node numbers, sets, and sheet properties."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from mic.geometry.repair import MeshReport

__all__ = ["UNITS", "Deck", "Sheet"]

#: Units of length: in mm, and the corresponding unit of stress (Pa for m, psi for inches) in MPa.
UNITS = {
    "mm": (1.0, 1.0),
    "cm": (10.0, 1e-2),
    "m": (1e3, 1e-6),
    "um": (1e-3, 1e6),
    "in": (25.4, 6.894757293168361e-3),
    "ft": (304.8, 4.788025898033584e-5),
}

#: Ends of lines of a repair report that need no attention.
HARMLESS = ("quadrilaterals split", "points that no triangle uses dropped", "nothing to repair")


@dataclass(frozen=True)
class Sheet:
    """Properties of a sheet in a deck; None if not given.

    Attributes
    ----------
    thickness : float, optional
        mm.
    offset : float, optional
        Distance from the meshed surface to the mid-surface over the thickness, positive along the surface normal: 0.5
        if the elements lie on the skin opposite to the normal. The keys of decks differ in sign (Abaqus ``OFFSET =
        SPOS`` is −0.5 here, Nastran ``ZOFFS`` has the same sign).
    young, poisson : float, optional
        Young's modulus, MPa; Poisson's ratio.
    material : str, optional
        Name or number.
    """

    thickness: float | None = None
    offset: float | None = None
    young: float | None = None
    poisson: float | None = None
    material: str | None = None


@dataclass(frozen=True)
class Deck:
    """Contents of a mesh file besides its surface; empty if the format or file has none.

    Points and triangles are those of the surface that :func:`mic.geometry.readers.read_mesh` returns with it.

    Attributes
    ----------
    nodes, node_points : (m,) int arrays
        Node numbers in the file, and the point of each. Coincident nodes share a point; a number appears twice if a
        part of the deck is instanced twice.
    node_sets : dict of str to (s,) int array
        Points by set name.
    element_sets : dict of str to (s,) int array
        Triangles by set name. Numbered properties and parts are called ``PID 7``, and by their names too if given.
    parts : tuple of str
        Element sets that partition the elements into parts of an assembly: properties, instances, sections, physical
        groups. Empty if the file has none.
    sheets : tuple of Sheet
    sheet_of : (k,) int array
        Index of each triangle's sheet, -1 if unknown.
    repair : MeshReport
        Changes made by the repair.
    ignored_elements : dict of str to int
        Number of elements other than shells by kind: beams, masses, connectors, rigid elements, …
    midside_nodes : int
        Number of mid-side nodes that were dropped.
    """

    nodes: np.ndarray
    node_points: np.ndarray
    node_sets: dict[str, np.ndarray]
    element_sets: dict[str, np.ndarray]
    parts: tuple[str, ...]
    sheets: tuple[Sheet, ...]
    sheet_of: np.ndarray
    repair: MeshReport
    ignored_elements: dict[str, int]
    midside_nodes: int

    def points_of(self, node: int) -> np.ndarray:
        """Points of the surface with a node number: none if the node is not on it, usually one."""
        return np.unique(self.node_points[self.nodes == node])

    def distinct_sheets(self, triangles: np.ndarray | None = None) -> list[Sheet]:
        """Distinct sheets of some triangles, by default all; `Sheet()` where unknown."""
        numbers = np.unique(self.sheet_of if triangles is None else self.sheet_of[triangles])
        return [self.sheets[number] if number >= 0 else Sheet() for number in numbers]

    def notes(self) -> list[str]:
        """Repairs, dropped nodes and ignored elements, as short clauses; empty if there are none."""
        kinds = [f"{count} {kind}" for kind, count in sorted(self.ignored_elements.items())]
        return (
            [line for line in str(self.repair).split("\n") if not line.endswith(HARMLESS)]
            + ([f"{self.midside_nodes} midside nodes dropped"] if self.midside_nodes else [])
            + ([f"ignored elements other than shells: {', '.join(kinds)}"] if kinds else [])
        )
