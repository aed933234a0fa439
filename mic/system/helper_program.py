"""Run another program: with a time limit, ended together with all processes that it started."""

from __future__ import annotations

import os
import signal
import subprocess
from collections.abc import Mapping, Sequence
from contextlib import suppress
from pathlib import Path
from typing import IO

try:
    import resource
except ImportError:  # not a POSIX system
    resource = None  # type: ignore[assignment]

__all__ = ["run_program"]


def run_program(
    command: Sequence[str],
    seconds: float,
    environment: Mapping[str, str],
    folder: Path | None = None,
    output: IO[bytes] | None = None,
    memory: float | None = None,
) -> int | None:
    """Exit status of a program, negative for a signal; None if it exceeds its time.

    Parameters
    ----------
    command : sequence of str
    seconds : float
        Time limit.
    environment : mapping of str to str
        All environment variables of the program.
    folder : Path, optional
        Its working folder. Default: that of this process.
    output : binary file, optional
        Receives what it prints. Default: that is discarded.
    memory : float, optional
        Limit of its address space, bytes, on systems that have one (Linux); its processor time is then limited, too.
    """
    process = subprocess.Popen(
        command,
        stdin=subprocess.DEVNULL,
        stdout=output if output is not None else subprocess.DEVNULL,
        stderr=subprocess.STDOUT,
        env=dict(environment),
        cwd=folder,
        start_new_session=True,  # so that its child processes end with it
    )
    try:
        if memory is not None and hasattr(resource, "prlimit"):
            most = resource.getrlimit(resource.RLIMIT_AS)[1]
            limit = int(memory) if most == resource.RLIM_INFINITY else min(int(memory), most)
            with suppress(ProcessLookupError):  # it has ended
                resource.prlimit(process.pid, resource.RLIMIT_AS, (limit, limit))
                # If this process is killed, the helper ends by itself, too.
                resource.prlimit(process.pid, resource.RLIMIT_CPU, (int(seconds) + 1, int(seconds) + 1))
        return process.wait(seconds)
    except subprocess.TimeoutExpired:
        return None
    finally:
        _end(process)


def _end(process: subprocess.Popen) -> None:
    """End a process, and on POSIX all processes that it started."""
    try:
        if os.name == "posix":
            os.killpg(process.pid, signal.SIGKILL)
        else:
            process.kill()
    except ProcessLookupError:
        pass  # it has ended
    process.wait()
