"""A run that is killed at a file operation and started again; `python -m support.killed` tries every operation."""

import json
import os
import subprocess
import sys

import pytest

pytestmark = pytest.mark.robustness


@pytest.mark.slow
def test_a_run_killed_at_any_file_operation_resumes_to_identical_bits(lap_model, tmp_path):
    lap_model.save(tmp_path / "model.npz")
    done = subprocess.run(
        [sys.executable, "-m", "support.killed", str(tmp_path / "model.npz"), str(tmp_path), "41"],
        capture_output=True,
        text=True,
        env=os.environ | {"OMP_NUM_THREADS": "1", "OPENBLAS_NUM_THREADS": "1"},
        timeout=600,
    )
    assert done.returncode == 0, done.stderr
    found = json.loads(done.stdout.splitlines()[-1])
    assert found["operations"] > 60  # the datasets alone write sixteen files, each by several operations
    assert found["wrong"] == {}, done.stderr
