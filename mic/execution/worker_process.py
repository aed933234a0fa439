"""Work shared with a second core by a copy of this process: blocks of samples, pictures."""

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
from mic.system.matrix_product import one_thread

__all__ = ["Copy", "second_core", "side_by_side"]

T = TypeVar("T")
PATIENCE = 120.0  # s; what the other process has not handed in by then is done here
SLOWER = 10.0  # of the longest task of this process: so much longer the copy may take for its last
PR_SET_PDEATHSIG = 1  # of Linux' prctl.h


class Copy(Generic[T]):
    """A copy of this process, a fork, that does tasks, from the first on, until they are asked for.

    It need not load and read again. Where there is no core for it, there is none, and nothing is done before.

    Parameters
    ----------
    tasks : sequence of callable
        What they return can be pickled.
    """

    def __init__(self, tasks: Sequence[Callable[[], T]]) -> None:
        self._tasks, self._waiting, self._lock = tasks, deque(range(len(tasks))), Lock()
        self._taken: dict[int, Future[T]] = {}  # by the copy
        self._process: Any = None
        if len(tasks) < 2 or not second_core():
            return
        context = get_context("fork")
        # Of a pair of sockets each process holds one end: where the copy is killed as it hands something in, half of
        # it is followed by an end that is heard.
        self._line, other = context.Pipe()
        with warnings.catch_warnings():  # of threads, which the copy lacks: those of BLAS and of the solver, all idle
            warnings.simplefilter("ignore", DeprecationWarning)
            self._process = context.Process(target=_serve, args=(other, self._line, tasks), daemon=True)
            self._process.start()
        other.close()
        self._told = Thread(target=self._hand_out, daemon=True)
        self._told.start()

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        self.end()

    def _next(self, last: bool = False) -> int | None:
        """A task that waits, for this process."""
        with self._lock:
            return (self._waiting.pop() if last else self._waiting.popleft()) if self._waiting else None

    def _hand_out(self) -> None:
        """One task after the other to the copy, as long as it lives."""
        while True:
            with self._lock:
                if not self._waiting:
                    return
                number = self._waiting.popleft()
                task = self._taken[number] = Future()
            try:
                self._line.send(number)
                done, result = self._line.recv()
            except Exception as problem:  # it is gone, or what it handed in cannot be read
                task.set_exception(problem)
                return
            if done:
                task.set_result(result)
            else:
                task.set_exception(RuntimeError("failed in the copy"))

    def results(self) -> list[T]:
        """What each task returns, in their order. This process helps, beginning with the last; what the copy failed at
        is done here, so that errors are raised as if there were none."""
        found: dict[int, T] = {}
        while (number := self._next(last=True)) is not None:
            found[number] = self._tasks[number]()
        for number, result in list(self._taken.items()):
            with suppress(Exception):  # raised again by whoever does it here
                found[number] = result.result(PATIENCE)
        return [found[number] if number in found else task() for number, task in enumerate(self._tasks)]

    def each(self, here: Sequence[Callable[[], T]] | None = None) -> Iterator[tuple[int, T]]:
        """Number and result of each task once it is done. This process does the next that waits while the copy does
        another; errors as in :meth:`results`.

        Parameters
        ----------
        here : sequence of callable, optional
            The tasks as this process does them, should that be another way.
        """
        here, given, longest = here or self._tasks, set(), 0.0
        while (number := self._next()) is not None:
            start = time.monotonic()
            result = here[number]()
            longest = max(longest, time.monotonic() - start)
            given.add(number)
            yield number, result
            for number, task in list(self._taken.items()):
                if number not in given and task.done() and task.exception() is None:
                    given.add(number)
                    yield number, task.result()
        for number in range(len(self._tasks)):
            if number not in given:
                try:
                    result = self._taken[number].result(PATIENCE + SLOWER * longest)
                except Exception:  # raised again where it is done here
                    result = here[number]()
                yield number, result

    def end(self) -> None:
        """Let the copy go, whatever it is at."""
        with self._lock:
            self._waiting.clear()
        if self._process is not None:
            self._process.kill()
            self._process.join()
            self._told.join()
            self._line.close()


def side_by_side(tasks: Sequence[Callable[[], T]]) -> list[T]:
    """What each task returns, in their order; where there is a core for it, a :class:`Copy` does some of them.

    Parameters
    ----------
    tasks : sequence of callable
        What they return can be pickled.
    """
    with Copy(tasks) as copy:
        return copy.results()


def second_core() -> bool:
    """Whether a copy may run beside this process: several processes have their cores already."""
    if sys.platform != "linux" or len(os.sched_getaffinity(0)) < 2:
        return False
    try:
        return communicator() is None
    except LaunchError:  # told where samples are shared out
        return False


def _serve(line: Connection, other: Connection, tasks: Sequence[Callable[[], Any]]) -> None:
    """The copy: does the tasks whose numbers it is told, until it is killed or its line has no other end.

    The other process ends it: it hears every interrupt as well. Killed, that one cannot; then the kernel does.
    """
    other.close()
    ctypes.CDLL(None).prctl(PR_SET_PDEATHSIG, signal.SIGKILL)
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    signal.signal(signal.SIGTERM, signal.SIG_DFL)
    # A thread of the other process may have held the console just then; and what fails is told there.
    sys.stdout = sys.stderr = open(os.devnull, "w", encoding="utf-8")
    with suppress(EOFError, OSError):
        while True:
            number = line.recv()
            try:
                answer = True, _alone(tasks[number])
            except Exception:
                answer = False, None
            try:
                line.send(answer)
            except (TypeError, ValueError, AttributeError, pickle.PicklingError):
                line.send((False, None))


@one_thread
def _alone(task: Callable[[], T]) -> T:
    return task()
