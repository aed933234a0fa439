"""One increment of samples that each have their own contacts, out of many candidates."""

from __future__ import annotations

import numpy as np
from numba import boolean, int64, types, void

from mic.contact.native.follower import follow
from mic.contact.native.kernel import BLOCKS, COUNTS, MATRIX, NUMBER, VECTOR, kernel
from mic.contact.native.law_equation import EQUATION_POINTER
from mic.contact.native.matrices import assign, block

__all__ = ["follow_among"]

#: Sweeps where a forecast of the forces is what they begin with: they do what thirty do from the forces before.
FORECAST = 10


@kernel(
    void(
        EQUATION_POINTER,
        MATRIX,
        MATRIX,
        MATRIX,
        VECTOR,
        COUNTS,
        COUNTS,
        NUMBER,
        int64,
        BLOCKS,
        MATRIX,
        BLOCKS,
        types.Array(boolean, 2, "C"),
        MATRIX,
        boolean,
        MATRIX,
        MATRIX,
        BLOCKS,
        BLOCKS,
        MATRIX,
        MATRIX,
        BLOCKS,
        types.Array(int64, 2, "C"),
    )
)
def follow_among(
    equation,
    W,
    P,
    parameters,
    D,
    among,
    some,
    tol,
    sweeps,
    b,
    force,
    anchor,
    working,
    guess,
    near,
    found,
    Q,
    L,
    slip,
    length,
    work,
    share,
    counts,
):
    """One step of first order of samples, each with the contacts of its own working set alone.

    As :func:`follow` with one sample at a time and what :func:`block` takes of W; but loads, forces and all that is
    found are those of a batch over all contacts, in mm and N, of which W has some.

    Parameters
    ----------
    D : (3k,) array
        Units of the scaled forces of W's contacts.
    among, some : (k,), (l,) int array
        Numbers of W's contacts among all m, and of the samples in the batch.
    b, force, anchor : (n, 2, 3m), (n, 3m), (n, m, 2) array
        Loads, and forces and anchors at the start.
    working : (n, m) bool array
    guess : (n, 3m) array
        Of the forces at the end, for samples that have any: taken as it is where it is ``near``, else as a
        forecast, with which few sweeps begin.
    found, Q, L, slip, length, work, share : (n, 3m), (n, 3m), (n, m, 2), (n, m, 2), (n, m), (n, m), (n, m, 3) array
        Receive forces, the right-hand side, anchors and what :class:`mic.contact.path.Trace` holds, of the contacts
        of the working sets; the others are not touched.
    counts : (n, 5) int array
    """
    at_end, none, nothing = np.ones(1), np.empty((1, 0)), np.empty((1, 0, 0))
    sums = np.zeros((1, 2))
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
        follow(
            equation,
            block(W, own, 3),
            some_P,
            some_parameters,
            unit,
            q0,
            q1,
            anchors,
            y,
            1,
            at_end,
            0.0,
            0.0,
            0.0,
            tol,
            min(sweeps, FORECAST) if guessed and not near else sweeps,
            q,
            slips,
            lengths,
            works,
            shares,
            sums,
            done,
            none,
            nothing,
            start if guessed else start[:0],
            near,
        )
        for a in range(m):
            k = among[own[a]]
            i, j = 3 * a, 3 * k
            length[s, k], work[s, k] = lengths[0, a] * unit[3 * a + 1], works[0, a]
            for c in range(3):
                d = D[3 * own[a] + c]
                found[s, j + c], Q[s, j + c], share[s, k, c] = y[0, i + c] * d, q[0, i + c] / d, shares[0, a, c]
            for c in range(2):
                L[s, k, c], slip[s, k, c] = (
                    anchors[0, 2 * a + c] * unit[3 * a + 1],
                    slips[0, a, c] * unit[3 * a + 1],
                )
