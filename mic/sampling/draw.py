"""Random deviations of the scene, one independent stream per sample."""

from __future__ import annotations

import numpy as np

__all__ = ["draw"]


def draw(scene, seed: int, first: int, count: int) -> np.ndarray:
    """Deviations of samples ``first … first + count - 1``.

    Each sample has its own counter-based stream, keyed by the seed and the sample's number, so its values depend neither
    on how samples are batched nor on the order in which they are drawn.

    Parameters
    ----------
    scene : mic.scene.schema.Scene
    seed : int
    first, count : int

    Returns
    -------
    (count, p) array
        In the units of the scene's deviations.
    """
    mean = np.array([deviation.mean for deviation in scene.deviations])
    sigma = np.array([deviation.sigma for deviation in scene.deviations])
    uniform = np.array([deviation.distribution == "uniform" for deviation in scene.deviations], dtype=bool)
    values = np.empty((count, len(mean)))
    for i in range(count):
        stream = np.random.Generator(np.random.Philox(key=np.array([seed, first + i], dtype=np.uint64)))
        standard = stream.standard_normal(len(mean))
        spread = stream.uniform(-np.sqrt(3), np.sqrt(3), len(mean))  # unit standard deviation
        values[i] = mean + sigma * np.where(uniform, spread, standard)
    return values
