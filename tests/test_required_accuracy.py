"""Required accuracies of a scene, and their distance from the best estimates of a run."""

import math
import tomllib
from pathlib import Path

import pandas as pd
import pytest

from mic.commands.invocation import with_options
from mic.errors import SceneError
from mic.results.headline import headline
from mic.results.required_accuracy import largest_uncertainty
from mic.scene.load import read_table

PATH = Path(__file__).resolve().parents[1] / "meshes" / "lap_joint" / "scene.toml"


def scene(accuracy, **changes):
    table = tomllib.loads(PATH.read_text(encoding="utf-8"))
    return read_table(table | {"monte_carlo": {"accuracy": accuracy}} | changes, PATH)


def test_a_number_is_the_accuracy_of_six_sigma():
    assert scene(0.02).monte_carlo == scene({"six_sigma": 0.02}).monte_carlo
    given = {"six_sigma": 0.01, "mean": 0.005, "share_outside": 0.001, "cpk": 0.05, "slip": 0.02}
    assert scene(given).monte_carlo.accuracy.required == given
    assert with_options(scene(given), [], accuracy=0.03).monte_carlo.accuracy.required == {"six_sigma": 0.03}


@pytest.mark.parametrize(
    ("accuracy", "changes", "words"),
    [
        ({}, {}, r"accuracy: it is empty; give at least one of six_sigma, mean, share_outside, cpk, slip"),
        ({"sixsigma": 0.01}, {}, r"accuracy.sixsigma: unknown key; did you mean 'six_sigma'\?"),
        ({"cpk": 0}, {}, "accuracy.cpk: .*greater than 0"),
        ({"mean": 1.0}, {}, "accuracy.mean: .*less than 1"),
        ("1 %", {}, "accuracy.six_sigma: .*valid number"),
        ({"slip": 0.1}, {"report": {"laws": ["frictionless"]}}, "accuracy.slip: nothing slips without friction"),
        ({"cpk": 0.1}, {"measurements": []}, "accuracy: it needs measurements and deviations"),
    ],
)
def test_an_invalid_accuracy_is_one_error(accuracy, changes, words):
    with pytest.raises(SceneError, match=words) as raised:
        scene(accuracy, **changes)
    assert len(str(raised.value).splitlines()) == 1


def test_slip_needs_a_zone_but_no_key_characteristic():
    assert scene({"slip": 0.1}, measurements=[]).monte_carlo.accuracy.required == {"slip": 0.1}
    with pytest.raises(SceneError, match="accuracy.slip: the scene has no contact zone"):
        scene({"slip": 0.1}, zones=[])


def test_an_accuracy_of_the_command_line_is_checked_as_that_of_the_scene():
    designed = read_table(
        tomllib.loads(PATH.read_text(encoding="utf-8")) | {"monte_carlo": {"samples": 64, "design": "sobol"}}, PATH
    )
    with pytest.raises(SceneError, match="--accuracy: monte_carlo: accuracy adds samples one by one"):
        with_options(designed, [], accuracy=0.01)


def measured(**columns):
    """Best estimates of one key characteristic: 6σ 0.6 ± 0.06 and others, of the samples alone."""
    row = {"law": "coulomb", "measurement": "KC1"}
    estimates = {"mean": (0.1, 0.03), "sigma": (0.1, 0.01), "six_sigma": (0.6, 0.06), "cp": (2.0, 0.2)}
    estimates |= {"cpk": (1.5, 0.3), "share_outside": (0.02, 0.01)}
    unknown = dict.fromkeys(("improved_mean", "improved_six_sigma", "improved_cpk"), (math.nan, math.nan))
    for name, (value, half) in (estimates | unknown | columns).items():
        row |= {name: value, f"{name}_low": value - half, f"{name}_high": value + half}
    return headline(pd.DataFrame([row]))


