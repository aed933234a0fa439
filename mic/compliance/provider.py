"""Interface between production and finite-element programs that compute compliance.

A provider is found by its entry point in the group ``mic.compliance``; `fem_reference` registers one, and any other
package may. Production names none of them.
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
REMEDY = "install finite elements (docs/install.md), or copy a cache folder from a machine that has them"


@runtime_checkable
class Provider(Protocol):
    """A finite-element program that computes the compliance of parts."""

    @property
    def elements(self) -> Collection[str]:
        """Names of its shell elements, the possible values of a scene's ``element``."""
        ...

    def accepts(self, part: Part) -> bool:
        """Whether it can compute this part."""
        ...

    def coefficients(self, parts: Sequence[Part], comm: Any = None) -> dict[str, InfluenceCoefficients]:
        """Influence coefficients of all parts by name, on every process.

        Parameters
        ----------
        parts : sequence of Part
        comm : mpi4py.MPI.Comm, optional
            Processes that call together and share the work; default: this one alone.
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
            On the support of the influence coefficients.
        rigid : (v, 6, 6) array
            Of each rigid-body mode, mode last.
        """
        ...


@cache
def installed() -> tuple[dict[str, Provider], dict[str, str]]:
    """The providers that can be loaded, by name, and the error of each other one; superelements need no package."""
    providers: dict[str, Provider] = {"superelements": Superelements()}
    broken = {}
    for point in sorted(entry_points(group=GROUP), key=lambda point: point.name):
        try:
            providers[point.name] = point.load()()
        except ImportError as error:
            broken[point.name] = str(error)
    return providers, broken


def check_element(element: str) -> None:
    """Refuse an unknown element, unless a provider cannot be loaded: its elements are then unknown.

    Raises
    ------
    SceneError
        Naming the known elements.
    """
    providers, broken = installed()
    known = sorted({name for provider in providers.values() for name in provider.elements if name != ELEMENT})
    if known and not broken and element not in known:
        raise SceneError(f"element: there is none called {element!r}; known: {', '.join(known)}")


def find(part: Part) -> Provider:
    """The first installed provider that accepts a part.

    Raises
    ------
    SceneError
        If no provider knows the part's element.
    MissingProvider
        If there is none; the message says what to install.
    """
    providers, broken = installed()
    for provider in providers.values():
        if provider.accepts(part):
            return provider
    check_element(part.element)
    reasons = [f"{name}: {reason}" for name, reason in broken.items()]
    refusing = [f"{name} does not accept it" for name in providers if name != "superelements"]
    reasons += refusing or ["no package registers one"] * (not broken)
    raise MissingProvider(
        f"part {part.name!r}: its compliance must be computed by finite elements, and no provider is installed "
        f"({'; '.join(reasons)}); {REMEDY}"
    )
