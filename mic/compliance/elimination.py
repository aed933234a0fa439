"""Eliminates bilateral rows: the compliance of parts that a fixture holds.

Notation, with rows D over the stacked functionals, free-body compliance H and rigid-body readings G, block-diagonal
over the parts: under functional forces f and rigid motions q the readings are ``y = H f + G q`` with ``Gᵀ f = 0``.

1. Choose 6P bilateral rows A, as many as the P parts have rigid motions, so that ``A G`` is well conditioned.
   With ``Q = G (A G)⁻¹`` and ``Π = I - Q A``, ``H_s = Π H Πᵀ`` is the compliance supported on A, and
   ``y = H_s f + Q v_A`` for any f, the reactions on A included implicitly. For rows J and K this needs gathers only:

       J H_s Kᵀ = J H Kᵀ - (J Q) Y_Kᵀ - Y_J (K Q)ᵀ,        Y_J = J H Aᵀ - ½ (J Q)(A H Aᵀ).

2. Eliminate the remaining bilateral rows R: ``λ_R = (R H_s Rᵀ)⁻¹ (v_R - R Q v_A - R H_s f)``. For rows C this gives
   equation (7) of the paper, ``δ = S f_C + T v``, with ``S = H_CC - H_CR H_RR⁻¹ H_RC``.

S is a gather less a correction of rank 12 P plus the number of rows R. Only required columns of S are formed.

A row with its own compliance c reads ``v - c λ`` instead of v. For rows R that adds c to ``R H_s Rᵀ``. For rows A,
``λ_A = -(J Q)ᵀ f_J`` of the forces f_J on all other rows, so that ``J H_s Kᵀ`` grows by ``(J Q) c_A (K Q)ᵀ``, as if
``A H Aᵀ`` in Y_J grew by c_A.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import partial

import numpy as np
from scipy.linalg import lapack, solve_triangular
from scipy.sparse import csr_matrix

from mic.compliance.blocks import Blocks
from mic.compliance.support import motion_size, statically_determinate
from mic.contact.compliance_columns import Columns
from mic.system.matrix_product import product

__all__ = ["Response", "eliminate"]

REDUNDANT = 1e-9  # relative compliance of a row while the others hold, below which it is redundant


@dataclass(frozen=True)
class Response:
    """Linear response of held parts at chosen rows.

    Bilateral rows carry prescribed values ``v``; contact rows and load rows carry forces.

    Attributes
    ----------
    S : (c, c) Columns
        Contact compliance, equation (7); symmetric positive semidefinite.
    diagonal : (c,) array
        Diagonal of S.
    T : (c, b) array
        Motion of the contact rows per prescribed value.
    L : (c, l) array
        Motion of the contact rows per load.
    S_out : (o, c) Columns
    T_out, L_out : arrays with (o, ...) rows
        The same for the output rows.
    reaction_S, reaction_T, reaction_L : arrays with (b, ...) rows
        Force of each bilateral row on the parts (positive along the row), per contact force, value and load.
    redundant : tuple of int
        Bilateral rows that the others already hold; they carry no force and their value has no effect.
    """

    S: Columns
    diagonal: np.ndarray
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
    multiply: Callable[[np.ndarray, np.ndarray], np.ndarray] = product,
) -> Response:
    """Eliminate bilateral rows.

    Parameters
    ----------
    compliance : Blocks
        Of the free parts.
    bilateral, contact, load, output : (b|c|l|o, F) csr_matrix
        Rows over the stacked functionals.
    yielding : (b,) array, optional
        Compliance of each bilateral row itself, mm/N; default: rigid.
    series : (c,) array, optional
        Compliance in series with each contact row, mm/N, added to the diagonal of S; default: none.
    multiply : callable
        The matrix product, see :func:`mic.system.matrix_product.product_of`.

    Raises
    ------
    FreeMotion
        If the bilateral rows leave a rigid motion free.
    """
    held = _BilateralRows(compliance, bilateral, yielding, multiply)
    contacts, loads, outputs = held.supported(contact), held.supported(load), held.supported(output)
    c, o = contact.shape[0], output.shape[0]
    series = np.zeros(c) if series is None else series
    diagonal = compliance.diagonal(contact) - 2 * np.einsum("ij,ij->i", contacts.JQ, contacts.Y)
    return Response(
        S=Columns(partial(_columns, contacts, contacts, series), (c, c)),
        diagonal=np.maximum(diagonal - np.einsum("ij,ij->i", contacts.Z, contacts.Z), 0.0) + series,
        T=held.motion(contacts),
        L=contacts.gather(loads) - contacts.Z @ loads.Z.T,
        S_out=Columns(partial(_columns, outputs, contacts, None), (o, c)),
        T_out=held.motion(outputs),
        L_out=outputs.gather(loads) - outputs.Z @ loads.Z.T,
        reaction_S=held.reactions(contacts),
        reaction_T=held.reactions_to_values(),
        reaction_L=held.reactions(loads),
        redundant=held.redundant,
    )


@dataclass(frozen=True)
class _SupportedRows:
    """Rows J of parts that are held by the rows A.

    Attributes
    ----------
    compliance : Blocks
    rows : (j, F) csr_matrix
    JQ, Y : (j, 6P) array
    Z : (j, r) array
        Factor of the correction by the rows R, ``H_JR H_RR⁻¹ H_RJ = Z Zᵀ``.
    multiply : callable
        The matrix product.
    """

    compliance: Blocks
    rows: csr_matrix
    JQ: np.ndarray
    Y: np.ndarray
    Z: np.ndarray
    multiply: Callable[[np.ndarray, np.ndarray], np.ndarray]

    def select(self, index: np.ndarray) -> _SupportedRows:
        """Some of the rows."""
        some = {name: getattr(self, name)[index] for name in ("rows", "JQ", "Y", "Z")}
        return replace(self, **some)

    def gather(self, other: _SupportedRows) -> np.ndarray:
        """(j, k) ``J H_s Kᵀ``; the bits of each column do not depend on the other columns."""
        gathered = self.compliance.gather(self.rows, other.rows)
        gathered -= self.multiply(other.Y, self.JQ.T).T
        gathered -= self.multiply(other.JQ, self.Y.T).T
        return gathered


class _BilateralRows:
    """Bilateral rows, split into the support A and the independent rows R among the rest, with H_RR factorised."""

    def __init__(
        self,
        compliance: Blocks,
        rows: csr_matrix,
        yielding: np.ndarray | None,
        multiply: Callable[[np.ndarray, np.ndarray], np.ndarray],
    ):
        self._compliance, self._count, self._multiply = compliance, rows.shape[0], multiply
        rigid = compliance.rigid(rows)
        self._support = support = statically_determinate(rigid, motion_size(compliance.G))
        rest = np.setdiff1d(np.arange(self._count), support)
        self._A, self._AG = rows[support], rigid[support]
        self._AHA = compliance.gather(self._A, self._A)
        if yielding is not None:
            self._AHA[np.diag_indices(len(support))] += yielding[support]
        R = self._on_support(rows[rest], rigid[rest])
        H_RR = R.gather(R)
        H_RR = 0.5 * (H_RR + H_RR.T)
        if yielding is not None:
            H_RR[np.diag_indices(len(rest))] += yielding[rest]
        independent = _independent(H_RR, compliance.diagonal(rows[rest]))
        self._further, self._R = rest[independent], R.select(independent)
        self.redundant = tuple(int(i) for i in np.delete(rest, independent))
        # H_RR = D⁻¹ C Cᵀ D⁻¹, so that H_CR H_RR⁻¹ H_RC = Z Zᵀ with Z = H_CR D C⁻ᵀ.
        H_RR = H_RR[np.ix_(independent, independent)]
        self._D = 1 / np.sqrt(np.diag(H_RR))
        self._C = np.linalg.cholesky(H_RR * np.outer(self._D, self._D))
        # λ_R = D C⁻ᵀ (C⁻¹ D (v_R - R Q v_A) - Zᵀ f), and λ_A = -(J Q)ᵀ f from the balance Gᵀ(Aᵀ λ_A + Jᵀ f) = 0.
        count = len(independent)
        values = np.zeros((count, self._count))
        values[:, support] = -self._R.JQ
        values[np.arange(count), self._further] = 1.0
        self._CD = solve_triangular(self._C, np.diag(self._D), lower=True) if count else np.zeros((0, 0))  # C⁻¹ D
        self._CDv = self._CD @ values

    def _on_support(self, rows: csr_matrix, rigid: np.ndarray) -> _SupportedRows:
        """Rows on the support A alone, from their readings of rigid motions (j, 6P)."""
        JQ = np.linalg.solve(self._AG.T, rigid.T).T
        Y = self._compliance.gather(rows, self._A) - 0.5 * JQ @ self._AHA
        return _SupportedRows(self._compliance, rows, JQ, Y, np.zeros((len(JQ), 0)), self._multiply)

    def supported(self, rows: csr_matrix) -> _SupportedRows:
        """Rows of the held parts, with their correction by the rows R."""
        supported = self._on_support(rows, self._compliance.rigid(rows))
        if not len(self._further):
            return supported
        return replace(supported, Z=solve_triangular(self._C, (supported.gather(self._R) * self._D).T, lower=True).T)

    def motion(self, rows: _SupportedRows) -> np.ndarray:
        """(j, b) motion of rows per prescribed value."""
        motion = rows.Z @ self._CDv
        motion[:, self._support] += rows.JQ
        return motion

    def reactions(self, rows: _SupportedRows) -> np.ndarray:
        """(b, j) force of each bilateral row per force on the rows."""
        force = np.zeros((self._count, len(rows.Z)))
        force[self._further] = -self._CD.T @ rows.Z.T
        force[self._support] = -self._R.JQ.T @ force[self._further] - rows.JQ.T
        return force

    def reactions_to_values(self) -> np.ndarray:
        """(b, b) force of each bilateral row per prescribed value."""
        force = np.zeros((self._count, self._count))
        force[self._further] = self._CD.T @ self._CDv
        force[self._support] = -self._R.JQ.T @ force[self._further]
        return force


def _columns(
    read: _SupportedRows, forced: _SupportedRows, series: np.ndarray | None, numbers: np.ndarray
) -> np.ndarray:
    """(k, j) columns of ``J H_s Cᵀ - Z_J Z_Cᵀ`` with these numbers, for rows J per force on rows C, without the rows R.

    A compliance in series (c,) is added to the diagonal.
    """
    some = forced.select(numbers)
    columns = read.gather(some).T - product(some.Z, read.Z.T)
    if series is not None:
        # Rows that the bilateral rows hold completely have no compliance; rounding must not make it negative.
        diagonal = np.arange(len(numbers)), numbers
        columns[diagonal] = np.maximum(columns[diagonal], 0.0) + series[numbers]
    return columns


def _independent(matrix, reference):
    """Linearly independent rows of a compliance matrix, ascending; each is compared with its own `reference`."""
    if len(matrix) == 0:
        return np.zeros(0, dtype=int)
    d = 1 / np.sqrt(np.maximum(reference, np.diag(matrix)).clip(1e-300))
    scaled = matrix * np.outer(d, d)
    _, pivot, rank, _ = lapack.dpstrf(scaled, tol=REDUNDANT, lower=1)
    if scaled.diagonal().max() <= REDUNDANT:  # LAPACK accepts the first pivot without checking the tolerance
        rank = 0
    return np.sort(pivot[:rank] - 1)
