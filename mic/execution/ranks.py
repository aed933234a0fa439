"""The processes that share a run: all that ``mpirun`` started, or this one alone.

What is decided once (what the cache holds, what is finished, what is wrong with a file) is decided by the first process
and told to the others. Processes that fail together leave together, with one message; one that fails alone takes the
others along, for they would wait for it for ever.
"""

from __future__ import annotations

import os
import pickle
import sys
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager, redirect_stderr, redirect_stdout
from functools import cache
from io import StringIO
from typing import Any, NoReturn, TypeVar

import numpy as np

from mic.errors import MicError

__all__ = [
    "FirstFailed",
    "LaunchError",
    "alone",
    "communicator",
    "leave",
    "on_first",
    "others_silent",
    "shared",
    "wait",
]

T = TypeVar("T")

PATIENCE = 2.0  # s that a process which fails waits for the others to end as well
ALIGNED = 64  # bytes
PIECE = 2**30  # bytes in one message of MPI, which counts in 32 bits
LAUNCHERS = {  # what says how many processes were started, the innermost launcher first
    "OMPI_COMM_WORLD_SIZE": "mpirun of Open MPI",
    "PMI_SIZE": "mpiexec of MPICH",
    "SLURM_STEP_NUM_TASKS": "srun",
}
MAYBE = ("PMIX_RANK", "PMI_RANK")  # of launchers that do not say how many; MPI does

_alone = False  # see :func:`alone`


class LaunchError(MicError, RuntimeError):
    """Processes that were started together and cannot work together; the message says why and what to do."""


class FirstFailed(MicError):
    """What the other processes raise where the first has failed, which says itself what is wrong."""


def communicator() -> Any:
    """The MPI world when started as one of several processes, else None (a single process needs no MPI); within
    :func:`alone` a world of this process.

    Raises
    ------
    LaunchError
        If several processes were started that do not see each other: each of them would do, and write, the whole run.
    """
    launcher, count = _launched()
    if launcher is None:
        return None
    try:
        from mpi4py import MPI  # only here: importing it starts MPI
    except ImportError as problem:
        raise LaunchError(
            f"{launcher} started several processes, and mpi4py, by which they share the work, cannot be imported "
            f"({problem}); install python3-mpi4py, or start one process"
        ) from problem
    if MPI.COMM_WORLD.size == 1:
        if count is None:
            return None
        library = " ".join(MPI.Get_library_version().replace(",", " ").split()[:3])
        raise LaunchError(
            f"{launcher} started {count} processes, and each sees itself alone: the launcher is not that of the MPI "
            f"that mpi4py uses ({library}); use its own mpirun, or start one "
            "process"
        )
    from mic.compliance import provider  # one process alone, which asks for help perhaps, need not wait for its imports

    provider.installed()  # their libraries start up collectively: later, a process alone would wait for ever
    _parting()
    return MPI.COMM_SELF if _alone else MPI.COMM_WORLD


@contextmanager
def alone() -> Iterator[None]:
    """What is done within, sampling too, is shared with no other process: the others do something else meanwhile."""
    global _alone
    before, _alone = _alone, True
    try:
        yield
    finally:
        _alone = before


def _launched() -> tuple[str | None, int | None]:
    """Who has started this process beside others, and how many there are where that is known."""
    for variable, launcher in LAUNCHERS.items():
        if os.environ.get(variable, "").isdigit():
            count = int(os.environ[variable])
            return (launcher, count) if count > 1 else (None, None)
    return ("the launcher", None) if any(variable in os.environ for variable in MAYBE) else (None, None)


@cache
def _parting() -> Any:
    """A communicator that is used only to leave: whoever fails can say so while the others are anywhere else."""
    from mpi4py import MPI  # only here: importing it starts MPI

    return MPI.COMM_WORLD.Dup()


def wait(world: Any) -> None:
    """Until all processes have come here; unlike in MPI's own barrier, signals are heard and the processor is left."""
    if world is not None:
        _until(world.Ibarrier())


def _until(request: Any, seconds: float = np.inf) -> bool:
    """Whether an MPI request has completed within a time."""
    end, pause = time.monotonic() + seconds, 1e-4
    while not request.Test():
        if time.monotonic() > end:
            return False
        time.sleep(pause)
        pause = min(2 * pause, 0.02)
    return True


