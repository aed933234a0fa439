"""Direct interface to MUMPS, for a user-defined elimination order (PERM_IN), which PETSc does not support.

MUMPS and its caller share one structure, whose layout depends on the version. It is read from the installed header
(`dmumps_c.h`); the version that MUMPS reports in that layout must be the header's. The library is that loaded by PETSc.
"""

from __future__ import annotations

import ctypes
import re
import sys
from functools import cache
from pathlib import Path
from typing import Any

import cffi
import numpy as np
import petsc4py
from mpi4py import MPI
from petsc4py import PETSc

__all__ = ["Instance", "MumpsFailure", "Unavailable"]

_STRUCTURE = "DMUMPS_STRUC_C"
_ROOM = 1 << 16  # bytes behind the structure: a library of another version writes there, not into what is ours
_POINTERS = {np.dtype(np.int32): "int *", np.dtype(np.float64): "double *"}
_REMEDY = "install the headers of the MUMPS that PETSc was built with (Debian: libmumps-headers-dev)"


class Unavailable(Exception):
    """MUMPS cannot be called directly; the text says why and what to change."""


class MumpsFailure(Exception):
    """MUMPS ended with INFOG(1) = `status` < 0 and INFOG(2) = `detail`."""

    def __init__(self, status: int, detail: int):
        super().__init__(f"MUMPS reports INFOG(1) = {status}, INFOG(2) = {detail}")
        self.status, self.detail = status, detail


class Instance:
    """A MUMPS instance for one matrix on this process. Field names are those of MUMPS's users' guide.

    Arrays handed over by `give` are read and written in place and kept alive until `take_back`.

    Raises
    ------
    Unavailable
        If there is no header, if it cannot be read, or if it is another version's than the library.
    """

    def __init__(self, symmetry: int):
        ffi, version = layout()
        self._function = _library()
        self._ffi = ffi
        self._memory = ffi.new("char[]", ffi.sizeof(_STRUCTURE) + _ROOM)
        self._fields: Any = ffi.cast(f"{_STRUCTURE} *", self._memory)
        self._arrays: dict[str, np.ndarray] = {}
        self._fields.sym, self._fields.par, self._fields.comm_fortran = symmetry, 1, MPI.COMM_SELF.py2f()
        self._call(-1)
        found = ffi.string(self._fields.version_number).decode("ascii", "replace").strip()
        if found != version:
            raise Unavailable(f"the header of MUMPS is of version {version}, its library of another; {_REMEDY}")
        self._alive = True
        for stream in (1, 2, 3):  # errors come as numbers, and nothing is printed
            self.control(stream, -1)
        self.control(4, 0)

    def control(self, number: int, value: int) -> None:
        """Set ICNTL(`number`)."""
        self._fields.icntl[number - 1] = value

    def information(self, number: int) -> int:
        """INFOG(`number`)."""
        return self._fields.infog[number - 1]

    def set(self, **values: int) -> None:
        """Set integer fields of the structure."""
        for name, value in values.items():
            setattr(self._fields, name, value)

    def give(self, **arrays: np.ndarray) -> None:
        """Let fields of the structure point to contiguous arrays of 32-bit integers or doubles."""
        for name, array in arrays.items():
            assert array.flags.c_contiguous or array.flags.f_contiguous, f"{name} must be contiguous"
            setattr(self._fields, name, self._ffi.cast(_POINTERS[array.dtype], array.ctypes.data))
            self._arrays[name] = array

    def take_back(self, *names: str) -> None:
        """Let fields of the structure point nowhere: MUMPS needs these arrays no more."""
        for name in names:
            setattr(self._fields, name, self._ffi.NULL)
            self._arrays.pop(name, None)

    def run(self, job: int) -> None:
        """1: analysis, 2: factorisation, 3: solve. Raises `MumpsFailure`."""
        self._call(job)
        if self.information(1) < 0:
            raise MumpsFailure(self.information(1), self.information(2))

    def close(self) -> None:
        """Give MUMPS's memory back; the instance is of no further use."""
        if getattr(self, "_alive", False) and not MPI.Is_finalized():
            self._alive = False
            self._call(-2)
            self._arrays.clear()

    def __del__(self):
        self.close()

    def _call(self, job: int) -> None:
        self._fields.job = job
        self._function(int(self._ffi.cast("uintptr_t", self._fields)))


@cache
def _library() -> Any:
    """`dmumps_c` of the very library that petsc4py has loaded; Python's lock is held, as MUMPS keeps global state."""
    try:
        function = ctypes.PyDLL(PETSc.__file__).dmumps_c  # symbols are looked up in its dependencies as well
    except (OSError, AttributeError) as problem:  # pragma: no cover - no such PETSc build is known
        raise Unavailable(f"this PETSc has no MUMPS ({problem})") from problem
    function.argtypes, function.restype = [ctypes.c_void_p], None
    return function


@cache
def layout() -> tuple[cffi.FFI, str]:
    """The structure's layout and the version of MUMPS, from the first header found."""
    config = petsc4py.get_config()
    petsc = Path(config["PETSC_DIR"], config.get("PETSC_ARCH", ""), "include")
    for folder in (petsc, Path(sys.base_prefix, "include"), Path("/usr/include")):
        if (folder / "dmumps_c.h").exists():
            return read_header(folder)
    raise Unavailable(f"the header of MUMPS, dmumps_c.h, is missing; {_REMEDY}")


def read_header(folder: Path) -> tuple[cffi.FFI, str]:
    """The layout of MUMPS's structure and its version, of the headers in a folder.

    Raises
    ------
    Unavailable
        If the header is not of the form that is known, or MUMPS was built with 64-bit integers throughout.
    """
    header = folder / "dmumps_c.h"
    text = header.read_text(encoding="utf-8", errors="replace")
    integers = folder / "mumps_int_def.h"
    if integers.exists() and re.search(r"^\s*#\s*define\s+MUMPS_INTSIZE64", integers.read_text(), re.MULTILINE):
        raise Unavailable(f"{integers} declares 64-bit integers, which are not supported")
    version = re.search(r'#\s*define\s+MUMPS_VERSION\s+"([^"]+)"', text)
    length = re.search(r"#\s*define\s+MUMPS_VERSION_MAX_LEN\s+(\d+)", text)
    structure = re.search(rf"typedef\s+struct\s*\{{[^{{}}]*\}}\s*{_STRUCTURE}\s*;", text)
    if not (version and length and structure):
        raise Unavailable(f"{header} has an unknown form; {_REMEDY}")
    ffi = cffi.FFI()
    try:
        ffi.cdef(
            "typedef int MUMPS_INT; typedef int64_t MUMPS_INT8; typedef double DMUMPS_REAL, DMUMPS_COMPLEX;"
            + structure.group().replace("MUMPS_VERSION_MAX_LEN", length.group(1))
        )
    except (cffi.CDefError, cffi.FFIError) as problem:
        raise Unavailable(f"{header} cannot be read ({str(problem).splitlines()[0]}); {_REMEDY}") from problem
    return ffi, version.group(1)
