"""The setting auto: what it chooses from a few samples, and what it says."""

import json
import tomllib
from pathlib import Path

import pytest

import mic
from mic import setting_choice
from mic.contact.path import Followed
from mic.setting_choice import choose

pytestmark = pytest.mark.fem
LAP = Path(__file__).resolve().parents[1] / "meshes" / "lap_joint" / "scene.toml"


def scene(accuracy=0.05, friction=None, **changes):
    """The lap joint, whose meshes and stated pairs are fixed and whose path is open."""
    table = tomllib.loads(LAP.read_text(encoding="utf-8"))
    (zone,) = table["zones"]
    zone |= {"pairs": 24}
    for part in table["parts"]:
        part["size"] = "coarse"
    if friction is not None:
        zone["friction"] = friction
    given = {"setting": "auto", "monte_carlo": {"accuracy": accuracy}, "report": {"laws": ["coulomb"]}} | changes
    return mic.Scene(**table | given).model_copy(update={"folder": LAP.parent})


@pytest.mark.slow
def test_the_cheapest_path_within_the_target_is_chosen_and_its_error_stated(cache):
    lines = []
    loose = choose(scene(0.5), cache, lines.append)
    assert [stage.increments for stage in loose.scene.stages] == [None, 1, 1, 1, None]
    assert "one increment per step" in lines[0] and "accepted" in lines[0] and "chosen for 6σ to 0.5" in lines[-1]
    tight = choose(scene(0.004), cache)
    assert [trial.accepted for trial in tight.trials][:-1] == [False] * (len(tight.trials) - 1)
    assert tight.scene.path.tolerance <= 40 * Followed.tolerance and tight.scene.stages[1].increments is None
    first, last = tight.trials[0], tight.trials[-1]
    assert first.error + first.half > 0.004 / 2**0.5 >= last.error + last.half
    assert json.loads(json.dumps(tight.record()))["trials"][0]["accepted"] is False


@pytest.mark.slow
def test_a_path_is_judged_by_the_difference_of_the_same_samples(cache, monkeypatch):
    """A difference of no sample accepts the coarsest path for any target; a planted one is found in size."""
    plain = setting_choice.quantities

    def planted(model, evaluation):
        found = plain(model, evaluation)
        return found * (1.02 if model.scene.stages[1].increments else 1.0)

    monkeypatch.setattr(setting_choice, "PATHS", ({"increments": 64}, setting_choice.JUDGE))
    honest = choose(scene(0.02), cache).trials[0]
    monkeypatch.setattr(setting_choice, "quantities", planted)
    trial = choose(scene(0.02), cache).trials[0]
    assert honest.accepted and not trial.accepted
    assert trial.error == pytest.approx(0.02, abs=honest.error + 1e-3)


@pytest.mark.slow
def test_a_scene_without_friction_leaves_the_path_and_says_so(cache):
    found = choose(scene(friction=0.0), cache)
    assert not found.trials and found.scene.path == scene().path and "leaves nothing open" in found.sentence()


@pytest.mark.slow
def test_a_run_prints_and_stores_the_choice(tmp_path, cache):
    lines = []

    class Lines(mic.runs.Progress):
        def report(self, sentence):
            lines.append(sentence)

    outcome = mic.run(scene(0.2), tmp_path / "out", cache, Lines())
    record = json.loads((tmp_path / "out" / "run.json").read_text())["setting"]
    assert record["target"] == 0.2 and any("auto: chosen" in line for line in lines)
    assert outcome.model.scene.stages[1].increments == 1 and record["chosen"][0].startswith("one increment per step")
