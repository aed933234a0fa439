"""The convex laws solved by general-purpose optimisers, to reproduce the paper and to verify the native solver.

The problem is the quadratic programme (12) in scaled normal forces ``y >= 0`` without friction, and the second-order
cone programme (13) in scaled forces with friction and without De Saxcé's shift,

.. math:: \\min_f \\tfrac12 f^T S f + b^T f, \\quad \\|f_t\\| \\le \\mu f_n, \\; f_n \\ge 0 .

The non-penetration constraints of (13) follow from its optimality conditions and are omitted; ``f_n >= 0`` is needed at
``μ = 0``, where the cone ``‖f_t‖ <= 0`` does not bound the normal force.  ``b`` is the only parameter, so that CVXPY
canonicalises once per ``S``.
"""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from mic.contact.friction import Friction
from mic.contact.laws import Law
from mic.errors import MissingLibrary

__all__ = ["OPTIMISERS", "ConeProgramme"]

#: Optimiser → (CVXPY's name, its settings for the highest accuracy that it reliably reaches).
OPTIMISERS = {
    "ecos": ("ECOS", dict(abstol=1e-12, reltol=1e-12, feastol=1e-12, max_iters=200)),
    "osqp": ("OSQP", dict(eps_abs=1e-10, eps_rel=1e-10, max_iter=100_000, polishing=True)),
    "clarabel": ("CLARABEL", dict(tol_gap_abs=1e-11, tol_gap_rel=1e-11, tol_feas=1e-11)),
    "scs": ("SCS", dict(eps_abs=1e-9, eps_rel=1e-9, max_iters=100_000)),
}


class ConeProgramme:
    """Problem (12) or (13) for one ``S``, parametrised by ``b``.

    Parameters
    ----------
    S, mu, law, dimension
        As in :class:`mic.contact.ContactSolver`, already checked.
    backend : str
        Key of :data:`OPTIMISERS`.

    Raises
    ------
    ValueError
        For a law with De Saxcé's shift, which is no optimisation problem, and for cones with a quadratic-programme
        solver.
    MissingLibrary
        If CVXPY or the solver is missing.
    """

    def __init__(self, S: np.ndarray, mu: np.ndarray, law: Law, backend: str, dimension: int):
        self.name, self._known = backend, (S, mu, law, dimension)
        if law.shift:
            raise ValueError(f"law {law.name} is not an optimisation problem; use backend native")
        if law.frictional and backend == "osqp":
            raise ValueError("backend osqp solves quadratic programmes: law must be without friction")
        try:
            import cvxpy
        except ImportError:
            command = "pip install 'mic-contact[peers]'"
            raise MissingLibrary(f"backend {backend} needs CVXPY, which is not installed: {command}") from None
        self._solver, self._settings = OPTIMISERS[backend]
        if self._solver not in cvxpy.installed_solvers():
            raise MissingLibrary(f"backend {backend} needs its solver, which is not installed: pip install {backend}")
        self._error = cvxpy.error.SolverError
        self._stride = 1 if law.frictional else dimension
        S = S[:: self._stride, :: self._stride]
        # One length per contact keeps the cones circular: f = d y, d_k = (trace S_kk)^{-1/2}.
        size = 3 if law.frictional else 1
        compliance = S.diagonal().reshape(-1, size).sum(1)
        compliance = np.where(compliance > 0.0, compliance, compliance.max(initial=0.0) or 1.0)
        self._scaling = np.repeat(compliance**-0.5, size)
        W = S * self._scaling[:, None] * self._scaling
        eigenvalues, vectors = np.linalg.eigh(W)
        factor = (vectors * np.sqrt(eigenvalues.clip(min=0.0))).T
        self._force = cvxpy.Variable(len(S))
        self._load = cvxpy.Parameter(len(S))
        objective = cvxpy.Minimize(0.5 * cvxpy.sum_squares(factor @ self._force) + self._load @ self._force)
        if law.frictional:
            y = cvxpy.reshape(self._force, (len(mu), 3), order="C")
            constraints = [cvxpy.norm(y[:, 1:], axis=1) <= cvxpy.multiply(mu, y[:, 0]), y[:, 0] >= 0]
        else:
            constraints = [self._force >= 0]
        self._problem = cvxpy.Problem(objective, constraints)

    def with_friction(self, friction: Friction) -> ConeProgramme:
        """See :meth:`mic.contact.backends.Backend.with_friction`; it is built again."""
        S, _, law, dimension = self._known
        return ConeProgramme(S, friction.coefficient, law, self.name, dimension)

    def subset(self, own: np.ndarray) -> ConeProgramme:
        """See :meth:`mic.contact.backends.Backend.subset`; it is built again."""
        S, mu, law, dimension = self._known
        rows = np.repeat(own, dimension)
        return ConeProgramme(S[np.ix_(rows, rows)], mu[own], law, self.name, dimension)

    def solve(self, b: np.ndarray, guess: np.ndarray | None) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
        """Forces for each row of ``b``; zero if the optimiser fails.  ``guess`` is ignored.

        See :meth:`mic.contact.backends.Backend.solve`; the rung is the optimiser's name.
        """
        force = np.zeros_like(b)
        iterations, factorisations = np.zeros((2, len(b)), dtype=np.int64)
        rung = np.full(len(b), self.name, dtype=object)
        if not self._force.size:
            return force, iterations, factorisations, rung
        for sample, row in enumerate(b[:, :: self._stride] * self._scaling):
            # The optimum scales with the load; a unit load suits the solvers' absolute tolerances.
            size = np.abs(row).max() or 1.0
            self._load.value = row / size
            try:
                self._problem.solve(solver=self._solver, **self._settings)
            except self._error:
                continue
            iterations[sample] = self._problem.solver_stats.num_iters or 0
            if self._force.value is not None and np.isfinite(self._force.value).all():
                force[sample, :: self._stride] = self._force.value * size * self._scaling
        return force, iterations, factorisations, rung

    def attempts(self, b: np.ndarray, force: np.ndarray) -> Iterator[tuple[np.ndarray, int, int, str]]:
        """No further methods."""
        return iter(())

    def infeasible(self, b: np.ndarray) -> bool:
        """Infeasibility is not detected."""
        return False