def on_first(world: Any, action: Callable[[], T]) -> T:
    """What an action returns that the first process does alone, on all of them.

    Parameters
    ----------
    world : mpi4py.MPI.Comm or None
    action : callable
        What it returns is sent to the other processes.

    Raises
    ------
    FirstFailed
        On the other processes, where the action has raised on the first.
    """
    if world is None:
        return action()
    if world.rank > 0:
        wait(world)
        done, result = world.bcast(None)
        if not done:
            raise FirstFailed("the first process has failed")
        return result
    answer: tuple[bool, Any] = (False, None)
    try:
        answer = (True, action())
        return answer[1]
    finally:
        wait(world)
        world.bcast(answer)


def shared(world: Any, make: Callable[[], T]) -> T:
    """What the first process makes, on all of them; its arrays lie in memory that the processes of a node share.

    Parameters
    ----------
    world : mpi4py.MPI.Comm or None
    make : callable
        What it returns can be pickled. Its arrays are one and the same on all processes of a node, so that nobody may
        write to them.

    Raises
    ------
    FirstFailed
        On the other processes, where the first has failed.
    """
    if world is None:
        return make()
    from mpi4py import MPI  # only here: importing it starts MPI

    found: list[pickle.PickleBuffer] = []
    body, sizes = on_first(world, lambda: _packed(make(), found))
    starts = np.concatenate([[0], np.cumsum(-(-np.array(sizes, dtype=np.int64) // ALIGNED) * ALIGNED)])
    node = world.Split_type(MPI.COMM_TYPE_SHARED, key=world.rank)
    leaders = world.Split(min(node.rank, 1), key=world.rank)
    window = MPI.Win.Allocate_shared(int(starts[-1]) if node.rank == 0 else 0, 1, comm=node)  # for good
    memory, _ = window.Shared_query(0)
    whole = np.asarray(memory, np.uint8)
    own = [whole[int(a) : int(a) + size] for a, size in zip(starts, sizes)]
    for i in range(len(own)):
        if world.rank == 0:
            own[i][:] = np.frombuffer(found[i].raw(), np.uint8)
        if node.rank == 0:
            for first in range(0, sizes[i], PIECE):
                leaders.Bcast(own[i][first : first + PIECE])
    found.clear()
    wait(world)
    return pickle.loads(body, buffers=own)


def _packed(made: Any, buffers: list[pickle.PickleBuffer]) -> tuple[bytes, list[int]]:
    """A pickle without the arrays, which are put among the buffers, and how many bytes each of these has."""
    body = pickle.dumps(made, protocol=5, buffer_callback=buffers.append)
    return body, [buffer.raw().nbytes for buffer in buffers]


@contextmanager
def others_silent(world: Any) -> Iterator[None]:
    """Within it no process but the first prints anything: they would all say the same."""
    if world is None or world.rank == 0:
        yield
    else:
        with redirect_stdout(StringIO()), redirect_stderr(StringIO()):
            yield


def leave(world: Any, status: int, words: str = "") -> NoReturn:
    """End this process.

    Where all processes come here, they leave in peace, and the first of those that failed says why. Where others do
    not come within a few seconds while this one has failed, it says why and ends them.

    Parameters
    ----------
    world : mpi4py.MPI.Comm or None
    status : int
        0 where all went well.
    words : str
        Why it has failed, for the standard error; none where that was said.
    """
    if world is not None:
        mine, all_of_them = np.array([status]), np.empty(world.size, int)
        # The later ones wait longer, so that of several that fail while others hang only one speaks.
        together = _until(_parting().Iallgather(mine, all_of_them), PATIENCE + 0.3 * world.rank if status else np.inf)
        if not together:
            words = words or f"ended with status {status}\n"
            print(f"process {world.rank + 1} of {world.size}: {words}", end="", file=sys.stderr, flush=True)
            world.Abort(status)
        if (all_of_them[: world.rank] != 0).any():
            words = ""
        elif words and world.rank > 0:
            words = f"process {world.rank + 1} of {world.size}: {words}"
    print(words, end="", file=sys.stderr, flush=True)
    sys.exit(status)
