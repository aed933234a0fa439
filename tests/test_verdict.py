"""The verdict of a run: yield, contributors of the worst characteristic, and estimated errors."""

import json
import shutil
from dataclasses import replace
from functools import partial

import numpy as np
import pandas as pd
import pytest
from support.runs import fail
from support.springs import dragged
from typer.testing import CliRunner

from mic.commands import run as run_command
from mic.options import app
from mic.report.page import write_report
from mic.report.style import change
from mic.report.verdict import verdict
from mic.results.error_sources import error_budget
from mic.results.outcome import read_outcome
from mic.results.schema import CONTRIBUTORS, DENSITY, LINEARITY, MESH_CHANGES, ORDERS, RARE, REMEDIES
from mic.results.statistic_tables import whole_yield
from mic.runs import run

SAMPLES = 30


@pytest.fixture(scope="module")
def folder(lap_scene, cache, tmp_path_factory):
    """M1 and M2 have limits that each some samples miss, not all of them the same."""
    limits = {"M1": {"lower": -1.5, "upper": -0.2}, "M2": {"lower": -0.75, "upper": 0.0}}
    changes = {
        "measurements": [item.model_copy(update=limits[item.name]) for item in lap_scene.measurements],
        "monte_carlo": lap_scene.monte_carlo.model_copy(update={"samples": SAMPLES, "seed": 2}),
        "report": lap_scene.report.model_copy(update={"laws": ["coulomb"], "fields": False}),
    }
    folder = tmp_path_factory.mktemp("answer") / "run"
    run(lap_scene.model_copy(update=changes), folder, cache)
    return folder


@pytest.fixture
def copied(folder, tmp_path):
    return shutil.copytree(folder, tmp_path / "run")


def required(outcome, **target):
    """The model of an outcome, whose scene requires another capability."""
    scene = outcome.model.scene
    return replace(outcome.model, scene=scene.model_copy(update={"report": scene.report.model_copy(update=target)}))


def beyond(outcome):
    """(n, k) which characteristics of which samples miss a limit."""
    items = outcome.model.scene.measurements
    x = np.column_stack([outcome.measured("coulomb", item.name) for item in items])
    return (x < [item.lower for item in items]) | (x > [item.upper for item in items])


@pytest.mark.slow
def test_the_yield_is_that_of_all_characteristics_together(folder):
    outcome = read_outcome(folder)
    out = beyond(outcome)
    good = 1 - out.any(axis=1).mean()
    assert (out.sum(axis=0) > 0).all() and good > 1 - out.mean(axis=0).sum()  # some miss both
    assert whole_yield(outcome, "coulomb").value == pytest.approx(good)
    told = json.loads((folder / "summary.json").read_text())["laws"]["coulomb"]["all_within"]
    assert told["share"] == pytest.approx(good) and told["outside_ppm"] == pytest.approx(1e6 * (1 - good))
    assert told["share_ci"][0] < good < told["share_ci"][1]
    by = f"counted among the samples ({out.any(axis=1).sum()} of {SAMPLES})."
    assert any(f" {100 * (1 - good):.1f} % (" in one and one.endswith(by) for one in verdict(outcome).sentences)


@pytest.mark.slow
def test_report_and_summary_state_the_same_verdict(folder):
    outcome = read_outcome(folder)
    told = json.loads((folder / "summary.json").read_text())["laws"]["coulomb"]
    first = verdict(outcome).sentences[0]
    worst = min(told["measurements"], key=lambda name: told["measurements"][name]["cpk"])
    assert told["verdict"]["verdict"] == "not capable" == told["measurements"][worst]["verdict"]
    assert first.startswith(f"Not capable: Cpk of {worst} is ") and "required at least 1.33" in first
    assert told["verdict"]["target_cpk"] == 1.33 and told["verdict"]["samples_needed"] is None


@pytest.mark.slow
@pytest.mark.parametrize(
    "target, opening",
    [
        ({"target_cpk": 0.5}, "Capable: Cpk of M1, the least capable, is 1.50 ("),
        ({}, f"Not decided by {SAMPLES} samples: Cpk of M1 is 1.50 ("),
        ({"target_cpk": 4.0}, "Not capable: Cpk of M1 is 1.50 ("),
        ({"target_outside": 0.5}, "Capable: the share outside limits is at most 11.6 %, required at most 50.0 %"),
        ({"target_outside": 0.001}, f"Not decided by {SAMPLES} samples: the share outside limits is at most 11.6 %"),
    ],
)
def test_the_requirement_of_the_scene_decides(folder, target, opening):
    """With limits that make Cpk 1.5 and 2 without a sample outside; none of 3687 outside would show 0.1 %."""
    outcome = read_outcome(folder)
    items = []
    for item, cpk in zip(outcome.model.scene.measurements, (1.5, 2.0)):
        x = outcome.measured("coulomb", item.name)
        half = 3 * cpk * x.std(ddof=1)
        items.append(item.model_copy(update={"lower": x.mean() - half, "upper": x.mean() + half}))
    model = required(outcome, **target)
    wide = replace(model, scene=model.scene.model_copy(update={"measurements": items}))
    first = verdict(read_outcome(folder, wide)).sentences[0]
    assert first.startswith(opening)
    assert ("samples would decide if" in first) == opening.startswith("Not decided")
    assert "target_outside" not in target or target["target_outside"] > 0.1 or "3700 samples" in first


