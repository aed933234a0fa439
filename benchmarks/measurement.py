"""Processor time, peak memory and growth of costs with the size of a problem."""

from __future__ import annotations

import multiprocessing
import time
from collections.abc import Callable, Sequence
from pathlib import Path

import numpy as np

__all__ = ["alone", "exponents", "peak_memory", "timed"]


def timed(work: Callable, *arguments):
    """Result of a call, and its processor seconds."""
    start = time.process_time()
    result = work(*arguments)
    return result, time.process_time() - start


def peak_memory() -> float:
    """Peak resident memory of this process, MB; unlike that of getrusage, without the process that started it."""
    (line,) = [line for line in Path("/proc/self/status").read_text().splitlines() if line.startswith("VmHWM:")]
    return int(line.split()[1]) / 1e3


def exponents(size: Sequence[float], costs: dict[str, Sequence[float]]) -> str:
    """The least-squares exponent of each cost in ``cost = c sizeᵉ``, in one line; at least two sizes."""
    logs = np.log(size)
    return ", ".join(f"{name} {np.polyfit(logs, np.log(values), 1)[0]:.2f}" for name, values in costs.items())


def alone(work: Callable, *arguments):
    """Result of a call in a process of its own, and the peak memory of that process, MB."""
    with multiprocessing.get_context("spawn").Pool(1) as pool:
        return pool.apply(_measured, (work, arguments))


def _measured(work, arguments):
    return work(*arguments), peak_memory()
