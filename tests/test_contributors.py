"""Contributors: Sobol indices against closed forms, and the warning where a linear analysis misleads."""

from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pandas as pd
import pytest
from scipy.stats import binom
from support.springs import MU, at_face, clamped
from typer.testing import CliRunner

from mic.options import app
from mic.report.driver_sentences import linear_words, named
from mic.results.schema import CONTRIBUTORS, LINEARITY
from mic.statistics.sobol_indices import Linear, sobol
from mic.studies.contributors import contributors, groups, joint_ranking
from mic.studies.input_screening import bounds, negligible


def nothing_linear(inputs, samples, outputs=1):
    still = np.zeros((inputs, samples, outputs))
    return Linear(still, still, still[:, 0], still[:, 0])


def picked(function, inputs, samples, seed, linear=False):
    """Indices of a function of inputs that are uniform on -π … π."""
    a, b = np.random.default_rng(seed).uniform(-np.pi, np.pi, (2, samples, inputs))
    mixed = np.stack([a] * inputs)
    for i in range(inputs):
        mixed[i, :, i] = b[:, i]
    own = nothing_linear(inputs, samples)
    if linear:
        slopes = np.linalg.lstsq(np.concatenate([a, b]), function(np.concatenate([a, b])), rcond=None)[0]
        parts = [np.moveaxis(x * slopes, 1, 0)[..., None] for x in (a, b)]
        own = Linear(*parts, (slopes**2 * np.pi**2 / 3)[:, None], np.zeros((inputs, 1)))
    return sobol(function(a)[:, None], function(b)[:, None], function(mixed)[..., None], own)


def ishigami(x):
    """A. Saltelli et al.: Global Sensitivity Analysis, 2008, section 2.9."""
    return np.sin(x[..., 0]) + 7 * np.sin(x[..., 1]) ** 2 + 0.1 * x[..., 2] ** 4 * np.sin(x[..., 0])


V = 0.5 + 49 / 8 + 0.1 * np.pi**4 / 5 + 0.01 * np.pi**8 / 18
TOGETHER = 8 * 0.01 * np.pi**8 / 225
FIRST = np.array([0.5 * (1 + 0.1 * np.pi**4 / 5) ** 2, 49 / 8, 0.0]) / V
ISHIGAMI = {"first": FIRST, "total": FIRST + np.array([TOGETHER, 0.0, TOGETHER]) / V}


@pytest.mark.slow
def test_indices_of_a_function_in_closed_form():
    found = picked(ishigami, 3, 10_000, 1, linear=True)
    for name, wanted in ISHIGAMI.items():
        np.testing.assert_allclose(getattr(found, name).value[:, 0], wanted, atol=0.04)  # three standard errors
    assert found.sigma.value[0] == pytest.approx(np.sqrt(V), rel=0.01)
    assert found.interaction.value[0] == pytest.approx((ISHIGAMI["total"] - ISHIGAMI["first"]).max(), abs=0.04)


@pytest.mark.slow
def test_intervals_have_their_stated_coverage():
    """12 repetitions; the bound is the 0.1 % quantile of the hits of 95 % intervals.

    On a quarter of the samples, 92 % of the intervals of the first total index, the most skewed one, hold it.
    """
    inside = {"first": [], "total": []}
    for seed in range(12):
        found = picked(ishigami, 3, 1024, seed, linear=True)
        for name, wanted in ISHIGAMI.items():
            own = getattr(found, name)
            inside[name].append((own.low[:, 0] <= wanted) & (wanted <= own.high[:, 0]))
    for name, hits in inside.items():
        assert (np.sum(hits, axis=0) >= binom.ppf(0.001, 12, 0.95)).all(), (name, np.mean(hits, axis=0))


def test_a_linear_function_has_exact_indices():
    slopes = np.array([3.0, 1.0, 0.0, -2.0])
    found = picked(lambda x: x @ slopes, 4, 16, 3, linear=True)
    for index in (found.first, found.total):
        np.testing.assert_allclose(index.value[:, 0], slopes**2 / 14, atol=1e-12)
        np.testing.assert_allclose(index.high - index.low, 0.0, atol=1e-12)
    noisy = picked(lambda x: x @ slopes, 4, 16, 3)
    assert np.abs(noisy.first.value[:, 0] - slopes**2 / 14).max() > 0.05


