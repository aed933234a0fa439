"""The scripts refuse a machine on which nothing fits; what they install and what other files promise agree."""

import os
import re
import shutil
import subprocess
import sys
import tomllib
from pathlib import Path

import numpy as np
import pytest
from packaging.requirements import Requirement

from fem_reference.shell.versions import supported
from mic.contact import ContactSolver
from mic.errors import MissingLibrary

ROOT = Path(__file__).resolve().parents[1]
TOOLS = ("awk", "bash", "cat", "cut", "dirname", "env", "grep", "id", "sed", "sha256sum", "uname")


@pytest.fixture
def machine(tmp_path):
    """A machine without apt-get, compiler and dolfinx: a copy of the scripts, and the environment to run them in."""
    shutil.copytree(ROOT / "script", tmp_path / "script")
    versions = tmp_path / "fem_reference" / "shell" / "versions.py"
    versions.parent.mkdir(parents=True)
    versions.write_text("raise SystemExit(1)")  # no Python finds dolfinx
    (tmp_path / "bin").mkdir()
    for tool in TOOLS:
        (tmp_path / "bin" / tool).symlink_to(shutil.which(tool))
    return tmp_path, {"PATH": str(tmp_path / "bin"), "HOME": str(tmp_path)}


@pytest.mark.parametrize("script", ["run", "test", "verify"])
@pytest.mark.parametrize("system", ["Darwin arm64", "Linux x86_64"])
def test_where_nothing_fits_one_sentence_names_the_reason_and_the_remedies(machine, script, system):
    folder, environment = machine
    if system.startswith("Linux") and fits("/usr/bin/python3"):
        pytest.skip("the Python of this system is one for the wheel")
    uname = folder / "bin" / "uname"
    uname.unlink()
    uname.write_text(f"#!{shutil.which('bash')}\necho {system}\n")
    uname.chmod(0o755)
    done = subprocess.run([folder / "script" / script], env=environment, capture_output=True, text=True)
    assert done.returncode == 1 and done.stdout == ""
    reason = "its wheel needs Python 3.12" if system.startswith("Linux") else "its wheel is for x86_64 Linux"
    assert done.stderr.count("\n") == 1 and reason in done.stderr
    assert "conda env create -f environment.yml" in done.stderr and "docker build" in done.stderr
    assert not (folder / ".venv").exists()


def fits(python):
    """Whether a Python is new enough for the wheel of dolfinx."""
    code = "import sys; sys.exit(sys.version_info < (3, 12))"
    return os.path.exists(python) and subprocess.run([python, "-c", code]).returncode == 0


def test_a_task_that_does_not_exist_is_refused(machine):
    folder, environment = machine
    done = subprocess.run([folder / "script" / "bootstrap", "tset"], env=environment, capture_output=True, text=True)
    assert done.returncode == 2 and "unknown task tset; choose from run, verify, test, check, docs" in done.stderr


def pins(name):
    lines = (ROOT / "script" / name).read_text(encoding="utf-8").splitlines()
    return [Requirement(line) for line in lines if not line.startswith("#")]


def test_the_pins_satisfy_the_ranges_of_the_project():
    project = tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))["project"]
    ranges = project["dependencies"] + [one for extra in project["optional-dependencies"].values() for one in extra]
    allowed = {one.name.lower(): one.specifier for one in map(Requirement, ranges)}
    pinned = pins("constraints.txt") + pins("constraints-wheel.txt")
    for pin in pinned:
        version = str(pin.specifier).removeprefix("==")
        assert pin.name.lower() not in allowed or allowed[pin.name.lower()].contains(version), pin
    missing = set(allowed) - {pin.name.lower() for pin in pinned} - {"mic-contact"}
    assert missing == set()
    assert len({(pin.name.lower(), str(pin.marker)) for pin in pinned}) == len(pinned)


def test_conda_and_the_wheel_bring_supported_versions_of_dolfinx():
    conda = (ROOT / "environment.yml").read_text(encoding="utf-8")
    first, beyond = re.search(r"fenics-dolfinx >=0\.(\d+),<0\.(\d+)", conda).groups()
    for minor in range(int(first), int(beyond)):
        supported(f"0.{minor}.0")
    (wheel,) = (pin for pin in pins("constraints-wheel.txt") if pin.name == "dolfinx-solver-real")
    supported(str(wheel.specifier).removeprefix("=="))


def test_the_image_is_built_by_the_script_that_is_tested_on_its_debian():
    lines = (ROOT / "Dockerfile").read_text(encoding="utf-8").splitlines()
    steps = [line for line in lines if line.startswith(("FROM", "RUN"))]
    assert steps == ["FROM debian:trixie-slim", "RUN script/bootstrap && rm -rf /var/lib/apt/lists/*"]


def test_a_solver_of_the_paper_that_is_not_installed_is_refused_with_the_command(monkeypatch):
    monkeypatch.setitem(sys.modules, "cvxpy", None)
    with pytest.raises(
        MissingLibrary, match=r"ecos needs CVXPY, which is not installed: pip install 'mic-contact\[peers\]'"
    ):
        ContactSolver(np.eye(3), 0.3, "associated", backend="ecos")
