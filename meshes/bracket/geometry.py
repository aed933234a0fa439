"""A bracket of three sheets: x along it, y across, z up; all lengths in mm.

The foot of an angle is on a base, and a cap is on the foot; nominally the sheets touch. Their thicknesses differ; the
distance of two mid-surfaces is the mean of the two thicknesses. Normals of the base, the foot and the cap point along
+z, those of the upright along -y.
"""

from __future__ import annotations

from mic.geometry.structured import extrude

BASE, ANGLE, CAP = 1.5, 1.0, 1.2  # mm, thicknesses
BASE_LENGTH, BASE_WIDTH = 120.0, 60.0  # mm
ANGLE_BEGIN, ANGLE_LENGTH = 25.0, 70.0  # mm
FOOT, UPRIGHT, LEAN = 36.0, 24.0, 2.0  # mm: width of the foot, height of the upright, and outward lean
CAP_BEGIN, CAP_LENGTH, CAP_WIDTH = 40.0, 75.0, 22.0  # mm
FOOT_HEIGHT = (BASE + ANGLE) / 2
CAP_HEIGHT = FOOT_HEIGHT + (ANGLE + CAP) / 2

PARTS = ("base", "angle", "cap")
SIZES = {"coarse": 8.0, "medium": 4.0, "fine": 2.0}  # mm
FINER = {"base": 1.0, "angle": 1.1, "cap": 1.25}  # factors of smaller elements, so that the meshes do not match


def build(part: str, size: float):
    """Mesh one part's mid-surface.

    Parameters
    ----------
    part : {"base", "angle", "cap"}
    size : float
        Largest edge along x and across, mm; ``SIZES`` holds named values.

    Returns
    -------
    points : ndarray, shape (n, 3)
        mm.
    triangles : ndarray of int, shape (k, 3)
        Normals point along +z on the base, the foot and the cap.
    normals : ndarray, shape (k, 3, 3)
        Of the sheet at the corners of each triangle.
    """
    if part not in PARTS:
        raise ValueError(f"the bracket has no part {part!r}; its parts are {', '.join(PARTS)}")
    size = size / FINER[part]
    if part == "base":
        return extrude([(-BASE_WIDTH / 2, 0), (BASE_WIDTH / 2, 0)], 0.0, BASE_LENGTH, size)
    if part == "cap":
        return extrude([(-16, CAP_HEIGHT), (-16 + CAP_WIDTH, CAP_HEIGHT)], CAP_BEGIN, CAP_LENGTH, size)
    bend = (-20 + FOOT, FOOT_HEIGHT)
    return extrude([(-20, FOOT_HEIGHT), bend, (bend[0] + LEAN, bend[1] + UPRIGHT)], ANGLE_BEGIN, ANGLE_LENGTH, size)
