"""The table of a key characteristic."""

from __future__ import annotations

from typing import Annotated, Any, ClassVar, Literal

import numpy as np
from pydantic import Field, model_validator

from mic.scene.keys import (
    NORMAL,
    UNPLACED,
    Count,
    Direction,
    FiniteFloat,
    Name,
    NonNegative,
    OnPart,
    Place,
    Positive,
    Table,
    Vector,
    check_single_place,
)

__all__ = ["Measurement", "OtherPoint"]


class OtherPoint(Table):
    """The second point of a characteristic between two points; without a place: the nearest point of its part."""

    part: Name
    """the part that it is on"""

    point: Place = UNPLACED
    """a point, mm, at most 5 mm from the part"""

    node: Count | None = None
    """or the number of a node in the part's mesh file"""

    set: Annotated[str, Field(min_length=1)] | None = None
    """or the name of a node set in the part's mesh file: its centre"""

    hole: Vector | None = None
    """or a point near the centre of a hole: its rim is read"""

    radius: NonNegative = 2.5
    """of the probe, mm; 0: a single node"""

    @model_validator(mode="after")
    def _one_place(self):
        nearest = self.point is None and self.node is None and self.set is None and self.hole is None
        return self if nearest else check_single_place(self)


class Measurement(OnPart):
    """A key characteristic, mm: the deviation of a point from nominal along a direction, or another `kind`.

    `flush`, `gap` and `distance` are the motion of the point `to` relative to the first point: along the normal of the
    first point's sheet, along the line between them projected into that sheet, and along that line itself.
    `parallelism` is the width between two planes across `direction` that enclose all `points`, minus its nominal
    value; `profile` is twice the largest deviation of any point along its normal; both follow ISO 1101.
    """

    name: Name
    """name of the key characteristic in results"""

    kind: Literal["point", "flush", "gap", "distance", "parallelism", "profile"] = "point"
    """quantity that is measured"""

    part: Name
    """the part that is measured"""

    direction: Direction = NORMAL
    """in which a deviation is positive; omitted for `gap`, not allowed for `distance` and `profile`"""

    radius: NonNegative = 2.5
    """of the probe, mm; 0: a single node"""

    to: OtherPoint | None = None
    """`flush`, `gap`, `distance`: the second point, `{ part = NAME, point = [x, y, z] }`; `{ part = NAME }`: the
    point of that part nearest to the first"""

    points: Annotated[list[Vector], Field(min_length=2)] | None = None
    """`parallelism`, `profile`: the points, mm, at most 5 mm from the part; `flush`, `gap`, `distance`: one
    characteristic at each, `NAME-1`, `NAME-2` …"""

    spacing: Positive | None = None
    """or points all over the part, at most this far apart, mm"""

    box: tuple[Vector, Vector] | None = None
    """with `spacing`: only within `[[xmin, ymin, zmin], [xmax, ymax, zmax]]`, mm"""

    best_fit: Annotated[list[Name], Field(min_length=1)] | None = None
    """measurements to which the assembly is first aligned as a rigid body by least squares; `parallelism` and
    `profile` may name themselves"""

    frame: Name | None = None
    """the frame in which it is measured (`[[frames]]`); `none`: as the assembly stands in the measure stage, even if a
    frame is for all"""

    lower: FiniteFloat
    """lower tolerance limit, mm from nominal; omitted for `parallelism` and `profile`: 0"""

    upper: FiniteFloat
    """upper tolerance limit, mm from nominal"""

    #: Kinds with two points, and with any number of points.
    BETWEEN: ClassVar[tuple[str, ...]] = ("flush", "gap", "distance")
    OVER: ClassVar[tuple[str, ...]] = ("parallelism", "profile")

    @model_validator(mode="before")
    @classmethod
    def _from_zero(cls, table: Any):
        if isinstance(table, dict) and table.get("kind") in cls.OVER:
            none = ("direction",) if table.get("direction") is None else ()  # a profile of a placed scene
            return {"lower": 0.0} | {key: value for key, value in table.items() if key not in none}
        return table

    @model_validator(mode="after")
    def _one_place(self):
        given = [key for key in ("points", "spacing") if getattr(self, key) is not None]
        if self.kind not in self.OVER:
            if given:
                raise ValueError(f"{given[0]} goes with kind {' or '.join(self.OVER)}; give point, or that kind")
            return check_single_place(self)
        single = [key for key in ("point", "node", "set", "hole") if getattr(self, key) is not None]
        if single:
            raise ValueError(f"{self.kind} is read at many points: give points or spacing in place of {single[0]}")
        if len(given) != 1:
            raise ValueError(f"{self.kind} takes either points = [[x, y, z], …] or spacing (mm)")
        return self

    @model_validator(mode="after")
    def _of_its_kind(self):
        if (self.to is not None) != (self.kind in self.BETWEEN):
            raise ValueError(
                f"{self.kind} is between two points: give the other as to = {{ part = …, point = … }}"
                if self.to is None
                else f"to goes with kind {', '.join(self.BETWEEN)}; {self.kind} has no second point, remove it"
            )
        if self.kind == "profile":
            if self.direction != NORMAL:
                raise ValueError("a profile is read along the normals at its points: remove direction")
            object.__setattr__(self, "direction", UNPLACED)  # one direction for each point
        if self.kind == "distance" and self.direction != NORMAL and not self._along_line():
            raise ValueError("a distance is read along the line between its points: remove direction")
        if self.box is not None and self.spacing is None:
            raise ValueError("box goes with spacing: give the points themselves, or spacing (mm)")
        if self.box is not None and any(low >= high for low, high in zip(*self.box)):
            raise ValueError("box is [[xmin, ymin, zmin], [xmax, ymax, zmax]] with each minimum below its maximum")
        return self

    @model_validator(mode="after")
    def _ordered(self):
        if self.kind in self.OVER and self.lower != 0:
            raise ValueError(f"{self.kind} is never negative and its lower limit is 0: remove lower")
        if self.frame is not None and self.best_fit is not None:
            raise ValueError("frame and best_fit exclude each other: remove one of them")
        if self.lower >= self.upper:
            raise ValueError("lower must be smaller than upper")
        return self

    def _along_line(self) -> bool:
        """Whether the direction is the line to the second point, which it is after placement."""
        if self.to is None or self.to.point is None or self.point is None or isinstance(self.direction, str):
            return False
        line = np.subtract(self.to.point, self.point)
        return bool(np.allclose(line / np.linalg.norm(line), self.direction, rtol=0, atol=1e-9))

    @property
    def one_sided(self) -> bool:
        """Whether the quantity is never below its lower limit, 0."""
        return self.kind in self.OVER

    @property
    def bounds(self) -> tuple[float, float]:
        """Limits that the quantity can exceed, mm."""
        return (-np.inf if self.one_sided else self.lower), self.upper

    @property
    def places(self) -> list[tuple[str, Vector]]:
        """Parts and points where it is read, as far as these are placed."""
        found = [(self.part, point) for point in self.points or [self.point]]
        found += [(self.to.part, self.to.point)] if self.to is not None else []
        return [(part, point) for part, point in found if point is not None]
