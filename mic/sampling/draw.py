"""Random deviations of the scene, one independent stream per sample."""

from __future__ import annotations

import numpy as np

from mic.sampling.distributions import DISTRIBUTIONS

__all__ = ["draw"]


def draw(scene, seed: int, first: int, count: int) -> np.ndarray:
    """Deviations of samples ``first … first + count - 1``.

    Each sample has its own counter-based stream, keyed by the seed and the sample's number, so its values depend
    neither on how samples are batched nor on the order in which they are drawn.

    Parameters
    ----------
    scene : mic.scene.Scene
    seed : int
    first, count : int

    Returns
    -------
    (count, p) array
        In the units of the scene's deviations.
    """
    mean = np.array([deviation.mean for deviation in scene.deviations])
    sigma = np.array([deviation.sigma for deviation in scene.deviations])
    chosen = np.array([list(DISTRIBUTIONS).index(item.distribution) for item in scene.deviations], dtype=int)
    values = np.empty((count, len(mean)))
    for i in range(count):
        stream = np.random.Generator(np.random.Philox(key=np.array([seed, first + i], dtype=np.uint64)))
        standard = np.array([distribution(stream, len(mean)) for distribution in DISTRIBUTIONS.values()])
        values[i] = mean + sigma * standard[chosen, np.arange(len(mean))]
    return values
