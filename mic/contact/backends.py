"""What a backend does for :class:`mic.contact.ContactSolver`, and which there are."""

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
    """One compliance and one law, prepared; many right-hand sides."""

    def take(self, own: np.ndarray) -> Backend:
        """The same for the contacts `own` (m,) alone, as if the others were not there."""

    def under(self, friction: Friction) -> Backend:
        """The same contacts under another friction (m,)."""

    def solve(self, b: np.ndarray, guess: np.ndarray | None) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
        """Forces for every sample, good or not: the caller certifies them.

        Parameters
        ----------
        b : (n, d m) array
            Displacements without contact forces [length].
        guess : array shaped like ``b``, or None
            Forces to start from, by a backend that can.

        Returns
        -------
        force : array shaped like ``b``
        iterations, factorisations : (n,) int array
            As :class:`mic.contact.solution.ContactSolution` has them.
        rung : (n,) object array of str
            The method that found each force.
        """

    def attempts(self, b: np.ndarray, force: np.ndarray) -> Iterator[tuple[np.ndarray, int, int, str]]:
        """Further forces for one sample, by more and more patient methods, from the best one so far.

        The caller certifies each and stops at the first that is good enough.  The generator ends by itself, so that a
        hopeless sample cannot hold up the rest; a backend without further methods yields nothing.

        Yields
        ------
        force : (d m,) array
        iterations, factorisations : int
            Since the last force.
        rung : str
        """

    def follow(self, b0: np.ndarray, b1: np.ndarray, force: np.ndarray, anchor: np.ndarray, path: Path) -> Leg:
        """Every sample from one load to the next, for a law whose path can be followed.

        Parameters
        ----------
        b0, b1 : (n, d m) array
            Displacements without contact forces at the two loads.
        force : (n, d m) array
            Contact forces at the first.
        anchor : (n, m, 2) array
            Where slip is measured from.
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
        """One increment of samples `some` (k,) of a batch, each with contacts of its own.

        Parameters
        ----------
        among : (l,) int array
            Numbers of this problem's contacts among the batch's m.
        b, force, anchor : (n, 2, d m), (n, d m), (n, m, 2) array
            Loads, forces and anchors of the batch, as :meth:`follow` has them.
        working : (n, m) bool array
            A sample's own contacts; all of them are among this problem's.
        guess : (n, d m) array
            Forces at the end to begin with, for samples that have any: so `near` that they may be tried as they are,
            or a forecast.
        leg : Leg
            Of the batch: what was found of the samples' own contacts is put there, and factorisations are added.
        """

    def landing(self, own: np.ndarray, S: Columns) -> Landing:
        """What :meth:`land` needs of a problem of contacts that most samples press, `own` (m,) of those of `S`; nothing
        true where their inverse is not accurate."""

    def land(
        self, b: np.ndarray, guess: np.ndarray, among: np.ndarray, landing: Landing | None
    ) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
        """As :meth:`solve`, for a law with friction and guesses (n, 3m) that are near: Newton's method alone.

        Parameters
        ----------
        among : (m,) int array
            Numbers of this problem's contacts among those that `landing` knows.
        """

    def infeasible(self, b: np.ndarray) -> bool:
        """Whether it is proven that no force keeps the contacts of sample ``b`` (d m,) from penetrating."""


def _native(S, friction, law, tol, threads, dimension):
    from mic.contact.native.solver import NativeSolver  # compiles, or reads the cache, when it is imported

    return NativeSolver(S, friction, law, tol, threads, dimension)


def _programme(optimiser, S, friction, law, tol, threads, dimension):
    return ConeProgramme(S, friction.coefficient, law, optimiser, dimension)


#: Every backend by its name: a function of a checked ``(S, friction, law, tol, threads, dimension)``, as
#: :class:`mic.contact.ContactSolver` has them.
BACKENDS: dict[str, Callable[[np.ndarray, Friction, Law, float, int, int], Backend]] = {
    "native": _native,
    **{name: partial(_programme, name) for name in OPTIMISERS},
}
