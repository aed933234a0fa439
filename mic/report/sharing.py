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
from typing import Any, TypeVar

from mic.product import one_thread
from mic.sampling.ranks import LaunchError, communicator

__all__ = ["second_core", "side_by_side"]

T = TypeVar("T")
PATIENCE = 120.0  # s; what the other process has not handed in by then is done here
PR_SET_PDEATHSIG = 1  # of Linux' prctl.h

_tasks: Sequence[Callable[[], Any]] = ()  # in the copy


def side_by_side(tasks: Sequence[Callable[[], T]]) -> list[T]:
    """What each task returns, in their order; where there is a core for it, a copy of this process does some of them.

    The copy, a fork, need not load and read again; it begins with the first task, this process with the last. What the
    copy fails at is done here, so that errors are raised as if there were none.

    Parameters
    ----------
    tasks : sequence of callable
        What they return can be pickled.
    """
    if len(tasks) < 2 or not second_core():
        return [task() for task in tasks]
    others, waiting = set(active_children()), deque(range(len(tasks)))
    copy = ProcessPoolExecutor(1, get_context("fork"), _begin, (tasks,))
    taken: dict[int, Future[T]] = {}
    found: dict[int, T] = {}

    def hand_out(_: Any = None) -> None:
        with suppress(IndexError, RuntimeError):  # none is left; the copy is gone
            number = waiting.popleft()
            taken[number] = copy.submit(_do, number)
            taken[number].add_done_callback(hand_out)

    try:
        with warnings.catch_warnings():  # of threads, which the copy lacks: those of BLAS and of the solver, all idle
            warnings.simplefilter("ignore", DeprecationWarning)
            hand_out()
        while True:
            try:
                number = waiting.pop()
            except IndexError:
                break
            found[number] = tasks[number]()
        for number, result in list(taken.items()):
            with suppress(Exception):  # raised again by whoever does it here
                found[number] = result.result(PATIENCE)
        return [found[number] if number in found else task() for number, task in enumerate(tasks)]
    finally:
        copy.shutdown(wait=False)
        for process in set(active_children()) - others:
            process.kill()
            process.join()


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
