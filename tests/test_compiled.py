"""Compiled code that is made when the program is set up, not when it is first used."""

import os
import subprocess
import sys

from mic.contact.laws import LAWS

EVALUATE = """
import sys
import mic
model = mic.ReducedModel.load(sys.argv[1])
for law in sys.argv[2:]:
    assert not model.evaluate({}, law).failed.any()
"""


def python(*arguments):
    environment = os.environ | {"NUMBA_DEBUG_CACHE": "1"}
    done = subprocess.run([sys.executable, *arguments], env=environment, capture_output=True, text=True, timeout=600)
    assert done.returncode == 0, done.stderr
    return done.stdout


def test_once_the_kernels_are_compiled_no_evaluation_compiles(lap_model, tmp_path):
    lap_model.save(tmp_path / "model.npz")
    python("-m", "mic.commands.compile")
    told = python("-c", EVALUATE, str(tmp_path / "model.npz"), *(name for name, law in LAWS.items() if not law.reads))
    assert "data loaded from" in told and "data saved to" not in told
