"""What the choice of contact law costs: the same contacts solved with all three, as a function of friction.

The associated programme (13) lets a sliding contact open by ``μ‖u_t‖`` while it carries load, which Coulomb's law (9)
forbids.  This study measures that, and what leaving friction out costs, on any ``S`` and ``b``.
"""

from __future__ import annotations

from enum import IntEnum

import numpy as np
import pandas as pd

from mic.contact.laws import Law
from mic.contact.solver import ContactSolver

__all__ = ["ContactState", "compare_laws", "contact_states", "summarise"]

#: A contact is loaded above this share of the largest normal force of the sample, and slides within this distance of the cone.
STATE_TOLERANCE = 1e-6


class ContactState(IntEnum):
    """State of one contact."""

    OPEN = 0
    STUCK = 1
    SLIDING = 2


def contact_states(force, mu) -> np.ndarray:
    """State of every contact: open without load, stuck inside the cone, sliding on its surface.

    Parameters
    ----------
    force : (n, 3m) array
    mu : float or (m,) array

    Returns
    -------
    (n, m) array of ContactState values
    """
    f = np.asarray(force).reshape(len(force), -1, 3)
    normal, traction = f[..., 0], np.hypot(f[..., 1], f[..., 2])
    loaded = normal > STATE_TOLERANCE * normal.max(axis=1, keepdims=True, initial=0.0)
    sliding = traction >= (1.0 - STATE_TOLERANCE) * mu * normal
    return np.where(loaded, np.where(sliding, ContactState.SLIDING, ContactState.STUCK), ContactState.OPEN)


def compare_laws(S, b, mu_values, tol=1e-10, threads=1) -> pd.DataFrame:
    """Solve every sample with every law and every friction coefficient.

    Parameters
    ----------
    S : (3m, 3m) array
        Compliance [length / force].
    b : (3m,) or (n, 3m) array
        Displacements without contact forces [length].
    mu_values : sequence of float or of (m,) arrays
        Friction to study; rows of the result carry the mean coefficient.
    tol, threads
        As for :class:`mic.contact.solver.ContactSolver`.

    Returns
    -------
    pandas.DataFrame
        One row per (``mu``, ``law``, ``sample``):

        ``converged``
            Whether this law and Coulomb's both reached ``tol``; drop other rows before averaging.
        ``normal_force``, ``friction_force``
            Sums over contacts of ``f_n`` and ``‖f_t‖`` [force].
        ``slip``
            Root mean square of ``‖u_t‖`` over the contacts [length].
        ``gap_at_load``
            Largest ``u_n`` where Coulomb's law has none: at contacts that carry load [length].
        ``open``, ``stuck``, ``sliding``
            Contacts in each state.
        ``force_change``, ``slip_change``
            ``‖f - f_c‖/‖f_c‖`` and ``‖u_t - u_ct‖/‖u_ct‖`` against Coulomb's solution, 0 if both vanish [1].
            With redundant contacts forces are not unique, and the first means little.
        ``changed_states``
            Contacts whose state differs from Coulomb's.
    """
    b = np.atleast_2d(np.asarray(b, dtype=float))
    frames = []
    for mu in mu_values:
        solutions = {law: ContactSolver(S, mu, law, tol=tol, threads=threads).solve(b) for law in Law}
        coulomb = solutions[Law.COULOMB]
        coulomb_states = contact_states(coulomb.force, mu)
        for law, solution in solutions.items():
            f = solution.force.reshape(len(b), -1, 3)
            u = solution.displacement.reshape(len(b), -1, 3)
            states = contact_states(solution.force, 0.0 if law is Law.FRICTIONLESS else mu)
            count = {state: (states == state).sum(axis=1) for state in ContactState}
            slip, coulomb_slip = u[..., 1:], coulomb.displacement.reshape(u.shape)[..., 1:]
            frames.append(
                pd.DataFrame(
                    {
                        "mu": float(np.mean(mu)),
                        "law": law.value,
                        "sample": np.arange(len(b)),
                        "converged": solution.converged & coulomb.converged,
                        "normal_force": f[..., 0].sum(axis=1),
                        "friction_force": np.hypot(f[..., 1], f[..., 2]).sum(axis=1),
                        "slip": np.sqrt(np.sum(slip**2, axis=(1, 2)) / max(u.shape[1], 1)),
                        "gap_at_load": np.max(
                            np.where(states == ContactState.OPEN, 0.0, u[..., 0]), axis=1, initial=0.0
                        ),
                        "open": count[ContactState.OPEN],
                        "stuck": count[ContactState.STUCK],
                        "sliding": count[ContactState.SLIDING],
                        "force_change": _relative_change(solution.force, coulomb.force),
                        "slip_change": _relative_change(slip, coulomb_slip),
                        "changed_states": (states != coulomb_states).sum(axis=1),
                    }
                )
            )
    return pd.concat(frames, ignore_index=True)


def summarise(study: pd.DataFrame) -> pd.DataFrame:
    """Means over the samples that converged, the largest gap, and how many samples were left out.

    Parameters
    ----------
    study : pandas.DataFrame
        From :func:`compare_laws`.

    Returns
    -------
    pandas.DataFrame
        Indexed by (``mu``, ``law``).
    """
    keys = ["mu", "law"]
    groups = study[study["converged"]].groupby(keys, sort=False)
    table = groups.mean(numeric_only=True).drop(columns=["sample", "converged"])
    table["gap_at_load_max"] = groups["gap_at_load"].max()
    table["left_out"] = (~study["converged"]).groupby([study[key] for key in keys], sort=False).sum()
    return table


def _relative_change(a, reference):
    axes = tuple(range(1, a.ndim))
    change = np.sqrt(np.sum((a - reference) ** 2, axis=axes))
    size = np.sqrt(np.sum(reference**2, axis=axes))
    return np.divide(change, size, out=np.where(change > 0.0, np.inf, 0.0), where=size > 0.0)
