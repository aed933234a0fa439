"""The linear problem of a linearised step, and products with slopes."""

from __future__ import annotations

import numpy as np
from numba import int64

from mic.contact.native.kernel import COUNTS, MATRIX, VECTOR, kernel
from mic.contact.native.lapack import least_squares, solution
from mic.contact.native.linearised_law import CONTACTS
from mic.contact.native.matrices import assign

__all__ = ["bent", "moved", "solved"]

#: Forces of contacts that hold each other are not unique, their displacements are.
HYPERSTATIC, UNSOLVED = 1e-11, 1e-9


@kernel(MATRIX(MATRIX, MATRIX))
def solved(matrix, right):
    """A linear system; where contacts hold each other, the least forces."""
    size = np.abs(right).max() if right.size else 0.0
    if size == 0.0:
        return np.zeros_like(right)
    found = solution(np.ascontiguousarray(matrix.T), right)
    worst = np.abs(np.dot(matrix, found) - right).max()
    if worst <= UNSOLVED * size:
        return found
    return least_squares(matrix, right, HYPERSTATIC)


@kernel(MATRIX(MATRIX, COUNTS, int64, COUNTS, MATRIX))
def moved(S, rows, size, loaded, F):
    """(r, p) some rows of ``S F``, F the slopes of the forces of the contacts ``loaded`` and zero elsewhere."""
    columns = np.empty((len(rows), size * len(loaded)))
    force = np.empty((size * len(loaded), F.shape[1]))
    for b in range(len(loaded)):
        for c in range(size):
            assign(force[size * b + c], F[size * loaded[b] + c])
    for a in range(len(rows)):
        line = S[rows[a]]
        for b in range(len(loaded)):
            for c in range(size):
                columns[a, size * b + c] = line[size * loaded[b] + c]
    return np.dot(columns, force)


@kernel(MATRIX(CONTACTS, VECTOR))
def bent(contacts, force):
    """(d m, p) ``dS f`` of each input."""
    left, right, inputs = contacts.left, contacts.right, contacts.inputs
    found = np.zeros((len(force), contacts.rougher.shape[1]))
    for i in range(len(inputs)):
        share = 0.0
        for j in range(len(force)):
            share += right[i, j] * force[j]
        for j in range(len(force)):
            found[j, inputs[i]] += share * left[i, j]
    return found
