"""The linear part of an equilibrium, condensed onto the contact forces: exact algebra, one factorisation for a mesh.

Of the unknowns (u, r, f) of :mod:`fem_reference.full.equilibrium` the first two obey linear equations. All parts, held
on rows D, are factorised once, LDLᵀ,

    K u = Dᵀ λ + p,        D u = w        gives u and λ for any p, w,                                      (1)

and a step whose bilateral rows are B is that with as many more unknowns as it has rows, r and w: its rows read what
they shall, and D carries nothing,

    B u + c r = v,         λ = 0,         p + Bᵀ r + Cᵀ f in place of p.                                   (2)

Elimination of r and w leaves what the contacts read, δ = C u = δ⁰ + S f, so that an iteration of Newton's method is a
system of the contact lines alone. Nothing is left out and nothing approximated; whoever uses the result holds it
against the whole system's residual.
"""

from __future__ import annotations

import weakref

import numpy as np
from scipy.sparse import bmat, csr_matrix, diags, vstack

from fem_reference.shell.factorisation import PetscFactors

__all__ = ["Condensation", "HeldParts"]

_BLOCK = 64  # right-hand sides at a time


class HeldParts:
    """System (1), on one process, and what rows read under unit forces on rows: each is solved for once.

    Parameters
    ----------
    K : (N, N) csr_matrix
        Stiffness of the free parts.
    D : (d, N) csr_matrix
        Independent rows that hold them.

    Attributes
    ----------
    solved : int
        Right-hand sides so far.

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
        self._response: dict[tuple, np.ndarray] = {}  # (N,) of unit forces on a row
        self._place: dict[tuple, int] = {}  # of a row in `_read`
        self.formed: tuple = (None, None)  # the step whose compliance is kept, and that
        self._rows, self._read, self.solved = csr_matrix((0, self.N)), np.zeros((0, 0)), 0
        self.moved, self.carried = self.solve(np.zeros((self.N, self.d)), np.eye(self.d))

    def solve(self, p: np.ndarray, w: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """u (N, k) and λ (d, k) of (1) under p (N, k) and w (d, k), refined once."""
        x = self._solve(np.concatenate([p, -w]))
        u, λ = x[: self.N], x[self.N :]
        x += self._solve(np.concatenate([p - self._K @ u + self.D.T @ λ, self.D @ u - w]))
        return x[: self.N], x[self.N :]

    def response(self, rows: csr_matrix) -> np.ndarray:
        """(N, r) u under unit forces on rows, D held; remembered row by row."""
        names = _names(rows)
        new = [i for i, name in enumerate(names) if name not in self._response]
        if new:
            u, _ = self.solve(rows[new].T.toarray(), np.zeros((self.d, len(new))))
            self._response.update(zip([names[i] for i in new], u.T.copy(), strict=True))
        return np.array([self._response[name] for name in names]).reshape(len(names), self.N).T

    def readings(self, rows: csr_matrix) -> np.ndarray:
        """(r, r) what rows read under unit forces on them, D held; remembered, the displacements are not."""
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
        found = np.empty(right.shape)
        self.solved += right.shape[1]
        for j in range(0, right.shape[1], _BLOCK):
            found[:, j : j + _BLOCK] = self._factors.solve(right[:, j : j + _BLOCK])
        return found


class Condensation:
    """System (2) of a step.

    Parameters
    ----------
    parts : HeldParts
    B : (b, N) csr_matrix
        Bilateral rows, independent, that hold all parts.
    yielding : (b,) array or None
        c, mm/N.
    C : (k, N) csr_matrix
        Rows of the contacts.
    """

    def __init__(self, parts: HeldParts, B: csr_matrix, yielding: np.ndarray | None, C: csr_matrix):
        self.parts, self.B, self.C, self.b = parts, B, C, B.shape[0]
        unit = np.column_stack([parts.response(B), parts.moved])  # u under unit r and w: not kept, a step's are large
        border = np.zeros((self.b + parts.d, self.b + parts.d))
        border[: self.b] = B @ unit
        border[self.b :, : self.b] = -border[: self.b, self.b :].T
        border[self.b :, self.b :] = parts.carried
        border[np.arange(self.b), np.arange(self.b)] += 0.0 if yielding is None else yielding
        self._scale = 1 / np.sqrt(np.abs(border).max(axis=1))  # forces beside displacements
        self._border = np.linalg.inv(border * np.outer(self._scale, self._scale))
        self._read = C @ unit

    def compliance(self) -> np.ndarray:
        """(k, k) S, mm/N; of all steps of a mesh, the one that asked last has it kept."""
        step, S = self.parts.formed
        if step is None or step() is not self:
            own = self._read.copy()
            own[:, : self.b] *= -1
            S = self.parts.readings(self.C) + self._read @ self._bordered(own.T)
            self.parts.formed = weakref.ref(self), S
        return S

    def solve(self, p: np.ndarray, v: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """u (N,) and r (b,) under loads p (N,), contact forces among them, and values v (b,)."""
        u, λ = self.parts.solve(p[:, None], np.zeros((self.parts.d, 1)))
        u = u[:, 0]
        unknown = self._bordered(np.concatenate([v - self.B @ u, -λ[:, 0]]))
        r, w = unknown[: self.b], unknown[self.b :]
        return u + self.parts.response(self.B) @ r + self.parts.moved @ w, r

    def _bordered(self, right):
        scale = self._scale if right.ndim == 1 else self._scale[:, None]
        return scale * (self._border @ (scale * right))


def _names(rows: csr_matrix) -> list[tuple]:
    """What tells each row from others: its columns and numbers."""
    edges = rows.indptr
    return [(rows.indices[lo:hi].tobytes(), rows.data[lo:hi].tobytes()) for lo, hi in zip(edges, edges[1:])]
