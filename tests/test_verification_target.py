"""The cheapest setting within a target error of 6σ, and the advice where there is none."""

import shutil
from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pandas as pd
import pytest
from support.runs import changed
from typer.testing import CliRunner

import mic
from mic import examples
from verification import budget, target
from verification.__main__ import app
from verification.budget import Item
from verification.sampling_cost import FEW, SamplingCost, enough, leading, measure_sampling
from verification.target import Tried, advice, as_set, choose, share_of, shares

pytestmark = pytest.mark.fem

LAP = examples.folder("lap_joint")


@pytest.mark.parametrize("text, share", [("2%", 0.02), ("0.02", 0.02), ("0.5 %", 0.005)])
def test_a_target_is_a_share(text, share):
    assert share_of(text) == pytest.approx(share)


@pytest.mark.parametrize("text", ["0", "-1%", "51%", "two", "nan"])
def test_invalid_shares_are_refused_at_once(text):
    with pytest.raises(ValueError, match="give one such as 2%"):
        share_of(text)
    found = CliRunner().invoke(app, ["scene", str(LAP), f"--to={text}"])
    assert found.exit_code == 2 and "no relative error" in found.output


def test_a_setting_replaces_what_the_scene_states():
    scene = mic.load_scene(examples.folder("wheelhouse"))
    assert not scene.zones[0].candidates and scene.parts[0].size == "medium"
    coarse = as_set(scene, "draft")
    assert all(zone.candidates for zone in coarse.zones) and {part.size for part in coarse.parts} == {"medium"}
    assert coarse.path.tolerance > scene.path.tolerance and coarse.stages[1].order == scene.stages[1].order


SIX = pd.Series({"measurement:M1": 1.0, "measurement:M2": 0.05, "slip:clamp:lap": 0.01, "slip:release:lap": 0.0})


def item(source, error, half):
    """A source with these relative errors of every 6σ, ten times as much for the second key characteristic."""
    size = SIX * [1, 10, 1, 1]
    names = ("mean", "mean_half", "six_sigma", "six_sigma_half")
    return Item(source, "", 0.0, pd.DataFrame(dict(zip(names, (0 * size, 0 * size, error * size, half * size)))))


def test_errors_are_those_of_the_largest_figures_of_each_kind():
    assert list(leading(SIX)) == ["measurement:M1", "slip:clamp:lap"]  # a twentieth, and nothing, lead nowhere
    found = shares([item("path", 0.003, 0.001), item("pairs", -0.01, 0.0)], SIX)
    assert found.loc["path", ["error", "unsure"]].tolist() == pytest.approx([0.003, 0.001])
    assert found.loc["all", ["error", "unsure"]].tolist() == pytest.approx([0.007, 0.001])  # errors have signs
    one = Tried("draft", found, 1.0, 0.1, 30)  # the uncertainty counts as well
    assert one.most == pytest.approx(0.008) and not one.meets(0.0075) and one.meets(0.0081)
    unknown = shares([item("path", 0.003, 0.001), Item("pairs", "no room", 0.0, None)], SIX)
    assert np.isnan(unknown.at["all", "error"]) and not Tried("draft", unknown, 1.0, 0.1, 30).meets(0.5)


def tried(setting, mesh, half=None, samples=30):
    """A setting with this mesh error, a tenth of it uncertain, and next to no error of path and pairs."""
    half = mesh / 10 if half is None else half
    items = [item("path", 1e-4, 0.0), item("pairs", 1e-4, 0.0), item("mesh and element", mesh, half)]
    return Tried(setting, shares(items, SIX), preparation=10.0, each=0.01, samples=samples)


def test_samples_are_added_only_where_they_would_decide():
    for mesh, half, samples, further in (
        (0.015, None, 30, 0),  # within the target
        (0.03, 0.005, 30, 0),  # surely above
        (0.0098, 0.02, 30, 120),  # the uncertainty must halve: four times as many
        (0.0298, 0.011, 30, 60),  # nearly decided: at least as many again
        (0.0198, 0.02, 30, target.MOST),
        (0.0198, 0.02, target.MOST, 0),
        (0.0098, 0.039, 30, target.MOST),  # four times as many leave half of it
        (0.0098, 0.041, 30, 0),  # the most samples would not decide it
    ):
        assert tried("draft", mesh, half, samples).further(0.02) == further, (mesh, half)
    unknown = shares([Item("pairs", "no room", 0.0, None)], SIX)
    assert Tried("draft", unknown, 1.0, 0.1, 30).further(0.02) == 0