def test_the_worst_characteristic_is_first_and_missing_studies_name_their_commands(copied):
    outcome = read_outcome(copied)
    found = verdict(outcome)
    cpk = [row["cpk"] for row in found.rows]
    assert cpk == sorted(cpk) and found.rows[0]["verdict"] == "out" and found.rows[0]["drivers"] is None
    said = " ".join(found.sentences)
    assert "Run `mic contributors " in said and "Run `mic friction " in said
    worst = found.rows[0]["measurement"]
    rows = [
        {"law": "coulomb", "measurement": worst, "contributor": name, **dict.fromkeys(CONTRIBUTORS.names[3:], share)}
        for name, share in (("F1", 0.3), ("F2", 0.7))
    ]
    CONTRIBUTORS.write(copied, pd.DataFrame(rows))
    line = dict.fromkeys(LINEARITY.names, 0.5)
    line |= {"law": "coulomb", "measurement": worst, "samples": 9, "failed": 0, "evaluations": 9, "linear": False}
    LINEARITY.write(copied, pd.DataFrame([line]))
    found = verdict(outcome)
    assert f"Cpk of {worst} is" in found.sentences[0]
    assert f"Main contributors of {worst}: F2 70 %, F1 30 %." in found.sentences
    assert "A linear analysis would mislead here" in " ".join(found.sentences)


def test_each_source_of_error_shows_its_estimate(copied):
    outcome = read_outcome(copied)
    table = outcome.measurement_statistics.set_index("measurement")
    budget = {one.name: one for one in error_budget(outcome, "coulomb")}
    assert list(budget) == ["samples", "path", "contact residuals", "meshes", "contact pairs", "order of the process"]
    half = (table["six_sigma_high"] - table["six_sigma_low"]).max() / 2
    assert budget["samples"].six_sigma == pytest.approx(half) and half > 0.1
    assert budget["path"].six_sigma == pytest.approx(table["six_sigma_path"].abs().max())
    assert 0 < budget["contact residuals"].six_sigma < 1e-8
    commands = {
        "meshes": "accuracy = true",
        "contact pairs": "mic check --converge",
        "order of the process": "mic order",
    }
    for name, command in commands.items():
        assert not budget[name].measured and command in budget[name].how
    orders = {"order": ["as stated", "reverse"], "quantity": "M1", "tolerance": 1.0, "samples": 9, "law": "coulomb"}
    orders |= {name: 0.0 for name in ORDERS.names if name not in orders} | {"six_sigma_change": [0.0, -0.017]}
    ORDERS.write(copied, pd.DataFrame(orders)[ORDERS.names])
    density = {"law": "coulomb", "measurement": ["M1", "M2"], "pairs": 24, "denser": 50, "nominal_change": 0.0}
    density |= {"mean_change": [0.001, -0.004], "six_sigma_change": [0.002, -0.003], "failed": 0}
    DENSITY.write(copied, pd.DataFrame(density))
    mesh = dict.fromkeys(MESH_CHANGES.names, 0.0) | {"law": "coulomb", "measurement": ["M1", "M2"]}
    mesh |= {"mean_change": [-0.003, 0.001], "six_sigma_change": [0.001, -0.002]}
    mesh |= dict.fromkeys(("nodes", "finer_nodes", "samples", "failed"), 9)
    MESH_CHANGES.write(copied, pd.DataFrame(mesh)[MESH_CHANGES.names])
    budget = {one.name: one for one in error_budget(outcome, "coulomb")}
    assert budget["order of the process"].six_sigma == pytest.approx(0.017)
    assert (budget["contact pairs"].mean, budget["contact pairs"].where) == (pytest.approx(0.004), "M2")
    assert (budget["meshes"].mean, budget["meshes"].six_sigma, budget["meshes"].where) == (0.003, 0.002, "M2")
    assert all(one.measured for one in budget.values())
    said = verdict(outcome).sentences[-1]
    total = float(np.sqrt(sum(one.six_sigma**2 for one in budget.values())))
    assert f"±{change(total).lstrip('+')} on 6σ, mostly from samples." in said
    orders["mean_change"] = [0.0, 40.0]
    ORDERS.write(copied, pd.DataFrame(orders)[ORDERS.names])
    said = verdict(outcome).sentences[-1]
    assert "on means (mostly order of the process), ±" in said and said.endswith("on 6σ (mostly samples).")


