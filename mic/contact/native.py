"""The native solver: scaling once per ``S``, compiled kernels per sample, a ladder of fallbacks for the degenerate.

With ``f = D y``, ``w = D u``, ``D_k = diag(d_n, d_t, d_t)``, ``d_n = S_nn^{-1/2}`` and one ``d_t`` per contact, so that the
cone stays circular, the problem becomes ``w = W y + q`` with ``W = D S D``, ``q = D b`` and ``μ' = μ d_n / d_t``: the same
laws, without units.
"""

from __future__ import annotations

from concurrent.futures import ThreadPoolExecutor
from itertools import islice

import numpy as np
from scipy.linalg import eigvalsh, inv
from scipy.optimize import nnls
from threadpoolctl import ThreadpoolController

from mic.contact import kernels
from mic.contact.interior_point import interior_point
from mic.contact.laws import Law

__all__ = ["NativeSolver"]

#: The kernels work to this fraction of the tolerance, because their residual and the certificate weigh contacts differently.
KERNEL_MARGIN = 1e-2
#: Tasks for each thread: few, because handing them out costs as much as an easy sample, and enough to level the load.
TASKS = 8
#: Sweeps of Gauss-Seidel before the first Newton.
SWEEPS = 10
#: Share of contacts that are not open above which the splitting takes over from Gauss-Seidel and Newton.
CROWD = 0.65
#: Steps of the splitting before its first Newton, and rounds of twice as many steps each.
SPLITTING_STEPS, SPLITTING_ROUNDS = 20, 4
#: Newton uses ``W⁻¹`` up to this condition number of ``W``: the inverse is then good to 1e-8, and each step gains that much.
INVERTIBLE = 1e8
#: Rounds of Gauss-Seidel and Newton before the patient methods take over.
ROUNDS = 3
FIXED_POINT_STEPS, PROXIMAL_STEPS, PATIENCE = 8, 25, 10
#: The patient methods may spend ``BUDGET (1 + 1000/m)`` factorisations of ``W`` on one sample, about 2 s for 100 contacts and
#: 100 s for 600; a sweep of Gauss-Seidel counts as ``SWEEP / 3m`` of one, its share of time.
BUDGET, SWEEP = 200.0, 10.0
#: A pressure ``d`` with ``‖W d‖`` below this share of its work on the overlaps proves infeasibility: balancing the load would
#: take forces this many times over the natural ones.
INFEASIBLE_COMPLIANCE = 1e-11


