r"""Settings by exact derivatives: the average over samples, made small by sequential quadratic programming.

With all samples fixed the objective is a function of the settings x alone, and each sample has exact derivatives. What
is the largest of several figures becomes a bound t on all of them, what a change costs a bound on ``|x|``, so that all
is smooth:

    least of  t + Σ s_i + W v   with   φ_j(x) ≤ t,   c_q(x) + v ≥ 0,   ± cost_i x_i ≤ s_i,   v ≥ 0,

within the bounds of x. Where the constraints can be kept v is 0, for W is large; where they cannot, it is the least by
which all of them are missed.

SciPy's SLSQP [1]_ solves it. Settings are few and an evaluation is dear: it takes a gradient a step where trust-constr,
the other of SciPy's methods that obey such constraints, takes several for its barrier, and it needs no second
derivatives, which a path of contact does not have. What is told is the best of the points that it has visited.

References
----------
.. [1] D. Kraft: A software package for sequential quadratic programming, DFVLR-FB 88-28, 1988.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import numpy as np
from scipy.optimize import minimize

from mic.studies.optimisation.design import Design
from mic.studies.optimisation.evaluations import Spent, Trials

__all__ = ["descend"]

STEPS = 15
ENOUGH = 1e-3  # of the objective: a step that gains no more is the last
SLACK = 100.0  # W, in objectives


class _Problem:
    """The problem above, in settings u between 0 and 1, t, s and v."""

    def __init__(self, start: Design, trials: Trials):
        self.start, self.trials, self.objective = start, trials, trials.objective
        space = trials.space
        self.low, self.width = space.low, space.high - space.low
        self.costs = space.costs if self.objective.kind == "cost" else np.zeros(len(space.costs))
        self.dear = np.flatnonzero(self.costs)
        self.scale = 1.0
        self._told: dict[bytes, tuple[np.ndarray, ...]] = {}

    def settings(self, z: np.ndarray) -> np.ndarray:
        """Of the unknowns."""
        return self.low + self.width * np.clip(z[: len(self.width)], 0.0, 1.0)

    def told(self, z: np.ndarray) -> tuple[np.ndarray, ...]:
        """φ, c and their derivatives by u."""
        x = self.settings(z)
        key = x.tobytes()
        if key not in self._told:
            design = replace(self.start, settings=tuple(float(one) for one in x))
            y, slopes = self.trials.derived(design)
            found = self.objective.figures(y, slopes)
            φ, dφ = self.objective.largest(found)
            c, dc = self.objective.inequalities(found, x)
            self._told[key] = φ, dφ * self.width, c, dc * self.width
        return self._told[key]

    def first(self) -> np.ndarray:
        """The unknowns at the start."""
        u = (np.array(self.start.settings) - self.low) / self.width
        φ = self.told(u)[0]
        self.scale = max(float(np.abs(φ).max()), float((self.costs * self.width).max()), 1e-6)
        s = np.abs(self.costs * self.settings(u))[self.dear]
        c = self.told(u)[2]
        return np.concatenate([u, [float(φ.max()) / self.scale], s / self.scale, [max(0.0, -c.min(initial=0.0))]])

    def kept(self, z: np.ndarray) -> np.ndarray:
        """What must not be negative."""
        φ, _, c, _ = self.told(z)
        a = len(self.width)
        dear = (self.costs * self.settings(z))[self.dear] / self.scale
        s = z[a + 1 : -1]
        return np.concatenate([z[a] - φ / self.scale, c + z[-1], s - dear, s + dear])

    def kept_slopes(self, z: np.ndarray) -> np.ndarray:
        """Its derivatives."""
        _, dφ, _, dc = self.told(z)
        a, d = len(self.width), len(self.dear)
        by_u = np.zeros((d, a))
        by_u[np.arange(d), self.dear] = (self.costs * self.width)[self.dear] / self.scale

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


def descend(start: Design, trials: Trials, better: Callable[[Design], None]) -> Design:
    """The best settings that are found from a design on, with its orders and places.

    Parameters
    ----------
    start : Design
    trials : Trials
    better : callable
        Called with each design that is the best so far.
    """
    best = start
    if not start.settings:
        return best

    def look(z: np.ndarray) -> None:
        nonlocal best
        design = replace(start, settings=trials.space.settable(problem.settings(z)))
        if design != best and trials.merit(design) < trials.merit(best):
            best = design
            better(best)

    try:
        if len(trials.derived(start)[0]) < 2:  # no sample has derivatives
            return best
        problem = _Problem(start, trials)
        z = problem.first()
        a = len(problem.width)
        gradient = np.concatenate([np.zeros(a), np.ones(len(z) - a - 1), [SLACK]])
        found = minimize(
            lambda z: float(gradient @ z),
            z,
            jac=lambda z: gradient,
            bounds=[(0.0, 1.0)] * a + [(None, None)] * (len(z) - a - 1) + [(0.0, None)],
            constraints={"type": "ineq", "fun": problem.kept, "jac": problem.kept_slopes},
            callback=look,
            method="SLSQP",
            options={"maxiter": STEPS, "ftol": ENOUGH},
        )
        look(found.x)
    except Spent:
        pass
    return best
