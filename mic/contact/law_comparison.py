"""Comparison of contact laws: the same contacts solved with every law, as a function of friction.

The associated programme (13) lets a sliding contact open by ``μ‖u_t‖`` while it carries load, which Coulomb's law (9)
excludes.  This comparison measures the effect, and that of neglecting friction, for any ``S`` and ``b``.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable

import numpy as np
import pandas as pd

from mic.contact.compliance_columns import Columns
from mic.contact.laws import COULOMB, LAWS
from mic.contact.solver import ContactSolver
from mic.contact.states import OPEN, STATES, classify
from mic.contact.working_set import WorkingSetSolver

__all__ = ["compare_laws", "summarise"]


def compare_laws(
    S: np.ndarray | Columns,
    b: np.ndarray,
    mu_values: Iterable,
    tol: float = 1e-10,
    threads: int = 1,
    solver: Callable[..., ContactSolver | WorkingSetSolver] = ContactSolver,
) -> pd.DataFrame:
    """Solve every sample for every coefficient of friction, under every law that needs no other friction data.

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
    solver : callable
        Creates a solver from S, a coefficient, and the keywords law, tol and threads.

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
            Largest ``u_n`` at contacts that carry load, where Coulomb's law requires zero [length].
        ``contacts_open``, ``contacts_stick``, ``contacts_slip``
            Contacts in each state of :mod:`mic.contact.states`.
        ``force_change``, ``slip_change``
            ``‖f - f_c‖/‖f_c‖`` and ``‖u_t - u_ct‖/‖u_ct‖`` against Coulomb's solution, 0 if both vanish [1].
            With redundant contacts forces are not unique, and the first means little.
        ``changed_states``
            Contacts whose state differs from Coulomb's.
    """
    b = np.atleast_2d(np.asarray(b, dtype=float))
    frames = []
    for mu in mu_values:
        # Without further friction data the other laws are Coulomb's.
        laws = [law for law in LAWS.values() if not law.reads]
        solutions = {law: solver(S, mu, law=law, tol=tol, threads=threads).solve(b) for law in laws}
        coulomb = solutions[COULOMB]
        f = coulomb.force.reshape(len(b), -1, 3)
        coulomb_states = classify(f, mu * f[..., 0])
        for law, solution in solutions.items():
            f = solution.force.reshape(len(b), -1, 3)
            u = solution.displacement.reshape(len(b), -1, 3)
            states = classify(f, (mu if law.frictional else 0.0) * f[..., 0])
            slip, coulomb_slip = u[..., 1:], coulomb.displacement.reshape(u.shape)[..., 1:]
            table = {
                "mu": float(np.mean(mu)),
                "law": law.name,
                "sample": np.arange(len(b)),
                "converged": solution.converged & coulomb.converged,
                "normal_force": f[..., 0].sum(axis=1),
                "friction_force": np.hypot(f[..., 1], f[..., 2]).sum(axis=1),
                "slip": np.sqrt(np.sum(slip**2, axis=(1, 2)) / max(u.shape[1], 1)),
                "gap_at_load": np.max(np.where(states == OPEN, 0.0, u[..., 0]), axis=1, initial=0.0),
                **{f"contacts_{label}": (states == state).sum(axis=1) for state, label in enumerate(STATES)},
                "force_change": _relative_change(solution.force, coulomb.force),
                "slip_change": _relative_change(slip, coulomb_slip),
                "changed_states": (states != coulomb_states).sum(axis=1),
            }
            frames.append(pd.DataFrame(table))
    return pd.concat(frames, ignore_index=True)


def summarise(study: pd.DataFrame) -> pd.DataFrame:
    """Means over converged samples, the largest gap, and the number of excluded samples.

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
