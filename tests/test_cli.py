"""The commands as a user calls them."""

import json
import os
import re
import shutil
import subprocess
import sys
from pathlib import Path
from typing import get_args, get_type_hints

import pandas as pd
import pytest
from typer.testing import CliRunner

import mic
from mic.options import app
from mic.scene.schema import MonteCarlo
from verification.scenes import FEW

ROOT = Path(__file__).resolve().parents[1]
LAP = ROOT / "meshes" / "lap_joint"


@pytest.fixture(autouse=True)
def elsewhere(tmp_path, monkeypatch):
    """A check writes its page where a run writes its results: below the working folder."""
    monkeypatch.chdir(tmp_path)


@pytest.fixture
def command(cache, tmp_path):
    def call(*arguments, check=True):
        done = subprocess.run(
            [sys.executable, "-m", "mic", *map(str, arguments)],
            cwd=tmp_path,
            capture_output=True,
            text=True,
            env=os.environ | {"MIC_CACHE": str(cache), "COLUMNS": "200"},
            timeout=300,
        )
        assert not check or done.returncode == 0, done.stdout + done.stderr
        return done

    return call


@pytest.fixture
def here(cache):
    """Output of a command that runs in this process."""

    def call(*arguments):
        done = CliRunner().invoke(app, [*map(str, arguments)], env={"MIC_CACHE": str(cache), "COLUMNS": "200"})
        assert done.exit_code == 0, done.output
        return done.output

    return call


@pytest.mark.slow
@pytest.mark.fem
def test_run_check_report(command, here, tmp_path, no_pictures):
    scene = lap_with(tmp_path, ("friction = 0.27", "friction = 0.27\npairs = 12"))
    checked = here("check", scene)
    assert (
        re.search(r"lower *│ 509 *│", checked)  # nodes
        and "6000" not in checked
        and re.search(r"200 samples × \(\d+ \+ \d+ \+ \d+\) contact solves", checked)
        and "The scene is valid" in checked
    )
    first = here("run", scene, "--samples", 20)
    assert "report:" in first and "RMS slip under load" in first and "RMS tangential displacement" in first
    assert "coulomb: largest residual" in first and "with a tighter load path (12 samples)" in first
    folder = tmp_path / "results" / "lap-joint"
    summary = json.loads((folder / "summary.json").read_text())
    assert summary["samples"] == 20 and set(summary["laws"]) == {"coulomb", "associated", "frictionless"}
    zone = summary["laws"]["coulomb"]["zones"]["lap"]
    slip = pd.read_parquet(folder / "slips" / "law=coulomb").query("stage == 'clamp' and zone == 'lap'")["rms_slip"]
    assert zone["mean_rms_slip"] == pytest.approx(slip.mean()) and zone["six_sigma_rms_slip"] == pytest.approx(
        6 * slip.std()
    )
    assert summary["laws"]["coulomb"]["worst_residual"] < 1e-8
    assert summary["laws"]["coulomb"]["path"]["repeated"] == 12 and zone["six_sigma_rms_slip_path"] is not None
    assert (folder / "report.html").stat().st_size > 10_000
    (folder / "report.html").unlink()
    assert "reused" in here("run", scene, "--samples", 20)
    assert (folder / "report.html").is_file()
    record = json.loads((folder / "run.json").read_text())
    (folder / "run.json").write_text(json.dumps(record | {"format": record["format"] - 1}))
    old = command("report", folder, check=False)
    assert old.returncode == 2 and len(old.stderr.strip().splitlines()) == 1 and "an older version" in old.stderr


@pytest.mark.slow
def test_check_shows_what_a_frictionless_run_omits(cache, tmp_path):
    text = (LAP / "scene.toml").read_text().replace("fields = true", "")
    text = re.sub(r'\[\[stages\]\]\nkind = "release".*?\n\n', "", text, flags=re.S)
    (tmp_path / "scene.toml").write_text(text)
    (tmp_path / "geometry.py").write_text((LAP / "geometry.py").read_text())
    environment = {"MIC_CACHE": str(cache), "COLUMNS": "200"}
    lean = CliRunner().invoke(app, ["check", str(tmp_path), "--law", "frictionless"], env=environment).output
    assert "only normals are modelled, 80 rows instead of 240" in lean
    assert "200 samples × 1 contact solves (frictionless) = 200 solves of 80 unknowns" in lean
    assert "no field solves" in lean


