"""The linear part of an equilibrium, condensed onto the contact forces: exact algebra, once for all Newton iterations.

Of the unknowns (u, r, f) of :mod:`fem_reference.full.equilibrium` the first two obey linear equations. Where the
bilateral rows hold the parts these can be solved for any f, with A = [[K, −Bᵀ], [B, c]] factorised once:

    (u, r) = A⁻¹ (p, v) + W f,        W = A⁻¹ (Cᵀ, 0),        δ = C u = δ⁰ + S f,       S = C W,              (1)

so that an iteration of Newton's method is a system of the contact lines alone, as large as there are contact forces.
The iterates are those of the whole system, but for rounding. Nothing is left out and nothing approximated; whoever uses
the result holds it against the whole system's residual.
"""

from __future__ import annotations

import numpy as np
from petsc4py import PETSc
from scipy.sparse import csr_matrix

__all__ = ["Condensation"]


class Condensation:
    """A⁻¹, W and S of (1), on one process.

    Parameters
    ----------
    matrix : PETSc.Mat
        Of the unknowns (u, r, f) in this order, the lines of f being ``f = given``. It is kept, and must not change.
    C : (k, N) csr_matrix
        Rows of the contacts.

    Attributes
    ----------
    response : (N + b, k) array
        W.
    compliance : (k, k) array
        S, mm/N.
    """

    def __init__(self, matrix: PETSc.Mat, C: csr_matrix):
        self._matrix, (k, N) = matrix, C.shape
        self._size = matrix.getSize()[0] - k
        self._right, self._left = matrix.createVecs()
        self._last: tuple[np.ndarray, np.ndarray] | None = None
        self._ksp = PETSc.KSP().create(matrix.getComm())
        self._ksp.setOperators(matrix)
        self._ksp.setType("preonly")
        pc = self._ksp.getPC()
        pc.setType("lu")
        pc.setFactorSolverType("mumps")
        unit = np.eye(k)
        self.response = np.column_stack([self._inverse(np.concatenate([np.zeros(self._size), f])) for f in unit])
        self.compliance = C @ self.response[:N]

    def __del__(self):
        """Free the factors, which petsc4py would keep to the end of the process."""
        for held in ("_ksp", "_matrix"):
            if hasattr(self, held):
                getattr(self, held).destroy()

    def unloaded(self, p: np.ndarray, v: np.ndarray) -> np.ndarray:
        """(N + b,) A⁻¹ (p, v): u and r where no contact carries anything; the last loads asked for are remembered."""
        loads = np.concatenate([p, v])
        if self._last is None or not np.array_equal(self._last[0], loads):
            right = np.concatenate([loads, np.zeros(self.response.shape[1])])
            self._last = loads, self._inverse(right)
        return self._last[1]

    def _inverse(self, right):
        """Solved, and refined once."""
        x = self._solve(right)
        self._right.setArray(x)
        self._matrix.mult(self._right, self._left)
        return (x + self._solve(right - self._left.getArray()))[: self._size]

    def _solve(self, right):
        self._left.setArray(right)
        self._ksp.solve(self._left, self._right)
        return self._right.getArray().copy()
