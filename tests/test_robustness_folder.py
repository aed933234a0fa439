"""Locks, cut files, full disks, missing rights, hostile text, endless runs: right numbers or one sentence."""

import json
import os
import shutil
import subprocess
import sys
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest
from typer.testing import CliRunner

import mic
from mic.errors import RunError, StorageError
from mic.model.assembly import assemble
from mic.options import app
from mic.results.cost_estimate import forecast
from mic.results.outcome import read_outcome
from mic.runs import conclude, sample_into
from mic.system.console import plain
from mic.system.files import PARTIAL, clean, replacing, set_aside
from mic.system.lock import LOCK, locked

pytestmark = pytest.mark.robustness

ROOT = Path(__file__).resolve().parents[1]
LAP = ROOT / "meshes" / "lap_joint"


def in_python(text, *arguments):
    command = [sys.executable, "-c", text, *map(str, arguments)]
    own = dict(os.environ)  # without what MPI, where it has started in this process, has put beside it
    return subprocess.run(command, capture_output=True, text=True, timeout=300, env=own)


# ---------------------------------------------- the lock


HOLD = """
import sys, time; from mic.system.lock import locked
with locked(sys.argv[1]): print("held", flush=True); time.sleep(60)
"""


def test_a_second_run_in_a_folder_is_refused_in_one_sentence(lap_model, tmp_path):
    with subprocess.Popen([sys.executable, "-c", HOLD, str(tmp_path)], stdout=subprocess.PIPE, text=True) as holder:
        try:
            assert holder.stdout.readline() == "held\n"
            words = rf"in use by process {holder.pid} on .*wait until it has ended"
            with pytest.raises(RunError, match=words) as caught:
                sample_into(tmp_path, lap_model, ["coulomb"], 10, 4)
            assert "\n" not in str(caught.value)
            assert [path.name for path in tmp_path.iterdir()] == [LOCK]
        finally:
            holder.kill()
    with locked(tmp_path) as stale:
        assert stale  # its process was killed
    assert not (tmp_path / LOCK).exists()


WORKER = """
import os, sys, time; from mic.system.lock import locked
with locked(sys.argv[1]):
    if os.fork() == 0:
        print("held", flush=True); time.sleep(1.0); open(sys.argv[1] + "/late", "w").close(); os._exit(0)
    time.sleep(60)
"""


def test_the_workers_of_a_killed_run_are_waited_for(tmp_path):
    """They inherit its lock, and may still write."""
    with subprocess.Popen([sys.executable, "-c", WORKER, str(tmp_path)], stdout=subprocess.PIPE, text=True) as holder:
        assert holder.stdout.readline() == "held\n"
        holder.kill()
        holder.wait()
        with locked(tmp_path) as stale:
            assert stale and (tmp_path / "late").exists()


@pytest.mark.parametrize("change", [{"boot": "another"}, {"started": 1}, {"process": 2**22 + 1}, None])
def test_a_lock_whose_owner_is_gone_is_taken_over(tmp_path, change):
    with locked(tmp_path):
        owner = json.loads((tmp_path / LOCK).read_text())
    (tmp_path / LOCK).write_text("" if change is None else json.dumps(owner | change))
    with locked(tmp_path):
        assert json.loads((tmp_path / LOCK).read_text()) == owner


def test_a_lock_of_another_machine_is_believed_and_the_remedy_named(tmp_path):
    with locked(tmp_path):
        owner = json.loads((tmp_path / LOCK).read_text())
    (tmp_path / LOCK).write_text(json.dumps(owner | {"host": "elsewhere"}))
    with pytest.raises(RunError, match=f"on elsewhere.*if that process has ended, remove .*{LOCK}"), locked(tmp_path):
        pass
    assert json.loads((tmp_path / LOCK).read_text())["host"] == "elsewhere"


def test_one_process_may_hold_a_folder_more_than_once(tmp_path):
    with locked(tmp_path):
        with locked(tmp_path):
            pass
        assert (tmp_path / LOCK).exists()
    assert not (tmp_path / LOCK).exists()


# ---------------------------------------------- cut files


