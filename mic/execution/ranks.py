"""The MPI ranks that share a run, or this process alone.

Decisions that must agree (content of the cache, finished blocks, invalid files) are made by rank 0 and broadcast. Ranks
that fail together exit together with one message; a rank that fails alone aborts the others, which would wait forever.
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
    "FirstRankFailed",
    "LaunchError",
    "alone",
    "communicator",
    "exit_together",
    "on_first",
    "shared",
    "silence_other_ranks",
    "wait",
]

T = TypeVar("T")

FAILURE_TIMEOUT = 2.0  # s that a failed rank waits for the others before it aborts them
ALIGNMENT = 64  # bytes
CHUNK = 2**30  # bytes of one MPI message, whose length is a 32-bit number
LAUNCHERS = {  # environment variables with the number of processes, the innermost launcher first
    "OMPI_COMM_WORLD_SIZE": "mpirun of Open MPI",
    "PMI_SIZE": "mpiexec of MPICH",
    "SLURM_STEP_NUM_TASKS": "srun",
}
UNSIZED = ("PMIX_RANK", "PMI_RANK")  # variables of launchers that do not give the number

_alone = False  # see :func:`alone`


class LaunchError(MicError, RuntimeError):
    """Processes that were started together cannot communicate; the message gives the reason and the remedy."""


class FirstRankFailed(MicError):
    """Raised on the other ranks when rank 0 has failed, which reports the error itself."""


def communicator() -> Any:
    """The MPI communicator if several processes were started, else None; within :func:`alone`, this rank's own.

    Raises
    ------
    LaunchError
        If several processes were started without a common MPI: each would compute and write the whole run.
    """
    launcher, count = _launched()
    if launcher is None:
        return None
    try:
        from mpi4py import MPI  # initialises MPI
    except ImportError as problem:
        raise LaunchError(
            f"{launcher} started several processes, but mpi4py, which they need to share the work, cannot be imported "
            f"({problem}); install mpi4py (Debian: python3-mpi4py) or start one process"
        ) from problem
    if MPI.COMM_WORLD.size == 1:
        if count is None:
            return None
        library = " ".join(MPI.Get_library_version().replace(",", " ").split()[:3])
        raise LaunchError(
            f"{launcher} started {count} processes that cannot communicate: the launcher does not belong to the MPI "
            f"that mpi4py uses ({library}); use its own mpirun or start one process"
        )
    from mic.compliance import provider  # slow to import, and needed with MPI only

    provider.installed()  # loads libraries whose initialisation is collective
    _exit_communicator()
    return MPI.COMM_SELF if _alone else MPI.COMM_WORLD


@contextmanager
def alone() -> Iterator[None]:
    """Within this context, work (sampling included) is not shared with other ranks, which do something else."""
    global _alone
    before, _alone = _alone, True
    try:
        yield
    finally:
        _alone = before


def _launched() -> tuple[str | None, int | None]:
    """Name of the MPI launcher and number of its processes; (None, None) for a single process."""
    for variable, launcher in LAUNCHERS.items():
        if os.environ.get(variable, "").isdigit():
            count = int(os.environ[variable])
            return (launcher, count) if count > 1 else (None, None)
    return ("the launcher", None) if any(variable in os.environ for variable in UNSIZED) else (None, None)


@cache
def _exit_communicator() -> Any:
    """A communicator for :func:`exit_together` only, so that its messages cannot match any others."""
    from mpi4py import MPI  # initialises MPI

    return MPI.COMM_WORLD.Dup()


def wait(world: Any) -> None:
    """Wait for all ranks; unlike ``MPI.Barrier``, this handles signals and does not spin."""
    if world is not None:
        _completed(world.Ibarrier())


def _completed(request: Any, seconds: float = np.inf) -> bool:
    """Whether an MPI request completes within the time."""
    end, pause = time.monotonic() + seconds, 1e-4
    while not request.Test():
        if time.monotonic() > end:
            return False
        time.sleep(pause)
        pause = min(2 * pause, 0.02)
    return True


def on_first(world: Any, action: Callable[[], T]) -> T:
    """Run an action on rank 0 and return its result on all ranks.

    Parameters
    ----------
    world : mpi4py.MPI.Comm or None
    action : callable
        Its result must be picklable.

    Raises
    ------
    FirstRankFailed
        On the other ranks, if the action raised on rank 0.
    """
    if world is None:
        return action()
    if world.rank > 0:
        wait(world)
        succeeded, result = world.bcast(None)
        if not succeeded:
            raise FirstRankFailed("the first process failed")
        return result
    outcome: tuple[bool, Any] = (False, None)
    try:
        outcome = (True, action())
        return outcome[1]
    finally:
        wait(world)
        world.bcast(outcome)


def shared(world: Any, make: Callable[[], T]) -> T:
    """Make an object on rank 0 and return it on all ranks, its arrays in memory shared by the ranks of a node.

    Parameters
    ----------
    world : mpi4py.MPI.Comm or None
    make : callable
        Its result must be picklable. All ranks of a node share its arrays, so they must not be modified.

    Raises
    ------
    FirstRankFailed
        On the other ranks, if rank 0 failed.
    """
    if world is None:
        return make()
    from mpi4py import MPI  # initialises MPI

    buffers: list[pickle.PickleBuffer] = []
    body, sizes = on_first(world, lambda: _pickled(make(), buffers))
    starts = np.concatenate([[0], np.cumsum(-(-np.array(sizes, dtype=np.int64) // ALIGNMENT) * ALIGNMENT)])
    node = world.Split_type(MPI.COMM_TYPE_SHARED, key=world.rank)
    leaders = world.Split(min(node.rank, 1), key=world.rank)
    window = MPI.Win.Allocate_shared(int(starts[-1]) if node.rank == 0 else 0, 1, comm=node)  # never freed
    memory, _ = window.Shared_query(0)
    whole = np.asarray(memory, np.uint8)
    views = [whole[int(a) : int(a) + size] for a, size in zip(starts, sizes)]
    for i in range(len(views)):
        if world.rank == 0:
            views[i][:] = np.frombuffer(buffers[i].raw(), np.uint8)
        if node.rank == 0:
            for first in range(0, sizes[i], CHUNK):
                leaders.Bcast(views[i][first : first + CHUNK])
    buffers.clear()
    wait(world)
    return pickle.loads(body, buffers=views)


def _pickled(content: Any, buffers: list[pickle.PickleBuffer]) -> tuple[bytes, list[int]]:
    """Pickle without the array data, which is appended to the buffers, and the size of each buffer in bytes."""
    body = pickle.dumps(content, protocol=5, buffer_callback=buffers.append)
    return body, [buffer.raw().nbytes for buffer in buffers]


@contextmanager
def silence_other_ranks(world: Any) -> Iterator[None]:
    """Suppress the output of all ranks but the first: it would be the same."""
    if world is None or world.rank == 0:
        yield
    else:
        with redirect_stdout(StringIO()), redirect_stderr(StringIO()):
            yield


def exit_together(world: Any, status: int, message: str = "") -> NoReturn:
    """End this process.

    If all ranks arrive here, all exit, and the first failed one prints its message. If this rank failed and others do
    not arrive within a few seconds, it prints its message and aborts them.

    Parameters
    ----------
    world : mpi4py.MPI.Comm or None
    status : int
        0 for success.
    message : str
        Reason of the failure, for standard error; empty if it was printed already.
    """
    if world is not None:
        mine, all_of_them = np.array([status]), np.empty(world.size, int)
        # Higher ranks wait longer: if several fail while others hang, only one prints its message.
        timeout = FAILURE_TIMEOUT + 0.3 * world.rank if status else np.inf
        together = _completed(_exit_communicator().Iallgather(mine, all_of_them), timeout)
        if not together:
            message = message or f"ended with status {status}\n"
            print(f"process {world.rank + 1} of {world.size}: {message}", end="", file=sys.stderr, flush=True)
            world.Abort(status)
        if (all_of_them[: world.rank] != 0).any():
            message = ""
        elif message and world.rank > 0:
            message = f"process {world.rank + 1} of {world.size}: {message}"
    print(message, end="", file=sys.stderr, flush=True)
    sys.exit(status)
