"""Answers that are learnt before anything is asked: assemblies on all sides, a spline between them, what it errs by.

By how much the spline misses an assembly is told by those that it was made of, each left out in turn, as a share of
how far it is off the others, the median at least. Below the r-th largest of n such shares lie, with a confidence of
0.95, no fewer than 0.95 of all, whatever their distribution [1]_: below the largest of 59, the second of 93. The
assemblies asked for scatter less than those that were learnt from, and each of them is answered by one assembly more.

What an adjustment changes is learnt by itself: assemblies that are known are evaluated again, each adjusted in one way;
and where nothing is adjusted, nothing changes.

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

__all__ = ["REACH", "Learnt", "learn", "tolerance"]

#: standard deviations: between assemblies so far off their means is learnt, and nothing beyond them is answered
REACH = 3.0
WIDER = 1.5  # standard deviations of those
LEAST = 59  # assemblies whose largest miss covers 0.95 with a confidence of 0.95: 0.95⁵⁹ < 0.05
BATCH, BATCHES = 16, 8  # assemblies that are added, until what the spline errs by is small enough, and how often
#: of the tolerance: what the spline errs by is small enough. A gauge whose six standard deviations take a tenth of the
#: tolerance is coarser by 1 % if it has this beside its own
FINE = 5e-3
SPANNED = 4.0  # standard deviations: as the scaled numbers see them, an adjustment from its one bound to the other
KEPT = Format("set of assemblies learnt from", 1, ABSENT)


@dataclass(frozen=True)
class Learnt:
    """Key characteristics of assemblies between those that were evaluated, or what adjustments change of them.

    Attributes
    ----------
    mean, scale : (p,) array
        Of the deviations, adjustments after them; what never varies has a scale of 0.
    x : (n, p) array
        What is known.
    h : (n, k) array
        What was found there, mm.
    judged : (n,) array of bool
        Which of them tell what the spline errs by.
    """

    mean: np.ndarray
    scale: np.ndarray
    x: np.ndarray
    h: np.ndarray
    judged: np.ndarray
    emulator: Emulator = field(init=False, repr=False)
    off: np.ndarray = field(init=False)  #: (k,) what it errs by in 95 %, in the midst of them, mm
    _midst: float = field(init=False)
    _farthest: float = field(init=False)

    def __post_init__(self):
        u = self._scaled(self.x)
        emulator = Emulator(u, self.h)
        missed, apart = (one[self.judged] for one in emulator.left_out())
        midst = float(np.median(apart))
        shares = np.abs(missed) / np.maximum(apart / midst, 1.0)[:, None]
        rank = min(int(binom.ppf(LEVEL, len(shares), LEVEL)), len(shares) - 1)
        object.__setattr__(self, "emulator", emulator)
        object.__setattr__(self, "off", np.sort(shares, axis=0)[rank])
        object.__setattr__(self, "_midst", midst)
        object.__setattr__(self, "_farthest", float(np.linalg.norm(u[self.judged], axis=1).max()))

    def covers(self, x: np.ndarray) -> bool:
        """Whether an assembly (p,) lies between those that were learnt from."""
        u = self._scaled(x)
        return bool((np.abs(u) <= REACH).all() and np.linalg.norm(u) <= self._farthest)

    def __call__(self, x: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Key characteristics (m, k) of assemblies (m, p), and what they err by (m, k), mm."""
        u = self._scaled(x)
        return self.emulator(u), np.maximum(self.emulator.apart(u) / self._midst, 1.0)[:, None] * self.off

    def _scaled(self, x: np.ndarray) -> np.ndarray:
        varied = self.scale > 0
        return (x[..., varied] - self.mean[varied]) / self.scale[varied]


def learn(
    model: ReducedModel,
    law: str,
    some: Sequence[Adjustment] = (),
    before: Learnt | None = None,
    cache: Path | None = None,
    progress: Callable[[int], None] = lambda count: None,
) -> Learnt | None:
    """Evaluate assemblies until the spline between them errs by little, or the patience is at its end.

    Parameters
    ----------
    model : ReducedModel
    law : str
        Contact law.
    some : sequence of Adjustment
        With ``before``, what may be adjusted, and is learnt; the changes stand after the deviations.
    before : Learnt, optional
        What was learnt without adjustments.
    cache : Path, optional
        Folder in which what was evaluated is kept for the next time.
    progress : callable, optional
        Called with the number of evaluations that were done.

    Returns
    -------
    Learnt, or None
        None where too few of the assemblies can be computed.
    """
    scene, p, a = model.scene, len(model.scene.deviations), len(some)
    mean = np.array([item.mean for item in scene.deviations] + [0.0] * a)
    scale = np.array([item.sigma for item in scene.deviations] + [(one.high - one.low) / SPANNED for one in some])
    kept, own = _kept(cache, model, law, some, before)
    if kept is not None and (answered := kept.load(own)) is not None:
        return Learnt(mean, scale, *(answered[1][name] for name in ("x", "h", "judged")))
    stream = np.random.default_rng([0, a])
    process = (extended(model, some)[0] if some else model).process(law)
    x, h, drawn = np.empty((0, p + a)), np.empty((0, len(scene.measurements))), 0
    if before is not None:
        x = np.pad(_spread(scene, stream, LEAST), ((0, 0), (0, a)))
        h = np.zeros((LEAST, h.shape[1]))
    free, found = len(x), None
    for count in (max(LEAST, p + p // 2 + 3 * a), *[BATCH] * BATCHES):
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
        found = Learnt(mean, scale, x, h, np.arange(len(x)) >= free)
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
    """(n, p) assemblies on all sides of the mean one."""
    z = WIDER * stream.standard_normal((count, len(scene.deviations)))
    return from_normal(scene, np.clip(z, -REACH, REACH))


def _changes(some: Sequence[Adjustment], which: np.ndarray, stream: np.random.Generator) -> np.ndarray:
    """(n, a) changes of one adjustment each, in turn."""
    found, share = np.zeros((len(which), len(some))), stream.random(len(which))
    for i, turn in enumerate(which if some else ()):
        own = some[turn % len(some)]
        found[i, turn % len(some)] = own.low + (own.high - own.low) * share[i]
    return found


def _kept(cache: Path | None, model, law: str, some, before: Learnt | None) -> tuple[Cache | None, str]:
    """Where it is kept, and the identity of all that it hangs on."""
    if cache is None:
        return None, ""
    asked = {
        "model": identity(model, 0),
        "law": law,
        "some": [[one.name, one.low, one.high] for one in some],
        "before": [] if before is None else [fingerprint(one.tobytes()) for one in (before.x, before.h)],
        "how": [REACH, WIDER, LEAST, BATCH, BATCHES, FINE, SPANNED],
        "limits": [[float(end) for end in item.bounds] for item in model.scene.measurements],
    }
    return Cache(cache, "answers", KEPT), fingerprint(asked)
