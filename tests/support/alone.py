"""One of several processes makes a run of its own, as the others sleep; it says how many samples there are."""

import sys
from pathlib import Path

import mic
from mic.execution import ranks

if __name__ == "__main__":
    world, folder = ranks.communicator(), Path(sys.argv[1])
    if world.rank == 0:
        with ranks.alone():
            found = mic.run(mic.load_scene(Path(sys.argv[2])), folder / "out", folder / "cache")
        print(found.record["samples"], ranks.communicator().size, flush=True)
    ranks.wait(world)
