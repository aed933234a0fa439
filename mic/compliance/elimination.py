"""Bilateral rows eliminated: what a fixture leaves of the parts' compliance.

Notation, with rows D over the stacked functionals, free-body compliance H and rigid-body readings G, block-diagonal
over the parts: under functional forces f and rigid motions q the readings are ``y = H f + G q`` with ``Gᵀ f = 0``.

1. Choose 6P bilateral rows A, as many as the P parts have rigid motions, so that ``A G`` is well conditioned.
   With ``Q = G (A G)⁻¹`` and ``Π = I - Q A``, ``H_s = Π H Πᵀ`` is the compliance supported on A, and
   ``y = H_s f + Q v_A`` for any f, the reactions on A included implicitly. For rows J and K no more is needed than
   gathers:

       J H_s Kᵀ = J H Kᵀ - (J Q) Y_Kᵀ - Y_J (K Q)ᵀ,        Y_J = J H Aᵀ - ½ (J Q)(A H Aᵀ).

2. Eliminate the remaining bilateral rows R: ``λ_R = (R H_s Rᵀ)⁻¹ (v_R - R Q v_A - R H_s f)``. For rows C this leaves
   equation (7) of the paper, ``δ = S f_C + T v``, with ``S = H_CC - H_CR H_RR⁻¹ H_RC``.

S is a gather less a correction whose rank is 12 P and the number of rows R, and no more of it is formed than its
columns that are asked for.

A row that yields by c per unit force reads ``v - c λ`` in place of v. Rows R that do add c to ``R H_s Rᵀ``. For rows A,
``λ_A = -(J Q)ᵀ f_J`` of the forces f_J on all other rows, so that ``J H_s Kᵀ`` grows by ``(J Q) c_A (K Q)ᵀ``, as if
``A H Aᵀ`` in Y_J grew by c_A.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.linalg import lapack, solve_triangular
from scipy.sparse import csr_matrix

from mic.compliance.blocks import Blocks
from mic.compliance.support import motion_size, statically_determinate
from mic.contact.compliance_columns import Columns
from mic.system.matrix_product import product

__all__ = ["Response", "eliminate"]

REDUNDANT = 1e-9  # a row whose compliance falls below this share of its own when the others hold is redundant


@dataclass(frozen=True)
class Response:
    """Linear response of held parts at chosen rows.

    Bilateral rows carry prescribed values ``v``; contact rows and load rows carry forces.

    Attributes
    ----------
    S : (c, c) Columns
        Contact compliance, equation (7); symmetric positive semidefinite.
    own : (c,) array
        Its diagonal.
    T : (c, b) array
        Motion of the contact rows per prescribed value.
    L : (c, l) array
        Motion of the contact rows per load.
    S_out : (o, c) Columns
    T_out, L_out : arrays with (o, ...) rows
        The same for the output rows.
    reaction_S, reaction_T, reaction_L : arrays with (b, ...) rows
        Force that each bilateral row exerts on the parts (positive along the row), per contact force, value and load.
    redundant : tuple of int
        Bilateral rows that the others already hold; they carry no force and their value has no effect.
    """

    S: Columns
    own: np.ndarray
    T: np.ndarray
    L: np.ndarray
    S_out: Columns
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
    series: np.ndarray | None = None,
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
    series : (c,) array, optional
        What lies in series with each contact row, mm/N, and is added to the diagonal of S; left out, nothing.

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
    held = compliance.gather(A, A)
    if yielding is not None:
        held[np.diag_indices(len(support))] += yielding[support]
    R = _supported(compliance, bilateral[rest], rigid[rest], A, AG, held)
    H_RR = R.gather(R)
    H_RR = 0.5 * (H_RR + H_RR.T)
    if yielding is not None:
        H_RR[np.diag_indices(len(rest))] += yielding[rest]
    kept = _independent(H_RR, compliance.diagonal(bilateral[rest]))
    # H_RR = D⁻¹ C Cᵀ D⁻¹, so that H_CR H_RR⁻¹ H_RC = Z Zᵀ with Z = H_CR D C⁻ᵀ.
    D, C = _cholesky(H_RR[np.ix_(kept, kept)])
    R = R.take(kept)

    def corrected(rows: csr_matrix) -> tuple[Supported, np.ndarray]:
        own = _supported(compliance, rows, compliance.rigid(rows), A, AG, held)
        Z = solve_triangular(C, (own.gather(R) * D).T, lower=True).T if len(kept) else np.zeros((rows.shape[0], 0))
        return own, Z

    # λ_R = D C⁻ᵀ (C⁻¹ D (v_R - R Q v_A) - Zᵀ f), and λ_A = -(J Q)ᵀ f from the balance Gᵀ(Aᵀ λ_A + Jᵀ f) = 0.
    values = np.zeros((len(kept), b))
    values[:, support] = -R.JQ
    values[np.arange(len(kept)), rest[kept]] = 1.0
    spread = solve_triangular(C, np.diag(D), lower=True) if len(kept) else np.zeros((0, 0))  # C⁻¹ D
    X = spread @ values

    def moved(own: Supported, Z: np.ndarray) -> np.ndarray:
        direct = Z @ X
        direct[:, support] += own.JQ
        return direct

    def reactions(own: Supported, Z: np.ndarray) -> np.ndarray:
        found = np.zeros((b, len(Z)))
        found[rest[kept]] = -spread.T @ Z.T
        found[support] = -R.JQ.T @ found[rest[kept]] - own.JQ.T
        return found

    reaction_v = np.zeros((b, b))
    reaction_v[rest[kept]] = spread.T @ X
    reaction_v[support] = -R.JQ.T @ reaction_v[rest[kept]]
    contacts, loads, outputs = corrected(contact), corrected(load), corrected(output)
    series = np.zeros(c) if series is None else series
    own = compliance.diagonal(contact) - 2 * np.einsum("ij,ij->i", contacts[0].JQ, contacts[0].Y)
    return Response(
        S=Columns(Responses(*contacts, *contacts, series), (c, c)),
        own=np.maximum(own - np.einsum("ij,ij->i", contacts[1], contacts[1]), 0.0) + series,
        T=moved(*contacts),
        L=contacts[0].gather(loads[0]) - contacts[1] @ loads[1].T,
        S_out=Columns(Responses(*outputs, *contacts), (o, c)),
        T_out=moved(*outputs),
        L_out=outputs[0].gather(loads[0]) - outputs[1] @ loads[1].T,
        reaction_S=reactions(*contacts),
        reaction_T=reaction_v,
        reaction_L=reactions(*loads),
        redundant=tuple(int(i) for i in np.delete(rest, kept)),
    )


@dataclass(frozen=True)
class Supported:
    """Rows J of parts that are held by the rows A alone.

    Attributes
    ----------
    compliance : Blocks
    rows : (j, F) csr_matrix
    JQ, Y : (j, 6P) array
    """

    compliance: Blocks
    rows: csr_matrix
    JQ: np.ndarray
    Y: np.ndarray

    def take(self, index: np.ndarray) -> Supported:
        """Some of the rows."""
        return Supported(self.compliance, self.rows[index], self.JQ[index], self.Y[index])

    def gather(self, other: Supported) -> np.ndarray:
        """(j, k) ``J H_s Kᵀ``; each column the same bits whatever the others are."""
        gathered = self.compliance.gather(self.rows, other.rows)
        gathered -= product(other.Y, self.JQ.T).T
        gathered -= product(other.JQ, self.Y.T).T
        return gathered


def _supported(
    compliance: Blocks, rows: csr_matrix, rigid: np.ndarray, A: csr_matrix, AG: np.ndarray, held: np.ndarray
) -> Supported:
    """Rows of held parts, from what they read of rigid motions (j, 6P), and ``A H Aᵀ`` with what A yields."""
    JQ = np.linalg.solve(AG.T, rigid.T).T
    return Supported(compliance, rows, JQ, compliance.gather(rows, A) - 0.5 * JQ @ held)


@dataclass(frozen=True)
class Responses:
    """``J H_s Cᵀ - Z Z_Cᵀ`` by columns: what rows J read per force of rows C, the rows R eliminated.

    Attributes
    ----------
    read, forced : Supported
        J and C.
    Z, Z_C : (j, r), (c, r) array
    series : (c,) array, optional
        What is added to the diagonal.
    """

    read: Supported
    Z: np.ndarray
    forced: Supported
    Z_C: np.ndarray
    series: np.ndarray | None = None

    def __call__(self, numbers: np.ndarray) -> np.ndarray:
        """(k, j) columns with these numbers."""
        found = self.read.gather(self.forced.take(numbers)).T - product(self.Z_C[numbers], self.Z.T)
        if self.series is not None:
            # What the bilateral rows hold altogether has no compliance; rounding must not make it negative.
            diagonal = np.arange(len(numbers)), numbers
            found[diagonal] = np.maximum(found[diagonal], 0.0) + self.series[numbers]
        return found


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


def _cholesky(matrix: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """D (k,) and the lower triangle C (k, k) with ``D M D = C Cᵀ``, D scaling its diagonal to 1."""
    D = 1 / np.sqrt(np.diag(matrix))
    return D, np.linalg.cholesky(matrix * np.outer(D, D))
