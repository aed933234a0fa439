"""Path errors in the results of a run: its first samples on a tighter path, compared with another computation."""

import shutil

import numpy as np
import pandas as pd
import pytest
from support.runs import edit, fail
from support.stages import on_the_way

from mic.contact.path import Followed, Increments
from mic.process.process import Process
from mic.results import path_error
from mic.results.outcome import read_outcome
from mic.results.path_effect import PathStudy
from mic.results.path_error import tighter
from mic.results.schema import RESOLUTIONS
from mic.results.table_writer import write_path_study, write_tables
from mic.runs import sample_into
from mic.statistics.draw import draw

SAMPLES, SEED = path_error.SAMPLES + 4, 5


@pytest.fixture(scope="module")
def folder(lap_model, tmp_path_factory):
    """A run of two increments a step, and its study."""
    folder = tmp_path_factory.mktemp("run")
    # No more than are repeated: of the same batch every product is rounded alike.
    model = on_the_way(lap_model, 2)
    sample_into(folder, model, ["coulomb", "associated", "frictionless"], path_error.SAMPLES, SEED)
    studied(folder)
    write_tables(read_outcome(folder))
    return folder


@pytest.fixture(scope="module")
def samples(lap_model, tmp_path_factory):
    """A run of two increments a step, and more samples than are repeated."""
    folder = tmp_path_factory.mktemp("samples")
    sample_into(folder, on_the_way(lap_model, 2), ["coulomb", "frictionless"], SAMPLES, SEED)
    return folder


@pytest.fixture
def own(samples, tmp_path):
    """The same, to be changed."""
    return shutil.copytree(samples, tmp_path / "run")


def studied(folder):
    """The study of a run, written and read."""
    write_path_study(read_outcome(folder))
    return read_outcome(folder).path_study


@pytest.fixture(scope="module")
def on_both(lap_model):
    """The repeated samples with two increments and with eight."""
    deviations = draw(lap_model.scene, SEED, 0, path_error.SAMPLES)
    return [on_the_way(lap_model, count).evaluate(deviations, "coulomb") for count in (2, 8)]


def zone_rms(moved):
    """RMS over the pairs of the scene's only zone."""
    return np.sqrt((moved**2).sum(axis=2).mean(axis=1))


def test_a_tighter_path_is_of_the_same_kind():
    assert tighter(Increments(3)) == Increments(12)
    assert tighter(Followed(1e-3, 0.2)) == Followed(1e-3 / 16, 0.2)


@pytest.mark.slow
def test_the_first_samples_stand_beside_themselves_on_the_tighter_path(folder, on_both, lap_model):
    study = read_outcome(folder).path_study
    repeated = [study.repeated(law) for law in ("coulomb", "associated", "frictionless")]
    assert repeated == [path_error.SAMPLES, path_error.SAMPLES, 0]
    pairs = study.pairs[study.pairs["law"] == "coulomb"].set_index(["quantity", "stage", "name"]).sort_index()
    for column, evaluation in zip(("value", "tighter"), on_both):
        for k, item in enumerate(lap_model.scene.measurements):
            found = pairs.loc[("measurement", "measure", item.name), column]
            np.testing.assert_allclose(found, evaluation.measurements[:, k], rtol=1e-7)
        for stage, resolution in evaluation.resolutions.items():
            for quantity, moved in (
                ("rms_tangential", resolution.displacement[:, :, 1:]),
                ("rms_slip", resolution.trace.slip),
            ):
                np.testing.assert_allclose(pairs.loc[(quantity, stage, "lap"), column], zone_rms(moved), rtol=1e-6)
    moved = pairs.loc[("rms_slip", "clamp", "lap")]
    assert (moved["value"] - moved["tighter"]).abs().max() > 1e-6  # the path matters, so there is something to see


