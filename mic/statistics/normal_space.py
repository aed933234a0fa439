"""Deviations as functions of independent standard normal numbers, with derivatives.

Distributions, truncation and correlation go in as :func:`mic.statistics.draw.placed` has them. Mode
amplitudes, which samples take from measured pieces, are normal here.
"""

from __future__ import annotations

import numpy as np
from scipy.special import ndtr

from mic.statistics.draw import values_of

__all__ = ["from_normal", "normal_slopes"]

STEP = 1e-4  # of a standard normal number in central differences; error about 1e-8


def from_normal(scene, z: np.ndarray) -> np.ndarray:
    """Deviations (n, p) of standard normal numbers (n, p).

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
    flat = np.sqrt(3) * (2 * ndtr(z) - 1)
    return values_of(scene.model_copy(update={"deviations": items}), z.copy(), flat, np.empty((len(z), 0), dtype=int))


def normal_slopes(scene, z: np.ndarray) -> np.ndarray:
    """(n, p, p) derivatives of the deviations (second axis) with respect to the numbers (third)."""
    n, p = z.shape
    found = np.empty((n, p, p))
    for j in range(p):
        ahead, behind = (from_normal(scene, z + step * np.eye(p)[j]) for step in (STEP, -STEP))
        found[:, :, j] = (ahead - behind) / (2 * STEP)
    return found
