"""Result of a contact solve."""

from __future__ import annotations

from dataclasses import dataclass
from enum import Enum

import numpy as np

from mic.contact.certificate import Certificate
from mic.contact.contact_residual import RESOLVED

__all__ = ["ContactSolution", "Status", "advice_on"]


class Status(str, Enum):  # noqa: UP042  (StrEnum would change how a status prints)
    """Outcome of one sample, with :attr:`advice`."""

    CONVERGED = "converged"
    NOT_CONVERGED = "not converged"
    INFEASIBLE = "infeasible"
    OUT_OF_RANGE = "out of range"

    @property
    def advice(self) -> str:
        """One sentence for the user."""
        return _ADVICE[self]


_ADVICE = {
    Status.CONVERGED: "The force satisfies the contact law to the requested tolerance.",
    Status.NOT_CONVERGED: (
        "No force that satisfies the law to the tolerance was found within the solver's work (solver_work in "
        "[monte_carlo]), so exclude this sample from statistics: check its residual, increase tol if that is accurate "
        "enough, and otherwise look for supports or gaps that cannot balance the load."
    ),
    Status.INFEASIBLE: (
        "No admissible force balances this load, because contacts overlap that no force can separate: "
        "correct the gaps or free the part, then solve again."
    ),
    Status.OUT_OF_RANGE: (
        "The forces exceed the range of doubles, or the law has units of its own, in which S or b lie outside 1e-60 to "
        "1e60: rescale the problem, then solve again."
    ),
}


def advice_on(status: str) -> str:
    """One sentence for the user on the status of a failed sample, which may be an error message."""
    known = {str(own.value): own.advice for own in Status}
    return known.get(status, "The computation failed at this sample; look for implausibly large deviations.")


@dataclass(frozen=True)
class ContactSolution(Certificate):
    """Forces and displacements, with the residuals that show whether they are a solution.

    Scalars and (3m,) vectors if ``b`` was one sample; leading axis n if it was a batch.

    Attributes
    ----------
    force : (3m,) or (n, 3m) array
        ``f`` in contact order n, t1, t2; ``f_n >= 0`` is compression [force].
    displacement : array like ``force``
        ``u = S f + b``; ``u_n >= 0`` is separation [length].
    converged : bool or (n,) bool array
        ``residual <= tol``, relative to the energy of all contacts; :attr:`unresolved` has the contacts that are too
        small for that to say anything about them.
    status : Status or (n,) object array of Status
        One outcome per sample.
    iterations : int or (n,) int array
        Passes over all contacts: Gauss-Seidel sweeps, Newton steps and splitting steps; other backends count their own.
    factorisations : int or (n,) int array
        Number of Newton steps among them: each factorises a matrix over the closed contacts, or over all.
        Factorisations shared by all samples are not counted; 0 if a backend reports none.
    rung : str or (n,) object array of str
        Rung of :mod:`mic.contact.ladder` that found the force; for other backends, their name.
    residual, penetration, cone_violation, complementarity, slip_error, contact_residual
        See :class:`mic.contact.certificate.Certificate`.
    """

    force: np.ndarray
    displacement: np.ndarray
    converged: np.ndarray
    status: np.ndarray
    iterations: np.ndarray
    factorisations: np.ndarray
    rung: np.ndarray

    @property
    def unresolved(self) -> np.ndarray | None:
        """(m,) or (n, m) bool array: contacts that do not satisfy their law on their own scale, only to within the
        tolerance of all: their ``contact_residual`` exceeds :data:`mic.contact.contact_residual.RESOLVED`. None if the
        contacts are not certified one by one."""
        return None if self.contact_residual is None else ~(self.contact_residual <= RESOLVED)
