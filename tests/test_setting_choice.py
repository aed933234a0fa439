"""The setting auto: its choice from a few samples, and its messages."""

import json
import tomllib
from pathlib import Path

import pytest

import mic
from mic import setting_choice
from mic.contact.path import Followed
from mic.setting_choice import choose

pytestmark = pytest.mark.slow
LAP = Path(__file__).resolve().parents[1] / "meshes" / "lap_joint" / "scene.toml"


def scene(accuracy=0.05, friction=0.27, **changes):
    """The lap joint, whose meshes and pairs are stated and whose path is open."""
    table = tomllib.loads(LAP.read_text(encoding="utf-8"))
    table["zones"][0] |= {"pairs": 8, "friction": friction}
    given = {"setting": "auto", "stiffness": "nominal", "report": {"laws": ["coulomb"], "fields": False}}
    given["monte_carlo"] = {"accuracy": accuracy, "samples": 50}
    return mic.Scene(**table | given | changes).model_copy(update={"folder": LAP.parent})


def test_the_cheapest_path_within_the_target_is_chosen_and_its_error_stated(cache):
    tight = choose(scene(0.01), cache)
    assert [trial.accepted for trial in tight.trials][:-1] == [False] * (len(tight.trials) - 1)
    assert tight.scene.path.tolerance <= 40 * Followed.tolerance and tight.scene.stages[1].increments is None
    first, last = tight.trials[0], tight.trials[-1]
    assert first.error + first.half > 0.01 / 2**0.5 >= last.error + last.half
    assert json.loads(json.dumps(tight.record()))["trials"][0]["accepted"] is False


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


@pytest.mark.parametrize("changes", [{"friction": 0.0}, {"report": {"laws": ["frictionless"]}}])
def test_a_scene_without_friction_leaves_the_path_and_says_so(cache, changes):
    found = choose(scene(**changes), cache)
    assert not found.trials and found.scene.path == scene().path and "leaves nothing open" in found.sentence()


def test_a_run_prints_and_stores_the_choice(tmp_path, cache):
    lines = []

    class Lines(mic.runs.Progress):
        def report(self, sentence):
            lines.append(sentence)

    outcome = mic.run(scene(0.5), tmp_path / "out", cache, Lines())
    record = json.loads((tmp_path / "out" / "run.json").read_text())["setting"]
    first, last = [line for line in lines if line.startswith("auto: ")]
    assert "one increment per step" in first and "accepted" in first and "chosen for 6σ to 0.5" in last
    assert [stage.increments for stage in outcome.model.scene.stages] == [None, 1, 1, 1, None]
    assert record["target"] == 0.5 and record["chosen"][0].startswith("one increment per step")
