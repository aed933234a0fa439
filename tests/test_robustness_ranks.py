"""Several processes: the same bits as one, nothing lost, nobody left waiting, and one message where something fails."""

import os
import re
import shutil
import signal
import subprocess
import sys
import time
from pathlib import Path

import pytest
from support.processes import on_processes

from mic.execution.ranks import LaunchError, communicator
from mic.results.schema import CONDENSED, CONTACTS, DATASETS, FORCES, SUMS

ROOT = Path(__file__).resolve().parents[1]
SCENE = ROOT / "meshes" / "lap_joint"
BLOCKS = 10  # of 210 samples under two laws
PAIRED = 4  # of them with their contact pairs and forces
TABLES = [table.name for table in (*DATASETS, FORCES, SUMS, CONDENSED)]
SECONDS = 240  # after which processes count as hanging; they start in ten on a machine that is busy

pytestmark = [pytest.mark.fem, pytest.mark.slow]


@pytest.fixture(scope="module", autouse=True)
def mpirun():
    if shutil.which("mpirun") is None:
        pytest.skip("mpirun is not installed")


@pytest.fixture(scope="module")
def run(tmp_path_factory):
    """A run whose first samples keep pairs and forces; of the others it keeps what they add up to."""
    scene = tmp_path_factory.mktemp("scene") / "lap_joint"
    shutil.copytree(SCENE, scene)
    file = scene / "scene.toml"
    file.write_text(file.read_text().replace("[report]", "[report]\ncontacts = 100", 1))
    return ["run", scene, "--samples", "210", "--law", "coulomb", "--law", "frictionless"]


@pytest.fixture(scope="module")
def kept(tmp_path_factory):
    """A cache folder that all runs of this module share."""
    return tmp_path_factory.mktemp("ranks") / "cache"


NOTHING = (0, "nothing")


def started(count, arguments, cache, plant=NOTHING, threads=1):
    """``mic ARGUMENTS`` on `count` processes, alone without ``mpirun``.

    `plant`: (rank, what), see support.planted, and no pictures are drawn; None, the command as it is.
    """
    program = ["-m", "support.planted", *map(str, plant)] if plant else ["-m", "mic.cli"]
    launch = ["mpirun", "--oversubscribe", "-n", str(count)] if count > 1 else []
    environment = os.environ | {
        "OMPI_ALLOW_RUN_AS_ROOT": "1",
        "OMPI_ALLOW_RUN_AS_ROOT_CONFIRM": "1",
        "OMPI_MCA_mpi_yield_when_idle": "1",  # who waits leaves the core to the others
        "OMP_NUM_THREADS": str(threads),
        "OPENBLAS_NUM_THREADS": str(threads),
        "MIC_CACHE": str(cache),
        "COLUMNS": "200",
        "PYTHONPATH": os.pathsep.join([str(ROOT), str(ROOT / "tests")]),
    }
    command = [*launch, sys.executable, *program, *map(str, arguments)]
    return subprocess.Popen(
        command,
        env=environment,
        cwd=ROOT,
        stdout=subprocess.PIPE,
        stderr=subprocess.STDOUT,
        text=True,
        errors="replace",
    )


def mic(count, arguments, cache, **options):
    """Exit code and all that was printed; ends what hangs."""
    process = started(count, arguments, cache, **options)
    try:
        said, _ = process.communicate(timeout=SECONDS)
    except subprocess.TimeoutExpired:
        process.terminate()
        pytest.fail(f"hangs; so far it said: {process.communicate()[0][-2000:]}")
    return process.returncode, said


def blocks(folder):
    """Content of the model and of every block, by name."""
    paths = [folder / "model.npz"]
    for table in TABLES:
        paths += [path for path in (folder / table).glob("law=*/*") if not path.name.startswith(".")]
    return {str(path.relative_to(folder)): path.read_bytes() for path in paths}


