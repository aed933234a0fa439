"""Which kernels OpenBLAS computes with: to a processor younger than itself it gives those of 2004, at a fifth of the
speed (release 0.3.21 of Debian 12 to Intel's of 2023). They are chosen here, before anything loads the library.
"""

from __future__ import annotations

import ctypes
import logging
import os
import sys
from pathlib import Path

__all__ = ["choose_kernels"]

NAME = "OPENBLAS_CORETYPE"  # what OpenBLAS reads as it is loaded
LIBRARY = "libopenblas.so.0"
OLDEST = "Prescott"
#: Kernels by what the processor must be able to do, the fastest first.
KERNELS = {
    "SKYLAKEX": {"avx512f", "avx512cd", "avx512bw", "avx512dq", "avx512vl"},
    "HASWELL": {"avx2", "fma"},
}
LOG = logging.getLogger(__name__)


def choose_kernels() -> None:
    """Have OpenBLAS take kernels that suit the processor, where it would take its oldest by itself.

    Nothing is done where the user has chosen, and where the library knows the processor: which kernels it takes decides
    the last bits of sums. Where numpy has loaded it already, it is too late, and said.
    """
    if NAME in os.environ:
        return
    able = abilities()
    suiting = next((name for name, needed in KERNELS.items() if needed <= able), None)
    if suiting is None:
        return
    if "numpy" in sys.modules:
        if loaded() == OLDEST:
            LOG.warning(
                "OpenBLAS does not know this processor, and computes at a fraction of its speed: "
                "import mic before numpy, or set %s=%s beforehand",
                NAME,
                suiting,
            )
    elif taken() == OLDEST:
        os.environ[NAME] = suiting


def abilities() -> set[str]:
    """Of the processor, in Linux's words."""
    try:
        lines = Path("/proc/cpuinfo").read_text().splitlines()
    except OSError:
        return set()
    return next((set(line.split()) for line in lines if line.startswith("flags")), set())


def taken() -> str:
    """The kernels that OpenBLAS takes by itself; a child asks it, since it decides once in a process."""
    mine, its = os.pipe()
    child = os.fork()
    if child == 0:
        try:
            os.write(its, _corename(ctypes.CDLL(LIBRARY)))
        finally:
            os._exit(0)
    os.close(its)
    with os.fdopen(mine) as told:
        name = told.read()
    os.waitpid(child, 0)
    return name


def loaded() -> str:
    """The kernels that it has taken in this process; nothing if another library is loaded."""
    try:
        return _corename(ctypes.CDLL(LIBRARY, mode=os.RTLD_NOLOAD)).decode()
    except OSError:
        return ""


def _corename(library: ctypes.CDLL) -> bytes:
    name = library.openblas_get_corename
    name.restype = ctypes.c_char_p
    found: bytes = name()
    return found
