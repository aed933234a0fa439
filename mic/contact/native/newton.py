"""Newton's method for all contacts of one sample."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numba import int64, typeof, types

from mic.contact.native.kernel import NUMBER, VECTOR, kernel
from mic.contact.native.law_equation import EQUATION_POINTER, derivative, force_scale, merit, relative
from mic.contact.native.linear_step import linear_step
from mic.contact.native.matrices import assign, assign_sum, displace, times
from mic.contact.states import OPEN, STICK

__all__ = ["COUPLING", "NO_INVERSE", "PATIENT", "Coupling", "NewtonSettings", "newton"]

#: Steps without a gain before Newton's method is given up.
PATIENT = 6


class Coupling(NamedTuple):
    """How the contacts move each other, and the parameters of their law.

    Attributes
    ----------
    W : (3m, 3m) array
    inverse : (3m, 3m) array
        ``W⁻¹``, or an empty array.
    parameters : (m, p) array
    """

    W: np.ndarray
    inverse: np.ndarray
    parameters: np.ndarray


class NewtonSettings(NamedTuple):
    """Settings of :func:`newton`.

    Attributes
    ----------
    damping : float
        Added to the diagonal of W in the derivative.
    scale : float
        Smallest force that errors are relative to.
    tol : float
    crowd : float
        Newton gives up before a step for the forces of more contacts than this.
    steps, halvings : int
        Steps, and how often each may be halved.
    """

    damping: float
    scale: float
    tol: float
    crowd: float
    steps: int
    halvings: int


NO_INVERSE = np.empty((0, 0))
COUPLING = typeof(Coupling(*np.empty((3, 0, 0))))
NEWTON_SETTINGS = typeof(NewtonSettings(0.0, 0.0, 0.0, 0.0, 0, 0))


@kernel(
    types.Tuple((NUMBER, int64))(EQUATION_POINTER, COUPLING, VECTOR, VECTOR, VECTOR, NEWTON_SETTINGS), from_python=True
)
def newton(equation, coupling, q, y, w, settings):
    """Semismooth Newton on ``Φ(y, W y + q) = 0``; ``y`` and ``w`` end at the best point found.

    Each step solves ``A dy + B dw = -Φ``, ``dw = W dy``, for few of the unknowns, because ``dy = -y`` where a contact
    is open and ``dw = -w`` where it sticks: for the forces of the contacts that are not open, or, where more contacts
    stick than are open and ``inverse = W⁻¹`` is at hand, for the displacements of those that do not stick, with ``dy =
    W⁻¹ dw``.

    ``damping`` is added to the diagonal of ``W`` in the derivative only: with a singular ``W`` the step is then that of
    a proximal point about the current ``y`` and stays bounded, and the solution is not moved.  Steps are halved up to
    ``halvings`` times until the norm of ``Φ`` falls.  Without halving they are taken whole: from afar the norm may rise
    for a step or two while states change, and then falls to zero where a search along the line would get stuck; after
    :data:`PATIENT` steps without a gain the search ends.

    Returns
    -------
    float, int
        ``‖Φ‖ / max(scale, (yᵀ W y)^{1/2})`` and the steps taken.
    """
    W, inverse, parameters = coupling
    damping, scale, tol, crowd, steps, halvings = settings
    m, n = len(parameters), len(q)
    phi, trial_phi = np.empty(n), np.empty(n)
    A, B = np.empty((m, 3, 3)), np.empty((m, 3, 3))
    state, trial_state = np.empty(m, np.int64), np.empty(m, np.int64)
    step, change = np.empty(n), np.empty(n)
    trial_y, trial_w = y.copy(), w.copy()
    error, size, gained, approach = np.inf, 0.0, 0, True
    iteration = 0
    while True:
        derivative(equation, parameters, trial_y, trial_w, phi, A, B, state)
        trial = np.sqrt(np.dot(phi, phi))
        if iteration == 0 or trial < error or (halvings > 0 and np.isfinite(trial)):
            error, gained = trial, iteration
            assign(y, trial_y)
            assign(w, trial_w)
            size = force_scale(scale, q, y, w)
        if error <= tol * size or iteration - gained > PATIENT or iteration == steps or not np.isfinite(trial):
            return relative(error, size), iteration
        stuck = free = 0
        for k in range(m):
            stuck += state[k] == STICK
            free += state[k] == OPEN
        if stuck > free and len(inverse) > 0:
            approach = linear_step(inverse, B, A, phi, state, STICK, trial_w, 0.0, approach, change)
            times(inverse, change, step)
        elif m - free > crowd:
            return relative(error, size), iteration
        else:
            approach = linear_step(W, A, B, phi, state, OPEN, trial_y, damping, approach, step)
        if halvings == 0:
            trial_y += step
        else:
            times(W, step, change)
            length = 1.0
            for _ in range(halvings):
                assign_sum(trial_y, y, length, step)
                assign_sum(trial_w, w, length, change)
                trial = merit(equation, parameters, trial_y, trial_w, trial_phi, trial_state)
                if trial <= (1.0 - 1e-4 * length) * error:
                    break
                length *= 0.5
            else:
                return relative(error, size), iteration + 1
        displace(W, trial_y, q, trial_w)
        iteration += 1
