"""The content of the wheel, and its use in an environment without finite elements."""

import json
import os
import shutil
import subprocess
import sys
import venv
import zipfile
from pathlib import Path

import pytest
from packaging.requirements import Requirement

from mic import examples

ROOT = Path(__file__).resolve().parents[1]
FINITE_ELEMENTS = ("dolfinx", "petsc4py", "mpi4py", "gmsh")
#: Tests that depend on the versions of NumPy, SciPy and pandas; CONTRIBUTING.md has the command for all.
TESTS = ("test_montecarlo.py", "test_statistics.py")
DEVIATIONS = {"F1": -7.0, "D1": 0.08}
#: Arguments: a saved model; a page of the gallery, from which sphinx-gallery writes a notebook cell by cell; packages
#: that must be absent.
SESSION = f"""
import importlib.util, runpy, sys
import mic
assert not [name for name in sys.argv[3:] if importlib.util.find_spec(name)], "this environment is not empty"
assert mic.__file__.startswith(sys.prefix), mic.__file__
print(mic.ReducedModel.load(sys.argv[1]).evaluate({DEVIATIONS}, "coulomb").measurements[0].tolist())
runpy.run_path(sys.argv[2])
"""


def run(command, folder):
    """Output of a program that does not see this tree; an error shows it."""
    hidden = ("PYTHONPATH", "VIRTUAL_ENV", "PYTHONHOME")
    environment = {name: text for name, text in os.environ.items() if name not in hidden}
    both = {"stdout": subprocess.PIPE, "stderr": subprocess.PIPE}
    done = subprocess.run(command, cwd=folder, env=environment | {"MPLBACKEND": "agg"}, **both, text=True, timeout=600)
    assert done.returncode == 0, f"{command}\n{done.stdout}{done.stderr}"
    return done.stdout


@pytest.fixture(scope="module")
def wheel(tmp_path_factory):
    """The wheel of this tree, built from a copy: building writes into its folder."""
    folder = tmp_path_factory.mktemp("wheel")
    source = folder / "source"
    source.mkdir()
    for name in ("mic", "fem_reference", "verification", "meshes"):
        shutil.copytree(ROOT / name, source / name, symlinks=True, ignore=shutil.ignore_patterns("__pycache__"))
    for path in ROOT.glob("*"):
        if path.is_file():
            shutil.copy(path, source)
    run([sys.executable, *"-m pip wheel . --no-deps -q -w".split(), folder], source)
    (path,) = folder.glob("*.whl")
    return path


@pytest.fixture(scope="module")
def python(wheel, tmp_path_factory):
    """Python of an environment that holds the wheel, its dependencies and a test runner, and nothing of the system."""
    folder = tmp_path_factory.mktemp("empty")
    venv.create(folder)
    python = next(path for path in (folder / "bin" / "python", folder / "Scripts" / "python.exe") if path.exists())
    install = "install --quiet --no-compile --disable-pip-version-check --constraint".split()
    needed = [ROOT / "script" / "constraints.txt", wheel, "pytest", "hypothesis"]
    run([sys.executable, "-m", "pip", "--python", python, *install, *needed], folder)
    (installed,) = folder.glob("**/site-packages/mic")
    # Compiled kernels depend on their sources, Numba and the processor alone, where Numba's own cache looks at the time
    # of a source. Those that this tree lacks are compiled.
    for kernel in (ROOT / "mic").glob("**/__pycache__/*.nb?"):
        source = kernel.parents[1] / f"{kernel.name.partition('.')[0]}.py"
        there = installed / kernel.parent.relative_to(ROOT / "mic")
        there.mkdir(exist_ok=True)
        shutil.copy(kernel, there)
        if source.is_file():
            shutil.copystat(source, there.parent / source.name)
    return python


@pytest.mark.slow
def test_the_wheel_carries_the_examples_and_no_generic_name(wheel):
    files = zipfile.ZipFile(wheel).namelist()
    top = {name.split("/")[0].split("-")[0] for name in files}
    assert top == {"mic", "fem_reference", "verification", "mic_contact"}
    for example in examples.names():
        for path in examples.folder(example).glob("*.*"):
            assert f"mic/example_scenes/{example}/{path.name}" in files
    own = {path for path in (ROOT / "mic").rglob("*.*") if path.is_file() and "__pycache__" not in path.parts}
    assert len(own) > 300 and {str(path.relative_to(ROOT)) for path in own} <= set(files)
    assert not any("__pycache__" in name for name in files)
    assert wheel.name.endswith("-py3-none-any.whl")


@pytest.mark.slow
def test_the_extra_of_finite_elements_holds_a_wheel_where_there_is_one(wheel):
    with zipfile.ZipFile(wheel) as archive:
        (name,) = (name for name in archive.namelist() if name.endswith(".dist-info/METADATA"))
        lines = archive.read(name).decode().splitlines()
    (needed,) = (Requirement(line.split(": ")[1]) for line in lines if line.startswith("Requires-Dist: dolfinx"))
    linux = {"extra": "fem", "sys_platform": "linux", "platform_machine": "x86_64", "python_version": "3.12"}
    others = ({"extra": ""}, {"sys_platform": "darwin"}, {"platform_machine": "aarch64"}, {"python_version": "3.11"})
    assert needed.marker.evaluate(linux) and not any(needed.marker.evaluate(linux | other) for other in others)


@pytest.fixture(scope="module")
def printed(python, lap_model, tmp_path_factory):
    """Output of the empty environment: measurements of the lap joint's saved model, then of a page of the gallery."""
    folder = tmp_path_factory.mktemp("session")
    lap_model.save(folder / "model.npz")
    page = shutil.copy(ROOT / "docs" / "gallery" / "without_finite_elements.py", folder)
    return run([python, "-c", SESSION, folder / "model.npz", page, *FINITE_ELEMENTS], folder)


@pytest.mark.slow
def test_a_saved_model_gives_the_same_numbers_in_an_empty_environment(printed, lap_model):
    expected = lap_model.evaluate(DEVIATIONS, "coulomb").measurements[0].tolist()
    assert json.loads(printed.splitlines()[0]) == pytest.approx(expected, rel=1e-9)


@pytest.mark.slow
def test_the_notebook_without_finite_elements_runs_in_an_empty_environment(printed):
    assert "6σ of M1, mm" in printed


@pytest.mark.slow
def test_tests_without_finite_elements_pass_in_an_empty_environment(python, tmp_path):
    options = ["-p", "no:cacheprovider", "-m", "not slow and not fem", f"--basetemp={tmp_path}"]
    tests = [ROOT / "tests" / name for name in TESTS]
    assert " passed" in run([python.with_name("pytest"), *options, *tests], ROOT)
