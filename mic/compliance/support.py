"""Chooses rows that hold a body: a statically determinate subset of those that read its rigid-body motions."""

from __future__ import annotations

import numpy as np

from mic.errors import FreeMotion

__all__ = ["completing_rows", "independent_rows", "motion_size", "statically_determinate"]

EQUAL = 1e-7  # relative difference of readings that count as equal

RANK = 1e-6  # relative to a row's own reading: a smaller component independent of the other rows counts as none

SILENT = 1e-9  # relative to the largest reading: rows of strain read only rounding errors of rigid motions

#: Weight of the strongest row that reads no translation, relative to one that does. Rotations and first moments of a
#: nugget hold a part by a lever of a few mm, and rows of strain by almost nothing: supported on them the part is so
#: compliant that rounding errors dominate the readings of other rows.
SHORT = 0.1


def statically_determinate(reading: np.ndarray, size: np.ndarray) -> np.ndarray:
    """Choose as many rows as there are rigid motions, so that they hold them best.

    Each step takes the row with the largest reading of the motions that are still free, as in QR with pivoting, and
    the first of several equal ones. Rows that read no translation come last. The choice does not depend on the scene's
    orientation nor on its units.

    Parameters
    ----------
    reading : (b, r) array
        Readings of each row under each of the r rigid motions, ``rows @ G``: for each part three translations, then
        three rotations.
    size : (r,) array
        Typical reading of each motion, so that lengths and angles have equal weight.

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
    reading = _normalised(reading, size)
    rank = np.linalg.matrix_rank(reading, tol=RANK) if b else 0
    if rank < r:
        raise FreeMotion(np.linalg.svd(reading, full_matrices=True)[2][rank:].T if b else np.eye(r))
    return np.sort(_strongest(reading, r, 0.0))


def completing_rows(held: np.ndarray, offered: np.ndarray, size: np.ndarray) -> np.ndarray:
    """Choose rows that hold the motions which other rows leave free: one for each such motion.

    Parameters
    ----------
    held : (b, r) array
        Readings of the rows that hold already.
    offered : (o, r) array
        Readings of the rows to choose from.
    size : (r,) array
        As in :func:`statically_determinate`.

    Returns
    -------
    int array
        Chosen rows of `offered`, ascending; none if nothing is free.

    Raises
    ------
    FreeMotion
        If all rows together leave a motion free.
    """
    free = _unread(_normalised(held, size))
    reading = _normalised(offered, size) @ free
    chosen = _strongest(reading, free.shape[1])
    if len(chosen) < free.shape[1]:
        raise FreeMotion(free @ _unread(reading))
    return np.sort(chosen)


def independent_rows(offered: np.ndarray, size: np.ndarray) -> np.ndarray:
    """The smallest subset of rows (o, r) that holds all motions which all of them hold, ascending."""
    return np.sort(_strongest(_normalised(offered, size), offered.shape[1]))


def _unread(reading: np.ndarray) -> np.ndarray:
    """(r, k) motions that rows (b, r) do not read."""
    if not len(reading):
        return np.eye(reading.shape[1])
    _, share, motion = np.linalg.svd(reading, full_matrices=True)
    return motion[int((share > RANK).sum()) :].T


def _normalised(reading: np.ndarray, size: np.ndarray) -> np.ndarray:
    """Readings relative to each row's own length; rows that read no translation have less weight."""
    reading = reading / np.where(size > 0, size, 1)
    length = np.linalg.norm(reading, axis=1)
    silent = SILENT * length.max(initial=0.0)
    reads = length > silent
    translates = np.linalg.norm(reading[:, np.arange(reading.shape[1]) % 6 < 3], axis=1) > silent
    short = length[reads & ~translates].max(initial=0.0) / SHORT
    return reading / np.where(reads, np.where(translates, length, short), 1)[:, None]


def _strongest(reading: np.ndarray, count: int, least: float = RANK) -> np.ndarray:
    """At most `count` rows, each with the largest component independent of those before, until it is below `least`."""
    chosen: list[int] = []
    for _ in range(count):
        length = np.linalg.norm(reading, axis=1)
        if not length.max(initial=0.0) > least:
            break
        chosen.append(int(np.argmax(length >= (1 - EQUAL) * length.max())))
        direction = reading[chosen[-1]] / length[chosen[-1]]
        reading = reading - np.outer(reading @ direction, direction)
    return np.array(chosen, dtype=int)


def motion_size(G: tuple[np.ndarray, ...]) -> np.ndarray:
    """(6P,) root mean square reading of displacement functionals under each part's rigid motions.

    One number for a part's translations and one for its rotations, for :func:`statically_determinate`.
    """
    sizes = []
    for block in G:
        # Functionals of rotations, or of a nugget's first moments, read no translation.
        displacement = block[np.linalg.norm(block[:, :3], axis=1) > 0.5]
        motions = displacement.reshape(-1, 2, 3)
        sizes.append(np.repeat(np.sqrt((motions**2).sum(axis=(0, 2)) / max(1, motions[:, 0].size)), 3))
    return np.concatenate(sizes)
