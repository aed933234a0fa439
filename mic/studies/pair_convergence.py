"""Convergence of the results with the density of contact pairs, on the same samples."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from mic.compliance.cache import influence_coefficients
from mic.model.assembly import Assembly, assemble
from mic.process.model import ReducedModel
from mic.scene import Scene
from mic.statistics.draw import draw
from mic.statistics.paired_differences import mean_change, six_sigma_change

__all__ = ["DENSER", "SAMPLES", "Convergence", "converge", "denser_scene"]

DENSER = 0.7  # factor on the distance between pairs: about twice as many pairs
SAMPLES = 30


@dataclass(frozen=True)
class Convergence:
    """Key characteristics with the stated pairs (first row) and with denser ones (second row).

    Attributes
    ----------
    pairs : (2,) int array
    nominal, mean, six_sigma : (2, k) array
        Without deviations, and over the samples that are valid in both, mm.
    mean_half, six_sigma_half : (k,) array
        Half width of the 95 % interval of the change of each, mm; the samples are paired.
    unseen : (2,) array
        Largest penetration between the pairs, mm.
    failed : int
        Samples that failed in either.
    """

    pairs: np.ndarray
    nominal: np.ndarray
    mean: np.ndarray
    six_sigma: np.ndarray
    mean_half: np.ndarray
    six_sigma_half: np.ndarray
    unseen: np.ndarray
    failed: int


def denser_scene(assembly: Assembly, share: float = DENSER) -> Scene:
    """The scene of an assembly with the distance of its contact pairs multiplied by `share`; points are replaced."""
    zones = []
    for i, zone in enumerate(assembly.scene.zones):
        if zone.pairs:
            zones.append(zone.model_copy(update={"pairs": round(zone.pairs / share**2)}))
        elif zone.points:
            distance = float(np.sqrt(assembly.contacts.area[assembly.contacts.zone == i].mean()))
            zones.append(zone.model_copy(update={"points": None, "spacing": share * distance}))
        else:
            zones.append(zone.model_copy(update={"spacing_factor": share * zone.spacing_factor}))
    return assembly.scene.model_copy(update={"zones": zones})


def converge(assembly: Assembly, cache: Path, law: str, progress: Callable[[str], None] | None = None) -> Convergence:
    """Evaluate a scene with its contact pairs and with denser ones.

    Parameters
    ----------
    assembly : Assembly
    cache : Path
    law : str
    progress : callable, optional
        Called with one line of text before each solve.

    Raises
    ------
    SceneError
        If the elements are too large for denser pairs.
    MissingProvider
    """
    scene = assembly.scene
    samples = draw(scene, scene.monte_carlo.seed, 0, SAMPLES)
    results = []
    for variant in (assembly, assemble(denser_scene(assembly), cache)):
        process = ReducedModel.build(variant, influence_coefficients(variant, cache, progress)[0]).process(law)
        results.append((variant, process.evaluate(np.zeros_like(samples[:1])), process.evaluate(samples)))
    failed = np.any([evaluation.failed for _, _, evaluation in results], axis=0)
    values = [evaluation.measurements[~failed] for _, _, evaluation in results]
    return Convergence(
        pairs=np.array([len(variant.contacts) for variant, _, _ in results]),
        nominal=np.array([nominal.measurements[0] for _, nominal, _ in results]),
        mean=np.array([y.mean(axis=0) for y in values]),
        six_sigma=np.array([6 * y.std(axis=0, ddof=1) for y in values]),
        mean_half=_half(mean_change, *values),
        six_sigma_half=_half(six_sigma_change, *values),
        unseen=np.array([max((r.unseen.max() for r in e.resolutions.values()), default=0.0) for _, _, e in results]),
        failed=int(failed.sum()),
    )


def _half(change, before: np.ndarray, after: np.ndarray) -> np.ndarray:
    """(k,) half widths of the intervals of the changes."""
    changes = [change(a, b) for a, b in zip(before.T, after.T)]
    return np.array([(estimate.high - estimate.low) / 2 for estimate in changes])
