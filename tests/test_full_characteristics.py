"""Key characteristics beyond a point, through the whole program: against the full solve, and in a run's tables."""

from __future__ import annotations

import tomllib
from pathlib import Path

import numpy as np
import pandas as pd
import pytest

import mic
from fem_reference.full.model import FullModel
from mic.model.assembly import assemble
from mic.report import picture_registry
from mic.report.context import read_context
from mic.scene.load import read_table
from mic.statistics.draw import draw

pytestmark = pytest.mark.fem
LAP = Path(__file__).resolve().parents[1] / "meshes" / "lap_joint" / "scene.toml"
ENDS = {"part": "lower", "point": [90, 12.5, 0], "to": {"part": "upper", "point": [105, 12.5, 1]}}
LIMITS = {"lower": -0.5, "upper": 0.5}
TIP = {"part": "upper", "point": [157, 12.5, 1], "direction": [0, 0, 1]}
KINDS = [
    {"name": "tip"} | TIP | LIMITS,
    {"name": "flush", "kind": "flush"} | ENDS | LIMITS,
    {"name": "gap", "kind": "gap"} | ENDS | LIMITS,
    {"name": "distance", "kind": "distance"} | ENDS | LIMITS,
    {"name": "fitted", "best_fit": ["tip", "surface"]} | TIP | LIMITS,
    {"name": "edge", "kind": "parallelism", "part": "upper", "upper": 0.2}
    | {"points": [[155, y, 1] for y in (3, 9, 16, 22)], "direction": [0, 0, 1]},
    {"name": "surface", "kind": "profile", "part": "upper", "spacing": 20.0, "upper": 2.0},
]


@pytest.fixture(scope="module")
def table():
    table = tomllib.loads(LAP.read_text())
    for part in table["parts"]:
        part["size"] = "coarse"
    following = ("clamp", "release")
    table["stages"] = [each | ({"increments": 1} if each["kind"] in following else {}) for each in table["stages"]]
    return table | {
        "zones": [each | {"pairs": 12} for each in table["zones"]],
        "measurements": KINDS,
        "report": {"laws": ["coulomb"]},
        "monte_carlo": {"samples": 12, "seed": 3},
    }


def test_the_full_solve_reads_the_same(table, cache):
    scene = read_table(table, LAP)
    sample = draw(scene, 5, 0, 1)[0]
    full = FullModel(assemble(scene, cache), route="condensed").evaluate(sample, "coulomb").measurements
    reduced = mic.reduce(scene, cache).evaluate(sample, "coulomb").measurements[0]
    np.testing.assert_allclose(full, reduced, rtol=0, atol=1e-7 * np.abs(reduced).max())
    assert np.abs(reduced).min() > 1e-3 and len(np.unique(reduced.round(6))) == len(KINDS)


def test_a_run_reports_every_point_and_judges_one_sided_limits(table, cache, tmp_path, monkeypatch):
    monkeypatch.setenv("MIC_CACHE", str(cache))
    folder = tmp_path / "run"
    outcome = mic.run(read_table(table, LAP), folder, cache)
    profiles = pd.read_parquet(folder / "profiles")
    measured = pd.read_parquet(folder / "measurements")
    for name, made in (("surface", lambda r: 2 * r.abs().max()), ("edge", lambda r: r.max() - r.min())):
        of = profiles[profiles["measurement"] == name].groupby("sample")["value"].apply(made)
        told = measured[measured["measurement"] == name].set_index("sample")["value"]
        np.testing.assert_allclose(told, of, rtol=1e-12)
        assert told.std() > 1e-3
    points = pd.read_csv(folder / "tables" / "profiles.csv").query("measurement == 'surface'")
    values = profiles[profiles["measurement"] == "surface"].pivot(index="sample", columns="point", values="value")
    np.testing.assert_allclose(points["mean"], values.mean(), rtol=1e-6)
    np.testing.assert_allclose(points["six_sigma"], 6 * values.std(), rtol=1e-6)
    row = pd.read_csv(folder / "tables" / "measurements.csv").set_index("measurement").loc["surface"]
    surface = measured[measured["measurement"] == "surface"]["value"]
    assert row["cpk"] == pytest.approx((2.0 - surface.mean()) / (3 * surface.std()), rel=1e-6)
    assert np.isnan(row["cp"]) and np.isfinite(row["cpk"])
    picture = picture_registry.draw("deviation-maps", outcome, read_context(outcome))
    assert all(f"largest variation of {name} at" in picture.caption for name in ("surface", "edge"))
