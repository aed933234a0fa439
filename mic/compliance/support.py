"""Which rows hold a body: a statically determinate choice among those that read its rigid-body motions."""

from __future__ import annotations

import numpy as np
from scipy.linalg import qr

from mic.errors import FreeMotion

__all__ = ["motion_size", "statically_determinate"]


def statically_determinate(reading: np.ndarray, size: np.ndarray) -> np.ndarray:
    """Choose as many rows as there are rigid motions, so that they hold them best.

    Parameters
    ----------
    reading : (b, r) array
        What each row reads of each of the r rigid motions, ``rows @ G``.
    size : (r,) array
        How large the readings of each motion are in general, so that lengths and angles count alike.

    Returns
    -------
    (r,) int array
        Chosen rows, ascending.

    Raises
    ------
    FreeMotion
        If the rows leave a rigid motion free.
    """
    b, r = reading.shape
    reading = reading / np.where(size > 0, size, 1)
    length = np.linalg.norm(reading, axis=1)
    reading = reading / np.where(length > 0, length, 1)[:, None]
    rank = np.linalg.matrix_rank(reading, tol=1e-6) if b else 0
    if rank < r:
        raise FreeMotion(np.linalg.svd(reading, full_matrices=True)[2][rank:].T if b else np.eye(r))
    pivots = qr(reading.T, mode="economic", pivoting=True)[2]
    return np.sort(pivots[:r])


def motion_size(G: tuple[np.ndarray, ...]) -> np.ndarray:
    """(6P,) root mean square of the readings of each rigid motion over all functionals, for
    :func:`statically_determinate`."""
    total = max(1, sum(len(block) for block in G))
    return np.concatenate([np.linalg.norm(block, axis=0) for block in G]) / np.sqrt(total)