def test_thirty_samples_claim_less_than_95_per_cent(copied, no_pictures):
    """In verdict, report, summary and tables; 15 of 30 samples show what half of the assemblies do."""
    outcome = read_outcome(copied)
    (said,) = [one for one in verdict(outcome).sentences if one.startswith("Intervals: ")]
    assert "contain the true value if each effect occurs in at least 50.0 % of the assemblies; 30 samples" in said
    assert outcome.summary()["confidence_level"] == 0.9
    characteristics = outcome.summary()["laws"]["coulomb"]["measurements"].values()
    assert all((one["confidence"], one["rarest_event"]) == (0.9, 0.5) for one in characteristics)
    assert set(outcome.zone_statistics["confidence"]) == {0.9}
    page = write_report(copied, outcome).read_text(encoding="utf-8")
    assert said in page and "<p>90 % intervals" in page


def test_the_verdict_counts_failed_samples(copied):
    fail(copied, "coulomb", {3: ("clamp", "not converged")})
    last = verdict(read_outcome(copied)).sentences[-1]
    assert last == f"1 of {SAMPLES} samples failed or are missing and are excluded."


def test_the_verdict_shows_a_computed_rare_miss(copied):
    row = {"law": "coulomb", "measurement": "", "outside": 2.5e-5, "outside_low": 1e-5, "outside_high": 6e-5}
    row |= {"levels": 5, "evaluations": 5000, "failed": 0, "first_order": 2e-5, "agrees": True}
    RARE.write(copied, pd.DataFrame([row]))
    said = verdict(read_outcome(copied)).sentences
    assert "Expected assemblies outside a limit: 25 ppm (10 to 60), by subset simulation." in said
    assert not any("first-order estimate" in each for each in said)
    outcome = read_outcome(copied)
    openings = {1e-4: "Capable: the share outside limits is 25 ppm", 1e-6: "Not capable: ", 3e-5: "Not"}
    for target, opening in openings.items():
        found = verdict(read_outcome(copied, required(outcome, target_outside=target))).sentences[0]
        assert found.startswith(opening) and ("`mic rare` with more samples" in found) == (target == 3e-5)
    RARE.write(copied, pd.DataFrame([row | {"first_order": 2e-6, "agrees": False}]))
    said = verdict(read_outcome(copied)).sentences
    assert "The first-order estimate differs, 2.0 ppm: the limits are curved." in said


def test_the_verdict_shows_only_a_remedy_that_suffices(copied):
    row = {"law": "coulomb", "remedy": "together", "adjustment": "locators.A1", "change": -0.12, "value": -0.12}
    REMEDIES.write(copied, pd.DataFrame([row | {"reached": True, "rounds": 3}]))
    said = verdict(read_outcome(copied)).sentences
    assert "Remedy: locators.A1 −0.12 mm brings all characteristics within limits." in said
    REMEDIES.write(copied, pd.DataFrame([row | {"reached": False, "rounds": 3}]))
    assert not any("brings" in each for each in verdict(read_outcome(copied)).sentences)


@pytest.mark.slow
def test_a_run_computes_contributors_where_they_are_cheap(lap_scene, tmp_path, cache, monkeypatch):
    study = run_command.contributor_study
    monkeypatch.setattr(run_command, "load_scene", lambda source: lap_scene)
    monkeypatch.setattr(study, "contributors", partial(study.contributors, samples=4))
    arguments = ["run", "scene", "--samples", "10", "--law", "frictionless", "--no-report", "--out", str(tmp_path)]
    for cheap in (0.0, 1e6):
        monkeypatch.setattr(run_command, "CHEAP", cheap)
        done = CliRunner().invoke(app, arguments, env={"MIC_CACHE": str(cache), "COLUMNS": "200"})
        assert done.exit_code == 0, done.output
        assert (CONTRIBUTORS.read(tmp_path, "") is not None) == bool(cheap)
        assert ("Main contributors of " in done.output) == bool(cheap) != ("Run `mic contributors " in done.output)


def test_a_folder_with_the_model_of_another_run_is_refused(copied):
    dragged().save(copied / "model.npz")
    done = CliRunner().invoke(app, ["contributors", str(copied)])
    assert done.exit_code != 0 and "belongs to another run" in str(done.exception)
