"""Run programs on several MPI processes."""

import os
import shutil
import subprocess
import sys
from functools import cache
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parents[2]


@cache
def launcher() -> list[str]:
    """Call of ``mpirun``, of this Python's virtual environment, else of the system; skip the test if there is none.

    More processes than cores, bound to none: MPICH does so by itself, Open MPI on request.
    """
    found = shutil.which("mpirun", path=os.pathsep.join([str(Path(sys.executable).parent), os.environ["PATH"]]))
    if found is None:
        pytest.skip("mpirun is not installed")
    name = subprocess.run([found, "--version"], capture_output=True, text=True).stdout
    return [found, "--oversubscribe", "--bind-to", "none"] if "Open MPI" in name else [found]


def start_processes(count: int, *program, stderr=subprocess.STDOUT, cwd=None, **environment) -> subprocess.Popen:
    """Start ``python PROGRAM …`` on `count` processes, one thread each; skip the test if there is no ``mpirun``."""
    settings = {
        "OMPI_ALLOW_RUN_AS_ROOT": "1",
        "OMPI_ALLOW_RUN_AS_ROOT_CONFIRM": "1",
        "OMPI_MCA_mpi_yield_when_idle": "1",  # waiting processes release their core; bound ones would wait for it
        "OMP_NUM_THREADS": "1",
        "OPENBLAS_NUM_THREADS": "1",
        "PYTHONPATH": os.pathsep.join([str(ROOT), str(ROOT / "tests")]),
    }
    return subprocess.Popen(
        [*launcher(), "-n", str(count), sys.executable, *map(str, program)],
        env=os.environ | settings | {name: str(value) for name, value in environment.items()},
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
