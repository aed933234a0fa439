"""A full contact solve that processes share: ``python -m support.shared SCENE FOLDER RESULT``.

Below FOLDER each process has its own cache.
"""

import sys
from pathlib import Path

import numpy as np
import ufl
from mpi4py import MPI
from dolfinx import fem

import mic
from fem_reference.contact_problem import Contact, ContactProblem, Sheet, Support, Traction
from fem_reference.full.model import FullModel
from fem_reference.shell.compat import compile_form, shell_mesh
from mic.geometry.structured import extrude
from mic.model.assembly import assemble
from mic.statistics.draw import draw
from verification.scenes import with_stated_pairs


def solved(file, folder: Path) -> list[np.ndarray]:
    """Measurements, fields and contact results of one sample; the same in every process."""
    scene = with_stated_pairs(mic.load_scene(file))
    steps = {"path": "increments", "increments": 1}
    stages = [stage.model_copy(update=steps) if stage.kind in ("clamp", "weld") else stage for stage in scene.stages]
    scene = scene.model_copy(
        update={
            "parts": [part.model_copy(update={"size": "coarse"}) for part in scene.parts],
            "zones": [zone.model_copy(update={"pairs": 4}) for zone in scene.zones],
            "welds": [weld.model_copy(update={"fused": False}) for weld in scene.welds],
            "stages": [stage for stage in stages if stage.kind != "release"],
        }
    )
    assembly = assemble(scene, folder / str(MPI.COMM_WORLD.rank))
    full = FullModel(assembly).evaluate(draw(scene, 5, 0, 1)[0])
    values = [full.measurements, *full.field("weld").values(), *strips()]
    values += [a for r in full.resolutions.values() for a in (r.force, r.displacement, r.reaction, r.trace.slip)]
    assert all(np.array_equal(a, b) for a, b in zip(values, MPI.COMM_WORLD.bcast(values)))
    return values


def strips() -> list[np.ndarray]:
    """Forces, reactions and the volume swept, of two strips on distributed dolfinx meshes, one bent onto the other."""
    sheets = []
    for name, height in (("lower", 0.0), ("upper", 1.1)):
        points, triangles, _ = extrude([(0.0, height), (10.0, height)], 0.0, 60.0, 5.0)
        sheets.append(Sheet(shell_mesh(MPI.COMM_WORLD, points, triangles), 1.0, 210e3, 0.3, name=name))
    held = [Support(sheet, lambda x: np.isclose(x[0], 0), rotation=(0, 0, 0)) for sheet in sheets]
    press = Traction(sheets[1], lambda x: x[0] > 20, (2e-4, 0, -2e-3))
    solution = ContactProblem(held, [press], [Contact(*sheets, 0.2, where=lambda x: x[0] > 1)]).solve()
    swept = [
        MPI.COMM_WORLD.allreduce(fem.assemble_scalar(compile_form(solution.displacement(sheet)[2] * ufl.dx)))
        for sheet in sheets
    ]
    return [solution.contacts[0].force, solution.reaction(held[0]), np.array(swept)]


if __name__ == "__main__":
    file, folder, result = sys.argv[1:]
    values = solved(file, Path(folder))
    if MPI.COMM_WORLD.rank == 0:
        np.savez(result, *values)
