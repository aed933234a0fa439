"""The outcome of a run, against the evaluation that it came from; failed and missing samples."""

import json
import shutil
from dataclasses import fields, replace

import numpy as np
import pandas as pd
import pytest
from support.runs import fail

from mic.errors import FormatError, RunError
from mic.execution.monte_carlo import BLOCK
from mic.model.assembly import assemble
from mic.process.evaluation import Evaluation
from mic.results.block_samples import BlockSamples
from mic.results.block_statistics import Accumulator
from mic.results.outcome import BlockCache, memory, read_outcome
from mic.results.run_folder import Block, RunFolder
from mic.results.table_writer import write_tables
from mic.runs import sample_into, write_evaluation
from mic.statistics import estimates
from mic.statistics.capability import centred_capability
from mic.statistics.draw import draw

SAMPLES, SEED = BLOCK + 10, 5
LAWS = ["coulomb", "frictionless"]


@pytest.fixture(scope="module")
def sampled(lap_model, tmp_path_factory):
    folder = tmp_path_factory.mktemp("sampled")
    sample_into(folder, lap_model, LAWS, SAMPLES, SEED)
    return folder


@pytest.fixture
def folder(sampled, tmp_path):
    """A copy of the run, which a test may change."""
    return shutil.copytree(sampled, tmp_path, dirs_exist_ok=True)


@pytest.fixture(scope="module")
def evaluation(lap_model):
    """The same samples evaluated in memory, in the blocks of the run, because rounding depends on the batch."""
    blocks = [draw(lap_model.scene, SEED, first, min(BLOCK, SAMPLES - first)) for first in range(0, SAMPLES, BLOCK)]
    return {law: Evaluation.join([lap_model.process(law).evaluate(block) for block in blocks]) for law in LAWS}


def zone_rms(motion):
    """(n,) root mean square over the pairs of the scene's only zone."""
    return np.sqrt((motion**2).sum(axis=2).mean(axis=1))


def test_accessors_return_values_of_the_evaluation(sampled, evaluation, lap_model):
    outcome, near = read_outcome(sampled), np.testing.assert_allclose
    assert outcome.stages == ["clamp", "release"] and outcome.has_slip
    for law in LAWS:
        assert outcome.sample_numbers(law).tolist() == list(range(SAMPLES))
        for j, name in enumerate(lap_model.parameters):
            np.testing.assert_array_equal(outcome.deviation(law, name), evaluation[law].deviations[:, j])
        for j, item in enumerate(lap_model.scene.measurements):
            near(outcome.measured(law, item.name), evaluation[law].measurements[:, j], rtol=1e-7)
        for stage, resolution in evaluation[law].resolutions.items():
            tolerance = 1e-7 * np.abs(resolution.force).max()
            for j, axis in enumerate(("n", "t1", "t2")):
                near(outcome.contact(law, stage, f"f_{axis}"), resolution.force[:, :, j], atol=tolerance)
            friction = np.linalg.norm(resolution.force[:, :, 1:], axis=2)
            near(outcome.contact(law, stage, "f_t"), friction, atol=tolerance)
            assert np.mean(outcome.contact(law, stage, "state") == resolution.state) > 0.999
            near(outcome.tangential(law, stage, "lap"), zone_rms(resolution.displacement[:, :, 1:]), rtol=1e-6)
            slip = zone_rms(resolution.trace.slip) if law == "coulomb" else np.full(SAMPLES, np.nan)
            near(outcome.slip(law, stage, "lap"), slip, rtol=1e-6)
            near(outcome.path_error(law, stage), resolution.trace.error, rtol=1e-6, atol=1e-12)
            assert outcome.residual(law, stage).max() <= outcome.worst_residual(law) < 1e-8
    assert outcome.contact("coulomb", "clamp", "f_t").max() > 0.1  # there is friction to compare
    with pytest.raises(KeyError, match="M7.*M1"):
        outcome.measured("coulomb", "M7")


