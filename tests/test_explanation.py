"""Sources of measured deviations: closed forms, coverage, indistinguishable sources, further measurements."""

from dataclasses import replace

import numpy as np
import pytest
from scipy import stats
from support.springs import LIFT, MU, PULL, at_face, clamped, dragged
from typer.testing import CliRunner

from mic.commands.explain import read_measured
from mic.errors import MicError, SceneError
from mic.options import app
from mic.report.explanation_page import sentences
from mic.results.schema import EXPLANATION, FURTHER
from mic.statistics.normal_space import from_normal, normal_derivatives
from mic.studies.explanation import explain, posterior

SIGMA, GAUGE = 0.1, 0.002
SLOPE = MU / 8  # of M, per mm of the locator


@pytest.fixture(scope="module")
def model():
    return dragged()


def row(found, name):
    return found.table.set_index("source").loc[name]


def test_a_linear_cause_is_that_of_the_closed_form(model):
    """Normal in, normal out: the posterior of P has precision 1/σ² + a²/s²; D does not move M at all."""
    value = MU * LIFT / 4 + 0.004
    found = explain(model, {"M": value}, GAUGE)
    EXPLANATION.check(found.table, "memory", "mend it")
    FURTHER.check(found.further, "memory", "mend it")
    variance = 1 / (1 / SIGMA**2 + SLOPE**2 / GAUGE**2)
    mean = 2 * LIFT + variance * SLOPE / GAUGE**2 * 0.004
    best = from_normal(found.scene, found.posterior.best[None])[0]
    assert best == pytest.approx([mean, PULL], abs=1e-6)
    own, spread = row(found, "P"), np.sqrt(variance)
    assert abs(own["mean"] - mean) < 4 * spread / np.sqrt(found.posterior.count)
    assert own["sigma"] == pytest.approx(spread, rel=4 / np.sqrt(2 * found.posterior.count))
    assert own["low"] == pytest.approx(mean - 1.96 * spread, abs=0.4 * spread)
    assert own["off"] == pytest.approx((own["mean"] - 2 * LIFT) / SIGMA)
    assert found.untold == ["D"] and found.table["source"].iloc[0] == "P" and not found.together
    square = 0.004**2 / (SLOPE**2 * SIGMA**2 + GAUGE**2)  # of what was measured, in units of what was to be expected
    assert found.posterior.least == pytest.approx(0.5 * square, rel=1e-5)
    assert found.likely == pytest.approx(stats.chi2.sf(square, 1), rel=1e-5)
    assert found.reached.set_index("measurement").loc["N", "mean"] == pytest.approx(PULL, abs=0.03)
    assert found.further["measurement"].tolist() == ["N"] and found.further["source"].iloc[0] == "D"
    assert found.further["told"].iloc[0] > 0.99


def test_a_finer_gauge_gives_more_information(model):
    everything = {"M": MU * LIFT / 4, "N": PULL}
    fine, coarse = (explain(model, measured, gauge) for measured, gauge in ((everything, 1e-4), ({"M": 0.0}, 1.0)))
    FURTHER.check(fine.further, "memory", "mend it")
    assert not len(fine.further) and not fine.untold
    assert coarse.further["told"].iloc[0] < 0.01 and coarse.further["bits"].iloc[0] < 0.01  # N varies by 0.05 mm
    assert row(fine, "P")["told"] > 0.99 and row(coarse, "P")["told"] < 0.2
    assert coarse.untold == ["D", "P"] or coarse.untold == ["P", "D"]


def two_lifting(**changes):
    """Two locators lift b alike."""
    deviations = [
        {"name": name, "kind": "locator", "target": target, "mean": LIFT, "sigma": SIGMA}
        for name, target in (("P", "bl1"), ("Q", "bl2"))
    ]
    return dragged(deviations=deviations, clamps=[at_face("t", (1, 0, 0), name="T", stroke=PULL)], **changes)


def test_indistinguishable_sources_are_named():
    found = explain(two_lifting(), {"M": MU * LIFT / 4 + 0.001}, 1e-5)
    assert found.together == [("P", "Q")]
    assert "cannot separate P and Q" in " ".join(sentences(found))


def test_measurements_outside_the_model_are_not_explained(model):
    found = explain(model, {"M": MU * LIFT / 4 + 10 * SLOPE * SIGMA}, 1e-4)
    assert found.likely < 1e-10 and "does not explain" in " ".join(sentences(found))
    assert row(found, "P")["off"] > 8
    likely = explain(model, {"M": MU * LIFT / 4}, 1e-4)
    assert likely.likely > 0.5 and "No source is unusual" in sentences(likely)[0]


