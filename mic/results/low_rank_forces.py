"""Forces and motions of one part in many samples, compressed to few rows with the same inner products.

Displacement fields of n samples need only the inner products of the columns of ``[1, F, Q]``: ones, forces and motions.
Any rows R with ``RᵀR = [1, F, Q]ᵀ [1, F, Q]`` have the same ones: the triangular factor of the QR factorisation, whose
number of rows does not grow with n, or ``Σ Vᵀ`` of the singular value decomposition, which has low rank because the
forces of hundreds of functionals follow from few deviations. Rows of two sets of samples, stacked, are rows of their
union.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np

from mic.system.matrix_product import one_thread

__all__ = ["CentredForces", "CompressedForces", "ForceAccumulator", "pack_forces", "unpack_forces"]

BUFFER = 8_000_000  # bytes of uncompressed samples, by part and law
ROUNDING = 1e-13  # singular values below this share of the largest are dropped, columns scaled to unit norm


@dataclass(frozen=True)
class CompressedForces:
    """Compressed rows of samples.

    Attributes
    ----------
    rows : (r, c) array
        The columns of R that are not zero.
    columns : (c,) int array
        Their indices.
    width : int
        Number of columns of R, 1 + F + 6.
    samples : int
    largest : float
        Largest force of any sample, N or N mm.
    """

    rows: np.ndarray
    columns: np.ndarray
    width: int
    samples: int
    largest: float

    @classmethod
    @one_thread  # bits independent of the number of threads
    def of(cls, force: np.ndarray, motion: np.ndarray) -> CompressedForces:
        """Compress (n, F) forces and (n, 6) motions up to rounding."""
        rows = _with_ones(force, motion)
        size = np.sqrt((rows**2).sum(axis=0))
        columns = np.flatnonzero(size)
        _, singular, Vt = np.linalg.svd(rows[:, columns] / size[columns], full_matrices=False)
        retained = singular > ROUNDING * singular.max(initial=0.0)
        compressed = singular[retained, None] * Vt[retained] * size[columns]
        return cls(compressed, columns, rows.shape[1], len(force), float(np.abs(force).max(initial=0.0)))

    @property
    def dense(self) -> np.ndarray:
        """(r, 1 + F + 6) R including zero columns."""
        R = np.zeros((len(self.rows), self.width))
        R[:, self.columns] = self.rows
        return R


class ForceAccumulator:
    """Accumulates samples and compressed samples in few rows.

    Beyond a buffer size the rows are replaced by their triangular factor R. Its rows and columns without the first ones
    have the inner products of the centred samples.

    Parameters
    ----------
    buffer : int
        Bytes.
    """

    def __init__(self, buffer: int = BUFFER) -> None:
        self.samples = 0
        self._buffer = buffer
        self._largest = 0.0
        self._rows: list[np.ndarray] = []
        self._compressed = False

    def add(self, force: np.ndarray, motion: np.ndarray) -> None:
        """Add (n, F) forces and (n, 6) motions."""
        self._append(_with_ones(force, motion), len(force), float(np.abs(force).max(initial=0.0)))

    def join(self, compressed: CompressedForces) -> None:
        """Add compressed samples."""
        self._append(compressed.dense, compressed.samples, compressed.largest)
        self._compressed = True

    def _append(self, rows: np.ndarray, samples: int, largest: float) -> None:
        self.samples += samples
        self._largest = max(self._largest, largest)
        self._rows.append(rows)
        count, width = sum(len(rows) for rows in self._rows), rows.shape[1]
        if count > max(2 * width, self._buffer // (8 * width)):
            self._rows = [_triangular(np.concatenate(self._rows))]
            self._compressed = True

    def centred(self) -> CentredForces:
        """All samples relative to their mean."""
        rows = np.concatenate(self._rows)
        if not self._compressed:
            mean = rows[:, 1:].mean(axis=0)
            return CentredForces(mean, rows[:, 1:] - mean, self.samples, self._largest)
        R = _triangular(rows)
        return CentredForces(R[0, 1:] / R[0, 0], R[1:, 1:], self.samples, self._largest * np.sqrt(self.samples))


@dataclass(frozen=True)
class CentredForces:
    """Rows with the inner products of the centred samples, see :class:`ForceAccumulator`.

    Attributes
    ----------
    mean : (F + 6,) array
        Forces, then motions.
    rows : (r, F + 6) array
    samples : int
    size : float
        Magnitude of the forces, the reference of their rounding error.
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


def pack_forces(arrays: Mapping[str, np.ndarray]) -> tuple[dict[str, Any], dict[str, np.ndarray]]:
    """Header and arrays of ``force`` (n, F) and ``motion``, without the many functionals that carry no force."""
    force = np.ascontiguousarray(arrays["force"])
    loaded = np.flatnonzero(force.view(np.int64).any(axis=0))  # keeps the sign of zeros
    stored = {"functional": loaded, "functionals": np.array(force.shape[1])}
    return {}, {**arrays, "force": force[:, loaded], **stored}


def unpack_forces(arrays: Mapping[str, np.ndarray]) -> dict[str, np.ndarray]:
    """``force`` (n, F) and ``motion`` of :func:`pack_forces`."""
    force = np.zeros((len(arrays["force"]), int(arrays["functionals"])))
    force[:, arrays["functional"]] = arrays["force"]
    return {"force": force, "motion": arrays["motion"]}


def _with_ones(force: np.ndarray, motion: np.ndarray) -> np.ndarray:
    return np.hstack([np.ones((len(force), 1)), force, motion])


def _triangular(rows: np.ndarray) -> np.ndarray:
    R: Any = np.linalg.qr(rows, mode="r")  # the stubs lack this mode
    return R
