"""Compliance matrix whose columns are computed on demand.

``u = S f`` needs only the columns of S with non-zero force, and few candidates ever carry force. A column is computed
when it is first needed, and cached. Its bits do not depend on the columns that it is computed with, and forces are
summed in the order of the contacts; so displacements do not depend on earlier requests.
"""

from __future__ import annotations

from collections.abc import Callable
from functools import partial
from threading import Lock

import numpy as np

from mic.contact.lazy_memory import lazy_zeros

__all__ = ["Columns"]

#: Bytes of address space reserved for further columns, since moving them takes longer than computing them.
RESERVED = 2**31


class Columns:
    """A matrix (r, c) with columns computed on demand: readings of r rows per contact force. Thread-safe.

    Parameters
    ----------
    find : callable
        Computes columns (k, r), one per row, from their indices (k,); their bits must not depend on each other.
    shape : (int, int)
        r and c.

    Attributes
    ----------
    shape : (int, int)
    """

    def __init__(self, find: Callable[[np.ndarray], np.ndarray], shape: tuple[int, int]):
        self.shape, self._find = shape, find
        # Columns given at construction or unpickling, and those computed since, with reserved space.
        self._given, self._own, self._count = np.empty((0, shape[0])), np.empty((0, shape[0])), 0
        self._at = np.full(shape[1], -1, dtype=np.int64)
        self._lock = Lock()

    @classmethod
    def of(cls, matrix: np.ndarray) -> Columns:
        """Columns of a dense matrix (r, c)."""
        columns = cls(_missing, (matrix.shape[0], matrix.shape[1]))
        columns._given = np.ascontiguousarray(matrix.T)
        columns._at = np.arange(matrix.shape[1], dtype=np.int64)
        return columns

    def __len__(self) -> int:
        return self.shape[0]

    @property
    def found(self) -> int:
        """Number of computed columns."""
        return len(self._given) + self._count

    def __getstate__(self) -> dict:
        """The state includes all computed columns; each copy adds further ones independently."""
        given = np.concatenate([self._given, self._own[: self._count]]) if self._count else self._given
        state = self.__dict__ | {"_given": given, "_own": np.empty((0, self.shape[0])), "_count": 0}
        return {name: value for name, value in state.items() if name != "_lock"}

    def __setstate__(self, state: dict) -> None:
        self.__dict__.update(state)
        self._lock = Lock()

    def take(self, numbers: np.ndarray) -> np.ndarray:
        """(k, r) columns with indices (k,), one per row."""
        self._provide(numbers)
        at, columns = self._at[numbers], np.empty((len(numbers), self.shape[0]))
        own = at >= len(self._given)
        columns[~own], columns[own] = self._given[at[~own]], self._own[at[own] - len(self._given)]
        return columns

    def uncached(self, numbers: np.ndarray) -> np.ndarray:
        """Like :meth:`take`, but newly computed columns are not cached, for callers that store them."""
        known = self._at[numbers] >= 0
        columns = np.empty((len(numbers), self.shape[0]))
        columns[known] = self.take(numbers[known])
        if not known.all():
            with self._lock:
                columns[~known] = self._find(numbers[~known])
        return columns

    def block(self, numbers: np.ndarray) -> np.ndarray:
        """(k, k) submatrix with these indices, of a matrix that is symmetric up to rounding; made exactly symmetric."""
        from mic.contact.native.matrices import symmetric  # Numba is slow to import

        self._provide(numbers)
        return symmetric(self._given, self._own, self._at, np.ascontiguousarray(numbers, dtype=np.int64))

    def through(self, find: Callable[[np.ndarray], np.ndarray], rows: int) -> Columns:
        """(rows, c) matrix whose columns are a function of those of this one, from (k, r) to (k, rows)."""
        return Columns(partial(_through, self, find), (rows, self.shape[1]))

    def first(self, count: int) -> Columns:
        """(count, count) leading submatrix."""
        return self if self.shape == (count, count) else Columns(partial(_first, self, count), (count, count))

    def whole(self) -> np.ndarray:
        """(r, c) dense matrix, for few contacts and inspection."""
        return self.take(np.arange(self.shape[1])).T

    def under(self, force: np.ndarray) -> np.ndarray:
        """(n, r) products with forces (n, c), one sample per row; the cost depends on the non-zero forces only."""
        loaded = np.flatnonzero(force.any(axis=0))
        if not len(loaded):  # nothing touches: no kernel is needed
            return np.zeros((len(force), self.shape[0]))
        from mic.contact.native.matrices import responses  # Numba is slow to import

        self._provide(loaded)
        readings = np.empty((len(force), self.shape[0]))
        responses(self._given, self._own, self._at, np.ascontiguousarray(force), readings)
        return readings

    def _provide(self, numbers) -> None:
        if (self._at[numbers] < 0).any():
            with self._lock:
                self._add(np.unique(numbers[self._at[numbers] < 0]))

    def _add(self, new: np.ndarray) -> None:
        if not len(new):  # another thread has computed them meanwhile
            return
        count = self._count + len(new)
        if count > len(self._own):
            capacity = max(2 * count, RESERVED // (8 * max(self.shape[0], 1)))
            memory = lazy_zeros(min(capacity, self.shape[1] - len(self._given)), self.shape[0])
            memory[: self._count] = self._own[: self._count]
            self._own = memory
        self._own[self._count : count] = self._find(new)
        at = self._at.copy()  # copies and other threads may use it
        at[new] = len(self._given) + np.arange(self._count, count)
        self._at, self._count = at, count


def _first(S: Columns, count: int, numbers: np.ndarray) -> np.ndarray:
    return S.take(numbers)[:, :count]


def _through(S: Columns, find: Callable[[np.ndarray], np.ndarray], numbers: np.ndarray) -> np.ndarray:
    return find(S.take(numbers))


def _missing(numbers):
    raise AssertionError("all columns of a dense matrix are known")
