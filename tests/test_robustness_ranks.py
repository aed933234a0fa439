"""A run on several MPI processes gives the bits of one, loses nothing, never hangs, and fails with one message."""

import re
import shutil
import signal
import subprocess
import sys
import time
from pathlib import Path

import pytest
from support.processes import on_processes, start_processes

import mic
from mic.errors import RunError
from mic.execution.ranks import LaunchError, communicator
from mic.results.run_folder import EXCEL
from mic.results.schema import CONDENSED, CONTACTS, DATASETS, FORCES, SUMS
from mic.runs import sample_into
from mic.system.lock import locked
from verification.ranks.study import launcher

ROOT = Path(__file__).resolve().parents[1]
SCENE = ROOT / "meshes" / "lap_joint"
BLOCKS = 6  # of 110 samples under two laws
PAIRED = 2  # blocks with contact pairs and forces
TABLES = [table.name for table in (*DATASETS, FORCES, SUMS, CONDENSED)]
SECONDS = 240  # after which processes count as hanging; on a busy machine they take ten to start

needs_mpirun = pytest.mark.skipif(launcher() is None, reason="mpirun is not installed")
pytestmark = [pytest.mark.fem, pytest.mark.slow, needs_mpirun]


@pytest.fixture(scope="module")
def scene(tmp_path_factory):
    """Folder of a small lap joint: the first samples store pairs and forces, the others only their sums."""
    folder = shutil.copytree(SCENE, tmp_path_factory.mktemp("scene") / "lap_joint")
    text = (folder / "scene.toml").read_text()
    for old, new in (
        ("medium", "coarse"),
        ("friction = 0.27", "friction = 0.27\npairs = 12"),
        ("samples = 200", "samples = 110"),
        ("[report]", "[report]\ncontacts = 50"),
        ('"associated", ', ""),
    ):
        assert old in text
        text = text.replace(old, new)
    (folder / "scene.toml").write_text(text)
    return folder


@pytest.fixture(scope="module")
def cache(tmp_path_factory):
    """A cache folder that all runs of this module share."""
    return tmp_path_factory.mktemp("ranks") / "cache"


def started(count, arguments, cache, plant=(0, "nothing")):
    """``mic ARGUMENTS`` on `count` processes without pictures, with an error planted in one: (rank, what)."""
    return start_processes(count, "-m", "support.planted", *plant, *arguments, MIC_CACHE=cache, COLUMNS="200")


def mic_on(count, arguments, cache, **options):
    """Exit code and all that was printed; ends what hangs."""
    process = started(count, arguments, cache, **options)
    try:
        output, _ = process.communicate(timeout=SECONDS)
    except subprocess.TimeoutExpired:
        process.terminate()
        pytest.fail(f"hangs; output so far: {process.communicate()[0][-2000:]}")
    return process.returncode, output


def blocks(folder):
    """Content of the model and of every block, by name."""
    paths = [folder / "model.npz"]
    for table in TABLES:
        paths += [path for path in (folder / table).glob("law=*/*") if not path.name.startswith(".")]
    return {str(path.relative_to(folder)): path.read_bytes() for path in paths}


@pytest.fixture(scope="module")
def one_process(scene, cache, tmp_path_factory):
    """Results folder of a run in this process; a copy of the cache folder that it leaves is beside it."""
    folder = tmp_path_factory.mktemp("one_process") / "out"
    mic.run(mic.load_scene(scene), folder, cache)
    found = {name: len(list((folder / name).glob("law=*/[0-9]*"))) for name in TABLES}
    few = {CONTACTS.name: PAIRED, FORCES.name: PAIRED, SUMS.name: BLOCKS - PAIRED, CONDENSED.name: BLOCKS - PAIRED}
    none = {"limits": 0, "profiles": 0}  # this scene has no such rows
    assert found == dict.fromkeys(TABLES, BLOCKS) | few | none
    assert len(blocks(folder)) == 1 + sum(found.values())
    shutil.copytree(cache, folder.parent / "cache")
    return folder


def wait_until_unlocked(folder):
    """Wait for processes that mpirun has left behind."""
    end = time.monotonic() + SECONDS
    while True:
        try:
            with locked(folder):
                return
        except RunError:
            assert time.monotonic() < end
            time.sleep(0.1)


def test_several_processes_give_the_bits_of_one(one_process, scene, tmp_path):
    """The first finds one part's coefficients and otherwise truncated files, which are reported once each; the second
    finds nothing."""
    cache = shutil.copytree(one_process.parent / "cache", tmp_path / "cache")
    whole = next((cache / "influence").glob("*.npz"))
    cut = [path for path in cache.glob("*/*.npz") if path != whole]
    assert len(cut) == 7  # an assembly and its warnings, two meshes, a part and two fields
    for path in cut:
        path.write_bytes(path.read_bytes()[:300])
    code, output = mic_on(3, ["run", scene, "--out", tmp_path / "out"], cache, plant=(1, "cache"))
    assert code == 0 and output.count("report: ") == 1 and blocks(tmp_path / "out") == blocks(one_process), output
    assert output.count("influence coefficients of ") == 2 and output.count(": reused from ") == 1
    output = re.sub(r"\x1b\[[?0-9;]*[A-Za-z]", "", output)  # bars erase their line and hide the cursor
    reported = [line for line in output.splitlines() if "it counts as absent and is replaced" in line]
    assert sorted(line.split(": this ")[0] for line in reported) == sorted(map(str, cut)), output


