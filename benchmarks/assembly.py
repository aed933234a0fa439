"""One assembly: what `model.evaluate` takes, with one step per stage, and what of it is not the contacts.

    python benchmarks/assembly.py                                   # the three small scenes
    python benchmarks/assembly.py meshes/wheelhouse --samples 200

Milliseconds of processor time, one process, one thread: of each sample by itself the fastest of three, their median
over the samples; and of a sample in a batch of all. *contacts* is the part of a single one that the contact solver has,
its certificate counted in; *the rest* is what stages take over and hand on. *before* are figures of commit bf8188e, in
which every row of every step was gathered by itself, and forces on all functionals were found whether asked for or not,
on a machine that others kept busy; only a run of that commit beside this one compares them fairly.
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
    """One sample, what its contacts take, and one of a batch, ms."""
    process = model.process(law)
    model.evaluate(samples, law)  # candidates join, and what is prepared for them is kept
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
    """Stands before the contact solvers of some stages, and adds up what they take.

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
