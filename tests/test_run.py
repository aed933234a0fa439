"""Runs that lose nothing, use nothing of another run, and delete nothing that is not theirs."""

import json
import shutil
from dataclasses import replace

import numpy as np
import pandas as pd
import pytest
from support.runs import Heard

from mic.compliance.blocks import Blocks
from mic.errors import RunError
from mic.model.assembly import assemble
from mic.results.run_identity import identity
from mic.results.schema import DATASETS
from mic.runs import conclude, read_run, run, sample_into

LAWS = ["coulomb", "frictionless"]


def read(folder, table, law="coulomb"):
    return pd.read_parquet(folder / table / f"law={law}")


@pytest.fixture(scope="module")
def sixty(lap_model, tmp_path_factory):
    """Results folder of 60 samples under Coulomb friction."""
    folder = tmp_path_factory.mktemp("sixty")
    sample_into(folder, lap_model, ["coulomb"], 60, 4)
    return folder


@pytest.mark.slow
def test_run_is_complete_and_reproducible(lap_model, sixty, tmp_path):
    sample_into(tmp_path, lap_model, LAWS, 60, 4)
    for table in DATASETS:
        pd.testing.assert_frame_equal(read(tmp_path, table.name), read(sixty, table.name))
    samples, contacts = read(tmp_path, "samples"), read(tmp_path, "contacts")
    assert samples["sample"].tolist() == list(range(60)) and not samples["failed"].any()
    assert len(contacts) == 60 * 2 * len(lap_model.contacts)
    assert json.loads((tmp_path / "run.json").read_text())["seed"] == 4


@pytest.mark.slow
def test_an_interrupted_run_keeps_finished_blocks(lap_model, tmp_path):
    with pytest.raises(KeyboardInterrupt):
        sample_into(tmp_path, lap_model, LAWS, 120, 4, progress=Heard(stop_after=1))
    blocks = {path: path.stat().st_mtime_ns for path in (tmp_path / "samples").glob("*/[!.]*.parquet")}
    done = {law: [pd.read_parquet(path)["sample"].tolist() for path in blocks if law in str(path)] for law in LAWS}
    whole = [list(range(first, min(first + 50, 120))) for first in range(0, 120, 50)]
    assert blocks and all(block in whole for found in done.values() for block in found)  # one more perhaps, of a copy
    kept = {law: sum(len(block) for block in done[law]) for law in LAWS}
    assert kept["coulomb"] and sample_into(tmp_path, lap_model, LAWS, 120, 4) == kept
    assert all(path.stat().st_mtime_ns == written for path, written in blocks.items())
    sample_into(tmp_path / "whole", lap_model, LAWS, 120, 4)
    pd.testing.assert_frame_equal(read(tmp_path, "measurements"), read(tmp_path / "whole", "measurements"))


@pytest.mark.slow
def test_another_seed_is_refused_and_replaces_a_run_only_on_request(lap_model, tmp_path):
    sample_into(tmp_path, lap_model, LAWS, 20, 4)
    with pytest.raises(RunError, match=r"another run \(seed: 4 in the folder, 5 requested\).*--out.*--replace"):
        sample_into(tmp_path, lap_model, LAWS, 20, 5)
    assert read_run(tmp_path).record["seed"] == 4 and read_run(tmp_path).missing == dict.fromkeys(LAWS, 0)
    assert sample_into(tmp_path, lap_model, ["coulomb"], 10, 5, replace=True) == {"coulomb": 0}
    assert len(pd.read_parquet(tmp_path / "samples")) == 10 and read_run(tmp_path).record["seed"] == 5


