"""Tasks distributed over MPI ranks: each takes every p-th task, and sends its results to rank 0."""

from __future__ import annotations

import math
import time
from collections.abc import Callable, Generator, Sequence
from typing import Any, TypeVar

from mic.errors import RunError
from mic.execution.ranks import wait

__all__ = ["Mpi"]

Task = TypeVar("Task")
Result = TypeVar("Result")
TAG = 4350  # of the messages with results
PAUSE = 0.005  # s between two looks for a message; a waiting MPI call would use its core


class Mpi:
    """The engine of MPI ranks, see :class:`mic.execution.engine.Engine`; all of its calls are collective.

    Parameters
    ----------
    world : mpi4py.MPI.Comm
    """

    def __init__(self, world: Any) -> None:
        self._world, self.workers = world, world.size

    def completed(
        self, work: Callable[[Task], Result], tasks: Sequence[Task], seconds: float = math.inf
    ) -> Generator[tuple[int, Result], None, None]:
        """See :meth:`mic.execution.engine.Engine.completed`."""
        world = self._world
        own = range(world.rank, len(tasks), world.size)
        if world.rank > 0:
            sent: list[Any] = []
            for number in own:
                sent = [request for request in sent if not request.Test()]
                sent.append(world.isend((number, work(tasks[number])), 0, TAG))
            while sent:
                sent = [request for request in sent if not request.Test()]
                time.sleep(PAUSE)
        else:
            others = len(tasks) - len(own)
            for number in own:
                yield number, work(tasks[number])
                while world.iprobe(tag=TAG):
                    others -= 1
                    yield world.recv(tag=TAG)
            while others:
                if world.iprobe(tag=TAG):
                    others -= 1
                    yield world.recv(tag=TAG)
                else:
                    time.sleep(PAUSE)
        wait(world)  # so that no rank sends results of other tasks before

    def standing(self, work: Callable[[Task], Result]) -> list[Any]:
        """See :meth:`mic.execution.engine.Engine.standing`.

        Raises
        ------
        RunError
            Always: ranks do the same tasks of the same list.
        """
        raise RunError("engine mpi: a service has no list of tasks to share; start it without mpirun")
