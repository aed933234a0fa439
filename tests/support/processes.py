"""Programs that tests run on several processes."""

import os
import shutil
import subprocess
import sys
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parents[2]


def on_processes(count: int, *program, timeout: float = 900) -> subprocess.CompletedProcess:
    """Run ``python PROGRAM …`` on `count` processes, one thread each; skip the test where there is no ``mpirun``."""
    if shutil.which("mpirun") is None:
        pytest.skip("mpirun is not installed")
    environment = os.environ | {
        "OMPI_ALLOW_RUN_AS_ROOT": "1",
        "OMPI_ALLOW_RUN_AS_ROOT_CONFIRM": "1",
        "OMPI_MCA_mpi_yield_when_idle": "1",  # who waits leaves the core to the others
        "OMP_NUM_THREADS": "1",
        "PYTHONPATH": os.pathsep.join([str(ROOT), str(ROOT / "tests")]),
    }
    command = ["mpirun", "--oversubscribe", "-n", str(count), sys.executable, "-m", "mpi4py", *map(str, program)]
    return subprocess.run(command, env=environment, cwd=ROOT, capture_output=True, text=True, timeout=timeout)