def test_a_deviation_with_the_name_of_an_unknown_friction_is_refused(model):
    items = [item.model_copy(update={"name": "friction_of_z"}) for item in model.scene.deviations[:1]]
    scene = model.scene.model_copy(update={"deviations": [*items, *model.scene.deviations[1:]]})
    with pytest.raises(SceneError, match="'friction_of_z' is needed by --friction; rename the deviation"):
        explain(replace(model, scene=scene), {"M": 0.0}, GAUGE, friction=0.1)


def test_friction_may_be_among_the_unknown(model):
    """N and P are known well by what is measured at them; then M tells μ."""
    still = [
        {"name": "P", "kind": "locator", "target": "bl1", "mean": 2 * LIFT, "sigma": 1e-6},
        {"name": "D", "kind": "clamp", "target": "T", "mean": PULL, "sigma": 0.05},
    ]
    found = explain(dragged(deviations=still), {"M": 0.2 * LIFT / 4}, 1e-5, friction=0.1)
    own = row(found, "friction_of_z")
    assert MU + own["mean"] == pytest.approx(0.2, abs=1e-3) and own["low"] < -0.1 < own["high"] and own["told"] > 0.99


@pytest.mark.slow
def test_the_credible_region_covers_the_truth_where_contacts_change_state():
    """b rises to t across a gap that half of the samples close: what N and M read has a kink there. 20 made assemblies
    of which only the upper part was measured: 95 %, less and more three standard errors."""
    model = clamped(
        "bt",
        0.2,
        measurements=[at_face("t", name="N", lower=-1, upper=1), at_face("b", name="B", lower=-1, upper=1)],
        deviations=[
            {"name": "P", "kind": "locator", "target": "bl1", "mean": 0.4, "sigma": 0.15},
            {"name": "Q", "kind": "locator", "target": "tl1", "mean": 0.0, "sigma": 0.15},
        ],
    )
    draws, cases = np.random.default_rng(11), 20
    z = draws.standard_normal((cases, 2))
    h = model.process("frictionless").evaluate(from_normal(model.scene, z)).measurements[:, :1]
    y = h + 0.01 * draws.standard_normal(h.shape)
    found = [posterior(model, [0], y[i], np.array([0.01]), "frictionless", seed=i) for i in range(cases)]
    assert all(one.count >= 50 for one in found)
    hits = np.mean([one.holds(own) for one, own in zip(found, z)])
    assert abs(hits - 0.95) < 3 * np.sqrt(0.95 * 0.05 / cases), hits


def test_the_proposed_further_point_reduces_the_uncertainty_most():
    """Two locators lift b's face alike; L reads one of them, R a tenth of the other, N neither. Each is measured in
    turn: the remaining uncertainty of both is least where it was predicted to be."""
    places = (("L", "b", [10, 0, 0]), ("R", "b", [5.5, 4.5, 0]), ("N", "t", [10, 0, 0]))
    further = [
        {"name": name, "part": part, "point": point, "direction": [0, 0, 1], "lower": -1, "upper": 1}
        for name, part, point in places
    ]
    model = two_lifting(measurements=[at_face("b", (1, 0, 0), name="M", lower=-1, upper=1), *further])
    true = model.evaluate({"P": LIFT + 1.5 * SIGMA, "Q": LIFT - SIGMA}).measurements[0]
    values = dict(zip(("M", "L", "R", "N"), true))
    found = explain(model, {"M": values["M"]}, 1e-3)
    assert found.further["measurement"].tolist() == ["L", "R", "N"]
    assert (np.diff(found.further["bits"]) < 0).all()
    after = {name: explain(model, {"M": values["M"], name: values[name]}, 1e-3) for name in "LRN"}
    left = [after[name].table["sigma"].sum() for name in "LRN"]
    assert left[0] < left[1] < left[2]
    for name in "LR":
        told = found.further.set_index("measurement").loc[name]
        before, then = (row(one, told["source"])["sigma"] ** 2 for one in (found, after[name]))
        assert then == pytest.approx((1 - told["told"]) * before, abs=0.02 * before)


def test_the_error_of_the_search_is_reported_if_it_exceeds_the_gauge(model):
    found = explain(model, {"M": MU * LIFT / 4}, 1e-3)
    assert (found.posterior.error < 1e-8).all()  # all is linear here
    blunt = replace(found, posterior=replace(found.posterior, error=np.array([6e-4, 0.0])))
    assert not any("widens the intervals" in said for said in sentences(found))
    assert any("has an error of 0.60 µm for M, with a gauge of 1.0 µm" in said for said in sentences(blunt))


