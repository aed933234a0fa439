"""The processor cores that this process may use."""

import os

__all__ = ["available_cores"]


def available_cores() -> int:
    """Number of cores that this process may use: all of them on systems that bind no process to cores."""
    affinity = getattr(os, "sched_getaffinity", None)  # Linux
    return len(affinity(0)) if affinity else os.cpu_count() or 1
