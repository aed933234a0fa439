"""An order of elimination that keeps factors small: nested dissection, by METIS.

Freedoms whose rows of the matrix have the same pattern, the six of a vertex or the three of an edge, are one node of
the graph that is dissected.
"""

from __future__ import annotations

import ctypes
import ctypes.util
from functools import cache
from typing import Any

import numpy as np
from scipy.sparse import csr_matrix

__all__ = ["nested_dissection"]

_OK = 1  # METIS_OK


def nested_dissection(pattern: csr_matrix) -> np.ndarray | None:
    """(m,) the place of each row in the order of elimination, from 0; None where there is no METIS.

    `pattern` (m, m) has the entries of a symmetric matrix on and above its diagonal, which is full; none below it.
    """
    metis = _metis()
    if metis is None:
        return None
    node, graph = _condensed(pattern)
    size, n = np.bincount(node).astype(np.int32), graph.shape[0]
    order, place = np.empty(n, dtype=np.int32), np.empty(n, dtype=np.int32)
    arrays = [a.ctypes.data for a in (graph.indptr, graph.indices, size)]
    if metis(ctypes.byref(ctypes.c_int32(n)), *arrays, None, order.ctypes.data, place.ctypes.data) != _OK:
        return None
    rows = np.argsort(place[node], kind="stable")
    places = np.empty(len(node), dtype=np.int32)
    places[rows] = np.arange(len(node), dtype=np.int32)
    return places


def _condensed(pattern: csr_matrix) -> tuple[np.ndarray, csr_matrix]:
    """The node (m,) of each row, and the nodes' graph without loops, 32-bit integers."""
    m = pattern.shape[0]
    # rows of one pattern have one sum of random keys, their own among them; sums of others agree once in 2^64 / m²
    key = np.random.default_rng(0).integers(2**64, size=m, dtype=np.uint64)
    entries = csr_matrix((np.ones(pattern.nnz, dtype=np.uint64), pattern.indices, pattern.indptr), pattern.shape)
    total = entries @ key + entries.T @ key - key
    _, first, node = np.unique(total, return_index=True, return_inverse=True)
    first_of_node = np.zeros(m, dtype=bool)
    first_of_node[first] = True
    rows = pattern[first]
    row, column = np.repeat(np.arange(len(first)), np.diff(rows.indptr)), rows.indices
    shown = first_of_node[column]
    row, column = row[shown], node[column[shown]]
    row, column = row[row != column], column[row != column]
    ends = np.concatenate([row, column]), np.concatenate([column, row])
    graph = csr_matrix((np.ones(len(ends[0]), dtype=np.int8), ends), shape=(len(first), len(first)))
    indices, starts = graph.indices.astype(np.int32), graph.indptr.astype(np.int32)
    return node, csr_matrix((graph.data, indices, starts), graph.shape)


@cache
def _metis() -> Any:
    """METIS_NodeND, or None: no METIS, or one whose integers are not of 32 bits."""
    try:
        function = ctypes.CDLL(ctypes.util.find_library("metis")).METIS_NodeND
    except (OSError, AttributeError, TypeError):  # the last: no library was found, and None is no name
        return None
    function.argtypes = [ctypes.c_void_p] * 7
    # one node and no edge: an integer of 64 bits would clear the second place of 32 as well
    one, none = np.array([1, 0], dtype=np.int32), np.zeros(4, dtype=np.int32)
    order, place = np.full(4, -1, dtype=np.int32), np.full(4, -1, dtype=np.int32)
    status = function(*(a.ctypes.data for a in (one, none, none)), None, None, order.ctypes.data, place.ctypes.data)
    return function if status == _OK and place.tolist() == [0, -1, -1, -1] else None
