"""Two sheets that are drawn onto each other: which of them lies on which side.

A mesh that a preprocessor leaves often lies on the skin where the parts touch, so that the drawn surfaces coincide.
Which sheet is the upper one is then decided by nothing but rounding. Where the sheets part again tells it: they do not
pass through each other, so each lies on the side that the rest of it lies on.
"""

from __future__ import annotations

import numpy as np

from mic.geometry.pairing import ContactPair, Side

__all__ = ["TOLD", "offsets", "untold"]

TOLD = 0.25  # of the distance between two touching mid-surfaces: nearer ones do not tell who lies where
REACH = 20.0  # thicknesses: what parts farther from the other sheet tells nothing of how they touch
SURE = 0.8  # of what parts lies on one side


def untold(pairs: list[ContactPair], first: Side, second: Side) -> list[ContactPair]:
    """Pairs whose mid-surfaces lie so near to each other that they do not tell which sheet is on which side."""
    apart = first.half_thickness + second.half_thickness
    return [pair for pair in pairs if pair.gap + apart < TOLD * apart]


def offsets(pair: ContactPair, first: Side, second: Side) -> tuple[tuple[float, float], bool]:
    """Offsets, in thicknesses, that set the two sheets of a pair side by side, and whether the shapes tell which.

    Where they do not, both of the opposite signs are as good.
    """
    normals = [
        patch.weight @ body.surface.normals[patch.triangle] for body, patch in zip((first, second), pair.patches)
    ]
    alike = 1.0 if normals[0] @ normals[1] > 0 else -1.0
    # on which side of the first, along its normals, the second lies: as the one tells, and as the other
    there, back = _leaves(first, second), -alike * _leaves(second, first)
    told = there + back
    sure = abs(told) > SURE * (abs(there) + abs(back)) and there * back >= 0
    side = 1.0 if told >= 0 else -1.0
    return (-0.5 * side, 0.5 * side * alike), bool(sure and told)


def _leaves(body: Side, other: Side) -> float:
    """Area of the other sheet that lies over this one, off it, on the side of its normals less that on the other side;
    0 where they do not agree."""
    surface, apart = body.surface, body.half_thickness + other.half_thickness
    middle = other.surface.corners.mean(axis=1)
    foot = surface.project(middle, reach=REACH * apart)
    found = np.flatnonzero((foot.triangle >= 0) & ~foot.at_border & (foot.distance > TOLD * apart))
    step = middle[found] - foot.point[found]
    along = np.einsum("ij,ij->i", step, surface.normals[foot.triangle[found]])
    # over a face of it, and not beside a fold
    over = np.abs(along) > 0.9 * foot.distance[found]
    area = np.bincount((along[over] > 0).astype(int), other.surface.areas[found[over]], 2)
    return float(area[1] - area[0]) if area.max() > SURE * area.sum() else 0.0
