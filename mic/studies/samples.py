"""Helpers that several studies share: contact law, limits, valid samples, and columns of intervals."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Any

import numpy as np

from mic.contact.laws import LAWS
from mic.process.model import ReducedModel
from mic.process.process import Process
from mic.scene import Scene
from mic.statistics.estimates import Estimate

__all__ = [
    "Progress",
    "derivatives",
    "first_frictional",
    "half_tolerances",
    "interval",
    "key_characteristics",
    "limits",
    "valid",
]

BLOCK = 10  # samples between two calls of `progress`

#: Called with the number of evaluations that were done since the call before; public functions also take True or False
#: (:func:`mic.system.arguments.checked`).
Progress = Callable[[int], None] | Any


def first_frictional(laws: Sequence[str]) -> str:
    """The first contact law with friction, or the first one if none has friction."""
    return next((name for name in laws if LAWS[name].frictional), laws[0])


def limits(scene: Scene) -> tuple[np.ndarray, np.ndarray]:
    """Lower and upper limits (k,) of the key characteristics, mm; infinite where there is none."""
    lower, upper = np.array([item.bounds for item in scene.measurements]).T
    return lower, upper


def half_tolerances(scene: Scene) -> np.ndarray:
    """(k,) half the tolerances of the key characteristics, mm."""
    return np.array([(item.upper - item.lower) / 2 for item in scene.measurements])


def valid(evaluation: Any) -> np.ndarray:
    """(n, k) key characteristics of an evaluation or of sensitivities, mm; NaN for failed samples."""
    return np.where(evaluation.failed[:, None], np.nan, evaluation.measurements)


def key_characteristics(process: Process, x: np.ndarray, progress: Progress) -> np.ndarray:
    """(n, k) key characteristics of samples (n, p), mm; NaN for failed samples."""
    evaluation = process.attempt(x)
    progress(len(x))
    return valid(evaluation)


def derivatives(
    model: ReducedModel, x: np.ndarray, law: str | None, progress: Progress, *inputs: Any
) -> tuple[np.ndarray, np.ndarray]:
    """Key characteristics (n, k) of samples (n, p), NaN for failed ones, and their derivatives (n, k, inputs).

    Parameters
    ----------
    model : ReducedModel
    x : (n, p) array
    law : str, optional
    progress : callable
    *inputs
        Inputs and steps, as :meth:`mic.process.model.ReducedModel.sensitivities` takes them.

    Raises
    ------
    SceneError
        If parts are held by contact alone.
    """
    y, jacobians = [], []
    for first in range(0, len(x), BLOCK):
        block = model.sensitivities(x[first : first + BLOCK], law, *inputs)
        y.append(valid(block))
        jacobians.append(block.jacobian)
        progress(len(block.failed))
    return np.concatenate(y), np.concatenate(jacobians)


def interval(name: str, estimate: Estimate) -> dict[str, float]:
    """Columns ``NAME``, ``NAME_low`` and ``NAME_high`` of an estimate of one quantity."""
    ends = {"": estimate.value, "_low": estimate.low, "_high": estimate.high}
    return {f"{name}{end}": float(value) for end, value in ends.items()}
