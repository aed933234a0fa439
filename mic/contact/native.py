"""The native solver: scaling once per ``S``, compiled kernels per sample, a ladder of fallbacks for the degenerate.

With ``f = D y``, ``w = D u``, ``D_k = diag(d_n, d_t, d_t)``, ``d_n = S_nn^{-1/2}`` and one ``d_t`` per contact, so that the
cone stays circular, the problem becomes ``w = W y + q`` with ``W = D S D``, ``q = D b`` and ``μ' = μ d_n / d_t``: the same
laws, without units.
"""

from __future__ import annotations

from concurrent.futures import ThreadPoolExecutor

import numpy as np
from threadpoolctl import threadpool_limits

from mic.contact import kernels
from mic.contact.laws import Law

__all__ = ["NativeSolver"]

#: The kernels work to this fraction of the tolerance, because their residual and the certificate weigh contacts differently.
KERNEL_MARGIN = 1e-2


class NativeSolver:
    """One compliance, scaled; solves batches of right-hand sides.

    Parameters
    ----------
    S : (3m, 3m) array, or (m, m) for ``dimension`` 1
        Symmetric compliance.
    mu : (m,) array
    law : Law
    tol : float
        Certificate to reach.
    threads : int
    dimension : {3, 1}
    """

    def __init__(self, S, mu, law, tol, threads, dimension):
        self.law, self.tol, self.threads, self.dimension = law, tol, threads, dimension
        if law is Law.FRICTIONLESS:
            S = S[::dimension, ::dimension]
            self.scaling = _inverse_root(S.diagonal())
            self.friction = mu
            self.factors = None
        else:
            diagonal = S.diagonal().reshape(-1, 3)
            d_n = _inverse_root(diagonal[:, 0])
            d_t = _inverse_root(0.5 * (diagonal[:, 1] + diagonal[:, 2]))
            self.scaling = np.column_stack([d_n, d_t, d_t]).ravel()
            self.friction = mu * d_n / d_t
        self.W = np.ascontiguousarray(S * self.scaling[:, None] * self.scaling)
        if law is not Law.FRICTIONLESS:
            self.factors = kernels.local_factors(self.W)

    def solve(self, b, guess):
        """Forces for each row of ``b``, from ``guess`` (same shape) or from zero.

        Returns
        -------
        force : array shaped like ``b``
        iterations : (n,) int array
        """
        stride = self.dimension if self.law is Law.FRICTIONLESS else 1
        Q = np.ascontiguousarray(b[:, ::stride] * self.scaling)
        Y = np.zeros_like(Q) if guess is None else np.ascontiguousarray(guess[:, ::stride] / self.scaling)
        iterations = self._iterate(Q, Y)
        force = np.zeros_like(b)
        force[:, ::stride] = Y * self.scaling
        return force, iterations

    def _iterate(self, Q, Y):
        n = len(Q)
        tol = KERNEL_MARGIN * self.tol
        errors, iterations = np.zeros(n), np.zeros(n, dtype=np.int64)

        def run(first, last):
            if self.law is Law.FRICTIONLESS:
                kernels.solve_frictionless(self.W, Q, Y, tol, first, last, 6, errors, iterations)
            else:
                kernels.solve_frictional(self.law is Law.ASSOCIATED, self.W, self.factors, Q, self.friction, Y, tol,
                                         first, last, 6, errors, iterations)

        with threadpool_limits(1):
            if self.threads == 1:
                run(0, n)
            else:
                bounds = np.arange(0, n + 8, 8).clip(max=n)
                with ThreadPoolExecutor(self.threads) as pool:
                    list(pool.map(run, bounds[:-1], bounds[1:]))
        return iterations


def _inverse_root(diagonal: np.ndarray) -> np.ndarray:
    """``d^{-1/2}``, the mean of the others' where the diagonal vanishes."""
    vanishing = diagonal <= np.finfo(float).eps * diagonal.max(initial=0.0)
    if vanishing.all():
        return np.ones_like(diagonal)
    return np.where(vanishing, diagonal[~vanishing].mean(), diagonal) ** -0.5
