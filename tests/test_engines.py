"""Tasks distributed by any engine: the same results, also if workers are killed."""

import os
import pickle
import signal
import socket
import subprocess
import sys
import threading
import time
from contextlib import closing, suppress
from multiprocessing import active_children
from pathlib import Path
from types import SimpleNamespace

import pytest

from mic.errors import MissingLibrary, RunError, WorkerLost
from mic.execution import local
from mic.execution.engine import choose
from mic.execution.local import Local, WorkerPool
from mic.execution.mpi import Mpi


def number_and_process(task):
    """The task's number, and the process that did it."""
    time.sleep(0.002)
    return task, os.getpid()


def finished(engine, work, tasks):
    """Results by number; none comes twice."""
    with closing(engine.completed(work, tasks)) as completed:
        found = list(completed)
    assert len(dict(found)) == len(found)
    return dict(found)


def test_workers_do_every_task_once_and_end():
    found = finished(Local(2), number_and_process, range(100, 200))
    assert {n: task for n, (task, _) in found.items()} == dict(enumerate(range(100, 200)))
    assert len({process for _, process in found.values()} - {os.getpid()}) == 2
    assert not active_children()


@pytest.mark.parametrize("workers, tasks, seconds", [(1, 4, 9.0), (2, 1, 9.0), (2, 4, 0.15)])
def test_one_worker_one_task_or_little_work_starts_no_process(workers, tasks, seconds):
    found = list(Local(workers).completed(number_and_process, range(tasks), seconds))
    assert [result for _, result in found] == [(task, os.getpid()) for task in range(tasks)]


@pytest.mark.parametrize("sign", [signal.SIGKILL, signal.SIGTERM])
def test_tasks_of_a_killed_worker_are_done_by_others(sign, tmp_path):
    """The worker with task 3 is killed once: half as many workers do the remaining tasks."""
    once = tmp_path / "once"

    def killed(task):
        if task == 3 and not once.exists():
            once.touch()
            os.kill(os.getpid(), sign)
        return number_and_process(task)

    found = finished(Local(4), killed, range(30))
    assert {n: task for n, (task, _) in found.items()} == dict(enumerate(range(30))) and once.exists()
    assert os.getpid() not in {process for _, process in found.values()}


def test_a_task_that_kills_every_worker_is_done_by_this_process():
    own = os.getpid()

    def fatal(task):
        if task == 3 and os.getpid() != own:
            os.kill(os.getpid(), signal.SIGKILL)
        return number_and_process(task)

    found = finished(Local(2), fatal, range(8))
    assert sorted(found) == list(range(8)) and found[3] == (3, own)


def test_a_worker_killed_by_another_process_costs_no_result():
    """While it sends a large result."""
    pool = WorkerPool(lambda task: bytes(10**7), range(40), 2)
    threading.Timer(0.1, lambda: active_children()[0].kill()).start()
    with pool:
        assert sorted(number for number, _ in pool.completed()) == list(range(40))


def test_what_fails_in_a_worker_is_done_here_and_errors_are_raised(capfd):
    own = os.getpid()

    def there(task):
        if os.getpid() != own:
            raise RuntimeError("in a worker")
        return task

    def unpicklable(task):
        return (lambda: task) if os.getpid() != own else task

    def anywhere(task):
        raise RuntimeError(f"in {task}")

    for work in (there, unpicklable):
        assert finished(Local(2), work, range(6)) == {task: task for task in range(6)}
    with pytest.raises(RuntimeError, match=r"in \d"):
        finished(Local(2), anywhere, range(6))
    assert capfd.readouterr().err == "" and not active_children()


def test_workers_of_systems_without_fork_receive_the_work_pickled(monkeypatch):
    monkeypatch.setattr(local, "START_METHOD", "spawn")
    found = finished(Local(2), pickle.dumps, ["a", "b", "c"])
    assert found == {0: pickle.dumps("a"), 1: pickle.dumps("b"), 2: pickle.dumps("c")}


@pytest.fixture
def interruptible():
    """SIGINT raises KeyboardInterrupt, also if another test changed its handler."""
    before = signal.signal(signal.SIGINT, signal.default_int_handler)
    yield
    signal.signal(signal.SIGINT, before)


@pytest.mark.usefixtures("interruptible")
def test_an_interrupt_ends_all_workers_at_once(capfd):
    begin, own = time.monotonic(), os.getpid()

    def long(task):
        if task == 1:
            time.sleep(0.2)
            os.kill(own, signal.SIGINT)
        os.kill(os.getpid(), signal.SIGINT)  # as all receive it from a terminal
        time.sleep(60 * task)
        return task

    taken = []
    with pytest.raises(KeyboardInterrupt), closing(Local(2).completed(long, range(9))) as completed:
        taken += completed
    assert taken in ([], [(0, 0)]) and time.monotonic() - begin < 20
    assert capfd.readouterr().err == "" and not active_children()


