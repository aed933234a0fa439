"""Room for what may come, of which little does."""

from __future__ import annotations

from mmap import MAP_ANONYMOUS, MAP_PRIVATE, mmap

import numpy as np

__all__ = ["untouched"]


def untouched(*shape: int) -> np.ndarray:
    """Zeros that take memory where they are written, and nowhere else: from the system, for the allocator that MPI
    brings along writes all that it gives. Processes do not share them."""
    size = int(np.prod(shape))
    if not size:
        return np.zeros(shape)
    return np.frombuffer(mmap(-1, 8 * size, flags=MAP_PRIVATE | MAP_ANONYMOUS), float, size).reshape(shape)
