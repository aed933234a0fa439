"""Samples that depend on nothing but seed and number; runs that lose nothing."""

import json
import os
import subprocess
import sys

import numpy as np
import pandas as pd
import pytest
from scipy import stats

from mic.sampling.draw import draw
from mic.sampling.montecarlo import run, tables

LAWS = ["coulomb", "frictionless"]


def read(folder, table, law="coulomb"):
    return pd.read_parquet(folder / table / f"law={law}").sort_values("sample", ignore_index=True)


def test_samples_depend_on_seed_and_number_only(lap_scene):
    whole = draw(lap_scene, 4, 0, 30)
    np.testing.assert_array_equal(draw(lap_scene, 4, 17, 5), whole[17:22])
    assert (draw(lap_scene, 5, 0, 30) != whole).all()
    assert len(np.unique(whole)) == whole.size


@pytest.mark.parametrize("distribution", ["normal", "uniform"])
def test_deviations_follow_the_stated_distribution(lap_scene, distribution):
    deviations = [d.model_copy(update={"distribution": distribution}) for d in lap_scene.deviations]
    scene = lap_scene.model_copy(update={"deviations": deviations})
    values = draw(scene, 8, 0, 4000)
    for j, deviation in enumerate(deviations):
        standard = (values[:, j] - deviation.mean) / deviation.sigma
        reference = stats.norm() if distribution == "normal" else stats.uniform(-np.sqrt(3), 2 * np.sqrt(3))
        assert stats.kstest(standard, reference.cdf).pvalue > 1e-3
    correlation = np.corrcoef(values.T) - np.eye(len(deviations))
    assert np.abs(correlation).max() < 4 / np.sqrt(4000)


def test_run_is_complete_and_reproducible(lap_model, tmp_path):
    run(lap_model, tmp_path / "a", LAWS, 60, 4)
    run(lap_model, tmp_path / "b", LAWS, 60, 4)
    for table in ("samples", "contacts"):
        pd.testing.assert_frame_equal(read(tmp_path / "a", table), read(tmp_path / "b", table))
    samples, contacts = read(tmp_path / "a", "samples"), read(tmp_path / "a", "contacts")
    assert samples["sample"].tolist() == list(range(60)) and not samples["failed"].any()
    assert len(contacts) == 60 * 2 * len(lap_model.contacts)
    assert json.loads((tmp_path / "a" / "run.json").read_text())["seed"] == 4


def test_zone_slip_is_the_rms_over_the_zones_pairs(lap_model):
    evaluation = lap_model.process("coulomb").evaluate(draw(lap_model.scene, 4, 0, 3))
    samples, contacts = tables(lap_model, evaluation)
    one = contacts[(contacts["sample"] == 2) & (contacts["stage"] == "clamp")]
    rms = np.sqrt((one["u_t1"] ** 2 + one["u_t2"] ** 2).mean())
    assert samples["slip:clamp:lap"][2] == pytest.approx(rms, rel=1e-12) and rms > 1e-5


class Interrupt(Exception):
    pass


def test_interrupted_run_keeps_what_was_finished(lap_model, tmp_path):
    def stop(law, count):
        raise Interrupt

    with pytest.raises(Interrupt):
        run(lap_model, tmp_path, LAWS, 120, 4, stop)
    partial = read(tmp_path, "samples")
    assert partial["sample"].tolist() == list(range(50))
    block = next((tmp_path / "samples" / "law=coulomb").glob("*.parquet"))
    written = block.stat().st_mtime_ns
    assert run(lap_model, tmp_path, LAWS, 120, 4) == {"coulomb": 50, "frictionless": 0}
    assert block.stat().st_mtime_ns == written
    run(lap_model, tmp_path / "whole", LAWS, 120, 4)
    pd.testing.assert_frame_equal(read(tmp_path, "samples"), read(tmp_path / "whole", "samples"))


def test_another_seed_or_model_replaces_old_blocks(lap_model, tmp_path):
    run(lap_model, tmp_path, LAWS, 60, 4)
    assert run(lap_model, tmp_path, LAWS, 60, 5) == dict.fromkeys(LAWS, 0)
    fewer = run(lap_model, tmp_path, ["coulomb"], 20, 5)
    assert fewer == {"coulomb": 0} and len(pd.read_parquet(tmp_path / "samples")) == 20


def test_a_sample_that_breaks_is_counted_and_the_rest_survives(lap_model, tmp_path, monkeypatch):
    process = lap_model.process("coulomb", threads=len(os.sched_getaffinity(0)))
    target = draw(lap_model.scene, 4, 7, 1)
    evaluate = process.evaluate

    def breaks(deviations):
        if (deviations == target).all(axis=1).any():
            raise np.linalg.LinAlgError("planted")
        return evaluate(deviations)

    monkeypatch.setattr(process, "evaluate", breaks)
    run(lap_model, tmp_path, ["coulomb"], 20, 4)
    samples = read(tmp_path, "samples")
    assert samples["sample"][samples["failed"]].tolist() == [7]
    assert samples["status:clamp"][7] == "planted" and np.isnan(samples["slip:clamp:lap"][7])
    assert samples.drop(7).notna().all(axis=None)


def test_ranks_share_the_samples(lap_model, tmp_path, cache):
    run(lap_model, tmp_path / "one", LAWS, 120, 4)
    lap_model.save(tmp_path / "model.npz")
    script = (
        "import sys; from pathlib import Path; from mic.model.reduced import ReducedModel; from mic.sampling.montecarlo import run\n"
        "folder = Path(sys.argv[1]); run(ReducedModel.load(folder / 'model.npz'), folder / 'two', sys.argv[2:], 120, 4)"
    )
    subprocess.run(
        ["mpirun", "-n", "2", "--oversubscribe", sys.executable, "-m", "mpi4py", "-c", script, str(tmp_path), *LAWS],
        check=True,
        env=os.environ | {"OMPI_ALLOW_RUN_AS_ROOT": "1", "OMPI_ALLOW_RUN_AS_ROOT_CONFIRM": "1"},
        timeout=120,
    )
    pd.testing.assert_frame_equal(read(tmp_path / "one", "samples"), read(tmp_path / "two", "samples"))