def test_blocks_without_their_record_are_used_by_their_own_identity_only(lap_model, tmp_path):
    sample_into(tmp_path, lap_model, ["coulomb"], 20, 4)
    (tmp_path / "run.json").unlink()
    assert sample_into(tmp_path, lap_model, ["coulomb"], 20, 4) == {"coulomb": 20}
    for text in ("", None):
        (tmp_path / "run.json").unlink(missing_ok=True)
        if text is not None:
            (tmp_path / "run.json").write_text(text)
        with pytest.raises(RunError, match="another run .*not the requested ones"):
            sample_into(tmp_path, lap_model, ["coulomb"], 20, 5)
    assert sample_into(tmp_path, lap_model, ["coulomb"], 20, 4) == {"coulomb": 20}


@pytest.mark.parametrize(
    "table, wound", [("samples", "gone"), ("slips", "altered"), ("contacts", "gone"), ("forces", "altered")]
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
    heard = Heard()
    found = sample_into(tmp_path, lap_model, ["coulomb"], 60, 4, progress=heard)
    assert found == {"coulomb": 10} and read_run(tmp_path).missing == {"coulomb": 0}
    if (table, wound) != ("samples", "gone"):  # without its samples a block was never finished
        (sentence,) = heard.sentences
        assert path.name in sentence and "computed again" in sentence
        assert list(tmp_path.glob("*/law=coulomb/*.damaged"))


def test_identity_depends_on_inputs_and_not_on_computed_values(lap_model, lap_scene, cache):
    own = identity(lap_model, 4)
    assert identity(assemble(lap_scene, cache), 4) == own  # known before anything is reduced
    compliance = lap_model.compliance
    computed = Blocks(tuple((1 + 1e-15) * H for H in compliance.H), compliance.G)
    assert identity(replace(lap_model, compliance=computed), 4) == own
    assert identity(lap_model, 5) != own
    thicker = [part.model_copy(update={"thickness": 1.1}) for part in lap_scene.parts]
    for changes in ({"parts": thicker}, {"element": "p2-cr"}, {"zones": []}):
        assert identity(replace(lap_model, scene=lap_scene.model_copy(update=changes)), 4) != own
    assert identity(replace(lap_model, inputs={**lap_model.inputs, "geometry.py": "0"}), 4) != own
    titles = {"description": "other words", "monte_carlo": lap_scene.monte_carlo.model_copy(update={"samples": 3})}
    assert identity(replace(lap_model, scene=lap_scene.model_copy(update=titles)), 4) == own


def test_how_exactly_the_path_is_followed_belongs_to_the_identity(lap_model, monkeypatch):
    own = identity(lap_model, 4)
    finer = lap_model.scene.path.model_copy(update={"tolerance": lap_model.scene.path.tolerance / 2})
    assert identity(replace(lap_model, scene=lap_model.scene.model_copy(update={"path": finer})), 4) != own
    monkeypatch.setattr("mic.results.run_identity.LEAST_MOTION", 0.04)
    assert identity(lap_model, 4) != own


@pytest.mark.slow
def test_a_run_from_scene_to_summary(lap_scene, cache, tmp_path):
    few = lap_scene.monte_carlo.model_copy(update={"samples": 8})
    report = lap_scene.report.model_copy(update={"laws": LAWS, "fields": False})
    scene = lap_scene.model_copy(update={"monte_carlo": few, "report": report})
    heard = Heard()
    outcome = run(scene, tmp_path, cache, heard)
    assert outcome.laws == LAWS and outcome.missing == dict.fromkeys(LAWS, 0)
    summary = json.loads((tmp_path / "summary.json").read_text())
    mean = outcome.measured("coulomb", "M1").mean()
    assert summary["laws"]["coulomb"]["measurements"]["M1"]["mean"] == pytest.approx(mean, rel=1e-12)
    assert {"Monte Carlo", "statistics", "influence coefficients"} <= set(summary["wall_time"])
    before = json.loads((tmp_path / "run.json").read_text())["wall_time"]["Monte Carlo"]
    again = conclude(tmp_path)  # other phases keep their time
    assert again.record["wall_time"]["Monte Carlo"] == before
    run(scene, tmp_path, cache, heard)
    assert "coulomb: 8 of 8 samples were already finished" in " ".join(heard.sentences)


def keeping(model, contacts, **report):
    """The same model, of which so many samples keep their contact pairs."""
    asked = model.scene.report.model_copy(update={"contacts": contacts, **report})
    return replace(model, scene=model.scene.model_copy(update={"report": asked}))


def statistics_of(folder):
    outcome = read_run(folder)
    return [getattr(outcome, f"{name}_statistics") for name in ("zone", "contact", "measurement")]


@pytest.fixture(scope="module")
def long_and_short(lap_model, tmp_path_factory):
    """Folders of 120 samples: all keep their pairs, or only the first block."""
    place = tmp_path_factory.mktemp("pairs")
    for name, contacts in (("all", 2000), ("few", 0)):
        sample_into(place / name, keeping(lap_model, contacts), LAWS, 120, 4)
    return place / "all", place / "few"


@pytest.mark.slow
def test_statistics_do_not_depend_on_how_many_samples_store_their_pairs(long_and_short, lap_model):
    whole, few = long_and_short
    assert read(few, "contacts")["sample"].unique().tolist() == list(range(50))  # the first block, as always
    assert len(list((few / "forces").rglob("*.npz"))) == 2 and len(list((few / "condensed").rglob("*.npz"))) == 4
    for one, other in zip(statistics_of(whole), statistics_of(few)):
        pd.testing.assert_frame_equal(one, other, check_exact=True)


def test_pairs_that_are_not_stored_are_refused_in_one_sentence(long_and_short):
    outcome = read_run(long_and_short[1])
    kept = outcome.with_pairs("coulomb")
    assert kept.tolist() == list(range(50))
    assert outcome.contact("coulomb", "clamp", "f_n", kept).shape == (50, len(outcome.model.contacts))
    for samples in (None, [49, 50]):
        with pytest.raises(RunError, match=r"pairs of 50 samples under coulomb.*more contacts in \[report\]"):
            outcome.contact("coulomb", "clamp", "f_n", samples)


@pytest.mark.slow
@pytest.mark.parametrize("contacts", [0, 2000])
def test_fewer_samples_of_a_longer_run_are_those_of_a_run_of_so_many(lap_model, tmp_path, contacts):
    model = keeping(lap_model, contacts)
    sample_into(tmp_path / "first", model, ["coulomb"], 90, 4)
    for count in (100, 90):
        sample_into(tmp_path / "again", model, ["coulomb"], count, 4)
    for one, other in zip(statistics_of(tmp_path / "first"), statistics_of(tmp_path / "again")):
        pd.testing.assert_frame_equal(one, other, check_exact=True)
    sample_into(tmp_path / "again", model, ["coulomb"], 100, 4)
    assert read_run(tmp_path / "again").sample_numbers("coulomb").tolist() == list(range(100))


@pytest.mark.slow
def test_pairs_requested_afterwards_are_computed(long_and_short, lap_model, tmp_path):
    shutil.copytree(long_and_short[1], tmp_path / "run")
    found = sample_into(tmp_path / "run", keeping(lap_model, 60), LAWS, 120, 4)
    assert found == dict.fromkeys(LAWS, 70)
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
    heard = Heard()
    assert sample_into(tmp_path / "run", keeping(lap_model, 0), LAWS, 120, 4, progress=heard)["coulomb"] == 100
    assert "computed again" in " ".join(heard.sentences)
    for one, other in zip(statistics_of(long_and_short[1]), statistics_of(tmp_path / "run")):
        pd.testing.assert_frame_equal(one, other, check_exact=True)


@pytest.mark.parametrize("long, said", [(0.0, True), (1e9, False)])
def test_a_long_run_announces_its_duration_after_its_first_samples(lap_model, tmp_path, monkeypatch, long, said):
    monkeypatch.setattr("mic.runs.LONG", long)
    heard = Heard()
    sample_into(tmp_path, lap_model, ["frictionless"], 3, 4, progress=heard)
    assert any("The remaining samples take about" in sentence for sentence in heard.sentences) == said
