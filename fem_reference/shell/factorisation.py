"""Cholesky factors of a sheet's stiffness, and H = L K⁻¹ Lᵀ at the cost of one factorisation.

K (SPD, the pinned part) bordered by n retained functionals L,

    ⎡ K  Lᵀ ⎤          has the Schur complement      0 − L K⁻¹ Lᵀ = −H
    ⎣ L  0  ⎦

on its last n rows. A multifrontal solver that is told to stop before those rows (MUMPS: ICNTL(19)) has it in the front
that remains, while the factors of K serve further solves. The pivots are those of K alone, so Cholesky applies though
the bordered matrix is indefinite.
"""

from __future__ import annotations

import ctypes
from functools import cache

import numpy as np
from petsc4py import PETSc
from scipy.sparse import bmat, csr_matrix, dia_matrix
from threadpoolctl import threadpool_limits

from mic.errors import MicError

__all__ = ["BLOCK", "Factorisation", "FactorisationError", "NoSchurComplement", "OutOfMemory"]

BLOCK = 96  # right-hand sides per sweep: more of them at once only cost memory

# MUMPS's numbers of what this module sets or reads (MUMPS 5.5 users' guide, sections 5 and 6)
_ICNTL_SCHUR_SOLVE = 26  # 0: solve with K only, as if there were no border
_ICNTL_RHS_BLOCK = 27  # columns handled at once in a solve
_INFOG_STATUS = 1  # negative: failure
_INFOG_NEGATIVE_PIVOTS = 12
_INFOG_MEMORY = 19  # MB, over all processes

# How many threads share a product of MUMPS's moves the last digits of H, by 1e-9 of its largest entry for a sheet that
# is badly conditioned. One thread always: the same bits on any number of them, and fronts this small cost no more time.
_one_thread = threadpool_limits.wrap(limits=1, user_api="blas")


class FactorisationError(MicError, RuntimeError):
    """The direct solver failed; the text says why and what to change."""


class OutOfMemory(FactorisationError):
    """MUMPS could not get the memory that it needs."""


class NoSchurComplement(FactorisationError):
    """This PETSc gives no Schur complements; it can still factorise and solve."""


class Factorisation:
    """Cholesky factors of a sparse SPD matrix and, at no further cost, L K⁻¹ Lᵀ for given rows L.

    Parameters
    ----------
    K : csr_matrix (m, m)
        Symmetric positive definite.
    L : csr_matrix (n, m), optional
        Rows of which `influence` is wanted.

    Attributes
    ----------
    influence : (n, n) array or None
        L K⁻¹ Lᵀ, exactly symmetric.
    memory : float
        MB that MUMPS used.

    Raises
    ------
    OutOfMemory
        If the memory does not suffice.
    NoSchurComplement
        If L is given and this PETSc cannot compute its Schur complement.
    FactorisationError
        If K is not positive definite.
    """

    @_one_thread
    def __init__(self, K: csr_matrix, L: csr_matrix | None = None):
        self.size = m = K.shape[0]
        n = 0 if L is None else L.shape[0]
        matrix = K
        if n:
            corner = dia_matrix((np.zeros((1, n)), [0]), shape=(n, n)).tocsr()
            matrix = bmat([[K, L.T], [L, corner]], format="csr")
        self._matrix = _petsc_matrix(matrix)
        self._matrix.setOption(PETSc.Mat.Option.SPD, True)
        self._pc = PETSc.PC().create(PETSc.COMM_SELF)
        self._pc.setOperators(self._matrix)
        self._pc.setType("cholesky")
        self._pc.setFactorSolverType("mumps")
        self._pc.setFactorSetUpSolverType()
        self._factor = self._pc.getFactorMatrix()
        self._factor.setMumpsIcntl(_ICNTL_RHS_BLOCK, 64)
        if n:
            _set_schur_rows(self._factor, np.arange(m, m + n))
        self._pc.setUp()
        status = self._factor.getMumpsInfog(_INFOG_STATUS)
        if status < 0:
            raise _failure(status, self._factor.getMumpsInfog(2))
        if self._factor.getMumpsInfog(_INFOG_NEGATIVE_PIVOTS) > 0:
            raise FactorisationError(
                "the stiffness is not positive definite: the part holds a mechanism, or is too thin for its size"
            )
        self.memory = float(self._factor.getMumpsInfog(_INFOG_MEMORY))
        self.influence = None
        if n:
            schur = _schur_complement(self._factor, n)
            self.influence = -(np.tril(schur) + np.tril(schur, -1).T)
            self._factor.setMumpsIcntl(_ICNTL_SCHUR_SOLVE, 0)

    def __del__(self):  # left to itself, petsc4py keeps the factors, hundreds of MB each, to the end of the process
        for held in ("_factor", "_pc", "_matrix"):
            if hasattr(self, held):
                getattr(self, held).destroy()

    @_one_thread
    def solve(self, right: np.ndarray) -> np.ndarray:
        """K⁻¹ B for dense columns B (m, r)."""
        solution = np.empty((self.size, right.shape[1]))
        for first in range(0, right.shape[1], BLOCK):
            columns = right[:, first : first + BLOCK]
            padded = np.zeros((self._matrix.size[0], columns.shape[1]), order="F")
            padded[: self.size] = columns
            B = PETSc.Mat().createDense(padded.shape, array=padded, comm=PETSc.COMM_SELF)
            solution[:, first : first + BLOCK] = self._sweep(B, columns.shape[1])
            B.destroy()
        return solution

    @_one_thread
    def solve_sparse(self, right: csr_matrix) -> np.ndarray:
        """K⁻¹ Bᵀ for the sparse rows B (r, m): one sweep, so keep r near `BLOCK`."""
        right = csr_matrix((right.data, right.indices, right.indptr), shape=(right.shape[0], self._matrix.size[0]))
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
        solution = X.getDenseArray()[: self.size].copy()  # the view does not keep X alive
        X.destroy()
        return solution


