"""Compiled functions in several modules: compiled, or read from the cache, at the first call.

A kernel has one signature. Its cache is valid as long as no source of this package changes: Numba would compare only
the file of the kernel itself, not those of the kernels that it calls. Importing a module compiles and loads nothing,
and a kernel that is loaded loads those that it calls.

A kernel calls another one, as functions of a library call each other. Numba would copy the code of the callee into each
caller, so that what stands at the bottom would be optimised again for all that stand above it. Only kernels that Python
calls have the wrapper that unpacks its arguments: wrappers for all would take a fifth of the compilation.
"""

from __future__ import annotations

import hashlib
from collections.abc import Callable
from copy import copy
from functools import cache
from pathlib import Path

from numba import boolean, float64, int64
from numba.core import caching
from numba.core.codegen import ll
from numba.core.compiler_lock import global_compiler_lock
from numba.core.registry import CPUDispatcher

from mic.contact import states

__all__ = ["BLOCKS", "COUNTS", "MASK", "MATRIX", "NUMBER", "VECTOR", "Kernel", "kernel"]

NUMBER, VECTOR, MATRIX, BLOCKS = float64, float64[::1], float64[:, ::1], float64[:, :, ::1]
COUNTS, MASK = int64[::1], boolean[::1]


@cache
def _package_stamp() -> bytes:
    """Hash of all sources that kernels are compiled from."""
    digest = hashlib.sha256()
    for path in [*sorted(Path(__file__).parent.glob("*.py")), Path(states.__file__)]:
        digest.update(path.name.encode() + path.read_bytes())
    return digest.digest()


class _Stamped:
    def get_source_stamp(self) -> bytes:
        return _package_stamp()


class _Provided(_Stamped, caching.UserProvidedCacheLocator): ...


class _InTree(_Stamped, caching.InTreeCacheLocator): ...


class _UserWide(_Stamped, caching.UserWideCacheLocator): ...


class _CacheFiles(caching.CompileResultCacheImpl):
    _locator_classes = [_Provided, _InTree, _UserWide]


class _PackageCache(caching.FunctionCache):
    _impl_class = _CacheFiles

    def load_overload(self, sig, target_context):
        try:
            return super().load_overload(sig, target_context)
        except (AttributeError, ImportError):  # left by a version whose types are gone
            self.flush()
            return None


class Kernel(CPUDispatcher):
    """A compiled function of one signature, which other kernels call, and Python if ``from_python`` is set."""

    def __init__(self, function: Callable, signature, from_python: bool):
        options = {"nopython": True, "nogil": True, "error_model": "numpy", "no_cfunc_wrapper": True}
        super().__init__(function, targetoptions={**options, "no_cpython_wrapper": not from_python})
        self._signature, self._from_python = signature, from_python

    @property
    def called(self) -> list[Kernel]:
        """The kernels that this one calls."""
        found = (self.py_func.__globals__.get(name) for name in self.__code__.co_names)
        return [value for value in found if isinstance(value, Kernel)]

    def load(self) -> None:
        """Read the function from the cache, or compile it, unless that is done."""
        with global_compiler_lock:
            if not self._can_compile:
                return
            for kernel in self.called:
                kernel.load()
            try:
                self._cache = _PackageCache(self.py_func)
            except RuntimeError:  # no folder can be written: each process compiles anew
                pass
            self.compile(self._signature)
            self.disable_compile()
            self._replace_by_symbol()

    def _replace_by_symbol(self) -> None:
        """Let callers refer to the function by its name, which no process changes, and do without its code."""
        (compiled,) = self.overloads.values()
        description = copy(compiled.fndesc)
        description.mangled_name = f"{self.__module__}.{self.__qualname__}"
        ll.add_symbol(
            description.mangled_name, compiled.library.get_pointer_to_function(compiled.fndesc.llvm_func_name)
        )
        self.targetctx.remove_user_function(compiled.entry_point)
        self.targetctx.insert_user_function(compiled.entry_point, description)

    def add_overload(self, compiled):
        if self._from_python:
            super().add_overload(compiled)
        else:  # a call from Python would jump to a wrapper that is not there
            self.overloads[tuple(compiled.signature.args)] = compiled

    def _compile_for_args(self, *arguments):  # at the first call: what Numba calls instead
        if not self._from_python:
            self._explain_matching_error(*arguments)
        self.load()
        return self

    def _explain_matching_error(self, *arguments):  # called if no overload fits
        if not self._from_python:
            raise TypeError(f"only kernels call {self.__qualname__}; Python may if its @kernel has from_python=True")
        super()._explain_matching_error(*arguments)

    def get_call_template(self, args, kws):  # when a caller is compiled
        self.load()
        return super().get_call_template(args, kws)


def kernel(signature, from_python: bool = False) -> Callable[[Callable], Kernel]:
    """Decorator that makes a function a :class:`Kernel`."""
    return lambda function: Kernel(function, signature, from_python)
