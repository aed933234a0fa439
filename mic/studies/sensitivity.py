"""What a step of each input changes: exact derivatives of the key characteristics, about the mean and over samples.

The inputs are the scene's deviations, each by one standard deviation, and what the scene holds fixed: positions of
locators and clamps, forces of clamps and guns, friction of zones, and places in sheets that the scene's report asks for
(:mod:`mic.process.inputs`).
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
import pandas as pd

from mic.process.model import ReducedModel
from mic.process.sensitivity import AT_CHANGE, known_inputs
from mic.results.schema import SENSITIVITIES, SPREADS
from mic.statistics.derivative_regression import by_slopes
from mic.statistics.draw import draw
from mic.statistics.estimates import six_sigma

__all__ = ["SAMPLES", "Effects", "effects", "steps"]

SAMPLES = 20
BLOCK = 10  # samples between two calls of `progress`

# By how much inputs are moved that the scene holds fixed.
POSITION = 0.1  # mm
FORCE = 0.1  # of the clamp's
FRICTION = 0.05


@dataclass(frozen=True)
class Effects:
    """What steps of the inputs change under one law.

    Attributes
    ----------
    table : DataFrame
        As :data:`mic.results.schema.SENSITIVITIES` declares it.
    spread : DataFrame
        As :data:`mic.results.schema.SPREADS` declares it: what the samples and their derivatives tell of 6σ.
    reach : float
        How far the mean assembly is from the next change of a contact's state, in standard deviations of the deviations
        together; infinite if none changes any.
    where : str
        What changes there.
    at_change : str
        What changes where the mean assembly is, if it is at a change; else empty.
    failed : int
        Samples that failed, of those asked for, the mean among them.
    """

    table: pd.DataFrame
    spread: pd.DataFrame
    reach: float
    where: str
    at_change: str
    failed: int


def steps(model: ReducedModel) -> dict[str, float]:
    """By how much each input is moved: a deviation by its standard deviation, a position by 0.1 mm, the force of a
    clamp or a gun, or its limit, by a tenth of it, a coefficient of friction by 0.05."""
    clamps, welds = model.scene.clamps, model.scene.welds
    forces = {f"clamps.{one.name}": FORCE * abs(one.force) for one in clamps if one.force}
    forces |= {f"clamps.{one.name}.limit": FORCE * one.limit for one in clamps if one.limit}
    forces |= {f"welds.{one.name}.gun": FORCE * one.gun for one in welds if one.gun}
    found = {}
    for name, sigma in known_inputs(model).items():
        if name in model.parameters:
            if sigma > 0:
                found[name] = sigma
        else:
            found[name] = forces.get(name, FRICTION if name.endswith(".friction") else POSITION)
    return found


def _spread(scene, law: str, inputs: list[str], drawn, values, jacobians) -> pd.DataFrame:
    """What samples with their derivatives tell of mean and 6σ, as :data:`mic.results.schema.SPREADS` declares it."""
    names = [item.name for item in scene.deviations]
    x, y = (
        np.concatenate([np.zeros((0, len(names))), *drawn]),
        np.concatenate([*values]) if values else np.zeros((0, 0)),
    )
    if not len(x):
        return SPREADS.empty()
    slopes = np.zeros((*y.shape, len(names)))
    own = [name for name in inputs if name in names]
    slopes[:, :, [names.index(name) for name in own]] = np.concatenate(jacobians)[:, :, [inputs.index(n) for n in own]]
    best, plain = by_slopes(scene, x, y, slopes), six_sigma(y)
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
            **{f"mean{end}": one for end, one in zip(("", "_low", "_high"), best.mean)},
            **{f"six_sigma{end}": 6 * one for end, one in zip(("", "_low", "_high"), best.sigma)},
        }
    )[SPREADS.names]


def effects(
    model: ReducedModel,
    law: str | None = None,
    samples: int = SAMPLES,
    seed: int = 0,
    progress: Callable[[int], None] = lambda count: None,
) -> Effects:
    """Find what steps of all inputs change.

    Parameters
    ----------
    model : ReducedModel
    law : str, optional
        Contact law; default: the first of the scene's report.
    samples : int
        Beside the mean assembly, over which the derivatives' range is told.
    seed : int
    progress : callable, optional
        Called with the number of samples that were done.

    Raises
    ------
    ValueError
        If nothing is measured.
    SceneError
        Where parts rest by contact alone, and places in sheets are inputs.
    """
    scene = model.scene
    if not scene.measurements:
        raise ValueError(f"scene {scene.name!r} has no measurements: nothing is asked for")
    step, name = steps(model), law or scene.report.laws[0]
    drawn, values = [], []
    mean = model.sensitivities({}, name, step)
    own = [one for one in step if one in model.parameters]
    near = model.sensitivities({}, name, own) if own else mean
    progress(1)
    size = np.array(list(step.values()))
    found = [mean.jacobian]
    for first in range(0, samples, BLOCK):
        some = draw(scene, seed, first, min(BLOCK, samples - first))
        told = model.sensitivities(some, name, step)
        found.append(told.jacobian)
        drawn.append(some)
        values.append(np.where(told.failed[:, None], np.nan, told.measurements))
        progress(len(some))
    slopes = np.concatenate(found) * size
    failed = np.isnan(slopes).any(axis=(1, 2))
    known = slopes[~failed] if not failed.all() else slopes[:1]
    rows = [
        {
            "law": name,
            "measurement": item.name,
            "input": one,
            "step": size[i],
            "samples": int((~failed).sum()),
            "effect": slopes[0, k, i],
            "effect_low": known[:, k, i].min(),
            "effect_high": known[:, k, i].max(),
            "effect_below": mean.sides[0, k, i, 0] * size[i],
            "effect_above": mean.sides[0, k, i, 1] * size[i],
            "reach": mean.reach_along[0, i],
        }
        for k, item in enumerate(scene.measurements)
        for i, one in enumerate(step)
    ]
    at_change = str(mean.where[0]) if mean.reach[0] <= AT_CHANGE else ""
    table = pd.DataFrame(rows, columns=SENSITIVITIES.names)
    spread = _spread(scene, name, list(step), drawn, values, found[1:])
    return Effects(table, spread, float(near.reach[0]), str(near.where[0]), at_change, int(failed.sum()))
