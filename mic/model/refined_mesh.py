"""The mesh that a part is solved on: as it is drawn, its elements divided where they are large for what reads them.

A fused nugget ties what two sheets move over a disc, up to linear fields. On elements as large as the disc that is
nearly all that they can do, and whole elements are tied. Elements of half the radius mend that, for some sixty nodes a
weld; divided further, or farther out, they change little more.

Candidates for contact that stand much nearer to each other than the nodes do read the same few freedoms: their
compliance is all but singular, and friction among them takes a thousand times as long to solve. Where candidates are
denser than so, under clamps above all, elements become as dense.

Where contact is looked for, and where everything else stands, is found on the mesh as it is drawn: dividing leaves the
sheet where it was. What is spread over all of a sheet, its weight, is spread over the elements that are solved.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from mic.compliance.part import Part
from mic.geometry.refinement import divided
from mic.geometry.surface import Patch, Surface
from mic.scene import Scene

__all__ = ["resolved"]

NUGGET = 0.5  # of a nugget's radius: elements that it touches are no larger
CANDIDATES = 1.5  # distances between candidates: elements about these are no larger


def resolved(part: Part, scene: Scene, zone: np.ndarray, point: np.ndarray, apart: np.ndarray) -> Part:
    """The part, its elements divided at the nuggets of fused welds and under dense candidates; itself where they are
    small enough.

    A superelement has no elements of its own, and an averaged weld no limit that finer ones would come to.

    Parameters
    ----------
    part : Part
    scene : Scene
        Placed on its meshes.
    zone, point : (m,) int array, (m, 3) array
        Zone of each contact pair, and where it stands, mm.
    apart : (m,) array
        How far from its neighbours each was to stand, mm; NaN where a zone states its pairs.
    """
    if part.superelement is not None:
        return part
    welds = [weld for weld in scene.welds if part.name in weld.parts and weld.fused and weld.radius > 0]
    places = [np.reshape([weld.point for weld in welds], (-1, 3))]
    reach = [np.array([weld.radius for weld in welds])]
    size = [NUGGET * reach[0]]
    touching = np.array([part.name in one.parts for one in scene.zones], dtype=bool)
    own = np.isfinite(apart) & touching[zone]
    places.append(point[own])
    reach.append(apart[own] / 2)
    size.append(CANDIDATES * apart[own])
    wanted, surface = np.concatenate(size), part.surface
    if not len(wanted):
        return part
    place = surface.project(np.concatenate(places)).point
    found = divided(surface.points, surface.triangles, surface.corner_normals, place, np.concatenate(reach), wanted)
    if len(found.triangles) == len(surface.triangles):
        return part
    rows = part.functionals
    patches = tuple(Patch(*found.carried(one.triangle, one.barycentric), one.weight) for one in rows.patches)
    return replace(
        part,
        surface=(solved := Surface(found.points, found.triangles, found.normals)),
        functionals=replace(rows, patches=_spread(rows.patches, patches, surface, solved)),
    )


def _spread(
    before: tuple[Patch, ...], carried: tuple[Patch, ...], drawn: Surface, solved: Surface
) -> tuple[Patch, ...]:
    """The carried patches, but for those that read all of the drawn surface, as a weight does: these read all of the
    divided one, whose every element bears its share."""
    all_of = drawn.whole()
    same = [
        np.array_equal(one.triangle, all_of.triangle) and np.array_equal(one.weight, all_of.weight) for one in before
    ]
    return tuple(solved.whole() if everywhere else one for everywhere, one in zip(same, carried))
