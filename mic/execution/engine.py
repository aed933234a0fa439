"""Engines, which distribute tasks over processes; results depend neither on the engine nor on the number of workers."""

from __future__ import annotations

import math
from collections.abc import Callable, Generator, Sequence
from typing import Protocol, TypeVar

from mic.errors import RunError
from mic.execution.local import START_METHOD, Local
from mic.execution.ranks import LaunchError, communicator
from mic.system.cores import available_cores

__all__ = ["Engine", "choose", "forked_workers"]

Task = TypeVar("Task", contravariant=True)
Result = TypeVar("Result", covariant=True)


class Engine(Protocol):
    """Distributes tasks over workers.

    Attributes
    ----------
    workers : int
        Number of tasks that are done at the same time.
    """

    @property
    def workers(self) -> int: ...

    def completed(
        self, work: Callable[[Task], Result], tasks: Sequence[Task], seconds: float = math.inf
    ) -> Generator[tuple[int, Result], None, None]:
        """Number and result of each task as it completes, in any order; under MPI, on the first rank only.

        Close the iterator (``contextlib.closing``): that ends the workers.

        Parameters
        ----------
        work : callable
            Called with a task, in any process. It and its results must be picklable; forked workers inherit `work`.
        tasks : sequence
        seconds : float
            Expected duration of all tasks in one process; a short one is worth few workers.
        """
        ...

    def standing(self, work: Callable[[Task], Result]) -> Sequence[StandingWorker[Task, Result]]:
        """Workers for a service, whose tasks come one by one; work and tasks as in :meth:`completed`."""
        ...


class StandingWorker(Protocol[Task, Result]):
    """Does one task at a time."""

    def do(self, task: Task, seconds: float) -> Result:
        """The result of a task; raises the error of the work.

        Raises
        ------
        TimeoutError
            If it takes longer than that.
        WorkerLost
            If the process has ended, which another process replaces.
        """
        ...

    def stop(self) -> None:
        """End the worker, whatever it is doing."""
        ...


def choose(name: str | None = None) -> Engine:
    """The engine of a name.

    Parameters
    ----------
    name : str, optional
        ``"local"``: a worker process for each core of this machine; ``"local:N"``: N of them. ``"mpi"``: the processes
        that ``mpirun`` started. ``"dask"``: a Dask cluster on this machine; ``"dask:ADDRESS"``: the cluster whose
        scheduler has this address. Default: ``"mpi"`` under ``mpirun``, else ``"local"``; where workers cannot be
        forked, this process alone, since a script without ``if __name__ == "__main__"`` would start itself again.

    Raises
    ------
    RunError
        If there is no such engine, or it cannot be used here.
    MissingLibrary
        If Dask is not installed.
    LaunchError
        As :func:`mic.execution.ranks.communicator`.
    """
    kind, _, where = (name or "").partition(":")
    world = communicator()
    if world is not None:
        from mic.execution.mpi import Mpi

        if kind not in ("", "mpi"):
            raise RunError(f"engine {name}: mpirun has started this process; leave out mpirun or the engine")
        return Mpi(world)
    if kind == "":
        return Local(None if START_METHOD == "fork" else 1)
    if kind == "local" and (not where or where.isdecimal() and int(where) > 0):
        return Local(int(where) if where else None)
    if kind == "dask":
        from mic.execution.dask_cluster import Dask

        return Dask(where or None)
    if name == "mpi":
        raise RunError("engine mpi: one process was started; start several with mpirun -n N, or leave out the engine")
    raise RunError(f"engine {name}: give local, local:WORKERS, mpi, dask or dask:ADDRESS")


def forked_workers() -> int:
    """Number of workers for tasks that cannot be pickled: the cores; one under MPI and where workers are not forked."""
    try:
        return available_cores() if START_METHOD == "fork" and communicator() is None else 1
    except LaunchError:  # reported when samples are distributed
        return 1
