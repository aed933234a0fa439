"""Error of the interpolated compliance of a sheet of varying thickness, against the computed one."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from mic.compliance.cache import influence_coefficients
from mic.compliance.thickness import Thicknesses
from mic.model.assembly import Assembly
from mic.process.model import ReducedModel

__all__ = ["AWAY", "Interpolated", "interpolated"]

AWAY = 3.0  # distance of the compared thicknesses from the mean, in standard deviations


@dataclass(frozen=True)
class Interpolated:
    """Error of the key characteristics with one part at its thinnest and thickest, all else at its mean.

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


def interpolated(
    assembly: Assembly, model: ReducedModel, cache: Path, progress: Callable[[str], None] | None = None
) -> list[Interpolated]:
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
    found = []
    mean = model.deviations({})
    for j, item in enumerate(model.scene.deviations):
        if item.kind != "thickness" or not model.scene.measurements:
            continue
        part = next(one for one in assembly.parts if one.name == item.part)
        known = model.thicknesses[part.name]
        t = np.clip(part.thickness + item.mean + AWAY * item.sigma * np.array([-1.0, 1.0]), known.low, known.high)
        ends = tuple(part.at(float(each)) for each in t)
        computed, _ = influence_coefficients(replace(assembly, parts=ends), cache, progress)
        sets = [computed[one.name] for one in ends]
        H, G = (np.array([getattr(one, name) for one in sets]) for name in ("H", "G"))
        exact = replace(model, thicknesses={**model.thicknesses, part.name: Thicknesses(t, t[0], t[1], H, G)})
        samples = np.repeat(mean, 2, axis=0)
        samples[:, j] = t - part.thickness
        read = model.process().attempt(samples).measurements
        change = read - model.process().attempt(mean).measurements
        error = read - exact.process().attempt(samples).measurements
        found.append(Interpolated(item.name, part.name, (float(t[0]), float(t[1])), change, error))
    return found
