"""Work shared with a second core: pictures are drawn side by side, and are the same bytes wherever they are drawn."""

from __future__ import annotations

import os
import signal
import sys
import warnings
from collections.abc import Callable, Iterator, Sequence
from contextlib import suppress
from multiprocessing import get_context
from typing import Any, TypeVar

from mic.product import one_thread
from mic.sampling.ranks import LaunchError, communicator

__all__ = ["second_core", "side_by_side"]

T = TypeVar("T")
PATIENCE = 120.0  # s; what the other process has not handed in by then is done here


def side_by_side(tasks: Sequence[Callable[[], T]]) -> list[T]:
    """What each task returns, in their order; where there is a core for it, a copy of this process does some of them.

    The copy (a fork: it need not load and read again) writes no file, has one thread, and ends of itself should this
    process be gone. What it fails at is done here, so that errors are raised as if there were no copy.

    Parameters
    ----------
    tasks : sequence of callable
        What they return can be pickled.
    """
    if len(tasks) < 2 or not second_core():
        return [task() for task in tasks]
    numbers = _Numbers(len(tasks))
    context = get_context("fork")
    here, there = context.Pipe(duplex=False)
    copy = context.Process(target=_hand_in, args=(there, numbers, tasks), daemon=True)
    with warnings.catch_warnings():  # of threads, which the copy lacks: those of BLAS and of the solver, all idle
        warnings.simplefilter("ignore", DeprecationWarning)
        copy.start()
    there.close()
    try:
        found = {number: tasks[number]() for number in numbers}
        with suppress(EOFError, OSError):
            if here.poll(PATIENCE):
                found |= here.recv()
    finally:
        copy.kill()
        copy.join()
        here.close()
        numbers.close()
    return [found[number] if number in found else task() for number, task in enumerate(tasks)]


class _Numbers:
    """The numbers of tasks, each taken once by whoever is free, from a pipe: who is killed holds none of it."""

    SIZE = 2  # bytes of a number

    def __init__(self, count: int) -> None:
        self._read, self._write = os.pipe()
        os.set_blocking(self._read, False)
        os.write(self._write, b"".join(number.to_bytes(self.SIZE, "little") for number in range(count)))

    def __iter__(self) -> Iterator[int]:
        with suppress(BlockingIOError):
            while True:
                yield int.from_bytes(os.read(self._read, self.SIZE), "little")

    def close(self) -> None:
        os.close(self._read)
        os.close(self._write)


def second_core() -> bool:
    """Whether a copy may run beside this process: several processes have their cores already."""
    if sys.platform != "linux" or len(os.sched_getaffinity(0)) < 2:
        return False
    try:
        return communicator() is None
    except LaunchError:  # told where samples are shared out
        return False


@one_thread
def _hand_in(there: Any, numbers: _Numbers, tasks: Sequence[Callable[[], Any]]) -> None:
    """In the copy: silent, whatever happens to it."""
    signal.signal(signal.SIGINT, signal.SIG_IGN)  # the other process, which hears it too, ends this one
    signal.signal(signal.SIGTERM, signal.SIG_DFL)
    found = {}
    with suppress(Exception):  # raised by the process that does it again
        for number in numbers:
            found[number] = tasks[number]()
    with suppress(OSError):  # nobody is there any more
        there.send(found)
