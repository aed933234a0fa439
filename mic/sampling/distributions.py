"""Distributions of deviations, by the word that the scene uses for them; each of mean 0 and standard deviation 1."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

__all__ = ["DISTRIBUTIONS"]


def _normal(stream: np.random.Generator, count: int) -> np.ndarray:
    return stream.standard_normal(count)


def _uniform(stream: np.random.Generator, count: int) -> np.ndarray:
    return stream.uniform(-np.sqrt(3), np.sqrt(3), count)


#: Name → ``draw(stream, count)``. All of them draw from every sample's stream, in this order: a new one goes to the
#: end, or the samples of present scenes change.
DISTRIBUTIONS: dict[str, Callable[[np.random.Generator, int], np.ndarray]] = {"normal": _normal, "uniform": _uniform}
