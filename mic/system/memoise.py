"""What a function makes of content alone, made once and kept in the cache: dataclasses with arrays in them.

It is kept under a hash of that content, of every line of this program, and of the libraries that compute: whatever
changes, nothing is found, and it is made again. So nothing else may go in: no clock, no file that was not hashed.

What nests is taken apart into a header that JSON holds and a few long arrays. Of a model there are thousands of short
ones; those of one kind lie in one long one, for reading a file of its own would take a tenth of a millisecond each.
Nothing that was kept is ever executed: only the classes that the reader names are made.
"""

from __future__ import annotations

import platform
from collections.abc import Callable, Mapping, Sequence
from dataclasses import fields
from functools import cache
from pathlib import Path
from typing import Any, TypeVar

import numpy as np
import scipy
from scipy.sparse import csr_matrix

from mic.system.disk_cache import Cache
from mic.system.files import fingerprint

__all__ = ["kept", "pack", "program", "unpack"]

T = TypeVar("T")


def kept(
    room: Cache, content: Any, known: Mapping[str, Any], classes: Sequence[type], make: Callable[[], T]
) -> tuple[T, str]:
    """What `make` returns, from the cache where it is there.

    Arrays lie in memory as the cache gives them, whether it had them or not: rounding hangs on that.

    Parameters
    ----------
    room : Cache
    content
        All that the result follows from, JSON-ready.
    known, classes
        As :func:`unpack` takes them; what is known must follow from `content` too.
    make : callable
        What it raises is not caught, and nothing is kept.

    Returns
    -------
    found
    identity : str
        Hash of what it follows from.
    """
    identity = fingerprint([program(), content])
    found = room.find(identity)
    if found is None:
        header, arrays = pack(make(), known)
        room.keep(identity, {"content": header}, arrays)
    else:
        header, arrays = found[0]["content"], found[1]
    return unpack(header, arrays, classes, known), identity


@cache
def program() -> list[str]:
    """This program and what it computes with."""
    sources = sorted(Path(__file__).parents[1].rglob("*.py"))
    own = fingerprint(b"".join(source.read_bytes() for source in sources))
    return [own, np.__version__, scipy.__version__, platform.machine(), platform.python_version()]


def pack(content: Any, known: Mapping[str, Any]) -> tuple[Any, dict[str, np.ndarray]]:
    """Take apart dataclasses, dicts with names as keys, tuples, lists, arrays, CSR matrices and plain values.

    Parameters
    ----------
    content
    known : mapping of str to object
        What the reader has already: told by its name wherever it stands.

    Returns
    -------
    header
        JSON-ready.
    arrays : dict of str to array

    Raises
    ------
    TypeError
        For anything else.
    """
    packer = _Packer({id(one): name for name, one in known.items()})
    header = packer.told(content)
    return header, {kind: np.concatenate(pieces) for kind, pieces in packer.pieces.items()}


def unpack(header: Any, arrays: Mapping[str, np.ndarray], classes: Sequence[type], known: Mapping[str, Any]) -> Any:
    """Put together what :func:`pack` took apart.

    Parameters
    ----------
    header, arrays
        As :func:`pack` gave them.
    classes : sequence of type
        The dataclasses that may be in it.
    known : mapping of str to object
        As :func:`pack` was given.

    Raises
    ------
    KeyError
        For another class, or a name that is not known.
    """
    by_name = {one.__name__: one for one in classes}

    def made(node: Any) -> Any:
        if isinstance(node, list):
            return [made(one) for one in node]
        if not isinstance(node, dict):
            return node
        ((kind, value),) = node.items()
        if kind == "known":
            return known[value]
        if kind == "array":
            dtype, start, shape = value
            return arrays[dtype][start : start + int(np.prod(shape))].reshape(shape)
        if kind == "matrix":
            *parts, shape = (made(one) for one in value)
            return csr_matrix(tuple(parts), shape=tuple(shape))
        if kind == "tuple":
            return tuple(made(one) for one in value)
        if kind == "dict":
            return {name: made(one) for name, one in value.items()}
        return by_name[kind](**{name: made(one) for name, one in value.items()})

    return made(header)


class _Packer:
    """Arrays so far, by kind, and how much there is of each."""

    def __init__(self, known: dict[int, str]) -> None:
        self.pieces: dict[str, list[np.ndarray]] = {}
        self._length: dict[str, int] = {}
        self._known = known

    def told(self, content: Any) -> Any:
        if id(content) in self._known:
            return {"known": self._known[id(content)]}
        if content is None or isinstance(content, (str, bool, int, float)):
            return content
        if isinstance(content, np.generic):
            return content.item()
        if isinstance(content, np.ndarray):
            return {"array": self._array(content)}
        if isinstance(content, csr_matrix):
            return {"matrix": [self.told(one) for one in (content.data, content.indices, content.indptr)] + [
                list(map(int, content.shape))
            ]}  # fmt: skip
        if isinstance(content, tuple):
            return {"tuple": [self.told(one) for one in content]}
        if isinstance(content, list):
            return [self.told(one) for one in content]
        if isinstance(content, dict):
            return {"dict": {name: self.told(one) for name, one in content.items()}}
        own = {field.name: self.told(getattr(content, field.name)) for field in fields(content)}
        return {type(content).__name__: own}

    def _array(self, array: np.ndarray) -> list[Any]:
        if array.dtype.hasobject:
            raise TypeError(f"an array of {array.dtype} cannot be packed")
        kind = array.dtype.str
        start = self._length.get(kind, 0)
        self.pieces.setdefault(kind, []).append(np.ravel(array))
        self._length[kind] = start + array.size
        return [kind, start, list(array.shape)]
