"""Cholesky factors of a sheet's stiffness, and H = L K⁻¹ Lᵀ at the cost of one factorisation.

K (SPD, the pinned part) bordered by n retained functionals L,

    ⎡ K  Lᵀ ⎤          has the Schur complement      0 − L K⁻¹ Lᵀ = −H
    ⎣ L  0  ⎦

on its last n rows. A multifrontal solver that stops before those rows (MUMPS: ICNTL(19)) returns it as the remaining
front, and the factors of K serve further solves. All pivots belong to K, so Cholesky applies although the bordered
matrix is indefinite. The elimination order is a nested dissection of K, followed by the border.
"""

from __future__ import annotations

import ctypes

import numpy as np
from petsc4py import PETSc
from scipy.sparse import csr_matrix, triu
from threadpoolctl import threadpool_limits

from fem_reference.shell.mumps import Instance, MumpsFailure, Unavailable
from fem_reference.shell.ordering import nested_dissection
from mic.errors import MicError

__all__ = [
    "BLOCK",
    "Factorisation",
    "FactorisationError",
    "NoSchurComplement",
    "OutOfMemory",
    "PetscFactors",
    "upper_triangle",
]

BLOCK = 96  # right-hand sides of a solve; larger blocks are not faster

_LARGE = 1e8  # bytes of matrix values; larger matrices return free memory to the system first, for a tenth of the time

# Numbers of the control and information parameters (MUMPS 5.5 users' guide, sections 5 and 6)
_SPD = 1  # SYM
_ANALYSIS, _FACTORISATION, _SOLUTION = 1, 2, 3  # JOB
_ICNTL_ORDERING, _GIVEN = 7, 1
_ICNTL_EXTRA_MEMORY = 14  # per cent
_ICNTL_SCHUR, _BY_ROWS = 19, 1
_ICNTL_RIGHT_SIDES, _DENSE, _SPARSE = 20, 0, 1
_ICNTL_RHS_BLOCK = 27  # columns handled at once in a solve
_INFOG_STATUS = 1  # negative: failure
_INFOG_NEGATIVE_PIVOTS = 12
_INFOG_MEMORY = 19  # MB, over all processes

# The number of BLAS threads changes the last digits of H, by 1e-9 of its largest entry for an ill-conditioned sheet.
# MUMPS always uses one thread, which gives the same bits everywhere and is not slower for such small fronts.
_one_thread = threadpool_limits.wrap(limits=1, user_api="blas")


class FactorisationError(MicError, RuntimeError):
    """The direct solver failed; the message names the cause and the remedy."""


class OutOfMemory(FactorisationError):
    """MUMPS ran out of memory."""


class NoSchurComplement(FactorisationError):
    """MUMPS cannot be called directly, so there are no Schur complements; PETSc can still factorise and solve."""


class Factorisation:
    """Cholesky factors of a sparse SPD matrix and, at no further cost, L K⁻¹ Lᵀ for given rows L.

    Parameters
    ----------
    K : csr_matrix (m, m)
        Symmetric positive definite; only its upper triangle is read.
    L : csr_matrix (n, m), optional
        Rows of `influence`.

    Attributes
    ----------
    influence : (n, n) array or None
        L K⁻¹ Lᵀ, exactly symmetric.
    memory : float
        Memory used by MUMPS, MB.

    Raises
    ------
    OutOfMemory
        If MUMPS runs out of memory.
    NoSchurComplement
        If L is given and MUMPS cannot be called directly.
    FactorisationError
        If K is not positive definite.
    """

    @_one_thread
    def __init__(self, K: csr_matrix, L: csr_matrix | None = None):
        self.size = K.shape[0]
        K = upper_triangle(K)
        L = csr_matrix((0, self.size)) if L is None else L
        self.influence: np.ndarray | None = None
        self._factors: _Factors | PetscFactors
        try:
            self._factors = _Factors(K, L)
            self.influence = self._factors.influence
        except Unavailable as problem:
            if L.shape[0]:
                raise NoSchurComplement(f"no Schur complements: {problem}") from problem
            self._factors = PetscFactors((K + triu(K, 1).T).tocsr())
        except MumpsFailure as problem:
            raise _failure(problem) from problem
        if self._factors.negative_pivots:
            raise FactorisationError(
                "the stiffness is not positive definite: the part has a mechanism, is too thin for its size, or has "
                "elements that are too narrow; remesh the part"
            )
        self.memory = self._factors.memory

    @_one_thread
    def solve(self, right: np.ndarray) -> np.ndarray:
        """K⁻¹ B for dense columns B (m, r)."""
        solution = np.empty((self.size, right.shape[1]))
        for first in range(0, right.shape[1], BLOCK):
            columns = slice(first, first + BLOCK)
            solution[:, columns] = self._factors.solve(right[:, columns])
        return solution

    @_one_thread
    def solve_sparse(self, right: csr_matrix) -> np.ndarray:
        """K⁻¹ Bᵀ for the sparse rows B (r, m): one sweep, so keep r near `BLOCK`."""
        return self._factors.solve_sparse(right)


