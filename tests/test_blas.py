"""Which kernels OpenBLAS is given: suiting ones, where it does not know the processor, and nowhere else."""

import os
import subprocess
import sys

import pytest

from mic import blas

AVX2 = {"sse2", "avx2", "fma"}
AVX512 = AVX2 | {"avx512f", "avx512cd", "avx512bw", "avx512dq", "avx512vl"}


@pytest.mark.parametrize(
    "able, taken, chosen",
    [
        (AVX512, "Prescott", "SKYLAKEX"),
        (AVX2, "Prescott", "HASWELL"),
        (AVX2 | {"avx512f"}, "Prescott", "HASWELL"),
        ({"sse2"}, "Prescott", None),  # of 2004 indeed
        (AVX512, "SkylakeX", None),
        (AVX2, "Zen", None),
        (AVX512, "", None),  # another library than OpenBLAS
    ],
)
def test_kernels_are_chosen_where_the_library_does_not_know_the_processor(monkeypatch, able, taken, chosen):
    monkeypatch.setattr(blas, "_abilities", lambda: able)
    monkeypatch.setattr(blas, "_taken", lambda: taken)
    monkeypatch.setattr(sys, "modules", {key: one for key, one in sys.modules.items() if key != "numpy"})
    monkeypatch.setenv(blas.NAME, "")
    monkeypatch.delenv(blas.NAME)
    blas.choose_kernels()
    assert os.environ.get(blas.NAME) == chosen


def test_what_the_user_chose_or_numpy_has_loaded_stays(monkeypatch):
    monkeypatch.setattr(blas, "_taken", lambda: pytest.fail("nobody needs to know"))
    monkeypatch.delenv(blas.NAME, raising=False)
    blas.choose_kernels()  # these tests have numpy
    assert blas.NAME not in os.environ
    monkeypatch.setattr(sys, "modules", {key: one for key, one in sys.modules.items() if key != "numpy"})
    monkeypatch.setenv(blas.NAME, "NEHALEM")
    blas.choose_kernels()
    assert os.environ[blas.NAME] == "NEHALEM"


def test_a_process_that_imports_mic_first_has_kernels_for_its_processor():
    program = (
        "import mic, numpy, threadpoolctl\n"
        "for one in threadpoolctl.threadpool_info(): print(one.get('internal_api'), one.get('architecture'))"
    )
    own = {key: value for key, value in os.environ.items() if key != blas.NAME}
    told = subprocess.run([sys.executable, "-c", program], env=own, capture_output=True, text=True, check=True).stdout
    with open("/proc/cpuinfo") as file:
        new = "avx2" in file.read()
    assert "openblas" in told and not (new and "Prescott" in told)
