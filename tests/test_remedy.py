"""Remedies known by hand, also where contact changes, and their effects on all characteristics."""

import tomllib
from dataclasses import replace

import numpy as np
import pandas as pd
import pytest
from scipy.special import ndtri
from support.springs import STIFFNESS, at_face, clamped
from typer.testing import CliRunner

from mic.options import app
from mic.report.driver_sentences import remedy_words
from mic.results.schema import REMEDIES, REMEDY_EFFECTS
from mic.scene.deviation import ClampDeviation, LocatorDeviation
from mic.studies.adjustment import adjustment_tables, adjustments, with_adjustments
from mic.studies.remedy import Limits, remedies, smallest


def faces(lower, upper, sigma=0.0, clamps=(), mean=0.8, gap=0.6, more=()):
    """b's face is w above nominal, and a's comes down by z, mean/2 and sigma/2: they touch at w + z = gap, and from
    there on b is pushed down by half of what they would overlap."""
    items = [{"name": "A", "kind": "locator", "target": "al1", "mean": -mean, "sigma": sigma}]
    measured = [at_face("b", name="M", lower=lower, upper=upper), *more]
    return clamped("ba", gap, clamps=list(clamps), measurements=measured, deviations=items)


def changes(one):
    return {adjustment.name: change for adjustment, change in one.changes.items()}


def limits(half, spread=3.0):
    return Limits(np.array([-half]), np.array([half]), np.array([half]), spread)


def test_the_smallest_change_moves_the_mean_just_within_the_limit():
    y = np.full((1, 1), 1.3)
    x, short = smallest(y, np.array([[[0.5, 2.0]]]), limits(1.0), -np.ones(2), np.ones(2))
    np.testing.assert_allclose(x, [0.0, -0.15], atol=1e-9)
    assert short == pytest.approx(0.0, abs=1e-9)


def test_a_spread_is_made_smaller_where_the_derivatives_say_how():
    """y = ξ (1 − x/2), σ of ξ is 1/2: three of them are 1.2 where x = 0.4, and the mean has no part in it."""
    y = ndtri((np.arange(200) + 0.5) / 200)[:, None]
    y *= 0.5 / y.std(ddof=1)
    x, short = smallest(y, -0.5 * y[..., None], limits(1.2), -np.ones(1), np.ones(1))
    assert x[0] == pytest.approx(0.4, abs=1e-4) and short < 1e-4
    x, short = smallest(y, -0.5 * y[..., None], limits(1.2), -0.1 * np.ones(1), 0.1 * np.ones(1))
    assert x[0] == pytest.approx(0.1) and short == pytest.approx((1.5 * 0.95 - 1.2) / 1.2, rel=1e-3)


def test_several_that_are_too_weak_alone_share_the_change_the_stronger_first():
    y, slopes = np.full((1, 1), 2.0), np.array([[[0.6, 0.5, 0.1]]])
    x, short = smallest(y, slopes, limits(1.0), -np.ones(3), np.ones(3))
    np.testing.assert_allclose(x, [-1.0, -0.8, 0.0], atol=1e-9)
    x, short = smallest(y, slopes, limits(0.5), -np.ones(3), np.ones(3))
    np.testing.assert_allclose(x, -1.0, atol=1e-9)
    assert short == pytest.approx((2.0 - 1.2 - 0.5) / 0.5)


def test_unselected_characteristics_are_ignored_and_selected_ones_stay_within_limits():
    y, slopes = np.array([[1.3, -0.9]]), np.array([[[-1.0, 0.0], [-1.0, 1.0]]])
    both = Limits(-np.ones(2), np.ones(2), np.ones(2), 3.0)
    bounds = -np.ones(2), np.ones(2)
    x, _ = smallest(y, slopes, both, *bounds, margin=np.array([0.0, -np.inf]))
    np.testing.assert_allclose(x, [0.3, 0.0], atol=1e-9)
    x, short = smallest(y, slopes, both, *bounds)
    np.testing.assert_allclose(x, [0.3, 0.2], atol=1e-9)
    assert short == pytest.approx(0.0, abs=1e-9)


