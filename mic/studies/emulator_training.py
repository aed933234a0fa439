"""Train a spline emulator of the key characteristics, with a bound of its error.

The error of the spline is estimated by leave-one-out cross-validation, relative to the distance from the other
assemblies (at least the median distance). The r-th largest of n such errors is a distribution-free tolerance limit
[1]_: with a confidence of 0.95 it covers at least 0.95 of all errors for r = 1 and n = 59, or r = 2 and n = 93.
Training assemblies scatter more widely than predicted ones.

The effect of adjustments is trained separately: training assemblies are evaluated again with one adjustment each, and
the effect is zero without adjustments.

References
----------
.. [1] S. S. Wilks: Determination of sample sizes for setting tolerance limits, Ann. Math. Stat. 12 (1941) 91-96.
"""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import numpy as np
from scipy.stats import binom

from mic.process.model import ReducedModel
from mic.results.run_identity import identity
from mic.scene import Scene
from mic.statistics.emulator import Emulator
from mic.statistics.estimates import LEVEL
from mic.statistics.normal_space import from_normal
from mic.studies.adjustment import Adjustment, with_adjustments
from mic.studies.samples import Progress, limits
from mic.system.disk_cache import ABSENT, Cache
from mic.system.files import Format, fingerprint

__all__ = ["REACH", "AssemblyEmulator", "train_emulator", "tolerance"]

#: range of the training in standard deviations; nothing is predicted beyond it
REACH = 3.0
SPREAD = 1.5  # standard deviation of the training assemblies, relative to the scene's
MIN_ASSEMBLIES = 59  # assemblies for a tolerance limit of 0.95 with a confidence of 0.95: 0.95⁵⁹ < 0.05
BATCH, BATCHES = 16, 8  # assemblies per refinement, and largest number of refinements
#: sufficient error of the spline relative to the tolerance. It increases the uncertainty of a gauge whose six standard
#: deviations are a tenth of the tolerance by 1 %.
FINE = 5e-3
SPANNED = 4.0  # scaled range of an adjustment between its bounds
FORMAT = Format("set of training assemblies", 1, ABSENT)


