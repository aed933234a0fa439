"""Memoisation on disk: results stored under a hash of their inputs and of the program.

The hash covers the inputs, the source code of this program and the versions of its numerical libraries. A memoised
computation may depend on nothing else, such as the time or files that are not hashed.

Nested data are split into a JSON header and a few long arrays: a model has thousands of short arrays, and reading each
from a file of its own would take 0.1 ms. Loading creates only the classes that the reader names and executes no
content, unlike ``joblib.Memory``, which unpickles.
"""

from __future__ import annotations

import functools
import logging
import platform
from collections.abc import Callable, Mapping, Sequence
from dataclasses import fields
from pathlib import Path
from typing import Any, TypeVar

import numpy as np
import scipy
from scipy.sparse import csr_matrix

from mic.errors import FormatError
from mic.system.disk_cache import Cache
from mic.system.files import fingerprint, reading

__all__ = ["memoise", "pack", "program", "unpack"]

T = TypeVar("T")

_log = logging.getLogger(__name__)


def memoise(
    cache: Cache, inputs: Any, known: Mapping[str, Any], classes: Sequence[type], compute: Callable[[], T]
) -> tuple[T, str]:
    """Result of `compute`, from the disk cache if it is there.

    The arrays have the memory layout of the cached file in either case, since rounding depends on it.

    Parameters
    ----------
    cache : Cache
    inputs
        Everything that the result depends on, JSON-ready.
    known, classes
        As for :func:`unpack`; known objects must depend on `inputs` only.
    compute : callable
        Its exceptions propagate, and nothing is cached then.

    Returns
    -------
    result
    identity : str
        Hash of the inputs and of the program.
    """
    identity = fingerprint([program(), inputs])
    cached = cache.load(identity)
    if cached is not None:
        try:
            with reading(cache.path(identity), cache.format):
                return unpack(cached[0]["content"], cached[1], classes, known), identity
        except FormatError as problem:
            _log.warning("%s", problem)
    header, arrays = pack(compute(), known)
    cache.store(identity, {"content": header}, arrays)
    return unpack(header, arrays, classes, known), identity


@functools.cache
def program() -> list[str]:
    """Hash of the code and tables of this program, versions of numpy, of Python, and the processor architecture."""
    sources = sorted(path for kind in ("*.py", "*.toml") for path in Path(__file__).parents[1].rglob(kind))
    code = fingerprint(b"".join(source.read_bytes() for source in sources))
    return [code, np.__version__, scipy.__version__, platform.machine(), platform.python_version()]


def pack(content: Any, known: Mapping[str, Any]) -> tuple[Any, dict[str, np.ndarray]]:
    """Split nested data into a JSON-ready header and a few long arrays, one for each dtype.

    Parameters
    ----------
    content
        Dataclasses, dicts with string keys, tuples, lists, arrays, CSR matrices and plain values.
    known : mapping of str to object
        Objects that the reader has already; only their names are stored.

    Raises
    ------
    TypeError
        For any other content.
    """
    packer = _Packer({id(value): name for name, value in known.items()})
    header = packer.header(content)
    return header, {dtype: np.concatenate(pieces) for dtype, pieces in packer.pieces.items()}


def unpack(header: Any, arrays: Mapping[str, np.ndarray], classes: Sequence[type], known: Mapping[str, Any]) -> Any:
    """Restore what :func:`pack` has split.

    Parameters
    ----------
    header, arrays
        As :func:`pack` returned them.
    classes : sequence of type
        The dataclasses that the content may hold.
    known : mapping of str to object
        As for :func:`pack`.

    Raises
    ------
    Exception
        Of any type, for another class, an unknown name, or content that :func:`pack` did not write.
    """
    by_name = {allowed.__name__: allowed for allowed in classes}

    def restore(node: Any) -> Any:
        if isinstance(node, list):
            return [restore(item) for item in node]
        if not isinstance(node, dict):
            return node
        ((kind, value),) = node.items()
        if kind == "known":
            return known[value]
        if kind == "array":
            dtype, start, shape = value
            return arrays[dtype][start : start + int(np.prod(shape))].reshape(shape)
        if kind == "matrix":
            *parts, shape = restore(value)
            matrix = csr_matrix(tuple(parts), shape=tuple(shape))
            matrix.check_format()  # compiled code does not check indices
            return matrix
        if kind == "tuple":
            return tuple(restore(value))
        if kind == "dict":
            return {name: restore(item) for name, item in value.items()}
        return by_name[kind](**{name: restore(item) for name, item in value.items()})

    return restore(header)


class _Packer:
    """Collects arrays by dtype, and the length of each collection."""

    def __init__(self, known: dict[int, str]) -> None:
        self.pieces: dict[str, list[np.ndarray]] = {}
        self._length: dict[str, int] = {}
        self._known = known

    def header(self, content: Any) -> Any:
        if id(content) in self._known:
            return {"known": self._known[id(content)]}
        if content is None or isinstance(content, (str, bool, int, float)):
            return content
        if isinstance(content, np.generic):
            return content.item()
        if isinstance(content, np.ndarray):
            return {"array": self._array(content)}
        if isinstance(content, csr_matrix):
            return {
                "matrix": self.header([content.data, content.indices, content.indptr, list(map(int, content.shape))])
            }
        if isinstance(content, tuple):
            return {"tuple": self.header(list(content))}
        if isinstance(content, list):
            return [self.header(item) for item in content]
        if isinstance(content, dict):
            return {"dict": {name: self.header(item) for name, item in content.items()}}
        return {
            type(content).__name__: {field.name: self.header(getattr(content, field.name)) for field in fields(content)}
        }

    def _array(self, array: np.ndarray) -> list[Any]:
        if array.dtype.hasobject:
            raise TypeError(f"an array of {array.dtype} cannot be packed")
        dtype = array.dtype.str
        start = self._length.get(dtype, 0)
        self.pieces.setdefault(dtype, []).append(np.ravel(array))
        self._length[dtype] = start + array.size
        return [dtype, start, list(array.shape)]
