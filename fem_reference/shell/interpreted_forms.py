"""Forms of dolfinx 0.11 without a C compiler, for the systems where FFCx cannot compile its C code.

FFCx also writes its kernels in Python, for Numba, which would take minutes to compile those of the shells. They are
straight-line code on numbers, and the same on arrays with one entry per cell, so NumPy evaluates them for many cells at
once. dolfinx calls a kernel for one cell after another and gets the finished element tensors.
"""

from __future__ import annotations

import ctypes
import shlex
import shutil
import sysconfig
from os import environ
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import ufl
from dolfinx import cpp, fem

__all__ = ["CELLS", "form", "no_compiler"]

CELLS = 1024  #: evaluated at once; the kernel of a shell holds ten thousand arrays of so many numbers
_known: dict[str, tuple] = {}  # kernels by signature of the form


def no_compiler() -> bool:
    """Whether C code cannot be compiled into a module of this Python: its compiler or header file is missing."""
    command = shlex.split(environ.get("CC") or sysconfig.get_config_var("CC") or "cc")
    return shutil.which(command[0]) is None or not Path(sysconfig.get_path("include"), "Python.h").exists()


def form(form: ufl.Form) -> fem.Form:
    """The form of dolfinx for a UFL form whose integrals are over all cells.

    Raises
    ------
    NotImplementedError
        If it has other integrals.
    """
    spaces = [argument.ufl_function_space() for argument in form.arguments()]
    mesh = form.ufl_domain().ufl_cargo()
    tabulate, positions = _generated(form)
    kernel = _Kernel(tabulate, mesh)
    coefficients = [form.coefficients()[i]._cpp_object for i in positions]
    entities, active = np.arange(kernel.cells, dtype=np.int32), np.arange(len(coefficients), dtype=np.int8)
    kernel.form = type_ = cpp.fem.Form_float64(
        [space._cpp_object for space in spaces],
        {fem.IntegralType.cell: [(0, kernel.address, entities, active)]},
        coefficients,
        [constant._cpp_object for constant in form.constants()],
        False,
        [],
        mesh,
    )
    return fem.Form(type_, module=kernel)  # which keeps the kernel alive


def _generated(form: ufl.Form):
    """The Python kernel of a form, and the positions of the coefficients that it reads among those of the form."""
    if form.signature() in _known:
        return _known[form.signature()]
    import ffcx.compiler
    import ffcx.options  # new in 0.11; the documentation imports this module with every version

    options = ffcx.options.get_options({"language": "numba", "scalar_type": np.float64})
    (source,), _ = ffcx.compiler.compile_ufl_objects([form], options, namespace="shells")
    names: dict = {}
    exec(compile(source, "<form>", "exec"), names)  # imports numba and numpy, whose places are then taken
    own = next(names[name] for name in names if name.startswith("form_shells"))
    if len(own.form_integrals) != 1 or own.form_integral_ids != [-1] or own.form_integral_offsets[1] != 1:
        raise NotImplementedError("a C compiler is needed for integrals other than one over all cells")
    _known[form.signature()] = own.form_integrals[0].tabulate_tensor, own.original_coefficient_positions or []
    return _known[form.signature()]


class _Kernel:
    """A kernel that dolfinx calls for the cells of this process in turn.

    Attributes
    ----------
    address : int
        Of the C function.
    cells : int
        Number of cells.
    form : dolfinx.cpp.fem.Form_float64
        The form that it belongs to, which gives the values of coefficients and constants.
    """

    def __init__(self, tabulate, mesh):
        self._tabulate, self._geometry = tabulate, mesh.geometry
        self.cells = mesh.topology.index_map(mesh.topology.dim).size_local
        self._next, self._tensors = 0, np.empty((0, 0))
        self._called = ctypes.CFUNCTYPE(None, *[ctypes.c_void_p] * 7)(self._give)
        self.address = ctypes.cast(self._called, ctypes.c_void_p).value

    def _give(self, tensor, *_):
        """Write the next cell's element tensor."""
        if self._next == 0:
            self._tensors = self._evaluated()
        values = self._tensors[self._next]
        ctypes.memmove(tensor, values.ctypes.data, values.nbytes)
        self._next = (self._next + 1) % self.cells

    def _evaluated(self) -> np.ndarray:
        """The tensors (cells, entries) with the present values of coefficients and constants."""
        points = self._geometry.x[self._geometry.dofmaps[0][: self.cells]].reshape(self.cells, -1)
        constants = cpp.fem.pack_constants(self.form)
        packed = list(cpp.fem.pack_coefficients(self.form).values())
        coefficients = packed[0] if packed else np.empty((self.cells, 0))
        parts = [slice(first, first + CELLS) for first in range(0, self.cells, CELLS)]
        return np.concatenate([self._batch(points[part], coefficients[part], constants) for part in parts])

    def _batch(self, points, coefficients, constants) -> np.ndarray:
        cells, tensors = len(points), []

        def array(given, size):
            if given is None:  # the tensor
                tensors.append(np.zeros((size, cells)))
                return tensors[0]
            return given

        names = self._tabulate.__globals__
        names["numba"] = SimpleNamespace(carray=array)
        names["np"] = _Numpy(cells)
        rows = (np.ascontiguousarray(values.T) for values in (coefficients, points))
        coefficients, points = rows
        self._tabulate(None, coefficients, constants, points, None, None, None)
        return np.ascontiguousarray(tensors[0].T)


class _Numpy:
    """NumPy as a kernel uses it, whose work arrays get an entry for each cell."""

    max_value, min_value = np.maximum, np.minimum  # FFCx's names, which NumPy does not have

    def __init__(self, cells: int):
        self._cells = cells

    def __getattr__(self, name):
        return getattr(np, name)

    def full(self, shape, value, dtype):
        return np.full((*shape, self._cells), value, dtype)
