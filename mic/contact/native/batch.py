"""The cheap rungs: all samples of a batch, in compiled code.

A method is made for one problem, rung and tolerance, which prepares what all samples share; it then takes ``Q`` (n, d
m), the guess ``Y``, which receives the forces, ``errors`` (n,), and ``iterations`` and ``factorisations`` (n,), which
it adds to: passes over all contacts, and those of them that factorised the matrix of the contacts that touch.
"""

from __future__ import annotations

from collections.abc import Callable

from mic.contact.ladder import Rung
from mic.contact.native.frictionless import solve_frictionless
from mic.contact.native.problem import ScaledProblem
from mic.contact.native.splitting import solve_by_splitting
from mic.contact.native.sweeps import solve_by_sweeps

__all__ = ["METHODS", "relaxation", "splitting"]


def relaxation(problem: ScaledProblem, rung: Rung, tol: float) -> Callable:
    """Sweeps of Gauss-Seidel where the law has them, then Newton."""
    if not problem.law.frictional:

        def active_set(Q, Y, errors, *counts):
            solve_frictionless(problem.W, Q, Y, tol, rung["rounds"], errors, *counts)

        return active_set
    # Rounds differ in their sweeps alone: without them the second would repeat the first.
    rounds, sweeps = (rung["rounds"], rung["sweeps"]) if problem.law.gauss_seidel else (1, 0)
    crowd = rung["crowd"] * len(problem.parameters)

    def sweep(Q, Y, errors, *counts):
        solve_by_sweeps(
            problem.equation,
            problem.W,
            problem.factors,
            Q,
            problem.parameters,
            Y,
            tol,
            rounds,
            sweeps,
            crowd,
            errors,
            *counts,
        )

    return sweep


def splitting(problem: ScaledProblem, rung: Rung, tol: float) -> Callable:
    """The splitting, then Newton."""
    inverse, resolvent, rho = problem.splitting

    def split(Q, Y, errors, *counts):
        solve_by_splitting(
            problem.equation,
            problem.law.shift,
            problem.W,
            inverse,
            resolvent,
            rho,
            Q,
            problem.parameters,
            Y,
            tol,
            rung["steps"],
            rung["rounds"],
            errors,
            *counts,
        )

    return split


#: The method of every rung of :data:`mic.contact.ladder.BATCH`, by its name.
METHODS = {"sweeps": relaxation, "guess": relaxation, "splitting": splitting, "active set": relaxation}
