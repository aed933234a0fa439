"""What a piece of work takes of the machine: wall and processor seconds, and the most memory of its process."""

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
LARGER = 1.05  # times this process's most: more can only be a program's own


@dataclass(frozen=True)
class Cost:
    """What one process took for one study.

    Attributes
    ----------
    process : int
        Its rank.
    began : float
        s since 1970.
    wall : float
        s.
    cpu : float
        s, those of programs that it called among them.
    memory : float
        GB that the process held at most meanwhile, and the largest program that it called, where that is the larger.
    """

    process: int
    began: float
    wall: float
    cpu: float
    memory: float


class Meter:
    """Runs from when it is made; what was freed before is then given back to the system, and not counted."""

    def __init__(self, process: int):
        self.process = process
        give_back()
        try:
            (PROC / "clear_refs").write_text("5")  # Linux begins anew to look for the most
        except OSError:
            pass  # then it is the most since the process began
        self.began, self.start, self.cpu, self.called = time.time(), time.perf_counter(), _cpu(), _program()

    def read(self) -> Cost:
        """What was taken so far."""
        wall, memory, called = time.perf_counter() - self.start, _most(), _program()
        # Linux counts to what is called what the process held itself just then: `true` called with 5 GB has 5 GB.
        if called > max(self.called, LARGER * memory):
            memory += called
        return Cost(self.process, self.began, wall, _cpu() - self.cpu, memory)


def give_back(beyond: float = 0.0) -> None:
    """Return to the system what was freed, if the process holds more than so many GB: under MPI glibc keeps all."""
    if beyond and _told("VmRSS") <= beyond:
        return
    gc.collect()
    trim = getattr(ctypes.CDLL(None), "malloc_trim", None)  # glibc's own
    if trim is not None:
        trim(0)


def together(costs: list[Cost]) -> float:
    """GB that all processes held at most at a time, no less: each counts with its most of what went on meanwhile."""
    most = 0.0
    for one in costs:
        beside: dict[int, float] = {}
        for other in costs:
            if other.began < one.began + one.wall and one.began < other.began + other.wall:
                beside[other.process] = max(beside.get(other.process, 0.0), other.memory)
        most = max(most, sum(beside.values()) - beside[one.process] + one.memory)
    return most


def _cpu() -> float:
    """s of this process and of those that it called and that have ended."""
    return sum(os.times()[:4])


def _program() -> float:
    """GB of the largest program that this process ever called and that has ended, no less than its own just then."""
    return resource.getrusage(resource.RUSAGE_CHILDREN).ru_maxrss * KILO


def _most() -> float:
    """GB that this process held at most."""
    return _told("VmHWM") or resource.getrusage(resource.RUSAGE_SELF).ru_maxrss * KILO


def _told(key: str) -> float:
    """GB that Linux tells of this process; 0 where it is not Linux."""
    try:
        told = dict(line.split(":", 1) for line in (PROC / "status").read_text().splitlines())
        return float(told[key].split()[0]) * KILO
    except (OSError, KeyError):
        return 0.0
