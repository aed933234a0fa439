"""Runs that lose nothing, use nothing of another run, and delete nothing that is not theirs."""

import json
import shutil
from dataclasses import replace

import numpy as np
import pandas as pd
import pytest
from support.runs import RecordedProgress, changed

import mic
from mic.compliance.blocks import Blocks
from mic.errors import RunError, SceneError
from mic.model.assembly import assemble
from mic.results.outcome import read_outcome
from mic.results.run_folder import RunFolder
from mic.results.run_identity import identity
from mic.runs import conclude, read_run, run, sample_into
from mic.scene.schema import Accuracy

LAWS, FRICTIONLESS = ["coulomb", "frictionless"], ["frictionless"]


def read(folder, table, law="coulomb"):
    return pd.read_parquet(folder / table / f"law={law}")


def test_blocks_without_their_record_are_used_by_their_own_identity_only(lap_model, tmp_path):
    sample_into(tmp_path, lap_model, FRICTIONLESS, 10, 4)
    (tmp_path / "run.json").unlink()
    assert sample_into(tmp_path, lap_model, FRICTIONLESS, 10, 4) == {"frictionless": 10}
    for text in ("", None):
        (tmp_path / "run.json").unlink(missing_ok=True)
        if text is not None:
            (tmp_path / "run.json").write_text(text)
        with pytest.raises(RunError, match="another run .*not the requested ones"):
            sample_into(tmp_path, lap_model, FRICTIONLESS, 10, 5)
    assert sample_into(tmp_path, lap_model, FRICTIONLESS, 10, 4) == {"frictionless": 10}


