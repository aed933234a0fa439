"""The ramp of a step: how its load grows, on which friction depends.

With s from 0 to 1 over a step, bilateral rows go from their previous readings to their targets, ``v(s) = v⁰ + s (v¹ −
v⁰)``; clamp forces grow from their previous values; released rows and removed forces fade, ``p(s) = p⁰ + s (p¹ − p⁰)``.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

__all__ = ["Ramp"]


@dataclass(frozen=True)
class Ramp:
    """Values and loads of n assemblies that grow together over a step.

    Attributes
    ----------
    value_start, value_end : (n, b) array
        Of the bilateral rows, mm and rad.
    load_start, load_end : (n, l) array
        Of the load rows, N and N mm.
    """

    value_start: np.ndarray
    value_end: np.ndarray
    load_start: np.ndarray
    load_end: np.ndarray

    def at(self, s: float) -> tuple[np.ndarray, np.ndarray]:
        """Values and loads at s."""
        return (
            self.value_start + s * (self.value_end - self.value_start),
            self.load_start + s * (self.load_end - self.load_start),
        )
