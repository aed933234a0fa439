"""Newton's method from the answer of another one: the last step of every patient rung."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from mic.contact.ladder import NEWTON
from mic.contact.native import kernels
from mic.contact.native.problem import ScaledProblem

__all__ = ["polished"]


def polished(problem: ScaledProblem, q: np.ndarray, y: np.ndarray) -> Iterator[tuple[np.ndarray, int]]:
    """Newton from ``y``, one force after each run of the rung :data:`mic.contact.ladder.NEWTON`.

    Yields
    ------
    y : (3m,) array
    steps : int
        Factorisations that it took, one each.
    """
    scale = kernels.starting_scale(q)
    for damping, halvings in NEWTON["runs"]:
        z, w = y.copy(), problem.W @ y + q
        _, steps = kernels.newton(
            problem.equation,
            problem.W,
            np.empty((0, 0)),
            q,
            problem.parameters,
            z,
            w,
            damping,
            scale,
            NEWTON["tol"],
            NEWTON["steps"],
            halvings,
            len(problem.parameters),
        )
        yield z, steps
