"""Cost of contact detection: a run with contact candidates against a run with known contacts.

    python benchmarks/watching.py                                  # 500 samples of the hat on the plate, one increment
    python benchmarks/watching.py --followed --samples 100         # the followed path, as the scene has it
    python benchmarks/watching.py --scene meshes/lap_joint meshes/wheelhouse/watched.toml

One process, one thread, processor time. *ahead* is the prediction of the working set, once per model; *watched* are the
samples, each extended by the candidates that it needs; *known* are the same samples started with all candidates that
carried force in any of them, step by step. The ratio is (ahead + watched) / known. The largest difference of the key
characteristics between both runs stays within the penetration tolerance of 1e-6 mm and the tolerance of the path. Last
come milliseconds per sample of the watched run and, where known, those of commit b7e00c6.
"""

from __future__ import annotations

import argparse
import time
from dataclasses import replace
from pathlib import Path

import numpy as np
from rich.console import Console
from rich.table import Table

import mic
from mic.process.process import Process
from mic.statistics.draw import draw
from verification.scenes import going

ROOT = Path(__file__).resolve().parents[1]
LAW = "coulomb"
TIMES = ("ahead, s", "watched, s", "known, s", "ratio")
COLUMNS = ("scene", "candidates", "touch", "samples", *TIMES, "difference, mm", "ms a sample", "before")
BEFORE = {("hat-on-plate", False): 85}  # by scene and whether it is followed


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--scene", nargs="+", type=Path, default=[ROOT / "meshes" / "hat_on_plate"])
    parser.add_argument("--samples", type=int, default=500)
    parser.add_argument("--followed", action="store_true", help="along the path, not in one increment a step")
    arguments = parser.parse_args()
    table = Table(*COLUMNS)
    for path in arguments.scene:
        scene = mic.load_scene(path)
        table.add_row(path.stem, *measure(scene if arguments.followed else going(scene, "increments", 1), arguments))
    Console(width=150).print(table)


def measure(scene, arguments) -> list[str]:
    """The row of one scene."""
    model = mic.reduce(scene)
    model.eliminations  # noqa: B018  (once for all laws, candidates or not)
    deviations = draw(scene, scene.monte_carlo.seed, 0, arguments.samples)
    Process(model, LAW, forecast={}).evaluate(deviations[:1])  # compiles
    ahead, _ = timed(lambda: model.forecast)
    process = Process(model, LAW)
    watched, found = timed(lambda: process.evaluate(deviations))
    touching = {step: one.touching for step, one in process.seen.items()}
    sets = {step: replace(one, touching=touching[step]) for step, one in model.forecast.items()}
    knowing = Process(model, LAW, forecast=sets)
    known, again = timed(lambda: knowing.evaluate(deviations))
    touch = max(int((one.force[:, :, 0] > 0).sum(axis=1).max()) for one in found.resolutions.values())
    ok = ~(found.failed | again.failed)
    difference = np.abs(found.measurements - again.measurements)[ok].max(initial=0.0)
    times = (ahead, watched, known, (ahead + watched) / known)
    counts = (int(model.contacts.watched.sum()), touch, arguments.samples)
    each, before = 1e3 * (ahead + watched) / arguments.samples, BEFORE.get((scene.name, arguments.followed), "")
    return [*map(str, counts), *(f"{value:.2f}" for value in times), f"{difference:.1e}", f"{each:.0f}", str(before)]


def timed(work):
    """Processor seconds and the result of a call."""
    start = time.process_time()
    result = work()
    return time.process_time() - start, result


if __name__ == "__main__":
    main()