@pytest.mark.slow
def test_statistics_block_by_block_are_those_of_all_samples_at_once(folder):
    fail(folder, "coulomb", {3: ("clamp", "not converged")})
    outcome = read_outcome(folder)
    assert [len(outcome.blocks[law]) for law in LAWS] == [2, 2]
    # A gap of zero is rounding error, and sums over blocks round differently.
    close = lambda found, whole: np.testing.assert_allclose(found, whole, rtol=1e-12, atol=1e-17)
    for law in LAWS:
        for stage in outcome.stages:
            rows = outcome.contact_statistics.query("law == @law and stage == @stage")
            for name, column in (("f_n", "f_n"), ("slip_force", "f_t")):
                x = outcome.contact(law, stage, column)
                for prefix, estimate in (("mean", estimates.mean(x)), ("six_sigma", estimates.six_sigma(x))):
                    for suffix, whole in (("", estimate.value), ("_low", estimate.low), ("_high", estimate.high)):
                        close(rows[f"{prefix}_{name}{suffix}"], whole)
            close(rows["mean_gap"], outcome.contact(law, stage, "u_n").mean(axis=0))
            close(rows["mean_tangential"], outcome.contact(law, stage, "u_t").mean(axis=0))
            for name in ("path_stick", "path_slip"):
                close(rows[name], outcome.contact(law, stage, name).astype(float).mean(axis=0))
            state = outcome.contact(law, stage, "state")
            for code, name in enumerate(("open", "stick", "slip")):
                close(rows[name], (state == code).mean(axis=0))
            (row,) = outcome.zone_statistics.query("law == @law and stage == @stage").to_dict("records")
            for name, x in (
                ("rms_tangential", outcome.tangential(law, stage, "lap")),
                ("rms_slip", outcome.slip(law, stage, "lap")),
                ("normal_force", outcome.contact(law, stage, "f_n").sum(axis=1)),
            ):
                close([row[f"mean_{name}"], row[f"six_sigma_{name}"]], [x.mean(), 6 * x.std(ddof=1)])
        for row in outcome.measurement_statistics.query("law == @law").to_dict("records"):
            x = outcome.measured(law, row["measurement"])
            close([row["mean"], row["sigma"], row["min"], row["max"]], [x.mean(), x.std(ddof=1), x.min(), x.max()])
            cpk = centred_capability(x, row["lower"], row["upper"])
            close([row["cpk"], row["cpk_low"], row["cpk_high"]], [cpk.value, cpk.low, cpk.high])
            close(row["share_outside"], np.mean((x < row["lower"]) | (x > row["upper"])))
        assert outcome.worst_residual(law) == max(outcome.residual(law, stage).max() for stage in outcome.stages)


def test_normal_forces_are_summed_over_pairs_clear_of_welds(sampled, lap_model):
    outcome, contacts = read_outcome(sampled), lap_model.contacts
    welds = lap_model.scene.welds
    away = [np.linalg.norm((contacts.point - weld.point)[:, :2], axis=1) / weld.radius for weld in welds]
    clear = np.min(away, axis=0) > 3
    assert 0 < clear.sum() < len(clear)
    row = outcome.zone_statistics.set_index(["law", "stage"]).loc["coulomb", "clamp"]
    total = outcome.contact("coulomb", "clamp", "f_n")[:, clear].sum(axis=1)
    assert row["mean_normal_force_clear"] == pytest.approx(total.mean(), rel=1e-12) and total.mean() > 0
    assert row["six_sigma_normal_force_clear"] == pytest.approx(6 * total.std(ddof=1), rel=1e-9)
    assert row["mean_normal_force_clear"] < row["mean_normal_force"] - 1e-3  # N


def test_the_summary_holds_the_statistics(sampled):
    outcome = read_outcome(sampled)
    summary = outcome.summary()["laws"]
    for row in outcome.zone_statistics.to_dict("records"):
        zone = summary[row["law"]]["zones"]["lap"]
        entry = zone["stages"][row["stage"]]
        for name in ("mean_rms_tangential", "six_sigma_rms_tangential", "mean_normal_force_clear"):
            assert entry[name] == row[name] and entry[f"{name}_ci"] == [row[f"{name}_low"], row[f"{name}_high"]]
            assert zone[name] == zone["stages"]["clamp"][name]  # the first stage that resolves contact
        slips = [entry["mean_rms_slip"], entry["six_sigma_rms_slip"]]
        assert slips == ([row["mean_rms_slip"], row["six_sigma_rms_slip"]] if row["law"] == "coulomb" else [None, None])
    for row in outcome.measurement_statistics.to_dict("records"):
        found = summary[row["law"]]["measurements"][row["measurement"]]
        assert [found[name] for name in ("mean", "six_sigma", "cpk")] == [row["mean"], row["six_sigma"], row["cpk"]]
        assert found["min_ci"][0] is None  # a minimum has no lower bound, and JSON no number for that


