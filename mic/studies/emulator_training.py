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

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np
from scipy.stats import binom

from mic.process.model import ReducedModel
from mic.results.run_identity import identity
from mic.scene import Scene
from mic.statistics.emulator import Emulator
from mic.statistics.estimates import LEVEL
from mic.statistics.normal_space import from_normal
from mic.studies.adjustment import Adjustment, extended
from mic.system.disk_cache import ABSENT, Cache
from mic.system.files import Format, fingerprint

__all__ = ["REACH", "AssemblyEmulator", "learn", "tolerance"]

#: range of the training in standard deviations; nothing is predicted beyond it
REACH = 3.0
SPREAD = 1.5  # standard deviation of the training assemblies, relative to the scene's
MIN_ASSEMBLIES = 59  # assemblies for a tolerance limit of 0.95 with a confidence of 0.95: 0.95⁵⁹ < 0.05
BATCH, BATCHES = 16, 8  # assemblies per refinement, and largest number of refinements
#: sufficient error of the spline relative to the tolerance. It increases the uncertainty of a gauge whose six standard
#: deviations are a tenth of the tolerance by 1 %.
FINE = 5e-3
SPANNED = 4.0  # scaled range of an adjustment between its bounds
FORMAT = Format("set of assemblies learnt from", 1, ABSENT)


