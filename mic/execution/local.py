"""Tasks distributed over worker processes of this machine: a process pool of the standard library.

On Linux workers are forks: they start at once, and inherit loaded kernels and the model, whose memory they share. On
other systems they are new processes, which receive the work pickled.
"""

from __future__ import annotations

import gc
import math
import multiprocessing
import os
import pickle
import shutil
import signal
import socket
import sys
import warnings
from collections.abc import Callable, Generator, Iterator, Sequence
from concurrent.futures import Future, ProcessPoolExecutor, as_completed
from concurrent.futures.process import BrokenProcessPool
from multiprocessing.connection import Connection, wait
from pathlib import Path
from tempfile import TemporaryDirectory
from threading import Lock, Thread
from typing import Any, Generic, Self, TypeVar

from mic.errors import WorkerLost
from mic.system.cores import available_cores
from mic.system.matrix_product import one_thread

__all__ = ["START_METHOD", "Local", "Worker", "WorkerPool"]

Task = TypeVar("Task")
Result = TypeVar("Result")
START_METHOD = "fork" if sys.platform == "linux" else "spawn"
WORTHWHILE = 0.1  # s of work for each worker, which takes a tenth of that to start


class Local:
    """The engine of one machine, see :class:`mic.execution.engine.Engine`.

    Parameters
    ----------
    workers : int, optional
        Worker processes; one: this process does all tasks. Default: the available cores.
    """

    def __init__(self, workers: int | None = None) -> None:
        self.workers = available_cores() if workers is None else workers

    def completed(
        self, work: Callable[[Task], Result], tasks: Sequence[Task], seconds: float = math.inf
    ) -> Generator[tuple[int, Result], None, None]:
        """See :meth:`mic.execution.engine.Engine.completed`."""
        workers = int(min(self.workers, len(tasks), seconds / WORTHWHILE))
        if workers > 1:
            with WorkerPool(work, tasks, workers) as pool:
                yield from pool.completed()
        else:
            yield from ((number, work(task)) for number, task in enumerate(tasks))

    def standing(self, work: Callable[[Task], Result]) -> list[Worker[Task, Result]]:
        """See :meth:`mic.execution.engine.Engine.standing`."""
        return [Worker(work) for _ in range(self.workers)]


class WorkerPool(Generic[Task, Result]):
    """Worker processes that begin with the tasks at once, in the background.

    Parameters
    ----------
    work : callable
        Its result for a task must be picklable; where workers are not forked, so must it and the tasks.
    tasks : sequence
    workers : int
        Number of processes.
    """

    def __init__(self, work: Callable[[Task], Result], tasks: Sequence[Task], workers: int) -> None:
        self._work, self._tasks, self._workers = work, tasks, workers
        self._results = TemporaryDirectory(prefix="mic-")
        self._futures: dict[Future[None], int] = {}
        self._start(range(len(tasks)))

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        self.stop()

    def _start(self, numbers: Sequence[int]) -> None:
        """Start workers on tasks."""
        context: Any = multiprocessing.get_context(START_METHOD)
        given = self._work, self._tasks, self._results.name
        self._pool = ProcessPoolExecutor(min(self._workers, len(numbers)), context, _initialise, given)
        before = multiprocessing.active_children()
        with warnings.catch_warnings():  # about forks of a process with threads (BLAS, console), which are idle
            warnings.simplefilter("ignore", DeprecationWarning)
            self._futures = {self._pool.submit(_run, number): number for number in numbers}
        self._processes = [process for process in multiprocessing.active_children() if process not in before]

    def completed(self) -> Iterator[tuple[int, Result]]:
        """Number and result of each task as it completes.

        If a worker is killed, half as many workers do the remaining tasks: it may be for lack of memory. What fails in
        a worker is done again by this process, which raises its errors.
        """
        remaining = set(self._futures.values())
        while True:
            broken = False
            for future in as_completed(self._futures):
                number, problem = self._futures[future], future.exception()
                if problem is None:
                    path = Path(self._results.name, str(number))
                    result = pickle.loads(path.read_bytes())
                    path.unlink()
                    remaining.remove(number)
                    yield number, result
                broken |= isinstance(problem, BrokenProcessPool)
            self._end()
            if not (broken and remaining and self._workers > 1):
                break
            self._workers //= 2
            self._start(sorted(remaining))
        for number in sorted(remaining):
            yield number, self._work(self._tasks[number])

    def _end(self) -> None:
        """Kill the workers, whatever they are doing."""
        for process in self._processes:
            process.kill()
        self._pool.shutdown(cancel_futures=True)

    def stop(self) -> None:
        """Kill the workers, whatever they are doing, and remove what they have left."""
        self._end()
        self._results.cleanup()


