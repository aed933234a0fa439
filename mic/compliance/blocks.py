"""The compliance of all parts, kept part by part: H and G of an assembly are block-diagonal and never made dense.

Under forces f on the stacked functionals and rigid motions q the readings are ``y = H f + G q`` with ``Gᵀ f = 0``.
Whatever an assembly needs of H is a *gather*, ``L H Rᵀ`` for two sets of rows: each entry costs what the two rows
hold, and two rows of different parts cost nothing.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np
from scipy.linalg import block_diag
from scipy.sparse import csr_matrix

__all__ = ["Blocks"]

ROWS = 64  # of which H is read at a time where their own entries alone are asked for


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
        """Each part's share of the stacked functionals."""
        return [slice(int(a), int(b)) for a, b in zip(self.offsets, self.offsets[1:])]

    @property
    def motions(self) -> list[slice]:
        """Each part's share of the stacked rigid motions."""
        return [slice(6 * p, 6 * p + 6) for p in range(len(self))]

    def part(self, p: int) -> Blocks:
        """One part alone."""
        return Blocks(self.H[p : p + 1], self.G[p : p + 1])

    def rigid(self, rows: csr_matrix) -> np.ndarray:
        """(r, 6P) readings ``rows @ G`` of the rigid motions."""
        columns = rows.tocsc()
        return np.hstack([columns[:, own] @ G for own, G in zip(self.functionals, self.G)])

    def gather(self, left: csr_matrix, right: csr_matrix) -> np.ndarray:
        """(l, r) ``left H rightᵀ`` for two sets of rows over the stacked functionals."""
        out = np.zeros((left.shape[0], right.shape[0]))
        for H, (i, L), (j, R) in zip(self.H, self._split(left), self._split(right)):
            if len(i) and len(j):
                p, q = np.unique(L.indices), np.unique(R.indices)
                out[np.ix_(i, j)] += L[:, p] @ (R[:, q] @ H[np.ix_(q, p)]).T
        return out

    def diagonal(self, rows: csr_matrix) -> np.ndarray:
        """(r,) each row's own compliance, the diagonal of ``rows H rowsᵀ``."""
        out = np.zeros(rows.shape[0])
        for H, (i, R) in zip(self.H, self._split(rows)):
            for first in range(0, len(i), ROWS):
                some = R[first : first + ROWS]
                out[i[first : first + ROWS]] += np.asarray(some.multiply(some @ H).sum(axis=1)).ravel()
        return out

    def displace(self, forces: np.ndarray) -> np.ndarray:
        """(n, F) elastic readings ``f H`` of forces (n, F), one sample a row."""
        return np.hstack([forces[:, own] @ H for own, H in zip(self.functionals, self.H)])

    def carry(self, motions: np.ndarray) -> np.ndarray:
        """(n, F) readings ``q Gᵀ`` of rigid motions (n, 6P), one sample a row."""
        return np.hstack([motions[:, own] @ G.T for own, G in zip(self.motions, self.G)])

    def resultants(self, forces: np.ndarray) -> np.ndarray:
        """(n, 6P) resultants ``f G`` of forces (n, F) on each part, one sample a row; zero in equilibrium."""
        return np.hstack([forces[:, own] @ G for own, G in zip(self.functionals, self.G)])

    def fit(self, readings: np.ndarray) -> np.ndarray:
        """(n, 6P) rigid motions nearest to readings (n, F), by least squares part by part."""
        return np.hstack(
            [np.linalg.lstsq(G, readings[:, own].T, rcond=None)[0].T for own, G in zip(self.functionals, self.G)]
        )

    def dense(self) -> tuple[np.ndarray, np.ndarray]:
        """H (F, F) and G (F, 6P) with all their zeros, for small models and inspection."""
        return block_diag(*self.H), block_diag(*self.G)

    def _split(self, rows: csr_matrix) -> list[tuple[np.ndarray, csr_matrix]]:
        """Per part: the rows that touch it, and their entries on its own functionals."""
        columns, pieces = rows.tocsc(), []
        for own in self.functionals:
            local = columns[:, own].tocsr()
            touched = np.flatnonzero(np.diff(local.indptr))
            pieces.append((touched, local[touched]))
        return pieces

    @classmethod
    def single(cls, H: np.ndarray, G: np.ndarray, edges: Sequence[int] | None = None) -> Blocks:
        """Blocks of dense H (F, F) and G (F, 6P) that are cut at `edges` (default: one part)."""
        edges = [0, len(H)] if edges is None else edges
        own = [slice(a, b) for a, b in zip(edges, edges[1:])]
        return cls(tuple(H[s, s] for s in own), tuple(G[s, 6 * p : 6 * p + 6] for p, s in enumerate(own)))
