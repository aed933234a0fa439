"""Exponents of growth: costs as powers of the size of a problem, and measurements in processes of their own."""

from __future__ import annotations

import multiprocessing
import resource
from collections.abc import Callable, Sequence

import numpy as np

__all__ = ["alone", "exponents"]


def exponents(size: Sequence[float], costs: dict[str, Sequence[float]]) -> str:
    """The least-squares exponent of each cost in ``cost = c sizeᵉ``, in one line; at least two sizes."""
    logs = np.log(size)
    return ", ".join(f"{name} {np.polyfit(logs, np.log(values), 1)[0]:.2f}" for name, values in costs.items())


def alone(work: Callable, *arguments):
    """The result of a call in a process of its own, and the peak memory of that process, MB."""
    with multiprocessing.get_context("spawn").Pool(1) as pool:
        return pool.apply(_measured, (work, arguments))


def _measured(work, arguments):
    result = work(*arguments)
    return result, resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024
