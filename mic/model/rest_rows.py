"""Position of parts that rest on contacts: rows of their contacts that read their free rigid motions.

A contact pair reads the motion of its second body less that of its first. Its reading of one of the two alone is also
a row, and six such rows of a part's contacts determine its position. They hold nothing: a part that rests by contact
alone is *where they read*.

Its start position is as drawn, or the nearest one without overlap: with gaps u as drawn, and their derivatives G by the
row values q,

    min ‖q‖²,        u + G q ≥ 0,

a least-distance problem (Lawson and Hanson 1974, chapter 23). No force acts yet.

References
----------
Lawson, Hanson (1974), Solving Least Squares Problems, Prentice-Hall.
"""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass

import numpy as np
from scipy.sparse import csr_matrix, vstack

from mic.compliance.blocks import Blocks
from mic.compliance.support import completing_rows, independent_rows, motion_size

__all__ = ["RestRows", "separating_motion", "separating_motion_slope"]

CLEAR = 1e-9  # mm: clearance to which overlapping parts are separated, larger than rounding errors
CLOSED = 1e-10  # mm: gaps this near to that clearance are active constraints
FEASIBLE = 1e-9  # residual of the dual below which no motion separates the parts


def separating_motion(gap: np.ndarray, G: np.ndarray) -> np.ndarray:
    """(k,) least motion of the rest rows for which gaps (m,) with derivatives G (m, k) do not overlap.

    It is zero if no motion separates the parts. Gaps that no motion changes are ignored.
    """
    read = np.abs(G).max(axis=1, initial=0.0) > FEASIBLE
    gap, G = gap[read], G[read]
    if not (gap < 0.0).any():
        return np.zeros(G.shape[1])
    gap = gap - CLEAR
    overlap = -gap.min()
    dual = np.vstack([G.T, -gap / overlap])
    unit = np.append(np.zeros(G.shape[1]), 1.0)
    from scipy.optimize import nnls  # slow to import, and only resting parts need it

    residual = dual @ nnls(dual, unit)[0] - unit
    if -residual[-1] <= FEASIBLE:
        return np.zeros(G.shape[1])
    return overlap * residual[:-1] / -residual[-1]


def separating_motion_slope(gap: np.ndarray, slope: np.ndarray, G: np.ndarray, motion: np.ndarray) -> np.ndarray:
    """(k, p) derivatives of :func:`separating_motion`'s result (k,) for derivatives (m, p) of the gaps.

    The gaps that it just closes stay closed, by the least motion.
    """
    closed = (np.abs(G).max(axis=1, initial=0.0) > FEASIBLE) & (np.abs(gap + G @ motion - CLEAR) <= CLOSED)
    if not (motion.any() and closed.any()):
        return np.zeros((len(motion), slope.shape[1]))
    return -np.linalg.pinv(G[closed]) @ slope[closed]


@dataclass(frozen=True)
class RestRows:
    """Rows that read the positions of the parts that rest at some time in a process.

    Attributes
    ----------
    rows : (r, F) csr_matrix
        Six rows of each part, or fewer if its contacts distinguish fewer motions.
    part : (r,) int array
        Part of each row.
    direction : (r, 3) array
        Direction of each reading, and of a force on its part.
    """

    rows: csr_matrix
    part: np.ndarray
    direction: np.ndarray

    def __len__(self) -> int:
        return len(self.part)

    @classmethod
    def of(cls, assembly, motions: Blocks, parts: Iterable[int]) -> RestRows:
        """Choose the rows of some parts.

        Parameters
        ----------
        assembly : mic.model.assembly_types.Assembly or mic.model.reduction.Reduction
        motions : Blocks
            Readings G of the rigid motions of all parts; compliance is not needed.
        parts : iterable of int
        """
        contacts, size = assembly.contacts, motion_size(motions.G)
        rows, owner, direction = [csr_matrix((0, motions.size))], [np.zeros(0, int)], [np.zeros((0, 3))]
        columns = assembly.rows["contact"].tocsc()
        directions = contacts.frame[:, :, : contacts.dimension].transpose(0, 2, 1).reshape(-1, 3)
        for p in sorted(parts):
            functionals, motion = motions.functionals[p], motions.motions[p]
            part_rows = columns[:, functionals].tocsr()
            chosen = independent_rows(part_rows @ motions.G[p], size[motion])
            part_rows = part_rows[chosen]
            entries = part_rows.data, part_rows.indices + functionals.start, part_rows.indptr
            rows.append(csr_matrix(entries, shape=(len(chosen), motions.size)))
            owner.append(np.full(len(chosen), p))
            second = [assembly.scene.zones[contacts.zone[i // contacts.dimension]].parts[1] for i in chosen]
            sign = np.where(np.array(second, dtype=str) == assembly.scene.parts[p].name, 1.0, -1.0)
            direction.append(sign[:, None] * directions[chosen])
        return cls(vstack(rows, format="csr"), np.concatenate(owner), np.concatenate(direction))

    def completing_rows(self, bilateral: csr_matrix, motions: Blocks) -> np.ndarray:
        """Numbers of the rows that read the motions that bilateral rows (b, F) leave free, one for each.

        Raises
        ------
        FreeMotion
            If the contacts do not distinguish all of these motions.
        """
        return completing_rows(motions.rigid(bilateral), motions.rigid(self.rows), motion_size(motions.G))
