"""Share an array of 80 MB between processes, one line of output for each; then run a scene on one of them.

``python -m support.sharing FOLDER SCENE CACHE``
"""

import os
import sys
from pathlib import Path

import numpy as np

import mic
from mic.execution.ranks import alone, communicator, shared, wait
from support.runs import changed

SIZE = 10_000_000


def private() -> float:
    """MB of memory that this process has for itself."""
    (line,) = [line for line in Path("/proc/self/status").read_text().splitlines() if line.startswith("RssAnon:")]
    return int(line.split()[1]) / 1e3


def main() -> None:
    world = communicator()
    before, made = private(), []

    def make():
        made.append(world.rank)
        return {"array": np.arange(SIZE, dtype=float), "few": np.arange(3), "words": ["as", "they", "are"]}

    found = shared(world, make)
    total = found["array"].sum()
    wait(world)
    if world.rank == 0:
        found["array"][7] = -1.0  # shows that all processes share one array
    wait(world)
    right = total == SIZE * (SIZE - 1) / 2 and found["words"] == ["as", "they", "are"] and found["few"].sum() == 3
    said = f"{world.rank} made {made} right {right} one {found['array'][7] == -1.0} grew {private() - before:.0f}\n"
    os.write(sys.stdout.fileno(), said.encode())  # at once, so that no line of another process comes between
    wait(world)
    folder, scene, cache = map(Path, sys.argv[1:])
    if world.rank == 0:
        with alone():
            few = changed(mic.load_scene(scene), monte_carlo={"samples": 10}, report={"fields": False})
            outcome = mic.run(few, folder / "out", cache)
        print(outcome.record["samples"], communicator().size, flush=True)
    wait(world)


if __name__ == "__main__":
    main()