@pytest.mark.slow
def test_check_shows_sources_of_normals_and_draws_them(cache, tmp_path):
    """A geometry that leaves normals out: a bend of two rows by 100°, and flats."""
    script = """
import numpy as np
from mic.geometry.structured import extrude
SIZES = {"medium": 5.5}
def build(part, size):
    at = np.radians([0, 50, 100])
    arc = np.column_stack([25 + 6 * np.sin(at), 6 - 6 * np.cos(at)])
    end = arc[-1] + 15 * np.array([np.cos(at[-1]), np.sin(at[-1])])
    return extrude(np.vstack([[[0, 0]], arc, [end]]), 0.0, 100.0, size)[:2]
"""
    scene = lap_with(tmp_path)
    environment = {"MIC_CACHE": str(cache), "COLUMNS": "200"}
    told = CliRunner().invoke(app, ["check", scene], env=environment).output
    rows = [line.split("│")[1:-1] for line in told.splitlines() if "the geometry" in line]
    assert [[field.strip() for field in row[:2] + row[3:]] for row in rows] == [
        [part, "the geometry", "0", "0", "0"] for part in ("lower", "upper")
    ]
    assert all(int(row[2]) > 1000 for row in rows)
    text = (tmp_path / "scene.toml").read_text()
    bent = text.replace('name = "lower"\ngeometry = "geometry.py"', 'name = "lower"\ngeometry = "bent.py"')
    assert bent != text
    (tmp_path / "scene.toml").write_text(bent)
    (tmp_path / "bent.py").write_text(script)
    picture = tmp_path / "normals.png"
    told = CliRunner().invoke(app, ["check", scene, "--normals", str(picture)], env=environment).output
    assert re.search(r"lower +│ none +│ 0 +│ [1-9]\d* +│ [1-9]\d* +│ 0", told)
    assert "with a bend of more than 40°, too coarse for its curvature" in " ".join(told.split())
    assert picture.read_bytes().startswith(b"\x89PNG")


def lap_with(tmp_path, *edits):
    """The lap joint's scene, edited, in a folder of its own."""
    text = (LAP / "scene.toml").read_text()
    for old, new in edits:
        assert old in text
        text = text.replace(old, new, 1)
    (tmp_path / "scene.toml").write_text(text)
    (tmp_path / "geometry.py").write_text((LAP / "geometry.py").read_text())
    return str(tmp_path)


@pytest.mark.slow
def test_check_prints_the_process_step_by_step_with_notes(cache, tmp_path, lap_model):
    """With coefficients at hand (those of the model) a few samples say where friction hardly matters."""
    scene = lap_with(
        tmp_path,
        ('kind = "clamp"', 'kind = "clamp"\norder = [["C1-lower"], ["C1-upper"]]'),
        ("friction = 0.27", f"friction = 0.27\npairs = {FEW['lap']}"),
    )
    with (tmp_path / "scene.toml").open("a") as file:
        file.write('\n[optimise]\nforces = [{ clamps = ["C1-upper"], between = [30, 90] }]\n')
    environment = {"MIC_CACHE": str(cache), "COLUMNS": "200"}
    printed = CliRunner().invoke(app, ["check", scene], env=environment).output
    process = printed[printed.index("Process") : printed.index("Optimisation")].splitlines()
    assert "• may change: force of C1-upper, 30 to 90 N (now 60)\n" in printed
    assert process[3:] == [
        "clamp: contact active, load path followed",
        "  1. overlaps between parts are resolved",
        "  2. clamp C1-lower closes (60 N)",
        "  3. clamp C1-upper closes (60 N)",
        "weld: nothing moves",
        "  1. welds W1 and W2 join the sheets as they stand",
        "release: contact active, load path followed",
        "  1. clamp C1-upper opens",
        "  2. clamp C1-lower opens",
        "  3. locators upper-A1, upper-A2, upper-A3, upper-B1, upper-B2 and upper-C1 open",
        "measure: nothing moves",
        "  1. 2 key characteristics are measured",
    ]
    assert "note: stage clamp: friction changes the tangential motion of the closed contacts by at most 5 %" in printed
    nothing_at_hand = {"MIC_CACHE": str(tmp_path / "empty"), "COLUMNS": "200"}
    told = CliRunner().invoke(app, ["check", scene], env=nothing_at_hand).output
    assert "note:" not in told and "Effect of the process order: not computed. Run `mic order SCENE`." in told


