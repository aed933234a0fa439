"""Block-diagonal compliance: H and G of an assembly, stored part by part and never made dense.

Under forces f on the stacked functionals and rigid motions q the readings are ``y = H f + G q`` with ``Gᵀ f = 0``.
An assembly uses H only through *gathers*, ``L H Rᵀ`` for two sets of rows: the cost of each entry depends on the
nonzeros of the two rows, and two rows of different parts cost nothing.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from functools import cache, cached_property

import numpy as np
from scipy.linalg import block_diag
from scipy.sparse import csr_matrix

__all__ = ["Blocks"]

BATCH = 64  # rows whose diagonal is gathered at once
SMALL = 300  # functionals up to which nothing is compiled: loading Numba takes 0.3 s


@dataclass(frozen=True)
class Blocks:
    """Compliance and rigid-body readings of P free parts.

    Attributes
    ----------
    H : tuple of (F_p, F_p) array
        Symmetric compliance of each part at its own functionals.
    G : tuple of (F_p, 6) array
        Readings of each part's six rigid-body motions.
    """

    H: tuple[np.ndarray, ...]
    G: tuple[np.ndarray, ...]

    def __len__(self) -> int:
        return len(self.H)

    @cached_property
    def offsets(self) -> np.ndarray:
        """(P + 1,) first stacked functional of each part, and their number F at the end."""
        return np.concatenate([[0], np.cumsum([len(H) for H in self.H])]).astype(np.int64)

    @property
    def size(self) -> int:
        """F."""
        return int(self.offsets[-1])

    @property
    def functionals(self) -> list[slice]:
        """Slice of the stacked functionals for each part."""
        return [slice(int(a), int(b)) for a, b in zip(self.offsets, self.offsets[1:])]

    @property
    def motions(self) -> list[slice]:
        """Slice of the stacked rigid motions for each part."""
        return [slice(6 * p, 6 * p + 6) for p in range(len(self))]

    def part(self, p: int) -> Blocks:
        """One part alone."""
        return Blocks(self.H[p : p + 1], self.G[p : p + 1])

    def rigid(self, rows: csr_matrix) -> np.ndarray:
        """(r, 6P) readings ``rows @ G`` of the rigid motions."""
        columns = rows.tocsc()
        return np.hstack([columns[:, block] @ G for block, G in zip(self.functionals, self.G)])

    def gather(self, left: csr_matrix, right: csr_matrix) -> np.ndarray:
        """(l, r) ``left H rightᵀ`` for two sets of rows over the stacked functionals."""
        out = np.zeros((left.shape[0], right.shape[0]))
        if out.size and self.size <= SMALL:
            left, right = left.sorted_indices(), right.sorted_indices()
            for own, H in zip(self.functionals, self.H):
                out += left[:, own] @ (right[:, own] @ H).T
        elif out.size:
            for first, H in zip(self.offsets, self.H):
                _compiled()(H, first, *_entries(left), *_entries(right), out)
        return out

    def diagonal(self, rows: csr_matrix) -> np.ndarray:
        """(r,) compliance of each row alone, the diagonal of ``rows H rowsᵀ``."""
        some = (rows[first : first + BATCH] for first in range(0, rows.shape[0], BATCH))
        return np.concatenate([np.zeros(0), *(np.diag(self.gather(own, own)) for own in some)])

    def displace(self, forces: np.ndarray) -> np.ndarray:
        """(n, F) elastic readings ``f H`` of forces (n, F), one sample per row."""
        return np.hstack([forces[:, block] @ H for block, H in zip(self.functionals, self.H)])

    def carry(self, motions: np.ndarray) -> np.ndarray:
        """(n, F) readings ``q Gᵀ`` of rigid motions (n, 6P), one sample per row."""
        return np.hstack([motions[:, block] @ G.T for block, G in zip(self.motions, self.G)])

    def fit(self, readings: np.ndarray) -> np.ndarray:
        """(n, 6P) least-squares rigid motions of each part for readings (n, F)."""
        return np.hstack(
            [np.linalg.lstsq(G, readings[:, block].T, rcond=None)[0].T for block, G in zip(self.functionals, self.G)]
        )

    def dense(self) -> tuple[np.ndarray, np.ndarray]:
        """H (F, F) and G (F, 6P) with all their zeros, for small models and inspection."""
        return block_diag(*self.H), block_diag(*self.G)


def _entries(rows: csr_matrix) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Start of each row, and ascending columns and values of its entries."""
    if not rows.has_sorted_indices:
        rows = rows.sorted_indices()
    return rows.indptr.astype(np.int64), rows.indices.astype(np.int64), rows.data.astype(float)


@cache
def _compiled() -> Callable[..., None]:
    """The function that adds one part's share to ``L H Rᵀ``.

    Compiled, because slicing sparse matrices would take most of the time of setting up an assembly.
    """
    from numba import njit  # slow to import, and most commands gather nothing

    def gather(H, first, L_start, L_column, L_value, R_start, R_column, R_value, out):
        n = len(H)
        read = np.zeros(n, np.bool_)
        touched = np.zeros(len(L_start) - 1, np.bool_)
        for i in range(len(touched)):
            for k in range(L_start[i], L_start[i + 1]):
                if first <= L_column[k] < first + n:
                    read[L_column[k] - first] = True
                    touched[i] = True
        columns, touched_rows = np.flatnonzero(read), np.flatnonzero(touched)
        moved = np.zeros(n)
        for j in range(len(R_start) - 1):
            there = False
            for k in range(R_start[j], R_start[j + 1]):
                q = R_column[k] - first
                if 0 <= q < n:
                    if not there:
                        moved[:] = 0.0
                        there = True
                    for p in columns:
                        moved[p] += R_value[k] * H[q, p]
            if there:
                for i in touched_rows:
                    sum = 0.0
                    for k in range(L_start[i], L_start[i + 1]):
                        p = L_column[k] - first
                        if 0 <= p < n:
                            sum += L_value[k] * moved[p]
                    out[i, j] += sum

    settings = {"nogil": True, "error_model": "numpy"}
    try:
        return njit(gather, cache=True, **settings)
    except RuntimeError:  # no folder for the compiled code is writable
        return njit(gather, **settings)
