"""What a mesh file tells beside the surface: node numbers, sets, and the sheet that its elements stand for."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from mic.geometry.repair import MeshReport

__all__ = ["UNITS", "Deck", "Sheet"]

#: Units of length that decks are written in: mm, and MPa of the unit of stress that goes with it (Pa with m, psi with
#: inches).
UNITS = {
    "mm": (1.0, 1.0),
    "cm": (10.0, 1e-2),
    "m": (1e3, 1e-6),
    "um": (1e-3, 1e6),
    "in": (25.4, 6.894757293168361e-3),
    "ft": (304.8, 4.788025898033584e-5),
}

#: Ends of lines of a repair report that tell nothing of a mesh's soundness.
USUAL = ("quadrilaterals split", "points that no triangle uses dropped", "nothing to repair")


@dataclass(frozen=True)
class Sheet:
    """What a deck tells of a sheet; None where it tells nothing.

    Attributes
    ----------
    thickness : float, optional
        mm.
    offset : float, optional
        From the drawn surface to the middle of the sheet, as a share of the thickness, positive along the normal of
        the surface: 0.5 where the elements lie on the skin that the normals point away from. The decks' own keys differ
        in sign (Abaqus ``OFFSET = SPOS`` is −0.5 here, Nastran ``ZOFFS`` has the same sign).
    young, poisson : float, optional
        MPa; Poisson's ratio.
    material : str, optional
        Its name, or its number.
    """

    thickness: float | None = None
    offset: float | None = None
    young: float | None = None
    poisson: float | None = None
    material: str | None = None


@dataclass(frozen=True)
class Deck:
    """What a mesh file tells beside its surface; empty where the format or the file knows nothing of it.

    Points and triangles are those of the surface that :func:`mic.geometry.readers.read_mesh` gives with it.

    Attributes
    ----------
    nodes, node_points : (m,) int arrays
        Numbers of nodes in the file, and the point that each became. Coincident nodes share a point; the same number
        stands twice where a part of the deck is placed twice.
    node_sets : dict of str to (s,) int array
        Points by the name of their set.
    element_sets : dict of str to (s,) int array
        Triangles by the name of their set. Properties and parts that have numbers are called ``PID 7``, and by their
        names too where the file holds these.
    parts : tuple of str
        Those of the element sets that divide the elements among themselves as parts of an assembly do: properties,
        instances, sections, physical groups. Empty where the file names none.
    sheets : tuple of Sheet
    sheet_of : (k,) int array
        The sheet that each triangle belongs to, -1 where the file tells nothing.
    repair : MeshReport
        What the repair took.
    passed_over : dict of str to int
        Elements of the file that are no sheet, by kind: beams, masses, connectors, rigid elements, …
    midside_nodes : int
        Nodes of the file in the middle of sides that were dropped: of such elements the corners are taken.
    """

    nodes: np.ndarray
    node_points: np.ndarray
    node_sets: dict[str, np.ndarray]
    element_sets: dict[str, np.ndarray]
    parts: tuple[str, ...]
    sheets: tuple[Sheet, ...]
    sheet_of: np.ndarray
    repair: MeshReport
    passed_over: dict[str, int]
    midside_nodes: int

    def points_of(self, node: int) -> np.ndarray:
        """Points of the surface that a node number stands for: none where it is not on the surface, mostly one."""
        return np.unique(self.node_points[self.nodes == node])

    def told(self, triangles: np.ndarray | None = None) -> list[Sheet]:
        """The different sheets that triangles belong to, all of them by default; a blank one where nothing is told."""
        numbers = np.unique(self.sheet_of if triangles is None else self.sheet_of[triangles])
        return [self.sheets[number] if number >= 0 else Sheet() for number in numbers]

    def notes(self) -> list[str]:
        """What was mended, dropped or passed over, in short clauses; empty where nothing was."""
        kinds = [f"{count} {kind}" for kind, count in sorted(self.passed_over.items())]
        return (
            [line for line in str(self.repair).split("\n") if not line.endswith(USUAL)]
            + ([f"{self.midside_nodes} midside nodes dropped"] if self.midside_nodes else [])
            + ([f"passed over, no sheet: {', '.join(kinds)}"] if kinds else [])
        )
