"""Measure wall time, processor time and peak memory of a piece of work."""

from __future__ import annotations

import ctypes
import gc
import os
import resource
import time
from dataclasses import dataclass
from pathlib import Path

__all__ = ["Cost", "Meter", "give_back", "together"]

PROC = Path("/proc/self")
KILO = 1024e-9  # GB in what Linux counts memory in
LARGER = 1.05  # a child process with more than this times the peak of its parent has memory of its own


@dataclass(frozen=True)
class Cost:
    """Time and memory that one process used for one study.

    Attributes
    ----------
    process : int
        Rank.
    began : float
        Start, s since 1970.
    wall : float
        Wall time, s.
    cpu : float
        Processor time including child processes, s.
    memory : float
        Peak memory of the process, plus that of its largest child process if that is larger, GB.
    """

    process: int
    began: float
    wall: float
    cpu: float
    memory: float


class Meter:
    """Measures from its creation, at which freed memory is returned to the system."""

    def __init__(self, process: int):
        self.process = process
        give_back()
        try:
            (PROC / "clear_refs").write_text("5")  # Linux resets its peak
        except OSError:
            pass  # the peak then counts from the start of the process
        self.began, self.start, self.cpu, self.called = time.time(), time.perf_counter(), _cpu(), _program()

    def read(self) -> Cost:
        """Cost so far."""
        wall, memory, called = time.perf_counter() - self.start, _most(), _program()
        # Linux includes the memory of the parent at the call: `true` called by a process of 5 GB counts as 5 GB.
        if called > max(self.called, LARGER * memory):
            memory += called
        return Cost(self.process, self.began, wall, _cpu() - self.cpu, memory)


def give_back(beyond: float = 0.0) -> None:
    """Return freed memory to the system if the process is larger than `beyond` GB: under MPI glibc does not."""
    if beyond and _status("VmRSS") <= beyond:
        return
    gc.collect()
    trim = getattr(ctypes.CDLL(None), "malloc_trim", None)  # glibc's own
    if trim is not None:
        trim(0)


def together(costs: list[Cost]) -> float:
    """Upper bound of the simultaneous memory of all processes, GB, from the peaks of overlapping studies."""
    most = 0.0
    for cost in costs:
        overlapping: dict[int, float] = {}
        for other in costs:
            if other.began < cost.began + cost.wall and cost.began < other.began + other.wall:
                overlapping[other.process] = max(overlapping.get(other.process, 0.0), other.memory)
        most = max(most, sum(overlapping.values()) - overlapping[cost.process] + cost.memory)
    return most


def _cpu() -> float:
    """Processor time of this process and its finished child processes, s."""
    return sum(os.times()[:4])


def _program() -> float:
    """Peak memory of the largest finished child process, GB; at least that of this process at the call."""
    return resource.getrusage(resource.RUSAGE_CHILDREN).ru_maxrss * KILO


def _most() -> float:
    """Peak memory of this process, GB."""
    return _status("VmHWM") or resource.getrusage(resource.RUSAGE_SELF).ru_maxrss * KILO


def _status(key: str) -> float:
    """Entry of this process's /proc status, GB; 0 on other systems than Linux."""
    try:
        status = dict(line.split(":", 1) for line in (PROC / "status").read_text().splitlines())
        return float(status[key].split()[0]) * KILO
    except (OSError, KeyError):
        return 0.0
