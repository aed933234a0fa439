"""The side frame of a body: three rails and three pillars, each a channel closed by a hat; all lengths in mm.

x along the rails, y along the pillars, z outwards. The channels' webs lie back to back, those of the rails at z = 0 and
those of the pillars at z = -THICKNESS, and cross at nine joints. Lips and hats of the rails stand outwards, those of
the pillars inwards: a hat's flanges lie on its channel's web. Nominally all sheets touch.
"""

from __future__ import annotations

import numpy as np

from mic.geometry.structured import extrude

THICKNESS = 1.0  # mm, all parts
WEB = 100.0  # mm, of a channel
LIP = 20.0  # mm
HAT_TOP, HAT_HEIGHT, HAT_DRAFT, FLANGE = 30.0, 40.0, 5.0, 25.0  # mm
FOOT = HAT_TOP / 2 + HAT_DRAFT  # mm from the middle of a hat to the start of its flange
RAILS = {"rocker": 0.0, "waist": 450.0, "roof": 900.0}  # y of the middle
PILLARS = {"a": 60.0, "b": 750.0, "c": 1440.0}  # x of the middle
RAIL, PILLAR = (0.0, 1500.0), (-50.0, 950.0)  # mm, start and end

PARTS = tuple(f"{member}-{sheet}" for member in (*RAILS, *PILLARS) for sheet in ("channel", "hat"))
SIZES = {"coarse": 14.0, "medium": 8.0}  # mm
HAT_REFINEMENT = 1.15  # the hats' elements are smaller by this, so that the meshes do not match


def build(part: str, size: float):
    """Mesh one part's mid-surface.

    Parameters
    ----------
    part : str
        One of `PARTS`.
    size : float
        Largest edge, mm; ``SIZES`` holds named values.

    Returns
    -------
    points : ndarray, shape (n, 3)
        mm.
    triangles : ndarray of int, shape (k, 3)
        Normals of webs and flanges point outwards on rails, inwards on pillars.
    normals : ndarray, shape (k, 3, 3)
        Of the sheet at the corners of each triangle.
    """
    if part not in PARTS:
        raise ValueError(f"the body side has no part {part!r}; its parts are {', '.join(PARTS)}")
    member, sheet = part.split("-")
    (start, end) = RAIL if member in RAILS else PILLAR
    if sheet == "channel":
        half = [(WEB / 2, 0.0), (WEB / 2, LIP)]
        level = 0.0
    else:
        half = [(HAT_TOP / 2, HAT_HEIGHT), (FOOT, 0.0), (FOOT + FLANGE, 0.0)]
        level, size = THICKNESS, size / HAT_REFINEMENT
    profile = np.array([(-y, z) for y, z in reversed(half)] + half) + (0.0, level)
    points, triangles, normals = extrude(profile, start, end - start, size)
    if member in RAILS:
        return points + (0.0, RAILS[member], 0.0), triangles, normals
    turn = np.array([[0.0, 1.0, 0.0], [1.0, 0.0, 0.0], [0.0, 0.0, -1.0]])  # the rails' x to y, inwards
    return points @ turn.T + (PILLARS[member], 0.0, -THICKNESS), triangles, normals @ turn.T
