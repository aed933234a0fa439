"""The table of a weld."""

from __future__ import annotations

from pydantic import Field, model_validator

from mic.scene.keys import Flag, Name, NonNegative, OnSheet, Positive

__all__ = [
    "Weld",
]


class Weld(OnSheet):
    """A spot weld; it freezes the relative position that it finds, or closes the gap first."""

    name: Name = Field(description="names the weld in results")
    parts: tuple[Name, Name] = Field(description="the two parts that it joins; nodes and sets are those of the first")
    radius: NonNegative = Field(2.5, description="of the nugget, mm")
    close: Flag = Field(False, description="close the gap first (one more contact resolution), or freeze what is found")
    gun: Positive | None = Field(
        None,
        description="force with which the gun presses the two parts together while the weld is made, N; it opens "
        "after. Where it leaves a gap, the weld keeps it, the assembly counts as not built, and the force that the gun "
        "would need is told",
    )
    moment: Flag = Field(True, description="whether the nugget carries moment, or ties its mean displacement alone")
    fused: Flag = Field(
        True,
        description="whether all of the nugget is one piece; `false` ties its mean displacement and rotation, which is "
        "softer",
    )
    stage: Name = Field("weld", description="the weld stage that makes it")

    @model_validator(mode="after")
    def _one_way_to_close(self):
        if self.close and self.gun is not None:
            raise ValueError("close closes the gap whatever that takes, a gun with its force: remove one of them")
        return self
