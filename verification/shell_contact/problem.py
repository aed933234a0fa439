"""The contact problem of the last stage of a case that ends in contact, on its coarse mesh and in one step:
compliance, gaps without contact forces, friction, and the solution."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from mic.contact import ContactSolver
from verification.scenes import with_path
from verification.shell_contact.case import Case

__all__ = ["contact_problem"]

BITS = 36  # bits of the entries of W, which then compress well; the problem is defined with the rounded entries
OPEN = 8  # smallest number of open contacts


def contact_problem(case: Case, cache: Path) -> dict:
    """The problem in the form of :func:`verification.shell_contact.fclib.write`.

    It contains the contacts that carry force and the nearest open contacts, half as many. The other contacts would be
    open in its solution too.

    Raises
    ------
    ValueError
        If the solver misses its tolerance.
    """
    model = case.model(with_path(case.scene("coarse"), "one-step"), cache)
    found = model.evaluate(np.zeros((1, len(model.scene.deviations))))
    touching = {name: one for name, one in found.resolutions.items() if one.force[0, :, 0].any()}
    stage = next(one for one in reversed(model.process("coulomb").stages) if one.plan.name in touching)
    last, contacts = touching[stage.plan.name], model.contacts
    force, displacement = last.force[0], last.displacement[0]
    W = stage.steps[-1].response.S.whole()[: force.size, : force.size]
    q = displacement.ravel() - W @ force.ravel()
    own = _taken(force, displacement, contacts.excluded(stage.steps[-1].step.nuggets))
    rows = (3 * own[:, None] + np.arange(3)).ravel()
    W, q, mu = _rounded(W[np.ix_(rows, rows)]), q[rows], contacts.friction_in(stage.plan.name).coefficient[own]
    solution = ContactSolver(W, mu).solve(q)
    if not solution.converged:
        raise ValueError(f"{case.name}: its contact problem did not converge")
    r = solution.force.ravel()
    return {
        "W": W,
        "q": q,
        "mu": mu,
        "u": W @ r + q,
        "r": r,
        "title": f"Shell contact: {case.name}, stage {stage.plan.name}",
        "description": f"{model.scene.description} {len(mu)} contacts; mm and N; order n, t1, t2.",
        "math_info": "W is symmetric and positive semidefinite: a compliance with all supports eliminated.",
    }


def _taken(force: np.ndarray, displacement: np.ndarray, out: np.ndarray) -> np.ndarray:
    """Indices of the contacts that carry force and of the nearest open ones."""
    loaded = force[:, 0] > 0
    gap = np.where(loaded | out, np.inf, displacement[:, 0])
    nearest = np.argsort(gap, kind="stable")[: max(OPEN, loaded.sum() // 2)]
    return np.sort(np.concatenate([np.flatnonzero(loaded), nearest[np.isfinite(gap[nearest])]]))


def _rounded(W: np.ndarray) -> np.ndarray:
    """Make symmetric and round to the given number of bits per entry."""
    mantissa, exponent = np.frexp(0.5 * (W + W.T))
    return np.ldexp(np.round(mantissa * 2.0**BITS) / 2.0**BITS, exponent)
