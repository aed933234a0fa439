"""Proof that no force at all can keep the contacts of a sample from penetrating."""

from __future__ import annotations

import numpy as np
from scipy.optimize import nnls

__all__ = ["infeasible"]

#: Forces ``d`` with ``‖W d‖`` below this share of their work on the overlaps prove infeasibility: balancing the load
#: would take forces this many times over the natural ones.
COMPLIANCE = 1e-11
#: Directions of the tangential force on each cone; contacts above which they would take seconds.
RAYS, MANY = 16, 100


def infeasible(W: np.ndarray, q: np.ndarray, size: int, dilatancy: np.ndarray | None = None) -> bool:
    """Whether some forces move nothing and do work on the overlaps.

    A law allows displacements with ``w_n >= δ‖w_t‖``; with ``‖d_t‖ <= δ d_n`` they do no negative work on ``d``.
    Farkas' lemma: with ``W d = 0`` and ``q·d < 0``, ``w·d = q·d < 0`` for every force, so none is admissible. Found by
    non-negative least squares, ``min ‖W d‖² + (q·d/‖q‖ + 1)²``, over pressures and over rays of the cone. Sufficient
    for every law; with ``δ = 0`` necessary for ``w_n >= 0`` to be out of reach.

    Parameters
    ----------
    W : (size m, size m) array
        Scaled compliance.
    q : (size m,) array
        Scaled displacements without contact forces.
    size : {3, 1}
        Rows of a contact.
    dilatancy : (m,) array, optional
        δ; default: zero.
    """
    moved, work = W[::size], q[::size]
    if dilatancy is not None and dilatancy.any() and len(work) <= MANY:
        angle = np.arange(RAYS) * (2.0 * np.pi / RAYS)
        rays = dilatancy[:, None, None] * np.column_stack([np.cos(angle), np.sin(angle)])
        both = np.column_stack([W, q]).reshape(len(work), size, -1)
        turned = both[:, :1] + np.einsum("kac,kcj->kaj", rays, both[:, 1:])
        moved, work = np.vstack([moved, turned[..., :-1].reshape(-1, len(W))]), np.append(work, turned[..., -1])
    if not (work < 0.0).any():
        return False
    work = work / np.linalg.norm(work)
    try:
        d, _ = nnls(np.vstack([moved.T, work]), np.append(np.zeros(len(W)), -1.0))
    except RuntimeError:  # no convergence: nothing proven
        return False
    done = work @ d
    return bool(done < -0.5 and np.linalg.norm(d @ moved) <= COMPLIANCE * -done)
