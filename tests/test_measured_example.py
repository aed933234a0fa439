"""The example with measured point clouds: the planted shapes are found, and the commands of its page run."""

from __future__ import annotations

import json
import re
import runpy
import tomllib
from pathlib import Path

import numpy as np
import pytest
from typer.testing import CliRunner

import mic
from mic.model.assembly import assemble
from mic.model.shape import datum_rows
from mic.options import app
from verification.scenes import with_stated_pairs

ROOT = Path(__file__).resolve().parents[1]
FOLDER = ROOT / "meshes" / "hat_on_plate"
PAGE = (ROOT / "docs" / "howto.md").read_text(encoding="utf-8")
SECTION = PAGE[PAGE.index("## Use measured parts") :].partition("\n## ")[0]
MEASURE = runpy.run_path(str(FOLDER / "measure.py"))


def test_the_point_clouds_are_those_of_their_script():
    for piece in range(MEASURE["PIECES"]):
        assert (FOLDER / f"hat-{piece + 1:02}.csv").read_text(encoding="utf-8") == MEASURE["cloud"](piece)


def test_the_page_shows_tables_of_the_scene():
    """Its tables stand in the scene, key by key."""
    given = tomllib.loads((FOLDER / "measured.toml").read_text(encoding="utf-8"))
    shown = [tomllib.loads(block) for block in re.findall(r"```toml\n(.*?)```", SECTION, re.S)]
    items = {item["name"]: item for table in shown for item in table.get("deviations", [])}
    own = {item["name"]: item for item in given["deviations"]}
    assert {"hat", "plate"} <= items.keys() & own.keys()
    for name in items.keys() & own.keys():
        assert items[name].items() <= own[name].items()


@pytest.fixture(scope="module")
def model(cache):
    scene = with_stated_pairs(mic.load_scene(FOLDER / "measured.toml"))
    return assemble(scene, cache), mic.reduce(scene, cache)


@pytest.mark.fem
@pytest.mark.slow
def test_the_planted_shape_is_found(model):
    """Mean and spread of the pieces agree to 5 % at all contact pairs and measurements of the hat.

    A part is measured on its datum, so the rigid motion that its datum rows read is removed from the planted shapes.
    """
    assembly, reduced = model
    p = [part.name for part in assembly.parts].index("hat")
    part, own = assembly.parts[p], reduced.compliance.functionals[p]
    f = part.functionals
    at = np.array([one.weight @ part.surface.at(one.triangle, one.barycentric) for one in f.patches])[f.patch]
    G = reduced.compliance.G[p]
    datum = datum_rows(assembly, p, G)
    kinds = ("contact", "measurement")
    rows = [reduced.rows[kind][:, own] for kind in kinds]
    rows[0] = rows[0][:: reduced.contacts.dimension]

    def planted(*amplitude):
        y = MEASURE["deviation"](at, *amplitude) * f.direction[:, 2] * ~f.rotation  # all read level faces, along z
        y = y - G @ np.linalg.solve(datum @ G, datum @ y)
        return np.concatenate([each @ y for each in rows])

    names = reduced.parameters
    shapes = reduced.shape[own]
    modes = [j for j, name in enumerate(names) if re.fullmatch(r"hat\.\d+", name)]
    mean = np.concatenate([each @ shapes[:, names.index("hat.mean")] for each in rows])
    spread = np.concatenate([each @ shapes[:, modes] for each in rows])
    each = np.array([planted(*amplitude) for amplitude in MEASURE["amplitudes"]()])
    size = np.sqrt(np.mean(each**2))
    assert size > 0.1
    found = np.sqrt(np.mean((mean - each.mean(axis=0)) ** 2)) / size
    assert found < 0.05, f"the mean is {100 * found:.2g} % off"
    σ, expected = np.sqrt((spread**2).sum(axis=1)), each.std(axis=0, ddof=1)
    assert np.sqrt(np.mean(expected**2)) > 0.05
    found = np.sqrt(np.mean((σ - expected) ** 2) / np.mean(expected**2))
    assert found < 0.05, f"the spread is {100 * found:.2g} % off"


@pytest.mark.fem
@pytest.mark.slow
def test_the_commands_of_the_page_run(cache, tmp_path, monkeypatch, no_pictures):
    monkeypatch.chdir(tmp_path)
    for name in ("check", "run"):
        monkeypatch.setattr(f"mic.commands.{name}.load_scene", lambda path: with_stated_pairs(mic.load_scene(path)))
    monkeypatch.setenv("MIC_CACHE", str(cache))
    commands = re.findall(r"```sh\n(.*?)```", SECTION, re.S)[0].strip().splitlines()
    assert len(commands) == 3
    printed = ""
    for command in commands:
        words = command.split()
        assert words[0] == ".venv/bin/mic"
        done = CliRunner().invoke(app, words[1:], env={"COLUMNS": "200"})
        assert done.exit_code == 0, f"{command}: {done.output}{done.exception}"
        printed += " ".join(done.output.split())
    assert "12 pieces at 156 points" in printed and "The scene is valid" in printed
    outcome = mic.read_run(tmp_path / "results" / "hat-measured")
    assert outcome.record["samples"] == 50 and not outcome.failed["coulomb"] and not outcome.record["warnings"]
    inputs = json.loads((tmp_path / "results" / "hat-measured" / "run.json").read_text())["inputs"]["files"]
    assert sum(name.startswith("hat: hat-") for name in inputs) == 12
