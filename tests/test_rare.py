"""Rare limit violations: subset simulation and design points against closed forms."""

from dataclasses import replace

import numpy as np
import pandas as pd
import pytest
from scipy.special import ndtr
from scipy.stats import binom, chi2, multivariate_normal
from support.springs import at_face, clamped
from typer.testing import CliRunner

from mic.options import app
from mic.report.driver_sentences import design_words
from mic.results.schema import DESIGN_POINTS, RARE
from mic.statistics.draw import draw
from mic.studies.first_order_reliability import find_design_points, union_probability
from mic.studies.rare import agree, rare, subset_simulation


def normal(dimension, beta):
    """One linear limit: P = Φ(−β)."""
    return (lambda z: z.sum(axis=1) / np.sqrt(dimension) - beta), float(ndtr(-beta))


def sphere(dimension, radius):
    """Far off in any direction: P = 1 − F_χ²(r²)."""
    return (lambda z: np.linalg.norm(z, axis=1) - radius), float(chi2.sf(radius**2, dimension))


@pytest.mark.parametrize("case, dimension, at", [(normal, 2, 3.5), (normal, 20, 4.5), (sphere, 5, 5.0)])
def test_closed_forms_are_within_the_interval_as_often_as_it_claims(case, dimension, at):
    """40 repetitions: hits above the 0.1 % quantile of those of 95 % intervals; the mean within its error."""
    g, wanted = case(dimension, at)
    found = [subset_simulation(g, dimension, 500, seed) for seed in range(40)]
    inside = sum(one.low <= wanted <= one.high for one in found)
    assert inside >= binom.ppf(0.001, 40, 0.95)
    each = np.array([one.probability for one in found])
    assert each.mean() == pytest.approx(wanted, rel=0.15 + 4 * each.std() / wanted / np.sqrt(40))
    assert max(one.high / one.low for one in found) < 100
    levels = found[0].levels
    assert found[0].evaluations == 500 + (levels - 1) * 450 and levels == pytest.approx(-np.log10(wanted), abs=1.5)


def test_frequent_misses_use_plain_monte_carlo():
    g, wanted = normal(3, 1.0)
    found = subset_simulation(g, 3, 2000, 1)
    assert (found.levels, found.evaluations) == (1, 2000)
    assert found.low < wanted < found.high and found.high - found.low < 0.04


def test_an_impossible_miss_gets_an_upper_bound():
    found = subset_simulation(lambda z: -1.0 - z[:, 0] ** 2, 2, 100, 1)
    assert found.probability == 0.0 and 0 < found.high < 1e-8


def read(lower=-1.0, upper=1.0):
    return [at_face("b", name="M", lower=lower, upper=upper)]


@pytest.fixture(scope="module")
def closing():
    """b's face follows its own locator, and in a fifth of the samples it is pressed down by a's."""
    items = [{"name": f"A{i}", "kind": "locator", "target": f"al{i}", "sigma": 1.0} for i in (1, 2)]
    return clamped("ba", 0.6, measurements=read(), deviations=items)


def test_a_rare_miss_through_contact_is_found_where_a_normal_estimate_fails(closing):
    """a comes down by z = (A1 + A2)/2 of σ √½ and presses b by (z − 0.6)/2, to −1 mm where z is 2.6 mm."""
    wanted = float(ndtr(-2.6 / np.sqrt(0.5)))  # 1.2e-4
    both = rare(closing, "frictionless", ["M"], 500, seed=4)
    found, points = both.table, both.points
    DESIGN_POINTS.check(points, "memory", "mend it")
    # z reaches 2.6 mm soonest where A1 and A2 are alike: 2.6/√½ from the mean, each 2.6 σ. Up, b is never pushed.
    lower = points[points["limit"] == "lower"]
    np.testing.assert_allclose(lower["beta"], 2.6 / np.sqrt(0.5), rtol=1e-3)
    np.testing.assert_allclose(lower["sigmas"], -2.6, rtol=1e-2)
    np.testing.assert_allclose(lower["share"], 0.5, atol=0.01)
    assert lower["found"].all() and (points[points["limit"] == "upper"]["beta"] > 8).all()
    np.testing.assert_allclose(found["first_order"], wanted, rtol=0.01)
    assert found["agrees"].all()
    assert any("A1 −2.6 σ" in each for each in design_words(found, points))
    RARE.check(found, "memory", "mend it")
    assert found["measurement"].tolist() == ["", "M"] and found["failed"].tolist() == [0, 0]
    for row in found.to_dict("records"):
        assert row["outside_low"] < wanted < row["outside_high"] and row["outside_high"] < 10 * wanted
    plain = closing.process("frictionless").evaluate(draw(closing.scene, 1, 0, 2000)).measurements[:, 0]
    fitted = float(ndtr((-1.0 - plain.mean()) / plain.std()))
    assert fitted < found["outside_low"].max() / 100 or fitted > 100 * found["outside_high"].min()