@pytest.mark.slow
def test_a_setting_gets_more_samples_until_it_is_decided(monkeypatch, tmp_path, lap_scene, lap_model):
    """The uncertainty of the mesh error halves with four times the samples."""
    cases = []

    def estimate(case, *_):
        cases.append(case)
        half = 0.02 * (30 / case.samples) ** 0.5
        return [item("path", 0.0, 0.0), item("pairs", 0.0, 0.0), item("mesh and element", 0.01, half)]

    monkeypatch.setattr(target, "estimate", estimate)
    monkeypatch.setattr(target, "leading", lambda six_sigma: SIX.index[:1])
    monkeypatch.setattr(target, "shares", lambda items, six_sigma: shares(items, SIX))
    monkeypatch.setattr(target, "reduced_and_assembly", lambda *_: (lap_model, SimpleNamespace(scene=lap_scene)))
    lines = []
    found = choose(lap_scene, 0.02, tmp_path, tmp_path, target.Team(), lines.append)
    assert [case.samples for case in cases] == [30, 120] and [one.samples for one in found] == [120]
    assert all(len(case.production) == case.samples for case in cases)
    assert "not decided; 120 samples next" in lines[0] and "by 120 samples" in lines[-1]


def test_the_cheapest_setting_within_the_target_is_chosen(monkeypatch, tmp_path):
    left = {"draft": 0.08, "standard": 0.015, "reference": 0.001}
    monkeypatch.setattr(target, "attempt", lambda scene, setting, *rest: tried(setting, left[setting]))
    scene, team = mic.load_scene(LAP), target.Team()
    names = lambda share: [one.setting for one in choose(scene, share, tmp_path, tmp_path, team, lambda line: None)]
    assert names(0.1) == ["draft"] and names(0.02) == ["draft", "standard"]
    assert names(1e-4) == ["draft", "standard", "reference"]


def test_advice_names_the_setting_with_its_cost_or_the_remedy():
    said = advice([tried("draft", 0.015)], 0.02)
    assert 'setting = "draft"' in said and "4803 samples alone have" in said and "58 CPU s" in said
    said = advice([replace(tried("draft", 0.015), sampling=SamplingCost(half=0.03, each=0.02))], 0.02)
    assert "113 followed samples with surrogates have" in said and "12 CPU s" in said  # 10 s of preparation
    assert enough(0.062) == pytest.approx(500, rel=0.01)
    said = advice([tried("reference", 0.04)], 0.02)  # a third of the target for each source: 0.04 / 0.00667, root
    assert "no setting is shown to be enough" in said and "0.41 times the element size" in said
    assert "candidates" not in said
    said = advice([tried("reference", 0.0058, 0.028, 480)], 0.02)  # twice what is unsure to spare
    assert "0.006 ± 0.028" in said and "about 1920 samples would decide" in said


def test_the_cheaper_estimator_is_chosen():
    known = SamplingCost(half=0.01, each=0.1)
    assert known.samples(0.02) == FEW and known.samples(0.005) == 4 * FEW
    assert known.cheapest(0.02, each=0.1) == (5.0, FEW, "50 followed samples with surrogates")
    assert known.cheapest(0.02, each=1e-4)[1:] == (enough(0.02), f"{enough(0.02)} samples alone")
    assert SamplingCost().cheapest(0.02, each=1.0)[1] == enough(0.02)


@pytest.mark.slow
def test_fifty_followed_samples_with_surrogates_know_the_lap_joint_and_given_samples_do_not(lap_model):
    found = measure_sampling(lap_model, "coulomb", 4)
    assert 1e-4 < found.half < 0.05 and found.each > 0
    monte_carlo = {"values": [[0.0, 0.0, 0.0]] * 500}
    given = replace(lap_model, scene=changed(lap_model.scene, monte_carlo=monte_carlo))
    assert np.isnan(measure_sampling(given, "coulomb", 4).half)


def test_a_source_without_a_known_uncertainty_is_named():
    unknown = tried("reference", 0.004, np.nan)
    assert "not known, mesh and element" in advice([unknown], 0.02)
    assert not unknown.meets(0.5) and unknown.further(0.02) == 0


@pytest.mark.slow
def test_a_coarse_lap_joint_is_known_to_five_per_cent_by_a_draft(tmp_path, cache, monkeypatch):
    """On the mesh of the setting, 2.5 mm, its error against the reference of the study of trade is 1 %."""
    monkeypatch.setenv("MIC_CACHE", str(cache))
    monkeypatch.setattr(budget, "SHARES", budget.SHARES[-1:])
    shutil.copytree(LAP, tmp_path / "lap")
    geometry = tmp_path / "lap" / "geometry.py"
    geometry.write_text(geometry.read_text().replace('"medium": 2.5', '"medium": 5.0'))
    found = CliRunner().invoke(app, ["scene", str(tmp_path / "lap"), "--to", "5%", "--out", str(tmp_path)])
    assert found.exit_code == 0 and 'setting = "draft"' in found.output
    table = pd.read_csv(tmp_path / "target.csv")
    assert list(table["source"]) == ["path", "pairs", "mesh and element", "all"] and (table["error"] < 0.05).all()
