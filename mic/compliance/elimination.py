"""Bilateral rows eliminated: what a fixture leaves of the parts' compliance.

Notation, with rows D over the stacked functionals, free-body compliance H and rigid-body readings G, block-diagonal
over the parts: under functional forces f and rigid motions q the readings are ``y = H f + G q`` with ``Gᵀ f = 0``.

1. Choose 6P bilateral rows A, as many as the P parts have rigid motions, so that ``A G`` is well conditioned.
   With ``Q = G (A G)⁻¹`` and ``Π = I - Q A``, ``H_s = Π H Πᵀ`` is the compliance supported on A, and
   ``y = H_s f + Q v_A`` for any f, the reactions on A included implicitly. For rows J and K no more is needed than
   gathers:

       J H_s Kᵀ = J H Kᵀ - (J Q) Y_Kᵀ - Y_J (K Q)ᵀ,        Y_J = J H Aᵀ - ½ (J Q)(A H Aᵀ).

2. Eliminate the remaining bilateral rows R densely: ``λ_R = (R H_s Rᵀ)⁻¹ (v_R - R Q v_A - R H_s f)``. For rows C this
   leaves equation (7) of the paper, ``δ = S f_C + T v``, with ``S = H_CC - H_CR H_RR⁻¹ H_RC``.

A row that yields by c per unit force reads ``v - c λ`` in place of v. Rows R that do add c to ``R H_s Rᵀ``. For rows A,
``λ_A = -(J Q)ᵀ f_J`` of the forces f_J on all other rows, so that ``J H_s Kᵀ`` grows by ``(J Q) c_A (K Q)ᵀ``.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.linalg import cho_solve, lapack
from scipy.sparse import csr_matrix, vstack

from mic.compliance.blocks import Blocks
from mic.compliance.support import motion_size, statically_determinate

__all__ = ["Response", "eliminate"]

REDUNDANT = 1e-9  # a row whose compliance falls below this share of its own when the others hold is redundant


@dataclass(frozen=True)
class Response:
    """Linear response of held parts at chosen rows.

    Bilateral rows carry prescribed values ``v``; contact rows and load rows carry forces.

    Attributes
    ----------
    S : (c, c) array
        Contact compliance, equation (7); symmetric positive semidefinite.
    T : (c, b) array
        Motion of the contact rows per prescribed value.
    L : (c, l) array
        Motion of the contact rows per load.
    S_out, T_out, L_out : arrays with (o, ...) rows
        The same for the output rows.
    reaction_S, reaction_T, reaction_L : arrays with (b, ...) rows
        Force that each bilateral row exerts on the parts (positive along the row), per contact force, value and load.
    redundant : tuple of int
        Bilateral rows that the others already hold; they carry no force and their value has no effect.
    """

    S: np.ndarray
    T: np.ndarray
    L: np.ndarray
    S_out: np.ndarray
    T_out: np.ndarray
    L_out: np.ndarray
    reaction_S: np.ndarray
    reaction_T: np.ndarray
    reaction_L: np.ndarray
    redundant: tuple[int, ...]


def eliminate(
    compliance: Blocks,
    bilateral: csr_matrix,
    contact: csr_matrix,
    load: csr_matrix,
    output: csr_matrix,
    yielding: np.ndarray | None = None,
) -> Response:
    """Eliminate bilateral rows.

    Parameters
    ----------
    compliance : Blocks
        Of the free parts.
    bilateral, contact, load, output : (b|c|l|o, F) csr_matrix
        Rows over the stacked functionals.
    yielding : (b,) array, optional
        By how much each bilateral row yields under its force, mm/N; left out, none does.

    Raises
    ------
    FreeMotion
        If the bilateral rows leave a rigid motion free.
    """
    b, c, l, o = (rows.shape[0] for rows in (bilateral, contact, load, output))
    rigid = compliance.rigid(bilateral)
    support = statically_determinate(rigid, motion_size(compliance.G))
    rest = np.setdiff1d(np.arange(b), support)
    A, AG = bilateral[support], rigid[support]
    J = vstack([bilateral[rest], contact, load, output], format="csr")
    JQ = np.linalg.solve(AG.T, np.vstack([rigid[rest], compliance.rigid(J[len(rest) :])]).T).T
    Y = compliance.gather(J, A) - 0.5 * JQ @ compliance.gather(A, A)
    # Outputs carry no forces, so that they have rows but no columns.
    forced = slice(0, len(rest) + c + l)
    supported = compliance.gather(J, J[forced]) - JQ @ Y[forced].T - Y @ JQ[forced].T
    supported[forced] = 0.5 * (supported[forced] + supported[forced].T)
    R = slice(0, len(rest))
    if yielding is not None:
        supported += JQ @ (yielding[support, None] * JQ[forced].T)
        supported[R, R] += np.diag(yielding[rest])
    kept = _independent(supported[R, R], compliance.diagonal(bilateral[rest]))
    # X = H_RR⁻¹ [H_RF, -R Q, I]: forces of the eliminated rows per unit of everything else.
    H_FR = supported[len(rest) :, kept]  # (c + l + o, kept)
    loaded = slice(0, c + l)
    values = np.zeros((len(kept), b))
    values[:, support] = -JQ[kept]
    values[np.arange(len(kept)), rest[kept]] = 1.0
    solve = _cholesky_solver(supported[np.ix_(kept, kept)])
    X_F, X_v = solve(H_FR[loaded].T), solve(values)
    direct = np.zeros((c + l + o, b))
    direct[:, support] = JQ[len(rest) :]
    response_F = supported[len(rest) :, len(rest) :] - H_FR @ X_F
    response_v = direct + H_FR @ X_v
    # Reactions: R from the elimination, A from the balance Gᵀ(Aᵀ λ_A + Jᵀ f) = 0, that is λ_A = -(J Q)ᵀ f.
    reaction_F, reaction_v = np.zeros((b, c + l)), np.zeros((b, b))
    reaction_F[rest[kept]], reaction_v[rest[kept]] = -X_F, X_v
    reaction_F[support] = JQ[kept].T @ X_F - JQ[len(rest) : len(rest) + c + l].T
    reaction_v[support] = -JQ[kept].T @ X_v
    C, L, O = slice(0, c), slice(c, c + l), slice(c + l, c + l + o)
    S = response_F[C, C]
    return Response(
        S=0.5 * (S + S.T),
        T=response_v[C],
        L=response_F[C, L],
        S_out=response_F[O, C],
        T_out=response_v[O],
        L_out=response_F[O, L],
        reaction_S=reaction_F[:, C],
        reaction_T=reaction_v,
        reaction_L=reaction_F[:, L],
        redundant=tuple(int(i) for i in np.delete(rest, kept)),
    )


def _independent(matrix, reference):
    """Rows of a compliance block that do not follow from each other, ascending; each is measured against its own
    `reference`."""
    if len(matrix) == 0:
        return np.zeros(0, dtype=int)
    d = 1 / np.sqrt(np.maximum(reference, np.diag(matrix)).clip(1e-300))
    scaled = matrix * np.outer(d, d)
    _, pivot, rank, _ = lapack.dpstrf(scaled, tol=REDUNDANT, lower=1)
    if scaled.diagonal().max() <= REDUNDANT:  # LAPACK takes the first pivot without looking at the tolerance
        rank = 0
    return np.sort(pivot[:rank] - 1)


def _cholesky_solver(matrix):
    if len(matrix) == 0:
        return lambda rhs: np.zeros((0, rhs.shape[1]))
    d = 1 / np.sqrt(np.diag(matrix))
    factor = np.linalg.cholesky(matrix * np.outer(d, d))
    return lambda rhs: d[:, None] * cho_solve((factor, True), d[:, None] * rhs)
