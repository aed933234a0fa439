"""A hat section on a plate: x along the hat, y across, z up; all lengths in mm.

The plate's mid-surface lies at z = 0, those of the hat's two flanges at z = THICKNESS; nominally the sheets touch. Both
parts are centred on y = 0 and extend from x = 0 to x = LENGTH. Normals of the plate, and of the hat's flanges and top,
point along +z, on the flanges from the plate to the hat.
"""

from __future__ import annotations

import numpy as np

from mic.geometry.structured import extrude

LENGTH = 160.0  # mm, both parts
PLATE_WIDTH = 120.0  # mm
FLANGE_WIDTH = 20.0  # mm, each
WEB_HEIGHT = 30.0  # mm
WEB_DRAFT = 5.0  # mm, inward lean of a web
TOP_WIDTH = 40.0  # mm
THICKNESS = 1.0  # mm, both parts

PARTS = ("plate", "hat")
SIZES = {"coarse": 8.0, "medium": 2.5, "fine": 1.25}  # mm; nuggets have a radius of 2.5
HAT_REFINEMENT = 1.15  # the hat's elements are smaller by this, so that the meshes do not match


def build(part: str, size: float):
    """Mesh one part's mid-surface.

    Parameters
    ----------
    part : {"plate", "hat"}
    size : float
        Largest edge along x and across, mm; ``SIZES`` holds named values.

    Returns
    -------
    points : ndarray, shape (n, 3)
        mm.
    triangles : ndarray of int, shape (k, 3)
        Normals point along +z on the plate and on the hat's flanges and top.
    normals : ndarray, shape (k, 3, 3)
        Of the sheet at the corners of each triangle.
    """
    if part == "plate":
        return extrude([(-PLATE_WIDTH / 2, 0), (PLATE_WIDTH / 2, 0)], 0.0, LENGTH, size)
    if part == "hat":
        half = TOP_WIDTH / 2
        right = [(half, WEB_HEIGHT), (half + WEB_DRAFT, 0), (half + WEB_DRAFT + FLANGE_WIDTH, 0)]
        profile = np.array([(-y, z) for y, z in reversed(right)] + right) + (0, THICKNESS)
        return extrude(profile, 0.0, LENGTH, size / HAT_REFINEMENT)
    raise ValueError(f"the hat on a plate has no part {part!r}; its parts are {', '.join(PARTS)}")
