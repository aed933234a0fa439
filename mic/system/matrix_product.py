"""Matrix products whose bits do not depend on the batch of a sample or on the number of threads.

BLAS sums a row of ``X A`` in an order that depends on the number of rows of X and of threads, and a difference in the
last bit can change the state of a contact. The compiled product here takes one sample at a time. It skips zero entries
of X, since most contacts carry no force. Models without contact use NumPy instead, because loading Numba takes longer
than all their products.
"""

from __future__ import annotations

import functools
from collections.abc import Callable
from threading import local
from typing import ParamSpec, TypeVar

import numpy as np
from threadpoolctl import ThreadpoolController

__all__ = ["one_thread", "product", "product_of"]

P = ParamSpec("P")
T = TypeVar("T")

SMALL = 10_000  # entries of a matrix up to which a model without contact does without compiled code


def one_thread(function: Callable[P, T]) -> Callable[P, T]:
    """Decorator that limits BLAS to one thread, which is also faster for small products."""

    @functools.wraps(function)
    def limited(*args: P.args, **kwargs: P.kwargs) -> T:
        if getattr(_state, "limited", False):  # querying the libraries takes as long as a small product
            return function(*args, **kwargs)
        with _threadpools().limit(limits=1, user_api="blas"):
            _state.limited = True
            try:
                return function(*args, **kwargs)
            finally:
                _state.limited = False

    return limited


_state = local()  # by thread: whether the limit is in force


@functools.cache
def _threadpools() -> ThreadpoolController:
    """The BLAS libraries, searched for once: that takes longer than a sample."""
    return ThreadpoolController()


def product(samples: np.ndarray, matrix: np.ndarray, found: np.ndarray | None = None) -> np.ndarray:
    """``X A``, one sample a row.

    Parameters
    ----------
    samples : (n, k) array
        X.
    matrix : (k, l) array
        A; copied if it is not C-contiguous.
    found : (n, l) array, optional
        Array to which the product is added in place.

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


def product_of(contacts: int) -> Callable[[np.ndarray, np.ndarray], np.ndarray]:
    """The product for a model with this number of contact pairs; without any, it needs no compiled code."""
    return product if contacts else _interpreted


def _interpreted(samples: np.ndarray, matrix: np.ndarray) -> np.ndarray:
    """As :func:`product`, except for the rounding of the last digit."""
    if matrix.size > SMALL:
        return product(samples, matrix)
    found = np.zeros((len(samples), matrix.shape[1]))
    for column, row in zip(samples.T, matrix):
        found += column[:, None] * row
    return found


@functools.cache
def _compiled() -> Callable[[np.ndarray, np.ndarray, np.ndarray], None]:
    from numba import float64, njit, void  # slow to import, and not needed by most commands

    def add(X, A, found):
        """``found += X A``, eight rows of A at a time."""
        columns = A.shape[1]
        for sample in range(len(X)):
            x, row = X[sample], found[sample]
            nonzero = np.flatnonzero(x)
            whole = len(nonzero) - len(nonzero) % 8
            for i in range(0, whole, 8):
                k0, k1, k2, k3, k4, k5, k6, k7 = nonzero[i : i + 8]
                x0, x1, x2, x3, x4, x5, x6, x7 = x[k0], x[k1], x[k2], x[k3], x[k4], x[k5], x[k6], x[k7]
                A0, A1, A2, A3, A4, A5, A6, A7 = A[k0], A[k1], A[k2], A[k3], A[k4], A[k5], A[k6], A[k7]
                for j in range(columns):
                    first = x0 * A0[j] + x1 * A1[j] + x2 * A2[j] + x3 * A3[j]
                    row[j] += first + (x4 * A4[j] + x5 * A5[j] + x6 * A6[j] + x7 * A7[j])
            for k in nonzero[whole:]:
                xk, Ak = x[k], A[k]
                for j in range(columns):
                    row[j] += xk * Ak[j]

    matrix = float64[:, ::1]
    signature = void(matrix, matrix, matrix)
    settings = {"nogil": True, "error_model": "numpy", "fastmath": {"contract"}}
    try:
        return njit(signature, cache=True, **settings)(add)
    except RuntimeError:  # no folder for compiled code can be written
        return njit(signature, **settings)(add)