def test_a_pool_works_in_the_background_and_can_be_stopped():
    with WorkerPool(number_and_process, range(6), 1) as pool:
        time.sleep(0.2)
        assert sorted(task for _, (task, _) in pool.completed()) == list(range(6))
    pool = WorkerPool(time.sleep, [60.0] * 4, 2)
    pool.stop()
    assert not active_children()


KILLED = """
import os, time
from mic.execution.local import Local
def work(task):
    os.write(1, b"%d\\n" % os.getpid())
    time.sleep(60)
list(Local(2).completed(work, range(2)))
"""


def test_workers_end_with_a_process_that_is_killed(tmp_path):
    environment = os.environ | {"TMPDIR": str(tmp_path)}
    command = [sys.executable, "-c", KILLED]
    with subprocess.Popen(command, stdout=subprocess.PIPE, text=True, env=environment) as process:
        workers = {int(process.stdout.readline()) for _ in range(2)}
        process.kill()
    assert len(workers - {process.pid}) == 2
    until = time.monotonic() + 20
    while (any(map(_runs, workers)) or list(tmp_path.iterdir())) and time.monotonic() < until:
        time.sleep(0.02)
    assert not any(map(_runs, workers)) and not list(tmp_path.iterdir())


def _runs(pid):
    """Whether a process runs: one that nobody has waited for does not."""
    try:
        return Path(f"/proc/{pid}/stat").read_text().rpartition(")")[2].split()[0] != "Z"
    except FileNotFoundError:
        return False


def test_an_engine_is_chosen_by_name_and_a_wrong_one_is_refused(monkeypatch):
    monkeypatch.setattr(local, "available_cores", lambda: 7)
    assert choose().workers == choose("local").workers == 7 and choose("local:3").workers == 3
    for name in ("cloud", "local:0", "local:many", "mpi:4"):
        with pytest.raises(RunError, match=f"engine {name}: give local, local:WORKERS, mpi, dask or dask:ADDRESS"):
            choose(name)
    with pytest.raises(RunError, match="engine mpi: one process was started; start several with mpirun"):
        choose("mpi")
    monkeypatch.setitem(sys.modules, "distributed", None)
    with pytest.raises(MissingLibrary, match="pip install distributed"):
        choose("dask")


def test_a_dask_cluster_does_every_task_also_of_a_killed_worker_and_raises_errors(tmp_path):
    pytest.importorskip("distributed", reason="Dask is not installed")
    engine, once = choose("dask"), tmp_path / "once"

    def killed(task):
        if task == "b" and not once.exists():
            once.touch()
            os.kill(os.getpid(), signal.SIGKILL)
        return pickle.dumps(task)

    assert finished(engine, killed, "abc") == {i: pickle.dumps(x) for i, x in enumerate("abc")} and once.exists()
    with pytest.raises(AttributeError):
        finished(engine, pickle.dumps, ["a", lambda: None])


def serve(task):
    """Do what a task says."""
    if task == "die":
        os.kill(os.getpid(), signal.SIGKILL)
    if task == "hang":
        time.sleep(60)
    if task == "fail":
        raise RunError("in the worker")
    return task, os.getpid(), open_connections()


def open_connections():
    """Number of network connections of this process."""
    numbers = set()
    for descriptor in os.listdir("/proc/self/fd"):
        with suppress(FileNotFoundError):  # that of this list
            numbers.add(os.readlink(f"/proc/self/fd/{descriptor}").removeprefix("socket:[").removesuffix("]"))
    return sum(line.split()[9] in numbers for line in Path("/proc/net/tcp").read_text().splitlines()[1:])


def test_a_standing_worker_outlives_its_errors_and_is_replaced_when_it_dies_or_hangs():
    with socket.create_server(("127.0.0.1", 0)) as server:
        (worker,) = Local(1).standing(serve)
        task, process, connections = worker.do("a", 9.0)
        assert task == "a" and process != os.getpid() and connections == 0 < open_connections(), server
        with pytest.raises(RunError, match="in the worker"):
            worker.do("fail", 9.0)
        assert worker.do("b", 9.0)[1] == process
        with pytest.raises(WorkerLost, match="the worker process was killed"):
            worker.do("die", 9.0)
        second = worker.do("c", 9.0)[1]
        start = time.monotonic()
        with pytest.raises(TimeoutError, match="no result after 0.1 s"):
            worker.do("hang", 0.1)
        assert worker.do("d", 9.0)[1] not in (process, second) and time.monotonic() - start < 5
        worker.stop()
    assert not active_children()


def test_ranks_do_not_serve():
    with pytest.raises(RunError, match="engine mpi: a service has no list of tasks to share"):
        Mpi(SimpleNamespace(size=2, rank=0)).standing(serve)


def test_a_standing_worker_of_a_dask_cluster_returns_results_and_errors():
    pytest.importorskip("distributed", reason="Dask is not installed")
    workers = choose("dask").standing(pickle.dumps)
    assert [worker.do("a", 20.0) for worker in workers] == [pickle.dumps("a")] * len(workers)
    with pytest.raises(AttributeError):
        workers[0].do(lambda: None, 20.0)
    for worker in workers:
        worker.stop()