class Worker(Generic[Task, Result]):
    """One process that does tasks as they come, see :class:`mic.execution.engine.StandingWorker`.

    A process that was killed, or took too long, is replaced for the next task.

    Parameters
    ----------
    work : callable
        As for :class:`WorkerPool`; the tasks must be picklable.
    """

    def __init__(self, work: Callable[[Task], Result]) -> None:
        self._work = work
        self._start()

    def _start(self) -> None:
        context: Any = multiprocessing.get_context(START_METHOD)
        with _one_starts, warnings.catch_warnings():  # a process started meanwhile would hold this pipe open
            warnings.simplefilter("ignore", DeprecationWarning)  # as in WorkerPool
            self._pipe, theirs = context.Pipe()
            self._process = context.Process(target=_do_tasks, args=(self._work, theirs), daemon=True)
            self._process.start()
            theirs.close()

    def do(self, task: Task, seconds: float) -> Result:
        """See :meth:`mic.execution.engine.StandingWorker.do`."""
        if not self._process.is_alive():
            self.stop()
            self._start()
        try:
            self._pipe.send(task)
            if not wait([self._pipe, self._process.sentinel], seconds):
                raise TimeoutError(f"no result after {seconds:g} s")
            succeeded, result = self._pipe.recv()
        except TimeoutError:
            self.stop()
            raise
        except (EOFError, OSError):
            self.stop()
            raise WorkerLost("the worker process was killed, perhaps for lack of memory") from None
        if not succeeded:
            raise result
        return result

    def stop(self) -> None:
        """See :meth:`mic.execution.engine.StandingWorker.stop`."""
        self._process.kill()
        self._process.join()
        self._pipe.close()


_one_starts = Lock()


def _do_tasks(work: Callable[[Any], Any], pipe: Connection) -> None:
    """The life of a :class:`Worker`'s process: it answers each task with whether it succeeded, and result or error."""
    _initialise(work, (), "")
    _close_sockets()
    while True:
        task = pipe.recv()
        try:
            answer = True, one_thread(work)(task)
        except Exception as problem:
            answer = False, problem
        pipe.send(answer)


def _close_sockets() -> None:
    """Close inherited network connections: otherwise a client would not see that this process's parent closes them."""
    descriptors = Path("/proc/self/fd")
    for name in list(descriptors.iterdir()) if descriptors.is_dir() else ():
        try:
            inherited = socket.socket(fileno=int(name.name))
        except OSError:
            continue  # no socket
        if inherited.family in (socket.AF_INET, socket.AF_INET6):
            inherited.close()
        else:
            inherited.detach()


_job: tuple[Callable[[Any], Any], Sequence[Any], str]  # of a worker: work, tasks, and folder of the results


def _initialise(*job: Any) -> None:
    """Prepare a worker: it ignores interrupts, since its parent kills it, and ends when its parent was killed."""
    global _job
    _job = job
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    signal.signal(signal.SIGTERM, signal.SIG_DFL)
    Thread(target=_end_with_parent, daemon=True).start()
    gc.freeze()  # a collection would write to, and so copy, the memory of all inherited objects
    # A thread of the parent may have held the console lock at the fork; errors are reported there.
    sys.stdout = sys.stderr = open(os.devnull, "w", encoding="utf-8")


def _end_with_parent() -> None:
    parent = multiprocessing.parent_process()
    if parent is not None:
        parent.join()
        shutil.rmtree(_job[2], ignore_errors=True)  # the parent was killed
        os._exit(1)


def _run(number: int) -> None:
    """Do a task and write its result to a file: a worker killed while it sends a long message would hang its parent."""
    work, tasks, folder = _job
    result = one_thread(work)(tasks[number])
    Path(folder, str(number)).write_bytes(pickle.dumps(result, pickle.HIGHEST_PROTOCOL))
