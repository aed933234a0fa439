"""Error of the interpolated compliance of a sheet of varying thickness, relative to the computed one."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from mic.compliance.cache import influence_coefficients
from mic.compliance.thickness import Thicknesses
from mic.model.assembly import Assembly
from mic.process.model import ReducedModel

__all__ = ["DISTANCE", "InterpolationError", "interpolation_errors"]

DISTANCE = 3.0  # distance of the compared thicknesses from the mean, in standard deviations


@dataclass(frozen=True)
class InterpolationError:
    """Errors of the key characteristics with one part at its extreme thicknesses and all else at its mean.

    Attributes
    ----------
    name : str
        Name of the deviation.
    part : str
    thickness : tuple of float
        Smallest and largest, mm.
    change : (2, k) array
        Change of the k key characteristics at them, mm.
    error : (2, k) array
        Difference from the change with coefficients computed at these thicknesses, mm.
    """

    name: str
    part: str
    thickness: tuple[float, float]
    change: np.ndarray
    error: np.ndarray


def interpolation_errors(
    assembly: Assembly, model: ReducedModel, cache: Path, progress: Callable[[str], None] | None = None
) -> list[InterpolationError]:
    """Compare interpolated coefficients with computed ones, for each thickness that varies.

    Parameters
    ----------
    assembly : Assembly
    model : ReducedModel
        Reduced model of the assembly.
    cache : Path
        Folder of cached coefficients.
    progress : callable, optional
        Called with one line of text before each solve.

    Raises
    ------
    MissingProvider
        If coefficients must be computed and no provider is installed.
    """
    results = []
    mean = model.deviations({})
    for j, deviation in enumerate(model.scene.deviations):
        if deviation.kind != "thickness" or not model.scene.measurements:
            continue
        part = next(item for item in assembly.parts if item.name == deviation.part)
        thicknesses = model.thicknesses[part.name]
        t = part.thickness + deviation.mean + DISTANCE * deviation.sigma * np.array([-1.0, 1.0])
        t = np.clip(t, thicknesses.low, thicknesses.high)
        end_parts = tuple(part.at(float(value)) for value in t)
        computed, _ = influence_coefficients(replace(assembly, parts=end_parts), cache, progress)
        coefficients = [computed[item.name] for item in end_parts]
        H, G = (np.array([getattr(item, name) for item in coefficients]) for name in ("H", "G"))
        exact = replace(model, thicknesses={**model.thicknesses, part.name: Thicknesses(t, t[0], t[1], H, G)})
        samples = np.repeat(mean, 2, axis=0)
        samples[:, j] = t - part.thickness
        y = model.process().attempt(samples).measurements
        change = y - model.process().attempt(mean).measurements
        error = y - exact.process().attempt(samples).measurements
        results.append(InterpolationError(deviation.name, part.name, (float(t[0]), float(t[1])), change, error))
    return results
