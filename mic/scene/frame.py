"""The table of a measurement frame."""

from __future__ import annotations

from typing import Annotated, Literal

from pydantic import Discriminator, Field, Tag, model_validator

from mic.scene.keys import NORMAL, Direction, Flag, Name, NonNegative, OnPart, Positive, Table

__all__ = ["Frame", "FramePoint"]

SIX = 6  # points of a 3-2-1 alignment


class FramePoint(OnPart):
    """A point that is read for a frame alone."""

    name: Name
    """name of the point in files of measurements"""

    part: Name
    """the part that it is on"""

    direction: Direction = NORMAL
    """in which it is read"""

    radius: NonNegative = 2.5
    """of the probe, mm; 0: a single node"""


def _kind(point: object) -> str:
    return "point-name" if isinstance(point, str) else "point-table"


#: A name, or a point of the frame's own; errors are those of the one that is meant.
PointOrName = Annotated[
    Annotated[Name, Tag("point-name")] | Annotated[FramePoint, Tag("point-table")], Discriminator(_kind)
]


class Frame(Table):
    """The frame of some or all measurements: before these are read, the assembly moves as a rigid body.

    `3-2-1` brings six points to their nominal positions, each along its direction. `best-fit` minimises the weighted
    sum of squares of their deviations; motions that they do not determine are zero.
    """

    name: Name
    """name of the frame"""

    kind: Literal["3-2-1", "best-fit"] = "best-fit"
    """alignment"""

    points: Annotated[list[PointOrName], Field(min_length=1)] | None = None
    """names of measurements and locators, whose points and directions are used, or points of its own, `{ name, part,
    point, direction }`; default: all measurements of kind `point`"""

    weights: Annotated[list[Positive], Field(min_length=1)] | None = None
    """`best-fit`: factor of each square, in the order of `points`; default: 1"""

    all: Flag = False
    """whether it is the frame of every measurement without a `frame` or `best_fit` of its own"""

    @model_validator(mode="after")
    def _of_its_kind(self):
        if self.kind == "3-2-1" and (self.weights is not None or len(self.points or ()) != SIX):
            what = "a 3-2-1 alignment is exact: remove weights" if self.weights is not None else "give six points"
            raise ValueError(f'{what}, or kind = "best-fit"')
        if self.weights is not None and len(self.weights) != len(self.points or ()):
            raise ValueError(
                f"there are {len(self.points or ())} points and {len(self.weights)} weights: give one for each"
            )
        return self
