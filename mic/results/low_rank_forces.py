"""Forces and motions of one part in many samples, as few rows as have the same products.

What fields need of n samples are products of columns of ``[1, F, Q]``: ones, forces and motions. These are kept by any
rows R with ``RᵀR = [1, F, Q]ᵀ [1, F, Q]``, such as the triangle of ``[1, F, Q] = Z R``, Z orthogonal, whose number does
not grow with n, or ``Σ Vᵀ`` of ``[1, F, Q] = U Σ Vᵀ``, of which all but the first are nothing: forces of hundreds of
functionals follow from few deviations. Rows of some samples and of others, one below the other, are rows of both.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np

from mic.system.matrix_product import one_thread

__all__ = ["Centred", "Condensed", "Condenser"]

ROOM = 8_000_000  # bytes of samples that are kept as they are, by part and law
ROUNDING = 1e-13  # singular values below this share of the largest are left out, each column in units of its own size


@dataclass(frozen=True)
class Condensed:
    """Rows that stand for samples.

    Attributes
    ----------
    rows : (r, c) array
        Columns of R above that are not all zero.
    columns : (c,) int array
        Which they are.
    width : int
        Of R, 1 + F + 6.
    samples : int
    largest : float
        Force of any sample, N or N mm.
    """

    rows: np.ndarray
    columns: np.ndarray
    width: int
    samples: int
    largest: float

    @classmethod
    @one_thread  # the same bits on any number of them
    def of(cls, force: np.ndarray, motion: np.ndarray) -> Condensed:
        """Those of (n, F) forces and (n, 6) motions, as few as rounding leaves."""
        rows = _beside(force, motion)
        size = np.sqrt((rows**2).sum(axis=0))
        columns = np.flatnonzero(size)
        _, singular, Vt = np.linalg.svd(rows[:, columns] / size[columns], full_matrices=False)
        own = singular > ROUNDING * singular.max(initial=0.0)
        few = singular[own, None] * Vt[own] * size[columns]
        return cls(few, columns, rows.shape[1], len(force), float(np.abs(force).max(initial=0.0)))

    @property
    def whole(self) -> np.ndarray:
        """(r, 1 + F + 6) R with its zeros."""
        R = np.zeros((len(self.rows), self.width))
        R[:, self.columns] = self.rows
        return R


class Condenser:
    """Takes in samples and what stands for samples, and keeps few rows however many there are.

    Beyond some room the rows so far are replaced by their triangle. Without its first row and column that is what is
    left of the samples once they are centred: Z drops out of every product of two columns.

    Parameters
    ----------
    room : int
        Bytes.
    """

    def __init__(self, room: int = ROOM) -> None:
        self.samples = 0
        self._room = room
        self._largest = 0.0
        self._rows: list[np.ndarray] = []
        self._condensed = False

    def add(self, force: np.ndarray, motion: np.ndarray) -> None:
        """Take in (n, F) forces and (n, 6) motions."""
        self._take(_beside(force, motion), len(force), float(np.abs(force).max(initial=0.0)))

    def join(self, some: Condensed) -> None:
        """Take in what stands for further samples."""
        self._take(some.whole, some.samples, some.largest)
        self._condensed = True

    def _take(self, rows: np.ndarray, samples: int, largest: float) -> None:
        self.samples += samples
        self._largest = max(self._largest, largest)
        self._rows.append(rows)
        held, width = sum(len(rows) for rows in self._rows), rows.shape[1]
        if held > max(2 * width, self._room // (8 * width)):
            self._rows = [_triangle(np.concatenate(self._rows))]
            self._condensed = True

    def centred(self) -> Centred:
        """All that was taken in, about its mean."""
        rows = np.concatenate(self._rows)
        if not self._condensed:
            mean = rows[:, 1:].mean(axis=0)
            return Centred(mean, rows[:, 1:] - mean, self.samples, self._largest)
        R = _triangle(rows)
        return Centred(R[0, 1:] / R[0, 0], R[1:, 1:], self.samples, self._largest * np.sqrt(self.samples))


@dataclass(frozen=True)
class Centred:
    """Rows that have the products of the centred samples, see :class:`Condenser`.

    Attributes
    ----------
    mean : (F + 6,) array
        Forces, then motions.
    rows : (r, F + 6) array
    samples : int
    size : float
        Of the forces: what their rounding is measured by.
    """

    mean: np.ndarray
    rows: np.ndarray
    samples: int
    size: float

    @property
    def force(self) -> np.ndarray:
        """(r, F) array."""
        return self.rows[:, :-6]

    @property
    def motion(self) -> np.ndarray:
        """(r, 6) array."""
        return self.rows[:, -6:]


def _beside(force: np.ndarray, motion: np.ndarray) -> np.ndarray:
    return np.hstack([np.ones((len(force), 1)), force, motion])


def _triangle(rows: np.ndarray) -> np.ndarray:
    R: Any = np.linalg.qr(rows, mode="r")  # an array, which the stubs do not know
    return R
