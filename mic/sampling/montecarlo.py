"""The Monte Carlo: samples drawn and taken through the process in blocks, the blocks shared out over processes.

Where an evaluated block goes is not known here: it is handed over before the next begins.
"""

from __future__ import annotations

import os
from collections.abc import Callable, Sequence

from mic.process.evaluation import Evaluation
from mic.sampling.draw import draw
from mic.sampling.ranks import communicator, on_first, wait

__all__ = ["BLOCK", "ROOM", "SIZES", "blocks", "monte_carlo"]

BLOCK = 50  # samples in each of the first blocks
SIZES = (BLOCK, 100, 250, 500, 1000, 2500, 5000)
SHARE = 20  # a block is at most this part of what stands before it: little is lost, and processes finish together
ROOM = 200_000  # samples × contact pairs that a block may hold: some hundred megabytes while it is evaluated or read


def blocks(laws: Sequence[str], samples: int, pairs: int) -> list[tuple[str, int, int]]:
    """(law, first, count) of every block, in the order in which they are evaluated.

    Blocks grow with their place, from :data:`BLOCK` samples to thousands: short runs are shown and saved often, long
    ones leave few files. Where a block begins does not depend on the number of samples, so that a run with more of
    them uses what a shorter one left.

    Parameters
    ----------
    laws : sequence of str
    samples : int
    pairs : int
        Contact pairs of the model.
    """
    found, first = [], 0
    while first < samples:
        most = min(first // SHARE, ROOM // max(pairs, 1))
        size = max((size for size in SIZES if size <= most), default=BLOCK)
        found.append((first, min(size, samples - first)))
        first += size
    return [(law, *block) for law in laws for block in found]


def monte_carlo(
    model,
    laws: Sequence[str],
    samples: int,
    seed: int,
    sink: Callable[[str, int, Evaluation], None],
    done: Callable[[str, int, int], bool] | None = None,
    advance: Callable[[str, int], None] | None = None,
) -> dict[str, int]:
    """Evaluate all samples under all laws; under MPI a collective call that shares the blocks out.

    Parameters
    ----------
    model : mic.process.model.ReducedModel
    laws : sequence of str
    samples, seed : int
    sink : callable
        Called with (law, number of the first sample, evaluation) for each block, by the process that evaluated it.
    done : callable, optional
        Called with (law, number of the first sample, number of samples): whether the block need not be evaluated. The
        first process alone asks, before any block is evaluated: all share out the same blocks, and each has its share.
    advance : callable, optional
        Called with (law, number of samples) for each block that is done; under MPI on each process, for the blocks of
        all, as it advances itself.

    Returns
    -------
    dict of str to int
        Samples per law that were not evaluated since they were done.
    """
    world = communicator()
    rank, size = (world.rank, world.size) if world else (0, 1)
    every = blocks(laws, samples, len(model.contacts))
    missing = on_first(world, lambda: [block for block in every if done is None or not done(*block)])
    left = set(missing)
    reused = dict.fromkeys(laws, 0)
    for law, first, count in every:
        if (law, first, count) not in left:
            reused[law] += count
            if advance is not None:
                advance(law, count)
    threads = max(1, len(os.sched_getaffinity(0)) // size)
    processes = {law: model.process(law, backend=model.scene.monte_carlo.backend, threads=threads) for law in laws}
    for i in range(0, len(missing), size):
        together = missing[i : i + size]  # what the processes evaluate side by side
        if rank < len(together):
            law, first, count = together[rank]
            sink(law, first, processes[law].attempt(draw(model.scene, seed, first, count)))
        if advance is not None:
            for law, _, count in together:
                advance(law, count)
    wait(world)
    return reused
