"""Time of one assembly: `model.evaluate` with one step per stage, and its share outside the contact solver.

    python benchmarks/assembly.py                                   # the three small scenes
    python benchmarks/assembly.py meshes/wheelhouse --samples 200

Milliseconds of processor time, one process, one thread. Single samples: the fastest of three evaluations of each, then
the median over samples. *contacts* is the contact solver's share of a single sample, including the certificate; *the
rest* is the transfer from stage to stage. *before* are times of commit bf8188e, which gathered every row of every step
separately and always computed forces on all functionals, on a busy machine; compare fairly by running that commit too.
"""

from __future__ import annotations

import argparse
import time
from functools import partial
from pathlib import Path

import numpy as np
from rich.console import Console
from rich.table import Table

import mic
from mic.process.stage import PreparedStage
from mic.statistics.draw import draw
from verification.scenes import going

ROOT = Path(__file__).resolve().parents[1]
SCENES = [ROOT / "meshes" / name for name in ("lap_joint", "hat_on_plate", "wheelhouse")]
LAWS = ("coulomb", "associated", "frictionless")
REPEATED = 3
#: ms of one sample and of one in a batch of 30, by scene and law, of commit bf8188e
BEFORE = {
    ("lap_joint", "coulomb"): (4.96, 1.60),
    ("lap_joint", "associated"): (6.49, 2.07),
    ("lap_joint", "frictionless"): (4.25, 1.00),
    ("hat_on_plate", "coulomb"): (12.30, 5.03),
    ("hat_on_plate", "associated"): (42.70, 28.53),
    ("hat_on_plate", "frictionless"): (10.10, 3.10),
    ("wheelhouse", "coulomb"): (5.21, 0.97),
    ("wheelhouse", "associated"): (6.34, 1.57),
    ("wheelhouse", "frictionless"): (4.30, 0.30),
}


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("scenes", nargs="*", type=Path, default=SCENES)
    parser.add_argument("--samples", type=int, default=30)
    arguments = parser.parse_args()
    shown = Table("scene", "law", "one", "contacts", "the rest", "before", "in a batch", "before", title="ms a sample")
    for path in arguments.scenes:
        scene = mic.load_scene(path)
        name = scene.folder.name
        model = mic.reduce(going(scene, "one-step"))
        samples = draw(model.scene, 1, 0, arguments.samples)
        for law in LAWS:
            one, contacts, batch = measure(model, law, samples)
            before = [f"{value:.2f}" for value in BEFORE.get((name, law), ())] or ["", ""]
            cells = f"{one:.2f}", f"{contacts:.2f}", f"{one - contacts:.2f}", before[0], f"{batch:.2f}", before[1]
            shown.add_row(name, law, *cells)
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
            times.append(timed(partial(model.evaluate, sample, law)))
            inside.append(watch.spent)
        one.append(min(times))
        contacts.append(min(inside))
    batch = min(timed(partial(model.evaluate, samples, law)) for _ in range(REPEATED)) / len(samples)
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


def timed(work) -> float:
    """Processor seconds."""
    start = time.process_time()
    work()
    return time.process_time() - start


if __name__ == "__main__":
    main()