def test_slopes_of_distributions_are_those_of_their_quantiles(model):
    """dx/dz = σ/s φ(z)/f(F⁻¹(Φ(z))), s the standard deviation of the distribution and f its density."""
    items = model.scene.model_dump(mode="json")["deviations"]
    items[0] |= {"distribution": "triang", "parameters": {"c": 0.3}}
    scene = type(model.scene)(**model.scene.model_dump(mode="json") | {"deviations": items})
    triangle, z = stats.triang(0.3), np.array([[0.3, -0.7], [-2.0, 1.0]])
    slopes = normal_derivatives(scene, z)
    density = triangle.pdf(triangle.ppf(stats.norm.cdf(z[:, 0])))
    np.testing.assert_allclose(slopes[:, 0, 0], SIGMA / triangle.std() * stats.norm.pdf(z[:, 0]) / density, rtol=1e-6)
    np.testing.assert_allclose(slopes[:, 1, 1], 0.05, rtol=1e-8)
    assert (slopes[:, 0, 1] == 0).all() and (slopes[:, 1, 0] == 0).all()


@pytest.mark.parametrize(
    ("text", "said"),
    [
        ("measurement,value,sigma\nM,1,1\n", "M, column gauge: no standard deviation of the gauge; give mm"),
        ("measurement,value\nM,1\n", "no standard deviation of the gauge; give mm, in the file or by --gauge"),
        ("measurement,value,gauge\nM,1,0\n", "M, column gauge: 0, not a number above 0"),
        ("measurement,value,gauge\nM,a,1\n", "row 2, column value: 'a' is not a finite number"),
    ],
)
def test_an_invalid_file_is_refused_in_one_sentence(model, text, said, tmp_path):
    path = tmp_path / "measured.csv"
    path.write_text(text)
    with pytest.raises(SceneError) as refused:
        read_measured(path, None, model.scene)
    assert said in str(refused.value) and str(path) in str(refused.value)


def test_decimal_commas_and_a_gauge_for_all_are_read(model, tmp_path):
    path = tmp_path / "measured.csv"
    path.write_text("measurement;value;gauge\nM;0,5;\nN;-1,25;0,1\n\n")
    assert read_measured(path, 0.02, model.scene)[:2] == ({"M": 0.5, "N": -1.25}, {"M": 0.02, "N": 0.1})


def test_one_of_several_assemblies_is_chosen_by_its_serial_number(model, tmp_path):
    path = tmp_path / "measured.csv"
    path.write_text("Feature,Nominal,Actual,Serial\nM,1,1.5,A\nM,1,1.7,B\n")
    assert read_measured(path, 0.02, model.scene, "B")[0] == {"M": pytest.approx(0.7)}
    with pytest.raises(SceneError, match="the file holds 2 assemblies; choose one by --piece: A, B"):
        read_measured(path, 0.02, model.scene)
    with pytest.raises(SceneError, match="the file holds no assembly 'C'; choose one by --piece: A, B"):
        read_measured(path, 0.02, model.scene, "C")


@pytest.mark.parametrize(
    ("measured", "gauge", "said"),
    [
        ({}, 0.1, "no measurement is given"),
        ({"O": 1.0}, 0.1, "has no key characteristic 'O'; it has: M, N"),
        ({"M": np.inf}, 0.1, "measured: 'M' is inf; give a finite number"),
        ({"M": 1.0}, 0.0, "gauge is 0.0; give a finite number above 0"),
        ({"M": 1.0}, {"N": 0.1}, "no positive standard deviation"),
    ],
)
def test_invalid_measurements_are_refused(model, measured, gauge, said):
    with pytest.raises(MicError, match=said):
        explain(model, measured, gauge)


def test_the_command_writes_a_page_and_tables(model, tmp_path):
    model.save(tmp_path / "model.npz")
    (tmp_path / "measured.csv").write_text(f"measurement,value\nM,{MU * LIFT / 4 + 3.5 * SLOPE * SIGMA}\n")
    asked = ["explain", str(tmp_path / "model.npz"), "--measured", str(tmp_path / "measured.csv"), "--gauge", "0.0005"]
    done = CliRunner().invoke(app, [*asked, "--out", str(tmp_path / "out")], env={"COLUMNS": "160"})
    assert done.exit_code == 0, done.output
    assert "Most probable cause: P at" in done.output and "The most useful further measurement is N" in done.output
    assert EXPLANATION.read(tmp_path / "out", "")["source"].tolist() == ["P", "D"]
    page = (tmp_path / "out" / "explanation.html").read_text(encoding="utf-8")
    assert "Most probable cause: P at" in page and page.count("data:image/svg+xml") == 2
    (tmp_path / "measured.csv").write_text("measurement,value\nO,1\n")
    other = CliRunner().invoke(app, [*asked, "--out", str(tmp_path / "other")])
    said = str(other.exception)
    assert "measured.csv" in said and "no key characteristic 'O' in this scene; known: M, N; correct the name" in said