def test_a_contact_that_closes_needs_more_than_the_derivative_predicts():
    """0.2 mm are left at first. b up by w reads w, then (w + 0.2)/2: 0.5 takes 0.8 and 1.6 of one locator, not 1.0."""
    model = faces(0.5, 1.5)
    found = remedies(model, "frictionless", shim=2.0, names=["bl1"])
    one = found.found[0]
    assert found.worst == "M" and changes(one) == {"locators.bl1": pytest.approx(1.6, abs=0.011)}
    assert one.reached and one.rounds >= 2
    assert one.after[0][0, 0] == pytest.approx(0.5, abs=0.006) and one.before[0][0, 0] == pytest.approx(0.0, abs=1e-9)


def test_a_clamp_force_rises_by_the_force_of_its_spring():
    clamp = at_face("b", (0, 0, 1), name="C", force=20.0)
    model = faces(0.5, 1.5, clamps=[clamp], gap=9.0)
    found = remedies(model, "frictionless", names=["C"])
    assert changes(found.found[0]) == {"clamps.C.force": pytest.approx(0.5 * STIFFNESS - 20.0)}
    assert found.table["value"].tolist() == [pytest.approx(25.0)]


def test_two_adjustments_within_bounds_replace_one_beyond():
    model = faces(0.5, 1.5, gap=9.0)
    found = remedies(model, "frictionless", shim=0.6, names=["bl1", "bl2"])
    alone, together = found.found
    assert not alone.reached and changes(alone).popitem()[1] == pytest.approx(0.6)
    assert together.reached and sum(changes(together).values()) == pytest.approx(1.0, abs=0.011)


def test_an_unreachable_target_is_reported_with_the_remaining_distance():
    found = remedies(faces(0.5, 1.5, gap=9.0), "frictionless", shim=0.2, names=["bl1", "bl2"])
    together = found.found[-1]
    assert not together.reached and together.name == "together"
    own = found.effects[found.effects["remedy"] == "together"]
    assert own["margin"].tolist() == pytest.approx([-0.3, -0.3])
    words = remedy_words(found.table, found.effects, faces(0.5, 1.5).scene)
    assert any("is not enough: the margin of M remains −300 µm" in each for each in words)


def test_of_samples_the_spread_counts_and_fresh_ones_judge():
    """M = −A/4 + 0.3 where they touch, as they do nearly always; mean −0.7, σ 0.1: 3σ ≤ 0.5 + 0.2 − …"""
    model = faces(-0.5, 0.5, sigma=0.2, mean=2.6, gap=0.0)
    found = remedies(model, "frictionless", 40, seed=3, shim=2.0, names=["bl1"])
    one = found.found[0]
    REMEDIES.check(found.table, "memory", "mend it")
    REMEDY_EFFECTS.check(found.effects, "memory", "mend it")
    assert found.effects["fresh"].tolist() == [False, True]
    assert not np.array_equal(one.before[0], one.before[1])
    told = found.effects.set_index("fresh").loc[True]
    assert told["mean_before"] == pytest.approx(-0.65, abs=0.03)
    assert one.reached and told["margin"] > -1e-3 and told["margin"] < 0.06
    # mean −0.65 + x/4 must be 3σ above −0.5: σ is a quarter of A's
    assert changes(one)["locators.bl1"] == pytest.approx((0.15 + 3 * 0.05) * 4, abs=0.15)
    assert told["gain_low"] <= told["gain"] <= told["gain_high"]
    assert told["outside_before"] > 0.9 and told["outside"] < 0.1


def test_a_table_of_samples_is_judged_as_it_is():
    model = faces(-0.5, 0.5, sigma=0.2, mean=2.6, gap=0.0)
    values = model.scene.monte_carlo.model_copy(update={"values": [[-2.6], [-2.4]], "samples": 2})
    model = replace(model, scene=model.scene.model_copy(update={"monte_carlo": values}))
    found = remedies(model, "frictionless", 2, shim=2.0, names=["bl1"], capability=0.5)
    assert found.effects["fresh"].tolist() == [False] and found.found[0].reached


def test_characteristics_within_limits_need_no_remedy():
    found = remedies(faces(-0.5, 0.5), "frictionless", names=["bl1"])
    assert found.worst == "" and found.found == [] and not len(found.table) and not len(found.effects)
    assert "no remedy is needed" in remedy_words(found.table, found.effects, faces(-0.5, 0.5).scene)[0]


JAWS = [at_face("b", name="T-b", force=20.0), at_face("a", (0, 0, -1), name="T-a", force=20.0)]


