"""Sample the deviations of a scene: one independent random stream per sample, or per group of samples of a design.

Independent samples use counter-based streams, so that a sample depends only on the seed and its number. Latin
hypercubes and the scrambling of Sobol sequences are computed here: the random numbers that ``scipy.stats.qmc`` takes
from a stream depend on its release.
"""

from __future__ import annotations

import numpy as np
from scipy.special import ndtr, ndtri

from mic.scene.distribution import quantile
from mic.scene.samples import DESIGNS

__all__ = ["at_probabilities", "draw", "from_random_numbers", "number_count", "number_keys", "population"]

EDGE = 1e-16  # distance of probabilities from 0 and 1
BITS = 30  # of a coordinate of a Sobol sequence
GROUPS = 1  # counter word that separates streams of groups from those of samples
POPULATION = 2  # and of the population


def draw(scene, seed: int, first: int, count: int) -> np.ndarray:
    """Deviations of samples ``first … first + count - 1``: those that the scene gives, or drawn ones.

    Each sample has its own counter-based stream, keyed by the seed and the sample's number, so its values do not
    depend on batches or order. Deviations with scores take those of one measured piece, the same for a whole batch. A
    design that makes samples in groups has one stream per group, keyed by the seed and the group's number.

    Parameters
    ----------
    scene : mic.scene.Scene
    seed : int
    first, count : int

    Returns
    -------
    (count, p) array
        In the units of the scene's deviations; fewer rows if the scene gives fewer samples.
    """
    if scene.monte_carlo.values is not None:
        return np.array(scene.monte_carlo.values[first : first + count]).reshape(-1, len(scene.deviations))
    pieces = _pieces(scene)
    p = len(scene.deviations)
    if scene.monte_carlo.design != "independent":
        u = _design_probabilities(scene.monte_carlo.design, seed, first, count, number_count(scene))
        return at_probabilities(scene, u)
    normal, uniform, piece = np.empty((count, p)), np.empty((count, p)), np.empty((count, len(pieces)), dtype=int)
    lengths = [scores.shape[1] for _, scores in pieces]
    for i in range(count):
        stream = np.random.Generator(np.random.Philox(key=np.array([seed, first + i], dtype=np.uint64)))
        normal[i], uniform[i] = stream.standard_normal(p), stream.uniform(-np.sqrt(3), np.sqrt(3), p)
        piece[i] = [stream.integers(length) for length in lengths]
    return from_random_numbers(scene, normal, uniform, piece)


def population(scene, seed: int, sets: int, points: int) -> np.ndarray:
    """(sets, points, p) deviations: independent scrambled Sobol sequences, for averages of functions that cost little.

    Parameters
    ----------
    scene : mic.scene.Scene
    seed : int
    sets, points : int
        Number of sequences, and their length, a power of 2.
    """
    values = np.empty((sets, points, len(scene.deviations)))
    for i in range(sets):
        key, counter = np.array([seed, i], dtype=np.uint64), [0, 0, 0, POPULATION]
        stream = np.random.Generator(np.random.Philox(key=key, counter=counter))
        values[i] = at_probabilities(scene, _sobol(stream, number_count(scene), points))
    return values


def number_keys(scene) -> list[tuple[str, str]]:
    """Purpose of each random number of a sample: ``("deviation", name)``, then ``("batch", name)`` of pieces."""
    return [*(("deviation", item.name) for item in scene.deviations), *(("batch", name) for name in _batches(scene))]


def number_count(scene) -> int:
    """Number of independent random numbers per sample: one for each deviation and each batch of pieces."""
    return len(number_keys(scene))


def at_probabilities(scene, u: np.ndarray) -> np.ndarray:
    """Deviations (n, p) from independent probabilities (inverse transform).

    Parameters
    ----------
    scene : mic.scene.Scene
    u : (n, d) array
        Between 0 and 1; d is :func:`number_count`.
    """
    p = len(scene.deviations)
    u = np.clip(u, EDGE, 1 - EDGE)
    lengths = [scores.shape[1] for _, scores in _pieces(scene)]
    piece = np.minimum(u[:, p:] * lengths, np.array(lengths) - 1).astype(int)
    return from_random_numbers(scene, ndtri(u[:, :p]), np.sqrt(3) * (2 * u[:, :p] - 1), piece)


