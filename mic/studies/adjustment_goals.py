r"""Objectives of an adjustment of one assembly, and the changes that minimise them for linear characteristics.

With key characteristics y (s, k) at s points of the uncertainty, limits L and U, half tolerances t and changes x of the
adjustments, :class:`WithinLimits` minimises

.. math::

    10^6 n + w \sum_k e_k / t_k + \sum_i c_i |x_i|, \qquad e_k = \max_s (y_{sk} + h_k - U_k,\ L_k - y_{sk} + h_k,\ 0),

with n the number of characteristics whose interval y ± h exceeds a limit. For linear y, without n, it is a linear
program, whose solutions change few adjustments. :class:`LeastExcess` compares changes where none brings all
characteristics within their limits: the largest excess counts. :class:`NearTarget` minimises the root mean square of
``w (y - target) / t``; for linear y this is a bounded least-squares problem.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.optimize import linprog, lsq_linear

__all__ = ["Goal", "LeastExcess", "NearTarget", "WithinLimits"]

OUTSIDE = 1e6  # per characteristic outside its limits
EXCESS = 50.0  # per excess of half the tolerance, in the comparison of changes
LARGEST = 5e3  # per mm of the largest excess, where no changes bring everything within limits
PROGRAM_EXCESS = 1e4  # the same in the linear program, which brings everything within limits if that is possible
INSIDE = 1e-6  # of half the tolerance: distance to the limits that the linear program keeps
SHRINKAGE = 3e-3  # weight of the distance of the changes from the common ones


@dataclass(frozen=True)
class WithinLimits:
    """All characteristics within their limits at the least cost.

    Attributes
    ----------
    lower, upper, half_tolerance : (k,) array
        mm.
    cost : (a,) array
        Cost per unit of each change.
    interval : (k,) array
        Half width h of the interval of each characteristic, mm.
    """

    lower: np.ndarray
    upper: np.ndarray
    half_tolerance: np.ndarray
    cost: np.ndarray
    interval: np.ndarray

    #: decreases of the merit below which an adjustment, or another evaluation, is not worth it; merit that is enough
    worth, enough, good = 0.05, 1e-4, 0.0

    def excess(self, y: np.ndarray) -> np.ndarray:
        """(..., k) largest excess of the intervals of (..., s, k) over their limits, mm; negative within."""
        return np.maximum(y + self.interval - self.upper, self.lower - y + self.interval).max(axis=-2)

    def merit(self, y: np.ndarray, changes: np.ndarray) -> np.ndarray:
        """(n,) objective of (n, s, k) characteristics with changes (n, a); less is better."""
        excess = self.excess(y)
        relative = np.maximum(excess, 0.0) / self.half_tolerance
        return OUTSIDE * (excess > 0).sum(axis=-1) + EXCESS * relative.sum(axis=-1) + np.abs(changes) @ self.cost

    def step(self, y: np.ndarray, slopes: np.ndarray, at: np.ndarray, low: np.ndarray, high: np.ndarray) -> np.ndarray:
        """(a,) changes between bounds that minimise the objective for ``y + slopes (x - at)``.

        Parameters
        ----------
        y : (s, k) array
        slopes : (s, k, a) array
        at, low, high : (a,) array
        """
        (_, k, a), t = slopes.shape, self.half_tolerance
        rows, bounds = [], []
        for sign, limit in ((1.0, self.upper), (-1.0, self.lower)):
            limited = np.flatnonzero(np.isfinite(limit))
            for value, slope in zip(y, slopes):
                scaled = sign * slope / t[:, None]
                rows.append(np.column_stack([scaled, -scaled, -np.eye(k)])[limited])
                room = (sign * (limit - value) - self.interval) / t + scaled @ at - INSIDE
                bounds.append(room[limited])
        costs = np.concatenate([self.cost, self.cost, np.full(k, PROGRAM_EXCESS)]) + 1e-9
        ranges = [
            *zip(np.maximum(low, 0), np.maximum(high, 0)),
            *zip(np.maximum(-high, 0), np.maximum(-low, 0)),
            *[(0, None)] * k,
        ]
        program = linprog(costs, np.concatenate(rows), np.concatenate(bounds), bounds=ranges, method="highs")
        return at if program.x is None else program.x[:a] - program.x[a : 2 * a]


class LeastExcess(WithinLimits):
    """The least largest excess, then the least cost: an adjustment by its whole range counts as 0.2 µm."""

    def merit(self, y: np.ndarray, changes: np.ndarray) -> np.ndarray:
        """As :meth:`WithinLimits.merit`."""
        largest = self.excess(y).max(axis=-1)
        return OUTSIDE * (largest > 0) + LARGEST * np.maximum(largest, 0.0) + np.abs(changes) @ self.cost


@dataclass(frozen=True)
class NearTarget:
    """The weighted root-mean-square distance of the characteristics from a target, relative to half their tolerances.

    Attributes
    ----------
    target : (k,) array
        mm.
    weight : (k,) array
        Weight of each distance, 1/mm, with mean square 1 relative to half the tolerances.
    common : (a,) array
        Changes that are common to all assemblies.
    size : (a,) array
        Largest change of each adjustment.
    """

    target: np.ndarray
    weight: np.ndarray
    common: np.ndarray
    size: np.ndarray

    worth, enough, good = 1e-3, 5e-4, 5e-3

    def merit(self, y: np.ndarray, changes: np.ndarray) -> np.ndarray:
        """(n,) objective of (n, s, k) characteristics; less is better."""
        moved = SHRINKAGE * (changes - self.common) / self.size
        return np.sqrt(np.mean(((y - self.target) * self.weight) ** 2, axis=(-2, -1)) + (moved**2).sum(axis=-1))

    def step(self, y: np.ndarray, slopes: np.ndarray, at: np.ndarray, low: np.ndarray, high: np.ndarray) -> np.ndarray:
        """As :meth:`WithinLimits.step`."""
        free, scale = low < high, np.sqrt(y.size)
        scaled = (slopes * self.weight[:, None] * self.size).reshape(y.size, -1) / scale
        fixed = np.where(free, 0.0, (low - at) / self.size)
        right = -((y - self.target) * self.weight).ravel() / scale - scaled @ fixed
        pull = SHRINKAGE * ((self.common - at) / self.size)[free]
        equations = np.concatenate([scaled[:, free], SHRINKAGE * np.eye(int(free.sum()))])
        bounds = [((end - at) / self.size)[free] for end in (low, high)]
        result = at + self.size * fixed
        if free.any():
            solution = lsq_linear(equations, np.concatenate([right, pull]), bounds, method="bvls").x
            result[free] = at[free] + self.size[free] * solution
        return np.clip(result, low, high)


Goal = WithinLimits | NearTarget