@pytest.mark.slow
@pytest.mark.parametrize("order", ["check", "run", "order"])
def test_a_process_that_frees_a_part_is_refused_before_long_work(order, tmp_path, monkeypatch):
    scene = lap_with(tmp_path, ('keep = ["lower-A1", "lower-A2",', "keep = ["))

    def compute(*_):
        raise AssertionError("influence coefficients were asked for")

    for name in ("runs.coefficients", "commands.check.influence_coefficients", "commands.invocation.coefficients"):
        monkeypatch.setattr(f"mic.{name}", compute)
    where = ["--out", str(tmp_path / "out")] if order == "run" else []
    done = CliRunner().invoke(app, [order, scene, *where])
    assert isinstance(done.exception, mic.SceneError)
    assert "stages (release): 2 rigid-body motions are free once lower-A1, lower-A2, upper-A1" in str(done.exception)


@pytest.mark.slow
@pytest.mark.parametrize(
    "arguments, words",
    [
        (("check", "nowhere"), ["nowhere", "no such file"]),
        (("report", "."), ["holds no run"]),
        (("check", "springs"), ["element: there is none called 'springs'; known: ", "dkt-opt"]),
    ],
)
def test_errors_are_one_line_and_exit_with_two(command, arguments, words, tmp_path):
    shutil.copytree(LAP, tmp_path / "springs")
    text = (LAP / "scene.toml").read_text()
    (tmp_path / "springs" / "scene.toml").write_text(f'element = "springs"\n{text}')
    done = command(*arguments, check=False)
    assert done.returncode == 2 and "Traceback" not in done.stderr
    assert len(done.stderr.strip().splitlines()) == 1
    for word in words:
        assert word in done.stderr


def test_an_interrupted_run_names_the_command_that_continues_it(tmp_path, monkeypatch):
    def interrupt(*_):
        raise KeyboardInterrupt

    monkeypatch.setattr("mic.commands.run.run_scene", interrupt)
    done = CliRunner().invoke(app, ["run", str(LAP), "--out", str(tmp_path)])
    assert done.exit_code == 130 and "run the same command again" in " ".join(done.output.split())


def test_laws_and_backends_of_the_options_are_those_of_the_program():
    help_ = CliRunner().invoke(app, ["run", "--help"], env={"COLUMNS": "300", "TERMINAL_WIDTH": "300"}).output
    assert all(law in help_ for law in ("coulomb", "associated", "frictionless", "native", "paper"))
    assert CliRunner().invoke(app, ["run", str(LAP), "--law", "glue"]).exit_code == 2


def test_the_backends_of_the_options_are_those_of_a_scene():
    asked = MonteCarlo.model_fields["backend"].annotation
    run = next(command for command in app.registered_commands if command.callback.__name__ == "run")
    declared = get_type_hints(run.callback)["backend"]
    assert set(get_args(asked)) == set(get_args(declared)[0].__members__)


def test_help_imports_no_numerical_library():
    script = (
        "import sys, mic.cli\n"
        "sys.argv = ['mic', 'run', '--help']\n"
        "try:\n    mic.cli.main()\nexcept SystemExit:\n    pass\n"
        "slow = {'pandas', 'pyarrow', 'numba', 'scipy', 'matplotlib', 'mpi4py'} & set(sys.modules)\n"
        "assert not slow, slow"
    )
    environment = {name: value for name, value in os.environ.items() if not name.startswith(("OMPI", "PMI"))}
    told = subprocess.run([sys.executable, "-c", script], capture_output=True, text=True, timeout=60, env=environment)
    assert told.returncode == 0 and "--samples" in told.stdout, told.stderr


@pytest.mark.slow
def test_production_path_imports_no_finite_elements():
    script = (
        "import sys, mic, mic.commands.run, mic.model.assembly, mic.runs, mic.report.page\n"
        "fem = ('dolfinx', 'petsc4py', 'ufl', 'fem_reference', 'mpi4py', 'gmsh')\n"
        "bad = [name for name in sys.modules if name.split('.')[0] in fem]\n"
        "assert not bad, bad"
    )
    subprocess.run([sys.executable, "-c", script], check=True, timeout=60)


@pytest.mark.slow
def test_readme_snippet_runs(cache, tmp_path):
    readme = (ROOT / "README.md").read_text()
    snippet = re.search(r"```python\n(.*?)```", readme, re.S).group(1)
    (tmp_path / "meshes").symlink_to(ROOT / "meshes")  # the snippet writes where it stands
    subprocess.run(
        [sys.executable, "-c", snippet],
        check=True,
        cwd=tmp_path,
        env=os.environ | {"MIC_CACHE": str(cache)},
        timeout=200,
    )
    assert (tmp_path / "model.npz").is_file()
