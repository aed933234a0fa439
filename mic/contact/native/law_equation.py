"""The equation of a law and its linearisation, over all contacts of one sample.

Symbols as in :mod:`mic.contact.native.problem`: ``w = W y + q`` with ``y`` the scaled force and ``w`` the scaled
displacement, three entries per contact (n, t1, t2), and ``parameters`` (m, p) the law's, contact by contact, scaled
likewise: friction first. All arrays are float64 and C-contiguous.

Kernels receive a law as the pointer to its compiled equation, so none depends on the laws that exist. Their signatures
are explicit because a function pointer needs one.
"""

from __future__ import annotations

from functools import cache

import numpy as np
from numba import boolean, cfunc, types, void

from mic.contact.native.kernel import BLOCKS, COUNTS, MATRIX, NUMBER, VECTOR, kernel
from mic.contact.states import OPEN, SLIP, STICK

__all__ = [
    "EQUATION_POINTER",
    "compiled",
    "derivative",
    "force_scale",
    "linear_equation",
    "merit",
    "relative",
    "starting_scale",
    "statuses",
]

#: parameters, y, w, Φ, A, B, state, derivative. All contacts in one call: one call for each would make a sample that
#: slips 1.5 times as expensive.
EQUATION = void(MATRIX, VECTOR, VECTOR, VECTOR, BLOCKS, BLOCKS, COUNTS, boolean)
EQUATION_POINTER = types.FunctionType(EQUATION)


@cache
def compiled(equation):
    """A law's equation as the kernels take it; a C callback is passed faster than a jitted function."""
    try:
        return cfunc(EQUATION, cache=True, error_model="numpy")(equation)
    except RuntimeError:  # no folder can be written
        return cfunc(EQUATION, error_model="numpy")(equation)


@kernel(void(EQUATION_POINTER, MATRIX, VECTOR, VECTOR, VECTOR, COUNTS))
def statuses(equation, parameters, y, w, phi, state):
    """Fill the states of all contacts, and the equations ``phi`` of those that slide."""
    nothing = np.empty((0, 3, 3))
    equation(parameters, y, w, phi, nothing, nothing, state, False)


@kernel(NUMBER(EQUATION_POINTER, MATRIX, VECTOR, VECTOR, VECTOR, COUNTS))
def merit(equation, parameters, y, w, phi, state):
    """Fill ``phi`` with all contacts' equations and return its Euclidean norm; ``state`` is scratch."""
    statuses(equation, parameters, y, w, phi, state)
    total = 0.0
    for k in range(len(state)):
        i = 3 * k
        if state[k] == OPEN:
            phi[i], phi[i + 1], phi[i + 2] = y[i], y[i + 1], y[i + 2]
        elif state[k] == STICK:
            phi[i], phi[i + 1], phi[i + 2] = w[i], w[i + 1], w[i + 2]
        total += phi[i] * phi[i] + phi[i + 1] * phi[i + 1] + phi[i + 2] * phi[i + 2]
    return np.sqrt(total)


@kernel(void(MATRIX, MATRIX, NUMBER))
def linear_equation(A, B, open_):
    """Fill the derivatives of ``Φ = y`` (`open_` 1) or of ``Φ = w`` (0: stick) of one contact, both (3, 3)."""
    for row in range(3):
        for column in range(3):
            A[row, column] = B[row, column] = 0.0
        A[row, row], B[row, row] = open_, 1.0 - open_


@kernel(void(EQUATION_POINTER, MATRIX, VECTOR, VECTOR, VECTOR, BLOCKS, BLOCKS, COUNTS), from_python=True)
def derivative(equation, parameters, y, w, phi, A, B, state):
    """Fill all contacts' equations, their derivatives and states.

    Open: ``Φ = y``, ``A = I``, ``B = 0``; stick: ``Φ = w``, ``A = 0``, ``B = I``; slip: the law's.
    """
    equation(parameters, y, w, phi, A, B, state, True)
    for k in range(len(state)):
        i = 3 * k
        if state[k] == SLIP:
            continue
        open_, z = (1.0, y) if state[k] == OPEN else (0.0, w)
        phi[i], phi[i + 1], phi[i + 2] = z[i], z[i + 1], z[i + 2]
        linear_equation(A[k], B[k], open_)


@kernel(NUMBER(NUMBER, VECTOR, VECTOR, VECTOR), from_python=True)
def force_scale(scale, q, y, w):
    """What errors are relative to, as in the certificate: the larger of ``scale`` and ``(yᵀ W y)^{1/2}``."""
    energy = 0.0
    rounding = 0.0
    for i in range(len(q)):
        energy += y[i] * (w[i] - q[i])
        rounding += y[i] * y[i]
    energy -= 1e-15 * len(q) * rounding
    return max(scale, np.sqrt(max(energy, 0.0)))


@kernel(NUMBER(NUMBER, NUMBER))
def relative(error, size):
    """``error / size``; beside nothing no error is none, and any other is beyond all bounds."""
    if size > 0.0:
        return error / size
    return 0.0 if error == 0.0 else np.inf


@kernel(NUMBER(VECTOR), from_python=True)
def starting_scale(q):
    """Norm of ``Φ`` at ``y = 0``: the force with which each overlapping contact alone would answer ``q``."""
    total = 0.0
    for i in range(0, len(q), 3):
        if q[i] < 0.0:
            total += q[i] * q[i]
    return np.sqrt(total)
