"""The tables of the process: stages, and how closely their path is followed."""

from __future__ import annotations

from typing import Annotated, ClassVar, Literal

from pydantic import Field, model_validator

from mic.contact.path import Followed
from mic.scene.keys import Count, FiniteFloat, Flag, Name, Table

__all__ = [
    "COARSEST",
    "FINEST",
    "FollowedPath",
    "Stage",
]

# Tolerances of a followed path: the contact problems inside it are solved to 1e-5, and a tenth is no path any more.
FINEST, COARSEST = 1e-5, 0.1


class Stage(Table):
    """One stage of the process; in order. The first is ``locate``, ``measure`` may only come last.

    ``locate`` sets the parts down on the locators that name it: further parts beside the others; or, where the others
    have locators in it too, in another station, all that held them open; ``clamp`` closes the clamps and further
    locators that
    name it; ``weld`` makes the welds that name it; ``release`` opens all clamps and every locator but `keep`;
    ``measure`` reads the measurements, of the assembly as it is held, or where locators name the stage, set down on
    these alone. What each of them does is a list of steps, one after the other, in each of which
    actions happen together (`mic.process.actions`); `mic check` prints them.
    """

    kind: Literal["locate", "clamp", "weld", "release", "measure"] = Field(description="what the stage does")
    name: Name | None = Field(None, description="what `stage` keys refer to; the kind if left out")
    keep: list[Name] | None = Field(
        None, description="release only: the locators and clamps that stay closed; if left out, all locators"
    )
    order: Annotated[list[list[Name]], Field(min_length=1)] | None = Field(
        None,
        description="clamp, weld, release: what closes, or opens, one after the other: groups of names, each group "
        "together. Left out, further locators close first and together, then clamps as the file has them, neighbours "
        "that press two parts together as one; welds are made together; a release opens last what closed first",
    )
    sequence: Flag = Field(False, description="weld only: one weld after the other, in the order of the file")
    settle: Flag = Field(
        True,
        description="locate only: parts that overlap where they were set down come to rest on each other before "
        "anything closes; `false`: while the first thing closes",
    )
    path: Literal["followed", "increments", "one-step"] | None = Field(
        None,
        description="how friction's path is followed where something closes or opens: `followed`, the default, by "
        "steps of controlled error; `increments`, so many for each step of the stage, short at both its ends; "
        "`one-step`, all that the stage does at once, overlaps included, as the paper has it",
    )
    increments: Annotated[Count, Field(ge=1)] | None = Field(
        None, description='of each step of the stage; means path = "increments"'
    )

    #: Kinds of stages to which a key applies.
    applies: ClassVar[dict[str, tuple[str, ...]]] = {
        "keep": ("release",),
        "order": ("clamp", "weld", "release"),
        "sequence": ("weld",),
        "settle": ("locate",),
        "path": ("locate", "clamp", "weld", "release", "measure"),
        "increments": ("locate", "clamp", "weld", "release", "measure"),
    }

    @model_validator(mode="after")
    def _fill(self):
        for key, kinds in self.applies.items():
            if self.kind not in kinds and getattr(self, key) != type(self).model_fields[key].default:
                raise ValueError(
                    f"{key} applies to {', '.join(kinds)} stages only, this one is of kind {self.kind!r}: remove it"
                )
        if self.order is not None and self.sequence:
            raise ValueError("order and sequence both say in which order welds are made: remove one of them")
        if self.path == "one-step" and (self.order is not None or self.sequence):
            key = "sequence" if self.sequence else "order"
            raise ValueError(f'path = "one-step" does all at once, {key} one after the other: remove one of them')
        if self.increments is not None and self.path not in (None, "increments"):
            raise ValueError(f"increments do not go with path = {self.path!r}: remove one of them")
        if self.increments is None and self.path == "increments":
            raise ValueError('path = "increments" needs increments, how many for each step of the stage: give it')
        if self.name is None:
            object.__setattr__(self, "name", self.kind)
        return self


class FollowedPath(Table):
    """How closely friction's path is followed, in stages that ask for nothing else.

    The tolerance is that of one step: the error that it may leave in the contacts' tangential positions, and in the
    slip of those that open, as a share of the motion that the step of the process asks of the contacts (root mean
    squares over the contacts).
    """

    tolerance: Annotated[FiniteFloat, Field(ge=FINEST, le=COARSEST)] = Field(
        Followed.tolerance, description="relative; below its least value steps would be judged by rounding"
    )