def upper_triangle(K: csr_matrix) -> csr_matrix:
    """Upper triangle of K (m, m) with its diagonal; K itself if it is upper triangular."""
    row = np.repeat(np.arange(K.shape[0], dtype=K.indices.dtype), np.diff(K.indptr))
    kept = K.indices >= row
    if kept.all():
        return K
    starts = np.zeros(K.shape[0] + 1, dtype=K.indptr.dtype)
    np.cumsum(np.bincount(row[kept], minlength=K.shape[0]), out=starts[1:])
    return csr_matrix((K.data[kept], K.indices[kept], starts), shape=K.shape)


def _mirrored(lower: np.ndarray) -> np.ndarray:
    """The array (n, n) with its lower triangle copied to the upper one, in place: MUMPS fills only the lower one."""
    for first in range(0, len(lower), BLOCK):
        own, rest = slice(first, first + BLOCK), slice(first + BLOCK, None)
        lower[own, own] = np.tril(lower[own, own]) + np.tril(lower[own, own], -1).T
        lower[own, rest] = lower[rest, own].T
    return lower


class _Factors:
    """K's factors and L K⁻¹ Lᵀ by MUMPS itself; K (m, m) on and above the diagonal, L (n, m) with any n.

    Solves are those with K alone, as if there were no border (ICNTL(26) = 0, the default).
    """

    def __init__(self, K: csr_matrix, L: csr_matrix):
        self._mumps = mumps = Instance(_SPD)
        self.influence: np.ndarray | None = None
        m, n = K.shape[0], L.shape[0]
        self._rows = m, m + n
        row, column, value = _triples(K, L)
        mumps.set(n=m + n, nnz=len(value))
        mumps.give(irn=row, jcn=column, a=value)
        places = nested_dissection(K)
        if places is not None:
            mumps.control(_ICNTL_ORDERING, _GIVEN)
            mumps.give(perm_in=np.concatenate([places, np.arange(m, m + n, dtype=np.int32)]) + np.int32(1))
        if n:
            schur = np.empty((n, n))
            mumps.control(_ICNTL_SCHUR, _BY_ROWS)
            mumps.set(size_schur=n)
            mumps.give(listvar_schur=np.arange(m + 1, m + n + 1, dtype=np.int32), schur=schur)
        if value.nbytes > _LARGE:
            _give_freed_memory_back()
        mumps.control(_ICNTL_EXTRA_MEMORY, 0)  # pivots come as they are: what the analysis foresees is exact
        try:
            mumps.run(_ANALYSIS)
            mumps.run(_FACTORISATION)
        except MumpsFailure:
            mumps.close()
            raise
        mumps.take_back("irn", "jcn", "a", "perm_in", "schur")
        self.negative_pivots = mumps.information(_INFOG_NEGATIVE_PIVOTS)
        self.memory = float(mumps.information(_INFOG_MEMORY))
        if n:
            self.influence = np.negative(_mirrored(schur), out=schur)
        mumps.control(_ICNTL_RHS_BLOCK, 64)

    def solve(self, right: np.ndarray) -> np.ndarray:
        m, rows = self._rows
        solution = np.zeros((rows, right.shape[1]), order="F")
        solution[:m] = right
        self._mumps.control(_ICNTL_RIGHT_SIDES, _DENSE)
        return self._solved(solution)

    def solve_sparse(self, right: csr_matrix) -> np.ndarray:
        solution = np.zeros((self._rows[1], right.shape[0]), order="F")
        self._mumps.control(_ICNTL_RIGHT_SIDES, _SPARSE)
        self._mumps.set(nz_rhs=right.nnz)
        self._mumps.give(
            rhs_sparse=np.asarray(right.data, dtype=float),
            irhs_sparse=right.indices.astype(np.int32) + np.int32(1),
            irhs_ptr=right.indptr.astype(np.int32) + np.int32(1),
        )
        return self._solved(solution)

    def _solved(self, solution):
        """Solve in place: the solution overwrites dense right-hand sides."""
        m, rows = self._rows
        self._mumps.set(nrhs=solution.shape[1], lrhs=rows)
        self._mumps.give(rhs=solution)
        try:
            self._mumps.run(_SOLUTION)
        except MumpsFailure as problem:
            raise _failure(problem) from problem
        finally:
            self._mumps.take_back("rhs", "rhs_sparse", "irhs_sparse", "irhs_ptr")
        return solution[:m]


