"""Two panels along an arch about the y axis: each a flange across y and a wall along it, without a bend between."""

from __future__ import annotations

import numpy as np

ARCH = np.radians(60.0)  # to either side of the top
#: Corners (r, y) of the section, mm, from the flange's edge to the wall's.
SECTIONS = {"inner": [(100.0, 0.0), (80.0, 0.0), (80.0, -30.0)], "outer": [(80.0, 1.2), (100.0, 1.2), (100.0, 31.2)]}
PARTS = tuple(SECTIONS)
SIZES = {"coarse": 5.0, "medium": 5.0 / 1.5, "fine": 5.0 / 2.25}  # mm


def build(part: str, size: float):
    """Points (n, 3), triangles (k, 3) and their corners' normals (k, 3, 3) of the middle surface, mm.

    The flange's normals point along +y.
    """
    section, legs = np.array(SECTIONS[part]), []
    for a, b in zip(section, section[1:]):
        count = int(np.ceil(np.linalg.norm(b - a) / size - 1e-9))
        legs.append(a + (b - a) * np.arange(count + 1)[:, None] / count)
    r, y = np.concatenate([legs[0], legs[1][1:]]).T
    around = int(np.ceil(2 * ARCH * 90.0 / size - 1e-9))
    angle = np.linspace(-ARCH, ARCH, around + 1)
    radial = np.column_stack([np.sin(angle), 0 * angle, np.cos(angle)])
    points = (radial[:, None] * r[:, None] + np.outer(y, [0, 1, 0])).reshape(-1, 3)
    i, j = (grid.ravel() for grid in np.meshgrid(np.arange(around), np.arange(len(r) - 1), indexing="ij"))
    a = i * len(r) + j
    b, c, d = a + len(r), a + len(r) + 1, a + 1
    even = ((i + j) % 2 == 0)[:, None]
    first = np.where(even, np.column_stack([a, b, c]), np.column_stack([a, b, d]))
    second = np.where(even, np.column_stack([a, c, d]), np.column_stack([b, c, d]))
    flange = np.tile(j < len(legs[0]) - 1, 2)[:, None, None]
    triangles = np.concatenate([first, second])
    if part == "inner":  # its flange runs inwards, the outer one's outwards
        triangles = triangles[:, ::-1]
    side = 1.0 if part == "inner" else -1.0  # of the wall's normal, along the radius
    radially = np.repeat(radial, len(r), axis=0)[triangles]
    return points, triangles, np.where(flange, np.array([0.0, 1.0, 0.0]), side * radially)
