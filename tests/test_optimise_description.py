"""Description of a table [optimise] by `mic check`, before anything is computed."""

import re

import pytest
from support.springs import at_face, clamped
from typer.testing import CliRunner

import mic
from mic import examples
from mic.options import app
from mic.results.schema import COMPARISON, OPTIMA
from mic.studies.optimisation import BUDGET, FRESH
from mic.studies.optimisation.description import describe
from mic.system.foreign_files import ALSO_READ

PLACES = [[float(i), 0.0, 0.0] for i in range(1, 9)]
WHOLE = {
    "objective": "cost",
    "reject": 40,
    "of": ["M"],
    "forces": [{"clamps": ["C"], "between": [10, 100]}],
    "shims": [{"of": ["bl1"], "between": [-0.5, 0.25]}, {"of": ["T"], "between": [-1, 1]}],
    "orders": [{"stage": "clamp", "groups": [["C", "U", "V"], ["T"]]}],
    "places": [{"item": "locators.bl2", "points": PLACES}],
    "constraints": [
        {"quantity": "six-sigma", "of": ["M"], "at_most": 0.3},
        {"quantity": "force", "at_least": 5, "at_most": 90},
    ],
}


def built(table, folder=None):
    kinds = {"matching": [{"name": name, "file": str(folder / f"{name}.csv")} for name in "fr"]} if folder else {}
    clamps = [at_face("b", name="C", force=20.0), *(at_face("a", name=name, stroke=2.0) for name in "TUV")]
    items = [{"name": name, "kind": "locator", "target": f"{name}l1", "mean": 0.1, "sigma": 0.1} for name in "ba"]
    measured = [at_face("b", name="M", lower=0.5, upper=1.5)]
    return clamped("ba", 9.0, clamps=clamps, measurements=measured, deviations=items, optimise=table | kinds)


def words(table, folder=None):
    return describe(built(table, folder))


def test_variables_and_constraints_are_described():
    *told, effort = words(WHOLE)
    assert told == [
        "objective: minimise the cost of M over the variation of the inputs; an assembly outside its limits costs 40",
        "may change: force of C, 10 to 100 N (now 20)",
        "may change: shim of bl1, -0.5 to 0.25 mm (now 0)",
        "may change: stroke of T, 1 to 3 mm (now 2)",
        "may change: order of stage clamp: C+…+V, T; 2 orders",
        "may change: place of locators.bl2, to (1, 0, 0); (2, 0, 0); (3, 0, 0); (4, 0, 0); (5, 0, 0); (6, 0, 0) and 2 "
        "more",
        "constraint: 6σ of M is at most 0.3 mm",
        "constraint: the sum of the forces of all clamps is at least 5 N and at most 90 N",
    ]
    assert effort.startswith("effort: 18 designs of orders and places × 3 settings between bounds; ")
    assert f"{BUDGET:,} evaluations" in effort and f"{2 * FRESH:,}" in effort


def test_the_objective_is_described_with_its_weights():
    told = words({"objective": "largest-six-sigma", "weights": {"M": 2}, "forces": WHOLE["forces"]})
    assert told[0].startswith("objective: minimise the largest 6σ of all measurements")
    assert told[0].endswith("; weights: M 2") and told[-1].startswith("effort: 1 setting between bounds; ")
    told = words({"forces": WHOLE["forces"]})
    assert told[0].startswith("objective: maximise the least Cpk of all measurements ")


def test_measured_parts_are_counted_and_a_file_that_is_none_is_refused(tmp_path, monkeypatch):
    monkeypatch.setenv(ALSO_READ, str(tmp_path))
    (tmp_path / "f.csv").write_text("b\n0.1\n0.2\n0.3\n")
    (tmp_path / "r.csv").write_text("a\n0.1\n0.2\n")
    told = words({}, tmp_path)
    assert "to be matched: 3 parts f with measured b" in told and "to be matched: 2 parts r with measured a" in told
    assert told[-1].startswith("effort: 6 combinations of parts; ")
    (tmp_path / "r.csv").unlink()
    with pytest.raises(mic.SceneError, match=r"optimise\.matching\[1\]\.file \(r\)"):
        words({}, tmp_path)


def test_the_report_of_a_run_shows_its_optimum(tmp_path, monkeypatch):
    """Its tables go where the report is drawn from, with the run's folder held; elsewhere there is no page."""
    model, drawn = built({"forces": WHOLE["forces"], "of": ["M"]}), []
    monkeypatch.setattr("mic.commands.invocation.load_model", lambda console, source: (model, source))
    monkeypatch.setattr("mic.report.page.write_report", lambda folder: drawn.append(folder) or folder / "report.html")
    short = ["--samples", "20", "--fresh", "20", "--budget", "60", "--law", "frictionless"]
    for place in ([], ["--out", str(tmp_path / "elsewhere")]):
        done = CliRunner().invoke(app, ["optimise", str(tmp_path), *short, *place])
        assert done.exit_code == 0, done.output
        assert drawn == [tmp_path] and ("report: " in done.output) == (not place)
        folder = tmp_path / "elsewhere" if place else tmp_path
        assert len(OPTIMA.read(folder, "")) == len(COMPARISON.read(folder, "")) - 1 == 1


@pytest.mark.slow
@pytest.mark.fem
def test_check_refuses_a_candidate_off_its_part(tmp_path):
    """With its page, before anything is reduced."""
    folder = examples.copy("lap_joint", tmp_path / "joint")
    with (folder / "scene.toml").open("a") as file:
        file.write('\n[optimise]\nplaces = [{ item = "welds.W1", points = [[92, 64, 0.5]] }]\n')
    done = CliRunner().invoke(app, ["check", str(folder), "--page", str(tmp_path / "check.html")])
    said = str(done.exception)
    assert re.search(r"^optimise.places\[0\].points\[0\] \(welds.W1\): \[92, 64, 0.5\] is 39 mm", said)
    assert "\n" not in said and "[92, 25, 0]" in said
    assert "is 39 mm away from part" in (tmp_path / "check.html").read_text()
