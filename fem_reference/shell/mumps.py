"""Direct interface to MUMPS, for a user-defined elimination order (PERM_IN), which PETSc does not support.

MUMPS and its caller share one structure, whose layout depends on the version. Its first four fields never moved, so
MUMPS is started with them; the version that it then writes must stand where the layout of that version has it. The
library is that loaded by PETSc, so no header file is needed.
"""

from __future__ import annotations

import ctypes
import re
from functools import cache
from typing import Any

import numpy as np
from mpi4py import MPI
from petsc4py import PETSc

__all__ = ["Instance", "MumpsFailure", "Unavailable", "version"]

_BYTES = 1 << 16  # at least five times the structure of any version
# Byte offsets in the structure of double precision with 32-bit integers (PETSc builds with no other)
_HEAD = {"sym": 0, "par": 4, "job": 8, "comm_fortran": 12, "icntl": 16, "n": 5416, "nnz": 5432}
_HEAD |= {"irn": 5440, "jcn": 5448, "a": 5456, "perm_in": 5552}
_TAIL = ("rhs", "rhs_sparse", "irhs_sparse", "irhs_ptr", "nrhs", "lrhs", "nz_rhs", "infog")
_TAIL += ("size_schur", "listvar_schur", "schur", "version_number")
_OFFSETS = {
    "5.5": (5600, 5616, 5640, 5648, 5672, 5676, 5684, 6048, 7032, 7040, 7048, 7072),
    "5.7": (5640, 5656, 5688, 5696, 5736, 5740, 5748, 6120, 7112, 7120, 7128, 7144),
    "5.9": (5640, 5656, 5688, 5696, 5736, 5740, 5748, 6120, 7108, 7112, 7120, 7136),
}
_OFFSETS["5.8"] = _OFFSETS["5.7"]
LAYOUTS = {series: _HEAD | dict(zip(_TAIL, offsets, strict=True)) for series, offsets in _OFFSETS.items()}


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
        If PETSc has no MUMPS, or one of a version whose structure is not in `LAYOUTS`.
    """

    def __init__(self, symmetry: int):
        self._function = _library()
        self._memory = ctypes.create_string_buffer(_BYTES)
        self._offset = _HEAD
        self._arrays: dict[str, np.ndarray] = {}
        self.set(sym=symmetry, par=1, comm_fortran=MPI.COMM_SELF.py2f())
        self._call(-1)
        self._alive = True
        for stream in (1, 2, 3):  # errors come as numbers, and nothing is printed
            self.control(stream, -1)
        self.control(4, 0)
        self._offset = self._layout()

    def control(self, number: int, value: int) -> None:
        """Set ICNTL(`number`)."""
        self._field("icntl", ctypes.c_int, number - 1).value = value

    def information(self, number: int) -> int:
        """INFOG(`number`)."""
        return self._field("infog", ctypes.c_int, number - 1).value

    def set(self, **values: int) -> None:
        """Set integer fields of the structure."""
        for name, value in values.items():
            self._field(name, ctypes.c_int64 if name == "nnz" else ctypes.c_int).value = value

    def give(self, **arrays: np.ndarray) -> None:
        """Let fields of the structure point to contiguous arrays of 32-bit integers or doubles."""
        for name, array in arrays.items():
            assert array.flags.c_contiguous or array.flags.f_contiguous, f"{name} must be contiguous"
            assert array.dtype in (np.int32, np.float64), f"{name} must hold 32-bit integers or doubles"
            self._field(name, ctypes.c_void_p).value = array.ctypes.data
            self._arrays[name] = array

    def take_back(self, *names: str) -> None:
        """Let fields of the structure point nowhere: MUMPS needs these arrays no more."""
        for name in names:
            self._field(name, ctypes.c_void_p).value = None
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
        self.set(job=job)
        self._function(ctypes.addressof(self._memory))

    def _field(self, name: str, kind: Any, entry: int = 0) -> Any:
        return kind.from_buffer(self._memory, self._offset[name] + entry * ctypes.sizeof(kind))

    def _layout(self) -> dict[str, int]:
        """The layout of the version that MUMPS has written, if it stands where that layout has it."""
        found = re.search(rb"(\d+\.\d+)\.\d+", self._memory.raw)
        layout = LAYOUTS.get(found.group(1).decode(), {}) if found else {}
        if found and layout.get("version_number") == found.start():
            self.version = found.group().decode()
            return layout
        version, known = found.group().decode() if found else "(unknown version)", ", ".join(LAYOUTS)
        raise Unavailable(f"the structure of MUMPS {version} is not known; install a PETSc with MUMPS {known}")


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
def version() -> str:
    """Version of the MUMPS that PETSc has loaded; "unknown" if it cannot be called directly."""
    try:
        return Instance(symmetry=1).version
    except Unavailable:
        return "unknown"
