"""Types of the keys of a scene: numbers, names, directions, points; and base tables of items on a part.

Lengths are mm, forces N, stiffness MPa; keys that hold degrees end in ``_deg``. Unknown keys are errors. The
descriptions of keys are the source of the scene reference.
"""

from __future__ import annotations

import re
import unicodedata
from collections.abc import Iterable
from typing import Annotated, Any, Literal

import numpy as np
from pydantic import AfterValidator, BaseModel, ConfigDict, Field, WrapValidator, model_validator

from mic.system.arguments import LARGEST

__all__ = [
    "Count",
    "Direction",
    "FileName",
    "FilePath",
    "FiniteFloat",
    "Flag",
    "LengthUnit",
    "NORMAL",
    "Name",
    "NonNegative",
    "OnPart",
    "OnSheet",
    "Owner",
    "Place",
    "Positive",
    "Table",
    "UNPLACED",
    "Vector",
    "RELATIVE_DIRECTION",
    "check_single_place",
    "unit_vector",
]


class Table(BaseModel):
    model_config = ConfigDict(extra="forbid", frozen=True, str_strip_whitespace=True)

    def __repr_args__(self) -> Iterable[tuple[str | None, Any]]:
        """The keys that are not at their defaults."""
        fields = type(self).model_fields
        return ((name, value) for name, value in super().__repr_args__() if value != fields[str(name)].default)


LONGEST_NAME = 255  # bytes of the name of a file
SMALLEST = 1e-15  # number of a scene, in any unit; squares of smaller ones vanish


def _bounded(value: float) -> float:
    if abs(value) > LARGEST:
        raise ValueError(f"{value:g} is larger than any quantity of an assembly: correct it")
    return value


def _not_tiny(value: float) -> float:
    if 0 < value < SMALLEST:
        raise ValueError(f"{value:g} is smaller than any quantity of an assembly: correct it")
    return value


def _countable(value: int) -> int:
    if abs(value) >= 2**63:
        raise ValueError("it has more than 64 bits: correct it")
    return value


# Strict: neither `true` nor a text counts as a number.
FiniteFloat = Annotated[float, Field(strict=True, allow_inf_nan=False), AfterValidator(_bounded)]
Count = Annotated[int, Field(strict=True), AfterValidator(_countable)]
Flag = Annotated[bool, Field(strict=True)]
LengthUnit = Literal["mm", "cm", "m", "um", "in", "ft"]
Name = Annotated[str, Field(min_length=1, max_length=60, pattern=r"^[A-Za-z0-9_.+-]+$")]


class FilePath(str):
    """The name of a file, relative to the scene's folder."""


def _file_name(name: str) -> FilePath:
    if any(unicodedata.category(letter) in ("Cc", "Cs") for letter in name):
        raise ValueError("a file name has no control characters; correct it")
    if max(len(part.encode()) for part in name.split("/")) > LONGEST_NAME:
        raise ValueError(f"a file name has at most {LONGEST_NAME} letters; correct it")
    return FilePath(name)


FileName = Annotated[str, Field(min_length=1), AfterValidator(_file_name)]
Vector = tuple[FiniteFloat, FiniteFloat, FiniteFloat]
Positive = Annotated[FiniteFloat, Field(gt=0), AfterValidator(_not_tiny)]
NonNegative = Annotated[FiniteFloat, Field(ge=0), AfterValidator(_not_tiny)]


def unit_vector(value: Vector | None) -> Vector | None:
    if value is None:
        return None
    length = float(np.linalg.norm(value))
    if length < 1e-9:
        raise ValueError("a direction must not be zero: give a vector of any length, such as [0, 0, 1]")
    if abs(length - 1) < 1e-14:  # keeps a normalised vector unchanged when a scene is read again
        return value
    x, y, z = value
    return x / length, y / length, z / length


#: Directions relative to the sheet; `mic.model.placement` computes their vectors.
RELATIVE_DIRECTION = re.compile(r"-?(normal|in-plane [xyz])")


def _if_given(value: Any, handler: Any) -> Any:
    return None if value is None else handler(value)


def _direction(value: Any, handler: Any) -> Any:
    if not isinstance(value, str):
        return unit_vector(handler(value))
    text = " ".join(value.split())
    if not RELATIVE_DIRECTION.fullmatch(text):
        raise ValueError(
            f'{value!r} is no direction; give [x, y, z], or "normal", "-normal", "in-plane x", "-in-plane x", … y, … z'
        )
    return text


#: A point, a part, a direction, with their types after `mic.model.placement` has placed the scene on its meshes. Before
#: that a point or a part may be None, and a direction a text.
Place = Annotated[Vector, WrapValidator(_if_given)]
Owner = Annotated[Name, WrapValidator(_if_given)]
Direction = Annotated[Vector, WrapValidator(_direction)]
UNPLACED: Any = None
NORMAL: Any = "normal"


def check_single_place(item: Any) -> Any:
    """The item, if exactly one of its keys gives its place; else raises ValueError."""
    keys = [key for key in ("point", "node", "set", "hole") if key in type(item).model_fields]
    given = [key for key in keys if getattr(item, key) is not None]
    if not given:
        raise ValueError(f"its place is missing: give point = [x, y, z], or {' or '.join(keys[1:])}")
    placed = given == ["point", "hole"] and item.point == item.hole  # a hole that is placed already
    if len(given) > 1 and not placed:
        raise ValueError(f"{' and '.join(given)} both give its place: remove all but one")
    return item


class OnSheet(Table):
    """An item on a part, at a point, at a node or at the centre of a node set."""

    name: Name
    """name of the item"""

    point: Place = UNPLACED
    """a point, mm, at most 5 mm from the part"""

    node: Count | None = None
    """or the number of a node in the part's mesh file"""

    set: Annotated[str, Field(min_length=1)] | None = None
    """or the name of a node set in the part's mesh file: its centre"""

    @model_validator(mode="after")
    def _one_place(self):
        return check_single_place(self)


class OnPart(OnSheet):
    """An item on a part, or in a hole of it."""

    hole: Vector | None = None
    """or a point near the centre of a hole: the item is at its centre and reads its rim, as a pin"""
