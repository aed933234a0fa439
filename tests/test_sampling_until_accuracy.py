"""Samples drawn until every 6σ is known as well as asked for."""

from dataclasses import replace

import pandas as pd
import pytest
from support.runs import Heard

import mic
from mic.errors import SceneError
from mic.results.outcome import read_outcome
from mic.results.run_folder import RunFolder
from mic.runs import sample_into

LAWS = ["frictionless"]


def asking(model, **keys):
    """The model whose scene asks for an accuracy."""
    monte_carlo = model.scene.monte_carlo.model_copy(update=keys)
    return replace(model, scene=model.scene.model_copy(update={"monte_carlo": monte_carlo}))


def drawn(folder):
    return pd.read_parquet(folder / "samples").sort_values("sample")["sample"].tolist()


def test_samples_are_drawn_until_the_accuracy_is_reached_and_no_longer(lap_model, tmp_path):
    heard = Heard()
    sample_into(tmp_path, asking(lap_model, accuracy=0.004), LAWS, 500, 4, heard)
    count = RunFolder(tmp_path).record()["samples"]
    found = read_outcome(tmp_path)
    assert found.uncertainty <= 0.004 and drawn(tmp_path) == list(range(count)) and 50 <= count < 500
    reached = f"every 6σ at most {found.uncertainty:.2%} (requested: 0.40%)"
    assert f"{count} samples: half-width of the 95 % interval of {reached}" in heard.sentences
    assert found.missing == {"frictionless": 0}


def test_the_requested_accuracy_decides_the_number_of_samples(lap_model, tmp_path):
    sample_into(tmp_path / "rough", asking(lap_model, accuracy=0.9), LAWS, 500, 4)
    assert drawn(tmp_path / "rough") == list(range(50))
    sample_into(tmp_path / "fine", asking(lap_model, accuracy=1e-9), LAWS, 120, 4, heard := Heard())
    assert drawn(tmp_path / "fine") == list(range(120))
    assert heard.sentences[-1].endswith("increase --samples")


@pytest.mark.slow
def test_an_interrupted_run_ends_with_the_same_samples(lap_model, tmp_path):
    model = asking(lap_model, accuracy=2e-4)
    sample_into(tmp_path / "whole", model, LAWS, 300, 4)
    with pytest.raises(KeyboardInterrupt):
        sample_into(tmp_path / "parts", model, LAWS, 300, 4, Heard(stop_after=2))
    sample_into(tmp_path / "parts", model, LAWS, 300, 4)
    assert drawn(tmp_path / "parts") == drawn(tmp_path / "whole")
    assert len(drawn(tmp_path / "whole")) > 50
    one, other = (RunFolder(tmp_path / name).record()["samples"] for name in ("parts", "whole"))
    assert one == other


@pytest.mark.parametrize(
    ("keys", "words"),
    [
        ({"accuracy": 0}, "accuracy"),
        ({"accuracy": 1.0}, "accuracy"),
        ({"accuracy": -0.02}, "accuracy"),
        ({"accuracy": "2 %"}, "accuracy"),
        ({"accuracy": float("nan")}, "accuracy"),
        ({"accuracy": [0.02]}, "accuracy"),
        ({"accuracy": 0.02, "design": "sobol", "samples": 64}, "accuracy adds samples one by one"),
        ({"accuracy": 0.02, "values": [[0.0, 0.0, 0.0]]}, "accuracy and values exclude each other"),
        ({"accuracy": 0.02, "table": "samples.csv"}, "accuracy and table exclude each other"),
    ],
)
def test_invalid_accuracy_requests_are_refused(lap_scene, keys, words):
    table = lap_scene.model_dump(exclude={"setting"}, exclude_none=True) | {"folder": lap_scene.folder}
    table["monte_carlo"] = keys
    with pytest.raises((SceneError, ValueError), match=words):
        mic.Scene(**table)


def test_an_accuracy_of_nothing_is_refused(lap_scene):
    table = lap_scene.model_dump(exclude={"setting"}, exclude_none=True) | {"folder": lap_scene.folder}
    table["monte_carlo"], table["measurements"] = {"accuracy": 0.02}, []
    with pytest.raises((SceneError, ValueError), match="it needs measurements and deviations"):
        mic.Scene(**table)
