"""The table of a weld."""

from __future__ import annotations

from pydantic import model_validator

from mic.scene.keys import Flag, Name, NonNegative, OnSheet, Positive

__all__ = ["Weld"]


class Weld(OnSheet):
    """A spot weld; it freezes the relative position of the sheets, or closes the gap first."""

    name: Name
    """name of the weld in results"""

    parts: tuple[Name, Name]
    """the two parts that it joins, on each other or one on the other by its free edge (a T joint); nodes and sets are
    those of the first"""

    radius: NonNegative = 2.5
    """of the nugget, mm"""

    close: Flag = False
    """close the gap first (one more contact solution); else it is frozen"""

    gun: Positive | None = None
    """force of the welding gun, N. A remaining gap is frozen, the assembly counts as not built, and the required
    force is reported"""

    moment: Flag = True
    """whether the nugget transmits moments, or couples mean displacements only"""

    fused: Flag = True
    """whether the nugget is rigid; `false` couples its mean displacement and rotation, which is softer"""

    stage: Name = "weld"
    """the weld stage that makes it"""

    @model_validator(mode="after")
    def _one_way_to_close(self):
        if self.close and self.gun is not None:
            raise ValueError("close closes the gap with any force, a gun with its own: remove one of them")
        return self