def from_random_numbers(scene, normal: np.ndarray, uniform: np.ndarray, piece: np.ndarray) -> np.ndarray:
    """Deviations (n, p) from random numbers.

    Parameters
    ----------
    scene : mic.scene.Scene
    normal, uniform : (n, p) array
        Standard normal numbers, and uniform ones on -√3 … √3; each distribution uses one of them. `normal` is
        correlated in place.
    piece : (n, b) int array
        Index of the measured piece of each batch.
    """
    pieces = _pieces(scene)
    correlated = _correlate(scene, normal)
    values = np.empty(normal.shape)
    for j, item in enumerate(scene.deviations):
        whole = item.truncated is None
        if whole and item.distribution == "normal":
            values[:, j] = item.mean + item.sigma * normal[:, j]
        elif whole and item.distribution == "uniform" and j not in correlated:
            values[:, j] = item.mean + item.sigma * uniform[:, j]
        else:
            values[:, j] = quantile(item, ndtr(normal[:, j]))
    for k, (indices, scores) in enumerate(pieces):
        for j, score in zip(indices, scores):
            values[:, j] = scene.deviations[j].mean + scene.deviations[j].sigma * score[piece[:, k]]
    return values


def _design_probabilities(design: str, seed: int, first: int, count: int, d: int) -> np.ndarray:
    """(count, d) probabilities of samples of a design."""
    size, groups = DESIGNS[design], []
    for group in range(first // size, -(-(first + count) // size)):
        key, counter = np.array([seed, group], dtype=np.uint64), [0, 0, 0, GROUPS]
        stream = np.random.Generator(np.random.Philox(key=key, counter=counter))
        if design == "antithetic":
            u = stream.random((1, d))
            points = np.concatenate([u, 1 - u])
        elif design == "sobol":
            points = _sobol(stream, d, size)
        elif design == "latin-hypercube":
            points = _latin_hypercube(stream, d, size)
        else:
            raise NotImplementedError(f"sampling design {design!r}")
        groups.append(points)
    start = first % size
    return np.concatenate([np.empty((0, d)), *groups])[start : start + count]


def _latin_hypercube(stream: np.random.Generator, d: int, size: int) -> np.ndarray:
    """(size, d) points: one in each of `size` layers of each of the d coordinates."""
    within = stream.uniform(size=(size, d))
    layers = np.tile(np.arange(1, size + 1), (d, 1))
    for row in layers:
        stream.shuffle(row)
    return (layers.T - within) / size


def _sobol(stream: np.random.Generator, d: int, size: int) -> np.ndarray:
    """(size, d) first points of a Sobol sequence with Matoušek's scrambling: a random linear map of the bits, and a
    random shift."""
    if not d:
        return np.empty((size, 0))
    from scipy.stats import qmc  # slow to import, needed for this design only

    shift = stream.integers(2, size=(d, BITS), dtype=np.uint32) @ 2 ** np.arange(BITS)
    lower = np.tril(stream.integers(2, size=(d, BITS, BITS), dtype=np.uint32), -1)
    place = np.arange(BITS)[::-1]
    points = (2**BITS * qmc.Sobol(d, scramble=False).random(size)).astype(np.int64)
    scrambled = np.empty((size, d), dtype=np.int64)
    for i in range(d):
        bits = (points[:, i, None] >> place & 1).astype(float)  # the most significant bit first
        sums = bits @ (lower[i] + np.eye(BITS)).T  # small integers: exact
        scrambled[:, i] = (sums % 2 @ 2.0**place).astype(np.int64)
    return (scrambled ^ shift) / 2**BITS


def _correlate(scene, normal: np.ndarray) -> set[int]:
    """Correlate standard normals (n, p) in place; returns the indices of the correlated deviations.

    ``z = L ε`` is summed term by term: a sample's bits do not depend on the other samples.
    """
    names, correlated = [item.name for item in scene.deviations], set()
    for table in scene.correlations:
        indices = [names.index(name) for name in table.deviations]
        independent = normal[:, indices].copy()
        for j, row in zip(indices, table.factor):
            normal[:, j] = sum(share * column for share, column in zip(row, independent.T))
        correlated |= {*indices}
    return correlated


def _pieces(scene) -> list[tuple[list[int], np.ndarray]]:
    """For each batch of n measured pieces, the indices of its k deviations and their scores (k, n)."""
    return [(indices, np.array([scene.deviations[j].scores for j in indices])) for indices in _batches(scene).values()]


def _batches(scene) -> dict[str, list[int]]:
    """Indices of the deviations of each batch of measured pieces."""
    batches: dict[str, list[int]] = {}
    for j, item in enumerate(scene.deviations):
        if getattr(item, "scores", None) is not None:
            batches.setdefault(item.batch or item.name, []).append(j)
    return batches
