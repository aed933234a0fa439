"""The table of how a part is scanned."""

from __future__ import annotations

from typing import Annotated, Literal

from pydantic import AfterValidator, Field

from mic.scene.keys import LengthUnit, Name, Table, Vector, unit_vector

__all__ = ["Scan"]


class Scan(Table):
    """Scans of a part, for `mic predict --scan`; without a table the defaults hold."""

    part: Name
    """the part"""

    unit: LengthUnit = "mm"
    """unit of length of the files"""

    skin: Literal[-1, 0, 1] = 0
    """surface of the points: 1 skin on the side of the mesh's normals, -1 the other, 0 mid-surface"""

    align: Literal["datum", "best-fit"] = "datum"
    """frame of the reported motion and deviation: `datum`, the part's own locators; `best-fit`"""

    supports: Annotated[list[Vector], Field(min_length=3)] | None = None
    """points, mm, at which the part lies on supports while it is scanned, without friction; its sag is removed. Needs
    the part's `density`; default: the scan shows the free part"""

    gravity: Annotated[Vector, AfterValidator(unit_vector)] = (0.0, 0.0, -1.0)
    """direction of gravity on the supports, in the coordinates of the drawing"""
