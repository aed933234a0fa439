"""Two flat strips in a lap joint: x along the strips, z through the thickness; all lengths in mm.

The lower strip's mid-surface lies at z = 0 from x = 0, the upper strip's at z = THICKNESS; nominally the sheets touch.
Normals of both meshes point along +z, from the lower to the upper strip.
"""

from __future__ import annotations

from mic.geometry.structured import extrude

LENGTH, WIDTH = 100.0, 25.0  # mm, each strip
OVERLAP = 40.0  # mm
THICKNESS = 1.0  # mm, both strips

PARTS = ("lower", "upper")
SIZES = {"coarse": 5.0, "medium": 2.5, "fine": 1.25}  # mm
UPPER_COARSENING = 1.15  # the upper strip's elements are larger by this, so that the meshes do not match


def build(part: str, size: float):
    """Mesh one strip's mid-surface.

    Parameters
    ----------
    part : {"lower", "upper"}
    size : float
        Largest edge along and across the strip, mm; ``SIZES`` holds named values.

    Returns
    -------
    points : ndarray, shape (n, 3)
        mm.
    triangles : ndarray of int, shape (k, 3)
        Normals point along +z.
    """
    if part == "lower":
        return extrude([(0, 0), (WIDTH, 0)], 0.0, LENGTH, size)
    if part == "upper":
        return extrude([(0, THICKNESS), (WIDTH, THICKNESS)], LENGTH - OVERLAP, LENGTH, size * UPPER_COARSENING)
    raise ValueError(f"the lap joint has no part {part!r}; its parts are {', '.join(PARTS)}")