def test_samples_with_a_failed_evaluation_are_excluded_and_counted():
    a, b, mixed = np.random.default_rng(1).standard_normal((3, 40, 1))
    whole = sobol(a[:30], b[:30], mixed[None, :30], nothing_linear(1, 30))
    a[30:34], b[34:37], mixed[37:] = np.nan, np.nan, np.nan
    found = sobol(a, b, mixed[None], nothing_linear(1, 40))
    np.testing.assert_array_equal(found.first.value, whole.first.value)
    assert (found.sigma.used, found.sigma.excluded) == (30, 10)


def test_a_constant_output_has_no_indices():
    same = np.full((20, 1), 0.3)
    found = sobol(same, same, same[None], nothing_linear(1, 20))
    assert np.isnan(found.first.value).all() and np.isnan(found.total.low).all()


def test_deviations_of_one_batch_are_one_contributor():
    items = [SimpleNamespace(name="F", batch=None), SimpleNamespace(name="S.1", batch="S")]
    items += [SimpleNamespace(name="L"), SimpleNamespace(name="S.2", batch="S")]
    scene = SimpleNamespace(deviations=items, correlations=[])
    assert groups(scene) == {"F": [0], "S": [1, 3], "L": [2]}
    scene.correlations = [SimpleNamespace(deviations=["L", "F"])]
    assert groups(scene) == {"S": [1, 3], "F + L": [0, 2]}


# ------------------------------------------------------------------------------------------------ contact


def moving(**sigma):
    """Deviations of locators, by name and target."""
    return [{"name": name[:-4], "kind": "locator", "target": name[-3:], "sigma": own} for name, own in sigma.items()]


@pytest.fixture(scope="module")
def dragged():
    """m lies between t and b, which move along x by ±D. Where P lifts m it is dragged along by t, where it sinks, by b.

    Without P nothing presses, without D nothing drags: neither moves m alone.
    """
    model = clamped(
        "bmt",
        0.0,
        MU,
        clamps=[at_face("t", (1, 0, 0), name="T", stroke=0), at_face("b", (-1, 0, 0), name="B", stroke=0)],
        measurements=[at_face("m", (1, 0, 0), name="M", lower=-1, upper=1)],
        deviations=[*moving(P_ml1=0.5), {"name": "D", "kind": "clamp", "target": ["T", "B"], "sigma": 0.5}],
    )
    return model, contributors(model, "coulomb", 500, seed=3)


@pytest.mark.slow
def test_two_deviations_that_matter_only_together_are_found(dragged):
    model, found = dragged
    own = found.table.set_index("contributor")
    assert (own["first"].abs() < 0.3).all() and (own["total"] > 0.7).all()  # 0 and 1, to four standard errors
    assert (own["total_low"] < 1.0).all() and (own["total_high"] > 1.0).all()
    # Lifted by h at its face, m is pressed with k h/2 and dragged by μ k h/2, which moves it by μ h/4.
    wanted = MU * 0.5 * 0.4 / 4
    at = [{"P": 0.4, "D": 2.0}, {"P": 0.4}, {"D": 2.0}, {"P": -0.4, "D": 2.0}]
    read = [model.evaluate(one, "coulomb").measurements[0, 0] for one in at]
    np.testing.assert_allclose(read, [wanted, 0.0, 0.0, -wanted], atol=1e-8)


def test_a_warning_states_that_a_linear_analysis_misses_them(dragged):
    _, found = dragged
    told = found.linearity.iloc[0]
    assert told["r_squared"] < 0.1 and told["tangent_sigma"] < 0.1 * told["sigma"] and not told["linear"]
    assert told["interaction_low"] > 0.5
    said = " ".join(linear_words(found.table, found.linearity))
    assert said.startswith("Warning: M: a linear analysis misleads") and "with interactions" in said and "R² is" in said


READ = [at_face("b", name="M", lower=-1, upper=1)]


