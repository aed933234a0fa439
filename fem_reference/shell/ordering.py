"""Fill-reducing elimination order: nested dissection by METIS.

Freedoms with the same row pattern (the six of a vertex, the three of an edge) form one node of the graph.
"""

from __future__ import annotations

import ctypes
from functools import cache
from typing import Any

import numpy as np
from petsc4py import PETSc
from scipy.sparse import csr_matrix

__all__ = ["nested_dissection"]

_OK = 1  # METIS_OK


def nested_dissection(pattern: csr_matrix) -> np.ndarray | None:
    """(m,) position of each row in the elimination order, from 0; None if PETSc has no METIS.

    `pattern` (m, m) is the upper triangle of a symmetric matrix, with a full diagonal.
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
    """Graph node (m,) of each row, and the graph without loops, in 32-bit integers."""
    m = pattern.shape[0]
    # rows of equal pattern have equal sums of random keys; others agree by chance with probability m² / 2^64
    key = np.random.default_rng(0).integers(2**64, size=m, dtype=np.uint64)
    entries = csr_matrix((np.ones(pattern.nnz, dtype=np.uint64), pattern.indices, pattern.indptr), pattern.shape)
    total = entries @ key + entries.T @ key - key
    _, first, node = np.unique(total, return_index=True, return_inverse=True)
    first_of_node = np.zeros(m, dtype=bool)
    first_of_node[first] = True
    rows = pattern[first]
    row, column = np.repeat(np.arange(len(first)), np.diff(rows.indptr)), rows.indices
    representative = first_of_node[column]
    row, column = row[representative], node[column[representative]]
    row, column = row[row != column], column[row != column]
    ends = np.concatenate([row, column]), np.concatenate([column, row])
    graph = csr_matrix((np.ones(len(ends[0]), dtype=np.int8), ends), shape=(len(first), len(first)))
    indices, starts = graph.indices.astype(np.int32), graph.indptr.astype(np.int32)
    return node, csr_matrix((graph.data, indices, starts), graph.shape)


@cache
def _metis() -> Any:
    """METIS_NodeND of the METIS that PETSc has loaded; None if there is none or its integers do not have 32 bits."""
    try:
        function = ctypes.CDLL(PETSc.__file__).METIS_NodeND  # symbols are looked up in its dependencies as well
    except (OSError, AttributeError):
        return None
    function.argtypes = [ctypes.c_void_p] * 7
    # a graph of one node: METIS with 64-bit integers would overwrite the second 32-bit entry too
    one, none = np.array([1, 0], dtype=np.int32), np.zeros(4, dtype=np.int32)
    order, place = np.full(4, -1, dtype=np.int32), np.full(4, -1, dtype=np.int32)
    status = function(*(a.ctypes.data for a in (one, none, none)), None, None, order.ctypes.data, place.ctypes.data)
    return function if status == _OK and place.tolist() == [0, -1, -1, -1] else None