@pytest.mark.slow
def test_failed_samples_are_named_and_enter_no_statistic(folder, evaluation):
    fail(folder, "coulomb", {3: ("clamp", "not converged"), BLOCK + 1: ("release", "overflow in a product")})
    outcome = read_outcome(folder)
    summary = outcome.summary()
    assert summary["failed_samples"] == {"coulomb": [3, BLOCK + 1], "frictionless": []}
    law = summary["laws"]["coulomb"]
    assert law["samples"] == SAMPLES - 2 and law["failed"] == 2 and law["worst_residual"] < 1e-8
    valid = np.delete(evaluation["coulomb"].measurements[:, 0], [3, BLOCK + 1])
    assert law["measurements"]["M1"]["mean"] == pytest.approx(valid.mean(), rel=1e-6)
    assert len(outcome.contact("coulomb", "clamp", "f_n")) == SAMPLES - 2
    assert outcome.sample_numbers("coulomb").tolist() == [i for i in range(SAMPLES) if i not in (3, BLOCK + 1)]
    assert outcome.failures("coulomb")[["sample", "stage", "status"]].to_numpy().tolist() == [
        [3, "clamp", "not converged"],
        [BLOCK + 1, "release", "overflow in a product"],
    ]


def test_tables_that_were_just_written_are_those_that_would_be_read(lap_model, evaluation, tmp_path):
    store, block, found = RunFolder(tmp_path), Block("coulomb", 0, SAMPLES), evaluation["coulomb"]
    broken = found.measurements.copy()
    broken[3] = np.nan
    found = replace(found, measurements=broken, failed=np.arange(SAMPLES) == 3)
    written, statistics = write_evaluation(store, block, "this run", lap_model, found)
    read = store.read_block(block, "this run")
    assert set(written) == set(read)
    for name, frame in read.items():
        pd.testing.assert_frame_equal(written[name], frame, check_exact=True)
    samples = BlockSamples(read, len(lap_model.contacts), SAMPLES)
    expected = Accumulator.of(samples, lap_model)
    assert statistics.moments.keys() == expected.moments.keys() and statistics.count == SAMPLES
    for key, moments in statistics.moments.items():
        for field in fields(moments):
            np.testing.assert_array_equal(getattr(moments, field.name), getattr(expected.moments[key], field.name))
    assert statistics.failed == expected.failed == [3] and statistics.numbers.tolist() == expected.numbers.tolist()


@pytest.mark.slow
def test_blocks_just_written_are_not_read_again_and_tables_are_cached_up_to_a_limit(folder, lap_model):
    """Whatever the order in which they come; without one, all after it wait for it."""
    store = RunFolder(folder)
    identity, expected = store.record()["identity"], read_outcome(folder)
    every = [block for law in LAWS for block in store.blocks(law)]
    tables = {block: store.read_block(block, identity) for block in every}
    whole, full, later = BlockCache(), BlockCache(memory(tables[every[0]])), BlockCache()
    for block in every[::-1]:
        samples = BlockSamples(tables[block], len(lap_model.contacts), SAMPLES)
        for cache in (whole, full) if block.first == 0 else (whole, full, later):
            cache.store(block, Accumulator.of(samples, lap_model), tables[block])
    assert list(whole.tables) == every[::-1] and every[-1] in full.tables and len(full.tables) < len(every)
    for path in (folder / "samples" / "law=coulomb").iterdir():
        cut = path.read_bytes()
        path.write_bytes(b"cut")
        outcome = read_outcome(folder, lap_model, whole)
        assert not outcome.damaged
        pd.testing.assert_frame_equal(outcome.zone_statistics, expected.zone_statistics, check_exact=True)
        assert outcome.summary()["laws"] == expected.summary()["laws"]
        assert len(read_outcome(folder, lap_model, later).damaged) == (path.stem.startswith("000000"))
        assert len(read_outcome(folder, lap_model).damaged) == 1
        path.write_bytes(cut)
    few = store.record() | {"samples": BLOCK + 5}  # of the last block, only a part is requested
    store.write_record(few)
    found, read = read_outcome(folder, lap_model, whole), read_outcome(folder, lap_model)
    pd.testing.assert_frame_equal(found.zone_statistics, read.zone_statistics, check_exact=True)
    assert len(found.sample_numbers("coulomb")) == BLOCK + 5


def test_an_interrupted_or_damaged_run_is_read_with_its_missing_samples(folder, evaluation):
    (last,) = (folder / "samples" / "law=frictionless").glob(f"{BLOCK:06d}-*")
    last.unlink()  # the block was interrupted after its contacts were written
    (folder / "samples" / "law=frictionless" / ".half.parquet").write_bytes(b"half a file")
    outcome = read_outcome(folder)
    assert outcome.missing == {"coulomb": 0, "frictionless": 10}
    assert len(outcome.contact("frictionless", "clamp", "f_n")) == BLOCK
    cut = folder / "contacts" / "law=coulomb" / f"{0:06d}-{BLOCK - 1:06d}.parquet"
    cut.write_bytes(cut.read_bytes()[:300])
    damaged = read_outcome(folder)
    assert damaged.missing["coulomb"] == BLOCK and damaged.sample_numbers("coulomb")[0] == BLOCK
    assert [cut.name in sentence and "damaged" in sentence for sentence in damaged.damaged] == [True]
    x = evaluation["frictionless"].measurements[:BLOCK, 0]
    assert outcome.summary()["laws"]["frictionless"]["measurements"]["M1"]["mean"] == pytest.approx(x.mean(), rel=1e-6)
    for path in folder.glob("samples/*/*"):
        path.unlink()
    summary = read_outcome(folder).summary()
    assert summary["laws"] == {} and summary["missing_samples"] == dict.fromkeys(LAWS, SAMPLES)


