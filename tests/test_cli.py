"""The commands as a user calls them."""

import json
import os
import re
import subprocess
import sys
from pathlib import Path
from typing import get_args, get_type_hints

import pytest
from typer.testing import CliRunner

import mic
from mic.contact.laws import LAWS
from mic.options import app
from mic.results.run_folder import RunFolder
from mic.scene.schema import MonteCarlo
from mic.system.files import Format, save_json
from verification.scenes import FEW

ROOT = Path(__file__).resolve().parents[1]
LAP = ROOT / "meshes" / "lap_joint"
COARSE = ('size = "medium"', 'size = "coarse"')  # an edit of its first part of medium size


@pytest.fixture(autouse=True)
def elsewhere(tmp_path, monkeypatch):
    """A check writes its page where a run writes its results: below the working folder."""
    monkeypatch.chdir(tmp_path)


@pytest.fixture
def call(cache):
    """Runs a command in this process: its exit status, output and error."""
    environment = {"MIC_CACHE": str(cache), "COLUMNS": "200"}
    return lambda *arguments: CliRunner().invoke(app, [*map(str, arguments)], env=environment)


@pytest.fixture
def output(call):
    """Runs a command in this process that must succeed: its output."""

    def run(*arguments):
        done = call(*arguments)
        assert done.exit_code == 0, done.output
        return done.output

    return run


@pytest.mark.slow
@pytest.mark.fem
def test_run_check_report(call, output, tmp_path, no_pictures):
    scene = lap_with(tmp_path, ("friction = 0.27", "friction = 0.27\npairs = 12"), ('"associated", ', ""))
    first = output("run", scene, "--samples", 12)
    assert "report:" in first and "RMS slip under load" in first and "RMS tangential displacement" in first
    assert "coulomb: largest residual" in first and "with a tighter load path (12 samples)" in first
    folder = tmp_path / "results" / "lap-joint"
    summary = json.loads((folder / "summary.json").read_text())
    assert summary["samples"] == 12 and set(summary["laws"]) == {"coulomb", "frictionless"}
    assert summary["laws"]["coulomb"]["path"]["repeated"] == 12
    assert summary["laws"]["coulomb"]["zones"]["lap"]["six_sigma_rms_slip_path"] is not None
    assert (folder / "report.html").stat().st_size > 10_000
    again = output("run", scene, "--samples", 12, "--no-report")
    assert "reused" in again and "report:" not in again
    assert not (folder / "report.html").exists() and (folder / "summary.json").is_file()
    reported = output("report", folder, "--excel")
    assert "report:" in reported and (folder / "report.html").is_file()
    assert "tables.xlsx" in reported and (folder / "tables.xlsx").is_file()
    record = RunFolder(folder).record()
    save_json(folder / "run.json", Format("record of a run", 4, ""), record)
    assert "an older version" in str(call("report", folder).exception)


@pytest.mark.slow
def test_check_shows_what_a_frictionless_run_omits(output, tmp_path):
    text = (LAP / "scene.toml").read_text().replace("fields = true", "")
    text = re.sub(r'\[\[stages\]\]\nkind = "release".*?\n\n', "", text, flags=re.S)
    lap_with(tmp_path)
    (tmp_path / "scene.toml").write_text(text)
    lean = output("check", tmp_path, "--law", "frictionless")
    assert "only normals are modelled, 80 rows instead of 240" in lean
    assert "200 samples × 1 contact solves (frictionless) = 200 solves of 80 unknowns" in lean
    assert "no field solves" in lean and "The scene is valid" in lean and re.search(r"lower *│ 509 *│", lean)  # nodes
    rows = [[cell.strip() for cell in line.split("│")[1:-1]] for line in lean.splitlines() if "the geometry" in line]
    assert [row[:2] + row[3:] for row in rows] == [[part, "the geometry", "0", "0", "0"] for part in ("lower", "upper")]
    assert all(int(row[2]) > 1000 for row in rows)  # given normals


