"""The dependencies that pyproject.toml declares are those that the program imports, and each says what it is for."""

import ast
import re
import sys
import tomllib
from pathlib import Path

ROOT = Path(__file__).resolve().parents[1]
PROJECT = tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))["project"]
OWN = {"mic", "fem_reference", "verification"}
#: Names of modules whose package has another name.
PACKAGES = {"PIL": "pillow", "trame_vtk": "trame-vtk"}
#: Imported by `mic` where several processes share a run; comes with the finite elements.
BY_RANKS = {"mpi4py"}


def names(requirements):
    return {re.match(r"[\w-]+", requirement)[0] for requirement in requirements}


def imported(folder):
    """Packages that the modules of a folder import anywhere, also within functions."""
    found = set()
    for path in folder.rglob("*.py"):
        if "example_scenes" not in path.parts:
            for node in ast.walk(ast.parse(path.read_text(encoding="utf-8"))):
                if isinstance(node, ast.Import):
                    found |= {alias.name.split(".")[0] for alias in node.names}
                elif isinstance(node, ast.ImportFrom):
                    found.add(node.module.split(".")[0])
    return {PACKAGES.get(name, name) for name in found - OWN - sys.stdlib_module_names}


def test_each_import_of_the_program_is_declared_and_nothing_else_is_always_installed():
    always, extras = names(PROJECT["dependencies"]), PROJECT["optional-dependencies"]
    used = imported(ROOT / "mic")
    assert always <= used, "drop what is not imported"
    optional = names(sum((extras[name] for name in ("dask", "excel", "explore", "fmu", "peers", "serve")), []))
    assert used - always <= optional | BY_RANKS, "declare what is imported"


def test_each_dependency_has_a_lower_bound_and_says_what_it_is_for():
    text = (ROOT / "pyproject.toml").read_text(encoding="utf-8")
    for requirement in [*PROJECT["dependencies"], *PROJECT["optional-dependencies"]["fem"]]:
        assert ">=" in requirement
        (line,) = (line for line in text.splitlines() if f'"{requirement}"' in line)
        assert re.search(r", # \w+ ?\w+", line), requirement
