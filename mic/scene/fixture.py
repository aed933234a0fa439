"""The tables of the fixture: rigid bodies, locators, clamps."""

from __future__ import annotations

from typing import Annotated

from pydantic import Field, model_validator

from mic.scene.keys import (
    NORMAL,
    UNPLACED,
    Count,
    Direction,
    FileName,
    FiniteFloat,
    Name,
    NonNegative,
    OnPart,
    Owner,
    Positive,
    Table,
    Vector,
)

__all__ = ["Clamp", "Fixture", "Locator"]


class Fixture(Table):
    """A rigid surface that parts may touch: a mesh, or a flat round pad.

    A pad with `part` is placed on the skin of that part as drawn.
    """

    name: Name
    """name of the fixture in `[[zones]]`"""

    mesh: FileName | None = None
    """mesh file, relative to the scene file"""

    point: Vector | None = None
    """or the centre of a flat round pad, mm; with `part` at most 5 mm from the part"""

    part: Name | None = None
    """the part that the pad touches"""

    node: Count | None = None
    """with `part`: or the number of a node"""

    set: Annotated[str, Field(min_length=1)] | None = None
    """or the name of a node set: its centre"""

    hole: Vector | None = None
    """or a point near the centre of a hole that the pad covers"""

    normal: Direction | None = None
    """direction in which the pad faces; with `part` also the sheet's `normal` (default) or `-normal`"""

    radius: Positive | None = None
    """radius of the pad, mm"""

    stage: Name | None = None
    """the locate stage whose station has the fixture; default: the first"""

    @model_validator(mode="after")
    def _one_shape(self):
        places = [key for key in ("point", "node", "set", "hole") if getattr(self, key) is not None]
        given = places + [key for key in ("part", "normal", "radius") if getattr(self, key) is not None]
        if (self.mesh is None) == (not given):
            raise ValueError('give either mesh = "file", or point, normal and radius of a flat pad')
        if self.mesh is not None:
            return self
        if self.part is None:
            alone = [key for key in places if key != "point"]
            if alone:
                raise ValueError(f"{alone[0]} needs a part: add part, on which the pad is placed")
            if not {"point", "normal", "radius"} <= set(given):
                raise ValueError('give either mesh = "file", or point, normal and radius of a flat pad')
            if isinstance(self.normal, str):
                raise ValueError(f"normal = {self.normal!r} needs a part: add part, or give normal = [x, y, z]")
            return self
        if len(places) != 1:
            raise ValueError(
                f"{' and '.join(places)} both give the place of the pad: remove all but one"
                if places
                else "the place of the pad on its part is missing: give point = [x, y, z], or node or set or hole"
            )
        if self.radius is None:
            raise ValueError("a pad needs radius, mm: add it")
        if self.normal is None:
            object.__setattr__(self, "normal", NORMAL)
        if isinstance(self.normal, str) and "in-plane" in self.normal:
            raise ValueError('the normal of a pad on a part is "normal", "-normal" or [x, y, z]')
        return self


class Locator(OnPart):
    """A bilateral support of a part in one direction, over a pad.

    Locators of the locate stage place the part (a 3-2-1 scheme). Those of a clamp stage (N-2-1) force the part to its
    nominal shape there. Those of a later locate stage, or of the measure stage, hold the assembly in another station,
    where all earlier locators and clamps are open.
    """

    name: Name
    """name of the locator in `keep` and in deviations"""

    part: Name
    """the part that it supports"""

    direction: Direction = NORMAL
    """of the support"""

    radius: NonNegative = 4.0
    """of the pad, mm; 0: a single node"""

    stage: Name = "locate"
    """the stage in which it closes; those of the locate stage must hold all six rigid-body motions"""

    stiffness: Positive | None = None
    """N/mm; default: rigid. A soft locator carries a part until clamps press it onto another"""


class Clamp(OnPart):
    """A clamp pushes a part along `direction`, by a force or to a position.

    With `parts` it is a tong with two jaws, ``NAME-PART``, that push the parts towards each other; `order`, `keep` and
    deviations may name the tong or a jaw.
    """

    name: Name
    """name of the clamp in deviations"""

    part: Owner = UNPLACED
    """the part that it pushes"""

    parts: tuple[Name, Name] | None = None
    """or the two parts that it presses together as a tong"""

    direction: Direction = NORMAL
    """of the push, for a tong on its first part; default for a tong: together"""

    force: FiniteFloat | None = None
    """N along `direction`"""

    stroke: FiniteFloat | None = None
    """or the prescribed position along `direction`, mm from nominal"""

    limit: Positive | None = None
    """with `stroke`: the largest force, N. If more is needed, the clamp stops short, the assembly counts as not
    built, and the required force is reported"""

    radius: NonNegative = 5.0
    """of the pad, mm; 0: a single node"""

    stage: Name = "clamp"
    """the clamp stage that closes it; a release opens it"""

    @model_validator(mode="after")
    def _force_or_stroke(self):
        if (self.force is None) == (self.stroke is None):
            raise ValueError("give either force (N) or stroke (mm from the nominal position), not both")
        if self.limit is not None and self.stroke is None:
            raise ValueError("limit needs a stroke; a clamp with a force always pushes with this force: remove limit")
        return self

    @model_validator(mode="after")
    def _one_or_two(self):
        if (self.part is None) == (self.parts is None):
            raise ValueError("give either part, which it pushes, or parts = [a, b], which it presses together")
        if self.parts is not None and (isinstance(self.direction, str) and self.direction != "normal"):
            raise ValueError("a tong presses its parts together: remove direction, or give [x, y, z] for parts[0]")
        if self.parts is not None and self.hole is not None:
            raise ValueError("a tong cannot press in a hole: give point, node or set")
        return self

    @property
    def owners(self) -> tuple[Name, ...]:
        """The parts that it pushes."""
        return self.parts or (self.part,)
