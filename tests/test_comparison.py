"""Differences of two assemblies on the same samples, with intervals from the pairs."""

import dataclasses

import numpy as np
import pytest
from support.springs import LIFT, MU, PULL, at_face, dragged
from typer.testing import CliRunner

import mic
from mic import examples
from mic.errors import RunError, SceneError
from mic.options import app
from mic.report.comparison_page import sentences
from mic.results.field_changes import field_changes
from mic.results.schema import COMPARISON
from mic.statistics.paired_differences import centred_capability_change, mean_change, share_change, six_sigma_change
from mic.studies.comparison import compare, scene_differences

SIGMA = 0.05


def measured(upper=0.05, far_first=False, sigma=SIGMA, **changes):
    """M alone is measured."""
    deviations = [
        {"name": "P", "kind": "locator", "target": "bl1", "mean": 2 * LIFT, "sigma": sigma},
        {"name": "D", "kind": "clamp", "target": "T", "mean": PULL, "sigma": 0.01},
    ]
    item = at_face("b", (1, 0, 0), name="M", lower=0.0, upper=upper)
    return dragged(deviations=deviations[::-1] if far_first else deviations, measurements=[item], **changes)


@pytest.fixture(scope="module")
def before():
    return measured()


def row(found, name):
    return found.table.set_index("quantity").loc[name]


def test_a_change_of_friction_agrees_with_the_closed_form(before):
    """The drag of every sample goes as μ, so that the samples of M do."""
    found = compare(before, measured(friction=0.2), samples=40, seed=3)
    COMPARISON.check(found.table, "memory", "mend it")
    a, b = (side.values["M"].to_numpy() for side in (found.a, found.b))
    np.testing.assert_allclose(b, a * 2 / 3, rtol=1e-9)
    own, slip = row(found, "M"), row(found, "slip clamp z")
    assert a.mean() == pytest.approx(MU * LIFT / 4, rel=0.05) and own["mean_change"] == pytest.approx(-a.mean() / 3)
    assert own["six_sigma_change"] == pytest.approx(-2 * a.std(ddof=1))
    assert own["mean_change_low"] < own["mean_change"] < own["mean_change_high"] < 0
    assert own["samples"] == 40 and not found.left_out and not found.alone
    assert found.changes == ["zones.z.friction: 0.3 → 0.2"]
    assert slip["mean_a"] == pytest.approx(PULL, rel=0.05) and np.isnan(slip["cpk_a"]) and slip["mean_change"] > 0
    assert "Significant changes of mean: M by −" in " ".join(sentences(found))


def test_deviations_are_paired_by_name_whatever_their_order_and_spread(before):
    found = compare(before, measured(sigma=2 * SIGMA, far_first=True), samples=30, seed=3)
    a, b = (side.values["M"].to_numpy() - MU * LIFT / 4 for side in (found.a, found.b))
    np.testing.assert_allclose(b, 2 * a, atol=1e-12)
    assert any(line.startswith("deviations.P.sigma: 0.05 → 0.1") for line in found.changes)


def test_equal_scenes_have_no_change_and_another_law_is_one(before):
    found = compare(before, before, samples=10)
    changes = found.table[[name for name in COMPARISON.names if name.endswith("_change")]].to_numpy()
    assert (np.nan_to_num(changes) == 0).all() and not found.changes
    assert "No mean of a key characteristic changes" in " ".join(sentences(found))
    other = compare(before, before, ("coulomb", "frictionless"), samples=10)
    assert (other.a.law, other.b.law) == ("coulomb", "frictionless") and other.alone == ["slip clamp z"]
    assert row(other, "M")["mean_b"] == pytest.approx(0.0, abs=1e-12)


def test_yield_and_share_outside_are_counted_in_pairs():
    limit = MU * LIFT / 4  # the median
    found = compare(measured(limit), measured(limit, friction=0.29), samples=60, seed=5)
    a, b = (side.values["M"].to_numpy() > limit for side in (found.a, found.b))
    whole = row(found, "")
    assert whole["outside_a"] == a.mean() and 0 < b.mean() < a.mean() and whole["outside_b"] == b.mean()
    assert whole["outside_change"] == pytest.approx(b.mean() - a.mean())
    assert whole["outside_change_low"] < b.mean() - a.mean() < whole["outside_change_high"]
    assert sentences(found)[0].startswith(f"{100 * (1 - b.mean()):.1f} % of the assemblies are within all limits")


def test_intervals_have_their_stated_coverage():
    """400 repetitions of correlated normals: 95 %, less three standard errors of that."""
    draws, hits, repeated = np.random.default_rng(20), np.zeros(4), 400
    sigma, limits = np.sqrt([1.09, 0.73]), (-3.0, 3.0)
    wanted = 0.1, 6 * (sigma[1] - sigma[0]), 2.9 / 3 / sigma[1] - 1 / sigma[0], 0.0
    for _ in range(repeated):
        both, own, c = draws.standard_normal((3, 20))
        a, b = both + 0.3 * own, 0.1 + 0.8 * both + 0.3 * c
        found = [change(a, b) for change in (mean_change, six_sigma_change)]
        found += [centred_capability_change(a, b, limits, limits), share_change(own > 1, c > 1)]
        hits += [one.low <= value <= one.high for one, value in zip(found, wanted)]
    assert (hits / repeated > 0.95 - 3 * np.sqrt(0.95 * 0.05 / repeated)).all(), hits / repeated


