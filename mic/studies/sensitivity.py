"""What a step of each input changes: exact derivatives of the key characteristics, about the mean and over samples.

The inputs are the scene's deviations, each by one standard deviation, and what the scene holds fixed: positions of
locators and clamps, forces of clamps, friction of zones (:mod:`mic.process.sensitivity`).
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
import pandas as pd

from mic.process.model import ReducedModel
from mic.process.sensitivity import known_inputs
from mic.results.schema import SENSITIVITIES
from mic.sampling.draw import draw

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
    reach : float
        How far the mean assembly is from the next change of a contact's state, in standard deviations of the deviations
        together; infinite if none changes any.
    where : str
        What changes there.
    failed : int
        Samples that failed, of those asked for, the mean among them.
    """

    table: pd.DataFrame
    reach: float
    where: str
    failed: int


def steps(model: ReducedModel) -> dict[str, float]:
    """By how much each input is moved: a deviation by its standard deviation, a position by 0.1 mm, a clamp's force by
    a tenth of it, a coefficient of friction by 0.05."""
    forces = {f"clamps.{one.name}": FORCE * abs(one.force) for one in model.scene.clamps if one.force}
    found = {}
    for name, sigma in known_inputs(model).items():
        if name in model.parameters:
            if sigma > 0:
                found[name] = sigma
        else:
            found[name] = forces.get(name, FRICTION if name.endswith(".friction") else POSITION)
    return found


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
        Where parts rest by contact alone.
    """
    scene = model.scene
    if not scene.measurements:
        raise ValueError(f"scene {scene.name!r} has no measurements: nothing is asked for")
    step, name = steps(model), law or scene.report.laws[0]
    mean = model.sensitivities({}, name, step)
    own = [one for one in step if one in model.parameters]
    near = model.sensitivities({}, name, own) if own else mean
    progress(1)
    size = np.array(list(step.values()))
    found = [mean.jacobian]
    for first in range(0, samples, BLOCK):
        some = draw(scene, seed, first, min(BLOCK, samples - first))
        found.append(model.sensitivities(some, name, step).jacobian)
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
            "reach": mean.reach_along[0, i],
        }
        for k, item in enumerate(scene.measurements)
        for i, one in enumerate(step)
    ]
    return Effects(
        pd.DataFrame(rows, columns=SENSITIVITIES.names), float(near.reach[0]), str(near.where[0]), int(failed.sum())
    )
