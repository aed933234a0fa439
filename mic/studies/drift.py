"""Drift of incoming deviations: do the last assemblies come from the scene's distributions?

A deviation becomes a standard normal number z by its distribution (:func:`mic.scene.distribution.normal_scores`). Of
the last n assemblies, ``√n z̄`` is standard normal and ``Σ (z − z̄)²`` has a χ² distribution with n − 1 degrees of
freedom, unless the deviation has drifted. A short window shows a large drift soon, a long one a small drift. The level
of all tests together is bounded by Bonferroni's inequality.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence

import numpy as np
from scipy.special import chdtr, chdtrc, ndtr

from mic.scene import Scene
from mic.scene.deviation import deviation_unit
from mic.scene.distribution import normal_scores

__all__ = ["WINDOWS", "drifts"]

WINDOWS = (200, 20)  #: numbers of last assemblies that are tested
LEVEL = 2e-5  # probability of a false alarm at one assembly; windows overlap, so that alarms are rarer than assemblies


def drifts(scene: Scene, assemblies: Sequence[Mapping[str, float]]) -> list[str]:
    """One sentence for each deviation that has drifted; none before :data:`WINDOWS` has its smaller number.

    Parameters
    ----------
    scene : Scene
    assemblies : sequence of mapping of str to float
        Known deviations by name, N or mm; the latest last.
    """
    varied = [item for item in scene.deviations if item.sigma > 0]
    level = LEVEL / max(2 * len(varied) * len(WINDOWS), 1)
    found = []
    for item in varied:
        x = np.array([values[item.name] for values in assemblies if item.name in values])
        windows = [x[-n:] for n in WINDOWS if len(x) >= min(n, 2 * min(WINDOWS))]
        found += [sentence for window in windows for sentence in _drift(scene, item, window, level)][:1]
    return found


def _drift(scene: Scene, item, x: np.ndarray, level: float) -> Iterator[str]:
    """Drift of the mean and of the spread of one deviation (n,)."""
    measured = getattr(item, "scores", None) is not None  # amplitudes of measured pieces, of no known distribution
    z = (x - item.mean) / item.sigma if measured else normal_scores(item, x)
    n, unit = len(z), deviation_unit(item, scene)
    if 2 * ndtr(-np.sqrt(n) * abs(z.mean())) < level:
        off = (x.mean() - item.mean) / item.sigma
        yield (
            f"{item.name}: the mean of the last {n} assemblies is {x.mean():.4g} {unit}, {off:+.2g} σ from the scene's "
            f"{item.mean:.4g} {unit}"
        )
    spread = float(((z - z.mean()) ** 2).sum())
    if not measured and 2 * min(chdtr(n - 1, spread), chdtrc(n - 1, spread)) < level:
        ratio = x.std(ddof=1) / item.sigma
        yield f"{item.name}: the standard deviation of the last {n} assemblies is {ratio:.2g} times the scene's"