@pytest.mark.parametrize(
    "table, wound",
    [("samples", "gone"), ("samples", "altered"), ("slips", "altered"), ("contacts", "gone"), ("forces", "altered")],
)
def test_a_damaged_block_is_set_aside_computed_again_and_reported(lap_model, sixty, tmp_path, table, wound):
    shutil.copytree(sixty, tmp_path, dirs_exist_ok=True)
    path = sorted((tmp_path / table / "law=coulomb").iterdir())[0]
    if wound == "altered":
        content = np.frombuffer(path.read_bytes(), np.uint8).copy()
        content[len(content) // 3 :][:40] ^= 0xFF
        path.write_bytes(content.tobytes())
    else:
        path.unlink()
    progress = RecordedProgress()
    found = sample_into(tmp_path, lap_model, ["coulomb"], 60, 4, progress=progress)
    assert found == {"coulomb": 10} and len(pd.read_parquet(tmp_path / "samples")) == 60
    outcome = read_run(tmp_path)
    np.testing.assert_array_equal(outcome.measured("coulomb", "M1"), read_run(sixty).measured("coulomb", "M1"))
    if (table, wound) != ("samples", "gone"):  # without its samples a block was never finished
        (sentence,) = progress.sentences
        assert path.name in sentence and "computed again" in sentence
        assert list(tmp_path.glob("*/law=coulomb/*.damaged"))


def test_identity_depends_on_inputs_and_not_on_computed_values(lap_model, lap_scene, cache):
    own = identity(lap_model, 4)
    assert identity(assemble(lap_scene, cache), 4) == own  # known before anything is reduced
    compliance = lap_model.compliance
    computed = Blocks(tuple((1 + 1e-15) * H for H in compliance.H), compliance.G)
    assert identity(replace(lap_model, compliance=computed), 4) == own
    assert identity(lap_model, 5) != own
    assert identity(replace(lap_model, inputs={**lap_model.inputs, "geometry.py": "0"}), 4) != own
    titles = {"description": "other words", "monte_carlo": lap_scene.monte_carlo.model_copy(update={"samples": 3})}
    assert identity(replace(lap_model, scene=lap_scene.model_copy(update=titles)), 4) == own


CHANGED_ITEMS = {
    "parts": {"thickness": 1.1},
    "clamps": {"force": 61.0},
    "deviations": {"sigma": 1.6},
    "stages": {"path": "increments"},
    "measurements": {"point": (156.0, 12.5, 1.0)},
    "zones": {"friction": 0.28},
}


@pytest.mark.parametrize("table", [*CHANGED_ITEMS, "element", "path"])
def test_every_change_of_the_scene_changes_the_identity(lap_model, table):
    scene = lap_model.scene
    if table == "element":
        other = scene.model_copy(update={"element": "p2-cr"})
    elif table == "path":
        other = changed(scene, path={"tolerance": scene.path.tolerance / 2})
    else:
        first, *rest = getattr(scene, table)
        other = scene.model_copy(update={table: [first.model_copy(update=CHANGED_ITEMS[table]), *rest]})
    assert identity(replace(lap_model, scene=other), 4) != identity(lap_model, 4)


@pytest.mark.slow
def test_a_run_from_scene_to_summary(lap_scene, cache, tmp_path):
    scene = changed(lap_scene, monte_carlo={"samples": 8}, report={"laws": LAWS, "fields": False})
    progress = RecordedProgress()
    outcome = run(scene, tmp_path, cache, progress)
    assert outcome.laws == LAWS and outcome.missing == dict.fromkeys(LAWS, 0)
    summary = json.loads((tmp_path / "summary.json").read_text())
    mean = outcome.measured("coulomb", "M1").mean()
    assert summary["laws"]["coulomb"]["measurements"]["M1"]["mean"] == pytest.approx(mean, rel=1e-12)
    assert {"Monte Carlo", "statistics", "influence coefficients"} <= set(summary["wall_time"])
    before = json.loads((tmp_path / "run.json").read_text())["wall_time"]["Monte Carlo"]
    again = conclude(tmp_path)  # other phases keep their time
    assert again.record["wall_time"]["Monte Carlo"] == before
    run(scene, tmp_path, cache, progress)
    assert "coulomb: 8 of 8 samples were already finished" in " ".join(progress.sentences)


def storing(model, contacts):
    """The same model, of which so many samples store their contact pairs."""
    return replace(model, scene=changed(model.scene, report={"contacts": contacts}))


def statistics_of(folder):
    outcome = read_run(folder)
    return [getattr(outcome, f"{name}_statistics") for name in ("zone", "contact", "measurement")]


@pytest.fixture(scope="module")
def long_and_short(lap_model, tmp_path_factory):
    """Folders of 110 samples: all keep their pairs, or only the first block."""
    place = tmp_path_factory.mktemp("pairs")
    for name, contacts in (("all", 2000), ("few", 0)):
        sample_into(place / name, storing(lap_model, contacts), ["coulomb"], 110, 4)
    return place / "all", place / "few"


@pytest.mark.slow
def test_statistics_do_not_depend_on_how_many_samples_store_their_pairs(long_and_short, lap_model):
    whole, few = long_and_short
    assert read(few, "contacts")["sample"].unique().tolist() == list(range(50))  # the first block, as always
    assert len(list((few / "forces").rglob("*.npz"))) == 1 and len(list((few / "condensed").rglob("*.npz"))) == 2
    for one, other in zip(statistics_of(whole), statistics_of(few)):
        pd.testing.assert_frame_equal(one, other, check_exact=True)


def test_pairs_that_are_not_stored_are_refused_in_one_sentence(long_and_short):
    outcome = read_run(long_and_short[1])
    stored = outcome.with_pairs("coulomb")
    assert stored.tolist() == list(range(50))
    assert outcome.contact("coulomb", "clamp", "f_n", stored).shape == (50, len(outcome.model.contacts))
    for samples in (None, [49, 50]):
        with pytest.raises(RunError, match=r"pairs of 50 samples under coulomb.*more contacts in \[report\]"):
            outcome.contact("coulomb", "clamp", "f_n", samples)


@pytest.mark.slow
def test_fewer_samples_of_a_longer_run_are_those_of_a_run_of_so_many(lap_model, tmp_path):
    """Also if the last block has no pairs, so that a part of it cannot be used."""
    model = storing(lap_model, 0)
    sample_into(tmp_path / "first", model, ["coulomb"], 60, 4)
    for count in (70, 60):
        sample_into(tmp_path / "again", model, ["coulomb"], count, 4)
    for one, other in zip(statistics_of(tmp_path / "first"), statistics_of(tmp_path / "again")):
        pd.testing.assert_frame_equal(one, other, check_exact=True)
    sample_into(tmp_path / "again", model, ["coulomb"], 70, 4)
    assert read_run(tmp_path / "again").sample_numbers("coulomb").tolist() == list(range(70))


@pytest.mark.slow
def test_pairs_requested_afterwards_are_computed(long_and_short, lap_model, tmp_path):
    shutil.copytree(long_and_short[1], tmp_path / "run")
    found = sample_into(tmp_path / "run", storing(lap_model, 60), ["coulomb"], 110, 4)
    assert found == {"coulomb": 60}
    assert read_run(tmp_path / "run").with_pairs("coulomb").tolist() == list(range(100))


@pytest.mark.slow
@pytest.mark.parametrize("table, length", [("sums", None), ("condensed", 300)])
def test_a_block_without_sums_of_its_pairs_is_computed_again(long_and_short, lap_model, tmp_path, table, length):
    shutil.copytree(long_and_short[1], tmp_path / "run")
    path = sorted((tmp_path / "run" / table / "law=coulomb").iterdir())[-1]
    content = path.read_bytes()
    path.unlink()
    if length is not None:
        path.write_bytes(content[:length])
    progress = RecordedProgress()
    found = sample_into(tmp_path / "run", storing(lap_model, 0), ["coulomb"], 110, 4, progress)
    assert found == {"coulomb": 100}
    assert "computed again" in " ".join(progress.sentences)
    for one, other in zip(statistics_of(long_and_short[1]), statistics_of(tmp_path / "run")):
        pd.testing.assert_frame_equal(one, other, check_exact=True)


@pytest.mark.parametrize("long, said", [(0.0, True), (1e9, False)])
def test_a_long_run_announces_its_duration_after_its_first_samples(lap_model, tmp_path, monkeypatch, long, said):
    monkeypatch.setattr("mic.runs.LONG", long)
    progress = RecordedProgress()
    sample_into(tmp_path, lap_model, ["frictionless"], 3, 4, progress=progress)
    assert any("The remaining samples take about" in sentence for sentence in progress.sentences) == said


# --- sampling until the accuracy that the scene asks for


def asking(model, accuracy):
    """The model whose scene requests an accuracy."""
    return replace(model, scene=changed(model.scene, monte_carlo={"accuracy": Accuracy(six_sigma=accuracy)}))


def drawn(folder):
    return pd.read_parquet(folder / "samples").sort_values("sample")["sample"].tolist()


@pytest.fixture(scope="module")
def accurate(lap_model, tmp_path_factory):
    """A run until ±1 % of 6σ, and what it said."""
    folder, progress = tmp_path_factory.mktemp("accurate"), RecordedProgress()
    sample_into(folder, asking(lap_model, 0.01), FRICTIONLESS, 500, 4, progress)
    return folder, progress.sentences


@pytest.mark.slow
def test_samples_are_drawn_until_the_accuracy_is_reached_and_no_longer(accurate):
    folder, sentences = accurate
    count, found = RunFolder(folder).record()["samples"], read_outcome(folder)
    uncertainty = found.uncertainty({"six_sigma": 0.01})
    assert uncertainty.reached and drawn(folder) == list(range(count)) and 50 < count < 500
    assert uncertainty.sentence(count) in sentences
    assert found.missing == {"frictionless": 0}


@pytest.mark.slow
def test_the_requested_accuracy_decides_the_number_of_samples(lap_model, tmp_path):
    sample_into(tmp_path / "rough", asking(lap_model, 0.9), FRICTIONLESS, 500, 4)
    assert drawn(tmp_path / "rough") == list(range(50))
    sample_into(tmp_path / "fine", asking(lap_model, 1e-9), FRICTIONLESS, 60, 4, progress := RecordedProgress())
    assert drawn(tmp_path / "fine") == list(range(60))
    assert progress.sentences[-1].endswith("increase --samples")


@pytest.mark.slow
def test_an_interrupted_run_ends_with_the_same_samples(lap_model, accurate, tmp_path):
    model = asking(lap_model, 0.01)
    with pytest.raises(KeyboardInterrupt):
        sample_into(tmp_path, model, FRICTIONLESS, 500, 4, RecordedProgress(stop_after=1))
    sample_into(tmp_path, model, FRICTIONLESS, 500, 4)
    assert drawn(tmp_path) == drawn(accurate[0])
    one, other = (RunFolder(folder).record()["samples"] for folder in (tmp_path, accurate[0]))
    assert one == other


@pytest.mark.parametrize(
    ("keys", "changes", "words"),
    [
        ({"accuracy": 0}, {}, "accuracy"),
        ({"accuracy": 1.0}, {}, "accuracy"),
        ({"accuracy": "2 %"}, {}, "accuracy"),
        ({"accuracy": float("nan")}, {}, "accuracy"),
        ({"accuracy": 0.02, "design": "sobol", "samples": 64}, {}, "accuracy adds samples one by one"),
        ({"accuracy": 0.02, "values": [[0.0, 0.0, 0.0]]}, {}, "accuracy and values exclude each other"),
        ({"accuracy": 0.02, "table": "samples.csv"}, {}, "accuracy and table exclude each other"),
        ({"accuracy": 0.02}, {"measurements": []}, "it needs measurements and deviations"),
    ],
)
def test_invalid_accuracy_requests_are_refused(lap_scene, keys, changes, words):
    table = lap_scene.model_dump(exclude={"setting"}, exclude_none=True) | {"folder": lap_scene.folder}
    table["monte_carlo"] = keys
    with pytest.raises((SceneError, ValueError), match=words):
        mic.Scene(**table | changes)
