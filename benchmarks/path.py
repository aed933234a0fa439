"""Cost and accuracy of followed paths: time against one step per stage, positions and forces against a tighter path.

    python benchmarks/path.py                                       # four scenes
    python benchmarks/path.py meshes/bracket --samples 2

Milliseconds of processor time of one sample under Coulomb's law, one process, one thread, each with its bar.
*followed* and *one step* are the same batch with both paths, in turns; the ratio is the median of these pairs.
*alone* is one assembly in a batch of its own, one step per stage. Errors are the largest of all stages and samples,
relative to a path with a 250th of the tolerance: of the contacts' positions, root mean square over the contacts, mm; of
their forces, likewise, in % of the largest force of the sample.
"""

from __future__ import annotations

import argparse
from pathlib import Path

import numpy as np
from measurement import timed
from rich.console import Console
from rich.table import Table

import mic
from mic.process.evaluation import Evaluation
from mic.process.process import Process
from mic.statistics.draw import draw
from verification.scenes import with_path

ROOT = Path(__file__).resolve().parents[1]
#: Largest ratio, ms of a followed sample (none: no bar) and ms of one assembly alone, by scene.
BARS = {
    "lap_joint": (8.0, np.inf, 1.5),
    "wheelhouse": (20.0, 9.0, 1.5),
    "bracket": (8.0, np.inf, 6.0),
    "hat_on_plate": (15.0, 100.0, 6.0),
}
PAIRS, TIGHTER = 3, 1 / 250


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("scenes", nargs="*", type=Path, default=[ROOT / "meshes" / name for name in BARS])
    parser.add_argument("--samples", type=int, default=10)
    arguments = parser.parse_args()
    costs = Table("scene", "followed", "one step", "ratio", "alone", "steps", "factorisations", title="ms, per sample")
    accuracies = Table("scene", "positions, mm", "forces, %", title="error of the default tolerance")
    for path in arguments.scenes:
        scene = mic.load_scene(path)
        model, name = mic.reduce(scene), scene.folder.name
        samples, bars = draw(model.scene, 1, 0, arguments.samples), BARS.get(name, (np.inf, np.inf, np.inf))
        one_step = mic.reduce(with_path(scene, "one-step"))
        costs.add_row(name, *cost(Process(model, "coulomb"), Process(one_step, "coulomb"), samples, bars))
        accuracies.add_row(name, *accuracy(model, samples))
    console = Console(width=110)
    console.print(costs)
    console.print(accuracies)


def cost(followed: Process, one_step: Process, samples: np.ndarray, bars: tuple[float, float, float]) -> list[str]:
    """Times against their bars, steps and factorisations of the followed path."""
    found = followed.evaluate(samples)  # the first evaluation fills the caches
    one_step.evaluate(samples)
    times = np.array([[per_sample(process, samples) for process in (followed, one_step)] for _ in range(PAIRS)])
    alone = np.median([min(per_sample(one_step, sample[None]) for _ in range(PAIRS)) for sample in samples])
    ratio = np.median(times[:, 0] / times[:, 1])
    traces = [resolution.trace for resolution in found.resolutions.values()]
    steps, factorisations = (sum(getattr(one, what).mean() for one in traces) for what in ("steps", "factorisations"))
    fastest = times.min(axis=0)
    times_and_ratio = judged(fastest[0], bars[1]), f"{fastest[1]:.2f}", judged(ratio, bars[0]), judged(alone, bars[2])
    return [*times_and_ratio, f"{steps:.1f}", f"{factorisations:.0f}"]


def accuracy(model, samples: np.ndarray) -> tuple[str, str]:
    """Largest errors of positions and forces."""
    tolerance = model.scene.path.tolerance
    paths = [Process(model, "coulomb", path_tolerance=share * tolerance) for share in (1, TIGHTER)]
    position, force = errors(*(process.evaluate(samples) for process in paths))
    return f"{position:.1e}", f"{100 * force:.2f}"


def errors(found: Evaluation, exact: Evaluation) -> tuple[float, float]:
    """Largest errors of positions, mm, and of forces, relative to the largest force of the sample."""
    position, worst = 0.0, np.zeros(2)
    for stage, reference in exact.resolutions.items():
        resolution = found.resolutions[stage]
        position = position + (resolution.displacement - reference.displacement)[:, :, 1:]
        force = np.sqrt(((resolution.force - reference.force) ** 2).sum(axis=-1).mean(axis=1))
        largest = np.abs(reference.force).max(axis=(1, 2))
        shares = force[largest > 0.0] / largest[largest > 0.0]
        worst = np.maximum(worst, [np.sqrt((position**2).sum(axis=-1).mean(axis=1)).max(), shares.max(initial=0.0)])
    return tuple(worst)


def per_sample(process: Process, samples: np.ndarray) -> float:
    """Milliseconds of processor time per sample."""
    return 1e3 * timed(process.evaluate, samples)[1] / len(samples)


def judged(value: float, bar: float) -> str:
    """A number, and how it compares with its bar."""
    return f"{value:.2f}" + (f" {'≤' if value <= bar else '>'} {bar:g}" if np.isfinite(bar) else "")


if __name__ == "__main__":
    main()
