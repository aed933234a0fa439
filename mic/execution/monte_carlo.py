"""The Monte Carlo loop: samples are drawn and evaluated in blocks, which an engine distributes over its workers.

A block is what is stored together, and does not depend on the number of workers. If there are fewer blocks than workers
could share, or samples are slow, blocks are evaluated in pieces.
"""

from __future__ import annotations

import math
import sys
import time
from collections.abc import Callable, Mapping, Sequence
from contextlib import closing
from dataclasses import dataclass, replace
from typing import Any, Generic, TypeVar, cast

from mic.execution.engine import Engine
from mic.execution.local import Local
from mic.execution.ranks import communicator, on_first
from mic.process.evaluation import Evaluation
from mic.process.model import ReducedModel
from mic.statistics.draw import draw

__all__ = ["BLOCK", "MAX_ENTRIES", "SIZES", "Piece", "blocks", "monte_carlo", "pieces"]

T = TypeVar("T")
Block = tuple[str, int, int]  # law, number of the first sample, number of samples
BLOCK = 50  # samples in each of the first blocks
MIN_BLOCK = 5
SIZES = (BLOCK, 100, 250, 500)
SHARE = 20  # a block is at most 1/20 of the samples before it, so that an interrupt loses little
MAX_FIRST_ENTRIES = 50_000  # samples × contact pairs in each of the first blocks: large models have slow samples
MAX_ENTRIES = 200_000  # in a block: some hundred megabytes while it is evaluated or read
PIECES = 4  # for each worker, at least, so that all end at about the same time
REPORT_INTERVAL = 10.0  # s that a piece takes at most, since progress is reported after each
JOIN = 0.003  # s in which this process takes and joins a piece; all workers together must not send them faster
MAX_JOINED = 100  # samples of a block that is divided for many workers: this process joins the pieces and writes it


@dataclass(frozen=True)
class Piece:
    """Samples that are evaluated together.

    Attributes
    ----------
    law : str
    first, count : int
        Number of the first sample, and number of samples.
    block : (str, int, int)
        The block that they belong to.
    """

    law: str
    first: int
    count: int
    block: Block

    @property
    def whole(self) -> bool:
        """Whether it is a whole block."""
        return (self.law, self.first, self.count) == self.block