@pytest.mark.slow
def test_check_shows_sources_of_normals_and_draws_them(output, tmp_path):
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
    bent = ('name = "lower"\ngeometry = "geometry.py"', 'name = "lower"\ngeometry = "bent.py"')
    scene, picture = lap_with(tmp_path, bent), tmp_path / "normals.png"
    (tmp_path / "bent.py").write_text(script)
    checked = output("check", scene, "--normals", picture)
    assert re.search(r"lower +│ none +│ 0 +│ [1-9]\d* +│ [1-9]\d* +│ 0", checked)
    assert "with a bend of more than 40°, too coarse for its curvature" in " ".join(checked.split())
    assert picture.read_bytes().startswith(b"\x89PNG")
    asked = f"Effect of the process order: not computed. Run `mic order {scene}`."
    assert "note:" not in checked and asked in checked
    assert re.search(r"200 samples × \(\d+ \+ \d+ \+ \d+\) contact solves", checked)


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
def test_check_prints_the_process_step_by_step_with_notes(output, tmp_path, lap_model):
    """With coefficients at hand (those of the model) a few samples say where friction hardly matters."""
    scene = lap_with(
        tmp_path,
        ('kind = "clamp"', 'kind = "clamp"\norder = [["C1-lower"], ["C1-upper"]]'),
        ("friction = 0.27", f"friction = 0.27\npairs = {FEW['lap']}"),
    )
    with (tmp_path / "scene.toml").open("a") as file:
        file.write('\n[optimise]\nforces = [{ clamps = ["C1-upper"], between = [30, 90] }]\n')
    printed = output("check", scene)
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


@pytest.mark.slow
@pytest.mark.parametrize("order", ["check", "run", "order"])
def test_a_process_that_frees_a_part_is_refused_before_long_work(call, order, tmp_path, monkeypatch):
    scene = lap_with(tmp_path, ('keep = ["lower-A1", "lower-A2",', "keep = ["), COARSE, COARSE)

    def compute(*_):
        raise AssertionError("influence coefficients were asked for")

    checks = [f"{module}.influence_coefficients" for module in ("commands.check", "studies.check_results")]
    for name in ("runs.coefficients", *checks, "commands.invocation.coefficients"):
        monkeypatch.setattr(f"mic.{name}", compute)
    error = call(order, scene, *(["--out", tmp_path / "out"] if order == "run" else [])).exception
    assert isinstance(error, mic.SceneError)
    assert "stages (release): 2 rigid-body motions are free once lower-A1, lower-A2, upper-A1" in str(error)


@pytest.mark.slow
def test_a_folder_without_a_run_and_an_unknown_element_are_refused(call, tmp_path):
    assert "holds no run" in str(call("report", tmp_path).exception)
    lap_with(tmp_path, ("name = ", 'element = "springs"\nname = '), COARSE, COARSE)
    error = str(call("check", tmp_path).exception)
    assert "element: there is none called 'springs'; known: " in error and "dkt-opt" in error


def test_an_interrupted_run_names_the_command_that_continues_it(call, tmp_path, monkeypatch):
    def interrupt(*_):
        raise KeyboardInterrupt

    monkeypatch.setattr("mic.commands.run.run_scene", interrupt)
    done = call("run", LAP, "--out", tmp_path)
    assert done.exit_code == 130 and "run the same command again" in " ".join(done.output.split())


def test_laws_and_backends_of_the_options_are_those_of_the_program(call):
    run = next(command for command in app.registered_commands if command.callback.__name__ == "run")
    law, backend = (get_args(get_type_hints(run.callback)[name])[0] for name in ("law", "backend"))
    assert set(get_args(law)[0].__members__) == set(LAWS)
    assert set(backend.__members__) == set(get_args(MonteCarlo.model_fields["backend"].annotation))
    assert call("run", LAP, "--law", "glue").exit_code == 2


@pytest.mark.slow
def test_help_imports_no_numerical_library_production_no_finite_elements_and_an_error_is_one_line():
    script = """
import runpy, sys, mic.cli
sys.argv = ["mic", "run", "--help"]
try:
    mic.cli.main()
except SystemExit:
    pass
loaded = lambda *names: {name.split(".")[0] for name in sys.modules} & {*names}
assert not loaded("pandas", "pyarrow", "numba", "scipy", "matplotlib", "mpi4py")
import mic.commands.run, mic.report.page
assert not loaded("dolfinx", "petsc4py", "ufl", "fem_reference", "mpi4py", "gmsh")
sys.argv = ["mic", "check", "nowhere"]
runpy.run_module("mic", run_name="__main__")
"""
    environment = {name: value for name, value in os.environ.items() if not name.startswith(("OMPI", "PMI"))}
    done = subprocess.run([sys.executable, "-c", script], capture_output=True, text=True, timeout=60, env=environment)
    assert "--samples" in done.stdout and done.returncode == 2, done.stderr
    (line,) = done.stderr.strip().splitlines()
    assert "nowhere" in line and "this scene does not exist" in line


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
