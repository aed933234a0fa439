"""Other solutions of a contact problem, found by further starts of Newton's method.

Coulomb's law with a given compliance S has one solution where friction times the coupling of normal and tangential
directions is small. A single contact may have several if ``μ ‖S_nt‖ > S_nn`` (Klarbring 1990): then forces and
displacements depend on the load path.
"""

from __future__ import annotations

import numpy as np

from mic.contact.path import Leg
from mic.contact.solver import ContactSolver
from mic.system.matrix_product import one_thread, product

__all__ = ["coupling", "has_other_solution"]

#: Coupling of a contact above which other solutions are sought: half of what a single contact needs.
COUPLED = 0.5
#: Relative to the energy of the forces: that of the difference of two solutions.
DISTINCT = 1e-8


def coupling(solver: ContactSolver) -> np.ndarray:
    """(m,) friction times coupling of each contact, ``μ ‖S_nt‖ / S_nn``; beyond 1 it may have several solutions."""
    m = solver.contacts
    blocks = solver.S.reshape(m, 3, m, 3)[np.arange(m), :, np.arange(m)]
    normal = np.maximum(blocks[:, 0, 0], np.finfo(float).tiny)
    return solver.mu * np.linalg.norm(blocks[:, 0, 1:], axis=1) / normal


@one_thread
def has_other_solution(solver: ContactSolver, b: np.ndarray) -> np.ndarray:
    """Whether two certified solutions were found.

    Parameters
    ----------
    solver : ContactSolver
        Of Coulomb's law, native.
    b : (n, 3m) array
        Displacements without contact forces, tangentially from the anchors.

    Returns
    -------
    (n,) bool array
        True proves that there are several. False proves nothing; it is what is returned where no contact is coupled by
        more than :data:`COUPLED`.
    """
    n, m = len(b), solver.contacts
    several = np.zeros(n, dtype=bool)
    if not m or coupling(solver).max() <= COUPLED:
        return several
    first = solver.solve(b, refine=False)
    for guess in _starts(solver, b, first.force):
        leg = Leg.start(n, m)
        every, problem = np.arange(m), np.stack([b, b], axis=1)
        start = np.zeros_like(b), np.zeros((n, m, 2)), np.ones((n, m), dtype=bool)
        solver.backend.step(every, np.arange(n), problem, *start, guess, True, leg)
        response = product(leg.force, solver.S)
        _, converged, _ = solver.check_convergence(leg.b, leg.force, response)
        change = leg.force - first.force
        energy = np.sum(change * product(change, solver.S), axis=1)
        size = np.sum(first.force * product(first.force, solver.S), axis=1) + np.sum(leg.force * response, axis=1)
        several |= first.converged & converged & ~leg.given_up & (energy > DISTINCT * size)
    return several


def _starts(solver: ContactSolver, b: np.ndarray, force: np.ndarray) -> list[np.ndarray]:
    """Forces (n, 3m) to start from: none; all sticking; friction reversed; sliding either way along the coupling."""
    n, m = len(b), solver.contacts
    stuck = -np.linalg.lstsq(solver.S, b.T, rcond=None)[0].T
    reversed_friction = force.reshape(n, m, 3) * [1.0, -1.0, -1.0]
    blocks = solver.S.reshape(m, 3, m, 3)[np.arange(m), 0, np.arange(m), 1:]
    along = blocks / np.maximum(np.linalg.norm(blocks, axis=1, keepdims=True), np.finfo(float).tiny)
    slide = solver.mu[:, None] * along
    pressed = np.abs(stuck).max(axis=1)[:, None, None]
    sliding = [pressed * np.column_stack([np.ones(m), way * slide]) for way in (-1.0, 1.0)]
    return [each.reshape(n, 3 * m) for each in (np.zeros_like(b), stuck, reversed_friction, *sliding)]
