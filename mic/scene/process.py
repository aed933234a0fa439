"""The tables of the process: stages, and the accuracy of the friction path."""

from __future__ import annotations

from typing import Annotated, ClassVar, Literal

from pydantic import Field, model_validator

from mic.contact.path import Followed
from mic.scene.keys import Count, FiniteFloat, Flag, Name, Table

__all__ = ["COARSEST", "FINEST", "MOVING", "FollowedPath", "Stage"]

#: Kinds of stages that close or open items while contacts act: they have an order, and a path of friction.
MOVING = ("clamp", "weld", "release")
# Tolerances of a followed path: contact problems are solved to 1e-5.
FINEST, COARSEST = 1e-5, 0.1


class Stage(Table):
    """A stage of the process, in order. The first is ``locate``; ``measure`` can only be the last.

    ``locate`` places parts on the locators that name it: additional parts, or, if those locators hold parts that are
    placed already, the assembly in another station. ``clamp`` closes the clamps and further locators that name it,
    ``weld`` makes the welds that name it, ``release`` opens all clamps and every locator but `keep`, ``measure`` reads
    the measurements, on the locators that name it if there are any. `mic check` prints the steps of each stage.
    """

    kind: Literal["locate", "clamp", "weld", "release", "measure"]
    """what the stage does"""

    name: Name | None = None
    """name of the stage in `stage` keys; default: the kind"""

    keep: list[Name] | None = None
    """release only: locators and clamps that stay closed; default: all locators"""

    order: Annotated[list[list[Name]], Field(min_length=1)] | None = None
    """clamp, weld, release: groups of names that close or open one after the other. Default: further locators
    together, then each clamp (neighbours that press parts together as one); all welds together; a release in
    reverse order of closing"""

    sequence: Flag = False
    """weld only: one weld after the other, in the order of the file"""

    settle: Flag = True
    """locate only: separate overlapping parts before anything closes; `false`: while the first item closes"""

    path: Literal["followed", "increments", "one-step"] | None = None
    """how friction is followed while items close or open: `followed` (default), in steps of controlled error;
    `increments`, a number per step of the stage, shorter at both ends; `one-step`, all at once, overlaps included,
    as in the paper"""

    increments: Annotated[Count, Field(ge=1)] | None = None
    """number per step of the stage; it implies `path = "increments"`"""

    #: Kinds of stages to which a key applies; the others apply to all.
    applies: ClassVar[dict[str, tuple[str, ...]]] = {
        "keep": ("release",),
        "order": MOVING,
        "sequence": ("weld",),
        "settle": ("locate",),
    }

    @model_validator(mode="after")
    def _fill(self):
        for key, kinds in self.applies.items():
            if self.kind not in kinds and getattr(self, key) != type(self).model_fields[key].default:
                raise ValueError(
                    f"{key} applies to {', '.join(kinds)} stages only, this one is of kind {self.kind!r}: remove it"
                )
        if self.order is not None and self.sequence:
            raise ValueError("order and sequence both give the order of welds: remove one of them")
        if self.path == "one-step" and (self.order is not None or self.sequence):
            key = "sequence" if self.sequence else "order"
            raise ValueError(f'path = "one-step" and {key} exclude each other: remove one of them')
        if self.increments is not None and self.path not in (None, "increments"):
            raise ValueError(f"increments do not go with path = {self.path!r}: remove one of them")
        if self.increments is None and self.path == "increments":
            raise ValueError('path = "increments" needs increments, the number per step of the stage: add it')
        if self.name is None:
            object.__setattr__(self, "name", self.kind)
        return self


class FollowedPath(Table):
    """Accuracy of the friction path in stages without a `path` of their own.

    The tolerance is the error per step of the contacts' tangential positions, and of the slip of opening contacts,
    relative to their tangential motion in the stage's step so far, at least a fifth of the thickness of the thinnest
    part (root mean squares over the contacts). Contact forces may err by 64 times as much, relative to their own size.
    """

    tolerance: Annotated[FiniteFloat, Field(ge=FINEST, le=COARSEST)] = Followed.tolerance
    """relative; below the lower bound rounding errors dominate"""
