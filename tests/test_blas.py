"""OpenBLAS gets a suitable kernel if it does not know the processor, and keeps its own otherwise."""

import os
import subprocess
import sys
from pathlib import Path

import pytest

from mic.system import blas

AVX2 = {"sse2", "avx2", "fma"}
AVX512 = AVX2 | {"avx512f", "avx512cd", "avx512bw", "avx512dq", "avx512vl"}


@pytest.fixture
def processor(monkeypatch):
    """A process begins on a processor with AVX-512 that OpenBLAS does not know: nothing chosen, no numpy."""
    monkeypatch.setattr(blas, "cpu_flags", lambda: AVX512)
    monkeypatch.setattr(blas, "default_is_oldest", lambda: True)
    monkeypatch.setattr(sys, "modules", {key: one for key, one in sys.modules.items() if key != "numpy"})
    monkeypatch.setenv(blas.NAME, "")
    monkeypatch.delenv(blas.NAME)
    return monkeypatch


@pytest.mark.parametrize(
    "able, oldest, chosen",
    [
        (AVX512, True, "SKYLAKEX"),
        (AVX2 | {"avx512f"}, True, "HASWELL"),
        ({"sse2"}, True, None),  # the oldest indeed
        (AVX512, False, None),
    ],
)
def test_a_kernel_is_chosen_if_openblas_does_not_know_the_processor(processor, able, oldest, chosen):
    processor.setattr(blas, "cpu_flags", lambda: able)
    processor.setattr(blas, "default_is_oldest", lambda: oldest)
    blas.choose_kernels()
    assert os.environ.get(blas.NAME) == chosen


def test_the_users_choice_of_kernel_is_respected(processor):
    processor.setenv(blas.NAME, "NEHALEM")
    blas.choose_kernels()
    assert os.environ[blas.NAME] == "NEHALEM"


@pytest.mark.parametrize("loaded, message", [("Prescott", "OPENBLAS_CORETYPE=SKYLAKEX"), ("Haswell", ""), ("", "")])
def test_importing_numpy_first_gives_a_warning(processor, caplog, loaded, message):
    sys.modules["numpy"] = None
    processor.setattr(blas, "loaded_kernel", lambda: loaded)
    blas.choose_kernels()
    assert blas.NAME not in os.environ and message in caplog.text and bool(caplog.text) == bool(message)


def test_importing_mic_first_selects_kernels_for_the_processor():
    program = (
        "import mic, numpy, threadpoolctl\n"
        "for one in threadpoolctl.threadpool_info(): print(one.get('internal_api'), one.get('architecture'))"
    )
    own = {key: value for key, value in os.environ.items() if key != blas.NAME}
    output = subprocess.run([sys.executable, "-c", program], env=own, capture_output=True, text=True, check=True).stdout
    new = "avx2" in Path("/proc/cpuinfo").read_text()
    assert "openblas" in output and not (new and "Prescott" in output)
    late = subprocess.run([sys.executable, "-c", f"import numpy\n{program}"], env=own, capture_output=True, text=True)
    assert (blas.NAME in late.stderr) == (new and "Prescott" in late.stdout)
