"""Cost of contact detection: a run with contact candidates against a run with known contacts.

    python benchmarks/watching.py                                  # 500 samples of the hat on the plate, one increment
    python benchmarks/watching.py --followed --samples 100         # the followed path, as the scene has it
    python benchmarks/watching.py --scene meshes/lap_joint meshes/wheelhouse/watched.toml

One process, one thread, processor time. *ahead* is the prediction of the working set, once per model; *watched* are the
samples, each extended by the candidates that it needs; *known* are the same samples started with all candidates that
carried force in any of them, step by step. The ratio is (ahead + watched) / known. The largest difference of the key
characteristics between both runs stays within the penetration tolerance of 1e-6 mm and the tolerance of the path. Last
come milliseconds per sample of the watched run.
"""

from __future__ import annotations

import argparse
from dataclasses import replace
from pathlib import Path

import numpy as np
from measurement import timed
from rich.console import Console
from rich.table import Table

import mic
from mic.process.process import Process
from mic.statistics.draw import draw
from verification.scenes import with_path

ROOT = Path(__file__).resolve().parents[1]
LAW = "coulomb"
TIMES = ("ahead, s", "watched, s", "known, s", "ratio")
COLUMNS = ("scene", "candidates", "touch", "samples", *TIMES, "difference, mm", "ms a sample")


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--scene", nargs="+", type=Path, default=[ROOT / "meshes" / "hat_on_plate"])
    parser.add_argument("--samples", type=int, default=500)
    parser.add_argument("--followed", action="store_true", help="along the path, not in one increment a step")
    arguments = parser.parse_args()
    table = Table(*COLUMNS)
    for path in arguments.scene:
        scene = mic.load_scene(path)
        if not arguments.followed:
            scene = with_path(scene, "increments", 1)
        table.add_row(path.stem, *measure(scene, arguments))
    Console(width=150).print(table)


def measure(scene, arguments) -> list[str]:
    """The row of one scene."""
    model = mic.reduce(scene)
    model.eliminations  # noqa: B018  (once for all laws, candidates or not)
    deviations = draw(scene, scene.monte_carlo.seed, 0, arguments.samples)
    Process(model, LAW, forecast={}).evaluate(deviations[:1])  # compiles
    _, ahead = timed(lambda: model.forecast)
    process = Process(model, LAW)
    found, watched = timed(process.evaluate, deviations)
    touching = {step: one.touching for step, one in process.seen.items()}
    sets = {step: replace(one, touching=touching[step]) for step, one in model.forecast.items()}
    knowing = Process(model, LAW, forecast=sets)
    again, known = timed(knowing.evaluate, deviations)
    touch = max(int((one.force[:, :, 0] > 0).sum(axis=1).max()) for one in found.resolutions.values())
    ok = ~(found.failed | again.failed)
    difference = np.abs(found.measurements - again.measurements)[ok].max(initial=0.0)
    times = (ahead, watched, known, (ahead + watched) / known)
    counts = (int(model.contacts.watched.sum()), touch, arguments.samples)
    each = 1e3 * (ahead + watched) / arguments.samples
    return [*map(str, counts), *(f"{value:.2f}" for value in times), f"{difference:.1e}", f"{each:.0f}"]


if __name__ == "__main__":
    main()
