"""Shapes that were measured, through the whole program: a shape that forces made is scanned, and comes out again."""

from __future__ import annotations

import json
import shutil
import tomllib
from pathlib import Path

import numpy as np
import pandas as pd
import pytest
from typer.testing import CliRunner

import mic
from fem_reference.full.model import FullModel
from mic.model.assembly import assemble
from mic.options import app
from mic.scene.load import read_table
from mic.system.foreign_files import ALSO_READ

pytestmark = pytest.mark.fem
HAT = Path(__file__).resolve().parents[1] / "meshes" / "hat_on_plate"
FORCES = {"F1": 9.0, "F2": -7.0}  # N: they bend the hat by about a millimetre


@pytest.fixture(scope="module")
def table():
    table = tomllib.loads((HAT / "scene.toml").read_text())
    for part in table["parts"]:
        part["size"] = "coarse"
    for zone in table["zones"]:
        zone["pairs"] = 12
    table["report"] = {"laws": ["frictionless"]}
    return table


@pytest.fixture(scope="module")
def bent(table, cache):
    """The hat, how its vertices move under FORCES, and what its contacts and measurements read of that."""
    scene = read_table(table, HAT / "scene.toml")
    assembly, model = assemble(scene, cache), mic.reduce(scene, cache)
    values = np.array([FORCES.get(name, 0.0) for name in model.parameters])
    hat = next(part.surface for part in assembly.parts if part.name == "hat")
    field = FullModel(assembly).shape_fields(values)["hat"][:, :3]
    return hat, field, read(model, values)


def read(model, values):
    """What contacts and measurements read of the hat's shape, mm."""
    own = model.compliance.functionals[[part.name for part in model.scene.parts].index("hat")]
    rows = [model.rows[kind][:, own] for kind in ("contact", "measurement")]
    return np.concatenate([each @ (model.shape[own] @ values) for each in rows])


def scan(path, hat, field, amplitude=1.0, noise=0.0, seed=8):
    """3000 points of the bent hat, in a position of their own."""
    rng = np.random.default_rng(seed)
    triangle = rng.choice(len(hat.triangles), 3000, p=hat.areas / hat.areas.sum())
    weight = rng.dirichlet(np.ones(3), 3000)
    points = hat.at(triangle, weight) + amplitude * np.einsum("qi,qij->qj", weight, field[hat.triangles[triangle]])
    points += noise * rng.standard_normal((3000, 1)) * hat.normals[triangle] + [0.1, -0.05, 0.2]
    np.savetxt(path, points, delimiter=",", header="x,y,z", comments="")


@pytest.mark.slow
def test_scans_give_the_shape_that_was_planted_to_a_twentieth(table, bent, cache, tmp_path, monkeypatch):
    """Root mean square over the scans: one of noisy points errs by its own luck."""
    monkeypatch.setenv(ALSO_READ, str(tmp_path))
    hat, field, planted = bent
    items, noise, seeds = [], 0.05, [8, 9, 10]
    for seed in seeds:
        file = tmp_path / f"hat-{seed}.csv"
        scan(file, hat, field, noise=noise, seed=seed)
        items.append({"name": f"S{seed}", "kind": "measured", "part": "hat", "files": str(file), "noise": noise})
    model = mic.reduce(read_table(table | {"deviations": items}, HAT / "scene.toml"), cache)
    found = np.array([read(model, unit) for unit in np.eye(len(seeds))])
    scale = np.sqrt(np.mean(planted**2))
    assert scale > 0.2
    assert np.sqrt(np.mean((found - planted) ** 2)) < 0.05 * scale
    assert np.sqrt(np.mean((found + planted) ** 2)) > scale  # and on the right side


@pytest.mark.slow
def test_check_and_run_take_measured_pieces(table, bent, cache, tmp_path, monkeypatch, no_pictures):
    hat, field, _ = bent
    for i, amplitude in enumerate(1 + 0.3 * np.random.default_rng(1).standard_normal(9)):
        scan(tmp_path / f"hat-{i}.csv", hat, field, amplitude, 0.01, seed=i)
    shutil.copy(HAT / "geometry.py", tmp_path)
    text = (HAT / "scene.toml").read_text().replace('size = "medium"', 'size = "coarse"')
    text = text.replace("friction =", "pairs = 12\nfriction =")
    before, _, after = text.partition("[[deviations]]")
    item = '[[deviations]]\nname = "S"\nkind = "measured"\npart = "hat"\nfiles = "hat-*.csv"\npieces = true\n'
    rest = after[after.index("[[measurements]]") : after.index("[report]")]
    (tmp_path / "scene.toml").write_text(before + item + rest + '[report]\nlaws = ["frictionless"]\n')
    monkeypatch.setenv("MIC_CACHE", str(cache))
    monkeypatch.chdir(tmp_path)
    monkeypatch.setenv("COLUMNS", "200")
    checked = CliRunner().invoke(app, ["check", "."])
    assert checked.exit_code == 0, checked.output
    said = " ".join(checked.output.split())
    assert "deviations[0] (S): 9 pieces at" in said and "fitted by up to" in said and "The scene is valid" in said
    done = CliRunner().invoke(app, ["run", ".", "--samples", "40"])
    assert done.exit_code == 0, done.output
    outcome = mic.read_run(tmp_path / "results" / "hat-on-plate")
    values = pd.read_parquet(tmp_path / "results" / "hat-on-plate" / "deviations")
    assert len(np.unique(values["value"][values["deviation"] == "S.1"])) == 9
    assert not outcome.record["warnings"]
    kept = json.loads((tmp_path / "results" / "hat-on-plate" / "run.json").read_text())["inputs"]["files"]
    assert sum(name.startswith("S: hat-") for name in kept) == 9