def _petsc_matrix(matrix: csr_matrix) -> PETSc.Mat:
    matrix.sort_indices()
    csr = (matrix.indptr.astype(PETSc.IntType), matrix.indices.astype(PETSc.IntType), matrix.data)
    return PETSc.Mat().createAIJ(matrix.shape, csr=csr, comm=PETSc.COMM_SELF)


def _failure(status: int, detail: int) -> FactorisationError:
    """The error that MUMPS's INFOG(1) = `status` stands for."""
    kind = FactorisationError
    if status == -10:
        reason = "the matrix is singular: the part is not in one piece, or its triangles hold a mechanism"
    elif status in (-8, -9, -11, -13, -14, -15, -17, -19, -20):
        kind = OutOfMemory
        reason = "memory ran out: use fewer functionals at once, a coarser mesh or more memory"
    else:
        reason = "see the MUMPS users' guide"
    return kind(f"MUMPS reports INFOG(1) = {status}, INFOG(2) = {detail}: {reason}")


@cache
def _petsc() -> ctypes.CDLL:
    """The very library that petsc4py has loaded, for the C calls that petsc4py does not wrap in every version."""
    pointer, integer = ctypes.c_void_p, ctypes.c_int
    try:
        library = ctypes.CDLL(PETSc.__file__)  # symbols are looked up in its dependencies as well
        library.MatFactorSetSchurIS.argtypes = [pointer, pointer]
        library.MatFactorCreateSchurComplement.argtypes = [pointer, ctypes.POINTER(pointer), ctypes.POINTER(integer)]
        library.MatDenseGetArrayRead.argtypes = [pointer, ctypes.POINTER(ctypes.POINTER(ctypes.c_double))]
        library.MatDenseRestoreArrayRead.argtypes = library.MatDenseGetArrayRead.argtypes
        library.MatDestroy.argtypes = [ctypes.POINTER(pointer)]
    except (OSError, AttributeError) as problem:  # pragma: no cover - no such PETSc build is known
        raise NoSchurComplement(f"no Schur complements from this PETSc ({problem})") from problem
    return library


def _checked(code: int) -> None:
    if code:
        raise FactorisationError(f"PETSc returned error {code} from its Schur complement interface")


def _set_schur_rows(factor: PETSc.Mat, rows: np.ndarray) -> None:
    index_set = PETSc.IS().createGeneral(rows.astype(PETSc.IntType), comm=PETSc.COMM_SELF)
    _checked(_petsc().MatFactorSetSchurIS(factor.handle, index_set.handle))


def _schur_complement(factor: PETSc.Mat, n: int) -> np.ndarray:
    petsc, schur, status = _petsc(), ctypes.c_void_p(), ctypes.c_int()
    _checked(petsc.MatFactorCreateSchurComplement(factor.handle, ctypes.byref(schur), ctypes.byref(status)))
    values = ctypes.POINTER(ctypes.c_double)()
    _checked(petsc.MatDenseGetArrayRead(schur, ctypes.byref(values)))
    matrix = np.ctypeslib.as_array(values, (n, n)).T.copy()  # PETSc stores columns
    _checked(petsc.MatDenseRestoreArrayRead(schur, ctypes.byref(values)))
    _checked(petsc.MatDestroy(ctypes.byref(schur)))
    return matrix