def test_effects_on_mean_and_six_sigma_agree_with_numpy(folder, on_both):
    outcome = read_outcome(folder)
    one, eight = (zone_rms(evaluation.resolutions["clamp"].displacement[:, :, 1:]) for evaluation in on_both)
    mean, spread = outcome.path_study.effects("coulomb", "rms_tangential", "lap", "clamp")
    assert mean.change == pytest.approx(eight.mean() - one.mean(), rel=1e-6)
    assert spread.change == pytest.approx(6 * (eight.std(ddof=1) - one.std(ddof=1)), rel=1e-5)
    assert mean.share == pytest.approx(mean.change / one.mean(), rel=1e-6)
    assert spread.share == pytest.approx(eight.std(ddof=1) / one.std(ddof=1) - 1, rel=1e-5)
    entry = outcome.summary()["laws"]["coulomb"]["zones"]["lap"]["stages"]["clamp"]
    assert entry["mean_rms_tangential_path"] == mean.change and entry["mean_rms_tangential_path_share"] == mean.share
    assert entry["six_sigma_rms_tangential_path"] == spread.change
    row = pd.read_csv(folder / "tables" / "zones.csv").query("law == 'coulomb' and stage == 'clamp'").iloc[0]
    assert row["six_sigma_rms_tangential_path"] == pytest.approx(spread.change)
    x, y = (evaluation.measurements[:, 0] for evaluation in on_both)
    mean, _ = outcome.path_study.effects("coulomb", "measurement", "M1")
    assert mean.change == pytest.approx((y - x).mean(), rel=1e-4)
    assert mean.share == pytest.approx((y - x).mean() / (6 * x.std(ddof=1)), rel=1e-4)
    measured = outcome.summary()["laws"]["coulomb"]["measurements"]["M1"]
    assert measured["mean_path"] == mean.change and measured["mean_path"] != 0


def test_estimates_stand_beside_the_error_that_was_measured(lap_model, folder, on_both):
    errors = read_outcome(folder).path_study.errors.query("law == 'coulomb'")
    assert errors["estimate"].isna().all()  # nothing estimates what increments leave
    change = 0.0
    for stage, (two, eight) in {name: [e.resolutions[name] for e in on_both] for name in ("clamp", "release")}.items():
        change = change + (eight.displacement - two.displacement)[:, :, 1:]
        found = errors[errors["stage"] == stage]["measured"]
        np.testing.assert_allclose(found, zone_rms(change), rtol=1e-6, atol=1e-12)
        force = eight.force - two.force
        for column, part in (("normal_measured", force[:, :, :1]), ("friction_measured", force[:, :, 1:])):
            found = errors[errors["stage"] == stage][column]
            np.testing.assert_allclose(found, zone_rms(part), rtol=1e-6, atol=1e-9)
    assert errors["measured"].max() > 1e-6 and errors["friction_measured"].max() > 1e-3
    assert errors["force_estimate"].isna().all() and not errors["several"].any()


def table(value, tight, quantity="rms_slip", converged=True):
    frame = pd.DataFrame({"sample": range(len(value)), "value": value, "tighter": tight, "converged": converged})
    return PathStudy(frame.assign(law="coulomb", quantity=quantity, stage="clamp", name="Z"), pd.DataFrame())


def test_a_change_below_a_micrometre_has_no_share():
    tiny = np.array([1e-4, 2e-4, 3e-4])
    for effect in table(tiny, 2 * tiny).effects("coulomb", "rms_slip", "Z", "clamp"):
        assert effect.change > 0 and np.isnan(effect.share)
    large = 1e3 * tiny
    for effect in table(large, 2 * large).effects("coulomb", "rms_slip", "Z", "clamp"):
        assert effect.share == pytest.approx(1.0)


def test_the_mean_of_a_key_characteristic_is_held_against_its_scatter():
    value = np.array([-0.1, 0.0, 0.1])  # mean 0
    mean, spread = table(value, value + 0.03, "measurement").effects("coulomb", "measurement", "Z")
    assert mean.share == pytest.approx(0.03 / 0.6) and spread.change == pytest.approx(0.0, abs=1e-15)