@pytest.fixture(scope="module")
def alone(run, kept, tmp_path_factory):
    """Results folder of one process, on two threads where the others have one."""
    folder = tmp_path_factory.mktemp("alone") / "out"
    code, said = mic(1, [*run, "--out", folder], kept, threads=2)
    assert code == 0, said
    there = {name: len(list((folder / name).glob("law=*/[0-9]*"))) for name in TABLES}
    few = {CONTACTS.name: PAIRED, FORCES.name: PAIRED, SUMS.name: BLOCKS - PAIRED, CONDENSED.name: BLOCKS - PAIRED}
    assert there == dict.fromkeys(TABLES, BLOCKS) | few
    assert len(blocks(folder)) == 1 + sum(there.values())
    shutil.copytree(kept, folder.parent / "kept")  # what this run alone keeps
    return folder


def test_four_processes_give_the_bits_of_one(alone, run, tmp_path):
    cache = tmp_path / "cache"  # coefficients are computed anew
    code, said = mic(4, [*run, "--out", tmp_path / "out"], cache)
    assert code == 0, said
    assert blocks(tmp_path / "out") == blocks(alone)
    assert said.count("influence coefficients of lower: ") == said.count("report: ") == 1


def test_a_process_that_is_killed_ends_all_and_what_was_finished_is_kept(alone, run, kept, tmp_path):
    out = tmp_path / "out"
    code, said = mic(2, [*run, "--out", out], kept, plant=(1, "death"))
    assert code != 0
    finished = sorted((out / "samples").glob("law=*/0*.parquet"))
    written = [path.stat().st_mtime_ns for path in finished]
    assert 1 <= len(finished) < 10
    code, said = mic(2, [*run, "--out", out], kept)
    assert code == 0 and "samples found finished" in said, said
    assert blocks(out) == blocks(alone) and [path.stat().st_mtime_ns for path in finished] == written


def test_a_run_that_is_terminated_is_completed_by_another_number_of_processes(alone, run, kept, tmp_path):
    out = tmp_path / "out"
    process = started(2, [*run, "--out", out], kept)
    end = time.monotonic() + SECONDS
    while not list((out / "samples").glob("law=*/0*.parquet")) and time.monotonic() < end:
        time.sleep(0.01)
    process.send_signal(signal.SIGTERM)
    process.communicate(timeout=SECONDS)
    assert process.returncode != 0
    code, said = mic(1, [*run, "--out", out], kept)
    assert code == 0 and blocks(out) == blocks(alone), said


@pytest.mark.parametrize(
    "rank, what, words, status",
    [
        (1, "bug", "RuntimeError: planted bug", 1),
        (0, "folder", "planted sentence", 2),
        (1, "interrupt", "process 2 of 2: ended with status 130", 130),
    ],
)
def test_one_process_that_fails_ends_all_with_one_message(alone, run, kept, tmp_path, rank, what, words, status):
    begin = time.monotonic()
    code, said = mic(2, [*run, "--out", tmp_path / "out"], kept, plant=(rank, what))
    assert code == status and said.count(words) == 1, said
    assert said.count("Traceback") == (what == "bug")
    assert time.monotonic() - begin < SECONDS / 2


def test_a_scene_that_is_wrong_is_refused_once_and_by_all(kept, tmp_path):
    wrong = tmp_path / "scene.toml"
    wrong.write_text((SCENE / "scene.toml").read_text().replace("thickness", "thinness", 1))
    code, said = mic(2, ["run", wrong], kept, plant=None)
    assert code == 2 and said.count("error:") == 1 and "MPI_ABORT" not in said, said


def test_check_and_report_are_done_by_one_process_and_the_others_leave(alone, kept):
    code, said = mic(2, ["check", SCENE], kept, plant=None)
    assert code == 0 and said.count("The scene is valid.") == 1, said
    (alone / "report.html").unlink()
    code, said = mic(2, ["report", alone], kept)
    assert code == 0 and said.count("report: ") == 1 and (alone / "report.html").is_file(), said


