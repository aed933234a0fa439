"""Compliance by columns: of many contacts only those that carry force are ever asked for theirs.

``u = S f`` needs the columns of S whose force does not vanish, and of candidates few ever carry any. A column is found
when it is first needed, and kept. It is the same bits whichever columns it is found with, and forces are taken in the
contacts' order: so are the displacements, whatever was asked for before.
"""

from __future__ import annotations

from collections.abc import Callable
from functools import partial
from threading import Lock

import numpy as np

from mic.contact.lazy_memory import untouched

__all__ = ["Columns"]

#: Bytes of address space for columns to come: to move them when they are more takes longer than to find them.
ROOM = 2**31


class Columns:
    """A matrix (r, c) that is had by columns: what r rows read per contact force. Threads may share it.

    Parameters
    ----------
    find : callable
        Given numbers (k,) of columns returns them, (k, r), one a row; each the same bits whatever the others are.
    shape : (int, int)
        r and c.

    Attributes
    ----------
    shape : (int, int)
    """

    def __init__(self, find: Callable[[np.ndarray], np.ndarray], shape: tuple[int, int]):
        self.shape, self._find = shape, find
        # Columns that were there when the matrix was made or sent elsewhere, and those found since, with room for more.
        self._given, self._own, self._count = np.empty((0, shape[0])), np.empty((0, shape[0])), 0
        self._at = np.full(shape[1], -1, dtype=np.int64)
        self._finding = Lock()

    @classmethod
    def of(cls, matrix: np.ndarray) -> Columns:
        """Of a matrix that is there, (r, c)."""
        found = cls(_missing, (matrix.shape[0], matrix.shape[1]))
        found._given = np.ascontiguousarray(matrix.T)
        found._at = np.arange(matrix.shape[1], dtype=np.int64)
        return found

    def __len__(self) -> int:
        return self.shape[0]

    @property
    def found(self) -> int:
        """How many columns have been asked for."""
        return len(self._given) + self._count

    def __getstate__(self) -> dict:
        """All that was found is given to whoever gets the copy; processes that share it add to it each for itself."""
        given = np.concatenate([self._given, self._own[: self._count]]) if self._count else self._given
        state = self.__dict__ | {"_given": given, "_own": np.empty((0, self.shape[0])), "_count": 0}
        return {name: value for name, value in state.items() if name != "_finding"}

    def __setstate__(self, state: dict) -> None:
        self.__dict__.update(state)
        self._finding = Lock()

    def take(self, numbers: np.ndarray) -> np.ndarray:
        """(k, r) columns with these numbers (k,), one a row."""
        self._provide(numbers)
        at, columns = self._at[numbers], np.empty((len(numbers), self.shape[0]))
        own = at >= len(self._given)
        columns[~own], columns[own] = self._given[at[~own]], self._own[at[own] - len(self._given)]
        return columns

    def passed(self, numbers: np.ndarray) -> np.ndarray:
        """As :meth:`take`, to who keeps them: those that had to be found are not kept here, too."""
        known = self._at[numbers] >= 0
        columns = np.empty((len(numbers), self.shape[0]))
        columns[known] = self.take(numbers[known])
        if not known.all():
            with self._finding:
                columns[~known] = self._find(numbers[~known])
        return columns

    def block(self, numbers: np.ndarray) -> np.ndarray:
        """(k, k) rows and columns with these numbers of a matrix that is symmetric but for rounding; without it."""
        from mic.contact.native.kernels import symmetric  # compiles, or reads the cache, when it is imported

        self._provide(numbers)
        return symmetric(self._given, self._own, self._at, np.ascontiguousarray(numbers, dtype=np.int64))

    def through(self, find: Callable[[np.ndarray], np.ndarray], rows: int) -> Columns:
        """(rows, c) whose columns are a function of this matrix's, told (k, r) and returned (k, rows)."""
        return Columns(partial(_through, self, find), (rows, self.shape[1]))

    def first(self, count: int) -> Columns:
        """(count, count) the first rows and columns."""
        return self if self.shape == (count, count) else Columns(partial(_first, self, count), (count, count))

    def whole(self) -> np.ndarray:
        """(r, c), for few contacts and inspection."""
        return self.take(np.arange(self.shape[1])).T

    def under(self, force: np.ndarray) -> np.ndarray:
        """(n, r) what the rows read under forces (n, c), one sample a row; cost follows the forces that act."""
        from mic.contact.native.kernels import responses  # compiles, or reads the cache, when it is imported

        self._provide(np.flatnonzero(force.any(axis=0)))
        read = np.empty((len(force), self.shape[0]))
        responses(self._given, self._own, self._at, np.ascontiguousarray(force), read)
        return read

    def _provide(self, numbers) -> None:
        if (self._at[numbers] < 0).any():
            with self._finding:
                self._add(np.unique(numbers[self._at[numbers] < 0]))

    def _add(self, new: np.ndarray) -> None:
        if not len(new):  # another thread has found them meanwhile
            return
        count = self._count + len(new)
        if count > len(self._own):
            most = max(2 * count, ROOM // (8 * max(self.shape[0], 1)))
            room = untouched(min(most, self.shape[1] - len(self._given)), self.shape[0])
            room[: self._count] = self._own[: self._count]
            self._own = room
        self._own[self._count : count] = self._find(new)
        at = self._at.copy()  # others may share it, or read it now
        at[new] = len(self._given) + np.arange(self._count, count)
        self._at, self._count = at, count


def _first(S: Columns, count: int, numbers: np.ndarray) -> np.ndarray:
    return S.take(numbers)[:, :count]


def _through(S: Columns, find: Callable[[np.ndarray], np.ndarray], numbers: np.ndarray) -> np.ndarray:
    return find(S.take(numbers))


def _missing(numbers):
    raise AssertionError("every column of a matrix that is there is known")
