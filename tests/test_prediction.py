"""Predictions of single assemblies: values by hand, verdicts, adjustments, and the log after a kill."""

import csv
import time
from types import SimpleNamespace

import numpy as np
import pandas as pd
import pytest
from support.springs import LIFT, MU, PULL, at_face, clamped, dragged
from typer.testing import CliRunner

import mic
from mic.commands.predict import PredictionLog
from mic.errors import FormatError, SceneError
from mic.options import app
from mic.results.schema import PREDICTIONS
from mic.studies.adjustment import adjustments, with_adjustments
from mic.studies.emulator_training import FINE, train_emulator
from mic.studies.prediction import Predictor

SIGMA = 0.1


def limited(upper, tighter=1.0):
    """M is at most `upper`."""
    limits = (("b", "M", 0.0, upper), ("t", "N", PULL - tighter, PULL + tighter))
    return dragged(measurements=[at_face(part, (1, 0, 0), name=n, lower=a, upper=b) for part, n, a, b in limits])


@pytest.fixture(scope="module")
def model():
    return limited(0.05)


def row(found, name):
    return found.set_index("measurement").loc[name]


def test_predictions_are_evaluations_and_unmeasured_inputs_widen_their_intervals(model):
    predictor = Predictor(model, error=1e-3)
    found = predictor.predict({"P": 0.9})
    PREDICTIONS.check(found, "memory", "mend it")
    own, other = row(found, "M"), row(found, "N")
    assert own["value"] == pytest.approx(MU * 0.45 / 4, rel=1e-9) and other["value"] == pytest.approx(PULL)
    assert own["high"] - own["value"] == pytest.approx(1.96e-3, rel=1e-3)  # the model's error alone: D does not move M
    assert other["value"] - other["low"] == pytest.approx(1.96 * np.hypot(1e-3, 0.05), rel=1e-3)
    whole = row(found, "")
    assert whole["verdict"] == "accepted" and whole["far"] == pytest.approx(1.0) and found["measurement"].iloc[-1] == ""


def test_verdicts_go_by_the_interval(model):
    """M is at most 0.05: P of 4/3 mm is just there."""
    predictor = Predictor(model, error=1e-3)
    at = {value: row(predictor.predict({"P": value, "D": PULL}), "M")["verdict"] for value in (1.2, 4 / 3, 1.39)}
    assert at == {1.2: "accepted", 4 / 3: "open", 1.39: "rejected"}
    assert row(predictor.predict({"P": 1.39}), "")["verdict"] == "rejected"


def test_inputs_too_far_from_the_mean_are_refused_with_their_distance(model):
    found = Predictor(model).predict({"P": 2 * LIFT + 6.5 * SIGMA})
    assert found["verdict"].tolist() == ["refused"] and "P is 6.5 σ off its mean" in found["said"].iloc[0]
    assert np.isnan(found["value"].iloc[0])


@pytest.mark.parametrize("exact", [False, True])
def test_the_smallest_sufficient_adjustment_is_found(exact):
    """b stands 45.1 µm too high at its face for M; its locator l2 lowers that by half of what it goes down, as P does,
    in thousandths of a millimetre: 0.046 mm are enough."""
    model = limited(0.036, 9.0)
    bad = {"P": 0.96 + 0.0451, "D": PULL}
    found = row(Predictor(model, adjust=["bl2", "tl1"], shim=0.4, exact=exact).predict(bad), "")
    assert found["verdict"] == "rejected" and found["way"] == "evaluated"
    assert found["said"].startswith("locators.bl2 by -0.046 mm: within all limits by 0.033")
    if not exact:
        return
    little = row(Predictor(model, adjust=["bl2"], shim=0.04, exact=True).predict(bad), "")
    assert little["said"] == "locators.bl2 by -0.04 mm: still 0.191 µm beyond a limit"
    idle = row(Predictor(model, adjust=["bl0"], exact=True).predict(bad), "")
    assert idle["said"].startswith("no adjustment helps")
    with pytest.raises(ValueError, match="neither a locator nor a clamp"):
        Predictor(model, adjust=["nothing"], exact=True)


def touching(low, high):
    """b rises to t across a gap that half of the samples close: what M reads bends there."""
    return clamped(
        "bt",
        0.2,
        measurements=[at_face("t", name="M", lower=low, upper=high)],
        deviations=[{"name": "P", "kind": "locator", "target": "bl1", "mean": 0.4, "sigma": 0.15}],
    )


