"""Sheets of the shipped scenes as quadrilateral meshes with matching nodes where the sheets touch."""

from __future__ import annotations

import numpy as np

from fem_reference.peers.calculix_sheets import Sheet, extruded, graded
from mic.scene import Scene

__all__ = ["hat_on_plate", "lap_joint"]

ABOUT = 1.6  # radius of the finely meshed area around a weld, in nugget radii
#: Distance of the first grid line from a fold, in thicknesses. Elements cut obliquely by a mitre hardly bend; with the
#: usual length they would stiffen the section.
FOLD = 0.6


def lap_joint(scene: Scene, fine: float, coarse: float) -> list[Sheet]:
    """Two strips of 100 by 25 mm; the upper one is shifted by 60 mm and lies 1 mm higher.

    Parameters
    ----------
    scene : Scene
    fine, coarse : float
        Largest element, mm, around the welds and elsewhere.
    """
    x = graded([0.0, 60.0, 100.0, 160.0], _about(scene, 0), fine, coarse)
    y = graded([0.0, 25.0], _about(scene, 1), fine, coarse)
    sheets = []
    for part, start, level in zip(scene.parts, (0.0, 60.0), (0.0, 1.0)):
        profile = np.column_stack([y, np.full_like(y, level)])
        own = x[(x >= start - 1e-9) & (x <= start + 100.0 + 1e-9)]
        sheets.append(Sheet(*extruded(profile, own), part.thickness, part.young, part.poisson))
    return sheets


def hat_on_plate(scene: Scene, fine: float, coarse: float) -> list[Sheet]:
    """A plate of 160 by 120 mm under a hat: flanges of 20 mm, webs 30 mm high and inclined by 5 mm, top of 40 mm.

    The lower face of a flange ends at the mitre of the fold; the plate has a grid line there too.

    Parameters
    ----------
    scene : Scene
    fine, coarse : float
        Largest element, mm, around the welds and elsewhere.
    """
    plate, hat = scene.parts
    x = graded([0.0, 160.0], _about(scene, 0), fine, coarse)
    beside = FOLD * hat.thickness
    flange = graded([25.0, 25.0 + beside, 45.0], [one for one in _about(scene, 1) if one[0] > 0], fine, coarse)
    web = np.array([-30.0, 5.0]) / np.hypot(30.0, 5.0)  # its direction downwards on the right, (z, y)
    fold = 25.0 + hat.thickness / 2 * web[0] / (1 + web[1])
    edge = graded([45.0, 60.0], [], fine, coarse)[1:]
    half = np.concatenate([graded([0.0, fold], [], fine, coarse), flange[1:], edge])
    flat = np.concatenate([-half[:0:-1], half])
    long = np.hypot(30.0, 5.0)
    down = graded([0.0, beside, long - beside, long], [], fine, coarse) / long
    top = graded([0.0, 20.0 - beside, 20.0], [], fine, coarse)
    right = np.vstack(
        [
            np.column_stack([top, np.full_like(top, 31.0)]),
            np.column_stack([20 + 5 * down, 31 - 30 * down])[1:],
            np.column_stack([flange, np.ones_like(flange)])[1:],
        ]
    )
    profile = np.vstack([right[:0:-1] * (-1, 1), right])
    return [
        Sheet(*extruded(each, x), part.thickness, part.young, part.poisson)
        for part, each in ((plate, np.column_stack([flat, np.zeros_like(flat)])), (hat, profile))
    ]


def _about(scene: Scene, axis: int) -> list[tuple[float, float]]:
    return [(weld.point[axis], ABOUT * weld.radius) for weld in scene.welds]
