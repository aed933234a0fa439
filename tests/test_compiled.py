"""Kernels are compiled at setup and not at the first evaluation."""

import os
import shutil
import subprocess
import sys

import pytest

from mic.commands import compile as compilation
from mic.contact.laws import LAWS
from mic.contact.native import kernel as native_kernel
from mic.system.compilation import MESSAGE

EVALUATE = """
import sys
import mic
from mic.commands import compile as compilation
compilation.load_all(compilation.kernels(derivatives=True), 2)
print("compiled", flush=True)
model = mic.ReducedModel.load(sys.argv[1])
for law in sys.argv[2:]:
    assert not model.evaluate({}, law).failed.any()
"""
ADDING = """
from numba import float64, njit

@njit(float64(float64), cache=True)
def one(x):
    return x + 1


@njit(float64(float64), cache=True)
def two(x):
    return x + 2
"""


def python(*arguments):
    environment = os.environ | {"NUMBA_DEBUG_CACHE": "1"}
    command, both = [sys.executable, *arguments], {"stdout": subprocess.PIPE, "stderr": subprocess.STDOUT}
    done = subprocess.run(command, env=environment, **both, text=True, timeout=600)
    assert done.returncode == 0, done.stdout
    return done.stdout


@pytest.mark.slow
def test_evaluations_compile_nothing_once_kernels_are_compiled(lap_model, tmp_path):
    lap_model.save(tmp_path / "model.npz")
    laws = (name for name, law in LAWS.items() if not law.reads)
    _, evaluation = python("-c", EVALUATE, str(tmp_path / "model.npz"), *laws).split("compiled\n")
    assert "data saved to" not in evaluation and MESSAGE not in evaluation


@pytest.mark.slow
def test_compilation_is_reported_once_and_cached_code_silently_reused(tmp_path):
    (tmp_path / "adding.py").write_text(ADDING)
    command = "-c", f"import sys; sys.path.insert(0, {str(tmp_path)!r}); import mic.contact.native, adding"
    assert [python(*command).count(MESSAGE) for _ in range(2)] == [1, 0]


@pytest.fixture
def package(tmp_path, monkeypatch):
    """The folder of a package ``native`` that holds the module of kernels alone."""
    monkeypatch.setenv("PYTHONPATH", str(tmp_path), prepend=os.pathsep)
    folder = tmp_path / "native"
    folder.mkdir()
    shutil.copy(native_kernel.__file__, folder)
    return folder


MODULES = {
    "adding": "from native.kernel import NUMBER, kernel\n\n@kernel(NUMBER(NUMBER))\ndef add(x):\n    return x + 1\n",
    "doubling": "from native.adding import add\nfrom native.kernel import NUMBER, kernel\n\n"
    "@kernel(NUMBER(NUMBER), from_python=True)\ndef double(x):\n    return 2 * add(x)\n",
}
CALL = "from native.doubling import double as f; print(len(f.overloads), f(1), f.stats.cache_hits.total())"


@pytest.mark.slow
def test_a_kernel_is_loaded_when_called_and_compiled_again_when_one_that_it_calls_changes(package):
    for name, text in MODULES.items():
        (package / f"{name}.py").write_text(text)
    found = [python("-c", CALL).splitlines()[-1] for _ in range(2)]
    (package / "adding.py").write_text(MODULES["adding"].replace("+ 1", "+ 2"))
    assert [*found, python("-c", CALL).splitlines()[-1]] == ["0 4.0 0", "0 4.0 1", "0 6.0 0"]


PAIRING = """
from typing import NamedTuple

from numba import types

from native.kernel import NUMBER, kernel


class Pair(NamedTuple):
    x: float
    y: float


@kernel(NUMBER(types.NamedUniTuple(NUMBER, 2, Pair)), from_python=True)
def total(pair):
    return pair.x + pair.y


print(total(Pair(1.0, 2.0)))
"""


@pytest.mark.slow
def test_a_cache_with_types_that_are_gone_is_written_anew(package):
    for text in (PAIRING, PAIRING.replace("Pair", "Both")):
        (package / "pairing.py").write_text(text)
        assert python("-c", "import native.pairing").splitlines()[-1] == "3.0"


@pytest.mark.slow
def test_python_cannot_call_a_kernel_without_a_wrapper(package):
    for name, text in MODULES.items():
        (package / f"{name}.py").write_text(text)
    call = """
from native.adding import add
from native.doubling import double

for _ in range(2):  # before and after it is loaded
    try:
        add(1.0)
    except TypeError as error:
        print(error)
    double(1.0)
"""
    assert python("-c", call).count("only kernels call add") == 2


def test_a_run_calls_no_kernel_of_derivatives():
    """The kernels compiled for a run call no others, and all others belong to derivatives."""
    for_a_run = compilation.kernels(derivatives=False)
    beyond = set(compilation.kernels(derivatives=True)) - set(for_a_run)
    assert {one.__module__.rpartition(".")[2] for one in beyond} == compilation.DERIVATIVES
    assert not any(called in beyond for one in for_a_run for called in one.called)
