"""What a source of deviation is."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any, Literal

import numpy as np
from scipy.sparse import csr_matrix

__all__ = ["Control", "Row", "Source"]

Row = tuple[str, int]  #: a row by its kind and its number


@dataclass(frozen=True)
class Control:
    """A shape that is known where rows of one part read it.

    Attributes
    ----------
    rows : (c, F) csr_matrix
    value : (c,) array
        What they read of the shape per unit amplitude, mm.
    noise : (c,) array
        Standard uncertainty of the values, mm; all zero, or none.
    loose : bool
        Whether they hold of the part in any position, or of the part set down on its datum locators.
    """

    rows: csr_matrix
    value: np.ndarray
    noise: np.ndarray
    loose: bool


class Source:
    """One of a scene's deviations: what a unit of its amplitude does to the assembly.

    Amplitudes come from the scene's distributions (`mic.sampling`). What a source does is linear in them: it gives a
    part another stress-free shape, it moves what a bilateral row prescribes, or it pushes. A kind of source overrides
    what it does and leaves the rest.

    Parameters
    ----------
    deviation
        The scene's table.
    key : str
        Where it stands in the scene, for messages.
    scene : mic.scene.Scene
        What it is a deviation of.
    """

    #: What it changes of the assembly itself, so that each of its values has contact problems of its own: the friction
    #: of contacts, the compliance of parts and with it the contacts, or nothing.
    changes: Literal["", "friction", "compliance"] = ""

    def __init__(self, deviation: Any, key: str, scene: Any):
        self.deviation, self.key, self.scene = deviation, key, scene

    def retain(self, rows: Any) -> None:
        """Add the rows that the source needs to :class:`mic.model.rows.Rows`."""

    def load(self, labels: Mapping[str, list[str]], rows: Mapping[str, csr_matrix]) -> csr_matrix | None:
        """Force (1, F) that shapes one part, or several, per unit amplitude, N and N mm, or None.

        Each part is held on its datum locators while the force acts; the deformed shape is then its stress-free shape.
        """
        return None

    def control(self, labels: Mapping[str, list[str]], rows: Mapping[str, csr_matrix]) -> Control | None:
        """The shape of a part where it is known, per unit amplitude, in place of a force that makes it, or None."""
        return None

    def expansion(self) -> Mapping[str, float]:
        """By how much parts grow in all directions per unit amplitude, free of stress, mm/mm, by name."""
        return {}

    def thickening(self) -> Mapping[str, int]:
        """Parts that are thicker by the amplitude, mm, by name, and which skin of each stays: 1 that on the side of the
        mesh's normals, -1 the other, 0 neither."""
        return {}

    def change(self, contacts: Any, amplitude: float) -> Any:
        """:class:`mic.model.assembly.Contacts` as they are at an amplitude, where the source changes them.

        Raises
        ------
        ImpossibleSample
        """
        return contacts

    def target(self, labels: Mapping[str, list[str]]) -> Mapping[Row, float]:
        """By how much bilateral rows are moved per unit amplitude, mm along the row."""
        return {}

    def push(self, labels: Mapping[str, list[str]]) -> Mapping[Row, float]:
        """By how much the forces of clamp rows grow per unit amplitude, N along the row."""
        return {}
