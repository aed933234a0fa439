"""Influence coefficients H = L K⁻¹ Lᵀ of one matrix, and of many parts distributed over processes."""

from __future__ import annotations

import warnings
from collections.abc import Callable, Mapping
from typing import Protocol

import numpy as np
from mpi4py import MPI
from scipy.sparse import csr_matrix

from fem_reference.shell.factorisation import (
    BLOCK,
    Factorisation,
    FactorisationError,
    NoSchurComplement,
    OutOfMemory,
    upper_triangle,
)
from mic.compliance.functional import Functionals

__all__ = ["Body", "compute_influence", "influence_matrix"]


class Body(Protocol):
    """A body with influence coefficients, such as :class:`fem_reference.shell.part.ShellPart`."""

    def influence(self, functionals: Functionals) -> tuple[np.ndarray, np.ndarray]:
        """H (n, n) and G (n, 6) at the functionals."""
        ...


def compute_influence(
    parts: Mapping[str, Callable[[], Body]],
    functionals: Mapping[str, Functionals],
    comm: MPI.Comm = MPI.COMM_WORLD,
) -> dict[str, tuple[np.ndarray, np.ndarray]]:
    """H (n, n) and G (n, 6) of every part, with the parts distributed over the processes.

    Each part is factorised on one process, so that the result does not depend on the number of processes. A serial
    factorisation for each part is faster than a distributed one at these sizes. Processes in excess of the number of
    parts stay idle.

    Parameters
    ----------
    parts
        Functions that build the parts on `MPI.COMM_SELF`; called only on the process that owns the part.
    functionals
        The retained functionals of each part, by part name.
    comm
        The processes; each gets the whole result.
    """
    # longest processing time first: each part goes to the process with the least load
    load = np.zeros(comm.size)
    owner = {}
    for name in sorted(parts, key=lambda name: -len(functionals[name])):
        owner[name] = int(np.argmin(load))
        load[owner[name]] += 1 + len(functionals[name])
    mine = {name: parts[name]().influence(functionals[name]) for name in parts if owner[name] == comm.rank}
    return {name: _shared(mine.get(name), len(functionals[name]), comm, owner[name]) for name in parts}


def _shared(own, n, comm, owner):
    """Broadcast H and G from their owner as arrays: pickling would take three times their memory."""
    if comm.size == 1:
        return own
    matrices = own or (np.empty((n, n)), np.empty((n, 6)))
    whole = tuple(np.ascontiguousarray(matrix) for matrix in matrices)
    for matrix in whole:
        comm.Bcast(matrix, root=owner)
    return whole


def influence_matrix(K: csr_matrix, L: csr_matrix) -> tuple[np.ndarray, Factorisation]:
    """H = L K⁻¹ Lᵀ (n, n) for sparse SPD K (m, m) and sparse L (n, m), with the factorisation of K.

    H is the Schur complement. If MUMPS lacks the memory or cannot be called directly, H is computed from blocks of
    sparse right-hand sides. A few columns are solved again and checked by their residuals with K. Only the upper
    triangle of K is read.

    Raises
    ------
    FactorisationError
        If the factorisation fails or H fails the check.
    """
    n, K = L.shape[0], upper_triangle(K)
    factorisation = None
    if n:
        try:
            factorisation = Factorisation(K, L)
            H = factorisation.influence
        except (OutOfMemory, NoSchurComplement) as problem:
            warnings.warn(f"{problem}. Falling back to blocks of right-hand sides, several times slower", stacklevel=2)
    if factorisation is None:
        factorisation = Factorisation(K)
        H = np.empty((n, n))
        for first in range(0, n, BLOCK):
            H[:, first : first + BLOCK] = L @ factorisation.solve_sparse(L[first : first + BLOCK])
        H = 0.5 * (H + H.T)
    _check(H, K, L, factorisation)
    return H, factorisation


def _check(H, K, L, factorisation, columns: int = 3) -> None:
    """Raise unless a few columns of H agree with solves of small backward error (Rigal and Gaches).

    K is an upper triangle.
    """
    # a functional of pinned freedoms only has an empty row and H = 0
    loaded = np.flatnonzero(np.diff(L.indptr))
    if not len(loaded):
        return
    chosen = loaded[np.unique(np.linspace(0, len(loaded) - 1, columns).astype(int))]
    B = L[chosen].T.toarray()
    X = factorisation.solve_sparse(L[chosen])
    diagonal, size = K.diagonal(), csr_matrix((abs(K.data), K.indices, K.indptr), K.shape)
    ones = np.ones(K.shape[0])
    norm_K = (size @ ones + size.T @ ones - abs(diagonal)).max()
    residual = K @ X + K.T @ X - diagonal[:, None] * X - B
    backward = abs(residual).max(axis=0) / (norm_K * abs(X).max(axis=0) + abs(B).max(axis=0))
    difference = abs(L @ X - H[:, chosen]).max() / abs(H).max()
    if not (np.all(backward < 1e-11) and difference < 1e-8):
        raise FactorisationError(
            f"influence coefficients fail their check: backward error {max(backward):.1e} (allowed 1e-11), "
            f"difference from separate solves {difference:.1e} of the largest (allowed 1e-8); the stiffness is too "
            "badly conditioned"
        )
