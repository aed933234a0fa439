"""Kernels are compiled at setup and not at the first evaluation."""

import os
import subprocess
import sys

import pytest

from mic.contact.laws import LAWS
from mic.system.compilation import MESSAGE

EVALUATE = """
import sys
import mic
from mic.contact.native.follower import follower
follower()
model = mic.ReducedModel.load(sys.argv[1])
for law in sys.argv[2:]:
    assert not model.evaluate({}, law).failed.any()
"""
ADDING = """
from numba import float64, njit

@njit(float64(float64), cache=True)
def one(x):
    return x + 1


@njit(float64(float64), cache=True)
def two(x):
    return x + 2
"""


def python(*arguments):
    environment = os.environ | {"NUMBA_DEBUG_CACHE": "1"}
    done = subprocess.run([sys.executable, *arguments], env=environment, capture_output=True, text=True, timeout=600)
    assert done.returncode == 0, done.stderr
    return done.stdout + done.stderr


@pytest.mark.slow
@pytest.mark.slow
def test_evaluations_compile_nothing_once_kernels_are_compiled(lap_model, tmp_path):
    lap_model.save(tmp_path / "model.npz")
    python("-m", "mic.commands.compile")
    output = python("-c", EVALUATE, str(tmp_path / "model.npz"), *(name for name, law in LAWS.items() if not law.reads))
    assert "data loaded from" in output and "data saved to" not in output and MESSAGE not in output


def test_compilation_is_reported_once_and_cached_code_silently_reused(tmp_path):
    (tmp_path / "adding.py").write_text(ADDING)
    command = "-c", f"import sys; sys.path.insert(0, {str(tmp_path)!r}); import mic.contact.native, adding"
    assert [python(*command).count(MESSAGE) for _ in range(2)] == [1, 0]
