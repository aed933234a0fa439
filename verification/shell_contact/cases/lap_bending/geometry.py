"""Two strips of 90 x 25 mm that overlap over 30 mm; x along them."""

from __future__ import annotations

from mic.geometry.structured import extrude

#: The (y, z) corners of each middle surface, where it begins along x and how long it is, mm.
SHEETS = {
    "lower": ([(0.0, 0.0), (25.0, 0.0)], 0.0, 90.0),
    "upper": ([(0.0, 1.2), (25.0, 1.2)], 60.0, 90.0),
}
PARTS = tuple(SHEETS)
SIZES = {"coarse": 5.0, "medium": 5.0 / 1.5, "fine": 5.0 / 2.25}  # mm


def build(part: str, size: float):
    """Points (n, 3), triangles (k, 3) and their corners' normals (k, 3, 3) of a part's middle surface, mm."""
    profile, start, length = SHEETS[part]
    return extrude(profile, start, length, size)
