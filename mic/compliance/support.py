"""Which rows hold a body: a statically determinate choice among those that read its rigid-body motions."""

from __future__ import annotations

import numpy as np

from mic.errors import FreeMotion

__all__ = ["completing", "independent", "motion_size", "statically_determinate"]

EQUAL = 1e-7  # rows that read as much to within this share read alike

RANK = 1e-6  # of a row's own reading: what is left of it once others hold is none

SILENT = 1e-9  # of the largest reading: what reads less of all motions, as strain does, reads rounding

#: What the strongest row that reads no translation counts beside one that does. Rotations, and first moments of a
#: nugget, hold a part by a lever of a few mm, and those that read strain by next to nothing: supported on them it
#: yields so much that what other rows leave is lost in rounding.
SHORT = 0.1


def statically_determinate(reading: np.ndarray, size: np.ndarray) -> np.ndarray:
    """Choose as many rows as there are rigid motions, so that they hold them best.

    Row by row the one that reads most of what those chosen leave free, as QR with pivoting does; the first of several
    that read as much. Rows that read no translation come last. The choice does not depend on how the scene is turned,
    nor on its units.

    Parameters
    ----------
    reading : (b, r) array
        What each row reads of each of the r rigid motions, ``rows @ G``: of each part three translations, then three
        rotations.
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
    reading = _of_one_length(reading, size)
    rank = np.linalg.matrix_rank(reading, tol=RANK) if b else 0
    if rank < r:
        raise FreeMotion(np.linalg.svd(reading, full_matrices=True)[2][rank:].T if b else np.eye(r))
    return np.sort(_strongest(reading, r, 0.0))


def completing(held: np.ndarray, offered: np.ndarray, size: np.ndarray) -> np.ndarray:
    """Choose, of rows that are offered, as many as others leave motions free, so that they hold these best.

    Parameters
    ----------
    held : (b, r) array
        What the rows read that hold already.
    offered : (o, r) array
    size : (r,) array
        As :func:`statically_determinate` wants it.

    Returns
    -------
    int array
        Chosen rows of `offered`, ascending; none where nothing is free.

    Raises
    ------
    FreeMotion
        If all of them together leave a motion free.
    """
    free = _unread(_of_one_length(held, size))
    reading = _of_one_length(offered, size) @ free
    chosen = _strongest(reading, free.shape[1])
    if len(chosen) < free.shape[1]:
        raise FreeMotion(free @ _unread(reading))
    return np.sort(chosen)


def independent(offered: np.ndarray, size: np.ndarray) -> np.ndarray:
    """Rows that hold all that `offered` (o, r) hold, as few as do, ascending."""
    return np.sort(_strongest(_of_one_length(offered, size), offered.shape[1]))


def _unread(reading: np.ndarray) -> np.ndarray:
    """(r, k) motions that rows (b, r) read nothing of."""
    if not len(reading):
        return np.eye(reading.shape[1])
    _, share, motion = np.linalg.svd(reading, full_matrices=True)
    return motion[int((share > RANK).sum()) :].T


def _of_one_length(reading: np.ndarray, size: np.ndarray) -> np.ndarray:
    """Readings as shares of each row's own; those that read no translation count less."""
    reading = reading / np.where(size > 0, size, 1)
    length = np.linalg.norm(reading, axis=1)
    silent = SILENT * length.max(initial=0.0)
    heard = length > silent
    moved = np.linalg.norm(reading[:, np.arange(reading.shape[1]) % 6 < 3], axis=1) > silent
    short = length[heard & ~moved].max(initial=0.0) / SHORT
    return reading / np.where(heard, np.where(moved, length, short), 1)[:, None]


def _strongest(reading: np.ndarray, count: int, least: float = RANK) -> np.ndarray:
    """At most `count` rows, one by one that of which those before leave most; fewer where they leave no more than
    `least`."""
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
    """(6P,) root mean square of what displacement functionals read of each part's rigid motions, for
    :func:`statically_determinate`: one number for its translations, one for its rotations."""
    sizes = []
    for block in G:
        # A functional of rotations, or of a nugget's first moments, reads no translation.
        displacement = block[np.linalg.norm(block[:, :3], axis=1) > 0.5]
        motions = displacement.reshape(-1, 2, 3)
        sizes.append(np.repeat(np.sqrt((motions**2).sum(axis=(0, 2)) / max(1, motions[:, 0].size)), 3))
    return np.concatenate(sizes)
