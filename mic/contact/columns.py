"""Compliance by columns: of many contacts only those that carry force are ever asked for theirs.

``u = S f`` needs the columns of S whose force does not vanish, and of candidates few ever carry any. A column is found
when it is first needed, and kept. It is the same bits whichever columns it is found with, and forces are taken in the
contacts' order: so are the displacements, whatever was asked for before.
"""

from __future__ import annotations

from collections.abc import Callable
from functools import partial

import numpy as np

__all__ = ["Columns"]


class Columns:
    """A matrix (r, c) that is had by columns: what r rows read per contact force.

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
        self._kept, self._count = np.empty((0, shape[0])), 0
        self._at = np.full(shape[1], -1, dtype=np.int64)

    @classmethod
    def of(cls, matrix: np.ndarray) -> Columns:
        """Of a matrix that is there, (r, c)."""
        found = cls(_missing, (matrix.shape[0], matrix.shape[1]))
        found._kept, found._count = np.ascontiguousarray(matrix.T), matrix.shape[1]
        found._at = np.arange(matrix.shape[1], dtype=np.int64)
        return found

    def __len__(self) -> int:
        return self.shape[0]

    @property
    def found(self) -> int:
        """How many columns have been asked for."""
        return self._count

    def take(self, numbers: np.ndarray) -> np.ndarray:
        """(k, r) columns with these numbers (k,), one a row."""
        self._provide(numbers)
        return self._kept[self._at[numbers]]

    def block(self, numbers: np.ndarray) -> np.ndarray:
        """(k, k) rows and columns with these numbers of a matrix that is symmetric but for rounding; without it."""
        own = self.take(numbers)[:, numbers]
        return 0.5 * (own + own.T)

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
        responses(self._kept, self._at, np.ascontiguousarray(force), read)
        return read

    def _provide(self, numbers) -> None:
        new = np.unique(numbers[self._at[numbers] < 0])
        if not len(new):
            return
        columns = self._find(new)
        if self._count + len(new) > len(self._kept):
            kept = np.empty((min(max(2 * self._count, self._count + len(new)), self.shape[1]), self.shape[0]))
            kept[: self._count] = self._kept[: self._count]
            self._kept = kept
        elif not self._kept.flags.writeable:
            self._kept = self._kept.copy()
        self._kept[self._count : self._count + len(new)] = columns
        self._at = self._at.copy()  # what is shared with other processes is read-only
        self._at[new] = np.arange(self._count, self._count + len(new))
        self._count += len(new)


def _first(S: Columns, count: int, numbers: np.ndarray) -> np.ndarray:
    return S.take(numbers)[:, :count]


def _missing(numbers):
    raise AssertionError("every column of a matrix that is there is known")
