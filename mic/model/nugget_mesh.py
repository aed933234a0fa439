"""The mesh that a part is solved on: as it is drawn, its elements divided where they are large for a weld's nugget.

A fused nugget ties what two sheets move over a disc, up to linear fields. On elements as large as the disc that is
nearly all that they can do, and whole elements are tied. Elements of half the radius mend that, for some sixty nodes a
weld; divided further, or farther out, they change little more.

Where contact is looked for, and where everything else stands, is found on the mesh as it is drawn: dividing leaves the
sheet where it was.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from mic.compliance.part import Part
from mic.geometry.refinement import divided
from mic.geometry.surface import Patch, Surface
from mic.scene import Scene

__all__ = ["resolved"]

SIZE = 0.5  # of a nugget's radius: elements that it touches are no larger


def resolved(part: Part, scene: Scene) -> Part:
    """The part, its elements divided at the nuggets of fused welds; itself where they are small enough.

    A superelement has no elements of its own, and an averaged weld no limit that finer ones would come to.

    Parameters
    ----------
    part : Part
    scene : Scene
        Placed on its meshes.
    """
    welds = [weld for weld in scene.welds if part.name in weld.parts and weld.fused and weld.radius > 0]
    if not welds or part.superelement is not None:
        return part
    surface, radius = part.surface, np.array([weld.radius for weld in welds])
    place = surface.project(np.array([weld.point for weld in welds])).point
    found = divided(surface.points, surface.triangles, surface.corner_normals, place, radius, SIZE * radius)
    if len(found.triangles) == len(surface.triangles):
        return part
    rows = part.functionals
    patches = tuple(Patch(*found.carried(one.triangle, one.barycentric), one.weight) for one in rows.patches)
    return replace(
        part,
        surface=Surface(found.points, found.triangles, found.normals),
        functionals=replace(rows, patches=patches),
    )
