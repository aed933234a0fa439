"""A full contact solve that processes share: ``python -m support.shared SCENE FOLDER RESULT``.

Below FOLDER each process has its own cache.
"""

import sys
from pathlib import Path

import numpy as np
from mpi4py import MPI

import mic
from fem_reference.full.model import FullModel
from mic.model.assembly import assemble
from mic.statistics.draw import draw
from verification.scenes import with_stated_pairs


def solved(file, folder: Path) -> list[np.ndarray]:
    """Measurements, fields and contact results of one sample; the same in every process."""
    scene = with_stated_pairs(mic.load_scene(file))
    steps = {"path": "increments", "increments": 1}
    loaded = ("clamp", "weld", "release")
    scene = scene.model_copy(
        update={
            "parts": [part.model_copy(update={"size": "coarse"}) for part in scene.parts],
            "zones": [zone.model_copy(update={"pairs": 4}) for zone in scene.zones],
            "welds": [weld.model_copy(update={"fused": False}) for weld in scene.welds],
            "stages": [stage.model_copy(update=steps) if stage.kind in loaded else stage for stage in scene.stages],
        }
    )
    assembly = assemble(scene, folder / str(MPI.COMM_WORLD.rank))
    full = FullModel(assembly).evaluate(draw(scene, 5, 0, 1)[0])
    values = [full.measurements, *full.field("release").values()]
    values += [a for r in full.resolutions.values() for a in (r.force, r.displacement, r.reaction, r.trace.slip)]
    assert all(np.array_equal(a, b) for a, b in zip(values, MPI.COMM_WORLD.bcast(values)))
    return values


if __name__ == "__main__":
    file, folder, result = sys.argv[1:]
    values = solved(file, Path(folder))
    if MPI.COMM_WORLD.rank == 0:
        np.savez(result, *values)
