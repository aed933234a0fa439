"""Tasks distributed over a Dask cluster, on this machine or elsewhere."""

from __future__ import annotations

import math
from collections.abc import Callable, Generator, Sequence
from functools import cached_property
from threading import Lock
from typing import Any, TypeVar

from mic.errors import MicError, MissingLibrary, RunError, WorkerLost
from mic.system.cores import available_cores
from mic.system.matrix_product import one_thread

__all__ = ["Dask"]

Task = TypeVar("Task")
Result = TypeVar("Result")
TIMEOUT = "10s"  # in which the scheduler must answer


class Dask:
    """The engine of a Dask cluster, see :class:`mic.execution.engine.Engine`.

    Parameters
    ----------
    address : str, optional
        Address of the scheduler, such as ``tcp://host:8786``; its workers must have this program and reach the
        results folder. Default: a cluster of this machine's cores.

    Raises
    ------
    MissingLibrary
        If Dask is not installed.
    """

    def __init__(self, address: str | None = None) -> None:
        try:
            import distributed  # noqa: F401
        except ImportError:
            raise MissingLibrary("engine dask needs Dask, which is not installed: pip install distributed") from None
        self._address = address

    @cached_property
    def _client(self) -> Any:
        from distributed import Client

        if self._address is None:
            return Client(n_workers=available_cores(), threads_per_worker=1, dashboard_address=None, processes=True)
        try:
            return Client(self._address, timeout=TIMEOUT)
        except (OSError, ValueError) as problem:
            raise RunError(f"engine dask:{self._address}: no scheduler answers there ({problem}); start one") from None

    @property
    def workers(self) -> int:
        """Number of worker processes."""
        return max(1, len(self._client.scheduler_info(-1)["workers"]))

    def completed(
        self, work: Callable[[Task], Result], tasks: Sequence[Task], seconds: float = math.inf
    ) -> Generator[tuple[int, Result], None, None]:
        """See :meth:`mic.execution.engine.Engine.completed`.

        Dask repeats the tasks of a lost worker. What fails otherwise is done by this process, which raises its errors;
        errors that a user can correct are raised at once.
        """
        from distributed import as_completed

        client = self._client
        try:
            shared = client.scatter(work, broadcast=True, hash=False)
            futures = {client.submit(_run, shared, task, pure=False): n for n, task in enumerate(tasks)}
            for future in as_completed(futures):
                number, problem = futures.pop(future), future.exception()
                if isinstance(problem, MicError):
                    raise problem
                yield number, future.result() if problem is None else work(tasks[number])
                future.release()
        finally:
            client.close()
            if client.cluster is not None:
                client.cluster.close()
            del self._client

    def standing(self, work: Callable[[Task], Result]) -> list[DaskWorker]:
        """See :meth:`mic.execution.engine.Engine.standing`."""
        shared = self._client.scatter(work, broadcast=True, hash=False)
        return [DaskWorker(self._client, shared) for _ in range(self.workers)]


class DaskWorker:
    """One task at a time on any worker of the cluster, see :class:`mic.execution.engine.StandingWorker`."""

    def __init__(self, client: Any, work: Any) -> None:
        self._client, self._work = client, work

    def do(self, task: Any, seconds: float) -> Any:
        """See :meth:`mic.execution.engine.StandingWorker.do`; Dask repeats the tasks of a lost worker."""
        from distributed.scheduler import KilledWorker

        future = self._client.submit(_run, self._work, task, pure=False)
        try:
            return future.result(seconds)
        except KilledWorker:
            raise WorkerLost("workers of the cluster have ended with this task, perhaps for lack of memory") from None
        finally:
            future.cancel()

    def stop(self) -> None:
        """Leave the cluster; one that this process started ends."""
        self._client.close()
        if self._client.cluster is not None:
            self._client.cluster.close()


_one_at_a_time = Lock()  # workers of a foreign cluster may have several threads


@one_thread
def _run(work: Callable[[Any], Any], task: Any) -> Any:
    with _one_at_a_time:
        return work(task)
