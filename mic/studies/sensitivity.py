"""Effects of steps of the inputs: exact derivatives of the key characteristics, about the mean and over samples.

The inputs are the deviations of the scene, with steps of one standard deviation, and its constants: positions of
locators and clamps, forces of clamps and guns, friction of zones, and the places in sheets that the report of the scene
names (:mod:`mic.process.inputs`).
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import pandas as pd

from mic.errors import ArgumentError
from mic.process.model import ReducedModel
from mic.process.sensitivity import AT_CHANGE, known_inputs
from mic.results.schema import SENSITIVITIES, SPREADS
from mic.statistics.derivative_regression import estimates_with_derivatives
from mic.statistics.draw import draw
from mic.statistics.estimates import six_sigma
from mic.studies.samples import Progress, derivatives
from mic.system.arguments import checked

__all__ = ["SAMPLES", "Effects", "effects", "steps"]

SAMPLES = 20

# Steps of the constants of the scene.
POSITION = 0.1  # mm
FORCE = 0.1  # relative to the force of the clamp or gun
FRICTION = 0.05


@dataclass(frozen=True)
class Effects:
    """Effects of steps of the inputs under one law.

    Attributes
    ----------
    table : DataFrame
        As :data:`mic.results.schema.SENSITIVITIES` declares it.
    spread : DataFrame
        As :data:`mic.results.schema.SPREADS` declares it: mean and 6σ from the samples and their derivatives.
    reach : float
        Distance of the mean assembly to the next change of a contact state, in joint standard deviations of the
        deviations; infinite if they change none.
    where : str
        Description of that change.
    at_change : str
        Description of the change if the mean assembly lies on it; else empty.
    failed : int
        Number of failed samples, including the mean.
    """

    table: pd.DataFrame
    spread: pd.DataFrame
    reach: float
    where: str
    at_change: str
    failed: int


def steps(model: ReducedModel) -> dict[str, float]:
    """Step of each input: the standard deviation of a deviation, 0.1 mm for a position, a tenth of the force of a clamp
    or gun or of its limit, 0.05 for a coefficient of friction."""
    clamps, welds = model.scene.clamps, model.scene.welds
    forces = {f"clamps.{item.name}": FORCE * abs(item.force) for item in clamps if item.force}
    forces |= {f"clamps.{item.name}.limit": FORCE * item.limit for item in clamps if item.limit}
    forces |= {f"welds.{item.name}.gun": FORCE * item.gun for item in welds if item.gun}
    result = {}
    for name, sigma in known_inputs(model).items():
        if name not in model.parameters:
            result[name] = forces.get(name, FRICTION if name.endswith(".friction") else POSITION)
        elif sigma > 0:
            result[name] = sigma
    return result


def _spread(scene, law: str, inputs: list[str], x: np.ndarray, y: np.ndarray, jacobian: np.ndarray) -> pd.DataFrame:
    """Mean and 6σ from samples (n, p), their key characteristics (n, k) and derivatives (n, k, inputs)."""
    names = [item.name for item in scene.deviations]
    slopes = np.zeros((*y.shape, len(names)))
    columns = [i for i, name in enumerate(inputs) if name in names]
    slopes[:, :, [names.index(inputs[i]) for i in columns]] = jacobian[:, :, columns]
    best, plain = estimates_with_derivatives(scene, x, y, slopes), six_sigma(y)
    if best is None:
        return SPREADS.empty()
    return pd.DataFrame(
        {
            "law": law,
            "measurement": [item.name for item in scene.measurements],
            "samples": np.isfinite(y).all(axis=1).sum(),
            "plain_six_sigma": plain.value,
            "plain_six_sigma_low": plain.low,
            "plain_six_sigma_high": plain.high,
            "kind": best.kind.astype(str),
            "explained": best.explained,
            **dict(zip(("mean", "mean_low", "mean_high"), best.mean)),
            **{name: 6 * end for name, end in zip(("six_sigma", "six_sigma_low", "six_sigma_high"), best.sigma)},
        }
    )[SPREADS.names]


@checked
def effects(
    model: ReducedModel,
    law: str | None = None,
    samples: int = SAMPLES,
    seed: int = 0,
    progress: Progress = lambda count: None,
) -> Effects:
    """Effects of steps of all inputs on the key characteristics.

    Parameters
    ----------
    model : ReducedModel
    law : str, optional
        Contact law; default: the first of the scene's report.
    samples : int
        Number of samples, besides the mean assembly, from which the range of the derivatives is taken.
    seed : int
    progress : callable or bool, optional
        Called with the number of evaluated samples; or whether a bar is shown.

    Raises
    ------
    ArgumentError
        If nothing is measured.
    SceneError
        If parts are held by contact alone and places in sheets are inputs.
    """
    scene = model.scene
    if not scene.measurements:
        raise ArgumentError(f"scene {scene.name!r} has no measurements: there are no effects to compute")
    inputs, law = steps(model), law or scene.report.laws[0]
    mean = model.sensitivities({}, law, inputs)
    deviations = [name for name in inputs if name in model.parameters]
    nearest = model.sensitivities({}, law, deviations) if deviations else mean
    progress(1)
    size = np.array(list(inputs.values()))
    x = draw(scene, seed, 0, samples)
    jacobian, spread = mean.jacobian, SPREADS.empty()
    if len(x):
        y, sampled = derivatives(model, x, law, progress, inputs)
        jacobian = np.concatenate([jacobian, sampled])
        spread = _spread(scene, law, list(inputs), x, y, sampled)
    effect = jacobian * size
    failed = np.isnan(effect).any(axis=(1, 2))
    known = effect[~failed] if not failed.all() else effect[:1]
    rows = [
        {
            "law": law,
            "measurement": item.name,
            "input": name,
            "step": size[i],
            "samples": int((~failed).sum()),
            "effect": effect[0, k, i],
            "effect_low": known[:, k, i].min(),
            "effect_high": known[:, k, i].max(),
            "effect_below": mean.sides[0, k, i, 0] * size[i],
            "effect_above": mean.sides[0, k, i, 1] * size[i],
            "reach": mean.reach_along[0, i],
        }
        for k, item in enumerate(scene.measurements)
        for i, name in enumerate(inputs)
    ]
    at_change = str(mean.where[0]) if mean.reach[0] <= AT_CHANGE else ""
    table = pd.DataFrame(rows, columns=SENSITIVITIES.names)
    return Effects(table, spread, float(nearest.reach[0]), str(nearest.where[0]), at_change, int(failed.sum()))
