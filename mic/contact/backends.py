"""The interface of backends of :class:`mic.contact.ContactSolver`, and the available ones."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from functools import partial
from typing import TYPE_CHECKING, Protocol

import numpy as np

from mic.contact.cone_programme import OPTIMISERS, ConeProgramme
from mic.contact.friction import Friction
from mic.contact.laws import Law
from mic.contact.path import Leg, Path

if TYPE_CHECKING:
    from mic.contact.compliance_columns import Columns
    from mic.contact.native.landing import Landing

__all__ = ["BACKENDS", "Backend"]


class Backend(Protocol):
    """Prepared solver for one compliance and one law, with many right-hand sides."""

    def subset(self, own: np.ndarray) -> Backend:
        """The backend of a subset `own` (m,) of the contacts."""

    def with_friction(self, friction: Friction) -> Backend:
        """The backend of the same contacts with another friction (m,)."""

    def solve(self, b: np.ndarray, guess: np.ndarray | None) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
        """Forces for every sample, which the caller certifies.

        Parameters
        ----------
        b : (n, d m) array
            Displacements without contact forces [length].
        guess : array shaped like ``b``, or None
            Initial forces, which a backend may ignore.

        Returns
        -------
        force : array shaped like ``b``
        iterations, factorisations : (n,) int array
            See :class:`mic.contact.solution.ContactSolution`.
        rung : (n,) object array of str
            The method that found each force.
        """

    def attempts(self, b: np.ndarray, force: np.ndarray) -> Iterator[tuple[np.ndarray, int, int, str]]:
        """Further forces for one sample, by increasingly expensive methods, from the best force so far.

        The caller certifies each and stops at the first that is accurate enough.  The generator is finite; a backend
        without further methods yields nothing.

        Yields
        ------
        force : (d m,) array
        iterations, factorisations : int
            Counted since the last force.
        rung : str
        """

    def follow(self, b0: np.ndarray, b1: np.ndarray, force: np.ndarray, anchor: np.ndarray, path: Path) -> Leg:
        """Follow every sample from one load to the next, under a law whose path can be followed.

        Parameters
        ----------
        b0, b1 : (n, d m) array
            Displacements without contact forces at the two loads.
        force : (n, d m) array
            Contact forces at the first.
        anchor : (n, m, 2) array
            Points from which slip is measured.
        path : Path
        """

    def step(
        self,
        among: np.ndarray,
        some: np.ndarray,
        b: np.ndarray,
        force: np.ndarray,
        anchor: np.ndarray,
        working: np.ndarray,
        guess: np.ndarray,
        near: bool,
        leg: Leg,
    ) -> None:
        """One increment of samples `some` (k,) of a batch, each with its own working set.

        Parameters
        ----------
        among : (l,) int array
            Indices of this problem's contacts among the m of the batch.
        b, force, anchor : (n, 2, d m), (n, d m), (n, m, 2) array
            Loads, forces and anchors of the batch, see :meth:`follow`.
        working : (n, m) bool array
            Working sets, all within the contacts of this problem.
        guess : (n, d m) array
            Initial forces at the end of the increment. If `near`, they are close enough for Newton's method; otherwise
            they are a forecast.
        leg : Leg
            Result of the batch, updated in place for the working sets of the samples; factorisations are added.
        """

    def landing(self, own: np.ndarray, S: Columns) -> Landing:
        """Factorised problem of the contacts `own` (m,) of `S` that most samples close, for :meth:`land`; falsy if its
        inverse is not accurate."""

    def land(
        self, b: np.ndarray, guess: np.ndarray, among: np.ndarray, landing: Landing | None
    ) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
        """Like :meth:`solve`, by Newton's method alone, for a law with friction and close guesses (n, 3m).

        Parameters
        ----------
        among : (m,) int array
            Indices of this problem's contacts among those of `landing`.
        """

    def infeasible(self, b: np.ndarray) -> bool:
        """Whether it is proven that no force can prevent penetration of the contacts of sample ``b`` (d m,)."""


def _native(S, friction, law, tol, threads, dimension, work):
    from mic.contact.native.solver import NativeSolver  # compiles, or reads the cache, when it is imported

    return NativeSolver(S, friction, law, tol, threads, dimension, work)


def _programme(optimiser, S, friction, law, tol, threads, dimension, work):
    return ConeProgramme(S, friction.coefficient, law, optimiser, dimension)


#: Backends by name: functions of the checked ``(S, friction, law, tol, threads, dimension, work)`` of
#: :class:`mic.contact.ContactSolver`.
BACKENDS: dict[str, Callable[[np.ndarray, Friction, Law, float, int, int, float], Backend]] = {
    "native": _native,
    **{name: partial(_programme, name) for name in OPTIMISERS},
}