@pytest.mark.parametrize(("start", "low", "high"), [(0.05, 0.021, 1.0), (0.9, -1.0, 0.029)])
def test_the_smallest_adjustment_is_found_where_contact_opens_or_closes_on_the_way(start, low, high):
    """M is constant while the gap is open: its derivatives are zero there, and too large where the gap closes."""
    model = touching(low, high)
    proposed = row(Predictor(model, adjust=["bl1"], shim=1.0, exact=True).predict({"P": start}), "")["said"]
    opened, names = with_adjustments(model, adjustments(model, 1.0, 2.0, ["bl1"]))
    tried = [(c, opened.evaluate({"P": start, names[0]: c}).measurements[0, 0]) for c in np.arange(-1, 1.001, 0.01)]
    least = min((c for c, value in tried if low <= value <= high), key=abs)
    assert proposed.startswith(f"locators.bl1 by {least:+.4g} mm: within all limits"), (proposed, least)


@pytest.mark.slow
def test_the_emulator_agrees_with_the_evaluation_within_its_stated_error():
    """Verdicts are the same, since assemblies closer to a limit than the error of the spline are evaluated."""
    x = 0.4 + 0.15 * np.clip(np.random.default_rng(3).standard_normal(60), -3, 3)
    found = touching(-1.0, 1.0).process("coulomb").evaluate(x[:, None]).measurements[:, 0]
    limit = float(np.sort(found)[-8]) + 1e-5  # mm: close by one of them
    exact, learnt = (Predictor(touching(-limit, limit), exact=on) for on in (True, False))
    told = [(exact.predict({"P": one}), learnt.predict({"P": one})) for one in x]
    ways = {"learnt": [], "evaluated": []}
    for a, b in told:
        ways[row(b, "M")["way"]].append((row(a, "M"), row(b, "M")))
    assert len(ways["learnt"]) > 40 and ways["evaluated"]
    half = [b["high"] - b["value"] for _, b in ways["learnt"]]
    assert 0 < np.median(half) <= FINE * 2 * limit
    for name in ("M", ""):
        assert all(row(a, name)["verdict"] == row(b, name)["verdict"] for a, b in told)
    assert all(a["value"] == b["value"] for a, b in ways["evaluated"])
    beyond = {"P": 0.4 + 3.5 * 0.15}
    assert row(learnt.predict(beyond), "M")["way"] == "evaluated"
    assert row(learnt.predict(beyond), "M")["value"] == row(exact.predict(beyond), "M")["value"]


def test_the_stated_error_of_the_emulator_is_no_less_than_its_error():
    """The kink of M lies between training assemblies: their leave-one-out errors are at least those of others."""
    model = touching(-1.0, 1.0)
    known = train_emulator(model, "coulomb")
    assert 0 < known.error_bound[0] and len(known.x) >= 59
    x = 0.4 + 0.15 * np.clip(np.random.default_rng(4).standard_normal((400, 1)), -3, 3)
    told, off = known(x)
    missed = np.abs(told - model.process("coulomb").evaluate(x).measurements)
    assert (missed <= off).mean() >= 0.95 and missed.max() > 0.1 * known.error_bound[0]
    assert known.covers(np.array([0.4])) and not known.covers(np.array([0.4 + 3.1 * 0.15]))


def test_a_cached_emulator_belongs_to_one_question(model, tmp_path):
    asked = []
    first = train_emulator(model, "coulomb", cache=tmp_path, progress=asked.append)
    assert asked and (tmp_path / "answers").is_dir()
    again = train_emulator(model, "coulomb", cache=tmp_path, progress=asked.append)
    assert len(asked) == 1 and np.array_equal(first.x, again.x) and np.array_equal(first.error_bound, again.error_bound)
    train_emulator(model, "frictionless", cache=tmp_path, progress=asked.append)
    assert len(asked) >= 2


def test_a_deviation_that_does_not_vary_and_one_that_bends_are_both_learnt():
    items = [
        {"name": "P", "kind": "locator", "target": "bl1", "mean": 2 * LIFT, "sigma": SIGMA},
        {"name": "still", "kind": "clamp", "target": "T", "mean": PULL, "sigma": 0.0},
    ]
    told = Predictor(dragged(deviations=items)).predict({"P": 0.9, "still": PULL})
    assert row(told, "")["way"] == "learnt"
    assert row(told, "M")["value"] == pytest.approx(MU * 0.45 / 4, rel=1e-9)


def test_a_table_of_parts_gives_a_table_of_predictions(model):
    told = mic.predict(model, pd.DataFrame({"P": [0.9, 1.39, 2.9], "D": [PULL, np.nan, PULL]}))
    PREDICTIONS.check(told, "memory", "mend it")
    whole = told[told["measurement"] == ""].set_index("row")
    assert whole["verdict"].tolist() == ["accepted", "rejected", "refused"]
    own = told[(told["measurement"] == "N")].set_index("row")
    assert (own["high"] - own["low"]).tolist() == pytest.approx([0.0, 2 * 1.96 * 0.05], rel=1e-3, abs=1e-9)
    alike = mic.predict(model, [{"P": 0.9, "D": PULL}])
    pd.testing.assert_frame_equal(alike, told[told["row"] == 0], check_index_type=False)
    with pytest.raises(SceneError, match="the list is empty"):
        mic.predict(model, [])
    with pytest.raises(ValueError, match="Q"):
        mic.predict(model, [{"Q": 1.0}])


