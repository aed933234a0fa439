"""Influence coefficients H = L K⁻¹ Lᵀ at the cost of one factorisation.

K (SPD, the pinned part) bordered by n retained functionals L,

    ⎡ K  Lᵀ ⎤          has the Schur complement      0 − L K⁻¹ Lᵀ = −H
    ⎣ L  0  ⎦

on its last n rows. A multifrontal solver that is told to stop before those rows (MUMPS: ICNTL(19)) has it in the front
that remains, while the factors of K serve further solves. The pivots are those of K alone, so Cholesky applies though
the bordered matrix is indefinite.
"""

from __future__ import annotations

import ctypes
import warnings
from collections.abc import Callable, Mapping
from typing import TYPE_CHECKING

import numpy as np
from mpi4py import MPI
from petsc4py import PETSc
from scipy.sparse import bmat, csr_matrix, dia_matrix

if TYPE_CHECKING:
    from fem_reference.shell.part import ShellPart
    from mic.compliance.functional import Functionals

BLOCK = 96  # right-hand sides per sweep: more of them at once only cost memory

# MUMPS's numbers of what this module sets or reads (MUMPS 5.5 users' guide, sections 5 and 6)
_ICNTL_SCHUR_SOLVE = 26  # 0: solve with K only, as if there were no border
_ICNTL_RHS_BLOCK = 27  # columns handled at once in a solve
_INFOG_STATUS = 1  # negative: failure
_INFOG_NEGATIVE_PIVOTS = 12
_INFOG_MEMORY = 19  # MB, over all processes


