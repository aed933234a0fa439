"""Forecast of a path from a few pilot samples: which contacts close, and how their forces change."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.spatial.distance import cdist

__all__ = ["PathForecast"]


@dataclass(frozen=True)
class PathForecast:
    """Closed contacts and force changes of a few pilot samples with m contacts, as the start of further samples.

    Attributes
    ----------
    touching : (m,) bool array
        Contacts that carried force at the end in any pilot sample.
    load : (k, m) array
        Gaps without contact forces at the end of the path, in k pilot samples, mm.
    change : (k, d m) array
        Changes of the contact forces along the path, N.
    """

    touching: np.ndarray
    load: np.ndarray
    change: np.ndarray

    @classmethod
    def empty(cls, m: int, d: int) -> PathForecast:
        """Forecast from no samples."""
        return cls(np.zeros(m, dtype=bool), np.empty((0, m)), np.empty((0, d * m)))

    def forces(self, load: np.ndarray, force: np.ndarray) -> np.ndarray:
        """(n, d m) forecast at the end of a path that starts with forces (n, d m) and ends with gaps `load` (n, m): the
        change is that of the pilot sample with the nearest gaps; no force at contacts without pressure."""
        if not len(self.load):
            return np.zeros_like(force)
        forecast = (force + self.change[cdist(load, self.load).argmin(axis=1)]).reshape(*load.shape, -1)
        return np.where(forecast[:, :, :1] > 0.0, forecast, 0.0).reshape(force.shape)
