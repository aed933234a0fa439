"""Exact condensation of an equilibrium onto the contact forces, with one factorisation per mesh.

The unknowns u and r of :mod:`fem_reference.full.equilibrium` satisfy linear equations. The stiffness of all parts,
supported by rows D, is factorised once (LDLᵀ),

    K u = Dᵀ λ + p,        D u = w        gives u and λ for any p, w.                                      (1)

A step with bilateral rows B is a bordered system with unknowns r and w: its rows have the prescribed values, and D
carries no force,

    B u + c r = v,         λ = 0,         p + Bᵀ r + Cᵀ f in place of p.                                   (2)

Elimination of r and w gives the relative displacements of the contacts, δ = C u = δ⁰ + S f, so that a Newton iteration
solves a system of the contact equations only. There is no approximation; the caller checks the residual of the whole
system.
"""

from __future__ import annotations

import weakref

import numpy as np
from scipy.sparse import bmat, csr_matrix, diags, vstack

from fem_reference.shell.factorisation import PetscFactors

__all__ = ["Condensation", "HeldParts"]

_BLOCK = 64  # right-hand sides at a time


class HeldParts:
    """System (1) on one process, with cached responses to unit forces on rows.

    Parameters
    ----------
    K : (N, N) csr_matrix
        Stiffness of the free parts.
    D : (d, N) csr_matrix
        Independent rows that exclude all rigid motions.

    Attributes
    ----------
    solved : int
        Number of right-hand sides solved so far.

    Raises
    ------
    FactorisationError
        If it cannot be factorised.
    """

    def __init__(self, K: csr_matrix, D: csr_matrix):
        self._K, self.D = K, D.tocsr()
        self.N, self.d = K.shape[0], D.shape[0]
        system = bmat([[K, -D.T], [-D, None]], format="csr") + diags(np.zeros(self.N + self.d), format="csr")
        self._factors = PetscFactors(system, definite=False)
        self._response: dict[tuple, np.ndarray] = {}  # (N,) u under a unit force on a row
        self._place: dict[tuple, int] = {}  # index of a row in `_read`
        self.formed: tuple = (None, None)  # step whose compliance matrix is cached, and that matrix
        self._rows, self._read, self.solved = csr_matrix((0, self.N)), np.zeros((0, 0)), 0
        self.moved, self.carried = self.solve(np.zeros((self.N, self.d)), np.eye(self.d))

    def solve(self, p: np.ndarray, w: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """u (N, k) and λ (d, k) of (1) under p (N, k) and w (d, k), refined once."""
        x = self._solve(np.concatenate([p, -w]))
        u, λ = x[: self.N], x[self.N :]
        x += self._solve(np.concatenate([p - self._K @ u + self.D.T @ λ, self.D @ u - w]))
        return x[: self.N], x[self.N :]

    def response(self, rows: csr_matrix) -> np.ndarray:
        """(N, r) u under unit forces on rows with D u = 0; cached row by row."""
        names = _names(rows)
        new = [i for i, name in enumerate(names) if name not in self._response]
        if new:
            u, _ = self.solve(rows[new].T.toarray(), np.zeros((self.d, len(new))))
            self._response.update(zip([names[i] for i in new], u.T.copy(), strict=True))
        return np.array([self._response[name] for name in names]).reshape(len(names), self.N).T

    def readings(self, rows: csr_matrix) -> np.ndarray:
        """(r, r) readings of rows under unit forces on them with D u = 0; cached without the displacements."""
        names = _names(rows)
        new = [i for i, name in enumerate(names) if name not in self._place]
        if new:
            first = len(self._read)
            self._place.update((names[i], first + j) for j, i in enumerate(new))
            added = rows[new]
            self._rows = vstack([self._rows, added], format="csr")
            whole = np.zeros((first + len(new), first + len(new)))
            whole[:first, :first] = self._read
            for j in range(0, len(new), _BLOCK):
                forces = added[j : j + _BLOCK].T.toarray()
                u = self._solve(np.concatenate([forces, np.zeros((self.d, forces.shape[1]))]))[: self.N]
                whole[:, first + j : first + j + _BLOCK] = self._rows @ u
            whole[first:, :first] = whole[:first, first:].T
            whole[first:, first:] = 0.5 * (whole[first:, first:] + whole[first:, first:].T)
            self._read = whole
        place = [self._place[name] for name in names]
        if place == list(range(len(self._read))):
            return self._read
        return self._read[np.ix_(place, place)]

    def _solve(self, right: np.ndarray) -> np.ndarray:
        solution = np.empty(right.shape)
        self.solved += right.shape[1]
        for j in range(0, right.shape[1], _BLOCK):
            solution[:, j : j + _BLOCK] = self._factors.solve(right[:, j : j + _BLOCK])
        return solution


class Condensation:
    """System (2) of a step.

    Parameters
    ----------
    parts : HeldParts
    B : (b, N) csr_matrix
        Independent bilateral rows that exclude all rigid motions.
    yielding : (b,) array or None
        c, mm/N.
    C : (k, N) csr_matrix
        Rows of the contacts.
    """

    def __init__(self, parts: HeldParts, B: csr_matrix, yielding: np.ndarray | None, C: csr_matrix):
        self.parts, self.B, self.C, self.b = parts, B, C, B.shape[0]
        unit = np.column_stack([parts.response(B), parts.moved])  # u under unit r and w; too large to store
        border = np.zeros((self.b + parts.d, self.b + parts.d))
        border[: self.b] = B @ unit
        border[self.b :, : self.b] = -border[: self.b, self.b :].T
        border[self.b :, self.b :] = parts.carried
        border[np.arange(self.b), np.arange(self.b)] += 0.0 if yielding is None else yielding
        self._scale = 1 / np.sqrt(np.abs(border).max(axis=1))  # forces and displacements differ in scale
        self._border = np.linalg.inv(border * np.outer(self._scale, self._scale))
        self._read = C @ unit

    def compliance(self) -> np.ndarray:
        """(k, k) S, mm/N; only the last step of a mesh that called this has it cached."""
        step, S = self.parts.formed
        if step is None or step() is not self:
            signed = self._read.copy()
            signed[:, : self.b] *= -1
            S = self.parts.readings(self.C) + self._read @ self._bordered(signed.T)
            self.parts.formed = weakref.ref(self), S
        return S

    def solve(self, p: np.ndarray, v: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """u (N,) and r (b,) under loads p (N,), which include the contact forces, and values v (b,)."""
        u, λ = self.parts.solve(p[:, None], np.zeros((self.parts.d, 1)))
        u = u[:, 0]
        unknown = self._bordered(np.concatenate([v - self.B @ u, -λ[:, 0]]))
        r, w = unknown[: self.b], unknown[self.b :]
        return u + self.parts.response(self.B) @ r + self.parts.moved @ w, r

    def _bordered(self, right):
        scale = self._scale if right.ndim == 1 else self._scale[:, None]
        return scale * (self._border @ (scale * right))


def _names(rows: csr_matrix) -> list[tuple]:
    """Cache key of each row: its columns and values."""
    edges = rows.indptr
    return [(rows.indices[lo:hi].tobytes(), rows.data[lo:hi].tobytes()) for lo, hi in zip(edges, edges[1:])]
