"""One matrix, many samples: a product that gives each sample the same bits in whatever batch it comes.

BLAS adds up a row of ``X A`` in another order when X has another number of rows. The last bit that this moves is enough
for a contact to take the other of two ways.
"""

from __future__ import annotations

import numpy as np

__all__ = ["product"]

#: Samples that BLAS is handed at a time, always: whole tiles of its kernels, so that it treats all of them alike.
TILE = 8


def product(samples: np.ndarray, matrix: np.ndarray) -> np.ndarray:
    """``X A``, one sample a row.

    Parameters
    ----------
    samples : (n, k) array
        X.
    matrix : (k, l) array
        A.

    Returns
    -------
    (n, l) array
    """
    (n, k), tiles = samples.shape, -(-len(samples) // TILE)
    padded = np.zeros((tiles * TILE, k))
    padded[:n] = samples
    return np.matmul(padded.reshape(tiles, TILE, k), matrix).reshape(tiles * TILE, matrix.shape[1])[:n]
