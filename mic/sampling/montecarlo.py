"""The Monte Carlo: samples drawn and taken through the process in blocks, the blocks shared out over processes.

Where an evaluated block goes is not known here: it is handed over before the next begins.
"""

from __future__ import annotations

import os
from collections.abc import Callable, Sequence

import numpy as np
from threadpoolctl import threadpool_limits

from mic.process.evaluation import Evaluation
from mic.sampling.draw import draw
from mic.sampling.ranks import communicator, on_first, wait

__all__ = ["BLOCK", "blocks", "monte_carlo"]

BLOCK = 50


def blocks(laws: Sequence[str], samples: int) -> list[tuple[str, int, int]]:
    """(law, first, count) of every block, in the order in which they are evaluated."""
    return [(law, first, min(BLOCK, samples - first)) for law in laws for first in range(0, samples, BLOCK)]


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
    every = blocks(laws, samples)
    missing = on_first(world, lambda: [block for block in every if done is None or not done(*block)])
    left = set(missing)
    reused = dict.fromkeys(laws, 0)
    for law, first, count in every:
        if (law, first, count) not in left:
            reused[law] += count
            if advance is not None:
                advance(law, count)
    threads = max(1, len(os.sched_getaffinity(0)) // size)
    # A fixed number of BLAS threads keeps results the same from run to run, and small products fast.
    with threadpool_limits(limits=1, user_api="blas"):
        processes = {law: model.process(law, backend=model.scene.monte_carlo.backend, threads=threads) for law in laws}
        for i in range(0, len(missing), size):
            together = missing[i : i + size]  # what the processes evaluate side by side
            if rank < len(together):
                law, first, count = together[rank]
                sink(law, first, _evaluate(processes[law], draw(model.scene, seed, first, count)))
            if advance is not None:
                for law, _, count in together:
                    advance(law, count)
    wait(world)
    return reused


def _evaluate(process, deviations: np.ndarray) -> Evaluation:
    """A block; should it break, sample by sample, so that only the samples at fault are lost."""
    try:
        return process.evaluate(deviations)
    except (ArithmeticError, np.linalg.LinAlgError) as error:
        if len(deviations) == 1:
            return process.blank(deviations, str(error))
        return Evaluation.join([_evaluate(process, row[None]) for row in deviations])
