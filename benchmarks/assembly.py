"""Time of one assembly: `model.evaluate` with one step per stage, and its share outside the contact solver.

    python benchmarks/assembly.py                                   # the three small scenes
    python benchmarks/assembly.py meshes/wheelhouse --samples 200

Milliseconds of processor time, one process, one thread. Single samples: the fastest of three evaluations of each, then
the median over samples. *contacts* is the contact solver's share of a single sample, including the certificate; *the
rest* is the transfer from stage to stage.
"""

from __future__ import annotations

import argparse
import time
from pathlib import Path

import numpy as np
from measurement import timed
from rich.console import Console
from rich.table import Table

import mic
from mic.process.stage import PreparedStage
from mic.statistics.draw import draw
from verification.scenes import with_path

ROOT = Path(__file__).resolve().parents[1]
SCENES = [ROOT / "meshes" / name for name in ("lap_joint", "hat_on_plate", "wheelhouse")]
LAWS = ("coulomb", "associated", "frictionless")
REPEATED = 3


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("scenes", nargs="*", type=Path, default=SCENES)
    parser.add_argument("--samples", type=int, default=30)
    arguments = parser.parse_args()
    shown = Table("scene", "law", "one", "contacts", "the rest", "in a batch", title="ms a sample")
    for path in arguments.scenes:
        scene = mic.load_scene(path)
        model = mic.reduce(with_path(scene, "one-step"))
        samples = draw(model.scene, 1, 0, arguments.samples)
        for law in LAWS:
            one, contacts, batch = measure(model, law, samples)
            shown.add_row(scene.folder.name, law, *(f"{ms:.2f}" for ms in (one, contacts, one - contacts, batch)))
    Console(width=110).print(shown)


def measure(model, law: str, samples: np.ndarray) -> tuple[float, float, float]:
    """Times of a single sample, of its contacts, and of a sample in a batch, ms."""
    process = model.process(law)
    model.evaluate(samples, law)  # extends the working sets and fills the caches
    watch = Watch([stage for stage in process.stages if stage.resolves])
    one, contacts = [], []
    for sample in samples:
        times, inside = [], []
        for _ in range(REPEATED):
            watch.spent = 0.0
            times.append(timed(model.evaluate, sample, law)[1])
            inside.append(watch.spent)
        one.append(min(times))
        contacts.append(min(inside))
    batch = min(timed(model.evaluate, samples, law)[1] for _ in range(REPEATED)) / len(samples)
    return 1e3 * float(np.median(one)), 1e3 * float(np.median(contacts)), 1e3 * batch


class Watch:
    """Wrap the contact solvers of some stages and sum up their processor time.

    Attributes
    ----------
    spent : float
        Processor time, s.
    """

    def __init__(self, stages: list[PreparedStage]):
        self.spent = 0.0
        solvers = [solver for stage in stages for solver in map(stage.solver, stage.required_steps) if solver]
        for solver in {id(solver): solver for solver in solvers}.values():
            follow = solver.follow

            def watched(*arguments, follow=follow):
                start = time.process_time()
                try:
                    return follow(*arguments)
                finally:
                    self.spent += time.process_time() - start

            solver.follow = watched


if __name__ == "__main__":
    main()