def test_a_terminated_run_keeps_its_blocks_and_one_process_completes_it(one_process, scene, cache, tmp_path):
    out = tmp_path / "out"
    process = started(2, ["run", scene, "--out", out], cache)
    end = time.monotonic() + SECONDS
    while not list((out / "samples").glob("law=*/0*.parquet")) and time.monotonic() < end:
        time.sleep(0.01)
    process.send_signal(signal.SIGTERM)
    process.communicate(timeout=SECONDS)
    assert process.returncode != 0
    wait_until_unlocked(out)
    finished = {path: path.stat().st_mtime_ns for path in (out / "samples").glob("law=*/0*.parquet")}
    assert 0 < len(finished) < BLOCKS
    model = mic.ReducedModel.load(one_process / "model.npz")
    sample_into(out, model, model.scene.report.laws, model.scene.monte_carlo.samples, model.scene.monte_carlo.seed)
    assert blocks(out) == blocks(one_process)
    assert {path: path.stat().st_mtime_ns for path in finished} == finished


@pytest.mark.parametrize(
    "rank, what, words, status",
    [
        (1, "bug", "RuntimeError: planted bug", 1),
        (0, "folder", "planted sentence", 2),
        (1, "interrupt", "process 2 of 2: ended with status 130", 130),
        (1, "death", r"signal 9 \(Killed\)|Killed \(signal 9\)", 137),  # in the words of Open MPI, of MPICH
    ],
)
def test_one_failing_process_ends_all_with_one_message(one_process, scene, cache, tmp_path, rank, what, words, status):
    begin = time.monotonic()
    code, output = mic_on(2, ["run", scene, "--out", tmp_path / "out"], cache, plant=(rank, what))
    assert code == status or (code, status) == (9, 137), output  # MPICH's launcher ends with the signal's number
    assert len(re.findall(words, " ".join(output.split()))) == 1, output
    assert output.count("Traceback") == (what == "bug")
    assert time.monotonic() - begin < SECONDS / 2
    if what == "folder":  # the first process refuses it for all
        assert output.count("error:") == 1 and "MPI_ABORT" not in output, output


def test_one_process_writes_the_report_and_waits_for_no_other(one_process, cache):
    code, output = mic_on(2, ["report", one_process, "--excel"], cache)
    assert code == 0 and output.count("report: ") == output.count("Excel: ") == 1, output
    assert (one_process / "report.html").is_file() and (one_process / EXCEL).is_file()


def test_processes_share_the_memory_of_a_result_and_one_of_them_runs_alone(one_process, scene, cache, tmp_path):
    done = on_processes(2, "-m", "support.sharing", tmp_path, scene, cache, timeout=SECONDS)
    first, second, alone = done.stdout.splitlines()
    assert done.returncode == 0 and {line.split(" grew ")[0] for line in (first, second)} == {
        "0 made [0] right True one True",
        "1 made [] right True one True",
    }, done.stdout + done.stderr
    (grown,) = [float(line.split(" grew ")[1]) for line in (first, second) if line.startswith("1")]
    assert grown < 8 and alone == "10 2"  # MB; the array has 80


@pytest.mark.parametrize("name", ["OMPI_COMM_WORLD_SIZE", "PMI_SIZE", "SLURM_STEP_NUM_TASKS"])
def test_processes_that_cannot_communicate_are_refused(monkeypatch, name):
    for other in ("OMPI_COMM_WORLD_SIZE", "PMI_SIZE", "SLURM_STEP_NUM_TASKS", "PMI_RANK"):
        monkeypatch.delenv(other, raising=False)
    monkeypatch.setenv("PMIX_RANK", "0")  # a launcher that does not give the number: MPI does
    assert communicator() is None
    monkeypatch.setenv(name, "1")
    assert communicator() is None
    monkeypatch.setenv(name, "4")
    with pytest.raises(LaunchError, match="started 4 processes that cannot communicate.*use its own mpirun"):
        communicator()
    monkeypatch.setenv("OMPI_COMM_WORLD_SIZE", "1")  # the innermost launcher says how many there are
    assert communicator() is None


def test_several_processes_without_mpi4py_are_refused_with_a_remedy(monkeypatch):
    monkeypatch.setenv("OMPI_COMM_WORLD_SIZE", "2")
    monkeypatch.setitem(sys.modules, "mpi4py", None)
    with pytest.raises(LaunchError, match="mpi4py.*cannot be imported.*install mpi4py"):
        communicator()
