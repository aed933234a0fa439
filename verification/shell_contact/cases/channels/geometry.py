"""A channel in a channel, both 120 mm long; x along them."""

from __future__ import annotations

from mic.geometry.structured import extrude

#: The (y, z) corners of each middle surface, where it begins along x and how long it is, mm.
SHEETS = {
    "outer": ([(-15.0, 20.0), (-15.0, 0.0), (15.0, 0.0), (15.0, 20.0)], 0.0, 120.0),
    "inner": ([(-13.85, 20.0), (-13.85, 1.15), (13.85, 1.15), (13.85, 20.0)], 0.0, 120.0),
}
PARTS = tuple(SHEETS)
SIZES = {"coarse": 5.0, "medium": 5.0 / 1.5, "fine": 5.0 / 2.25}  # mm


def build(part: str, size: float):
    """Points (n, 3), triangles (k, 3) and their corners' normals (k, 3, 3) of a part's middle surface, mm."""
    profile, start, length = SHEETS[part]
    return extrude(profile, start, length, size)
