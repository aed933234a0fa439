"""One compliance in scaled variables, as every native method takes it.

With ``f = D y``, ``w = D u``, ``D_k = diag(d_n, d_t, d_t)``, ``d_n = S_nn^{-1/2}`` and one ``d_t`` per contact, so that
the cone stays circular, the problem becomes ``w = W y + q`` with ``W = D S D``, ``q = D b`` and ``μ' = μ d_n / d_t``:
the same laws, without units.  A coefficient that depends on the normal force is held by most methods and renewed from
their forces; Newton's method knows it as a function.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
from scipy.linalg import eigvalsh, inv
from scipy.sparse import csr_array
from scipy.sparse.csgraph import connected_components

from mic.contact.certificate import contact_stiffness, residual
from mic.contact.ladder import SPLITTING
from mic.contact.laws import Law
from mic.contact.native.gauss_seidel import local_factors
from mic.contact.native.law_equation import compiled

__all__ = ["ScaledProblem", "inverse_root"]


@dataclass(frozen=True)
class ScaledProblem:
    """``W`` and the law of its contacts.

    Attributes
    ----------
    law : Law
    W : (3m, 3m) array, or (m, m) for a law without friction
    parameters : (m, p) array
        Of the law, contact by contact; scaled friction ``μ'`` first, as it is held.
    factors : (m, 7) array or None
        :func:`mic.contact.native.gauss_seidel.local_factors` of ``W``; None without friction.
    """

    law: Law
    W: np.ndarray
    parameters: np.ndarray
    factors: np.ndarray | None

    @classmethod
    def of(cls, law: Law, W: np.ndarray, parameters: np.ndarray) -> ScaledProblem:
        """The problem of scaled compliance ``W`` and scaled parameters (m, p) of the law."""
        parameters = np.ascontiguousarray(parameters, dtype=float)
        if not law.frictional:
            return cls(law, W, parameters, None)
        return cls(law, W, parameters, local_factors(W))

    @property
    def equation(self) -> Callable:
        """The law's equation, compiled; for a law with friction only. It cannot be pickled, so it is no attribute."""
        return compiled(self.law.equation)

    @property
    def friction(self) -> np.ndarray:
        """Scaled friction ``μ'`` (m,)."""
        return self.parameters[:, 0]

    @cached_property
    def components(self) -> list[np.ndarray]:
        """Contacts that hang together, by ``W``: (m,) bool arrays, each a problem of its own."""
        m, size = len(self.parameters), len(self.W) // max(len(self.parameters), 1)
        touching = (self.W.reshape(m, size, m, size) != 0.0).any(axis=(1, 3))
        count, label = connected_components(csr_array(touching), directed=False)
        return [label == own for own in range(count)]

    @cached_property
    def splitting(self) -> tuple[np.ndarray, np.ndarray, float]:
        """What the splitting needs: ``W⁻¹``, empty where it is not accurate; ``(W + ρ I)⁻¹``; and ``ρ``.

        ``ρ`` is the geometric mean of the extreme eigenvalues, the smallest bounded from below.
        """
        eigenvalues = eigvalsh(self.W, check_finite=False)
        smallest, largest = eigenvalues[0], eigenvalues[-1]
        rho = np.sqrt(max(smallest, 1e-6 * largest) * largest) or 1.0  # a contact that nothing moves
        invertible = SPLITTING["invertible"] * smallest > largest
        shifted = self.W.copy()
        shifted[np.diag_indices(len(shifted))] += rho
        return _inverse(self.W.copy()) if invertible else np.empty((0, 0)), _inverse(shifted), rho

    def error(self, q: np.ndarray, y: np.ndarray) -> float:
        """The certificate of one scaled force, :func:`mic.contact.certificate.certify`."""
        size = len(self.W) // len(self.parameters)
        stiffness = contact_stiffness(self.W, self.law, size)
        return float(residual(self.W, q[None], self.parameters, y[None], self.law, stiffness, size)[0])

    def renewed(self, y: np.ndarray) -> ScaledProblem:
        """The same contacts, with the friction that belongs to the forces ``y`` where it depends on them."""
        if not (self.law.coefficient_varies and np.isfinite(y).all()):
            return self
        parameters = self.parameters.copy()
        parameters[:, 0] = self.law.coefficient(self.parameters, y[::3])
        return replace(self, parameters=parameters)

    def proximal(self, alpha: float) -> ScaledProblem:
        """The same contacts with ``W + α I``."""
        W = self.W + alpha * np.eye(len(self.W))
        return replace(self, W=W, factors=None if self.factors is None else local_factors(W))


def _inverse(matrix: np.ndarray) -> np.ndarray:
    """In its place: of thousands of contacts one more array of its size would be most of what the process holds."""
    return inv(matrix.T, overwrite_a=True, check_finite=False).T  # LAPACK takes columns


def inverse_root(diagonal: np.ndarray) -> np.ndarray:
    """``d^{-1/2}``, the mean of the others' where the diagonal vanishes."""
    vanishing = diagonal <= np.finfo(float).eps * diagonal.max(initial=0.0)
    if vanishing.all():
        return np.ones_like(diagonal)
    return np.where(vanishing, diagonal[~vanishing].mean(), diagonal) ** -0.5
