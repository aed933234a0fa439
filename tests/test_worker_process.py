"""Work shared with a copy of the process: the same results in the same order, whatever becomes of the copy."""

import os
import signal
import subprocess
import sys
import time
from functools import partial
from multiprocessing import active_children
from pathlib import Path

import pytest

from mic.execution import worker_process
from mic.execution.worker_process import WorkerProcess, run_on_two_cores


@pytest.fixture(autouse=True)
def two_cores(monkeypatch):
    """As on a machine of two cores: the copy is made, whatever this one has."""
    monkeypatch.setattr(worker_process, "has_spare_core", lambda: True)


def done(number, seconds=0.02):
    """The task's number, and who did it."""
    time.sleep(seconds)
    return number, os.getpid()


def test_results_come_in_order_and_two_processes_did_them():
    found = run_on_two_cores([partial(done, number, 0.02 * (number < 20)) for number in range(300)])
    assert [number for number, _ in found] == list(range(300))
    assert len({who for _, who in found}) == 2
    assert [who for _, who in run_on_two_cores([partial(done, 0)])] == [os.getpid()]


@pytest.mark.slow
def test_a_worker_starts_at_once_and_ends_when_stopped():
    copy = WorkerProcess([partial(done, number) for number in range(6)])
    time.sleep(0.5)
    found = copy.results()
    copy.stop()
    assert [number for number, _ in found] == list(range(6))
    assert os.getpid() not in {who for _, who in found} and not active_children()
    unasked = WorkerProcess([partial(done, number, 60.0) for number in range(6)])
    unasked.stop()
    assert not active_children()


def test_each_result_comes_as_it_is_done_and_none_is_lost():
    own = os.getpid()
    with WorkerProcess([partial(done, number, 0.02 * (number < 20)) for number in range(300)]) as copy:
        found = dict(copy.completed([partial(done, 1000 + number, 0.02 * (number < 20)) for number in range(300)]))
    assert list(sorted(found)) == list(range(300)) and not active_children()
    assert all(number == task + 1000 * (who == own) for task, (number, who) in found.items())
    assert 0 < sum(who == own for _, who in found.values()) < 300


@pytest.mark.slow
def test_stopping_a_worker_that_sends_much_data_does_not_block():
    """In a process of its own, which is to end."""
    program = "from mic.execution import worker_process; worker_process.has_spare_core = lambda: True\n"
    program += "copy = worker_process.WorkerProcess([lambda: bytes(10**7)] * 1000)\n"
    program += "import time; time.sleep(0.3); copy.stop()"
    assert subprocess.run([sys.executable, "-c", program], timeout=60).returncode == 0


def test_without_a_second_core_no_copy_is_made(monkeypatch):
    monkeypatch.setattr(worker_process, "has_spare_core", lambda: False)
    assert {who for _, who in run_on_two_cores([partial(done, number) for number in range(4)])} == {os.getpid()}


@pytest.mark.parametrize("sign", [signal.SIGKILL, signal.SIGTERM])
def test_tasks_of_a_killed_worker_are_done_here(sign):
    own = os.getpid()

    def fatal(number):
        if os.getpid() != own:
            os.kill(os.getpid(), sign)
        return done(number)

    assert run_on_two_cores([partial(fatal, number) for number in range(6)]) == [(number, own) for number in range(6)]


def test_tasks_that_fail_in_the_worker_are_done_here_and_errors_are_raised(capfd):
    own = os.getpid()

    def there(number):
        if os.getpid() != own:
            raise RuntimeError("in the copy")
        return done(number)

    def anywhere(number):
        done(number)
        raise RuntimeError(f"in {number}")

    assert [number for number, _ in run_on_two_cores([partial(there, number) for number in range(6)])] == list(range(6))
    with pytest.raises(RuntimeError, match=r"in \d"):
        run_on_two_cores([partial(anywhere, number) for number in range(6)])
    assert capfd.readouterr().err == ""


@pytest.fixture
def interruptible():
    """SIGINT raises, whatever started the tests, or ran in this process before, has made of it."""
    before = signal.signal(signal.SIGINT, signal.default_int_handler)
    yield
    signal.signal(signal.SIGINT, before)


@pytest.mark.usefixtures("interruptible")
def test_an_interrupt_is_raised_once_and_ends_the_worker(capfd):
    def interrupted(number, own):
        if os.getpid() != own or number > 1:
            os.kill(os.getpid(), signal.SIGINT)  # as both hear it from a terminal
        return done(number)

    with pytest.raises(KeyboardInterrupt):
        run_on_two_cores([partial(interrupted, number, os.getpid()) for number in range(50)])
    assert capfd.readouterr().err == ""
    assert not active_children()


KILLED = """
import os, time
from mic.execution import worker_process
worker_process.has_spare_core = lambda: True
def task():
    os.write(1, b"%d\\n" % os.getpid())
    time.sleep(60)
worker_process.run_on_two_cores([task, task])
"""


def test_a_copy_ends_with_a_process_that_is_killed():
    with subprocess.Popen([sys.executable, "-c", KILLED], stdout=subprocess.PIPE, text=True) as process:
        pids = {int(process.stdout.readline()) for _ in range(2)}
        process.kill()
    assert process.pid in pids and len(pids) == 2
    (copy,) = pids - {process.pid}
    until = time.monotonic() + 20
    while _runs(copy) and time.monotonic() < until:
        time.sleep(0.02)
    assert not _runs(copy)


def _runs(pid):
    """Whether a process runs: one that nobody has waited for does not."""
    try:
        return Path(f"/proc/{pid}/stat").read_text().rpartition(")")[2].split()[0] != "Z"
    except FileNotFoundError:
        return False
