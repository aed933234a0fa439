"""Cost and accuracy of exact derivatives, against evaluations and central differences.

    python benchmarks/sensitivity.py                               # the three example scenes, few pairs
    python benchmarks/sensitivity.py --scenes lap_joint --samples 40

One process, one thread, processor time, one law, the deviations of the scene drawn with its seed. *6 inputs* are the
first of the scene (with copies of the last if it has fewer); *40 inputs* are its deviations, locators, clamps and
zones, and copies of the first up to forty. Both are multiples of the time of evaluating the same samples. *differences*
is the largest error against central differences with frozen path steps, relative to the largest derivative of the key
characteristic. The steps are 1e-5, 1e-4 and 5e-4 σ, between rounding and curvature; the best of each sample counts.
Samples whose forward and backward differences differ by 1e-3 lie at a change of contact state and are *kinked*.
"""

from __future__ import annotations

import argparse
from dataclasses import replace
from functools import partial

import numpy as np
from measurement import timed
from rich.console import Console
from rich.table import Table

import mic
from mic.examples import folder
from mic.process.sensitivity import known_inputs, sensitivities
from mic.statistics.draw import draw
from mic.system.matrix_product import one_thread
from verification.scenes import with_path, with_stated_pairs

SCENES = ("lap_joint", "hat_on_plate", "wheelhouse")
PATHS = {"one step": ("one-step",), "8 increments": ("increments", 8), "followed": ("followed",)}
STEPS, KINK = (1e-5, 1e-4, 5e-4), 1e-3
REPEATS = 3  # repetitions in turns; the shortest counts


@one_thread
def main() -> None:
    """Print the table."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--scenes", default=",".join(SCENES))
    parser.add_argument("--law", default="coulomb")
    parser.add_argument("--samples", type=int, default=10)
    parser.add_argument("--checked", type=int, default=3, help="samples compared with central differences")
    options = parser.parse_args()
    table = Table("scene", "path", "ms a sample", "6 inputs", "40 inputs", "differences", "kinked", "exact")
    for name in options.scenes.split(","):
        model = mic.reduce(with_stated_pairs(mic.load_scene(folder(name))))
        for path, keys in PATHS.items():
            own = replace(model, scene=with_path(model.scene, *keys))
            table.add_row(name, path, *_row(own, options.law, options.samples, options.checked))
    Console().print(table)


def _row(model, law: str, samples: int, checked: int) -> list[str]:
    process = model.process(law)
    x = draw(model.scene, model.scene.monte_carlo.seed, 0, samples)
    every = list(known_inputs(model))
    six, forty = (_so_many(every, count) for count in (6, 40))
    for warm in (lambda: process.evaluate(x[:1]), lambda: sensitivities(process, x[:1], six)):
        warm()
    works = [lambda: process.evaluate(x), *(partial(sensitivities, process, x, inputs) for inputs in (six, forty))]
    plain, *times = np.min([[timed(work)[1] for work in works] for _ in range(REPEATS)], axis=0)
    error, kinked, exact = _errors(model, law, x[:checked])
    cells = [f"{1e3 * plain / samples:.2f}", *(f"{one / plain:.2f}" for one in times)]
    return [*cells, f"{error:.1e}", f"{kinked} of {checked}", f"{exact} of {checked}"]


def _so_many(names: list[str], count: int) -> list[str]:
    return [names[i % len(names)] for i in range(count)]


def _errors(model, law: str, x: np.ndarray) -> tuple[float, int, int]:
    """Largest error of samples that are not kinked, number of kinked ones, and number of exactly solved paths."""
    process = model.process(law, 1e-12)
    found, σ = sensitivities(process, x), np.array([one.sigma for one in model.scene.deviations])
    n, p = x.shape
    steps = {key: np.repeat(record, p) for key, record in found.steps.items()}
    base, slope = found.measurements[:, :, None], found.jacobian * σ
    scale = np.abs(slope).max(axis=(0, 2))[:, None]

    def beside(way: float) -> np.ndarray:
        moved = (x[:, None] + way * np.diag(σ)).reshape(-1, p)
        values = sensitivities(process, moved, model.parameters[:1], steps).measurements
        return values.reshape(n, p, -1).transpose(0, 2, 1)

    kinks, errors = [], []
    for step in STEPS:
        up, down = beside(step), beside(-step)
        kinks.append((np.abs(up + down - 2 * base) / step / scale).max(axis=(1, 2)) > KINK)
        errors.append((np.abs(slope - (up - down) / (2 * step)) / scale).max(axis=(1, 2)))
    kink = np.all(kinks, axis=0)
    return float(np.min(errors, axis=0)[~kink].max(initial=0.0)), int(kink.sum()), int(found.exact.sum())


if __name__ == "__main__":
    main()
