r"""Screen inputs that hardly matter by bounds of their total Sobol indices from exact derivatives.

The deviations are functions of independent standard normal numbers z. The total index of number i is bounded by the
derivatives (Poincaré's inequality for the normal distribution, [1]_, [2]_; SALib's `dgsm` computes ν by finite
differences, here it takes exact derivatives),

.. math::

    T_i \le \nu_i / V, \qquad \nu_i = E\,(\partial y / \partial z_i)^2,

with equality if y is linear in it; the index of a group is bounded by the sum. Distributions and correlations enter by
the chain rule. The bounds include the sampling error: ν is increased by two standard errors, and V is the lower end of
its confidence interval.

References
----------
.. [1] I. M. Sobol', S. Kucherenko: Derivative based global sensitivity measures and their link with global sensitivity
       indices, Math. Comput. Simul. 79 (2009) 3009-3017.
.. [2] M. Lamboni, B. Iooss, A.-L. Popelin, F. Gamboa: Derivative-based global sensitivity measures: general links with
       Sobol' indices and numerical tests, Math. Comput. Simul. 87 (2013) 45-54.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np
from scipy.special import chdtri

from mic.errors import SceneError
from mic.process.model import ReducedModel
from mic.statistics.estimates import LEVEL
from mic.statistics.normal_space import from_normal, normal_derivatives
from mic.studies.samples import Progress, derivatives

__all__ = ["NEGLECTED", "MANY", "SAMPLES", "bounds", "negligible"]

MANY = 20  #: number of contributors above which some are left out
SAMPLES = 40  #: samples with derivatives
NEGLECTED = 0.05  #: largest share of any variance for all contributors that are left out together


def bounds(
    model: ReducedModel,
    law: str,
    contributors: Mapping[str, Sequence[int]],
    samples: int = SAMPLES,
    seed: int = 0,
    progress: Progress = lambda count: None,
) -> np.ndarray | None:
    """Upper bounds of the total index of each contributor.

    Parameters
    ----------
    model : ReducedModel
    law : str
    contributors : mapping of str to sequence of int
        Numbers of the deviations of each contributor; contributors are independent.
    samples, seed : int
    progress : callable, optional
        Called with the number of evaluated samples.

    Returns
    -------
    (g, k) array or None
        Infinite for resampled measured parts, which have no derivatives; None if parts are held by contact alone, which
        leaves no derivatives, or if fewer than three samples are valid.
    """
    scene = model.scene
    stream = np.random.Generator(np.random.Philox(key=np.array([seed, samples], dtype=np.uint64)))
    z = stream.standard_normal((samples, len(scene.deviations)))
    try:
        y, jacobian = derivatives(model, from_normal(scene, z), law, progress)
    except SceneError:
        return None
    slopes = np.matmul(jacobian, normal_derivatives(scene, z))
    known = np.isfinite(y).all(axis=1) & np.isfinite(slopes).all(axis=(1, 2))
    y, squares = y[known], slopes[known] ** 2
    n = len(y)
    if n < 3:
        return None
    variance = y.var(axis=0, ddof=1) * (n - 1) / chdtri(n - 1, (1 - LEVEL) / 2)
    bound = []
    for columns in contributors.values():
        if any(getattr(scene.deviations[j], "scores", None) is not None for j in columns):
            bound.append(np.full(y.shape[1], np.inf))
            continue
        ν = squares[:, :, list(columns)].sum(axis=2)
        bound.append(ν.mean(axis=0) + 2 * ν.std(axis=0, ddof=1) / np.sqrt(n))
    with np.errstate(invalid="ignore", divide="ignore"):
        return np.array(bound) / variance


def negligible(bound: np.ndarray, varies: np.ndarray) -> np.ndarray:
    """(g,) contributors that may be left out: the smallest, with at most :data:`NEGLECTED` of any variance together.

    Parameters
    ----------
    bound : (g, k) array
    varies : (k,) bool array
        Characteristics that vary.
    """
    relevant = bound[:, varies]
    order = np.argsort(relevant.max(axis=1, initial=0.0), kind="stable")
    negligible = np.zeros(len(bound), dtype=bool)
    negligible[order] = (np.cumsum(relevant[order], axis=0) <= NEGLECTED).all(axis=1)
    return negligible if negligible.sum() > 1 else np.zeros_like(negligible)
