"""Interrupted from outside: one line that says what is finished and how to go on."""

import os
import shutil
import signal
import subprocess
import sys
import time
from pathlib import Path

import pandas as pd
import pytest
from typer.testing import CliRunner

from mic.options import app
from mic.system.files import PARTIAL
from mic.system.lock import LOCK

pytestmark = [pytest.mark.robustness, pytest.mark.slow]

ROOT = Path(__file__).resolve().parents[1]


def test_an_interrupted_run_keeps_finished_blocks_and_the_same_call_completes_it(tmp_path, cache, monkeypatch):
    scene = shutil.copytree(ROOT / "meshes" / "lap_joint", tmp_path / "scene")
    text = (scene / "scene.toml").read_text().replace("fields = true", "").replace("medium", "coarse")
    (scene / "scene.toml").write_text(text.replace("friction = 0.27", "friction = 0.27\npairs = 6"))
    arguments = ["run", str(scene), "--law", "coulomb", "--out", "run", "--samples", "200", "--no-report"]
    options = {"cwd": tmp_path, "text": True, "env": os.environ | {"MIC_CACHE": str(cache)}}
    options |= {"stdout": subprocess.PIPE, "stderr": subprocess.PIPE}
    run = subprocess.Popen([sys.executable, "-m", "mic.cli", *arguments], **options)
    blocks = tmp_path / "run" / "samples" / "law=coulomb"
    while run.poll() is None and not list(blocks.glob("[!.]*")):
        time.sleep(0.001)
    run.send_signal(signal.SIGINT)
    told, errors = run.communicate(timeout=120)
    assert run.returncode == 130 and "Traceback" not in errors
    done = {path: path.stat().st_mtime_ns for path in blocks.glob("0*.parquet")}
    told = " ".join(told.split())
    assert done and f"{50 * len(done)} of 200 samples are finished" in told and "run the same command again" in told
    monkeypatch.chdir(tmp_path)
    again = CliRunner().invoke(app, arguments, env={"MIC_CACHE": str(cache)})
    assert again.exit_code == 0, again.output
    assert all(path.stat().st_mtime_ns == written for path, written in done.items())
    assert pd.read_parquet(tmp_path / "run" / "samples")["sample"].tolist() == list(range(200))
    assert not [path for path in (tmp_path / "run").rglob("*") if PARTIAL in path.name or path.name == LOCK]


LOST = """
import ctypes, os, signal, time
from mic import cli, options

def stop():
    os.kill(os.getpid(), signal.SIGTERM)

class Kept:
    __del__ = lambda self: stop()

def app():
    {where}
    time.sleep(30)

options.app = app
cli.main()
"""


@pytest.mark.parametrize("where", ["ctypes.CFUNCTYPE(None)(stop)()", "Kept()"])
def test_a_signal_in_code_that_cannot_raise_is_not_lost(where):
    program = LOST.format(where=where)
    told = subprocess.run([sys.executable, "-c", program], capture_output=True, text=True, timeout=20)
    assert told.returncode == 143 and "interrupted" in told.stderr and "Traceback" not in told.stderr, told.stderr


def test_a_process_stopped_at_its_exit_prints_nothing():
    program = "import os, signal; from mic import cli, options; from mic.execution import ranks\n"
    program += "options.app = lambda: None; ranks.exit_together = lambda *_: os.kill(os.getpid(), signal.SIGTERM)\n"
    program += "cli.main()"
    told = subprocess.run([sys.executable, "-c", program], capture_output=True, text=True, timeout=20)
    assert told.returncode == -signal.SIGTERM and not told.stderr, told.stderr
