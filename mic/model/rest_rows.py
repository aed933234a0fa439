"""Where a part rests that its rows leave free: six readings of it alone, at its contacts.

A contact pair reads what its second body moves less its first. What it reads of one of the two alone is a row too, and
of a part's contacts six such rows tell where the part is. They hold nothing: a part that rests by contact alone is
*where they read*.

It is put down where it is drawn, or as near to that as nothing overlaps: with u the gaps there, G what they change with
the rows q,

    min ‖q‖²,        u + G q ≥ 0,

a problem of least distance (Lawson and Hanson 1974, chapter 23). No force acts: nothing presses it yet.

References
----------
Lawson, Hanson (1974), Solving Least Squares Problems, Prentice-Hall.
"""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass

import numpy as np
from scipy.optimize import nnls
from scipy.sparse import csr_matrix, vstack

from mic.compliance.blocks import Blocks
from mic.compliance.support import completing, independent, motion_size

__all__ = ["RestRows", "put_down", "put_down_slope"]

CLEAR = 1e-9  # mm: how far apart parts are put down that would overlap, more than rounding
CLOSED = 1e-10  # mm: gaps that are this near to that are those that hold the parts apart
FEASIBLE = 1e-9  # residual of the dual below which no motion takes the parts apart


def put_down(gap: np.ndarray, G: np.ndarray) -> np.ndarray:
    """(k,) by how much the rest rows move for gaps (m,) that change by G (m, k) not to overlap; none where they cannot.

    Gaps that none of them changes do not count.
    """
    read = np.abs(G).max(axis=1, initial=0.0) > FEASIBLE
    gap, G = gap[read], G[read]
    if not (gap < 0.0).any():
        return np.zeros(G.shape[1])
    gap = gap - CLEAR
    overlap = -gap.min()
    dual = np.vstack([G.T, -gap / overlap])
    unit = np.append(np.zeros(G.shape[1]), 1.0)
    residual = dual @ nnls(dual, unit)[0] - unit
    if -residual[-1] <= FEASIBLE:
        return np.zeros(G.shape[1])
    return overlap * residual[:-1] / -residual[-1]


def put_down_slope(gap: np.ndarray, slope: np.ndarray, G: np.ndarray, moved: np.ndarray) -> np.ndarray:
    """(k, p) derivatives of what :func:`put_down` found, (k,), with those (m, p) of the gaps: those that it just closes
    stay closed, by the least motion."""
    closed = (np.abs(G).max(axis=1, initial=0.0) > FEASIBLE) & (np.abs(gap + G @ moved - CLEAR) <= CLOSED)
    if not (moved.any() and closed.any()):
        return np.zeros((len(moved), slope.shape[1]))
    return -np.linalg.pinv(G[closed]) @ slope[closed]


@dataclass(frozen=True)
class RestRows:
    """Of the parts that rest somewhere in a process, where they are.

    Attributes
    ----------
    rows : (r, F) csr_matrix
        Six rows of each part, or as many as its contacts tell motions apart.
    part : (r,) int array
        Whose they are.
    direction : (r, 3) array
        Along which each reads: into which it pushes its part, if it pushes.
    """

    rows: csr_matrix
    part: np.ndarray
    direction: np.ndarray

    def __len__(self) -> int:
        return len(self.part)

    @classmethod
    def of(cls, assembly, motions: Blocks, parts: Iterable[int]) -> RestRows:
        """Choose them for some parts.

        Parameters
        ----------
        assembly : mic.model.assembly.Assembly or mic.model.reduction.Reduction
        motions : Blocks
            Readings G of the rigid motions of all parts; compliance is not asked for.
        parts : iterable of int
        """
        contacts, size = assembly.contacts, motion_size(motions.G)
        rows, owner, direction = [csr_matrix((0, motions.size))], [np.zeros(0, int)], [np.zeros((0, 3))]
        columns = assembly.rows["contact"].tocsc()
        along = contacts.frame[:, :, : contacts.dimension].transpose(0, 2, 1).reshape(-1, 3)
        for p in sorted(parts):
            functionals, motion = motions.functionals[p], motions.motions[p]
            own = columns[:, functionals].tocsr()
            chosen = independent(own @ motions.G[p], size[motion])
            own = own[chosen]
            placed = own.data, own.indices + functionals.start, own.indptr
            rows.append(csr_matrix(placed, shape=(len(chosen), motions.size)))
            owner.append(np.full(len(chosen), p))
            second = [assembly.scene.zones[contacts.zone[i // contacts.dimension]].parts[1] for i in chosen]
            sign = np.where(np.array(second, dtype=str) == assembly.scene.parts[p].name, 1.0, -1.0)
            direction.append(sign[:, None] * along[chosen])
        return cls(vstack(rows, format="csr"), np.concatenate(owner), np.concatenate(direction))

    def completing(self, bilateral: csr_matrix, motions: Blocks) -> np.ndarray:
        """Numbers of the rows that tell where bilateral rows (b, F) leave the parts: as many as motions are free.

        Raises
        ------
        FreeMotion
            If contacts do not tell all of these motions apart.
        """
        return completing(motions.rigid(bilateral), motions.rigid(self.rows), motion_size(motions.G))
