"""The same bits, in whatever batch a sample comes and on however many threads.

BLAS adds up a row of ``X A`` in another order when X has another number of rows, and when more threads share it. The
last bit that this moves is enough for a contact to take the other of two ways.
"""

from __future__ import annotations

import functools
from collections.abc import Callable
from typing import ParamSpec, TypeVar

import numpy as np
from threadpoolctl import ThreadpoolController

__all__ = ["one_thread", "product"]

#: Samples that BLAS is handed at a time, always: whole tiles of its kernels, so that it treats all of them alike.
TILE = 8

P = ParamSpec("P")
T = TypeVar("T")


def one_thread(function: Callable[P, T]) -> Callable[P, T]:
    """`function` with one BLAS thread, however many the caller has; small products are faster so, too."""

    @functools.wraps(function)
    def alone(*args: P.args, **kwargs: P.kwargs) -> T:
        with _threadpools().limit(limits=1, user_api="blas"):
            return function(*args, **kwargs)

    return alone


@functools.cache
def _threadpools() -> ThreadpoolController:
    """Found once, when first asked for: looking for libraries takes longer than a sample."""
    return ThreadpoolController()


def product(samples: np.ndarray, matrix: np.ndarray) -> np.ndarray:
    """``X A``, one sample a row.

    Parameters
    ----------
    samples : (n, k) array
        X.
    matrix : (k, l) array
        A.

    Returns
    -------
    (n, l) array
    """
    (n, k), tiles = samples.shape, -(-len(samples) // TILE)
    padded = np.zeros((tiles * TILE, k))
    padded[:n] = samples
    return np.matmul(padded.reshape(tiles, TILE, k), matrix).reshape(tiles * TILE, matrix.shape[1])[:n]