@pytest.fixture(scope="module")
def closing():
    """The face of a comes down on b's in a fifth of the samples, which then moves by half of the overlap.

    b's own locator moves its face all the time, by a tenth of what the parts do that meet there.
    """
    gap = 0.595  # 0.8416 σ of the two that close it: P(closed) = 0.2
    model = clamped("ba", gap, measurements=READ, deviations=moving(A1_al1=1.0, A2_al2=1.0, B1_bl1=0.04))
    return model, contributors(model, "frictionless", 1000, seed=5)


@pytest.mark.slow
def test_differences_at_the_mean_miss_contributors_behind_a_gap_that_seldom_closes(closing):
    _, found = closing
    own, told = found.table.set_index("contributor"), found.linearity.iloc[0]
    # At the mean the gap is open: all that moves b is its own locator, by half of its 0.04 mm.
    np.testing.assert_allclose(own["tangent"], [0.0, 0.0, 1.0], atol=1e-9)
    assert told["tangent_sigma"] == pytest.approx(0.02, rel=0.02)
    # By hand: y = −max(z − g, 0)/2 + …, z = √½ σ of both; Var max(z − g, 0) = s² ((1 + c²) Q − c φ − (φ − c Q)²).
    s, c = np.sqrt(0.5), 0.595 / np.sqrt(0.5)
    phi, Q = np.exp(-(c**2) / 2) / np.sqrt(2 * np.pi), 0.2
    wanted = s**2 / 4 * ((1 + c**2) * Q - c * phi - (phi - c * Q) ** 2)
    assert told["sigma"] == pytest.approx(np.sqrt(wanted), rel=0.1)
    assert own["total"]["A1"] > 0.4 and own["total"]["A2"] > 0.4 and own["total"]["B1"] < 0.05
    said = " ".join(linear_words(found.table, found.linearity))
    assert "but derivatives at the mean would name B1" in said and not told["linear"]


@pytest.mark.slow
def test_a_nearly_linear_assembly_is_called_so_and_all_rankings_agree(lap_model):
    found = contributors(lap_model, "coulomb", 32, seed=1)
    CONTRIBUTORS.check(found.table, "memory", "mend it")
    LINEARITY.check(found.linearity, "memory", "mend it")
    assert found.linearity["linear"].all() and (found.linearity["r_squared"] > 0.99).all()
    for _, own in found.table.groupby("measurement"):
        ranks = own[["total", "regression", "tangent"]].rank()
        assert (ranks["total"].iloc[:2] == ranks["regression"].iloc[:2]).all()
        assert own["first"].sum() == pytest.approx(1.0, abs=0.05)
    assert "nearly linear" in linear_words(found.table, found.linearity)[0]
    assert found.linearity["evaluations"].unique().tolist() == [32 * 5 + 6]


@pytest.mark.slow
def test_many_small_contributors_count_as_one_and_their_bounds_hold():
    """M = Σ x_i/2: three that matter, of shares 16, 9 and 4 of 29.27, and 27 others of a hundredth each."""
    items = moving(L_bl1=0.4, N_bl1=0.3, K_bl1=0.2, **{f"S{i}_bl1": 0.01 for i in range(27)})
    items[0] |= {"distribution": "uniform"}
    items[3] |= {"distribution": "triang", "parameters": {"c": 0.3}}
    found = contributors(clamped("ba", 90.0, measurements=READ, deviations=items), "frictionless", 64, seed=1)
    CONTRIBUTORS.check(found.table, "memory", "mend it")
    own = found.table.set_index("contributor")
    assert list(own.index[:4]) == ["L", "N", "K", "27 others"] and len(own) == 31
    whole = 0.16 + 0.09 + 0.04 + 27e-4
    np.testing.assert_allclose(own["total"][:4], np.array([0.16, 0.09, 0.04, 27e-4]) / whole, atol=2e-3)
    assert own["total"][4:].isna().all()
    each = np.array([0.16, 0.09, 0.04] + [1e-4] * 27) / whole
    bound = own["bound"].drop("27 others").to_numpy()
    assert (bound >= each).all() and (bound <= 3 * each).all()
    assert found.linearity["evaluations"].tolist() == [64 * 6 + 60]
    words = linear_words(found.table, found.linearity)
    assert words[-1].startswith("27 contributors are combined into one: by their derivatives they contribute at most")
    assert named(found.table, "total").startswith("L 55 %, N 31 %, K 14 %")


