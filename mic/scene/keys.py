"""What keys of a scene take: numbers, names, directions, places; and the tables of what stands on a part.

Lengths are mm, forces N, stiffness MPa; keys that hold degrees end in ``_deg``. Unknown keys are errors. The
descriptions here and in the tables beside are the scene reference: the documentation is generated from them.
"""

from __future__ import annotations

import re
from typing import Annotated, Any

import numpy as np
from pydantic import BaseModel, ConfigDict, Field, WrapValidator, model_validator

__all__ = [
    "Count",
    "Direction",
    "FiniteFloat",
    "Flag",
    "NORMAL",
    "Name",
    "NonNegative",
    "OnPart",
    "OnSheet",
    "Owner",
    "Place",
    "Positive",
    "TOWARDS",
    "Table",
    "UNPLACED",
    "Vector",
    "WORDS",
    "stands_once",
    "unit_vector",
]


class Table(BaseModel):
    model_config = ConfigDict(extra="forbid", frozen=True, str_strip_whitespace=True)


# A number is a number: neither true, which Python takes for 1, nor the text of one.
FiniteFloat = Annotated[float, Field(strict=True, allow_inf_nan=False)]
Count = Annotated[int, Field(strict=True)]
Flag = Annotated[bool, Field(strict=True)]
Name = Annotated[str, Field(min_length=1, max_length=60, pattern=r"^[A-Za-z0-9_.+-]+$")]
Vector = tuple[FiniteFloat, FiniteFloat, FiniteFloat]
Positive = Annotated[FiniteFloat, Field(gt=0)]
NonNegative = Annotated[FiniteFloat, Field(ge=0)]


def unit_vector(value: Vector | None) -> Vector | None:
    if value is None:
        return None
    length = float(np.linalg.norm(value))
    if length < 1e-9:
        raise ValueError("a direction must not be zero: give a vector of any length, such as [0, 0, 1]")
    if abs(length - 1) < 1e-14:  # so that a scene read back from a model is the scene that was written
        return value
    x, y, z = value
    return x / length, y / length, z / length


#: The directions that a surface gives, in words; `mic.model.placement` says which vector each is.
WORDS = re.compile(r"-?(normal|in-plane [xyz])")


def _if_given(value: Any, handler: Any) -> Any:
    return None if value is None else handler(value)


def _vector_or_words(value: Any, handler: Any) -> Any:
    if not isinstance(value, str):
        return unit_vector(handler(value))
    words = " ".join(value.split())
    if not WORDS.fullmatch(words):
        raise ValueError(
            f'{value!r} is no direction; give [x, y, z], or "normal", "-normal", "in-plane x", "-in-plane x", … y, … z'
        )
    return words


#: A point, a part, a direction: typed as what they are once `mic.model.placement` has placed the scene on its meshes,
#: which everything comes after that reads them. In a scene as it is written a point or a part may be None, and a
#: direction words.
Place = Annotated[Vector, WrapValidator(_if_given)]
Owner = Annotated[Name, WrapValidator(_if_given)]
Direction = Annotated[Vector, WrapValidator(_vector_or_words)]
UNPLACED: Any = None
NORMAL: Any = "normal"
TOWARDS = "`[x, y, z]`; or `normal` or `in-plane x`, y, z (the axis laid into the sheet), with a minus the other way"


def stands_once(item: Any) -> Any:
    """The item, if one key says where it stands; raises ValueError for none and for two."""
    keys = [key for key in ("point", "node", "set", "hole") if key in type(item).model_fields]
    given = [key for key in keys if getattr(item, key) is not None]
    if not given:
        raise ValueError(f"give point = [x, y, z], or {' or '.join(keys[1:])}, where it stands")
    placed = given == ["point", "hole"] and item.point == item.hole  # which rows find the rim by
    if len(given) > 1 and not placed:
        raise ValueError(f"{' and '.join(given)} each say where it stands: give one of them")
    return item


class OnSheet(Table):
    """What stands on a part, at a point that its coordinates, a node or a set of nodes tell."""

    name: Name = Field(description="names it")
    point: Place = Field(UNPLACED, description="where, mm, at most 5 mm off the part")
    node: Count | None = Field(None, description="or a node by its number in the part's mesh file")
    set: Annotated[str, Field(min_length=1)] | None = Field(
        None, description="or a set of nodes by its name in the part's mesh file: their middle"
    )

    @model_validator(mode="after")
    def _one_place(self):
        return stands_once(self)


class OnPart(OnSheet):
    """What stands on a part, or in a hole of it."""

    hole: Vector | None = Field(
        None, description="or a point near the centre of a hole: its rim is read, as a pin does, at its own centre"
    )
