"""The same bits, in whatever batch a sample comes and on however many threads.

BLAS adds up a row of ``X A`` in another order when X has another number of rows, and when more threads share it. The
last bit that this moves is enough for a contact to take the other of two ways. So a product is compiled here, a sample
at a time; it passes over entries of X that vanish, and most contacts carry no force.
"""

from __future__ import annotations

import functools
from collections.abc import Callable
from threading import local
from typing import ParamSpec, TypeVar

import numpy as np
from threadpoolctl import ThreadpoolController

__all__ = ["one_thread", "product"]

P = ParamSpec("P")
T = TypeVar("T")


def one_thread(function: Callable[P, T]) -> Callable[P, T]:
    """`function` with one BLAS thread, however many the caller has; small products are faster so, too."""

    @functools.wraps(function)
    def alone(*args: P.args, **kwargs: P.kwargs) -> T:
        if getattr(_within, "one", False):  # asking the libraries takes as long as a small product
            return function(*args, **kwargs)
        with _threadpools().limit(limits=1, user_api="blas"):
            _within.one = True
            try:
                return function(*args, **kwargs)
            finally:
                _within.one = False

    return alone


_within = local()  # of each thread: whether it is in such a function


@functools.cache
def _threadpools() -> ThreadpoolController:
    """Found once, when first asked for: looking for libraries takes longer than a sample."""
    return ThreadpoolController()


def product(samples: np.ndarray, matrix: np.ndarray, found: np.ndarray | None = None) -> np.ndarray:
    """``X A``, one sample a row.

    Parameters
    ----------
    samples : (n, k) array
        X.
    matrix : (k, l) array
        A. Where its rows do not lie one after the other in memory, as those of a transpose, they are copied.
    found : (n, l) array, optional
        What the product is added to, in place.

    Returns
    -------
    (n, l) array
    """
    found = np.zeros((len(samples), matrix.shape[1])) if found is None else found
    if samples.size and matrix.size:
        samples = samples if samples.flags.c_contiguous else np.ascontiguousarray(samples)
        matrix = matrix if matrix.flags.c_contiguous else np.ascontiguousarray(matrix)
        _compiled()(samples, matrix, found)
    return found


@functools.cache
def _compiled() -> Callable[[np.ndarray, np.ndarray, np.ndarray], None]:
    from numba import float64, njit, void  # slow to import, and most commands multiply nothing

    def add(X, A, found):
        """``found += X A``, eight rows of A at a time."""
        columns = A.shape[1]
        for sample in range(len(X)):
            x, row = X[sample], found[sample]
            own = np.flatnonzero(x)
            whole = len(own) - len(own) % 8
            for i in range(0, whole, 8):
                k0, k1, k2, k3, k4, k5, k6, k7 = own[i : i + 8]
                x0, x1, x2, x3, x4, x5, x6, x7 = x[k0], x[k1], x[k2], x[k3], x[k4], x[k5], x[k6], x[k7]
                A0, A1, A2, A3, A4, A5, A6, A7 = A[k0], A[k1], A[k2], A[k3], A[k4], A[k5], A[k6], A[k7]
                for j in range(columns):
                    first = x0 * A0[j] + x1 * A1[j] + x2 * A2[j] + x3 * A3[j]
                    row[j] += first + (x4 * A4[j] + x5 * A5[j] + x6 * A6[j] + x7 * A7[j])
            for k in own[whole:]:
                one, Ak = x[k], A[k]
                for j in range(columns):
                    row[j] += one * Ak[j]

    matrix = float64[:, ::1]
    signature = void(matrix, matrix, matrix)
    settings = {"nogil": True, "error_model": "numpy", "fastmath": {"contract"}}
    try:
        return njit(signature, cache=True, **settings)(add)
    except RuntimeError:  # where no folder can be written, neither here nor at home
        return njit(signature, **settings)(add)