def _give_freed_memory_back() -> None:
    """Return fragmented free memory to the system, so that MUMPS can allocate one large block.

    After the assembly of a sheet it exceeds the memory of mesh and stiffness.
    """
    trim = getattr(ctypes.pythonapi, "malloc_trim", None)  # glibc only; pythonapi is the process itself
    if trim is not None:
        trim(0)


def _triples(K: csr_matrix, L: csr_matrix) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Row numbers, column numbers (from 1) and values of the upper triangle of K and of L below it.

    K then shares the memory of these values, so that they are not stored twice at the peak of memory.
    """
    row, column, value = (np.empty(K.nnz + L.nnz, dtype) for dtype in (np.int32, np.int32, float))
    for matrix, first, entries in ((K, 0, slice(0, K.nnz)), (L, K.shape[0], slice(K.nnz, None))):
        ends = first + 1 + np.arange(matrix.shape[0], dtype=np.int32)
        row[entries] = np.repeat(ends, np.diff(matrix.indptr))
        np.add(matrix.indices, 1, out=column[entries], casting="same_kind")
        value[entries] = matrix.data
    if K.data.dtype == value.dtype:
        K.data = value[: K.nnz]
    return row, column, value


class PetscFactors:
    """Factors of a symmetric matrix (m, m) by MUMPS through PETSc, in the elimination order that MUMPS chooses.

    Parameters
    ----------
    whole : csr_matrix (m, m)
        Both triangles.
    definite : bool
        Whether the matrix is positive definite. Otherwise delayed pivots need extra memory.

    Raises
    ------
    FactorisationError
        If it cannot be factorised.
    """

    def __init__(self, whole: csr_matrix, definite: bool = True):
        self._matrix = _petsc_matrix(whole)
        self._matrix.setOption(PETSc.Mat.Option.SPD if definite else PETSc.Mat.Option.SYMMETRIC, True)
        self._pc = PETSc.PC().create(PETSc.COMM_SELF)
        self._pc.setOperators(self._matrix)
        self._pc.setType("cholesky")
        self._pc.setFactorSolverType("mumps")
        self._pc.setFactorSetUpSolverType()
        self._factor = self._pc.getFactorMatrix()
        self._factor.setMumpsIcntl(_ICNTL_RHS_BLOCK, 64)
        if not definite:
            self._factor.setMumpsIcntl(_ICNTL_EXTRA_MEMORY, 80)
        self._pc.setUp()
        status = self._factor.getMumpsInfog(_INFOG_STATUS)
        if status < 0:
            raise _failure(MumpsFailure(status, self._factor.getMumpsInfog(2)))
        self.negative_pivots = self._factor.getMumpsInfog(_INFOG_NEGATIVE_PIVOTS)
        self.memory = float(self._factor.getMumpsInfog(_INFOG_MEMORY))

    def __del__(self):  # petsc4py would not free the factors, hundreds of MB each, before the end of the process
        for held in ("_factor", "_pc", "_matrix"):
            if hasattr(self, held):
                getattr(self, held).destroy()

    def solve(self, right: np.ndarray) -> np.ndarray:
        columns = np.asfortranarray(right, dtype=float)
        B = PETSc.Mat().createDense(columns.shape, array=columns, comm=PETSc.COMM_SELF)
        solution = self._sweep(B, columns.shape[1])
        B.destroy()
        return solution

    def solve_sparse(self, right: csr_matrix) -> np.ndarray:
        rows = _petsc_matrix(right)
        B = PETSc.Mat().createTranspose(rows)
        solution = self._sweep(B, right.shape[0])
        B.destroy()
        rows.destroy()
        return solution

    def _sweep(self, B: PETSc.Mat, columns: int) -> np.ndarray:
        X = PETSc.Mat().createDense((self._matrix.size[0], columns), comm=PETSc.COMM_SELF)
        X.setUp()
        X.assemble()
        self._factor.matSolve(B, X)
        solution = X.getDenseArray().copy()  # the view does not keep X alive
        X.destroy()
        return solution


def _petsc_matrix(matrix: csr_matrix) -> PETSc.Mat:
    matrix.sort_indices()
    csr = (matrix.indptr.astype(PETSc.IntType), matrix.indices.astype(PETSc.IntType), matrix.data)
    return PETSc.Mat().createAIJ(matrix.shape, csr=csr, comm=PETSc.COMM_SELF)


def _failure(problem: MumpsFailure) -> FactorisationError:
    """The error for a status of MUMPS."""
    kind = FactorisationError
    if problem.status in (-10, -40):
        reason = "the matrix is singular: the part is not connected, or its triangles form a mechanism"
    elif problem.status in (-8, -9, -11, -13, -14, -15, -17, -19, -20):
        kind = OutOfMemory
        reason = "memory ran out: use fewer functionals at once, a coarser mesh or more memory"
    else:
        reason = "see the MUMPS users' guide"
    return kind(f"{problem}: {reason}")
