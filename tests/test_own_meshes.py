"""The tutorial that starts from two meshes: its commands run, and give the numbers that it states."""

import contextlib
import io
import json
import os
import re
import subprocess
import sys
from pathlib import Path

import pandas as pd
import pytest
from support.runs import skip_pictures
from typer.testing import CliRunner

from mic.options import app

ROOT = Path(__file__).resolve().parents[1]
PAGE = (ROOT / "docs" / "own_meshes.md").read_text(encoding="utf-8")
TEXT = " ".join(PAGE.split())
BLOCKS = re.findall(r"^```(sh|text|python|toml)\n(.*?)^```", PAGE, re.M | re.S)

pytestmark = [pytest.mark.fem, pytest.mark.slow]


def run(command, folder, cache, alone):
    """Exit code and output of a command, in this process unless `alone`: to start another takes seconds."""
    words = command.replace("--samples 32", "--samples 16").split()
    environment = {"MIC_CACHE": str(cache), "COLUMNS": "200"}
    if words[0] == ".venv/bin/mic" and not alone:
        with contextlib.chdir(folder):
            done = CliRunner().invoke(app, words[1:], env=environment)
        return done.exit_code, done.output
    program = {".venv/bin/mic": ["-m", "mic.cli"], ".venv/bin/python": []}[words[0]]
    words = [str(ROOT / word) if word.startswith("docs/") else word for word in words[1:]]
    command = [sys.executable, *program, *words]
    done = subprocess.run(
        command, cwd=folder, capture_output=True, text=True, env=os.environ | environment, timeout=600
    )
    return done.returncode, done.stdout + done.stderr


def edit(scene, block):
    """Replace keys in the table of the scene that has the name given in a block of the page."""
    wanted = dict(line.split(" = ") for line in block.strip().splitlines())
    text = scene.read_text()
    start = text.index(f"name = {wanted.pop('name')}")
    end = text.index("\n\n", start)
    table = text[start:end]
    for key, value in wanted.items():
        table, count = re.subn(rf"^{key} = \S+", f"{key} = {value}", table, flags=re.M)
        assert count == 1
    scene.write_text(text[:start] + table + text[end:])


@pytest.fixture(scope="module")
def patched():
    with pytest.MonkeyPatch.context() as patch:
        yield patch


@pytest.fixture(scope="module")
def tutorial(tmp_path_factory, patched):
    """Outputs of all blocks of the page, in order, and the folder."""
    folder, cache = tmp_path_factory.mktemp("own"), tmp_path_factory.mktemp("cache")
    scene = folder / "panel+channel" / "scene.toml"
    outputs = []
    skip_pictures(patched.setattr)
    for number, (kind, block) in enumerate(BLOCKS):
        following = BLOCKS[number + 1] if number + 1 < len(BLOCKS) else ("", "")
        if kind == "sh":
            fails = following[0] == "text"
            code, printed = run(block.strip(), folder, cache, alone=fails)
            assert (code != 0) == fails, printed
            if scene.exists():  # no test reads the fields
                scene.write_text(scene.read_text().replace("fields = true", "fields = false"))
            outputs.append(" ".join(printed.split()))
        elif kind == "python":
            printed = io.StringIO()
            with contextlib.chdir(folder), contextlib.redirect_stdout(printed):
                exec(block, {})
            outputs.append(printed.getvalue())
        elif kind == "toml":
            edit(scene, block)
            outputs.append("")
        else:
            outputs.append(block.strip())
    return outputs, folder


def capability(folder, run):
    summary = json.loads((folder / "results" / run / "summary.json").read_text())
    return summary["laws"]["coulomb"]["measurements"]


def test_missing_data_are_reported_as_on_the_page(tutorial):
    outputs, _ = tutorial
    quoted = next(number for number, (kind, _) in enumerate(BLOCKS) if kind == "text")
    assert outputs[quoted] in outputs[quoted - 1]


def test_no_sample_of_the_runs_fails(tutorial):
    outputs, _ = tutorial
    assert sum("0 samples failed" in text for text in outputs) == 2


def test_the_first_run_leads_to_the_question_of_the_page(tutorial):
    """The corner that it names has by far the least capability, with the stated numbers."""
    _, folder = tutorial
    found = capability(folder, "panel+channel")
    name, six_sigma, cpk = re.search(r"`([\w-]+)`, a corner .*?6σ = (\d+\.\d+) mm.*?Cpk = (\d+\.\d+)", TEXT).groups()
    assert min(found, key=lambda one: found[one]["cpk"]) == name
    assert found[name]["six_sigma"] == pytest.approx(float(six_sigma), abs=0.01)
    assert found[name]["cpk"] == pytest.approx(float(cpk), abs=0.01) and float(cpk) < 1.33
    assert all(one["cpk"] > float(cpk) + 0.3 for key, one in found.items() if key != name)


def test_the_cause_is_the_one_that_the_page_names(tutorial):
    """The test has half the samples of the page: its interval contains the stated share, and the share of a linear
    analysis, which has no scatter, is near."""
    _, folder = tutorial
    name, cause, percent = re.search(r"contributor to `([\w-]+)` is `([\w-]+)`, with (\d+) %", TEXT).groups()
    table = pd.read_csv(folder / "results" / "panel+channel" / "tables" / "contributors.csv")
    shares = table[table["measurement"] == name].set_index("contributor")
    assert shares["total"].idxmax() == shares["tangent"].idxmax() == cause
    low, high = (100 * shares.loc[cause, bound] for bound in ("total_low", "total_high"))
    assert low < float(percent) < high and 100 * shares.loc[cause, "tangent"] == pytest.approx(float(percent), abs=5)


def test_the_decision_holds(tutorial):
    _, folder = tutorial
    cpk = float(re.search(r"is now ([\d.]+):", TEXT)[1])
    assert capability(folder, "better")["panel-M2"]["cpk"] == pytest.approx(cpk, abs=0.01)
    assert capability(folder, "panel+channel")["panel-M2"]["cpk"] + 0.25 < cpk < 1.33
