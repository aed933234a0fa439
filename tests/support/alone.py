"""One of several processes makes a run while the others wait: ``python -m support.alone FOLDER SCENE CACHE``.

It prints the number of samples and of processes.
"""

import sys
from pathlib import Path

import mic
from mic.execution import ranks

if __name__ == "__main__":
    world = ranks.communicator()
    folder, scene, cache = map(Path, sys.argv[1:])
    if world.rank == 0:
        with ranks.alone():
            outcome = mic.run(mic.load_scene(scene), folder / "out", cache)
        print(outcome.record["samples"], ranks.communicator().size, flush=True)
    ranks.wait(world)
