"""A cover over a base, both 120 x 80 mm, 0.6 mm apart; z across them."""

from __future__ import annotations

from mic.geometry.structured import extrude

#: The (y, z) corners of each middle surface, where it begins along x and how long it is, mm.
SHEETS = {
    "base": ([(0.0, 0.0), (80.0, 0.0)], 0.0, 120.0),
    "cover": ([(0.0, 1.75), (80.0, 1.75)], 0.0, 120.0),
}
PARTS = tuple(SHEETS)
SIZES = {"coarse": 8.0, "medium": 8.0 / 1.5, "fine": 8.0 / 2.25}  # mm


def build(part: str, size: float):
    """Points (n, 3), triangles (k, 3) and their corners' normals (k, 3, 3) of a part's middle surface, mm."""
    profile, start, length = SHEETS[part]
    return extrude(profile, start, length, size)
