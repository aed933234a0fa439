r"""Optimise settings by sequential quadratic programming with exact derivatives of the sample average.

On fixed samples the objective is a function of the settings x, and each sample has exact derivatives. A maximum of
several figures is replaced by an upper bound t on all of them, and the cost of a change by an upper bound s on
``cost |x|``, so that the problem is smooth:

    minimise  t + Σ s_i + W v   with   φ_j(x) ≤ t,   c_q(x) + v ≥ 0,   ± cost_i x_i ≤ s_i,   v ≥ 0,

within the bounds of x. W is large, so that v = 0 if the constraints can be satisfied; otherwise v is their smallest
common violation.

:func:`scipy.optimize.minimize` solves it with SLSQP [1]_. Settings are few and an evaluation is expensive: SLSQP takes
one gradient per step, whereas trust-constr takes several for its barrier and needs second derivatives, which a contact
path does not have. The result is the best of the visited points.

References
----------
.. [1] D. Kraft: A software package for sequential quadratic programming, DFVLR-FB 88-28, 1988.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from functools import cache

import numpy as np
from scipy.optimize import minimize

from mic.studies.optimisation.design import Design
from mic.studies.optimisation.evaluations import BudgetExceeded, DesignEvaluator

__all__ = ["descend"]

STEPS = 15
ENOUGH = 1e-3  # change of the scaled objective at which the search stops
SLACK = 100.0  # W, relative to the scaled objective


class _Problem:
    """The problem above, in settings u between 0 and 1, t, s and v."""

    def __init__(self, start: Design, evaluator: DesignEvaluator):
        self.start, self.evaluator, self.objective = start, evaluator, evaluator.objective
        space = evaluator.space
        self.low, self.width = space.low, space.high - space.low
        self.costs = space.costs if self.objective.kind == "cost" else np.zeros(len(space.costs))
        self.priced = np.flatnonzero(self.costs)
        self.scale = 1.0
        self._known = cache(self._evaluate)

    def settings(self, z: np.ndarray) -> np.ndarray:
        """Settings x of the unknowns z."""
        return self.low + self.width * np.clip(z[: len(self.width)], 0.0, 1.0)

    def values(self, z: np.ndarray) -> tuple[np.ndarray, ...]:
        """φ, c and their derivatives by u."""
        return self._known(tuple(self.settings(z).tolist()))

    def _evaluate(self, x: tuple[float, ...]) -> tuple[np.ndarray, ...]:
        y, slopes = self.evaluator.values_with_derivatives(replace(self.start, settings=x))
        figures = self.objective.figures(y, slopes)
        φ, dφ = self.objective.objective_terms(figures)
        c, dc = self.objective.inequalities(figures, x)
        return φ, dφ * self.width, c, dc * self.width

    def first(self) -> np.ndarray:
        """The unknowns z at the start; sets the scale of the objective."""
        u = (np.array(self.start.settings) - self.low) / self.width
        φ = self.values(u)[0]
        self.scale = max(float(np.abs(φ).max()), float((self.costs * self.width).max()), 1e-6)
        s = np.abs(self.costs * self.settings(u))[self.priced]
        c = self.values(u)[2]
        return np.concatenate([u, [float(φ.max()) / self.scale], s / self.scale, [max(0.0, -c.min(initial=0.0))]])

    def constraints(self, z: np.ndarray) -> np.ndarray:
        """Constraint functions of z, which must not be negative."""
        φ, _, c, _ = self.values(z)
        a = len(self.width)
        priced = (self.costs * self.settings(z))[self.priced] / self.scale
        s = z[a + 1 : -1]
        return np.concatenate([z[a] - φ / self.scale, c + z[-1], s - priced, s + priced])

    def constraint_slopes(self, z: np.ndarray) -> np.ndarray:
        """Derivatives of :meth:`constraints` by z."""
        _, dφ, _, dc = self.values(z)
        a, d = len(self.width), len(self.priced)
        by_u = np.zeros((d, a))
        by_u[np.arange(d), self.priced] = (self.costs * self.width)[self.priced] / self.scale

        def rows(u: np.ndarray, t: float, s: np.ndarray, v: float) -> np.ndarray:
            return np.column_stack([u, np.full(len(u), t), s, np.full(len(u), v)])

        return np.concatenate(
            [
                rows(-dφ / self.scale, 1.0, np.zeros((len(dφ), d)), 0.0),
                rows(dc, 0.0, np.zeros((len(dc), d)), 1.0),
                rows(-by_u, 0.0, np.eye(d), 0.0),
                rows(by_u, 0.0, np.eye(d), 0.0),
            ]
        )


def descend(start: Design, evaluator: DesignEvaluator, better: Callable[[Design], None]) -> Design:
    """Optimise the settings of a design; its orders and places stay.

    Parameters
    ----------
    start : Design
    evaluator : DesignEvaluator
    better : callable
        Called with each design that is the best so far.
    """
    best = start
    if not start.settings:
        return best

    def accept_if_better(z: np.ndarray) -> None:
        nonlocal best
        design = replace(start, settings=evaluator.space.settable(problem.settings(z)))
        if design != best and evaluator.merit(design) < evaluator.merit(best):
            best = design
            better(best)

    try:
        if len(evaluator.values_with_derivatives(start)[0]) < 2:  # too few samples have derivatives
            return best
        problem = _Problem(start, evaluator)
        z = problem.first()
        a = len(problem.width)
        gradient = np.concatenate([np.zeros(a), np.ones(len(z) - a - 1), [SLACK]])
        result = minimize(
            lambda z: float(gradient @ z),
            z,
            jac=lambda z: gradient,
            bounds=[(0.0, 1.0)] * a + [(None, None)] * (len(z) - a - 1) + [(0.0, None)],
            constraints={"type": "ineq", "fun": problem.constraints, "jac": problem.constraint_slopes},
            callback=accept_if_better,
            method="SLSQP",
            options={"maxiter": STEPS, "ftol": ENOUGH},
        )
        accept_if_better(result.x)
    except BudgetExceeded:
        pass
    return best
