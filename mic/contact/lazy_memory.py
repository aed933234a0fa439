"""Large arrays of which only the written pages take memory."""

from __future__ import annotations

from mmap import MAP_ANONYMOUS, MAP_PRIVATE, mmap

import numpy as np

__all__ = ["lazy_zeros"]


def lazy_zeros(*shape: int) -> np.ndarray:
    """Array of zeros whose pages take memory only once written; not shared between processes.

    ``np.zeros`` does not guarantee this: the allocator that MPI installs writes to all memory.
    """
    size = int(np.prod(shape))
    if not size:
        return np.zeros(shape)
    return np.frombuffer(mmap(-1, 8 * size, flags=MAP_PRIVATE | MAP_ANONYMOUS), float, size).reshape(shape)
