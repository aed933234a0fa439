"""A hat section of 60 mm on two rigid planes at z = 0; x along it, y across."""

from __future__ import annotations

from mic.geometry.structured import extrude

#: The (y, z) corners of each middle surface, where it begins along x and how long it is, mm.
SHEETS = {
    "hat": ([(-45.0, 0.6), (-28.0, 0.6), (-22.0, 25.6), (22.0, 25.6), (28.0, 0.6), (45.0, 0.6)], 0.0, 60.0),
}
PARTS = tuple(SHEETS)
SIZES = {"coarse": 5.0, "medium": 5.0 / 1.5, "fine": 5.0 / 2.25}  # mm


def build(part: str, size: float):
    """Points (n, 3), triangles (k, 3) and their corners' normals (k, 3, 3) of a part's middle surface, mm."""
    profile, start, length = SHEETS[part]
    return extrude(profile, start, length, size)