@pytest.mark.slow
def test_stored_parts_are_the_parts(folder, lap_scene, cache):
    assembly = assemble(lap_scene, cache)
    assert read_outcome(folder).parts == ()
    RunFolder(folder).store_inputs(assembly)
    found = read_outcome(folder).parts
    assert [part.fingerprint() for part in found] == [part.fingerprint() for part in assembly.parts]


def test_the_wide_table_of_old_stays_with_a_warning(sampled):
    outcome = read_outcome(sampled)
    with pytest.warns(DeprecationWarning, match="Outcome.samples"):
        wide = outcome.samples["coulomb"]
    np.testing.assert_array_equal(wide["measurement:M1"], outcome.measured("coulomb", "M1"))
    np.testing.assert_array_equal(wide["slip:release:lap"], outcome.tangential("coulomb", "release", "lap"))
    assert set(wide["status:clamp"]) == {"converged"} and len(wide) == SAMPLES


def test_an_unreadable_record_is_one_sentence(folder):
    record = folder / "run.json"
    text = record.read_text()
    damaged, old = "run.json.*damaged.*run the scene again", json.dumps({"kind": "record of a run", "format": 3})
    for content, error, words in (
        (text[:100], FormatError, damaged),
        (text.replace('"samples"', '"sample"'), FormatError, damaged),
        (old, FormatError, "run.json.*an older version.*run the scene"),
        (None, RunError, "run.json"),
    ):
        record.unlink() if content is None else record.write_text(content)
        with pytest.raises(error, match=words) as caught:
            read_outcome(folder)
        assert "\n" not in str(caught.value)


@pytest.mark.slow
def test_the_study_of_friction_is_solved_once_read_back_and_removed(lap_model, tmp_path):
    stages = [stage.model_copy(update={"path": "one-step"} if stage.kind == "clamp" else {})
              for stage in lap_model.scene.stages]  # fmt: skip
    model = replace(lap_model, scene=lap_model.scene.model_copy(update={"stages": stages}))
    sample_into(tmp_path, model, ["coulomb", "associated"], 14, SEED)
    assert read_outcome(tmp_path).friction_study is None
    write_tables(read_outcome(tmp_path))
    study = read_outcome(tmp_path).friction_study
    assert set(study["law"]) == {"coulomb", "associated", "frictionless"} and study["sample"].nunique() == 12
    mu = lap_model.contacts.friction_in("clamp").coefficient.mean()
    at_scene = study[(study["mu"] == mu) & (study["law"] == "coulomb")]
    stored = read_outcome(tmp_path).contact("coulomb", "clamp", "f_n")  # in one step too
    assert at_scene["normal_force"].iloc[0] == pytest.approx(stored[0].sum(), rel=1e-6)
    sample_into(tmp_path, model, ["coulomb"], 14, SEED)  # the associated law is no longer requested
    write_tables(read_outcome(tmp_path))
    assert read_outcome(tmp_path).friction_study is None


@pytest.mark.slow
def test_samples_are_read_by_number(folder, monkeypatch):
    fail(folder, "coulomb", {3: ("clamp", "not converged")})
    whole, few = read_outcome(folder), (2, 7, BLOCK + 4)
    monkeypatch.setattr("mic.results.outcome.CACHE_SIZE", 0)  # every table is read again
    outcome = read_outcome(folder)
    assert not any(outcome.cached_tables.values()) and any(whole.cached_tables.values())
    place = np.searchsorted(outcome.sample_numbers("coulomb"), few)
    force, measured = whole.contact("coulomb", "clamp", "f_t"), whole.measured("coulomb", "M1")
    for found in (whole, outcome):
        np.testing.assert_array_equal(found.contact("coulomb", "clamp", "f_t", few), force[place])
        np.testing.assert_array_equal(found.measured("coulomb", "M1", few), measured[place])
    with pytest.raises(KeyError, match="requested samples are not valid"):
        outcome.measured("coulomb", "M1", [3, 4])
