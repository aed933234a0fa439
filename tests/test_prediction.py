"""One assembly at a time: forecasts by hand, verdicts, adjustments, and a log that survives."""

import csv
import os
import signal
import subprocess
import sys
import time

import numpy as np
import pandas as pd
import pytest
from support.springs import LIFT, MU, PULL, at_face, dragged, six, spring_model
from typer.testing import CliRunner

import mic
from mic.commands.predict import Log, read_parts
from mic.errors import FormatError, SceneError
from mic.options import app
from mic.results.schema import PREDICTIONS
from mic.studies.prediction import Predictor

SIGMA = 0.1


@pytest.fixture(scope="module")
def model():
    """M is at most 0.05 mm."""
    limits = (("b", "M", 0.0, 0.05), ("t", "N", PULL - 1, PULL + 1))
    return dragged(measurements=[at_face(part, (1, 0, 0), name=n, lower=a, upper=b) for part, n, a, b in limits])


def row(found, name):
    return found.set_index("measurement").loc[name]


def test_what_is_foretold_is_what_the_model_evaluates_and_the_unmeasured_widens_it(model):
    predictor = Predictor(model, error=1e-3)
    found = predictor.judge({"P": 0.9})
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
    at = {value: row(predictor.judge({"P": value, "D": PULL}), "M")["verdict"] for value in (1.2, 4 / 3, 1.39)}
    assert at == {1.2: "accepted", 4 / 3: "open", 1.39: "rejected"}
    assert row(predictor.judge({"P": 1.39}), "")["verdict"] == "rejected"


def test_what_lies_too_far_off_is_refused_and_says_how_far(model):
    found = Predictor(model).judge({"P": 2 * LIFT + 6.5 * SIGMA})
    assert found["verdict"].tolist() == ["refused"] and "P is 6.5 σ off its mean" in found["said"].iloc[0]
    assert np.isnan(found["value"].iloc[0])


def test_the_adjustment_that_helps_is_evaluated(model):
    """b stands 0.09 mm too high at its face; its locator l2 lowers that by half of what it goes down."""
    predictor = Predictor(model, adjust=["bl2", "tl1"], shim=0.4)
    found = row(predictor.judge({"P": 1.39, "D": PULL}), "")
    assert found["verdict"] == "rejected" and found["said"].startswith("locators.bl2 by −0.".replace("−", "-"))
    assert found["said"].endswith("within all limits")
    little = row(Predictor(model, adjust=["bl2"], shim=0.04).judge({"P": 1.39, "D": PULL}), "")
    assert "still" in little["said"] and "beyond" in little["said"]
    idle = row(Predictor(model, adjust=["tl3"]).judge({"P": 1.39, "D": PULL}), "")
    assert idle["said"].startswith("no adjustment helps")
    with pytest.raises(ValueError, match="neither a locator nor a clamp"):
        Predictor(model, adjust=["nothing"])


def touching(limit):
    """b rises to t across a gap that half of the samples close: what M reads bends there."""
    return spring_model(
        [0.2],
        parts=[{"name": name, "mesh": f"{name}.stl", "thickness": 1.0} for name in "bt"],
        locators=[*six("b"), *six("t")],
        zones=[{"name": "z", "parts": ["b", "t"], "friction": 0.0, "pairs": 1}],
        measurements=[at_face("t", name="M", lower=-limit, upper=limit)],
        deviations=[{"name": "P", "kind": "locator", "target": "bl1", "mean": 0.4, "sigma": 0.15}],
        stages=[{"kind": "locate"}, {"kind": "clamp"}, {"kind": "measure"}],
    )


def test_quick_answers_are_those_of_the_evaluation_within_what_they_say():
    exact, quick = (Predictor(touching(1.0), quick=on) for on in (False, True))
    x = 0.4 + 0.15 * np.random.default_rng(3).standard_normal(40)
    told = [(row(exact.judge({"P": one}), "M"), row(quick.judge({"P": one}), "M")) for one in x[np.abs(x - 0.4) < 0.45]]
    off = np.array([b["value"] - a["value"] for a, b in told])
    half = np.array([b["high"] - b["value"] for _, b in told])
    assert (half > 0).all() and half.max() < 1.96 * 0.005 * 2
    assert (np.abs(off) <= half).mean() >= 0.9 and np.abs(off).max() > 0
    beyond = {"P": 0.4 + 3.5 * 0.15}  # is evaluated
    assert row(quick.judge(beyond), "M")["value"] == row(exact.judge(beyond), "M")["value"]


def test_quick_answers_that_would_err_by_more_than_a_tolerance_allows_are_refused():
    with pytest.raises(SceneError, match="quick answers for M err by .* leave quick out"):
        Predictor(touching(1e-8), quick=True)


