"""Element sizes of parts that state an accuracy in place of a size.

The error falls with the square of the element size, and is estimated on each mesh (:mod:`mic.model.mesh_accuracy`). From the
coarsest size that the geometry names, or a twentieth of the part's extent,

    h ← h · min(¾, 0.9 √(accuracy / 1.25 estimate))

until 1.25 times the largest estimate of the part keeps to its accuracy: those of H and of each key characteristic's
influence, on the locators of the first stage and on all. The estimate may fall short by a fifth, hence 1.25, which the
grid convergence index has too. Sizes are rounded down to two digits, so that they do not hang on rounding.

Where locators, clamps, welds, forces and measurements stand on the part by a disc, elements are no larger than its
radius: else a fixture holds a facet of the mesh rather than the sheet. On a part with soft regions that halves the
error for a few per cent of the nodes; finer elements in contact zones and at free edges gained nothing where it was
measured.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from math import floor, log10, sqrt
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from mic.compliance.part import GENERATION
from mic.errors import Problems, SceneError
from mic.geometry.grading import GradedSize
from mic.geometry.load import coarsest_size, load_part
from mic.model.mesh_accuracy import estimate_accuracy
from mic.scene import Scene
from mic.scene.deviation import ForceDeviation
from mic.system.disk_cache import ABSENT, Cache
from mic.system.files import Format, fingerprint

if TYPE_CHECKING:
    from mic.model.assembly import Assembly

__all__ = ["chosen_sizes"]

CHOSEN = Format("choice of element sizes", 3, ABSENT)
ROUNDS = 8
SAFETY = 1.25  # of the estimate
MARGIN = 0.9  # of the size that the estimate would allow
LEAST = 0.75  # a size never shrinks by less
LARGEST = 150_000  # nodes, beyond which a mesh of half the size would not be solved by the way


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
        Folder of meshes, estimates and of choices that were made before.
    assembled : callable
        Puts the scene on meshes of the given sizes.
    check : callable
        Called with the assembly on its first meshes, before anything is solved; raises what finer ones do not mend.
    progress : callable, optional
        Called with one line of text before each solve.

    Raises
    ------
    SceneError
        If an accuracy cannot be reached, or a part cannot be meshed.
    MissingProvider
    """
    asked = {part.name: part.accuracy for part in scene.parts if part.accuracy is not None}
    if not asked:
        return {}
    sizes: dict[str, GradedSize] = {}
    inputs: dict[str, str | None] = {}
    problems = Problems()
    for part in scene.parts:
        if part.name in asked:
            with problems:
                size = coarsest_size(part, scene.folder) or _extent(scene, part.name) / 20
                sizes[part.name] = _graded(scene, part.name, size)
                inputs |= load_part(part, scene.folder, cache, sizes[part.name]).inputs
    for part in scene.parts if problems else ():  # what is wrong with the others is told with it
        if part.name not in asked:
            with problems:
                load_part(part, scene.folder, cache)
    problems.tell()
    identity = fingerprint(
        [GENERATION, scene.model_dump_json(exclude={"name", "description", "monte_carlo", "report"}), inputs]
    )
    kept = Cache(cache, "meshes", CHOSEN)
    found = kept.find(identity)
    if found is not None:
        return {name: _graded(scene, name, size) for name, size in found[0]["sizes"].items()}
    for number in range(ROUNDS):
        assembly = assembled(sizes)
        if number == 0:
            check(assembly)
        missed = {}
        for one in estimate_accuracy(assembly, cache, progress, asked):
            if SAFETY * one.worst > asked[one.part]:
                missed[one.part] = one
        if not missed:
            kept.keep(identity, {"sizes": sizes}, {"none": np.zeros(0)})
            return sizes
        finer = {
            name: _graded(
                scene, name, _rounded(sizes[name] * min(LEAST, MARGIN * sqrt(asked[name] / one.worst / SAFETY)))
            )
            for name, one in missed.items()
        }
        if any(one.mesh.nodes * (sizes[name] / finer[name]) ** 2 > LARGEST for name, one in missed.items()):
            break
        sizes |= finer
    name, one = next(iter(missed.items()))
    raise SceneError(
        f"part {name!r}: accuracy: {asked[name]:g} is not reached: on the mesh of size {sizes[name]:g} mm "
        f"({one.mesh.nodes} nodes) the estimate is still {one.worst:.2g}, which may fall short by a fifth; ask for "
        "less, or give a size"
    )


def _graded(scene: Scene, part: str, size: float) -> GradedSize:
    """The size, no larger than a disc's radius where the scene has discs on a part."""
    forces = [item for item in scene.deviations if isinstance(item, ForceDeviation)]
    items: list[Any] = [item for item in scene.welds if part in item.parts]
    items += [item for item in scene.clamps if part in item.owners]
    measured: list[Any] = [*scene.measurements, *(item.to for item in scene.measurements if item.to is not None)]
    items += [item for table in (scene.locators, forces, measured) for item in table if item.part == part]
    discs = [(_near(item), item.radius) for item in items if _near(item) is not None]
    places, radii = zip(*[(point, radius) for point, radius in discs if radius > 0] or [((0.0, 0.0, 0.0), size)])
    return GradedSize(size, places, radii)


def _extent(scene: Scene, part: str) -> float:
    """Diagonal of the box about the scene's points on a part, mm."""
    items: list[Any] = [item for table in (scene.locators, scene.measurements) for item in table if item.part == part]
    items += [item for item in scene.clamps if part in item.owners]
    points = np.array([_near(item) for item in items if _near(item) is not None])
    return float(np.linalg.norm(np.ptp(points, axis=0)))


def _near(item: Any) -> Any:
    """Where an item stands, about: a part that is meshed by its geometry has holes, but no node numbers."""
    return item.point or getattr(item, "hole", None)


def _rounded(size: float) -> float:
    """The size rounded down to two digits."""
    unit = 10.0 ** (floor(log10(size)) - 1)
    return round(floor(size / unit * (1 + 1e-9)) * unit, 12)