def test_kept_files_that_were_cut_are_computed_anew_and_said_once_each(alone, run, tmp_path):
    cache = shutil.copytree(alone.parent / "kept", tmp_path / "cache")
    cut = [path for path in cache.glob("*/*.npz")]
    assert len(cut) == 8  # an assembly and its warnings, two meshes, two parts and their fields
    for path in cut:
        path.write_bytes(path.read_bytes()[:300])
    code, said = mic(2, [*run, "--out", tmp_path / "out"], cache)
    assert code == 0 and blocks(tmp_path / "out") == blocks(alone), said
    said = said.replace("\x1b[?25h", "")  # the cursor, shown again where the bar ends
    told = [line for line in said.splitlines() if "it counts as absent and is replaced" in line]
    assert sorted(line.split(": this ")[0] for line in told) == sorted(map(str, cut)), said


def test_processes_that_would_find_different_caches_agree(alone, run, kept, tmp_path):
    code, said = mic(2, [*run, "--out", tmp_path / "out"], kept, plant=(0, "cache"))
    assert code == 0 and blocks(tmp_path / "out") == blocks(alone), said


def test_what_the_first_process_makes_lies_once_in_the_memory_of_a_node():
    done = on_processes(3, "-m", "support.sharing")
    lines = [line.split(" grew ") for line in sorted(done.stdout.splitlines())]
    assert done.returncode == 0 and [said for said, _ in lines] == [
        "0 made [0] right True one True",
        "1 made [] right True one True",
        "2 made [] right True one True",
    ], done.stdout + done.stderr
    assert max(float(grew) for _, grew in lines[1:]) < 8  # MB; the array has 80


def test_one_process_makes_a_run_alone_as_the_others_do_something_else(tmp_path):
    scene = tmp_path / "scene"
    shutil.copytree(SCENE, scene)
    file = scene / "scene.toml"
    file.write_text(re.sub(r"(?m)^samples = .*$", "samples = 20", file.read_text(), count=1))
    done = on_processes(2, "-m", "support.alone", tmp_path, scene, timeout=SECONDS)
    assert (done.returncode, done.stdout) == (0, "20 2\n"), done.stdout + done.stderr


@pytest.mark.parametrize("name", ["OMPI_COMM_WORLD_SIZE", "PMI_SIZE", "SLURM_STEP_NUM_TASKS"])
def test_processes_that_do_not_see_each_other_are_refused(monkeypatch, name):
    for other in ("OMPI_COMM_WORLD_SIZE", "PMI_SIZE", "SLURM_STEP_NUM_TASKS", "PMIX_RANK", "PMI_RANK"):
        monkeypatch.delenv(other, raising=False)
    assert communicator() is None
    monkeypatch.setenv(name, "1")
    assert communicator() is None
    monkeypatch.setenv(name, "4")
    with pytest.raises(LaunchError, match="started 4 processes that cannot communicate.*use its own mpirun"):
        communicator()
    monkeypatch.setenv("OMPI_COMM_WORLD_SIZE", "1")  # the innermost launcher says how many there are
    assert communicator() is None


def test_a_launcher_that_says_no_number_is_asked_through_mpi(monkeypatch):
    for other in ("OMPI_COMM_WORLD_SIZE", "PMI_SIZE", "SLURM_STEP_NUM_TASKS"):
        monkeypatch.delenv(other, raising=False)
    monkeypatch.setenv("PMIX_RANK", "0")
    assert communicator() is None


def test_without_mpi4py_several_processes_are_refused_with_the_remedy(monkeypatch):
    monkeypatch.setenv("OMPI_COMM_WORLD_SIZE", "2")
    monkeypatch.setitem(sys.modules, "mpi4py", None)
    with pytest.raises(LaunchError, match="mpi4py.*cannot be imported.*install python3-mpi4py"):
        communicator()