def test_samples_of_a_group_count_as_one():
    x = np.random.default_rng(1).standard_normal(20)
    a, group = np.repeat(x, 5), np.repeat(np.arange(20), 5)
    alone, together = mean_change(x, 2 * x), mean_change(a, 2 * a, group)
    assert (together.low, together.high) == pytest.approx((alone.low, alone.high))
    assert mean_change(a, 2 * a).high < alone.high
    assert np.isnan(mean_change([1.0, np.nan], [2.0, 1.0]).low)


def test_lists_of_samples_go_together_row_by_row():
    rows = [[2 * lift, PULL] for lift in (0.3, 0.4, 0.5)]
    given = measured(monte_carlo={"values": rows})
    found = compare(given, measured(far_first=True), samples=3)
    for side in (found.a, found.b):
        np.testing.assert_allclose(side.values["M"], [MU * lift / 4 for lift in (0.3, 0.4, 0.5)], rtol=1e-9)
    with pytest.raises(SceneError, match="tables of samples do not match"):
        compare(given, measured(monte_carlo={"values": rows[:2]}), samples=3)


def test_runs_without_common_characteristics_are_refused(before):
    other = before.scene.measurements[0].model_copy(update={"name": "other"})
    for changes, words in (
        (
            {"measurements": [other]},
            r"no key characteristic in common \(M; other\): compare two scenes of one assembly",
        ),
        ({"parts": []}, r"'springs' and 'springs' have no part in common \(b, t; none\)"),
        ({"stages": before.scene.stages[:2]}, r"key characteristic .* \(M; none\)"),
    ):
        changed = dataclasses.replace(before, scene=before.scene.model_copy(update=changes))
        with pytest.raises(SceneError, match=words):
            compare(before, changed, samples=3, progress=lambda count: pytest.fail("it was evaluated"))
    with pytest.raises(SceneError, match="laws are given for two sides"):
        compare(before, before, ("coulomb", "frictionless", "associated"))


def test_scenes_of_other_assemblies_are_refused_before_either_is_reduced(monkeypatch):
    monkeypatch.setattr("mic.commands.compare.load_model", lambda *_: pytest.fail("it was reduced"))
    done = CliRunner().invoke(app, ["compare", *(str(examples.folder(name)) for name in ("lap_joint", "wheelhouse"))])
    assert "have no part in common (lower, upper; inner, outer)" in str(done.exception)


def test_differences_of_scenes_name_added_and_removed_items(before):
    other = before.scene.model_dump(mode="json")
    other["zones"], other["name"] = [other["zones"][0] | {"name": "y"}], "other"
    assert scene_differences(before.scene, mic.Scene(**other)) == ["zones.z: removed", "zones.y: added"]


def test_the_command_writes_a_page_and_a_table(before, tmp_path):
    before.save(tmp_path / "a.npz")
    measured(friction=0.2).save(tmp_path / "b.npz")
    asked = ["compare", *(str(tmp_path / name) for name in ("a.npz", "b.npz")), "--samples", "12", "--seed", "3"]
    done = CliRunner().invoke(app, [*asked, "--out", str(tmp_path / "out")], env={"COLUMNS": "160"})
    assert done.exit_code == 0, done.output
    assert "Significant changes of mean: M by" in done.output
    page = (tmp_path / "out" / "comparison.html").read_text(encoding="utf-8")
    assert "zones.z.friction: 0.3 → 0.2" in page and page.count("data:image/svg+xml") == 2
    assert len(COMPARISON.read(tmp_path / "out", "")) == 3


@pytest.mark.fem
@pytest.mark.slow
def test_runs_are_compared_as_they_stand_with_maps(lap_scene, cache, tmp_path):
    def ran(name, seed=1, fields=True, **zone):
        changes = {
            "report": lap_scene.report.model_copy(update={"laws": ["coulomb"], "fields": fields}),
            "monte_carlo": lap_scene.monte_carlo.model_copy(update={"samples": 6, "seed": seed}),
            "zones": [lap_scene.zones[0].model_copy(update=zone)],
        }
        return mic.run(lap_scene.model_copy(update=changes), tmp_path / name, cache)

    a, b = ran("a"), ran("b", friction=0.1)
    found = compare(a, b)
    for name in ("M1", "M2"):
        wanted = b.measured("coulomb", name) - a.measured("coulomb", name)
        assert row(found, name)["mean_change"] == pytest.approx(wanted.mean(), abs=1e-12)
    assert row(found, "slip clamp lap")["mean_b"] == pytest.approx(b.slip("coulomb", "clamp", "lap").mean())
    anew = compare(a, b, samples=6)  # other samples
    assert row(anew, "slip clamp lap")["mean_a"] != row(found, "slip clamp lap")["mean_a"]
    maps = field_changes(a, "coulomb", b, "coulomb")
    assert [one.part for one in maps] == ["lower", "upper"] and all(one.same_mesh for one in maps)
    fields = [{f.part: f for f in mic.results.fields.read_fields(each.folder)[0]} for each in (a, b)]
    np.testing.assert_allclose(maps[1].mean, fields[1]["upper"].mean - fields[0]["upper"].mean)
    with pytest.raises(RunError, match="different draws"):
        compare(a, ran("c", seed=77, fields=False))
    with pytest.raises(RunError, match="has no samples under frictionless"):
        compare(a, b, ("frictionless",))