@pytest.mark.slow
@pytest.mark.parametrize("name", ["run.json", "model.npz"])
def test_files_of_a_run_truncated_anywhere_are_set_aside_and_written_again(lap_model, sixty, tmp_path, name):
    run, whole = tmp_path / "run", (sixty / name).read_bytes()
    for length in (0, len(whole) // 2, len(whole) - 2):
        shutil.copytree(sixty, run)
        (run / name).write_bytes(whole[:length])
        assert sample_into(run, lap_model, ["coulomb"], 60, 4) == {"coulomb": 60}
        np.testing.assert_array_equal(measured(run), measured(sixty))
        assert [path.read_bytes() for path in run.glob(f"*{name}.damaged")] == [whole[:length]]
        shutil.rmtree(run)


def measured(folder):
    return read_outcome(folder).measured("coulomb", "M1")


def test_files_set_aside_never_replace_each_other(tmp_path):
    for number in range(3):
        (tmp_path / "a.json").write_text(str(number))
        set_aside(tmp_path / "a.json")
    assert sorted(path.read_text() for path in tmp_path.glob("a.json.damaged*")) == ["0", "1", "2"]


def test_partial_files_of_killed_programs_are_cleaned_and_others_stay(tmp_path):
    with pytest.raises(KeyboardInterrupt), replacing(tmp_path / "a.json") as own:
        raise KeyboardInterrupt
    dead = in_python("import os; print(os.getpid())").stdout.strip()
    orphan = tmp_path / own.name.replace(f"-{os.getpid()}", f"-{dead}")
    others = [own, tmp_path / f"mine{PARTIAL}.json", tmp_path / ".notes.txt"]
    for path in (orphan, *others):
        path.write_text("")
    clean([tmp_path, tmp_path / "none"])
    assert not orphan.exists() and all(path.exists() for path in others)
    clean([tmp_path], alone=True)
    assert [path.exists() for path in others] == [False, True, True]


# ---------------------------------------------- disks and rights


FULL = """
import resource, sys; from pathlib import Path
from mic.process.model import ReducedModel; from mic.runs import sample_into; from mic.errors import StorageError
model = ReducedModel.load(sys.argv[1])
most = resource.getrlimit(resource.RLIMIT_FSIZE)[1]
for limit in map(int, sys.argv[3:]):
    resource.setrlimit(resource.RLIMIT_FSIZE, (limit, most))
    try: sample_into(Path(sys.argv[2]), model, ["coulomb"], 60, 4)
    except StorageError as error: print(error)
"""


@pytest.mark.slow
def test_a_full_disk_gives_one_sentence_and_finished_samples_stay(lap_model, sixty, tmp_path):
    lap_model.save(tmp_path / "model.npz")
    limits = (0, 30_000)
    done = in_python(FULL, tmp_path / "model.npz", tmp_path / "run", *limits)
    assert done.returncode == 0 and not done.stderr, done.stderr
    told = done.stdout.splitlines()
    assert len(told) == len(limits) and all("file too large" in line for line in told), done.stdout
    sample_into(tmp_path / "run", lap_model, ["coulomb"], 60, 4)
    np.testing.assert_array_equal(measured(tmp_path / "run"), measured(sixty))
    assert not [path for path in (tmp_path / "run").rglob("*") if PARTIAL in path.name]


@pytest.mark.skipif(os.geteuid() == 0, reason="root may write everywhere")
def test_a_folder_that_cannot_be_written_is_one_sentence(lap_model, tmp_path):
    tmp_path.chmod(0o500)
    with pytest.raises(StorageError, match="permission denied.*--out"):
        sample_into(tmp_path / "run", lap_model, ["coulomb"], 10, 4)


def test_no_folder_of_results_can_be_a_file_or_lie_in_one(lap_model, tmp_path):
    (tmp_path / "file").write_text("mine")
    for folder, words in (("file", "is a file; name a folder"), ("file/run", "not a directory")):
        with pytest.raises(mic.MicError, match=words):
            sample_into(tmp_path / folder, lap_model, ["coulomb"], 10, 4)
    assert (tmp_path / "file").read_text() == "mine"


def test_without_a_home_the_cache_must_be_named(monkeypatch):
    monkeypatch.delenv("MIC_CACHE", raising=False)
    monkeypatch.delenv("XDG_CACHE_HOME", raising=False)
    monkeypatch.setattr("os.path.expanduser", lambda path: path)
    with pytest.raises(StorageError, match="no home folder.*MIC_CACHE"):
        mic.cache_folder()


# ---------------------------------------------- what a user writes


@pytest.mark.slow
def test_text_of_a_user_reaches_the_terminal_as_text_and_a_script_is_announced(tmp_path, cache, monkeypatch):
    monkeypatch.setenv("MIC_CACHE", str(cache))
    shutil.copy(LAP / "geometry.py", tmp_path)
    hostile = r"Gap [mm] [/red] [link=x] \u001b[2J \u0007 end"
    text = (LAP / "scene.toml").read_text().replace("Two flat strips, clamped and welded in their overlap.", hostile)
    text = text.replace("medium", "coarse").replace("friction = 0.27", "friction = 0.27\npairs = 6")
    (tmp_path / "scene.toml").write_text(text)
    arguments = ["check", str(tmp_path), "--page", str(tmp_path / "check.html")]
    found = CliRunner().invoke(app, arguments, env={"COLUMNS": "200"})
    assert found.exit_code == 0 and "Gap [mm] [/red] [link=x]" in found.output
    assert "\x1b[2J" not in found.output and "\x07" not in found.output
    announced = found.output.replace("\n", "").partition(" is executed to create its meshes")[0]
    assert announced.endswith(str(tmp_path / "geometry.py")) and "reading meshes" not in announced


def test_plain_text_keeps_lines_and_letters():
    assert plain("ä 6σ\n\t[mm]") == "ä 6σ\n\t\\[mm]" and plain("\x1b[31m\x9b2J") == "�[31m�2J"


@pytest.mark.parametrize("name", ["..", "."])
def test_a_scene_cannot_lead_out_of_the_results(tmp_path, monkeypatch, name):
    (tmp_path / "here").mkdir()
    monkeypatch.chdir(tmp_path / "here")
    for file in ("scene.toml", "geometry.py"):
        shutil.copy(LAP / file, file)
    Path("scene.toml").write_text(Path("scene.toml").read_text().replace('"lap-joint"', f'"{name}"'))
    found = CliRunner().invoke(app, ["run", "."])
    assert isinstance(found.exception, mic.MicError) and "--out" in str(found.exception)
    assert sorted(path.name for path in tmp_path.rglob("*")) == ["geometry.py", "here", "scene.toml"]


@pytest.mark.parametrize(
    "key, words",
    [
        (f"seed = {2**63}", "monte_carlo.seed: it has more than 64 bits: correct it"),
        ("samples = " + "[" * 5000 + "]" * 5000, "nested too deeply|not valid TOML"),
        ("samples = 1e400", "monte_carlo.samples"),
    ],
)
def test_numbers_and_nesting_beyond_all_bounds_are_one_sentence(tmp_path, key, words):
    text = (LAP / "scene.toml").read_text().replace("samples = 200\nseed = 1", key)
    (tmp_path / "scene.toml").write_text(text)
    with pytest.raises(mic.SceneError, match=words):
        mic.load_scene(tmp_path)


def test_a_seed_beyond_the_generator_is_refused_by_the_command():
    assert CliRunner().invoke(app, ["run", str(LAP), "--seed", str(2**63)]).exit_code == 2


def expected_cost(scene, cache, samples, increments=1):
    stages = [stage.model_copy(update={"increments": increments}) for stage in scene.stages]
    assembly = assemble(scene.model_copy(update={"stages": stages}), cache)
    return forecast(assembly, ["coulomb"], samples, cores=2)


@pytest.mark.parametrize("samples, increments", [(10**30, 1), (500, 10**9)])
def test_a_run_that_would_never_end_is_refused_with_the_time_it_would_take(
    lap_scene, cache, tmp_path, samples, increments
):
    words = f"{samples} samples would take at least .* (years|days|hours) and .* on disk"
    with pytest.raises(RunError, match=words):
        expected_cost(lap_scene, cache, samples, increments).check(tmp_path / "run")
    assert not list(tmp_path.iterdir())


def test_a_run_of_a_day_is_refused_only_if_its_results_do_not_fit(lap_scene, cache, tmp_path, monkeypatch):
    cost = expected_cost(lap_scene, cache, 10**6)
    cost.check(tmp_path)
    assert 60 < cost.seconds < 86400 and 1e8 < cost.size < 1e11
    monkeypatch.setattr("shutil.disk_usage", lambda folder: SimpleNamespace(free=5 * 10**6))
    with pytest.raises(RunError, match="1000000 samples would take .* has 5 MB free"):
        cost.check(tmp_path)


def test_a_report_of_a_folder_without_a_run_does_not_change_it(tmp_path):
    with pytest.raises(RunError, match="holds no run"):
        conclude(tmp_path)
    assert not list(tmp_path.iterdir())
