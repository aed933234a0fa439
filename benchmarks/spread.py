"""Errors of 6σ at equal cost: plain sampling, surrogates, and regression on values and exact derivatives.

    python benchmarks/spread.py                       # the lap joint, its three deviations and all its locators
    python benchmarks/spread.py --repetitions 100

Inputs are the deviations of the scene, and then also every locator with a deviation of 0.05 mm. The error is the root
mean square over repetitions with other samples, the largest over the key characteristics; the reference takes
surrogates of the samples of all repetitions and of twenty times as many as one repetition has. Costs are processor
time in units of an evaluation.
"""

from __future__ import annotations

import argparse
import time
from pathlib import Path

import numpy as np

import mic
from mic.statistics.control_variate import FOLDS, surrogate_estimates
from mic.statistics.derivative_regression import estimates_with_derivatives
from mic.statistics.draw import draw, population
from mic.studies.adjustment import adjustments, with_adjustments

HERE = Path(__file__).resolve().parents[1]
POSITION = 0.05  # mm


def main() -> None:
    options = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    options.add_argument("--scene", type=Path, default=HERE / "meshes" / "lap_joint" / "scene.toml")
    options.add_argument("--samples", type=int, default=60)
    options.add_argument("--repetitions", type=int, default=40)
    options.add_argument("--law", default="coulomb")
    asked = options.parse_args()
    model = mic.reduce(mic.load_scene(asked.scene))
    for wide in (model, _with_locators(model)):
        _compare(wide, asked)


def _with_locators(model):
    """The model with every locator as a deviation too."""
    found, names = with_adjustments(model, adjustments(model, names=[one.name for one in model.scene.locators]))
    items = [one.model_copy(update={"sigma": POSITION}) if one.name in names else one for one in found.scene.deviations]
    return found.varied(found.scene.model_copy(update={"deviations": items}))


def _compare(model, asked) -> None:
    n, process = asked.samples, model.process(asked.law)
    whole = n * asked.repetitions
    process.attempt(draw(model.scene, 1, 0, 4))
    start = time.process_time()
    drawn = draw(model.scene, 1, 0, 20 * n)
    much = process.attempt(drawn).measurements
    one = (time.process_time() - start) / len(much)
    x = draw(model.scene, 2, 0, whole)
    start = time.process_time()
    found = model.sensitivities(x, asked.law)
    cost = (time.process_time() - start) / whole / one
    y, slopes = found.measurements, found.jacobian
    truth = _improved(model, np.concatenate([x, drawn]), np.concatenate([y, much]))
    print(f"{len(model.parameters)} inputs: with derivatives a sample costs {cost:.1f} evaluations")
    for count in sorted({n, round(n * cost)}):
        parts = [slice(i, i + count) for i in range(0, whole - count + 1, count)]
        plain = np.array([y[own].std(axis=0, ddof=1) for own in parts])
        regressed = np.array([_improved(model, x[own], y[own]) for own in parts])
        print(f"  {count:4d} samples, plain:         {_error(plain, truth)}")
        print(f"  {count:4d} samples, by surrogates: {_error(regressed, truth)}")
    parts = [slice(i, i + n) for i in range(0, whole, n)]
    told = [estimates_with_derivatives(model.scene, x[own], y[own], slopes[own]) for own in parts]
    both = np.array(
        [np.where(one.kind == "plain", y[own].std(axis=0, ddof=1), one.sigma[0]) for one, own in zip(told, parts)]
    )
    print(f"  {n:4d} with derivatives:       {_error(both, truth)}", flush=True)


def _error(found: np.ndarray, truth: np.ndarray) -> str:
    error = np.sqrt(((found / truth - 1) ** 2).mean(axis=0)).max()
    return f"{100 * error:.2f} % of 6σ, {len(found)} repetitions"


def _improved(model, x, y) -> np.ndarray:
    points = population(model.scene, 1, FOLDS, 8192)
    found = surrogate_estimates(x, y, points)
    plain = y.std(axis=0, ddof=1)
    return plain if found is None else np.where(np.array(found.kind) == "plain", plain, found.sigma().value)


if __name__ == "__main__":
    main()
