"""Three leaves of 100 x 20 mm, one upon the other; x along them."""

from __future__ import annotations

from mic.geometry.structured import extrude

#: The (y, z) corners of each middle surface, where it begins along x and how long it is, mm.
SHEETS = {
    "lower": ([(0.0, 0.0), (20.0, 0.0)], 0.0, 100.0),
    "middle": ([(0.0, 1.3), (20.0, 1.3)], 0.0, 100.0),
    "upper": ([(0.0, 2.5), (20.0, 2.5)], 0.0, 100.0),
}
PARTS = tuple(SHEETS)
SIZES = {"coarse": 5.0, "medium": 5.0 / 1.5, "fine": 5.0 / 2.25}  # mm


def build(part: str, size: float):
    """Points (n, 3), triangles (k, 3) and their corners' normals (k, 3, 3) of a part's middle surface, mm."""
    profile, start, length = SHEETS[part]
    return extrude(profile, start, length, size)
