"""Work shared with a second core: pictures are drawn side by side, and are the same bytes wherever they are drawn."""

from __future__ import annotations

import ctypes
import os
import signal
import sys
import warnings
from collections import deque
from collections.abc import Callable, Sequence
from concurrent.futures import Future, ProcessPoolExecutor
from contextlib import suppress
from multiprocessing import active_children, get_context
from typing import Any, Generic, TypeVar

from mic.product import one_thread
from mic.sampling.ranks import LaunchError, communicator

__all__ = ["Copy", "second_core", "side_by_side"]

T = TypeVar("T")
PATIENCE = 120.0  # s; what the other process has not handed in by then is done here
PR_SET_PDEATHSIG = 1  # of Linux' prctl.h

_tasks: Sequence[Callable[[], Any]] = ()  # in the copy


class Copy(Generic[T]):
    """A copy of this process, a fork, that does tasks, from the first on, until they are asked for.

    It need not load and read again. Where there is no core for it, there is none, and nothing is done before.

    Parameters
    ----------
    tasks : sequence of callable
        What they return can be pickled.
    """

    def __init__(self, tasks: Sequence[Callable[[], T]]) -> None:
        self._tasks, self._waiting = tasks, deque(range(len(tasks)))
        self._taken: dict[int, Future[T]] = {}
        self._pool: ProcessPoolExecutor | None = None
        self._own: set[Any] = set()
        if len(tasks) < 2 or not second_core():
            return
        others = set(active_children())
        try:
            with (
                warnings.catch_warnings()
            ):  # of threads, which the copy lacks: those of BLAS and of the solver, all idle
                warnings.simplefilter("ignore", DeprecationWarning)
                self._pool = ProcessPoolExecutor(1, get_context("fork"), _begin, (tasks,))
                self._hand_out()
        finally:
            self._own = set(active_children()) - others

    def _hand_out(self, _: Any = None) -> None:
        with suppress(IndexError, RuntimeError):  # none is left; the copy is gone
            assert self._pool is not None
            number = self._waiting.popleft()
            self._taken[number] = self._pool.submit(_do, number)
            self._taken[number].add_done_callback(self._hand_out)

    def results(self) -> list[T]:
        """What each task returns, in their order. This process helps, beginning with the last; what the copy failed at
        is done here, so that errors are raised as if there were none."""
        found: dict[int, T] = {}
        while True:
            try:
                number = self._waiting.pop()
            except IndexError:
                break
            found[number] = self._tasks[number]()
        for number, result in list(self._taken.items()):
            with suppress(Exception):  # raised again by whoever does it here
                found[number] = result.result(PATIENCE)
        return [found[number] if number in found else task() for number, task in enumerate(self._tasks)]

    def end(self) -> None:
        """Let the copy go, whatever it is at."""
        if self._pool is not None:
            self._pool.shutdown(wait=False)
        for process in self._own:
            process.kill()
            process.join()


def side_by_side(tasks: Sequence[Callable[[], T]]) -> list[T]:
    """What each task returns, in their order; where there is a core for it, a :class:`Copy` does some of them.

    Parameters
    ----------
    tasks : sequence of callable
        What they return can be pickled.
    """
    copy = None
    try:
        copy = Copy(tasks)
        return copy.results()
    finally:
        if copy is not None:
            copy.end()


def second_core() -> bool:
    """Whether a copy may run beside this process: several processes have their cores already."""
    if sys.platform != "linux" or len(os.sched_getaffinity(0)) < 2:
        return False
    try:
        return communicator() is None
    except LaunchError:  # told where samples are shared out
        return False


def _begin(tasks: Sequence[Callable[[], Any]]) -> None:
    """In the copy, which the other process ends: it hears every interrupt as well. Killed, that one cannot; then the
    kernel does."""
    global _tasks
    _tasks = tasks
    ctypes.CDLL(None).prctl(PR_SET_PDEATHSIG, signal.SIGKILL)
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    signal.signal(signal.SIGTERM, signal.SIG_DFL)


@one_thread
def _do(number: int) -> Any:
    return _tasks[number]()