def test_a_repetition_that_did_not_converge_is_excluded_and_counted():
    value = np.array([0.1, 0.2, 0.3, 0.4])
    study = table(value, value + np.array([0.01, 0.01, 0.01, 9.0]), converged=[True, True, True, False])
    mean, _ = study.effects("coulomb", "rms_slip", "Z", "clamp")
    assert mean.change == pytest.approx(0.01) and study.repeated("coulomb") == 3 and study.left_out == 1


def test_one_sample_has_no_spread_to_change():
    mean, spread = table(np.array([0.1]), np.array([0.2])).effects("coulomb", "rms_slip", "Z", "clamp")
    assert mean.change == pytest.approx(0.1) and np.isnan(spread.change)


def test_the_first_valid_samples_are_repeated_and_failed_ones_are_not(own):
    fail(own, "coulomb", {3: ("clamp", "not converged")})
    found = studied(own).pairs["sample"].unique()
    assert found.tolist() == [i for i in range(path_error.SAMPLES + 1) if i != 3]


@pytest.mark.slow
def test_a_study_is_the_same_whenever_it_is_made(folder):
    names = ("path.csv", "path_errors.csv")
    before = [(folder / "tables" / name).read_bytes() for name in names]
    write_path_study(read_outcome(folder))
    assert [(folder / "tables" / name).read_bytes() for name in names] == before


def test_a_repetition_that_breaks_is_lost_alone(lap_model, own, monkeypatch):
    target, evaluate = draw(lap_model.scene, SEED, 2, 1), Process.evaluate

    def breaks(self, deviations, *at):
        if (deviations == target).all(axis=1).any():
            raise np.linalg.LinAlgError("planted")
        return evaluate(self, deviations, *at)

    monkeypatch.setattr(Process, "evaluate", breaks)
    study = studied(own)
    assert study.left_out == 1 and study.repeated("coulomb") == path_error.SAMPLES - 1


def test_without_friction_there_is_no_path_to_study(lap_model, tmp_path):
    sample_into(tmp_path, lap_model, ["frictionless"], 3, SEED)
    assert studied(tmp_path) is None and not (tmp_path / "tables" / "path.csv").exists()
    row = read_outcome(tmp_path).zone_statistics.iloc[0]
    assert np.isnan(row["mean_rms_tangential_path"]) and row["mean_rms_tangential"] > 0


def test_rescued_samples_are_counted_and_stay(own):
    def rescued(frame):
        return frame.assign(rescued=frame["sample"].isin([4, 9]) & (frame["stage"] == "clamp"))

    edit(own, RESOLUTIONS, "coulomb", rescued)
    summary = read_outcome(own).summary()
    assert summary["rescued_samples"] == {"coulomb": [4, 9], "frictionless": []}
    assert summary["laws"]["coulomb"]["rescued"] == 2 and summary["laws"]["coulomb"]["samples"] == SAMPLES


def test_the_summary_shows_steps_and_errors_of_the_path(own):
    def told(frame):
        error = np.where(frame["stage"] == "clamp", 1e-4, 0.0) * (1 + frame["sample"])
        return frame.assign(path_error=error, steps=7, factorisations=np.int64(11))

    edit(own, RESOLUTIONS, "coulomb", told)
    path = read_outcome(own).summary()["laws"]["coulomb"]["path"]
    assert path["steps"] == 14 and path["factorisations"] == 22  # over both stages that resolve contact
    assert path["error"]["clamp"]["max"] == pytest.approx(1e-4 * SAMPLES)
    assert path["error"]["clamp"]["mean"] == pytest.approx(1e-4 * (SAMPLES + 1) / 2)
    assert path["error"]["release"] == {"mean": 0.0, "max": 0.0}
