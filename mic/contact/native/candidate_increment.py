"""One increment of samples that each have their own contacts, out of many candidates."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numba import boolean, int64, types, void

from mic.contact.native.follower import follow
from mic.contact.native.kernel import BLOCKS, COUNTS, MATRIX, VECTOR, kernel
from mic.contact.native.law_equation import EQUATION_POINTER
from mic.contact.native.matrices import assign, block
from mic.contact.native.step_data import CONTROL, Control, Outcome, PathProblem, Record

__all__ = ["Found", "Samples", "SolverContacts", "follow_among"]

#: Sweeps where a forecast of the forces is what they begin with: they do what thirty do from the forces before.
FORECAST = 10


class SolverContacts(NamedTuple):
    """The k contacts of a solver, among all m.

    Attributes
    ----------
    W, P, parameters : (3k, 3k), (k, 7), (k, p) array
        As :class:`mic.contact.native.step_data.PathProblem` has them; the law's equation is no attribute, because Numba
        finds the type of a tuple with a function in it a hundred times as slowly as of one with arrays.
    D : (3k,) array
        Units of the scaled forces.
    among : (k,) int array
        Their numbers.
    """

    W: np.ndarray
    P: np.ndarray
    parameters: np.ndarray
    D: np.ndarray
    among: np.ndarray


class Samples(NamedTuple):
    """Samples before an increment, over all m contacts, in mm and N.

    Attributes
    ----------
    b, force, anchor : (n, 2, 3m), (n, 3m), (n, m, 2) array
        Loads, and forces and anchors at the start.
    working : (n, m) bool array
    guess : (n, 3m) array
        Of the forces at the end, for samples that have any.
    """

    b: np.ndarray
    force: np.ndarray
    anchor: np.ndarray
    working: np.ndarray
    guess: np.ndarray


class Found(NamedTuple):
    """What an increment fills: forces, right-hand side, anchors and what :class:`mic.contact.path.Trace` holds.

    (n, 3m), (n, 3m), (n, m, 2), (n, m, 2), (n, m), (n, m), (n, m, 3) arrays, of the contacts of the working sets; the
    others are not touched.
    """

    force: np.ndarray
    q: np.ndarray
    anchor: np.ndarray
    slip: np.ndarray
    length: np.ndarray
    work: np.ndarray
    share: np.ndarray


SOLVER_CONTACTS = types.NamedTuple([MATRIX, MATRIX, MATRIX, VECTOR, COUNTS], SolverContacts)
SAMPLES = types.NamedTuple([BLOCKS, MATRIX, BLOCKS, types.Array(boolean, 2, "C"), MATRIX], Samples)
FOUND = types.NamedTuple([MATRIX, MATRIX, BLOCKS, BLOCKS, MATRIX, MATRIX, BLOCKS], Found)


@kernel(
    void(EQUATION_POINTER, SOLVER_CONTACTS, COUNTS, CONTROL, SAMPLES, boolean, FOUND, types.Array(int64, 2, "C")),
    from_python=True,
)
def follow_among(equation, contacts, some, control, samples, near, found, counts):
    """One step of first order of samples, each with the contacts of its own working set alone.

    As :func:`follow` with one sample at a time and what :func:`block` takes of W; but loads, forces and all that is
    found are those of a batch over all contacts, in mm and N.

    Parameters
    ----------
    some : (l,) int array
        Numbers of the samples in the batch.
    near : bool
        Whether the guess is taken as it is; else it is a forecast, with which few sweeps begin.
    counts : (n, 3) int array
    """
    W, P, parameters, D, among = contacts
    b, force, anchor, working, guess = samples
    forces, Q, L, slip, length, work, share = found
    none, nothing, sums = np.empty((1, 0)), np.empty((1, 0, 0)), np.zeros((1, 2))
    for s in some:
        own = np.flatnonzero(working[s][among])
        m, done = len(own), counts[s : s + 1]
        some_P, some_parameters = np.empty((m, P.shape[1])), np.empty((m, parameters.shape[1]))
        size = 1, 3 * m
        q0, q1, y, start, q = np.empty(size), np.empty(size), np.empty(size), np.empty(size), np.zeros(size)
        anchors, unit = np.empty((1, 2 * m)), np.empty(3 * m)
        guessed = False
        for a in range(m):
            k = own[a]
            i, j = 3 * a, 3 * among[k]
            assign(some_P[a], P[k])
            assign(some_parameters[a], parameters[k])
            for c in range(3):
                d = D[3 * k + c]
                unit[i + c] = 1.0 / d
                q0[0, i + c], q1[0, i + c] = b[s, 0, j + c] * d, b[s, 1, j + c] * d
                y[0, i + c], start[0, i + c] = force[s, j + c] / d, guess[s, j + c] / d
                guessed = guessed or guess[s, j + c] != 0.0
            for c in range(2):
                anchors[0, 2 * a + c] = anchor[s, among[k], c] * D[3 * k + 1]
        slips, lengths, works, shares = np.zeros((1, m, 2)), np.zeros((1, m)), np.zeros((1, m)), np.zeros((1, m, 3))
        own_problem = PathProblem(equation, block(W, own, 3), some_P, some_parameters, unit)
        sweeps = min(control.sweeps, FORECAST) if guessed and not near else control.sweeps
        step = Control(control.order, control.ends, 0.0, 0.0, 0.0, control.tol, sweeps)
        outcome = Outcome(q, Record(slips, lengths, works, shares), sums, done, none, nothing)
        follow(own_problem, (q0, q1), step, anchors, y, outcome, start if guessed else start[:0], near)
        for a in range(m):
            k = among[own[a]]
            i, j = 3 * a, 3 * k
            length[s, k], work[s, k] = lengths[0, a] * unit[3 * a + 1], works[0, a]
            for c in range(3):
                d = D[3 * own[a] + c]
                forces[s, j + c], Q[s, j + c], share[s, k, c] = y[0, i + c] * d, q[0, i + c] / d, shares[0, a, c]
            for c in range(2):
                L[s, k, c], slip[s, k, c] = (
                    anchors[0, 2 * a + c] * unit[3 * a + 1],
                    slips[0, a, c] * unit[3 * a + 1],
                )
