"""Samples that a method solves together in compiled code."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numba import typeof

__all__ = ["BATCH", "Batch"]


class Batch(NamedTuple):
    """Samples of one problem with d rows a contact.

    Attributes
    ----------
    Q, Y : (n, d m) array
        Displacements without force, and the guess, which receives the forces.
    errors : (n,) array
    iterations, factorisations : (n,) int array
        Added to: passes over all contacts, and those of them that factorised the matrix of the closed contacts.
    """

    Q: np.ndarray
    Y: np.ndarray
    errors: np.ndarray
    iterations: np.ndarray
    factorisations: np.ndarray


BATCH = typeof(Batch(np.empty((0, 0)), np.empty((0, 0)), np.empty(0), np.empty(0, np.int64), np.empty(0, np.int64)))
