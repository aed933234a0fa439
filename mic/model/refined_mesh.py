"""Refines the mesh that a part is solved on: under nuggets and under dense contact candidates.

A fused nugget ties the motion of two sheets over a disc, up to linear fields. On elements as large as the disc these
are nearly all motions that the elements have, and whole elements are tied. Elements of half the radius remove that
error, for about sixty more nodes a weld; further refinement changes little.

Contact candidates that are much closer to each other than the nodes read the same few degrees of freedom: their
compliance is almost singular, and friction among them takes a thousand times as long to solve. So elements become as
dense as the candidates, mostly under clamps.

Contact pairs and all other positions are found on the mesh as drawn: refinement leaves the surface unchanged. Loads on
a whole sheet, such as its weight, are spread over the refined elements.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from mic.compliance.part import Part
from mic.geometry.refinement import divided
from mic.geometry.surface import Patch, Surface
from mic.scene import Scene

__all__ = ["refined_part"]

NUGGET = 0.5  # largest element at a nugget, relative to its radius
CANDIDATES = 1.5  # largest element at candidates, relative to their distance


def refined_part(part: Part, scene: Scene, zone: np.ndarray, point: np.ndarray, spacing: np.ndarray) -> Part:
    """The part with elements divided at the nuggets of fused welds and under dense candidates.

    It is the same object if its elements are small enough, or if it is a superelement. Averaged welds need no
    refinement: their result has no limit for fine elements.

    Parameters
    ----------
    part : Part
    scene : Scene
        With all items placed.
    zone, point : (m,) int array, (m, 3) array
        Zone and point, mm, of each contact pair.
    spacing : (m,) array
        Intended distance of each candidate from its neighbours, mm; NaN for pairs that a zone states.
    """
    if part.superelement is not None:
        return part
    welds = [weld for weld in scene.welds if part.name in weld.parts and weld.fused and weld.radius > 0]
    radius = np.array([weld.radius for weld in welds])
    of_part = np.isfinite(spacing) & np.array([part.name in one.parts for one in scene.zones], dtype=bool)[zone]
    places = np.concatenate([np.reshape([weld.point for weld in welds], (-1, 3)), point[of_part]])
    size = np.concatenate([NUGGET * radius, CANDIDATES * spacing[of_part]])
    if not len(size):
        return part
    drawn = part.surface
    reach = np.concatenate([radius, spacing[of_part] / 2])
    fine = divided(drawn.points, drawn.triangles, drawn.corner_normals, drawn.project(places).point, reach, size)
    if len(fine.triangles) == len(drawn.triangles):
        return part
    surface, whole = Surface(fine.points, fine.triangles, fine.normals), drawn.whole()

    def transferred(patch: Patch) -> Patch:
        if np.array_equal(patch.triangle, whole.triangle) and np.array_equal(patch.weight, whole.weight):
            return surface.whole()  # a load on the whole sheet
        return Patch(*fine.locate(patch.triangle, patch.barycentric), patch.weight)

    patches = tuple(transferred(patch) for patch in part.functionals.patches)
    return replace(part, surface=surface, functionals=replace(part.functionals, patches=patches))