def test_a_table_of_parts_gives_a_table_of_predictions(model):
    told = mic.predict(model, pd.DataFrame({"P": [0.9, 1.39, 2.9], "D": [PULL, np.nan, PULL]}))
    PREDICTIONS.check(told, "memory", "mend it")
    whole = told[told["measurement"] == ""].set_index("row")
    assert whole["verdict"].tolist() == ["accepted", "rejected", "refused"]
    own = told[(told["measurement"] == "N")].set_index("row")
    assert own["high"][0] == own["low"][0] and own["high"][1] - own["low"][1] == pytest.approx(
        2 * 1.96 * 0.05, rel=1e-3
    )
    alike = mic.predict(model, [{"P": 0.9, "D": PULL}])
    pd.testing.assert_frame_equal(alike, told[told["row"] == 0], check_index_type=False)
    with pytest.raises(SceneError, match="no assembly"):
        mic.predict(model, [])
    with pytest.raises(ValueError, match="Q"):
        mic.predict(model, [{"Q": 1.0}])


@pytest.mark.parametrize(
    ("text", "said"),
    [
        ("", "this is no table"),
        ("Q\n1\n", "row 1: there is no deviation 'Q'; known: P, D"),
        ("P,P\n1,1\n", "column 'P' stands there twice"),
        ("P\na\n", "row 2, column P: 'a' is no finite number"),
        ("P,D\n1,2\n1,inf\n", "row 3, column D: 'inf' is no finite number"),
        ("P\n1,2\n", "this is no table"),
    ],
)
def test_a_file_that_is_none_is_refused_in_a_sentence(text, said, tmp_path):
    path = tmp_path / "parts.csv"
    path.write_text(text)
    with pytest.raises(SceneError) as refused:
        list(read_parts(path, ["P", "D"]))
    assert said in str(refused.value) and str(path) in str(refused.value)


def test_empty_cells_are_not_known_and_empty_rows_are_passed_over(tmp_path):
    path = tmp_path / "parts.csv"
    path.write_text("P;D\n0,9;\n;\n1,1;2\n")
    assert list(read_parts(path, ["P", "D"])) == [(2, {"P": 0.9}), (4, {"P": 1.1, "D": 2.0})]


def test_a_log_takes_up_where_a_killed_program_left_it(model, tmp_path):
    found, path = Predictor(model).judge({"P": 0.9}), tmp_path / "log.csv"
    log = Log(path, "abc")
    log.add(found, tmp_path / "a.csv", 2)
    log.add(found, tmp_path / "a.csv", 3)
    whole = path.read_text()
    for cut in range(len(whole) - 1, whole.index(f"{tmp_path / 'a.csv'},3"), -37):
        path.write_text(whole[:cut])
        again = Log(path, "abc")
        assert (str(tmp_path / "a.csv"), 3) not in again and again.count == 1
        again.add(found, tmp_path / "a.csv", 3)
        assert path.read_text() == whole
    assert Log(path, "another").count == 0
    path.write_text("P,D\n1,2\n")
    with pytest.raises(FormatError, match="no log of predictions"):
        Log(path, "abc")


def test_the_command_foretells_each_row_once(model, tmp_path):
    model.save(tmp_path / "model.npz")
    (tmp_path / "parts.csv").write_text("P,D\n0.9,2\n1.39,2\n2.9,2\n")
    asked = ["predict", str(tmp_path / "model.npz"), "--parts", str(tmp_path / "parts.csv")]
    asked += ["--log", str(tmp_path / "log.csv"), "--adjust", "bl2"]
    done = CliRunner().invoke(app, asked, env={"COLUMNS": "160"})
    assert done.exit_code == 0, done.output
    for said in ("row 2: accepted", "row 3: rejected (M +0.05", "locators.bl2 by -0.", "row 4: refused; P is 21 σ off"):
        assert said in done.output
    with open(tmp_path / "log.csv", newline="") as file:
        rows = list(csv.DictReader(file))
    assert [one["verdict"] for one in rows if not one["measurement"]] == ["accepted", "rejected", "refused"]
    again = CliRunner().invoke(app, asked)
    assert again.exit_code == 0 and "row" not in again.output
    neither = CliRunner().invoke(app, asked[:2])
    assert neither.exit_code != 0 and "give either --parts" in str(neither.exception)


@pytest.mark.slow
@pytest.mark.robustness
def test_a_folder_is_watched_until_the_program_is_ended(model, tmp_path):
    """A file at fault is told, the next is judged all the same; what was judged stands in the log."""
    model.save(tmp_path / "model.npz")
    folder, log = tmp_path / "in", tmp_path / "log.csv"
    folder.mkdir()
    (folder / "1.csv").write_text("Q\n1\n")
    (folder / "2.csv").write_text("P\n0.9\n")
    asked = ["predict", str(tmp_path / "model.npz"), "--watch", str(folder), "--log", str(log)]
    program = subprocess.Popen(
        [sys.executable, "-m", "mic.cli", *asked],
        stdout=subprocess.PIPE,
        text=True,
        env=os.environ | {"COLUMNS": "200"},
    )

    def judged(count):
        until = time.monotonic() + 120
        while time.monotonic() < until:
            if log.is_file() and log.read_text().count(",coulomb,,") >= count:
                return True
            time.sleep(0.1)
        return False

    try:
        assert judged(1)
        (folder / "3.csv").write_text("P\n1.0\n")
        assert judged(2)
        time.sleep(0.5)  # and is told
    finally:
        program.send_signal(signal.SIGINT)
        said, _ = program.communicate(timeout=60)
    assert program.returncode == 0 and "there is no deviation 'Q'" in said and "Ended: 2 assemblies" in said