class FactorisationError(RuntimeError):
    """The direct solver failed; the text says why and what to change."""


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
    FactorisationError
        If K is not positive definite or the memory does not suffice.
    """

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
            _PETSC.set_schur(self._factor, np.arange(m, m + n))
        self._pc.setUp()
        status = self._factor.getMumpsInfog(_INFOG_STATUS)
        if status < 0:
            raise FactorisationError(_explain(status, self._factor.getMumpsInfog(2)))
        if self._factor.getMumpsInfog(_INFOG_NEGATIVE_PIVOTS) > 0:
            raise FactorisationError(
                "the stiffness is not positive definite: the part holds a mechanism, or is too thin for its size"
            )
        self.memory = float(self._factor.getMumpsInfog(_INFOG_MEMORY))
        self.influence = None
        if n:
            schur = _PETSC.schur_complement(self._factor, n)
            self.influence = -(np.tril(schur) + np.tril(schur, -1).T)
            self._factor.setMumpsIcntl(_ICNTL_SCHUR_SOLVE, 0)

    def __del__(self):  # left to itself, petsc4py keeps the factors, hundreds of MB each, to the end of the process
        for held in ("_factor", "_pc", "_matrix"):
            if hasattr(self, held):
                getattr(self, held).destroy()

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


def _explain(status: int, detail: int) -> str:
    if status == -10:
        reason = "the matrix is singular: the part is not in one piece, or its triangles hold a mechanism"
    elif status in (-8, -9, -11, -13, -14, -15, -17, -19, -20):
        reason = "memory ran out: use fewer functionals at once, a coarser mesh or more memory"
    else:
        reason = "see the MUMPS users' guide"
    return f"MUMPS reports INFOG(1) = {status}, INFOG(2) = {detail}: {reason}"


def influence_matrix(K: csr_matrix, L: csr_matrix) -> tuple[np.ndarray, Factorisation]:
    """H = L K⁻¹ Lᵀ (n, n) for sparse SPD K (m, m) and sparse L (n, m), with the factorisation that gave it.

    By the Schur complement; should that fail for lack of memory, by sweeps of sparse right-hand sides. A few columns
    are solved once more, and their residuals formed with K itself.

    Raises
    ------
    FactorisationError
        If the factorisation fails or H does not pass that check.
    """
    n = L.shape[0]
    factorisation = None
    if _PETSC is not None and n:
        try:
            factorisation = Factorisation(K, L)
            H = factorisation.influence
        except FactorisationError as problem:
            if "memory" not in str(problem):
                raise
            warnings.warn(f"{problem}. Falling back to blocks of right-hand sides", stacklevel=2)
    if factorisation is None:
        factorisation = Factorisation(K)
        H = np.empty((n, n))
        for first in range(0, n, BLOCK):
            H[:, first : first + BLOCK] = L @ factorisation.solve_sparse(L[first : first + BLOCK])
        H = 0.5 * (H + H.T)
    _check(H, K, L, factorisation)
    return H, factorisation


def _check(H, K, L, factorisation, columns: int = 3) -> None:
    """Raise unless a few columns of H agree with solves whose residual is small in the sense of Rigal and Gaches."""
    loaded = np.flatnonzero(
        np.diff(L.indptr)
    )  # a functional that reads pinned freedoms alone has an empty row and H = 0
    if not len(loaded):
        return
    chosen = loaded[np.unique(np.linspace(0, len(loaded) - 1, columns).astype(int))]
    B = L[chosen].T.toarray()
    X = factorisation.solve_sparse(L[chosen])
    norm_K = abs(K).sum(axis=1).max()
    backward = abs(K @ X - B).max(axis=0) / (norm_K * abs(X).max(axis=0) + abs(B).max(axis=0))
    difference = abs(L @ X - H[:, chosen]).max() / abs(H).max()
    if not (np.all(backward < 1e-11) and difference < 1e-8):
        raise FactorisationError(
            f"influence coefficients fail their check: backward error {max(backward):.1e} (allowed 1e-11), "
            f"difference from separate solves {difference:.1e} of the largest (allowed 1e-8); the stiffness is too "
            "badly conditioned"
        )


class _PetscLibrary:
    """The C calls that petsc4py does not wrap in every version, from the very library that petsc4py has loaded."""

    def __init__(self):
        library = ctypes.CDLL(PETSc.__file__)  # symbols are looked up in its dependencies as well
        pointer, integer = ctypes.c_void_p, ctypes.c_int
        self._set = library.MatFactorSetSchurIS
        self._set.argtypes = [pointer, pointer]
        self._create = library.MatFactorCreateSchurComplement
        self._create.argtypes = [pointer, ctypes.POINTER(pointer), ctypes.POINTER(integer)]
        self._array = library.MatDenseGetArrayRead
        self._array.argtypes = [pointer, ctypes.POINTER(ctypes.POINTER(ctypes.c_double))]
        self._restore = library.MatDenseRestoreArrayRead
        self._restore.argtypes = self._array.argtypes
        self._destroy = library.MatDestroy
        self._destroy.argtypes = [ctypes.POINTER(pointer)]

    @staticmethod
    def _check(code):
        if code:
            raise FactorisationError(f"PETSc returned error {code} from its Schur complement interface")

    def set_schur(self, factor: PETSc.Mat, rows: np.ndarray) -> None:
        index_set = PETSc.IS().createGeneral(rows.astype(PETSc.IntType), comm=PETSc.COMM_SELF)
        self._check(self._set(factor.handle, index_set.handle))

    def schur_complement(self, factor: PETSc.Mat, n: int) -> np.ndarray:
        schur, status = ctypes.c_void_p(), ctypes.c_int()
        self._check(self._create(factor.handle, ctypes.byref(schur), ctypes.byref(status)))
        values = ctypes.POINTER(ctypes.c_double)()
        self._check(self._array(schur, ctypes.byref(values)))
        matrix = np.ctypeslib.as_array(values, (n, n)).T.copy()  # PETSc stores columns
        self._check(self._restore(schur, ctypes.byref(values)))
        self._check(self._destroy(ctypes.byref(schur)))
        return matrix


try:
    _PETSC = _PetscLibrary()
except (OSError, AttributeError) as problem:  # pragma: no cover - no such PETSc build is known
    _PETSC = None
    warnings.warn(
        f"no Schur complements from this PETSc ({problem}): influence coefficients take several times longer",
        stacklevel=2,
    )


def compute_influence(
    parts: Mapping[str, Callable[[], ShellPart]],
    functionals: Mapping[str, Functionals],
    comm: MPI.Comm = MPI.COMM_WORLD,
) -> dict[str, tuple[np.ndarray, np.ndarray]]:
    """H (n, n) and G (n, 6) of every part, the parts shared out over the processes.

    Each part is factorised on one process alone (a serial factorisation per part beats a distributed one at these
    sizes), so that the result does not depend on how many there are. The Schur complement leaves no right-hand sides to
    share out further; processes beyond the number of parts have nothing to do.

    Parameters
    ----------
    parts
        What builds each part, on `MPI.COMM_SELF`; called only on the process that owns the part.
    functionals
        The retained functionals of each part, by the same names.
    comm
        The processes to share the work; the result is whole on each.
    """
    # the dearest first, each to the process with the least to do
    load = np.zeros(comm.size)
    owner = {}
    for name in sorted(parts, key=lambda name: -len(functionals[name])):
        owner[name] = int(np.argmin(load))
        load[owner[name]] += 1 + len(functionals[name])
    mine = {name: parts[name]().influence(functionals[name]) for name in parts if owner[name] == comm.rank}
    shared = {}
    for piece in comm.allgather(mine):
        shared.update(piece)
    return {name: shared[name] for name in parts}