def test_the_nearest_point_of_a_curved_limit_and_of_a_plane():
    """z₁ = 3 + z₂²/5 lies nearest at (3, 0); z₁ + 2 z₂ = 5 at (1, 2); and from its other side."""

    def slopes(z, which):
        curved = z[:, 0] - 3 - z[:, 1] ** 2 / 5, np.column_stack([np.ones(len(z)), -2 * z[:, 1] / 5])
        flat = z @ [1.0, 2.0] - 5, np.tile([1.0, 2.0], (len(z), 1))
        limits = [curved, flat, (2 * flat[0] + 20, 2 * flat[1])]
        return tuple(np.array([limits[w][part][i] for i, w in enumerate(which)]) for part in (0, 1))

    found = find_design_points(slopes, np.array([[4.0, 1.0], [0.0, 0.0], [1.0, -1.0]]))
    assert found.found.all()
    np.testing.assert_allclose(found.z, [[3, 0], [1, 2], [-1, -2]], atol=0.01)
    np.testing.assert_allclose(found.beta, [3, np.sqrt(5), -np.sqrt(5)], rtol=1e-3)


def test_a_limit_with_a_kink_where_no_gradient_points_to_the_origin_is_not_called_found():
    """max(z₁ + z₂/2, z₂ + z₁/2) = 3 is nearest where the two meet."""

    def slopes(z, which):
        first = z[:, 0] + z[:, 1] / 2 < z[:, 1] + z[:, 0] / 2
        slope = np.where(first[:, None], [1.0, 0.5], [0.5, 1.0])
        return (z * slope).sum(axis=1) - 3, slope

    assert not find_design_points(slopes, np.array([[1.0, 1.2]])).found[0]


def test_the_probability_of_a_union_of_half_spaces():
    """Two at an angle, against the bivariate normal; two equal ones; two opposite ones."""
    r, beta = 0.6, np.array([2.5, 3.0])
    direction = np.array([[1.0, 0.0], [r, np.sqrt(1 - r**2)]])
    both = multivariate_normal([0, 0], [[1, r], [r, 1]]).cdf(-beta)
    assert union_probability(direction, beta) == pytest.approx(ndtr(-beta).sum() - both, rel=0.005)
    assert union_probability(direction[[0, 0]], beta[[0, 0]]) == pytest.approx(ndtr(-2.5))
    assert union_probability(np.array([[1.0], [-1.0]]), np.array([4.0, 4.0])) == pytest.approx(2 * ndtr(-4.0), rel=1e-6)


def direct(deviations, upper, correlations=()):
    """M = (A1 + A2)/2, no contact near."""
    items = [{"name": f"A{i}", "kind": "locator", "target": f"bl{i}"} | one for i, one in enumerate(deviations, 1)]
    return clamped("ba", 9.0, measurements=read(-9.0, upper), deviations=items, correlations=list(correlations))


@pytest.mark.slow
def test_correlated_and_other_distributions_are_seen_through():
    """A1 + A2 of correlation 0.8 has the variance 3.6 σ²; a uniform one reaches 0.99 of its end at Φ⁻¹(0.995)."""
    joint = {"deviations": ["A1", "A2"], "matrix": [[1, 0.8], [0.8, 1]]}
    found = rare(direct([{"sigma": 0.3}, {"sigma": 0.3}], 1.0, [joint]), "frictionless", samples=200, seed=1)
    upper = found.points[found.points["limit"] == "upper"]
    np.testing.assert_allclose(upper["beta"], 2 / (0.3 * np.sqrt(3.6)), rtol=1e-3)
    np.testing.assert_allclose(upper["value"], 1.0, rtol=1e-2)
    one = direct([{"sigma": 0.5, "distribution": "uniform"}, {"sigma": 0.0}], 0.99 * np.sqrt(3) * 0.25)
    found = rare(one, "frictionless", samples=200, seed=1)
    assert found.table["first_order"][0] == pytest.approx(0.005, rel=0.01)


def test_disagreement_at_a_curved_limit_is_reported():
    row = {"outside": 1e-5, "outside_low": 5e-6, "outside_high": 2e-5, "measurement": "", "agrees": True}
    assert agree(row | {"first_order": 6e-6}) and not agree(row | {"first_order": 4e-6})
    told = pd.DataFrame([row | {"first_order": 4e-6, "agrees": False}])
    assert "the limit is curved" in design_words(told, DESIGN_POINTS.empty())[0]


def test_samples_that_failed_are_no_misses_and_counted(closing, monkeypatch):
    process = closing.process("frictionless")
    attempt = process.attempt

    def some_fail(deviations):
        found = attempt(deviations)
        return replace(found, failed=deviations[:, 0] < -2.0)

    monkeypatch.setattr(process, "attempt", some_fail)
    found = rare(closing, "frictionless", samples=500, seed=4).table.iloc[0]
    assert found["failed"] > 0
    whole = float(ndtr(-2.6 / np.sqrt(0.5)))
    assert found["outside"] < 0.3 * whole  # most misses are among those that failed


def test_the_command_prints_parts_per_million_and_refuses_unknown_names(closing, tmp_path):
    closing.save(tmp_path / "model.npz")
    arguments = ["rare", str(tmp_path / "model.npz"), "--samples", "200", "--law", "frictionless"]
    done = CliRunner().invoke(app, arguments, env={"COLUMNS": "160"})
    assert done.exit_code == 0, done.output
    assert "Assemblies outside limits: " in done.output and "levels" in done.output
    refused = CliRunner().invoke(app, [*arguments, "--measurement", "N"])
    assert refused.exit_code != 0 and "has no measurement 'N'; it has: M" in str(refused.exception)