def zones(slip=(0.2, 0.01), tangential=(0.3, 0.06), spread=(0.4, 0.02)):
    row = {"law": "coulomb", "stage": "clamp", "zone": "A"}
    columns = {"mean_rms_slip": slip, "six_sigma_rms_slip": spread if slip[0] == slip[0] else slip}
    columns |= {"mean_rms_tangential": tangential, "six_sigma_rms_tangential": spread}
    for name, (value, half) in columns.items():
        row |= {name: value, f"{name}_low": value - half, f"{name}_high": value + half}
    return headline(pd.DataFrame([row]))


@pytest.mark.parametrize(
    ("required", "ratio", "words"),
    [
        ({"six_sigma": 0.05}, 2.0, "6σ of KC1 under coulomb is known to ±10 % (required: ±5 %); increase --samples"),
        ({"six_sigma": 0.2}, 0.5, "every required accuracy is reached; least: 6σ of KC1 under coulomb, ±10 % of ±20 %"),
        ({"mean": 0.01}, 5.0, "the mean of KC1 under coulomb is known to ±5 % of its 6σ"),
        ({"cpk": 0.1}, 3.0, "Cpk of KC1 under coulomb is known to ±0.3 (required: ±0.1)"),
        ({"share_outside": 0.005}, 2.0, "the share outside the limits of KC1 under coulomb is known to ±1 %"),
        ({"slip": 0.025}, 2.0, "of zone A in stage clamp under coulomb is known to ±5 %"),
        ({"six_sigma": 0.05, "cpk": 0.1}, 3.0, "Cpk"),
    ],
)
def test_the_quantity_farthest_from_its_required_accuracy_is_named(required, ratio, words):
    found = largest_uncertainty(measured(), zones(), required)
    assert found.ratio == pytest.approx(ratio) and found.reached == (ratio <= 1)
    assert words in found.sentence(500)


def test_slip_is_tangential_displacement_where_nothing_slips_under_load():
    found = largest_uncertainty(measured(), zones(slip=(math.nan, math.nan)), {"slip": 0.1})
    assert found.ratio == pytest.approx(0.06 / 0.3 / 0.1)


def test_slip_is_relative_to_at_least_ten_micrometres():
    found = largest_uncertainty(measured(), zones(slip=(0.0001, 0.0001), spread=(0.0001, 0.0001)), {"slip": 0.1})
    assert found.ratio == pytest.approx(0.1)


def test_an_unknown_interval_is_not_reached_and_no_spread_is():
    unknown = largest_uncertainty(measured(six_sigma=(0.6, math.nan)), zones(), {"six_sigma": 0.5})
    assert unknown.ratio == math.inf and "has no interval" in unknown.sentence(1)
    constant = measured(six_sigma=(0.0, math.nan), mean=(0.1, math.nan), cpk=(math.inf, math.nan))
    assert largest_uncertainty(constant, zones(), {"six_sigma": 0.01, "mean": 0.01, "cpk": 0.1}).ratio == 0
    assert not largest_uncertainty(measured()[:0], zones()[:0], {"six_sigma": 0.5}).reached


def test_the_improved_estimate_is_the_headline_and_that_of_the_samples_stays():
    (row,) = measured(improved_six_sigma=(0.5, 0.01)).to_dict("records")
    assert (row["six_sigma"], row["alone_six_sigma"]) == (0.5, 0.6)
    assert row["six_sigma_high"] == pytest.approx(0.51) and row["alone_six_sigma_high"] == pytest.approx(0.66)
    assert row["sigma"] == pytest.approx(0.5 / 6) and row["cp"] == pytest.approx(2.0 * 0.6 / 0.5)
    assert row["cp_low"] == pytest.approx(1.2 / 0.51) and row["cp_high"] == pytest.approx(1.2 / 0.49)
    assert row["mean"] == 0.1 and math.isnan(row["alone_mean"])
    found = largest_uncertainty(measured(improved_six_sigma=(0.5, 0.01)), zones(), {"six_sigma": 0.01})
    assert found.ratio == pytest.approx(2.0)