def test_bounds_hold_for_a_nonlinear_assembly(closing):
    """The gap closes in a fifth of the samples."""
    model, found = closing
    bound = bounds(model, "frictionless", groups(model.scene), 400, seed=1)[:, 0]
    total = found.table.set_index("contributor")["total"]
    assert (bound >= total).all() and (0.25 * bound[:2] < total[:2]).all()  # and are not idle


def test_omitted_contributors_stay_below_the_limit():
    bound = np.array([[0.9, 0.001], [0.02, 0.0], [0.02, 0.04], [0.005, 0.02], [np.inf, np.inf]])
    assert negligible(bound, np.array([True, True])).tolist() == [False, True, False, True, False]
    assert negligible(bound, np.array([True, False])).tolist() == [False, True, True, True, False]
    assert not negligible(bound[[0, 1]], np.array([True, True])).any()  # one alone is no group


def with_scene(model, **change):
    return replace(model, scene=model.scene.model_copy(update=change))


def test_samples_that_cannot_be_drawn_or_read_are_refused_in_one_sentence(closing):
    model, _ = closing
    given = model.scene.monte_carlo.model_copy(update={"values": [[0.0, 0.0, 0.0]], "samples": 1})
    for change, words in (
        ({"monte_carlo": given}, "its samples are given in a table"),
        ({"deviations": []}, "has no deviations"),
        ({"measurements": []}, "has no measurements"),
    ):
        with pytest.raises(ValueError, match=words):
            contributors(with_scene(model, **change), "frictionless", 8)


def test_a_nearly_constant_characteristic_has_no_shares(closing, monkeypatch):
    monkeypatch.setattr("mic.studies.contributors.DRAWS", 500)
    quiet = [each.model_copy(update={"sigma": 1e-5}) for each in closing[0].scene.deviations]
    found = contributors(with_scene(closing[0], deviations=quiet), "frictionless", 20)
    assert found.table[["first", "total", "regression", "tangent"]].isna().all(axis=None)
    assert linear_words(found.table, found.linearity)[0].startswith("M hardly varies")


def test_the_joint_ranking_weighs_each_characteristic_by_how_much_of_its_tolerance_it_takes():
    items = [SimpleNamespace(name="wide", lower=-1.0, upper=1.0), SimpleNamespace(name="tight", lower=-0.1, upper=0.1)]
    rows = [("wide", "A", 0.9), ("wide", "B", 0.1), ("tight", "A", 0.2), ("tight", "B", 0.8)]
    table = pd.DataFrame([{"law": "coulomb", "measurement": m, "contributor": c, "total": t} for m, c, t in rows])
    linearity = pd.DataFrame({"law": "coulomb", "measurement": ["wide", "tight"], "sigma": [0.1, 0.01]})
    ranked = joint_ranking(table, linearity, SimpleNamespace(measurements=items)).set_index("contributor")["total"]
    np.testing.assert_allclose([ranked["A"], ranked["B"]], [0.55, 0.45])
    linearity["sigma"] = [0.1, 0.03]  # nine times the share of its tolerance, squared
    ranked = joint_ranking(table, linearity, SimpleNamespace(measurements=items))
    assert ranked["contributor"].tolist() == ["B", "A"]
    np.testing.assert_allclose(ranked["total"], [0.73, 0.27])
    assert named(ranked, "total") == "B 73 %, A 27 %"


def test_the_command_takes_a_saved_model_and_prints_its_results(closing, tmp_path, monkeypatch):
    monkeypatch.setattr("mic.studies.contributors.DRAWS", 500)
    model, _ = closing
    model.save(tmp_path / "model.npz")
    asked = ["contributors", str(tmp_path / "model.npz"), "--samples", "16", "--law", "frictionless"]
    done = CliRunner().invoke(app, asked, env={"COLUMNS": "160"})
    assert done.exit_code == 0, done.output
    wanted = contributors(model, "frictionless", 16, model.scene.monte_carlo.seed)
    ranked = joint_ranking(wanted.table, wanted.linearity, model.scene)
    assert f"All key characteristics together: {named(ranked, 'total')}" in done.output
    assert "86 evaluations" in done.output
