"""A hat section over a plate, both 120 mm long; x along them, y across."""

from __future__ import annotations

from mic.geometry.structured import extrude

#: The (y, z) corners of each middle surface, where it begins along x and how long it is, mm.
SHEETS = {
    "plate": ([(-45.0, 0.0), (45.0, 0.0)], 0.0, 120.0),
    "hat": ([(-45.0, 1.45), (-28.0, 1.45), (-22.0, 26.45), (22.0, 26.45), (28.0, 1.45), (45.0, 1.45)], 0.0, 120.0),
}
PARTS = tuple(SHEETS)
SIZES = {"coarse": 4.0, "medium": 4.0 / 1.5, "fine": 4.0 / 2.25}  # mm


def build(part: str, size: float):
    """Points (n, 3), triangles (k, 3) and their corners' normals (k, 3, 3) of a part's middle surface, mm."""
    profile, start, length = SHEETS[part]
    return extrude(profile, start, length, size)
