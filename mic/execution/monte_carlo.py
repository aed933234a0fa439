"""The Monte Carlo loop: samples are drawn and evaluated in blocks, and the blocks are distributed over processes.

Under MPI the blocks are distributed over the ranks, else over this process and a forked worker if a second core is
free. Each evaluated block is handed to a callback before the next one begins.
"""

from __future__ import annotations

import time
from collections.abc import Callable, Sequence
from functools import partial
from typing import Any, TypeVar

import numpy as np

from mic.execution.ranks import communicator, on_first, wait
from mic.execution.worker_process import WorkerProcess, has_spare_core
from mic.process.evaluation import Evaluation
from mic.statistics.draw import draw
from mic.system.cores import available_cores

__all__ = ["BLOCK", "MAX_ENTRIES", "SIZES", "blocks", "monte_carlo"]

T = TypeVar("T")
Block = tuple[str, int, int]  # law, number of the first sample, number of samples
BLOCK = 50  # samples in each of the first blocks
SIZES = (BLOCK, 100, 250, 500, 1000, 2500, 5000)
SHARE = 20  # a block is at most 1/20 of the samples before it, so that an interrupt loses little
MANY_PAIRS = 1000  # contact pairs above which a sample takes so long that blocks are small
SMALL_BLOCK = 5
MIN_BLOCKS = 4  # blocks that justify a worker process
REPORT_INTERVAL = 10.0  # s between progress reports within a block
MAX_ENTRIES = 200_000  # samples × contact pairs in a block: some hundred megabytes while it is evaluated or read


