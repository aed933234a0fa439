r"""First-order reliability method (FORM) with exact derivatives: design points and failure probabilities.

The deviations are functions of standard normal numbers z; a limit is violated where ``g(z) > 0``. The design point z*
is the point of ``g = 0`` nearest to the origin. If g is linear there, the probability is ``Φ(−β)`` with ``β = ‖z*‖``.
It is found by the iteration of Hasofer, Lind, Rackwitz and Fiessler [1]_, ``z' = (∇g·z − g) ∇g / ‖∇g‖²``, with a line
search on ``½‖z‖² + c |g|`` [2]_. All limits iterate together in batched evaluations, which
:func:`scipy.optimize.minimize` cannot do. Each side of each key characteristic is a limit of its own. The probability
of violating any of several limits is that of a union of half-spaces ``α·z > β`` with ``α = z*/‖z*‖``, by importance
sampling [3]_.

The result is approximate if a limit is curved, kinked by changes of contact, or has several design points. It is
compared with subset simulation (:mod:`mic.studies.rare`), whose samples provide the starting points.

References
----------
.. [1] R. Rackwitz, B. Fiessler: Structural reliability under combined random load sequences, Comput. Struct. 9 (1978)
       489-494.
.. [2] Y. Zhang, A. Der Kiureghian: Two improved algorithms for reliability analysis, in: Reliability and Optimization
       of Structural Systems, 1995, 297-304.
.. [3] A. B. Owen, Y. Maximov, M. Chertkov: Importance sampling the union of rare events with an application to power
       systems analysis, Electron. J. Stat. 13 (2019) 231-254.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np
import pandas as pd
from scipy.special import ndtr, ndtri

from mic.errors import SceneError
from mic.process.model import ReducedModel
from mic.results.schema import DESIGN_POINTS
from mic.statistics.draw import number_count
from mic.statistics.normal_space import from_normal, normal_derivatives
from mic.studies.samples import Progress, half_tolerances

__all__ = ["DesignPoints", "design_points", "union_probability", "first_order", "find_design_points"]

ROUNDS = 20
ENOUGH = 1e-3  # relative tolerance of g and of β
HALVINGS = 8
FALLS = 0.3  # share of the decrease predicted by linearisation that a step must achieve
FARTHEST = 8.0  # bound of |z| for evaluations, beyond any probability of interest
UNION = 100_000  # samples of half-spaces

#: Maps numbers (n, d) and their limits (n,) to g (n,) and its gradient (n, d); NaN where unknown.
Slopes = Callable[[np.ndarray, np.ndarray], tuple[np.ndarray, np.ndarray]]


@dataclass(frozen=True)
class DesignPoints:
    """Design points of s limits.

    Attributes
    ----------
    z : (s, d) array
    beta : (s,) array
        Distance, negative if the limit is violated at the origin.
    direction : (s, d) array
        α, towards the violation.
    found : (s,) bool array
        Whether the iteration converged: on the limit, with its gradient along z.
    """

    z: np.ndarray
    beta: np.ndarray
    direction: np.ndarray
    found: np.ndarray


def find_design_points(slopes: Slopes, start: np.ndarray) -> DesignPoints:
    """The design points of s limits.

    Parameters
    ----------
    slopes : callable
    start : (s, d) array
        Starting point of each limit, with a nonzero gradient of g.
    """
    z, numbers = np.array(start, dtype=float), np.arange(len(start))
    g, slope = slopes(z, numbers)
    converged, active = np.zeros(len(z), dtype=bool), numbers
    for _ in range(ROUNDS):
        steep = np.linalg.norm(slope[active], axis=1)
        active = active[np.isfinite(g[active]) & (steep > 0) & (np.linalg.norm(z[active], axis=1) < 1.5 * FARTHEST)]
        if not active.size:
            break
        gradient, at, trial_g = slope[active], z[active], g[active]
        squared = (gradient**2).sum(axis=1)
        step = (((gradient * at).sum(axis=1) - trial_g) / squared)[:, None] * gradient - at
        scale = np.maximum(1.0, np.linalg.norm(at, axis=1))
        close = (np.abs(trial_g) < ENOUGH * np.sqrt(squared) * scale) & (np.linalg.norm(step, axis=1) < ENOUGH * scale)
        converged[active[close]] = True
        active, step = active[~close], step[~close]
        if not active.size:
            break
        # c > ‖z‖/‖∇g‖ makes the step a descent direction
        c = 2 * np.linalg.norm(z[active], axis=1) / np.linalg.norm(slope[active], axis=1) + 1.0
        merit = 0.5 * (z[active] ** 2).sum(axis=1) + c * np.abs(g[active])
        decrease = FALLS * ((z[active] * step).sum(axis=1) - c * np.abs(g[active]))  # per unit of length
        pending, length = np.arange(len(active)), 1.0
        for _ in range(HALVINGS):
            trial_limits = active[pending]
            trial = z[trial_limits] + length * step[pending]
            trial_g, trial_slope = slopes(trial, trial_limits)
            after = 0.5 * (trial**2).sum(axis=1) + c[pending] * np.abs(trial_g)
            better = after <= merit[pending] + length * decrease[pending]
            better |= length < 2.0 ** (2 - HALVINGS)
            better &= np.isfinite(trial_g)
            improved = trial_limits[better]
            z[improved], g[improved], slope[improved] = trial[better], trial_g[better], trial_slope[better]
            pending, length = pending[~better], length / 2
            if not pending.size:
                break
        active = np.delete(active, pending)  # limits without an improving step end here
    steep = np.linalg.norm(slope, axis=1, keepdims=True)
    direction = np.divide(slope, steep, out=np.zeros_like(slope), where=steep > 0)
    # Distance of the tangent plane of the limit.
    flat = np.where(g < 0, -np.inf, np.inf)
    beta = (direction * z).sum(axis=1) - np.divide(g, steep[:, 0], out=flat, where=steep[:, 0] > 0)
    return DesignPoints(z, beta, direction, converged)


def union_probability(direction: np.ndarray, beta: np.ndarray) -> float:
    """Probability of a union of half-spaces ``α·z > β`` of standard normal numbers.

    Parameters
    ----------
    direction : (s, d) array
        α, of length 1.
    beta : (s,) array
    """
    p = ndtr(-beta)
    possible = p > 0
    direction, beta, p = direction[possible], beta[possible], p[possible]
    if len(p) < 2:
        return float(p.sum())
    stream = np.random.Generator(np.random.Philox(key=len(p)))
    chosen = stream.choice(len(p), UNION, p=p / p.sum())
    along = -ndtri(stream.random(UNION) * p[chosen])  # standard normal beyond β
    z = stream.standard_normal((UNION, direction.shape[1]))
    z += (along - (z * direction[chosen]).sum(axis=1))[:, None] * direction[chosen]
    inside = z @ direction.T > beta
    inside[np.arange(UNION), chosen] = True
    return float(p.sum() * (1 / inside.sum(axis=1)).mean())


def design_points(
    model: ReducedModel, law: str | None, z: np.ndarray, y: np.ndarray, progress: Progress = lambda n: None
) -> tuple[pd.DataFrame, DesignPoints, list[tuple[int, str]]]:
    """The design point of each limit of each key characteristic.

    Parameters
    ----------
    model : ReducedModel
    law : str, optional
    z, y : (n, d), (n, k) array
        Numbers and key characteristics of samples. The search starts at the most likely violation of each limit, or at
        the sample nearest to the limit.
    progress : callable, optional
        Called with the number of assemblies after each round.

    Returns
    -------
    DataFrame
        As :data:`mic.results.schema.DESIGN_POINTS` declares it.
    DesignPoints
    list of (int, str)
        Number of the characteristic of each limit, and ``upper`` or ``lower``.

    Raises
    ------
    SceneError
        If measured parts are resampled, which leaves no derivatives, or parts are held by contact alone.
    """
    scene = model.scene
    if number_count(scene) != len(scene.deviations):
        raise SceneError("resampled measured parts have no derivatives")
    limits = [
        (k, side)
        for k, item in enumerate(scene.measurements)
        for side, limit in zip(("lower", "upper"), item.bounds)
        if np.isfinite(limit)
    ]
    number = np.array([k for k, _ in limits], dtype=int)
    sign = np.array([-1.0 if side == "lower" else 1.0 for _, side in limits])
    limit = np.array([getattr(scene.measurements[k], side) for k, side in limits])
    half = half_tolerances(scene)[number]

    def slopes(at: np.ndarray, selected: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        at = at.clip(-FARTHEST, FARTHEST)
        values, derivatives = from_normal(scene, at), normal_derivatives(scene, at)
        result = model.sensitivities(values, law)
        progress(len(at))
        k, rows = number[selected], np.arange(len(at))
        g = sign[selected] * (result.measurements[rows, k] - limit[selected]) / half[selected]
        slope = (sign / half)[selected, None] * np.einsum("np,npd->nd", result.jacobian[rows, k], derivatives)
        return np.where(result.failed, np.nan, g), np.nan_to_num(slope)

    g = sign * (y[:, number] - limit) / half
    g[~np.isfinite(g)] = -np.inf
    length = np.linalg.norm(z, axis=1)[:, None]
    first = np.where(g > 0, FARTHEST**2 - length, g - np.abs(g).max(where=np.isfinite(g), initial=1.0)).argmax(axis=0)
    design = find_design_points(slopes, z[first])
    values = from_normal(scene, design.z.clip(-FARTHEST, FARTHEST))
    rows = [
        {
            "law": law or scene.report.laws[0],
            "measurement": scene.measurements[k].name,
            "limit": side,
            "beta": float(design.beta[i]),
            "probability": float(ndtr(-design.beta[i])),
            "found": bool(design.found[i]),
            "deviation": item.name,
            "value": float(values[i, j]),
            "sigmas": float((values[i, j] - item.mean) / item.sigma) if item.sigma > 0 else 0.0,
            "share": float(design.direction[i, j] ** 2),
        }
        for i, (k, side) in enumerate(limits)
        for j, item in enumerate(scene.deviations)
    ]
    return pd.DataFrame(rows, columns=DESIGN_POINTS.names), design, limits


def first_order(design: DesignPoints, limits: Sequence[tuple[int, str]], group: Sequence[int]) -> float:
    """First-order probability that any limit of some characteristics, given by number, is violated."""
    selected = np.isin([k for k, _ in limits], list(group)) & np.isfinite(design.beta)
    return union_probability(design.direction[selected], design.beta[selected])
