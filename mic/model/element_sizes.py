"""Element sizes of parts that state an accuracy instead of a size.

The discretisation error falls with the square of the element size, and is estimated on each mesh
(:mod:`mic.model.mesh_accuracy`). Starting from the coarsest size that the geometry states, or a twentieth of the part's
extent, sizes shrink by

    h ← h · min(¾, 0.9 √(accuracy / 1.25 estimate))

until 1.25 times the largest estimate of the part is within its accuracy: the estimates of H and of each key
characteristic's influence, on the locators of the first stage and on all locators. The estimate may be a fifth too
small, hence the safety factor 1.25, as in the grid convergence index. Sizes are rounded down to two digits, so that
rounding errors do not change them.

At locators, clamps, welds, forces and measurements that act on a disc, elements are no larger than its radius:
otherwise a fixture holds a facet of the mesh rather than the sheet. On a part with soft regions that halves the error
for a few per cent more nodes; finer elements in contact zones and at free edges had no measurable effect.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from math import floor, log10, sqrt
from pathlib import Path
from typing import Any

import numpy as np

from mic.compliance.part import GENERATION
from mic.errors import Problems, SceneError
from mic.geometry.grading import GradedSize
from mic.geometry.load import coarsest_size, load_part
from mic.model.assembly_types import Assembly
from mic.model.mesh_accuracy import estimate_accuracy
from mic.scene import Scene
from mic.scene.deviation import ForceDeviation
from mic.system.disk_cache import ABSENT, Cache
from mic.system.files import Format, fingerprint

__all__ = ["chosen_sizes"]

FORMAT = Format("choice of element sizes", 3, ABSENT)
ROUNDS = 8
SAFETY = 1.25  # factor on the estimate
MARGIN = 0.9  # factor on the size that the estimate would allow
LEAST = 0.75  # largest factor between two successive sizes
LARGEST = 150_000  # nodes: finer meshes are not tried


def chosen_sizes(
    scene: Scene,
    cache: Path,
    assembled: Callable[[Mapping[str, float]], Assembly],
    check: Callable[[Assembly], object],
    progress: Callable[[str], None] | None = None,
) -> dict[str, GradedSize]:
    """Element size, mm, by name, of every part that states an accuracy.

    Parameters
    ----------
    scene : Scene
    cache : Path
        Cache folder of meshes, estimates and earlier choices.
    assembled : callable
        Assembles the scene on meshes of the given sizes.
    check : callable
        Called with the assembly on its first meshes, before anything is solved; raises errors that finer meshes do
        not remove.
    progress : callable, optional
        Called with one line of text before each solve.

    Raises
    ------
    SceneError
        If an accuracy cannot be reached, or a part cannot be meshed.
    MissingProvider
    """
    stated = {part.name: part.accuracy for part in scene.parts if part.accuracy is not None}
    if not stated:
        return {}
    sizes, inputs = _first_sizes(scene, cache, stated)
    identity = fingerprint(
        [GENERATION, scene.model_dump_json(exclude={"name", "description", "monte_carlo", "report"}), inputs]
    )
    disk_cache = Cache(cache, "meshes", FORMAT)
    cached = disk_cache.load(identity)
    if cached is not None:
        return {name: _graded(scene, name, size) for name, size in cached[0]["sizes"].items()}
    for number in range(ROUNDS):
        assembly = assembled(sizes)
        if number == 0:
            check(assembly)
        estimates = estimate_accuracy(assembly, cache, progress, stated)
        missed = [one for one in estimates if SAFETY * one.worst > stated[one.part]]
        if not missed:
            disk_cache.store(identity, {"sizes": sizes}, {"none": np.zeros(0)})
            return sizes
        finer = {}
        for one in missed:
            share = min(LEAST, MARGIN * sqrt(stated[one.part] / one.worst / SAFETY))
            finer[one.part] = _graded(scene, one.part, _rounded(sizes[one.part] * share))
        if any(one.mesh.nodes * (sizes[one.part] / finer[one.part]) ** 2 > LARGEST for one in missed):
            break
        sizes |= finer
    one, name = missed[0], missed[0].part
    raise SceneError(
        f"part {name!r}: accuracy: {stated[name]:g} is not reached: on the mesh of size {sizes[name]:g} mm "
        f"({one.mesh.nodes} nodes) the estimate is still {one.worst:.2g}, which may be a fifth too small; state a "
        "larger accuracy, or a size"
    )


def _first_sizes(scene: Scene, cache: Path, stated) -> tuple[dict[str, GradedSize], dict[str, str | None]]:
    """Sizes of the first meshes, and hashes of the files that they depend on.

    Raises
    ------
    SceneError
        With one line for each part that cannot be meshed or read.
    """
    sizes: dict[str, GradedSize] = {}
    inputs: dict[str, str | None] = {}
    problems = Problems()
    for part in scene.parts:
        if part.name in stated:
            with problems:
                size = coarsest_size(part, scene.folder) or _extent(scene, part.name) / 20
                sizes[part.name] = _graded(scene, part.name, size)
                inputs |= load_part(part, scene.folder, cache, sizes[part.name]).inputs
    for part in scene.parts if problems else ():  # report errors of the other parts together with these
        if part.name not in stated:
            with problems:
                load_part(part, scene.folder, cache)
    problems.raise_all()
    return sizes, inputs


def _graded(scene: Scene, part: str, size: float) -> GradedSize:
    """The size, limited to the radius of each disc that the scene has on a part."""
    forces = [item for item in scene.deviations if isinstance(item, ForceDeviation)]
    seconds = [item.to for item in scene.measurements if item.to is not None]
    aligned = [point for frame in scene.frames for point in frame.points or () if not isinstance(point, str)]
    tables = (scene.welds, scene.clamps, scene.locators, forces, scene.measurements, seconds, aligned)
    discs = [(point, radius) for point, radius in _discs(part, *tables) if radius > 0]
    return GradedSize(size, [point for point, _ in discs], [radius for _, radius in discs])


def _extent(scene: Scene, part: str) -> float:
    """Diagonal of the bounding box of the scene's points on a part, mm."""
    points = [point for point, _ in _discs(part, scene.locators, scene.measurements, scene.clamps)]
    return float(np.linalg.norm(np.ptp(np.array(points), axis=0)))


def _discs(part: str, *tables: Sequence[Any]) -> list[tuple[Any, float]]:
    """Approximate points and radii of the items on a part.

    A part meshed from its geometry may have holes, but no node numbers.
    """
    own = [item for table in tables for item in table if part in (getattr(item, "parts", None) or (item.part,))]
    places = [(item.point or getattr(item, "hole", None), item.radius) for item in own]
    return [(point, radius) for point, radius in places if point is not None]


def _rounded(size: float) -> float:
    """The size rounded down to two digits."""
    unit = 10.0 ** (floor(log10(size)) - 1)
    return round(floor(size / unit * (1 + 1e-9)) * unit, 12)
