"""What a contact solve returns."""

from __future__ import annotations

from dataclasses import dataclass
from enum import Enum

import numpy as np

__all__ = ["ContactSolution", "Status"]


class Status(str, Enum):  # noqa: UP042  (StrEnum would change how a status prints)
    """Outcome of one sample; :attr:`advice` says what to do about it."""

    CONVERGED = "converged"
    NOT_CONVERGED = "not converged"
    INFEASIBLE = "infeasible"
    OUT_OF_RANGE = "out of range"

    @property
    def advice(self) -> str:
        """One sentence for the user."""
        return _ADVICE[self]


_ADVICE = {
    Status.CONVERGED: "The force obeys the contact law to the tolerance asked for; use it.",
    Status.NOT_CONVERGED: (
        "No force was found that obeys the law to the tolerance, so leave this sample out of any statistics: read its "
        "residual, loosen tol if that is good enough, and otherwise look for supports or gaps that leave nothing to "
        "balance the load."
    ),
    Status.INFEASIBLE: (
        "No admissible force balances this load, because some combination of contacts that cannot be separated by any "
        "force overlaps: correct the gaps or free the part, then solve again."
    ),
    Status.OUT_OF_RANGE: (
        "The forces are too large or too small to be told, or the law has units of its own, in which S or b lie beyond "
        "1e-60 or 1e60: state the problem in units of its own size, then solve again."
    ),
}


@dataclass(frozen=True)
class ContactSolution:
    """Forces, displacements and the evidence that they are a solution.

    Scalars and (3m,) vectors if ``b`` was one sample; leading axis n if it was a batch.

    Attributes
    ----------
    force : (3m,) or (n, 3m) array
        ``f`` in contact order n, t1, t2; ``f_n >= 0`` is compression [force].
    displacement : array like ``force``
        ``u = S f + b``; ``u_n >= 0`` is separation [length].
    residual : float or (n,) array
        Scale-free natural-map residual of the law, see :mod:`mic.contact.certificate` [1].
    converged : bool or (n,) bool array
        ``residual <= tol``.
    status : Status or (n,) object array of Status
        One outcome per sample.
    iterations : int or (n,) int array
        Passes over all contacts: Gauss-Seidel sweeps, Newton steps and splitting steps together; a backend's own count.
    factorisations : int or (n,) int array
        How many of them were of Newton's method: each factorises a matrix over the contacts
        that touch, or over all.  What is factorised once for all samples is not counted; 0 where a backend tells none.
    rung : str or (n,) object array of str
        Which rung of the ladder found the force, a name in :mod:`mic.contact.ladder`; another backend's own name.
    penetration, cone_violation, complementarity, slip_error : float or (n,) array
        Coulomb's conditions one by one, see :class:`mic.contact.certificate.Certificate`.
    """

    force: np.ndarray
    displacement: np.ndarray
    residual: np.ndarray
    converged: np.ndarray
    status: np.ndarray
    iterations: np.ndarray
    factorisations: np.ndarray
    rung: np.ndarray
    penetration: np.ndarray
    cone_violation: np.ndarray
    complementarity: np.ndarray
    slip_error: np.ndarray