def test_jaws_of_one_pair_of_tongs_are_adjusted_together_and_others_alone():
    other = at_face("a", (0, 0, -1), name="C", force=30.0)
    stroke = {**at_face("b", (0, 0, -1), name="S", stroke=0.1), "point": [5.0, 9.0, 0.0]}
    model = faces(0.5, 1.5, clamps=[*JAWS, other, stroke])
    some = adjustments(model, names=["T-b", "C", "S"])
    assert [one.name for one in some] == ["clamps.T-b+T-a.force", "clamps.C.force", "clamps.S.stroke"]
    assert [(one.low, one.high, one.unit) for one in some][0] == (-10.0, 20.0, "N") and some[2].now == 0.1


def test_changes_are_rounded_up_to_settable_steps_within_bounds():
    model = faces(0.5, 1.5, clamps=[at_face("b", (0, 0, 1), name="C", force=20.0)])
    shim, force = adjustments(model, names=["bl1", "C"])
    assert [shim.settable(x) for x in (0.123, -0.123, 0.1, 0.0001, 7.0)] == pytest.approx([0.13, -0.13, 0.1, 0.0, 0.5])
    assert [force.settable(x) for x in (5.03, -30.0)] == pytest.approx([5.1, -10.0])


def test_the_written_table_holds_the_evaluated_values():
    model = faces(0.5, 1.5, clamps=JAWS)
    some = adjustments(model, names=["bl1", "T-a"])
    told = tomllib.loads(adjustment_tables(model.scene, dict(zip(some, (0.3, -4.0)))))["deviations"]
    kinds = {"locator": LocatorDeviation, "clamp": ClampDeviation}
    tables = [kinds[one["kind"]](**one) for one in told]
    own, _ = with_adjustments(model, some)
    scene = own.scene.model_copy(update={"deviations": [*model.scene.deviations, *tables]})
    as_written = replace(own, scene=scene).evaluate({}, "frictionless")
    as_found = own.evaluate(np.array([[-0.8, 0.3, -4.0]]), "frictionless")
    np.testing.assert_array_equal(as_written.measurements, as_found.measurements)
    assert as_found.measurements[0, 0] != pytest.approx(model.evaluate({}, "frictionless").measurements[0, 0], abs=0.01)


@pytest.mark.parametrize(
    "options, message",
    [
        (["--adjust", "X"], "'X' is neither a locator nor a clamp of this scene; it has: bl0, bl1"),
        ([], "nothing to adjust besides the datum of its measurements"),
        (["--adjust", "bl1", "--shim", "nan"], "shim is nan; give a finite number above 0"),
        (["--adjust", "bl1", "--force", "0.5"], "factor is 0.5; give a finite number above 1"),
        (["--adjust", "bl1", "--save", "mended.toml"], "--save writes a changed copy of a scene file"),
        (["--adjust", "bl1", "--samples", "1"], "Invalid value"),
    ],
)
def test_the_command_refuses_in_words(options, message, tmp_path):
    faces(0.5, 1.5).save(tmp_path / "model.npz")
    done = CliRunner().invoke(app, ["remedy", str(tmp_path / "model.npz"), *options], env={"COLUMNS": "200"})
    assert done.exit_code != 0 and message in f"{done.output} {done.exception}"


def test_the_command_prints_adjustments_and_their_effects(tmp_path):
    faces(0.5, 1.5, gap=9.0).save(tmp_path / "model.npz")
    arguments = ["remedy", str(tmp_path / "model.npz"), "--adjust", "bl1", "--shim", "1.5"]
    done = CliRunner().invoke(app, arguments, env={"COLUMNS": "160"})
    assert done.exit_code == 0, done.output
    assert "locators.bl1 0 → 1 mm" in done.output and "brings the worst characteristic within limits" in done.output
    assert 'target = "bl1"' in done.output and "mean = 1\n" in done.output


def test_sentences_name_characteristics_that_a_remedy_moves_beyond_limits():
    found = remedies(faces(0.5, 1.5, gap=9.0), "frictionless", shim=2.0, names=["bl1"])
    spoilt = found.effects.assign(measurement="N", margin_before=0.1, margin=-0.1)
    scene = faces(0.5, 1.5, more=[at_face("b", name="N", lower=-1.0, upper=1.0)]).scene
    words = remedy_words(found.table, pd.concat([found.effects, spoilt]), scene)
    assert "but moves N out of limits" in words[0]
