"""The two-level estimate on populations with a known answer, and the verification of a user's scene."""

import json
from types import SimpleNamespace

import numpy as np
import pytest
from scipy.stats import t as student

import mic
from fem_reference.full.model import ContactFailure, FullModel
from mic.errors import SceneError
from mic.statistics import estimates
from verification import own_scene
from verification.own_scene import choose, verify_scene
from verification.scenes import with_path, with_stated_pairs
from verification.study import FOLDER, Team
from verification.two_level import two_level

pytestmark = pytest.mark.fem

INTERCEPT, SLOPE, NOISE = 0.5, 1.2, 0.15  # x = INTERCEPT + SLOPE y + NOISE e
MEAN, SIGMA = INTERCEPT + SLOPE * 5.0, np.hypot(SLOPE * 2.0, NOISE)  # with y normal, of mean 5 and σ 2


def population(rng, count):
    y = 5.0 + 2.0 * rng.standard_normal(count)
    return y, INTERCEPT + SLOPE * y + NOISE * rng.standard_normal(count)


def ends_and_random(rng, y, count):
    """The middle, both extremes and random ones: chosen by the cheap result, as `choose` does."""
    order = np.argsort(y)
    rest = rng.choice(order[1 : len(y) // 2], count - 3, replace=False)
    return np.array([order[len(y) // 2], order[0], order[-1], *rest])


def at_random(rng, y, count):
    return rng.choice(len(y), count, replace=False)


@pytest.mark.parametrize("chooser", [ends_and_random, at_random])
def test_intervals_cover_as_often_as_claimed(chooser):
    """1000 repetitions: the shares lie within 2.5 % of 95 %; ignoring the dear results would hold the mean never."""
    rng, repetitions = np.random.default_rng(3), 1000
    held, plain, errors = np.zeros(2), 0, []
    for _ in range(repetitions):
        y, x = population(rng, 300)
        chosen = chooser(rng, y, 5)
        found = two_level(y, chosen, x[chosen])
        held += [found.mean.low <= MEAN <= found.mean.high, found.sigma.low <= SIGMA <= found.sigma.high]
        errors.append([found.mean.value - MEAN, found.sigma.value - SIGMA])
        cheap = estimates.mean(y)
        plain += cheap.low <= MEAN <= cheap.high
    assert np.abs(held / repetitions - estimates.LEVEL).max() < 0.025, held / repetitions
    assert plain == 0
    spread = np.std(errors, axis=0)
    bias = np.abs(np.mean(errors, axis=0))
    assert (bias < 0.1 * spread + 3 * spread / np.sqrt(repetitions)).all()  # far below the spread
    assert spread[0] < 1.5 * SIGMA / np.sqrt(300)  # five dear results, and nearly what 300 would give


def test_intervals_of_errors_cover_as_often_as_claimed():
    """2000 repetitions; those of means and of σ would be wider, since the cheap samples are shared."""
    rng, repetitions, cheap, dear = np.random.default_rng(4), 2000, 30, 10
    held, widths = np.zeros(2), np.zeros(2)
    for _ in range(repetitions):
        y, x = population(rng, cheap)
        chosen = at_random(rng, y, dear)
        found = two_level(y, chosen, x[chosen])
        off = found.mean_error, found.sigma_error
        held += [one.low <= true <= one.high for one, true in zip(off, (5.0 - MEAN, 2.0 - SIGMA))]
        widths += [found.mean_error.high - found.mean_error.low, found.mean.high - found.mean.low]
    assert np.abs(held / repetitions - estimates.LEVEL).max() < 0.025, held / repetitions
    assert widths[0] < widths[1]


def test_perfect_cheap_results_do_not_change_the_monte_carlo_estimate():
    y, _ = population(np.random.default_rng(0), 200)
    found = two_level(y, [3, 50, 120, 7], y[[3, 50, 120, 7]])
    assert found.mean.value == pytest.approx(y.mean(), rel=1e-13)
    assert found.sigma.value == pytest.approx(y.std(ddof=1), rel=1e-12)
    assert found.slope == pytest.approx(1, rel=1e-12) and found.worth == pytest.approx(200, rel=1e-6)
    assert np.allclose([found.mean_error.value, found.mean_error.high, found.six_sigma_error.low], 0, atol=1e-12)
    assert found.six_sigma.low == pytest.approx(6 * found.sigma.low)
    width = 2 * student.ppf(0.975, len(y) - 1) * y.std(ddof=1) / np.sqrt(len(y))
    assert found.mean.high - found.mean.low == pytest.approx(width, rel=1e-6)


def test_a_wrong_scale_is_corrected():
    """Cheap results 20 % too small: 6σ is put right; the Monte Carlo alone would be off by 20 %."""
    x = np.random.default_rng(1).standard_normal(400)
    found = two_level(0.8 * x - 1, [0, 1, 2, 3, 4], x[:5])
    assert found.six_sigma.value == pytest.approx(6 * x.std(ddof=1), rel=1e-10)
    assert found.mean.value == pytest.approx(x.mean(), abs=1e-12)


def test_constant_cheap_results_give_the_estimate_of_expensive_ones():
    x = np.array([1.0, 2.0, 4.0, 5.0])
    found, plain = two_level(np.full(50, 3.0), range(4), x), estimates.mean(x)
    assert (found.mean.value, found.mean.low, found.mean.high) == pytest.approx((plain.value, plain.low, plain.high))
    assert found.sigma.value == pytest.approx(x.std(ddof=1))


def test_too_few_expensive_results_have_no_interval():
    found = two_level([1.0, 2.0, 3.0], [0, 2], [2.0, 4.0])
    assert found.mean.value == 3.0 and np.isnan([found.mean.low, found.sigma.high]).all()


@pytest.mark.parametrize(
    "cheap, chosen, dear, words",
    [
        ([1.0, np.nan], [0], [1.0], "finite"),
        ([1.0, 2.0], [], [], "0 expensive"),
        ([1.0, 2.0], [0, 1], [1.0], "2 chosen"),
    ],
)
def test_invalid_input_is_refused(cheap, chosen, dear, words):
    with pytest.raises(ValueError, match=words):
        two_level(cheap, chosen, dear)


def test_samples_are_chosen_typical_then_extreme_and_random_in_turn():
    x = np.random.default_rng(5).standard_normal((60, 3))
    x[17] = 40.0, 0, 0  # the farthest
    numbers = 100 + np.arange(60)
    picked = choose(x, numbers, 5, seed=1)
    assert [c.kind for c in picked] == ["typical", "extreme", "random", "extreme", "random"] and picked[1].sample == 117
    assert len({c.sample for c in picked}) == 5 and choose(x, numbers, 3, seed=1) == picked[:3]
    assert len(choose(x[:2], numbers[:2], 5, seed=1)) == 2
    assert [c.sample for c in choose(1e3 * x, numbers, 5, seed=1)] == [c.sample for c in picked]  # units do not matter


def followed_lap():
    scene = with_stated_pairs(mic.load_scene(FOLDER.parent / "meshes" / "lap_joint"))
    parts = [part.model_copy(update={"size": "coarse"}) for part in scene.parts]
    monte_carlo = scene.monte_carlo.model_copy(update={"samples": 10})
    return scene.model_copy(update={"parts": parts, "monte_carlo": monte_carlo})


@pytest.fixture(scope="module")
def lap():
    """Each stage in one step, as in the paper, where (13) differs most from Coulomb's law."""
    return with_path(followed_lap(), "one-step")


@pytest.mark.slow
def test_a_scene_is_verified_and_cached(lap, cache, tmp_path, monkeypatch):
    """On nominal meshes the reduced Coulomb is exact; (13) is not. A second call solves nothing again."""
    summary = verify_scene(lap, tmp_path, cache, 3, False, Team(), lambda line: None, ())
    rows = {law: [row for row in summary["per_sample"] if row["law"] == law] for law in lap.report.laws}
    assert [len(own) for own in rows.values()] == [3, 3, 3]
    for row in rows["coulomb"]:
        assert row["force, relative"] < 1e-8 and row["measurement, mm"] < 1e-8 and row["changed states"] == 0
    assert max(row["force, relative"] for row in rows["associated"]) > 0.1
    for row in summary["statistics"]:
        if row["law"] == "coulomb":
            assert row["corrected 6σ"] == pytest.approx(row["6σ"], rel=1e-6)
            assert row["corrected mean"] == pytest.approx(row["mean"], abs=1e-8)
    page = (tmp_path / "report.html").read_text()
    assert "{'" not in page, "a table shows its data structure instead of its text"
    assert "<img" in page and "://" not in page.replace("http://www.w3.org", "")
    written = json.loads((tmp_path / "summary.json").read_text())
    monkeypatch.setattr(FullModel, "evaluate", None)
    again = verify_scene(lap, tmp_path, cache, 3, False, Team(), lambda line: None, ())
    assert again["statistics"] == written["statistics"]


@pytest.mark.slow
def test_a_followed_path_is_verified_with_the_same_increments_and_always_under_coulombs_law(cache, tmp_path):
    """With other increments the difference would include the errors of both paths."""
    lap = followed_lap()
    only = lap.model_copy(update={"report": lap.report.model_copy(update={"laws": ["frictionless"]})})
    summary = verify_scene(only, tmp_path, cache, 1, False, Team(), lambda line: None, ())
    rows = {row["law"]: row for row in summary["per_sample"]}
    assert (summary["law"], summary["truth"]["law"]) == ("frictionless", "coulomb")
    assert set(rows) == {"coulomb", "frictionless"}
    assert rows["coulomb"]["force, relative"] < 1e-8 and rows["coulomb"]["changed states"] == 0
    page = (tmp_path / "report.html").read_text()
    assert "have no confidence interval" in page and "largest error of 6σ" not in page  # of one full solve


@pytest.mark.slow
def test_a_failed_full_solve_is_named_and_left_out(lap, cache, tmp_path, monkeypatch):
    solve, calls = FullModel.evaluate, []

    def second_fails(self, deviations, law):
        calls.append(law)
        if len(calls) == 2:
            raise ContactFailure("planted failure")
        return solve(self, deviations, law)

    monkeypatch.setattr(FullModel, "evaluate", second_fails)
    summary = verify_scene(lap, tmp_path, cache, 2, True, Team(), lambda line: None, ())
    assert [item["failure"] for item in summary["chosen"]] == [None, "planted failure"]
    solved = {item["sample"] for item in summary["chosen"] if item["failure"] is None}
    assert {row["sample"] for row in summary["per_sample"]} == solved
    assert "planted failure" in (tmp_path / "report.html").read_text()


def no_finite_elements(*_, **__):
    raise SceneError("part 'lower' is a superelement")


@pytest.mark.slow
def test_a_scene_without_whole_finite_elements_is_reported_without_them(lap, cache, tmp_path, monkeypatch):
    monkeypatch.setattr(own_scene, "FullModel", no_finite_elements)
    summary = verify_scene(lap, tmp_path, cache, 2, True, Team(), lambda line: None, ())
    assert {item["failure"] for item in summary["chosen"]} == {"part 'lower' is a superelement"}
    page = (tmp_path / "report.html").read_text()
    assert "Not solved in full: samples" in page and "0 of them also by full" in page


def test_whole_finite_elements_of_a_superelement_are_refused_by_its_name():
    part = SimpleNamespace(name="lower", superelement=object())
    with pytest.raises(SceneError, match="part 'lower' is a superelement: whole finite elements need its mesh"):
        FullModel(SimpleNamespace(parts=[part]))


def test_a_scene_without_anything_to_compare_is_refused_before_it_is_solved(lap, tmp_path):
    report = lap.report.model_copy(update={"laws": ["frictionless"]})
    zones = [zone.model_copy(update={"friction": 0.0}) for zone in lap.zones]
    empty = lap.model_copy(update={"report": report, "zones": zones, "measurements": []})
    with pytest.raises(SceneError, match="nothing to verify: neither measurements nor"):
        verify_scene(empty, tmp_path / "none", tmp_path / "cache", 1, False, Team(), lambda line: None)
    once = lap.model_copy(update={"monte_carlo": lap.monte_carlo.model_copy(update={"samples": 1})})
    with pytest.raises(SceneError, match="has one sample"):
        verify_scene(once, tmp_path / "none", tmp_path / "cache", 1, False, Team(), lambda line: None)
    assert not list(tmp_path.iterdir())
