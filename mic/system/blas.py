"""Choice of the OpenBLAS kernels, before the library is loaded.

OpenBLAS selects its oldest kernels, at a fifth of the speed, on processors that are newer than itself: release 0.3.21
of Debian 12 does so on Intel's of 2023.
"""

from __future__ import annotations

import ctypes
import logging
import os
import sys
from pathlib import Path

__all__ = ["choose_kernels"]

NAME = "OPENBLAS_CORETYPE"  # environment variable that OpenBLAS reads when it is loaded
LIBRARY = "libopenblas.so.0"
OLDEST = "Prescott"
#: Processor features that each kernel needs, the fastest kernel first.
KERNELS = {
    "SKYLAKEX": {"avx512f", "avx512cd", "avx512bw", "avx512dq", "avx512vl"},
    "HASWELL": {"avx2", "fma"},
}
LOG = logging.getLogger(__name__)


def choose_kernels() -> None:
    """Make OpenBLAS use suitable kernels if it would select its oldest ones.

    The choice of the user, and of a library that knows the processor, is not changed: kernels determine the last bits
    of sums. If numpy was imported first, it is too late, and a warning is logged.
    """
    if NAME in os.environ:
        return
    flags = cpu_flags()
    kernel = next((name for name, needed in KERNELS.items() if needed <= flags), None)
    if kernel is None:
        return
    if "numpy" in sys.modules:
        if loaded_kernel() == OLDEST:
            LOG.warning(
                "OpenBLAS does not know this processor and runs at a fraction of its speed: import mic before numpy, "
                "or set the environment variable %s=%s",
                NAME,
                kernel,
            )
    elif default_is_oldest():
        os.environ[NAME] = kernel


def cpu_flags() -> set[str]:
    """Feature flags of the processor, from ``/proc/cpuinfo``."""
    try:
        lines = Path("/proc/cpuinfo").read_text().splitlines()
    except OSError:
        return set()
    return next((set(line.split()) for line in lines if line.startswith("flags")), set())


def default_is_oldest() -> bool:
    """Whether OpenBLAS by itself selects its oldest kernels; a child process loads it, since it selects once per
    process."""
    child = os.fork()
    if child == 0:
        try:
            os._exit(_corename(ctypes.CDLL(LIBRARY)) == OLDEST)
        finally:  # it cannot be loaded
            os._exit(0)
    return os.waitstatus_to_exitcode(os.waitpid(child, 0)[1]) == 1


def loaded_kernel() -> str:
    """The kernels that OpenBLAS selected in this process; empty if another library is loaded."""
    try:
        return _corename(ctypes.CDLL(LIBRARY, mode=os.RTLD_NOLOAD))
    except OSError:
        return ""


def _corename(library: ctypes.CDLL) -> str:
    name = library.openblas_get_corename
    name.restype = ctypes.c_char_p
    return str(name(), "ascii")