_THREADPOOLS = ThreadpoolController()


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
        self._splitting = None
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

    def attempts(self, b, force):
        """Further forces for one sample, by more and more patient methods, each starting from the last.

        A generator: the caller certifies each force and stops at the first that is good enough.  It ends by itself when
        :data:`BUDGET` is spent, so that a hopeless sample cannot hold up a Monte Carlo.

        Parameters
        ----------
        b : (d m,) array
        force : (d m,) array
            The best force so far.

        Yields
        ------
        force : (d m,) array
        iterations : int
            Passes that it took.
        """
        stride = self.dimension if self.law is Law.FRICTIONLESS else 1
        q, y = b[::stride] * self.scaling, force[::stride] / self.scaling
        method = self._attempts_frictionless if self.law is Law.FRICTIONLESS else self._attempts_frictional
        with _THREADPOOLS.limit(limits=self.threads):
            budget = BUDGET * (1.0 + 1000.0 / len(self.friction))
            for y, iterations, work in method(q, y):
                force = np.zeros_like(b)
                force[::stride] = y * self.scaling
                yield force, iterations
                budget -= work
                if budget < 0.0:
                    return

    def _attempts_frictionless(self, q, y):
        yield from self._proximal_points(q, y)

    def _attempts_frictional(self, q, y):
        mu, W = self.friction, self.W
        coulomb = self.law is Law.COULOMB
        yield from self._polished(W, q, y)
        # The shift μ‖w_t‖ moves with the iterates, ...
        shift = None if coulomb else np.zeros_like(mu)
        z, steps = interior_point(W, q, mu, shift)
        for polished, more, _ in self._polished(W, q, z):
            yield polished, steps + more, steps + more
            steps = 0
        if coulomb:
            sweeping = self._patient_sweeps(q, y)
            yield from islice(sweeping, 3 * PATIENCE // 2)
        # ... or is held while a convex problem is solved, then moved: De Saxcé's fixed point.
        if coulomb:
            shift = np.zeros_like(mu)
            for _ in range(FIXED_POINT_STEPS):
                z, steps = interior_point(W, q, mu, shift)
                for polished, more, _ in self._polished(W, q, z):
                    yield polished, steps + more, steps + more
                    steps = 0
                w = W @ z + q
                shift = np.hypot(w[1::3], w[2::3])
            yield from sweeping
        for start in (y, z):
            yield from self._proximal_points(q, start)
        for alpha in (1e-4, 1e-3):
            yield from self._interior_proximal_points(q, alpha)

    def _patient_sweeps(self, q, y):
        """Gauss-Seidel in runs of 100, 200, 400, ... sweeps, polished after each: slow on stacks, but hard to defeat."""
        y, w, slip = y.copy(), self.W @ y + q, np.zeros_like(self.friction)
        for doubling in range(PATIENCE):
            sweeps, _ = kernels.gauss_seidel(self.W, self.factors, self.friction, y, w, slip, 100 * 2**doubling, 1e-15)
            w = self.W @ y + q
            for polished, more, _ in self._polished(self.W, q, y):
                yield polished, sweeps + more, SWEEP * sweeps / len(q) + more
                sweeps = 0

    def _polished(self, W, q, y):
        """Newton from ``y``: searching along the line, plain and damped, and with whole steps."""
        scale = kernels.starting_scale(self.friction, q)
        for damping, halvings in ((1e-9, 7), (1e-12, 0), (1e-6, 7), (1e-14, 7)):
            z, w = y.copy(), W @ y + q
            _, steps = kernels.newton(
                self.law is Law.ASSOCIATED,
                W,
                np.empty((0, 0)),
                q,
                self.friction,
                z,
                w,
                damping,
                scale,
                1e-14,
                20,
                halvings,
                len(self.friction),
            )
            yield z, steps, steps

    def _proximal_points(self, q, y):
        """Proximal-point steps: solve with ``W + α I`` and ``q - α y``, move there, and lower ``α`` while that succeeds."""
        alpha, identity = 1e-1, np.eye(len(q))
        errors, counts = np.zeros(1), np.zeros(1, dtype=np.int64)
        for _ in range(PROXIMAL_STEPS):
            W, Q, Y = self.W + alpha * identity, (q - alpha * y)[None], y[None].copy()
            counts[0] = 0
            self._run_kernel(W, Q, Y, 1e-13, errors, counts)
            step = np.linalg.norm(Y[0] - y)
            solved = errors[0] <= max(1e-13, 1e-2 * step / max(np.linalg.norm(Y[0]), np.finfo(float).tiny))
            y = Y[0]
            yield y, int(counts[0]), int(counts[0])
            alpha = max(0.2 * alpha, 1e-9) if solved else min(5.0 * alpha, 10.0)

    def _interior_proximal_points(self, q, alpha):
        """Proximal-point steps of constant ``α``, each by the interior point: slow, steady, for jammed piles."""
        y = np.zeros_like(q)
        shift = None if self.law is Law.COULOMB else np.zeros_like(self.friction)
        W = self.W + alpha * np.eye(len(q))
        for _ in range(PROXIMAL_STEPS):
            z, steps = interior_point(W, q - alpha * y, self.friction, shift)
            y, more, _ = next(self._polished(W, q - alpha * y, z))
            yield y, steps + more, steps + more

    def _run_kernel(self, W, Q, Y, tol, errors, iterations, rounds=ROUNDS, crowd=1.0):
        if self.law is Law.FRICTIONLESS:
            kernels.solve_frictionless(W, Q, Y, tol, rounds, errors, iterations)
        else:
            factors = self.factors if W is self.W else kernels.local_factors(W)
            kernels.solve_frictional(
                self.law is Law.ASSOCIATED,
                W,
                factors,
                Q,
                self.friction,
                Y,
                tol,
                rounds,
                SWEEPS,
                crowd * len(self.friction),
                errors,
                iterations,
            )

    def infeasible(self, b) -> bool:
        """Whether no force at all can keep the contacts from penetrating.

        Farkas' lemma: some pressures ``d >= 0`` move nothing, ``S d = 0``, and do work on the overlaps, ``b·d < 0``; then
        ``u·d = b·d < 0`` for every force, so that some ``u_n < 0``.  Found by non-negative least squares,
        ``min ‖W d‖² + (q·d/‖q‖ + 1)²``.  Sufficient for all three laws, and necessary for the frictionless one.
        """
        size = 1 if self.law is Law.FRICTIONLESS else 3
        stride = self.dimension if self.law is Law.FRICTIONLESS else 1
        q = b[::stride] * self.scaling
        overlap = q[::size]
        if not (overlap < 0.0).any():
            return False
        overlap = overlap / np.linalg.norm(overlap)
        matrix = np.vstack([self.W[:, ::size], overlap])
        try:
            d, _ = nnls(matrix, np.append(np.zeros(len(self.W)), -1.0))
        except RuntimeError:  # no convergence: nothing proven
            return False
        work = overlap @ d
        return work < -0.5 and np.linalg.norm(self.W[:, ::size] @ d) <= INFEASIBLE_COMPLIANCE * -work

    def _iterate(self, Q, Y):
        """All samples, by the cheap methods: Gauss-Seidel with Newton, then splitting with Newton for those still unsolved."""
        n = len(Q)
        tol = KERNEL_MARGIN * self.tol
        errors, iterations = np.full(n, np.inf), np.zeros(n, dtype=np.int64)

        def stage(samples, method):
            """Run ``method(Q, Y, errors, iterations)`` on chunks of the samples, in parallel."""

            def chunk(first):
                pick = samples[first : first + size]
                parts = Q[pick], Y[pick], errors[pick], iterations[pick]
                method(*parts)
                Y[pick], errors[pick], iterations[pick] = parts[1:]

            size = -(-len(samples) // (TASKS * self.threads if self.threads > 1 else 1))
            starts = range(0, len(samples), size)
            if self.threads == 1:
                for first in starts:
                    chunk(first)
            else:
                with ThreadPoolExecutor(self.threads) as pool:
                    list(pool.map(chunk, starts))

        def cheap(*parts):
            self._run_kernel(self.W, *parts[:2], tol, *parts[2:], rounds=1, crowd=CROWD)

        def splitting(Q, Y, errors, iterations):
            kernels.solve_by_splitting(
                self.law is Law.ASSOCIATED,
                self.W,
                *self._splitting,
                Q,
                self.friction,
                Y,
                tol,
                SPLITTING_STEPS,
                SPLITTING_ROUNDS,
                errors,
                iterations,
            )

        with _THREADPOOLS.limit(limits=1):
            if not Q.size:
                pass
            elif self.law is Law.FRICTIONLESS:
                stage(np.arange(n), lambda *parts: self._run_kernel(self.W, *parts[:2], tol, *parts[2:]))
            else:
                # Newton from afar is a waste for the associated law, which has no Gauss-Seidel to come near; a guess is near.
                if self.law is Law.COULOMB or Y.any():
                    stage(np.arange(n), cheap)
                unsolved = np.flatnonzero(errors > tol)
                if unsolved.size:
                    self._prepare_splitting()
                    stage(unsolved, splitting)
        return iterations

    def _prepare_splitting(self):
        """``W⁻¹``, empty where it is not accurate; ``(W + ρ I)⁻¹``; and ``ρ``.

        ``ρ`` is the geometric mean of the extreme eigenvalues, the smallest bounded from below.
        """
        if self._splitting is None:
            eigenvalues = eigvalsh(self.W, check_finite=False)
            smallest, largest = eigenvalues[0], eigenvalues[-1]
            rho = np.sqrt(max(smallest, 1e-6 * largest) * largest)
            invertible = INVERTIBLE * smallest > largest
            self._splitting = (
                np.ascontiguousarray(inv(self.W)) if invertible else np.empty((0, 0)),
                np.ascontiguousarray(inv(self.W + rho * np.eye(len(self.W)))),
                rho,
            )


def _inverse_root(diagonal: np.ndarray) -> np.ndarray:
    """``d^{-1/2}``, the mean of the others' where the diagonal vanishes."""
    vanishing = diagonal <= np.finfo(float).eps * diagonal.max(initial=0.0)
    if vanishing.all():
        return np.ones_like(diagonal)
    return np.where(vanishing, diagonal[~vanishing].mean(), diagonal) ** -0.5
