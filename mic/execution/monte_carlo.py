"""The Monte Carlo: samples drawn and taken through the process in blocks, the blocks shared out over processes.

Under MPI they are shared out over its processes, else with a copy of this one where there is a core for it: what is
between the kernels, tables and files, would else wait for one core. Where an evaluated block goes is not known here: it
is handed over before the next begins.
"""

from __future__ import annotations

import os
import time
from collections.abc import Callable, Sequence
from functools import partial
from typing import TypeVar

import numpy as np

from mic.execution.ranks import communicator, on_first, wait
from mic.execution.worker_process import Copy, second_core
from mic.process.evaluation import Evaluation
from mic.statistics.draw import draw

__all__ = ["BLOCK", "ROOM", "SIZES", "blocks", "monte_carlo"]

T = TypeVar("T")
BLOCK = 50  # samples in each of the first blocks
SIZES = (BLOCK, 100, 250, 500, 1000, 2500, 5000)
SHARE = 20  # a block is at most this part of what stands before it: little is lost, and processes finish together
CROWD = 1000  # contact pairs from which on a sample takes so long that few of them make a block
FEW = 5
WORTH = 4  # blocks from which on a copy of the process is made
SIGN = 10.0  # s: where samples take long, one is told of them about so often
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
        size = max((size for size in SIZES if size <= most), default=BLOCK if pairs <= CROWD else FEW)
        found.append((first, min(size, samples - first)))
        first += size
    return [(law, *block) for law in laws for block in found]


def monte_carlo(
    model,
    laws: Sequence[str],
    samples: int,
    seed: int,
    sink: Callable[[str, int, Evaluation], T],
    done: Callable[[str, int, int], bool] | None = None,
    advance: Callable[[str, int], None] | None = None,
    expect: Callable[[float], None] | None = None,
    take: Callable[[str, int, int, T], None] | None = None,
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
        all, as it advances itself. Where samples take long, for those of its own block as they are done.
    expect : callable, optional
        Called once by the first process with the seconds that all will take, as its first samples let expect.
    take : callable, optional
        Called with (law, number of the first sample, number of samples, what `sink` returned) for each block that this
        process has evaluated or a copy of it, which is made only where one takes so; `sink` returns what can be
        pickled, and is called in the copy then.

    Returns
    -------
    dict of str to int
        Samples per law that were not evaluated since they were done.
    """
    world = communicator()
    rank, size = (world.rank, world.size) if world else (0, 1)
    every = blocks(laws, samples, len(model.contacts))
    missing = on_first(world, lambda: [block for block in every if done is None or not done(*block)])
    not_done, left = set(missing), sum(count for _, _, count in missing)
    reused = dict.fromkeys(laws, 0)
    for law, first, count in every:
        if (law, first, count) not in not_done:
            reused[law] += count
            if advance is not None:
                advance(law, count)
    cores = len(os.sched_getaffinity(0))
    worth = take is not None and len(missing) >= WORTH and len(model.contacts) <= CROWD
    copied = worth and world is None and second_core()
    share = 2 if copied else size  # of what is left, and of the cores
    threads = max(1, cores // share)
    processes = {law: model.process(law, backend=model.scene.monte_carlo.backend, threads=threads) for law in laws}

    def evaluated(pace: _Pace, law: str, first: int, count: int) -> tuple[T, int]:
        evaluation, told = pace.evaluate(law, processes[law].attempt, draw(model.scene, seed, first, count))
        return sink(law, first, evaluation), told

    pace = _Pace(advance, (lambda each: expect(each * left / share)) if expect is not None and rank == 0 else None)
    if copied:
        silent = _Pace(None)  # of the copy, whose words nobody hears
        with Copy([partial(evaluated, silent, *block) for block in missing]) as copy:
            for number, (found, told) in copy.each([partial(evaluated, pace, *block) for block in missing]):
                law, first, count = missing[number]
                if take is not None:
                    take(law, first, count, found)
                if advance is not None:
                    advance(law, count - told)
        return reused
    for i in range(0, len(missing), size):
        together = missing[i : i + size]  # what the processes evaluate side by side
        told = 0
        if rank < len(together):
            found, told = evaluated(pace, *together[rank])
            if take is not None:
                take(*together[rank], found)
        if advance is not None:
            for number, (law, _, count) in enumerate(together):
                advance(law, count - told if number == rank else count)
    wait(world)
    return reused


class _Pace:
    """Evaluates the samples of a block together, or where each takes long in pieces, so that one is told of them; a
    sample is the same in whatever piece it comes.

    Parameters
    ----------
    advance : callable, optional
        As :func:`monte_carlo` takes it.
    expect : callable, optional
        Called once with the seconds that a sample takes: not the first one, which loads and compiles.
    """

    def __init__(
        self, advance: Callable[[str, int], None] | None, expect: Callable[[float], None] | None = None
    ) -> None:
        self._advance = advance or (lambda law, count: None)
        self._expect = expect
        self._each: dict[str, float] = {}  # by law, s a sample

    def evaluate(
        self, law: str, attempt: Callable[[np.ndarray], Evaluation], deviations: np.ndarray
    ) -> tuple[Evaluation, int]:
        """The samples of a block, and of how many one was told."""
        pieces: list[Evaluation] = []
        done = told = 0
        start = time.perf_counter()
        while done < len(deviations):
            each = self._each.get(law)
            count = 1 if each is None else max(1, int(min(len(deviations), SIGN / max(each, 1e-9))))
            begun = time.perf_counter()
            pieces.append(attempt(deviations[done : done + count]))
            now, size = time.perf_counter(), len(pieces[-1].deviations)
            self._each[law] = (now - begun) / size
            done += size
            if self._expect is not None and done > 1:
                self._expect(self._each[law])
                self._expect = None
            if now - start > SIGN and done < len(deviations):
                self._advance(law, done - told)
                told, start = done, now
        return (pieces[0] if len(pieces) == 1 else Evaluation.join(pieces)), told
