"""Data of the kernels of a path: problem, aim of a solution, arrays, predictions, last linear problem, records."""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np
from numba import boolean, int64, types

from mic.contact.native.kept_factors import FACTORS, Factors
from mic.contact.native.kernel import BLOCKS, COUNTS, MATRIX, NUMBER, VECTOR
from mic.contact.native.law_equation import EQUATION_POINTER

__all__ = [
    "AIM",
    "CONTROL",
    "LAST_PROBLEM",
    "OUTCOME",
    "PATH_PROBLEM",
    "PREDICTION",
    "RECORD",
    "RECORDS",
    "WORKSPACE",
    "Aim",
    "Control",
    "LastProblem",
    "Outcome",
    "PathProblem",
    "Prediction",
    "Record",
    "Workspace",
]


class PathProblem(NamedTuple):
    """Contacts under a law, scaled.

    Attributes
    ----------
    equation : pointer
        Of the law (:mod:`mic.contact.native.law_equation`).
    W : (3m, 3m) array
    P : (m, 7) array
        Factors of each contact for the sweeps.
    parameters : (m, p) array
        The law's.
    unit : (3m,) array
        Length of a unit of ``w``; a unit of ``y`` is its reciprocal.
    """

    equation: Any
    W: np.ndarray
    P: np.ndarray
    parameters: np.ndarray
    unit: np.ndarray


class Control(NamedTuple):
    """How a path is followed.

    Attributes
    ----------
    order : {1, 2}
        1 for backward Euler's method as it is: neither prediction nor shifts, and no estimate.
    ends : (k,) array
        Where steps end, in shares of the path, the last at 1; none for steps of controlled error.
    tolerance, least, bearable : float
        A step's error in positions may be the first share of the tangential motion so far, or of the length ``least``
        if that is larger; in forces ``bearable`` times the largest so far or at the end of the path if those that press
        go on: all root mean square over the contacts.
    tol : float
        Newton's tolerance at the end.
    sweeps : int
        Of Gauss-Seidel, where Newton needs help; 0 if they are not the law's.
    """

    order: int
    ends: np.ndarray
    tolerance: float
    least: float
    bearable: float
    tol: float
    sweeps: int


class Aim(NamedTuple):
    """What a solution must reach, and how.

    Attributes
    ----------
    tol, scale : float
        Tolerance of the residual, relative to the force ``scale``.
    sweeps, calls : int
        Of Gauss-Seidel, and calls for help before the problem is given up.
    near : bool
        Whether the guess is near the solution.
    current : bool
        Whether the linear problem has the statuses of the solution in any case, however it was found.
    """

    tol: float
    scale: float
    sweeps: int
    calls: int
    near: bool
    current: bool


class Workspace(NamedTuple):
    """Arrays that every step uses.

    Attributes
    ----------
    y0, w0 : (3m,) array
        Forces and displacements where the step starts, ``w_t = 0``.
    y, w, q, state : (3m,), (3m,), (3m,), (m,) array
        The solution, its right-hand side and its statuses.
    yp, wp : (3m,) array
        The predicted end.
    shift, other : (m, 2) array
        Where slip is measured from: as solved, and as the solution would have it.
    late : (m,) array
        Share of the step after which contacts touch.
    pace : (m,) array
        Slip that is expected of sliders, over the whole path; 0 if nothing is.
    doubt, phi : (3m,) array
        Scratch.
    """

    y0: np.ndarray
    w0: np.ndarray
    y: np.ndarray
    w: np.ndarray
    q: np.ndarray
    state: np.ndarray
    yp: np.ndarray
    wp: np.ndarray
    shift: np.ndarray
    other: np.ndarray
    late: np.ndarray
    pace: np.ndarray
    doubt: np.ndarray
    phi: np.ndarray


class Prediction(NamedTuple):
    """Where a step leads with statuses held.

    Attributes
    ----------
    state, e : (m,), (m, 2) array
        Statuses of the start, and directions of sliders.
    grip, loose : (m,) array
        ‖y_t‖ of sliders when they begin to slide, and the share of the step after which they do: 0 for those that slide
        at its start, 1 for those that do not slide.
    x, motion : (3m,) array
        Changes of forces and displacements.
    opened, gone : (m,), (m, 2) array
        The share of the step after which a contact opens, 1 if it does not, and its tangential motion until then.
    """

    state: np.ndarray
    e: np.ndarray
    grip: np.ndarray
    loose: np.ndarray
    x: np.ndarray
    motion: np.ndarray
    opened: np.ndarray
    gone: np.ndarray


class LastProblem(NamedTuple):
    """The linear problem that was solved last.

    Attributes
    ----------
    state, stretch : (m,) array
        Statuses, and how many times tangential displacements count.
    A, B : (m, 3, 3) array
        The equations.
    own : (c,) int array
        The contacts that it is over, none if there was none.
    inverse : (3c, 3c) array
        None of many contacts, which have factors.
    factors : Factors
    """

    state: np.ndarray
    stretch: np.ndarray
    A: np.ndarray
    B: np.ndarray
    own: np.ndarray
    inverse: np.ndarray
    factors: Factors


class Record(NamedTuple):
    """What :class:`mic.contact.path.Trace` holds, lengths scaled: slip under load and its length, work, shares.

    Of a sample (m, 2), (m,), (m,) and (m, 3) arrays; of a batch with n before.
    """

    slip: np.ndarray
    length: np.ndarray
    work: np.ndarray
    share: np.ndarray


class Outcome(NamedTuple):
    """What a batch of n paths fills.

    Attributes
    ----------
    q : (n, 3m) array
        The right-hand side of the last step: what the certificate is measured against.
    record : Record
    sums : (n, 2) array
        Sums of the steps' errors, in positions and in forces, N.
    counts : (n, 3) int array
        Columns as in :mod:`mic.contact.native.path_constants`.
    passed, passed_force : (n, k), (n, k, 3m) array
        Where the first k steps end, and the forces there; of second order from the start on, at 0.
    """

    q: np.ndarray
    record: Record
    sums: np.ndarray
    counts: np.ndarray
    passed: np.ndarray
    passed_force: np.ndarray


PATH_PROBLEM = types.NamedTuple([EQUATION_POINTER, MATRIX, MATRIX, MATRIX, VECTOR], PathProblem)
CONTROL = types.NamedTuple([int64, VECTOR, NUMBER, NUMBER, NUMBER, NUMBER, int64], Control)
AIM = types.NamedTuple([NUMBER, NUMBER, int64, int64, boolean, boolean], Aim)
WORKSPACE = types.NamedTuple([*[VECTOR] * 5, COUNTS, *[VECTOR] * 2, *[MATRIX] * 2, *[VECTOR] * 4], Workspace)
PREDICTION = types.NamedTuple([COUNTS, MATRIX, VECTOR, VECTOR, VECTOR, VECTOR, VECTOR, MATRIX], Prediction)
LAST_PROBLEM = types.NamedTuple([COUNTS, VECTOR, BLOCKS, BLOCKS, COUNTS, MATRIX, FACTORS], LastProblem)
RECORD = types.NamedTuple([MATRIX, VECTOR, VECTOR, MATRIX], Record)
RECORDS = types.NamedTuple([BLOCKS, MATRIX, MATRIX, BLOCKS], Record)
OUTCOME = types.NamedTuple([MATRIX, RECORDS, MATRIX, types.Array(int64, 2, "C"), MATRIX, BLOCKS], Outcome)
