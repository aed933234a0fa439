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

from collections.abc import Callable, Mapping, Sequence

import numpy as np
from scipy.special import chdtri

from mic.errors import SceneError
from mic.process.model import ReducedModel
from mic.statistics.estimates import LEVEL
from mic.statistics.normal_space import from_normal, normal_slopes

__all__ = ["NEGLECTED", "MANY", "SAMPLES", "bounds", "left_out"]

MANY = 20  #: number of contributors above which some are left out
SAMPLES = 40  #: samples with derivatives
NEGLECTED = 0.05  #: largest share of any variance for all contributors that are left out together
BLOCK = 10  # samples between two calls of `progress`


def bounds(
    model: ReducedModel,
    law: str,
    own: Mapping[str, Sequence[int]],
    samples: int = SAMPLES,
    seed: int = 0,
    progress: Callable[[int], None] = lambda count: None,
) -> np.ndarray | None:
    """Upper bounds of the total index of each contributor.

    Parameters
    ----------
    model : ReducedModel
    law : str
    own : mapping of str to sequence of int
        Numbers of the deviations of each contributor; contributors are independent.
    samples, seed : int
    progress : callable, optional
        Called with the number of samples that were done.

    Returns
    -------
    (g, k) array or None
        Infinite for resampled measured parts, which have no derivatives; None if parts are held by contact alone, so
        that there are no derivatives.
    """
    scene = model.scene
    stream = np.random.Generator(np.random.Philox(key=np.array([seed, samples], dtype=np.uint64)))
    z = stream.standard_normal((samples, len(scene.deviations)))
    values, turned = from_normal(scene, z), normal_slopes(scene, z)
    y, slopes = [], []
    try:
        for first in range(0, samples, BLOCK):
            found = model.sensitivities(values[first : first + BLOCK], law)
            y.append(np.where(found.failed[:, None], np.nan, found.measurements))
            slopes.append(np.matmul(found.jacobian, turned[first : first + BLOCK]))
            progress(len(found.failed))
    except SceneError:
        return None
    whole, slope = np.concatenate(y), np.concatenate(slopes)
    known = np.isfinite(whole).all(axis=1) & np.isfinite(slope).all(axis=(1, 2))
    whole, square = whole[known], slope[known] ** 2
    n = len(whole)
    if n < 3:
        return None
    low = whole.var(axis=0, ddof=1) * (n - 1) / chdtri(n - 1, (1 - LEVEL) / 2)
    told = []
    for columns in own.values():
        if any(getattr(scene.deviations[j], "scores", None) is not None for j in columns):
            told.append(np.full(whole.shape[1], np.inf))
            continue
        each = square[:, :, list(columns)].sum(axis=2)
        told.append(each.mean(axis=0) + 2 * each.std(axis=0, ddof=1) / np.sqrt(n))
    with np.errstate(invalid="ignore", divide="ignore"):
        return np.array(told) / low


def left_out(bound: np.ndarray, varies: np.ndarray) -> np.ndarray:
    """(g,) contributors that may be left out: the smallest, with at most :data:`NEGLECTED` of any variance together.

    Parameters
    ----------
    bound : (g, k) array
    varies : (k,) bool array
        Characteristics that vary.
    """
    own = bound[:, varies]
    order = np.argsort(own.max(axis=1, initial=0.0), kind="stable")
    out = np.zeros(len(bound), dtype=bool)
    out[order] = (np.cumsum(own[order], axis=0) <= NEGLECTED).all(axis=1)
    return out if out.sum() > 1 else np.zeros_like(out)