def blocks(laws: Sequence[str], samples: int, pairs: int) -> list[Block]:
    """(law, first, count) of every block, in the order of evaluation.

    Blocks grow from :data:`BLOCK` samples to thousands: short runs are reported and saved often, long ones produce few
    files. The start of a block does not depend on the number of samples, so that a longer run reuses a shorter one.

    Parameters
    ----------
    laws : sequence of str
    samples : int
    pairs : int
        Contact pairs of the model.
    """
    ranges, first = [], 0
    while first < samples:
        limit = min(first // SHARE, MAX_ENTRIES // max(pairs, 1))
        size = max((size for size in SIZES if size <= limit), default=BLOCK if pairs <= MANY_PAIRS else SMALL_BLOCK)
        ranges.append((first, min(size, samples - first)))
        first += size
    return [(law, *block) for law in laws for block in ranges]


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
    """Evaluate all samples under all laws; under MPI a collective call that distributes the blocks.

    Parameters
    ----------
    model : mic.process.model.ReducedModel
    laws : sequence of str
    samples, seed : int
    sink : callable
        Called with (law, number of the first sample, evaluation) for each block, by the process that evaluated it.
    done : callable, optional
        Called with (law, number of the first sample, number of samples): whether to skip the block. Only the first
        rank calls it, before any block is evaluated, so that all ranks agree.
    advance : callable, optional
        Progress: called with (law, number of samples) for each finished block, under MPI on each rank for the blocks
        of all. Slow samples are reported while their block is evaluated.
    expect : callable, optional
        Called once, on the first rank, with the estimated duration of the whole evaluation in seconds.
    take : callable, optional
        Called with (law, number of the first sample, number of samples, result of `sink`) for each block of this
        process and of its worker process. A worker is used only if `take` is given; it calls `sink` itself, whose
        result must then be picklable.

    Returns
    -------
    dict of str to int
        Number of skipped samples per law.
    """
    world, pairs, cores = communicator(), len(model.contacts), available_cores()
    every = blocks(laws, samples, pairs)
    missing = on_first(world, lambda: [block for block in every if done is None or not done(*block)])
    advance, reused, skipped = advance or _ignore, dict.fromkeys(laws, 0), set(every).difference(missing)
    for law, _, count in (block for block in every if block in skipped):
        reused[law] += count
        advance(law, count)
    worker = take is not None and world is None and len(missing) >= MIN_BLOCKS and pairs <= MANY_PAIRS
    worker = worker and has_spare_core()
    share = 2 if worker else world.size if world else 1  # processes that share samples and cores
    threads = max(1, cores // share)
    processes = {law: model.process(law, backend=model.scene.monte_carlo.backend, threads=threads) for law in laws}
    remaining = sum(count for _, _, count in missing)

    def evaluate(timed: _TimedEvaluation, law: str, first: int, count: int) -> tuple[T, int]:
        evaluation, reported = timed.evaluate(law, processes[law].attempt, draw(model.scene, seed, first, count))
        return sink(law, first, evaluation), reported

    timed = _TimedEvaluation(advance, remaining / share, None if world and world.rank else expect)
    (_with_worker if worker else _over_ranks)(world, missing, evaluate, timed, advance, take or _ignore)
    return reused


def _ignore(*_: Any) -> None:
    """Do nothing, in place of a callback that the caller did not give."""


def _with_worker(_world, missing: list[Block], evaluate, timed: _TimedEvaluation, advance, take) -> None:
    """Evaluate blocks in this process and a forked worker, whose progress is not reported within a block."""
    in_worker = [partial(evaluate, _TimedEvaluation(_ignore), *block) for block in missing]
    with WorkerProcess(in_worker) as worker:
        for number, (result, reported) in worker.completed([partial(evaluate, timed, *block) for block in missing]):
            law, first, count = missing[number]
            take(law, first, count, result)
            advance(law, count - reported)


def _over_ranks(world, missing: list[Block], evaluate, timed: _TimedEvaluation, advance, take) -> None:
    """Evaluate blocks on all MPI ranks, one block per rank at a time."""
    rank, size = (world.rank, world.size) if world else (0, 1)
    for i in range(0, len(missing), size):
        concurrent = missing[i : i + size]
        reported = 0
        if rank < len(concurrent):
            result, reported = evaluate(timed, *concurrent[rank])
            take(*concurrent[rank], result)
        for number, (law, _, count) in enumerate(concurrent):
            advance(law, count - reported if number == rank else count)
    wait(world)


class _TimedEvaluation:
    """Evaluates the samples of a block together, or slow ones in pieces, with a progress report after each piece.

    Parameters
    ----------
    advance : callable
        As :func:`monte_carlo` takes it.
    samples : float
        Number of samples of this process.
    expect : callable, optional
        Called once with the duration of all `samples`, estimated after the first one, which loads and compiles code.
    """

    def __init__(
        self, advance: Callable[[str, int], Any], samples: float = 0.0, expect: Callable[[float], None] | None = None
    ) -> None:
        self._advance, self._samples, self._expect = advance, samples, expect
        self._seconds: dict[str, float] = {}  # per sample, by law

    def evaluate(
        self, law: str, attempt: Callable[[np.ndarray], Evaluation], deviations: np.ndarray
    ) -> tuple[Evaluation, int]:
        """The evaluation of a block, and the number of its samples that were reported already."""
        pieces: list[Evaluation] = []
        finished = reported = 0
        last_report = time.perf_counter()
        while finished < len(deviations):
            seconds = self._seconds.get(law)
            count = 1 if seconds is None else max(1, int(min(len(deviations), REPORT_INTERVAL / max(seconds, 1e-9))))
            start = time.perf_counter()
            pieces.append(attempt(deviations[finished : finished + count]))
            now, size = time.perf_counter(), len(pieces[-1].deviations)
            self._seconds[law] = (now - start) / size
            finished += size
            if self._expect is not None and finished > 1:
                self._expect(self._seconds[law] * self._samples)
                self._expect = None
            if now - last_report > REPORT_INTERVAL and finished < len(deviations):
                self._advance(law, finished - reported)
                reported, last_report = finished, now
        return (pieces[0] if len(pieces) == 1 else Evaluation.join(pieces)), reported