class AssemblyEmulator:
    """Emulator of the key characteristics of assemblies, or of the changes that adjustments cause.

    Parameters
    ----------
    mean, scale : (p,) array
        Mean and scale of the deviations, followed by those of the adjustments; the scale of constants is 0.
    x : (n, p) array
        Training points.
    h : (n, k) array
        Values at them, mm.
    validation : (n,) array of bool
        Points that are used for cross-validation.

    Attributes
    ----------
    error_bound : (k,) array
        Bound of 95 % of the errors at the median distance, mm.
    """

    def __init__(self, mean: np.ndarray, scale: np.ndarray, x: np.ndarray, h: np.ndarray, validation: np.ndarray):
        self.mean, self.scale, self.x, self.h, self.validation = mean, scale, x, h, validation
        u = self._scaled(x)
        self.emulator = Emulator(u, h)
        errors, distance = (array[validation] for array in self.emulator.leave_one_out())
        self._midst = float(np.median(distance))
        shares = np.abs(errors) / np.maximum(distance / self._midst, 1.0)[:, None]
        rank = min(int(binom.ppf(LEVEL, len(shares), LEVEL)), len(shares) - 1)
        self.error_bound = np.sort(shares, axis=0)[rank]
        self._farthest = float(np.linalg.norm(u[validation], axis=1).max())

    def covers(self, x: np.ndarray) -> bool:
        """Whether an assembly (p,) lies within the range of the training."""
        u = self._scaled(x)
        return bool((np.abs(u) <= REACH).all() and np.linalg.norm(u) <= self._farthest)

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
    available: Sequence[Adjustment] = (),
    base: AssemblyEmulator | None = None,
    cache: Path | None = None,
    progress: Progress = lambda count: None,
) -> AssemblyEmulator | None:
    """Evaluate assemblies until the error of the spline is small enough or their largest number is reached.

    Parameters
    ----------
    model : ReducedModel
    law : str
        Contact law.
    available : sequence of Adjustment
        With `base`: the adjustments whose effect is trained; their columns follow the deviations.
    base : AssemblyEmulator, optional
        Emulator without adjustments.
    cache : Path, optional
        Folder of the disk cache for the training assemblies.
    progress : callable, optional
        Called with the number of evaluations since the last call.

    Returns
    -------
    AssemblyEmulator, or None
        None if too few of the assemblies can be computed.
    """
    scene, p, a = model.scene, len(model.scene.deviations), len(available)
    mean = np.array([item.mean for item in scene.deviations] + [0.0] * a)
    scale = np.array(
        [item.sigma for item in scene.deviations] + [(item.high - item.low) / SPANNED for item in available]
    )
    stored = None if cache is None else Cache(cache, "answers", FORMAT)
    key = _cache_key(model, law, available, base)
    if stored is not None and (entry := stored.load(key)) is not None:
        return AssemblyEmulator(mean, scale, *(entry[1][name] for name in ("x", "h", "judged")))
    stream = np.random.default_rng([0, a])
    process = (with_adjustments(model, available)[0] if available else model).process(law)
    # The effect of no adjustment is 0.
    given = 0 if base is None else MIN_ASSEMBLIES
    x = np.pad(_training_points(scene, stream, given), ((0, 0), (0, a)))
    h, drawn, emulator = np.zeros((given, len(scene.measurements))), 0, None
    for count in (max(MIN_ASSEMBLIES, p + p // 2 + 3 * a), *[BATCH] * BATCHES):
        numbers = np.arange(drawn, drawn + count)
        points = _training_points(scene, stream, count) if base is None else base.x[numbers % len(base.x)]
        points = np.concatenate([points, _training_changes(available, numbers, stream)], axis=1)
        evaluation = process.attempt(points)
        values = evaluation.measurements if base is None else evaluation.measurements - base.h[numbers % len(base.h)]
        x, h = np.concatenate([x, points[~evaluation.failed]]), np.concatenate([h, values[~evaluation.failed]])
        progress(count)
        drawn += count
        if len(x) - given < np.count_nonzero(scale) + 3:
            continue
        emulator = AssemblyEmulator(mean, scale, x, h, np.arange(len(x)) >= given)
        if (emulator.error_bound <= FINE * tolerance(scene, h if base is None else base.h)).all():
            break
    if stored is not None and emulator is not None:
        stored.store(key, {}, {"x": emulator.x, "h": emulator.h, "judged": emulator.validation})
    return emulator


def tolerance(scene: Scene, h: np.ndarray) -> np.ndarray:
    """(k,) tolerances, mm; with a single limit, six standard deviations of key characteristics (n, k)."""
    lower, upper = limits(scene)
    return np.where(np.isfinite(upper - lower), upper - lower, 6 * h.std(axis=0))


def _training_points(scene: Scene, stream: np.random.Generator, count: int) -> np.ndarray:
    """(n, p) training assemblies around the mean one."""
    z = SPREAD * stream.standard_normal((count, len(scene.deviations)))
    return from_normal(scene, np.clip(z, -REACH, REACH))


def _training_changes(available: Sequence[Adjustment], numbers: np.ndarray, stream: np.random.Generator) -> np.ndarray:
    """(n, a) random changes of one adjustment per assembly, in turn."""
    changes, share = np.zeros((len(numbers), len(available))), stream.random(len(numbers))
    for i, number in enumerate(numbers if available else ()):
        adjustment = available[number % len(available)]
        changes[i, number % len(available)] = adjustment.low + (adjustment.high - adjustment.low) * share[i]
    return changes


def _cache_key(model, law: str, available, base: AssemblyEmulator | None) -> str:
    """A checksum of all inputs of the training."""
    inputs = {
        "model": identity(model, 0),
        "law": law,
        "some": [[item.name, item.low, item.high] for item in available],
        "before": [] if base is None else [fingerprint(item.tobytes()) for item in (base.x, base.h)],
        "how": [REACH, SPREAD, MIN_ASSEMBLIES, BATCH, BATCHES, FINE, SPANNED],
        "limits": [[float(end) for end in item.bounds] for item in model.scene.measurements],
    }
    return fingerprint(inputs)
