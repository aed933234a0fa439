"""Who computes compliance: the border between the production path and any finite-element code.

A provider is found by its entry point in the group ``mic.compliance``; `fem_reference` registers one there as any other
package may. The production path names none of them.
"""

from __future__ import annotations

from collections.abc import Collection, Sequence
from functools import cache
from importlib.metadata import entry_points
from typing import Any, Protocol, runtime_checkable

import numpy as np

from mic.compliance.coefficients import InfluenceCoefficients
from mic.compliance.part import Part
from mic.compliance.superelement import ELEMENT, Superelements
from mic.errors import MissingProvider, SceneError

__all__ = ["GROUP", "Provider", "check_element", "find", "installed"]

GROUP = "mic.compliance"  #: of the entry points
REMEDY = "on Debian: apt-get install python3-dolfinx; or copy a cache folder from a machine that has it"


@runtime_checkable
class Provider(Protocol):
    """What computes the compliance of parts."""

    @property
    def elements(self) -> Collection[str]:
        """Names of the shell elements that it knows: what a scene's ``element`` may be."""
        ...

    def accepts(self, part: Part) -> bool:
        """Whether it can compute this part."""
        ...

    def coefficients(self, parts: Sequence[Part], comm: Any = None) -> dict[str, InfluenceCoefficients]:
        """Influence coefficients of the parts by name, whole on every process.

        Parameters
        ----------
        parts : sequence of Part
        comm : mpi4py.MPI.Comm, optional
            Processes that call together and share the parts out; default: this one alone.
        """
        ...

    def field(self, part: Part, forces: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Displacements and rotations at the v vertices of the part's surface, mm and rad.

        Parameters
        ----------
        part : Part
        forces : (F, r) array
            r self-balanced sets of forces on the part's functionals, N and N mm.

        Returns
        -------
        solved : (v, 6, r) array
            On the support that the coefficients were computed on.
        rigid : (v, 6, 6) array
            Of each rigid-body mode, mode last.
        """
        ...


@cache
def installed() -> tuple[dict[str, Provider], dict[str, str]]:
    """The providers that can be loaded, by name, and for each of the others why it cannot; superelements need no other
    package."""
    found: dict[str, Provider] = {"superelements": Superelements()}
    broken = {}
    for point in sorted(entry_points(group=GROUP), key=lambda point: point.name):
        try:
            found[point.name] = point.load()()
        except ImportError as error:
            broken[point.name] = str(error)
    return found, broken


def check_element(element: str) -> None:
    """Refuse an element that nobody knows; where a provider cannot be loaded, what it knows cannot be told.

    Raises
    ------
    SceneError
        Naming the elements that there are.
    """
    found, broken = installed()
    known = sorted({name for provider in found.values() for name in provider.elements if name != ELEMENT})
    if known and not broken and element not in known:
        raise SceneError(f"element: there is none called {element!r}; known: {', '.join(known)}")


def find(part: Part) -> Provider:
    """The first installed provider that accepts a part.

    Raises
    ------
    SceneError
        If nobody knows the part's element.
    MissingProvider
        If there is none; the message says what is missing and how to install it.
    """
    found, broken = installed()
    for provider in found.values():
        if provider.accepts(part):
            return provider
    check_element(part.element)
    reasons = [f"{name}: {reason}" for name, reason in broken.items()]
    refusing = [f"{name} does not accept it" for name in found if name != "superelements"]
    reasons += refusing or ["no package registers one"] * (not broken)
    raise MissingProvider(
        f"part {part.name!r}: its compliance must be computed by finite elements, and no provider of them is at hand "
        f"({'; '.join(reasons)}); {REMEDY}"
    )