def test_a_log_continues_after_a_killed_program(model, tmp_path):
    found, path = Predictor(model).predict({"P": 0.9}), tmp_path / "log.csv"
    log = PredictionLog(path, "abc")
    log.add(found, tmp_path / "a.csv", 2, "c")
    log.add(found, tmp_path / "a.csv", 3, "c")
    whole = path.read_text()
    for cut in range(len(whole) - 1, whole.index(f"{tmp_path / 'a.csv'},3"), -37):
        path.write_text(whole[:cut])
        again = PredictionLog(path, "abc")
        assert (str(tmp_path / "a.csv"), 3, "c") not in again and again.count == 1
        again.add(found, tmp_path / "a.csv", 3, "c")
        assert path.read_text() == whole
    assert PredictionLog(path, "another").count == 0
    path.write_text("P,D\n1,2\n")
    with pytest.raises(FormatError, match="not a log of predictions"):
        PredictionLog(path, "abc")


@pytest.mark.slow
def test_the_command_predicts_each_row_once(model, tmp_path):
    model.save(tmp_path / "model.npz")
    (tmp_path / "parts.csv").write_text("P,D\n0.9,2\n1.39,2\n2.9,2\n")
    asked = ["predict", str(tmp_path / "model.npz"), "--parts", str(tmp_path / "parts.csv")]
    asked += ["--log", str(tmp_path / "log.csv"), "--adjust", "bl2"]
    done = CliRunner().invoke(app, asked, env={"COLUMNS": "160"})
    assert done.exit_code == 0, done.output
    adjusted = ("row 3: rejected (M +0.05", "locators.bl2 by -0.")
    for said in ("row 2: accepted", *adjusted, "largest error (95 %)", "row 4: refused; P is 21 σ off"):
        assert said in done.output
    with open(tmp_path / "log.csv", newline="") as file:
        rows = list(csv.DictReader(file))
    assert [one["verdict"] for one in rows if not one["measurement"]] == ["accepted", "rejected", "refused"]
    again = CliRunner().invoke(app, asked, env={"COLUMNS": "400"})
    assert again.exit_code == 0 and "3 rows are already in" in again.output and "row 2" not in again.output
    (tmp_path / "parts.csv").write_text("P,D\n0.91,2\n1.39,2\n2.9,2\n")
    corrected = CliRunner().invoke(app, asked, env={"COLUMNS": "400"})
    assert "row 2: accepted" in corrected.output and "2 rows are already in" in corrected.output
    other = CliRunner().invoke(app, [*asked, "--error", "0.001"], env={"COLUMNS": "400"})
    assert "row 2: accepted" in other.output and "already" not in other.output
    asked[3] = str(tmp_path / "none.csv")
    missing = CliRunner().invoke(app, asked)
    assert "none.csv: this table does not exist; correct the name" in str(missing.exception)
    assert "training" not in missing.output, "before the training"
    neither = CliRunner().invoke(app, asked[:2])
    assert neither.exit_code != 0 and "give either --parts" in str(neither.exception)


def test_a_folder_is_watched_until_the_program_ends(model, tmp_path, monkeypatch):
    """An invalid file is reported, and the next is predicted; the log has all predictions."""
    model.save(tmp_path / "model.npz")
    folder, looks = tmp_path / "in", []
    folder.mkdir()
    (folder / "1.csv").write_text("Q\n1\n")
    (folder / "2.csv").write_text("P\n0.9\n")

    def sleep(seconds):
        looks.append(seconds)
        if len(looks) == 3:
            (folder / "3.csv").write_text("P\n1.0\n")
        if len(looks) == 6:
            raise KeyboardInterrupt

    monkeypatch.setattr("mic.commands.predict.time", SimpleNamespace(sleep=sleep, perf_counter=time.perf_counter))
    asked = ["predict", str(tmp_path / "model.npz"), "--watch", str(folder), "--log", str(tmp_path / "log.csv")]
    done = CliRunner().invoke(app, asked, env={"COLUMNS": "200"})
    assert done.exit_code == 0 and "contains 2 assemblies" in done.output
    assert done.output.count("there is no deviation 'Q'") == 1
    assert (tmp_path / "log.csv").read_text().count(",coulomb,,") == 2