def blocks(laws: Sequence[str], samples: int, pairs: int) -> list[Block]:
    """(law, first, count) of every block, in the order of evaluation.

    Blocks grow from :data:`BLOCK` samples to hundreds: short runs are reported and saved often, long ones produce few
    files. The start of a block depends neither on the number of samples nor on that of workers, so that a longer run
    reuses a shorter one.

    Parameters
    ----------
    laws : sequence of str
    samples : int
    pairs : int
        Contact pairs of the model.
    """
    ranges, first, pairs = [], 0, max(pairs, 1)
    smallest = max(MIN_BLOCK, min(BLOCK, MAX_FIRST_ENTRIES // pairs))
    while first < samples:
        limit = min(first // SHARE, MAX_ENTRIES // pairs)
        size = max((size for size in SIZES if size <= limit), default=smallest)
        ranges.append((first, min(size, samples - first)))
        first += size
    return [(law, *block) for law in laws for block in ranges]


def pieces(missing: Sequence[Block], workers: int, seconds: float = 0.0) -> list[Piece]:
    """The blocks, divided if there are fewer than :data:`PIECES` for each worker, or if their samples are slow.

    Parameters
    ----------
    missing : sequence of (str, int, int)
        As :func:`blocks` returns them.
    workers : int
    seconds : float
        Duration of a sample.
    """
    slow = max(1, math.floor(min(REPORT_INTERVAL / max(seconds, 1e-9), sys.maxsize)))
    few = workers > 1 and len(missing) < PIECES * workers
    worthwhile = math.ceil(JOIN * workers / max(seconds, 1e-9))
    share = max(worthwhile, sum(count for *_, count in missing) // (PIECES * workers))
    found = []
    for law, first, count in missing:
        parts = math.ceil(count / (min(slow, share) if few and count <= MAX_JOINED else slow))
        ends = [first + count * i // parts for i in range(parts + 1)]
        found += [Piece(law, a, b - a, (law, first, count)) for a, b in zip(ends, ends[1:])]
    return found


def monte_carlo(
    model: ReducedModel,
    laws: Sequence[str],
    samples: int,
    seed: int,
    sink: Callable[[str, int, Evaluation], T],
    done: Callable[[str, int, int], bool] | None = None,
    advance: Callable[[str, int], None] | None = None,
    expect: Callable[[float], None] | None = None,
    take: Callable[[str, int, int, T], None] | None = None,
    engine: Engine | None = None,
) -> dict[str, int]:
    """Evaluate all samples under all laws; under MPI a collective call.

    Parameters
    ----------
    model : mic.process.model.ReducedModel
    laws : sequence of str
    samples, seed : int
    sink : callable
        Called with (law, number of the first sample, evaluation) for each block, in any process of the engine. If the
        engine has several, it and its result must be picklable.
    done : callable, optional
        Called with (law, number of the first sample, number of samples): whether to skip the block. Only the first
        rank calls it, before any block is evaluated, so that all ranks agree.
    advance : callable, optional
        Progress: called with (law, number of samples) for finished samples, under MPI on the first rank.
    expect : callable, optional
        Called once, on the first rank, with the estimated duration of the whole evaluation in seconds.
    take : callable, optional
        Called with (law, number of the first sample, number of samples, result of `sink`) for each block, under MPI
        on the first rank.
    engine : Engine, optional
        Default: this process.

    Returns
    -------
    dict of str to int
        Number of skipped samples per law.
    """
    world, engine = communicator(), engine or Local(1)
    every = blocks(laws, samples, len(model.contacts))
    missing = on_first(world, lambda: [block for block in every if done is None or not done(*block)])
    advance, reused, skipped = advance or _ignore, dict.fromkeys(laws, 0), set(every).difference(missing)
    for law, _, count in (block for block in every if block in skipped):
        reused[law] += count
        advance(law, count)
    evaluate = _Evaluate(model, seed, sink)
    if not missing:
        return reused
    # One process compiles what is not in Numba's cache, and loads it before workers are forked.
    begun, seconds = on_first(world, lambda: evaluate.first_samples(missing))
    planned = _without(pieces(missing, engine.workers, seconds), begun)
    joining: dict[Block, dict[int, Evaluation]] = {}

    def join(block: Block, first: int, evaluation: Evaluation) -> None:
        """Add a piece to its block, which is finished with its last piece."""
        parts = joining.setdefault(block, {})
        parts[first] = evaluation
        if sum(len(part.deviations) for part in parts.values()) == block[2]:
            whole = Evaluation.join([part for _, part in sorted(joining.pop(block).items())])
            (take or _ignore)(*block, sink(*block[:2], whole))

    expected = seconds * sum(piece.count for piece in planned)
    if world is None or world.rank == 0:
        (expect or _ignore)(expected / engine.workers)
        for block, evaluation in begun.items():
            join(block, block[1], evaluation)
            advance(block[0], len(evaluation.deviations))
    with closing(engine.completed(evaluate, planned, expected)) as completed:
        for number, result in completed:
            piece = planned[number]
            if piece.whole:
                (take or _ignore)(*piece.block, cast(T, result))
            else:
                join(piece.block, piece.first, cast(Evaluation, result))
            advance(piece.law, piece.count)
    return reused


def _ignore(*_: Any) -> None:
    """Do nothing, in place of a callback that the caller did not give."""


def _without(planned: Sequence[Piece], begun: Mapping[Block, Evaluation]) -> list[Piece]:
    """The pieces without the samples with which some blocks are begun."""
    found = []
    for piece in planned:
        evaluated = len(begun[piece.block].deviations) if piece.block in begun else 0
        first, end = max(piece.first, piece.block[1] + evaluated), piece.first + piece.count
        if first < end:
            found.append(replace(piece, first=first, count=end - first))
    return found


class _Evaluate(Generic[T]):
    """Evaluates pieces in any process: returns what `sink` makes of a whole block, else the evaluation.

    Parameters
    ----------
    model, seed, sink
        As :func:`monte_carlo` takes them.
    """

    def __init__(self, model: ReducedModel, seed: int, sink: Callable[[str, int, Evaluation], T]) -> None:
        self._model, self._seed, self._sink = model, seed, sink

    def __call__(self, piece: Piece) -> T | Evaluation:
        evaluation = self._evaluation(piece.law, piece.first, piece.count)
        return self._sink(piece.law, piece.first, evaluation) if piece.whole else evaluation

    def first_samples(self, missing: Sequence[Block]) -> tuple[dict[Block, Evaluation], float]:
        """Evaluations of the first sample of each law and one more, by block, and the duration of that one, s.

        The first sample under each law loads or compiles code; so it is not timed if there is another.
        """
        begun: dict[Block, Evaluation] = {}
        start = time.perf_counter()
        for law in dict.fromkeys(block[0] for block in missing):
            block = next(block for block in missing if block[0] == law)
            begun[block] = self._evaluation(law, block[1], 1)
        law, first, count = missing[0]
        if count > 1:
            start = time.perf_counter()
            begun[missing[0]] = Evaluation.join([begun[missing[0]], self._evaluation(law, first + 1, 1)])
        return begun, time.perf_counter() - start

    def _evaluation(self, law: str, first: int, count: int) -> Evaluation:
        process = self._model.process(law, backend=self._model.scene.monte_carlo.backend)
        return process.attempt(draw(self._model.scene, self._seed, first, count))
