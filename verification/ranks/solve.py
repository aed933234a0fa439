"""One full solve on the processes of mpirun, stored with its cost as an npz file: ``mpirun -n 2 python -m mpi4py -m
verification.ranks.solve SCENE SIZE CACHE RESULT``."""

from __future__ import annotations

import sys
import time
from pathlib import Path

import numpy as np
from mpi4py import MPI

from fem_reference.full.model import FullModel
from mic.model.assembly import assemble
from mic.statistics.draw import draw
from verification.cost import Meter
from verification.scenes import shipped, with_path


def main(name: str, size: str, cache: str, result: str) -> None:
    """Solve the first sample of a shipped scene and store the results of all processes."""
    comm = MPI.COMM_WORLD
    scene = with_path(shipped(name, size if size.isalpha() else float(size)), "one-step")
    assembly = assemble(scene, Path(cache))
    sample = draw(scene, scene.monte_carlo.seed, 0, 1)[0]
    comm.Barrier()
    meter, start = Meter(comm.rank), time.perf_counter()
    model = FullModel(assembly, comm=comm)
    found = model.evaluate(sample)
    wall = time.perf_counter() - start
    operations, memory = found.mesh.elimination()
    mine = (wall, operations, memory, 1e3 * meter.read().memory)
    costs = np.array(comm.gather(mine) or [])
    values = {"measurements": found.measurements} | {
        f"{kind} {stage}": getattr(one, kind)
        for stage, one in found.resolutions.items()
        for kind in ("force", "displacement", "reaction")
    }
    if comm.rank == 0:
        freedoms, contacts = found.mesh.parts.offsets[-1], len(assembly.contacts)
        np.savez(result, costs=costs, size=np.array([freedoms, contacts]), route=found.route, **values)


if __name__ == "__main__":
    main(*sys.argv[1:])
