"""Deviations as functions of independent standard normal numbers, with derivatives.

Distributions, truncation and correlation are those of :func:`mic.statistics.draw.at_probabilities`. Mode amplitudes,
which samples take from measured pieces, are normal here.
"""

from __future__ import annotations

import numpy as np
from scipy.special import ndtr

from mic.statistics.draw import from_random_numbers

__all__ = ["from_normal", "normal_derivatives"]

STEP = 1e-4  # of a standard normal number in central differences; error about 1e-8


def from_normal(scene, z: np.ndarray) -> np.ndarray:
    """Deviations (n, p) from standard normal numbers (n, p).

    Parameters
    ----------
    scene : mic.scene.Scene
    z : (n, p) array
        One number for each deviation, in their order.
    """
    items = [
        item.model_copy(update={"scores": None}) if getattr(item, "scores", None) is not None else item
        for item in scene.deviations
    ]
    uniform = np.sqrt(3) * (2 * ndtr(z) - 1)
    no_pieces = np.empty((len(z), 0), dtype=int)
    return from_random_numbers(scene.model_copy(update={"deviations": items}), z.copy(), uniform, no_pieces)


def normal_derivatives(scene, z: np.ndarray) -> np.ndarray:
    """(n, p, p) derivatives of the deviations (second axis) with respect to the numbers (third)."""
    n, p = z.shape
    derivatives = np.empty((n, p, p))
    for j in range(p):
        above, below = (from_normal(scene, z + step * np.eye(p)[j]) for step in (STEP, -STEP))
        derivatives[:, :, j] = (above - below) / (2 * STEP)
    return derivatives
