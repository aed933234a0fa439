"""Random deviations of the scene, one independent stream per sample."""

from __future__ import annotations

import numpy as np

from mic.sampling.distributions import DISTRIBUTIONS

__all__ = ["draw"]


def draw(scene, seed: int, first: int, count: int) -> np.ndarray:
    """Deviations of samples ``first … first + count - 1``.

    Each sample has its own counter-based stream, keyed by the seed and the sample's number, so its values depend
    neither on how samples are batched nor on the order in which they are drawn. Deviations with scores take those of
    one measured piece, the same for a whole batch, drawn after the distributions.

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
    pieces = _pieces(scene)
    values = np.empty((count, len(mean)))
    for i in range(count):
        stream = np.random.Generator(np.random.Philox(key=np.array([seed, first + i], dtype=np.uint64)))
        standard = np.array([distribution(stream, len(mean)) for distribution in DISTRIBUTIONS.values()])
        amplitude = standard[chosen, np.arange(len(mean))]
        for own, scores in pieces:
            amplitude[own] = scores[:, stream.integers(scores.shape[1])]
        values[i] = mean + sigma * amplitude
    return values


def _pieces(scene) -> list[tuple[list[int], np.ndarray]]:
    """Of each batch of measured pieces, its deviations, and the scores (k, n) that its n pieces have in them."""
    batches: dict[str, list[int]] = {}
    for j, item in enumerate(scene.deviations):
        if getattr(item, "scores", None) is not None:
            batches.setdefault(item.batch or item.name, []).append(j)
    return [(own, np.array([scene.deviations[j].scores for j in own])) for own in batches.values()]
