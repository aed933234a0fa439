"""The tables of the fixture: rigid bodies, locators, clamps."""

from __future__ import annotations

from typing import Annotated

from pydantic import Field, model_validator

from mic.scene.keys import (
    NORMAL,
    TOWARDS,
    UNPLACED,
    Count,
    Direction,
    FiniteFloat,
    Name,
    NonNegative,
    OnPart,
    Owner,
    Positive,
    Table,
    Vector,
)

__all__ = [
    "Clamp",
    "Fixture",
    "Locator",
]


class Fixture(Table):
    """A rigid surface that parts may touch: a mesh, or a flat round pad.

    A pad with `part` is set against that part as it is drawn: its face touches the skin, at a place told as elsewhere.
    """

    name: Name = Field(description="names the fixture in `[[zones]]`")
    mesh: str | None = Field(None, description="mesh file, relative to the scene file")
    point: Vector | None = Field(
        None, description="or the centre of a flat round pad, mm; with `part` a place at most 5 mm off the part"
    )
    part: Name | None = Field(None, description="the part that the pad is set against, touching its skin")
    node: Count | None = Field(None, description="with `part`, in place of `point`: a node by its number")
    set: Annotated[str, Field(min_length=1)] | None = Field(
        None, description="or a set of nodes by its name in the part's mesh file: their middle"
    )
    hole: Vector | None = Field(None, description="or a point near the centre of a hole, over which the pad then lies")
    normal: Direction | None = Field(
        None,
        description="the pad's outward normal; with `part` also `normal`, the default, which is that of the sheet, or "
        "`-normal`: the pad lies on the side that it comes from",
    )
    radius: Positive | None = Field(None, description="the pad's radius, mm")
    stage: Name | None = Field(None, description="the locate stage in whose station it stands; if left out, the first")

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
                raise ValueError(f"{alone[0]} is one of a part's: add part, which the pad is set against")
            if not {"point", "normal", "radius"} <= set(given):
                raise ValueError('give either mesh = "file", or point, normal and radius of a flat pad')
            if isinstance(self.normal, str):
                raise ValueError(f"normal = {self.normal!r} is a part's: add part, or give normal = [x, y, z]")
            return self
        if len(places) != 1:
            raise ValueError(
                f"{' and '.join(places)} each say where the pad lies: give one of them"
                if places
                else "give point = [x, y, z], or node or set or hole, where the pad lies on its part"
            )
        if self.radius is None:
            raise ValueError("a pad needs radius, mm: add it")
        if self.normal is None:
            object.__setattr__(self, "normal", NORMAL)
        if isinstance(self.normal, str) and "in-plane" in self.normal:
            raise ValueError('a pad lies flat against its part: normal is "normal", "-normal" or [x, y, z]')
        return self


class Locator(OnPart):
    """A bilateral support of a part in one direction, over a pad of the given radius.

    It engages in the named stage: those of the locate stage place the part (a 3-2-1 scheme), further ones of an N-2-1
    scheme close when the clamps do and force the part. Those of a later locate stage, or of the measure stage, hold an
    assembly that is set down there: all that held it before opens.
    """

    name: Name = Field(description="names the locator in `keep` and in deviations")
    part: Name = Field(description="the part that it supports")
    direction: Direction = Field(NORMAL, description=f"of the support: {TOWARDS}")
    radius: NonNegative = Field(4.0, description="of the pad, mm; 0 is nodal")
    stage: Name = Field(
        "locate",
        description="the stage in which it engages; those of the locate stage must hold all six motions of their part",
    )
    stiffness: Positive | None = Field(
        None,
        description="N/mm: it yields under its load; left out, it is rigid. Soft ones carry a part that is to rest on "
        "another, until clamps press it there",
    )


class Clamp(OnPart):
    """A clamp pushes a part along `direction`, by a force or to a position.

    With `parts` it is a tong: one jaw pushes the first part towards the second, the other the second towards the first.
    Its jaws are called `NAME-PART`; `order`, `keep` and deviations may name it as a whole.
    """

    name: Name = Field(description="names the clamp in deviations")
    part: Owner = Field(UNPLACED, description="the part that it pushes")
    parts: tuple[Name, Name] | None = Field(None, description="or the two parts that it presses together, as a tong")
    direction: Direction = Field(
        NORMAL, description=f"into which it pushes, a tong its first part: {TOWARDS}; of a tong: together"
    )
    force: FiniteFloat | None = Field(None, description="N along `direction`")
    stroke: FiniteFloat | None = Field(
        None, description="or the position that it enforces along `direction`, mm from nominal"
    )
    limit: Positive | None = Field(
        None,
        description="with `stroke`: the most that it pushes with, N; where its position takes more, it stops short of "
        "it and pushes with its limit, the assembly counts as not built, and the force that it would need is told",
    )
    radius: NonNegative = Field(5.0, description="of the pad, mm; 0 is nodal")
    stage: Name = Field("clamp", description="the clamp stage that closes it; a release opens it")

    @model_validator(mode="after")
    def _force_or_stroke(self):
        if (self.force is None) == (self.stroke is None):
            raise ValueError("give either force (N) or stroke (mm from the nominal position), not both and not neither")
        if self.limit is not None and self.stroke is None:
            raise ValueError("limit goes with stroke; a clamp with a force pushes with just that: remove limit")
        return self

    @model_validator(mode="after")
    def _one_or_two(self):
        if (self.part is None) == (self.parts is None):
            raise ValueError("give either part, which it pushes, or parts = [a, b], which it presses together")
        if self.parts is not None and (isinstance(self.direction, str) and self.direction != "normal"):
            raise ValueError("a tong presses its parts together: leave direction out, or give [x, y, z] for parts[0]")
        if self.parts is not None and self.hole is not None:
            raise ValueError("a tong presses on sheets, and there is none in a hole: give point, node or set")
        return self

    @property
    def owners(self) -> tuple[Name, ...]:
        """The parts that it pushes."""
        return self.parts or (self.part,)
