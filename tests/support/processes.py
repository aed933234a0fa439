"""Run programs on several MPI processes."""

import os
import subprocess
import sys
from pathlib import Path

import pytest

from verification.ranks.study import SETTINGS, launcher

ROOT = Path(__file__).resolve().parents[2]


def start_processes(count: int, *program, stderr=subprocess.STDOUT, cwd=None, **environment) -> subprocess.Popen:
    """Start ``python PROGRAM …`` on `count` processes, one thread each; skip the test if there is no ``mpirun``."""
    mpirun = launcher()
    if mpirun is None:
        pytest.skip("mpirun is not installed")
    path = os.pathsep.join([str(ROOT), str(ROOT / "tests")])
    return subprocess.Popen(
        [mpirun, "-n", str(count), sys.executable, *map(str, program)],
        env=os.environ | SETTINGS | {"PYTHONPATH": path} | {name: str(value) for name, value in environment.items()},
        stdout=subprocess.PIPE,
        stderr=stderr,
        cwd=cwd,
        text=True,
        errors="replace",
    )


def on_processes(count: int, *program, timeout: float = 900) -> subprocess.CompletedProcess:
    """Run ``python -m mpi4py PROGRAM …`` on `count` processes to its end; an error in one of them ends all."""
    with start_processes(count, "-m", "mpi4py", *program, stderr=subprocess.PIPE, cwd=ROOT) as process:
        try:
            stdout, stderr = process.communicate(timeout=timeout)
        except subprocess.TimeoutExpired:
            process.terminate()
            raise
    return subprocess.CompletedProcess(process.args, process.returncode, stdout, stderr)
