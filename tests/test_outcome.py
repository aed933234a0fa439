"""The outcome of a run, against the evaluation that it came from; failed and missing samples."""

import json

import numpy as np
import pandas as pd
import pytest

from mic.model.assembly import assemble
from mic.results.outcome import keep_inputs, kept_parts, read_outcome, write_summary
from mic.sampling.draw import draw
from mic.sampling.montecarlo import BLOCK, run

SAMPLES, SEED = BLOCK + 10, 5
LAWS = ["coulomb", "frictionless"]


@pytest.fixture
def folder(lap_model, tmp_path):
    run(lap_model, tmp_path, LAWS, SAMPLES, SEED)
    return tmp_path


@pytest.fixture(scope="module")
def evaluation(lap_model):
    """The same samples by another route: one batch in memory."""
    return {law: lap_model.process(law).evaluate(draw(lap_model.scene, SEED, 0, SAMPLES)) for law in LAWS}


def _fail(folder, law, numbers):
    """Mark samples as failed, with NaN for everything they hold."""
    for path in (folder / "samples" / f"law={law}").glob("*.parquet"):
        table = pd.read_parquet(path, partitioning=None)
        hit = table["sample"].isin(numbers)
        table.loc[hit, "failed"] = True
        for name in table.columns:
            if name.startswith(("slip:", "measurement:", "residual:")):
                table.loc[hit, name] = np.nan
            if name.startswith("status:"):
                table.loc[hit, name] = "not converged"
        table.to_parquet(path, index=False)


def test_contact_arrays_are_those_of_the_evaluation(folder, evaluation):
    outcome = read_outcome(folder)
    for law in LAWS:
        for stage, resolution in evaluation[law].resolutions.items():
            scale = np.abs(resolution.force).max()
            for j, axis in enumerate(("n", "t1", "t2")):
                np.testing.assert_allclose(
                    outcome.contact(law, stage, f"f_{axis}"), resolution.force[:, :, j], atol=1e-7 * scale
                )
            np.testing.assert_allclose(
                outcome.contact(law, stage, "f_t"),
                np.linalg.norm(resolution.force[:, :, 1:], axis=2),
                atol=1e-7 * scale,
            )
            assert np.mean(outcome.contact(law, stage, "state") == resolution.state) > 0.999
    assert (
        np.abs(evaluation["coulomb"].resolutions["clamp"].force[:, :, 1:]).max() > 0.1
    )  # friction is there to be compared


def test_statistics_of_zones_and_measurements_by_hand(folder, evaluation):
    outcome = read_outcome(folder)
    summary = outcome.summary()
    for law in LAWS:
        for stage, resolution in evaluation[law].resolutions.items():
            slip = np.sqrt((resolution.displacement[:, :, 1:] ** 2).sum(axis=2).mean(axis=1))  # the scene has one zone
            entry = summary["laws"][law]["zones"]["lap"]["stages"][stage]
            assert entry["mean_rms_slip"] == pytest.approx(slip.mean(), rel=1e-6)
            assert entry["six_sigma_rms_slip"] == pytest.approx(6 * slip.std(ddof=1), rel=1e-5)
            assert entry["mean_rms_slip_ci"][0] < entry["mean_rms_slip"] < entry["mean_rms_slip_ci"][1]
        zone = summary["laws"][law]["zones"]["lap"]
        assert (
            zone["mean_rms_slip"] == zone["stages"]["clamp"]["mean_rms_slip"]
        )  # clamping is the first stage that resolves contact
        x = evaluation[law].measurements[:, 0]
        found = summary["laws"][law]["measurements"]["M1"]
        assert found["mean"] == pytest.approx(x.mean(), rel=1e-6)
        assert found["cpk"] == pytest.approx(min(1 - x.mean(), x.mean() + 1) / (3 * x.std(ddof=1)), rel=1e-6)


def test_shares_of_states_add_up(folder):
    table = read_outcome(folder).contact_statistics
    np.testing.assert_allclose(table[["open", "stick", "slip"]].sum(axis=1), 1, rtol=1e-12)
    assert (table.loc[table["law"] == "frictionless", "stick"] == 0).all()
    assert table["open"].nunique() > 1


def test_failed_samples_are_named_and_enter_no_statistic(folder, evaluation):
    _fail(folder, "coulomb", [3, BLOCK + 1])
    outcome = read_outcome(folder)
    summary = outcome.summary()
    assert summary["failed_samples"] == {"coulomb": [3, BLOCK + 1], "frictionless": []}
    assert summary["laws"]["coulomb"]["samples"] == SAMPLES - 2 and summary["laws"]["coulomb"]["failed"] == 2
    kept = np.delete(evaluation["coulomb"].measurements[:, 0], [3, BLOCK + 1])
    assert summary["laws"]["coulomb"]["measurements"]["M1"]["mean"] == pytest.approx(kept.mean(), rel=1e-6)
    assert len(outcome.contact("coulomb", "clamp", "f_n")) == SAMPLES - 2
    assert summary["laws"]["coulomb"]["worst_residual"] < 1e-8
    assert set(outcome.failures("coulomb")["sample"]) == {3, BLOCK + 1}


def test_an_interrupted_run_is_read_and_says_what_is_missing(folder, evaluation):
    (last,) = (folder / "samples" / "law=frictionless").glob(f"{BLOCK:06d}-*")
    last.unlink()  # its contacts are there already: the block was cut off before it was done
    (folder / "samples" / "law=frictionless" / ".half.parquet").write_bytes(b"half a file")
    outcome = read_outcome(folder)
    assert outcome.missing == {"coulomb": 0, "frictionless": 10}
    assert len(outcome.contact("frictionless", "clamp", "f_n")) == BLOCK
    x = evaluation["frictionless"].measurements[:BLOCK, 0]
    assert outcome.summary()["laws"]["frictionless"]["measurements"]["M1"]["mean"] == pytest.approx(x.mean(), rel=1e-6)


def test_a_run_without_any_finished_block_is_read(folder):
    for path in folder.glob("samples/*/*"):
        path.unlink()
    summary = read_outcome(folder).summary()
    assert summary["laws"] == {} and summary["missing_samples"] == dict.fromkeys(LAWS, SAMPLES)


def test_summary_and_tables_on_disk(folder):
    record = json.loads((folder / "run.json").read_text()) | {"wall_time": {"Monte Carlo": 1.5}}
    (folder / "run.json").write_text(json.dumps(record))
    path = write_summary(read_outcome(folder))

    def refuse(name):
        raise AssertionError(f"{name} is not JSON")

    summary = json.loads(path.read_text(), parse_constant=refuse)
    assert summary["wall_time"] == {"Monte Carlo": 1.5} and summary["seed"] == SEED and summary["scene"] == "lap-joint"
    assert summary["laws"]["coulomb"]["measurements"]["M1"]["min_ci"][0] is None  # nothing bounds a minimum from below
    zones = pd.read_csv(folder / "tables" / "zones.csv")
    assert len(zones) == 2 * 2 and zones["mean_rms_slip"].gt(0).all()


def test_kept_parts_are_the_parts(folder, lap_scene, cache):
    assembly = assemble(lap_scene, cache)
    assert kept_parts(read_outcome(folder)) == ()
    keep_inputs(folder, assembly)
    assert [part.fingerprint() for part in kept_parts(read_outcome(folder))] == [
        part.fingerprint() for part in assembly.parts
    ]


def test_a_folder_that_holds_no_run_is_refused(tmp_path):
    with pytest.raises(FileNotFoundError, match="run.json"):
        read_outcome(tmp_path)
