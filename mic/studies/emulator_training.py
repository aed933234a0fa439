"""Train a spline emulator of the key characteristics, with a bound of its error.

The error of the spline is estimated by leave-one-out cross-validation, relative to the distance from the other
assemblies (at least the median distance). The r-th largest of n such errors is a distribution-free tolerance limit
[1]_: with a confidence of 0.95 it covers at least 0.95 of all errors for r = 1 and n = 59, or r = 2 and n = 93.
Training assemblies scatter more widely than predicted ones.

References
----------
.. [1] S. S. Wilks: Determination of sample sizes for setting tolerance limits, Ann. Math. Stat. 12 (1941) 91-96.
"""

from __future__ import annotations

from pathlib import Path

import numpy as np
from scipy.stats import binom

from mic.process.model import ReducedModel
from mic.results.run_identity import identity
from mic.scene import Scene
from mic.statistics.emulator import Emulator
from mic.statistics.estimates import LEVEL
from mic.statistics.normal_space import from_normal
from mic.studies.samples import Progress, limits
from mic.system.disk_cache import ABSENT, Cache
from mic.system.files import Format, fingerprint

__all__ = ["COVERED", "REACH", "AssemblyEmulator", "train_emulator", "tolerance"]

REACH = 3.0  #: range of the training in standard deviations
#: range of predictions: nearer to the edge of the training than this, fewer than 95 % of the errors keep the bound
COVERED = 2.5
SPREAD = 1.5  # standard deviation of the training assemblies, relative to the scene's
MIN_ASSEMBLIES = 59  # assemblies for a tolerance limit of 0.95 with a confidence of 0.95: 0.95⁵⁹ < 0.05
BATCH, BATCHES = 16, 8  # assemblies per refinement, and largest number of refinements
#: sufficient error of the spline relative to the tolerance. It increases the uncertainty of a gauge whose six standard
#: deviations are a tenth of the tolerance by 1 %.
FINE = 5e-3
FORMAT = Format("set of training assemblies", 2, ABSENT)


class AssemblyEmulator:
    """Emulator of the key characteristics of assemblies.

    Parameters
    ----------
    mean, scale : (p,) array
        Mean and scale of the deviations; the scale of constants is 0.
    x : (n, p) array
        Training points.
    h : (n, k) array
        Values at them, mm.

    Attributes
    ----------
    error_bound : (k,) array
        Bound of 95 % of the errors at the median distance, mm.
    """

    def __init__(self, mean: np.ndarray, scale: np.ndarray, x: np.ndarray, h: np.ndarray):
        self.mean, self.scale, self.x, self.h = mean, scale, x, h
        u = self._scaled(x)
        self.emulator = Emulator(u, h)
        errors, distance = self.emulator.leave_one_out()
        self._midst = float(np.median(distance))
        shares = np.abs(errors) / np.maximum(distance / self._midst, 1.0)[:, None]
        rank = min(int(binom.ppf(LEVEL, len(shares), LEVEL)), len(shares) - 1)
        self.error_bound = np.sort(shares, axis=0)[rank]
        self._farthest = float(np.linalg.norm(u, axis=1).max())

    def covers(self, x: np.ndarray) -> bool:
        """Whether an assembly (p,) lies within the range of predictions."""
        u = self._scaled(x)
        return bool((np.abs(u) <= COVERED).all() and np.linalg.norm(u) <= self._farthest)

    def __call__(self, x: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Key characteristics (m, k) of assemblies (m, p), and bounds of their errors (m, k), mm."""
        u = self._scaled(x)
        distance = np.maximum(self.emulator.relative_sigma(u) / self._midst, 1.0)
        return self.emulator(u), distance[:, None] * self.error_bound

    def _scaled(self, x: np.ndarray) -> np.ndarray:
        varied = self.scale > 0
        return (x[..., varied] - self.mean[varied]) / self.scale[varied]


def train_emulator(
    model: ReducedModel,
    law: str,
    cache: Path | None = None,
    progress: Progress = lambda count: None,
) -> AssemblyEmulator | None:
    """Evaluate assemblies until the error of the spline is small enough or their largest number is reached.

    Parameters
    ----------
    model : ReducedModel
    law : str
        Contact law.
    cache : Path, optional
        Folder of the disk cache for the training assemblies.
    progress : callable, optional
        Called with the number of evaluations since the last call.

    Returns
    -------
    AssemblyEmulator, or None
        None if too few of the assemblies can be computed.
    """
    scene, p = model.scene, len(model.scene.deviations)
    mean, scale = (np.array([getattr(item, name) for item in scene.deviations]) for name in ("mean", "sigma"))
    stored = None if cache is None else Cache(cache, "answers", FORMAT)
    key = _cache_key(model, law)
    if stored is not None and (entry := stored.load(key)) is not None:
        return AssemblyEmulator(mean, scale, *(entry[1][name] for name in ("x", "h")))
    stream, process, emulator = np.random.default_rng([0, 0]), model.process(law), None
    x, h = np.zeros((0, p)), np.zeros((0, len(scene.measurements)))
    for count in (max(MIN_ASSEMBLIES, p + p // 2), *[BATCH] * BATCHES):
        points = _training_points(scene, stream, count)
        evaluation = process.attempt(points)
        x = np.concatenate([x, points[~evaluation.failed]])
        h = np.concatenate([h, evaluation.measurements[~evaluation.failed]])
        progress(count)
        if len(x) < np.count_nonzero(scale) + 3:
            continue
        emulator = AssemblyEmulator(mean, scale, x, h)
        if (emulator.error_bound <= FINE * tolerance(scene, h)).all():
            break
    if stored is not None and emulator is not None:
        stored.store(key, {}, {"x": emulator.x, "h": emulator.h})
    return emulator


def tolerance(scene: Scene, h: np.ndarray) -> np.ndarray:
    """(k,) tolerances, mm; with a single limit, six standard deviations of key characteristics (n, k)."""
    lower, upper = limits(scene)
    return np.where(np.isfinite(upper - lower), upper - lower, 6 * h.std(axis=0))


def _training_points(scene: Scene, stream: np.random.Generator, count: int) -> np.ndarray:
    """(n, p) training assemblies around the mean one."""
    z = SPREAD * stream.standard_normal((count, len(scene.deviations)))
    return from_normal(scene, np.clip(z, -REACH, REACH))


def _cache_key(model, law: str) -> str:
    """A checksum of all inputs of the training."""
    inputs = {
        "model": identity(model, 0),
        "law": law,
        "how": [REACH, SPREAD, MIN_ASSEMBLIES, BATCH, BATCHES, FINE],
        "limits": [[float(end) for end in item.bounds] for item in model.scene.measurements],
    }
    return fingerprint(inputs)