@dataclass(frozen=True)
class AssemblyEmulator:
    """Emulator of the key characteristics of assemblies, or of the changes that adjustments cause.

    Attributes
    ----------
    mean, scale : (p,) array
        Of the deviations, followed by the adjustments; the scale of constants is 0.
    x : (n, p) array
        Training points.
    h : (n, k) array
        Values at them, mm.
    judged : (n,) array of bool
        Points that are used for cross-validation.
    """

    mean: np.ndarray
    scale: np.ndarray
    x: np.ndarray
    h: np.ndarray
    judged: np.ndarray
    emulator: Emulator = field(init=False, repr=False)
    off: np.ndarray = field(init=False)  #: (k,) bound of 95 % of the errors at the median distance, mm
    _midst: float = field(init=False)
    _farthest: float = field(init=False)

    def __post_init__(self):
        u = self._scaled(self.x)
        emulator = Emulator(u, self.h)
        missed, distance = (one[self.judged] for one in emulator.left_out())
        midst = float(np.median(distance))
        shares = np.abs(missed) / np.maximum(distance / midst, 1.0)[:, None]
        rank = min(int(binom.ppf(LEVEL, len(shares), LEVEL)), len(shares) - 1)
        object.__setattr__(self, "emulator", emulator)
        object.__setattr__(self, "off", np.sort(shares, axis=0)[rank])
        object.__setattr__(self, "_midst", midst)
        object.__setattr__(self, "_farthest", float(np.linalg.norm(u[self.judged], axis=1).max()))

    def covers(self, x: np.ndarray) -> bool:
        """Whether an assembly (p,) lies within the range of the training."""
        u = self._scaled(x)
        return bool((np.abs(u) <= REACH).all() and np.linalg.norm(u) <= self._farthest)

    def __call__(self, x: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Key characteristics (m, k) of assemblies (m, p), and bounds of their errors (m, k), mm."""
        u = self._scaled(x)
        return self.emulator(u), np.maximum(self.emulator.apart(u) / self._midst, 1.0)[:, None] * self.off

    def _scaled(self, x: np.ndarray) -> np.ndarray:
        varied = self.scale > 0
        return (x[..., varied] - self.mean[varied]) / self.scale[varied]


def learn(
    model: ReducedModel,
    law: str,
    some: Sequence[Adjustment] = (),
    before: AssemblyEmulator | None = None,
    cache: Path | None = None,
    progress: Callable[[int], None] = lambda count: None,
) -> AssemblyEmulator | None:
    """Evaluate assemblies until the error of the spline is small, or the largest number is reached.

    Parameters
    ----------
    model : ReducedModel
    law : str
        Contact law.
    some : sequence of Adjustment
        With ``before``: the adjustments whose effect is trained; they follow the deviations.
    before : AssemblyEmulator, optional
        Emulator without adjustments.
    cache : Path, optional
        Folder of the disk cache for the training assemblies.
    progress : callable, optional
        Called with the number of evaluations that were done.

    Returns
    -------
    AssemblyEmulator, or None
        None if too few of the assemblies can be computed.
    """
    scene, p, a = model.scene, len(model.scene.deviations), len(some)
    mean = np.array([item.mean for item in scene.deviations] + [0.0] * a)
    scale = np.array([item.sigma for item in scene.deviations] + [(one.high - one.low) / SPANNED for one in some])
    kept, own = _cache_entry(cache, model, law, some, before)
    if kept is not None and (answered := kept.load(own)) is not None:
        return AssemblyEmulator(mean, scale, *(answered[1][name] for name in ("x", "h", "judged")))
    stream = np.random.default_rng([0, a])
    process = (extended(model, some)[0] if some else model).process(law)
    x, h, drawn = np.empty((0, p + a)), np.empty((0, len(scene.measurements))), 0
    if before is not None:
        x = np.pad(_spread(scene, stream, MIN_ASSEMBLIES), ((0, 0), (0, a)))
        h = np.zeros((MIN_ASSEMBLIES, h.shape[1]))
    free, found = len(x), None
    for count in (max(MIN_ASSEMBLIES, p + p // 2 + 3 * a), *[BATCH] * BATCHES):
        which = np.arange(drawn, drawn + count)
        new = _spread(scene, stream, count) if before is None else before.x[which % len(before.x)]
        new = np.concatenate([new, _changes(some, which, stream)], axis=1)
        done = process.attempt(new)
        told = done.measurements if before is None else done.measurements - before.h[which % len(before.h)]
        x, h = np.concatenate([x, new[~done.failed]]), np.concatenate([h, told[~done.failed]])
        progress(count)
        drawn += count
        if len(x) - free < np.count_nonzero(scale) + 3:
            continue
        found = AssemblyEmulator(mean, scale, x, h, np.arange(len(x)) >= free)
        if (found.off <= FINE * tolerance(scene, h if before is None else before.h)).all():
            break
    if kept is not None and found is not None:
        kept.store(own, {}, {"x": found.x, "h": found.h, "judged": found.judged})
    return found


def tolerance(scene: Scene, h: np.ndarray) -> np.ndarray:
    """(k,) widths of the tolerances, mm; of one limit alone six standard deviations of key characteristics (n, k)."""
    lower, upper = np.array([item.bounds for item in scene.measurements]).T
    return np.where(np.isfinite(upper - lower), upper - lower, 6 * h.std(axis=0))


def _spread(scene: Scene, stream: np.random.Generator, count: int) -> np.ndarray:
    """(n, p) training assemblies around the mean one."""
    z = SPREAD * stream.standard_normal((count, len(scene.deviations)))
    return from_normal(scene, np.clip(z, -REACH, REACH))


def _changes(some: Sequence[Adjustment], which: np.ndarray, stream: np.random.Generator) -> np.ndarray:
    """(n, a) changes, each of one adjustment, in turn."""
    found, share = np.zeros((len(which), len(some))), stream.random(len(which))
    for i, turn in enumerate(which if some else ()):
        own = some[turn % len(some)]
        found[i, turn % len(some)] = own.low + (own.high - own.low) * share[i]
    return found


def _cache_entry(
    cache: Path | None, model, law: str, some, before: AssemblyEmulator | None
) -> tuple[Cache | None, str]:
    """The cache and the key of the training assemblies, a checksum of all inputs."""
    if cache is None:
        return None, ""
    asked = {
        "model": identity(model, 0),
        "law": law,
        "some": [[one.name, one.low, one.high] for one in some],
        "before": [] if before is None else [fingerprint(one.tobytes()) for one in (before.x, before.h)],
        "how": [REACH, SPREAD, MIN_ASSEMBLIES, BATCH, BATCHES, FINE, SPANNED],
        "limits": [[float(end) for end in item.bounds] for item in model.scene.measurements],
    }
    return Cache(cache, "answers", FORMAT), fingerprint(asked)
