"""A forked worker process that shares tasks (blocks of samples, pictures) with this process.

Not ``concurrent.futures``: tasks are closures, which cannot be pickled; this process works too; a worker that dies or
hangs costs no result; and it is killed at once at the end.
"""

from __future__ import annotations

import ctypes
import os
import pickle
import signal
import sys
import time
import warnings
from collections import deque
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import Future
from contextlib import suppress
from multiprocessing import get_context
from multiprocessing.connection import Connection
from threading import Lock, Thread
from typing import Any, Generic, Self, TypeVar

from mic.execution.ranks import LaunchError, communicator
from mic.system.cores import available_cores
from mic.system.matrix_product import one_thread

__all__ = ["WorkerProcess", "has_spare_core", "run_on_two_cores"]

T = TypeVar("T")
TIMEOUT = 120.0  # s that this process waits for a result of the worker before it does the task itself
SLOWDOWN = 10.0  # added to the timeout, in multiples of the longest task of this process
PR_SET_PDEATHSIG = 1  # from Linux prctl.h


class WorkerProcess(Generic[T]):
    """A fork of this process that works on tasks, from the first on, in the background.

    It inherits loaded code and data. Without a spare core there is no worker, and this process does all tasks.

    Parameters
    ----------
    tasks : sequence of callable
        Their results must be picklable.
    """

    def __init__(self, tasks: Sequence[Callable[[], T]]) -> None:
        self._tasks, self._waiting, self._lock = tasks, deque(range(len(tasks))), Lock()
        self._futures: list[Future[T]] = [Future() for _ in tasks]  # by the worker
        self._process: Any = None
        if len(tasks) < 2 or not has_spare_core():
            return
        context = get_context("fork")
        # A duplex pipe: if the worker is killed while it sends a result, this end receives EOF.
        self._connection, other = context.Pipe()
        with warnings.catch_warnings():  # about threads (BLAS, solver), which are idle
            warnings.simplefilter("ignore", DeprecationWarning)
            self._process = context.Process(target=_serve, args=(other, self._connection, tasks), daemon=True)
            self._process.start()
        other.close()
        self._dispatcher = Thread(target=self._dispatch, daemon=True)
        self._dispatcher.start()

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        self.stop()

    def _next(self) -> int | None:
        """Remove the first waiting task."""
        with self._lock:
            return self._waiting.popleft() if self._waiting else None

    def _dispatch(self) -> None:
        """Send one task after the other to the worker, as long as it lives."""
        while (number := self._next()) is not None:
            task = self._futures[number]
            try:
                self._connection.send(number)
                succeeded, result = self._connection.recv()
            except Exception as problem:  # the worker died, or its result cannot be unpickled
                task.set_exception(problem)
                return
            if succeeded:
                task.set_result(result)
            else:
                task.set_exception(RuntimeError("failed in the worker process"))

    def results(self) -> list[T]:
        """Results of all tasks, in order; see :meth:`completed`."""
        results = dict(self.completed())
        return [results[number] for number in range(len(self._tasks))]

    def completed(self, local: Sequence[Callable[[], T]] | None = None) -> Iterator[tuple[int, T]]:
        """Number and result of each task as it completes. This process works on the next waiting task meanwhile, and
        repeats tasks that failed in the worker, so that their errors are raised here.

        Parameters
        ----------
        local : sequence of callable, optional
            The tasks for this process, if they differ from those of the worker.
        """
        local, remaining, longest = local or self._tasks, set(range(len(self._tasks))), 0.0
        while (number := self._next()) is not None:
            start = time.monotonic()
            result = local[number]()
            longest = max(longest, time.monotonic() - start)
            remaining.remove(number)
            yield number, result
            for number in sorted(remaining):
                task = self._futures[number]
                if task.done() and task.exception() is None:
                    remaining.remove(number)
                    yield number, task.result()
        for number in sorted(remaining):
            try:
                result = self._futures[number].result(TIMEOUT + SLOWDOWN * longest)
            except Exception:  # raised again by the task
                result = local[number]()
            yield number, result

    def stop(self) -> None:
        """Kill the worker, whatever it is doing."""
        with self._lock:
            self._waiting.clear()
        if self._process is not None:
            self._process.kill()
            self._process.join()
            self._dispatcher.join()
            self._connection.close()


def run_on_two_cores(tasks: Sequence[Callable[[], T]]) -> list[T]:
    """Results of all tasks, in order; a :class:`WorkerProcess` does some of them if there is a spare core.

    Parameters
    ----------
    tasks : sequence of callable
        Their results must be picklable.
    """
    with WorkerProcess(tasks) as worker:
        return worker.results()


def has_spare_core() -> bool:
    """Whether a worker may run beside this process: a second core, and no other MPI ranks."""
    if sys.platform != "linux" or available_cores() < 2:
        return False
    try:
        return communicator() is None
    except LaunchError:  # reported when samples are distributed
        return False


def _serve(connection: Connection, other: Connection, tasks: Sequence[Callable[[], Any]]) -> None:
    """Main loop of the worker: do the tasks whose numbers it receives until it is killed or the pipe is closed.

    It ignores interrupts: the parent kills it, or the kernel does if the parent was killed.
    """
    other.close()
    ctypes.CDLL(None).prctl(PR_SET_PDEATHSIG, signal.SIGKILL)
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    signal.signal(signal.SIGTERM, signal.SIG_DFL)
    # A thread of the parent may have held the console lock at the fork; errors are reported there.
    sys.stdout = sys.stderr = open(os.devnull, "w", encoding="utf-8")
    with suppress(EOFError, OSError):
        while True:
            number = connection.recv()
            try:
                outcome = True, _run(tasks[number])
            except Exception:
                outcome = False, None
            try:
                connection.send(outcome)
            except (TypeError, ValueError, AttributeError, pickle.PicklingError):
                connection.send((False, None))


@one_thread
def _run(task: Callable[[], T]) -> T:
    return task()
