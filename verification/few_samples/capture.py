"""Key characteristics of the example scenes on the followed path and in one step, stored for repeated statistics.

    python -m verification.few_samples.capture lap_joint 20000

computes the first 20 000 samples of the scene with seed 1 under Coulomb's law and writes ``samples/lap_joint.npz``:
``followed`` and ``one_step`` (N, k), and ``milliseconds`` of processor time per sample of both. The deviations are
those of :func:`mic.statistics.draw.draw`, and are not stored.
"""

from __future__ import annotations

import sys
import time
from pathlib import Path

import numpy as np

import mic
from mic import examples
from mic.statistics.draw import draw

__all__ = ["BLOCK", "FOLDER", "LAW", "SEED", "store"]

FOLDER = Path(__file__).parent / "samples"
LAW, SEED, BLOCK = "coulomb", 1, 100


def store(name: str, followed, one_step, milliseconds) -> None:
    """Write the samples of a scene in single precision."""
    FOLDER.mkdir(exist_ok=True)
    arrays = {"followed": followed, "one_step": one_step, "milliseconds": milliseconds}
    np.savez_compressed(FOLDER / f"{name}.npz", **{key: np.asarray(value, "f4") for key, value in arrays.items()})


def main(name: str, samples: int) -> None:
    """Compute and store the first samples of a scene."""
    model = mic.reduce(mic.load_scene(examples.folder(name)))
    processes = [model.process(LAW), model.one_step.process(LAW)]
    found: list[list[np.ndarray]] = [[], []]
    seconds = np.zeros(2)
    for first in range(0, samples, BLOCK):
        x = draw(model.scene, SEED, first, min(BLOCK, samples - first))
        for i, process in enumerate(processes):
            start = time.process_time()
            found[i].append(process.attempt(x).measurements)
            seconds[i] += time.process_time() - start
    store(name, *map(np.concatenate, found), 1e3 * seconds / samples)


if __name__ == "__main__":
    main(sys.argv[1], int(sys.argv[2]))
