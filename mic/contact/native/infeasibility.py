"""Proof that no force at all can keep the contacts of a sample from penetrating."""

from __future__ import annotations

import numpy as np
from scipy.optimize import nnls

__all__ = ["infeasible"]

#: A pressure ``d`` with ``‖W d‖`` below this share of its work on the overlaps proves infeasibility: balancing the load
#: would take forces this many times over the natural ones.
COMPLIANCE = 1e-11


def infeasible(W: np.ndarray, q: np.ndarray, size: int) -> bool:
    """Whether pressures ``d >= 0`` move nothing and do work on the overlaps.

    Farkas' lemma: with ``W d = 0`` and ``q·d < 0``, ``w·d = q·d < 0`` for every force, so that some ``w_n < 0``.  Found
    by non-negative least squares, ``min ‖W d‖² + (q·d/‖q‖ + 1)²``.  Sufficient for every law, and necessary without
    friction.

    Parameters
    ----------
    W : (size m, size m) array
        Scaled compliance.
    q : (size m,) array
        Scaled displacements without contact forces.
    size : {3, 1}
        Rows of a contact.
    """
    overlap = q[::size]
    if not (overlap < 0.0).any():
        return False
    overlap = overlap / np.linalg.norm(overlap)
    matrix = np.vstack([W[:, ::size], overlap])
    try:
        d, _ = nnls(matrix, np.append(np.zeros(len(W)), -1.0))
    except RuntimeError:  # no convergence: nothing proven
        return False
    work = overlap @ d
    return bool(work < -0.5 and np.linalg.norm(W[:, ::size] @ d) <= COMPLIANCE * -work)
