"""Base class of the sources of deviation."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any, Literal

import numpy as np
from scipy.sparse import csr_matrix

from mic.model.rows import Row
from mic.scene.deviation import targets

__all__ = ["KnownShape", "Source"]


@dataclass(frozen=True)
class KnownShape:
    """A shape that is known at points, where rows of one part read it.

    Attributes
    ----------
    rows : (c, F) csr_matrix
    value : (c,) array
        Their readings of the shape per unit amplitude, mm.
    noise : (c,) array
        Standard uncertainty of the values, mm; all positive or all zero.
    loose : bool
        Whether the values hold for the part in any position, or only on its datum locators.
    """

    rows: csr_matrix
    value: np.ndarray
    noise: np.ndarray
    loose: bool


class Source:
    """One of a scene's deviations: the effect of a unit of its amplitude on the assembly.

    Amplitudes come from the scene's distributions (`mic.statistics`). The effect is linear in them: a source gives a
    part another stress-free shape, it moves the prescribed value of a bilateral row, or it applies a force. Each kind
    of source overrides the methods that it needs.

    Parameters
    ----------
    deviation
        The scene's table.
    key : str
        Its scene key, for messages.
    scene : mic.scene.Scene
    """

    #: What a source changes in the assembly itself, so that each of its values needs contact problems of its own:
    #: friction of contacts, compliance of parts (and with it the contacts), or nothing.
    changes: Literal["", "friction", "compliance"] = ""

    def __init__(self, deviation: Any, key: str, scene: Any):
        self.deviation, self.key, self.scene = deviation, key, scene

    @property
    def label(self) -> str:
        """Scene key and name, for messages."""
        return f"{self.key} ({self.deviation.name})"

    @property
    def targets(self) -> list[str]:
        """Names of the items that the deviation acts on."""
        return targets(self.deviation)

    def retain(self, rows: Any) -> None:
        """Add the rows that the source needs to :class:`mic.model.rows.Rows`."""

    def load(self, labels: Mapping[str, list[str]], rows: Mapping[str, csr_matrix]) -> csr_matrix | None:
        """Force (1, F) that shapes one or several parts, per unit amplitude, N and N mm, or None.

        Each part is held on its datum locators while the force acts; the deformed shape is then its stress-free shape.
        """
        return None

    def known_shape(self, labels: Mapping[str, list[str]], rows: Mapping[str, csr_matrix]) -> KnownShape | None:
        """The shape of a part at points, per unit amplitude, if it is known instead of the force, or None."""
        return None

    def expansion(self) -> Mapping[str, float]:
        """Stress-free isotropic strain of parts per unit amplitude, mm/mm, by name."""
        return {}

    def thickening(self) -> Mapping[str, int]:
        """Parts whose thickness grows by the amplitude, mm, by name, and the skin of each that stays in place: 1 the
        one on the side of the mesh's normals, -1 the other, 0 neither."""
        return {}

    def change(self, contacts: Any, amplitude: float) -> Any:
        """:class:`mic.model.assembly_types.Contacts` at an amplitude, changed if the source changes them.

        Raises
        ------
        ImpossibleSample
        """
        return contacts

    def target(self, labels: Mapping[str, list[str]]) -> Mapping[Row, float]:
        """Prescribed motion of bilateral rows per unit amplitude, mm along the row."""
        return {}

    def push(self, labels: Mapping[str, list[str]]) -> Mapping[Row, float]:
        """Additional force of clamp rows per unit amplitude, N along the row."""
        return {}
