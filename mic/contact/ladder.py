"""The ladder: the solution methods in their order, with their settings and the laws that they apply to.

Each sample starts on the first rung that applies to its law and ends at the first whose force is accurate enough.  The
rungs of :data:`BATCH` are cheap and solve all samples together; those of :data:`PATIENT` solve one remaining sample at
a time, until :data:`BUDGET` is used up.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from operator import attrgetter
from types import MappingProxyType
from typing import Any

from mic.contact.laws import Law

__all__ = [
    "APART",
    "BATCH",
    "BUDGET",
    "MARGIN",
    "PATIENT",
    "SPLITTING",
    "Rung",
    "rungs",
]

#: Fraction of the tolerance that the compiled kernels solve to, because their residual and the certificate weight
#: contacts differently.
MARGIN = 1e-2
#: The patient rungs may spend ``BUDGET (1 + 1000/m)`` factorisations of ``W`` on one sample, about 2 s for 100 contacts
#: and 100 s for 600.
BUDGET = 500.0
#: A connected component of contacts is solved once its own residual is below this fraction of the tolerance.
APART = 0.1


_swept = attrgetter("gauss_seidel")


def _unswept(law: Law) -> bool:
    return law.frictional and not law.gauss_seidel


@dataclass(frozen=True)
class Rung:
    """One solution method.

    Attributes
    ----------
    name : str
        Name in :class:`mic.contact.ContactSolution`.
    reason : str
        Purpose in one sentence.
    applies : function of a law
        Whether the method applies to the law.
    settings : mapping of str to number or tuple
        Its parameters; ``rung["steps"]`` reads one.
    """

    name: str
    reason: str
    applies: Callable[[Law], bool]
    settings: Mapping[str, Any] = field(default_factory=dict)

    def __post_init__(self):
        object.__setattr__(self, "settings", MappingProxyType(dict(self.settings)))

    def __getitem__(self, name):
        return self.settings[name]


# The other splitting rung shares its settings.
SPLITTING = Rung(
    "splitting",
    "Each step is one product with an inverse formed once per S: efficient if many contacts stick.",
    _swept,
    # Steps before the first Newton step, doubled in each round: contacts that do not stick by then are better solved by
    # Newton's method. Newton uses W⁻¹ up to this condition number of W, where the inverse is accurate to 1e-8.
    {"steps": 20, "rounds": 4, "invertible": 1e8},
)
#: Methods for all samples together.
BATCH = (
    Rung(
        "sweeps",
        "A few Gauss-Seidel sweeps identify the closed contacts, from which Newton's method converges.",
        _swept,
        # Above this fraction of closed contacts, Newton's method for their forces costs more than the splitting.
        {"sweeps": 10, "rounds": 1, "crowd": 0.65},
    ),
    Rung(
        "guess",
        "Newton's method converges from a close guess, so it is tried only if there is one.",
        _unswept,
        {"crowd": 0.65},
    ),
    SPLITTING,
    Rung(
        "splitting",
        "For convex problems the steps converge from any start, so more of them are allowed.",
        _unswept,
        # After 20 steps Newton's method usually fails.
        dict(SPLITTING.settings) | {"steps": 50, "rounds": 5},
    ),
    Rung(
        "active set",
        "Without friction a few projected Gauss-Seidel sweeps and the Newton steps of an active set suffice.",
        lambda law: not law.frictional,
        {"rounds": 3},
    ),
)

#: Fallbacks for single samples. They solve subproblems by `newton` steps with a `damping` of the derivative, after each
#: number of `sweeps` if the law has them, to the tolerance `tol`.
PATIENT = (
    Rung(
        "renewed friction",
        "For fixed coefficients the law is Coulomb's; they are then updated from the normal forces of its solution.",
        attrgetter("varies"),
        # From this tolerance on, Newton's method for the full problem converges.
        {"steps": 20, "sweeps": (10, 20, 40), "newton": 15, "damping": 1e-12, "tol": 1e-8},
    ),
    Rung(
        "proximal points",
        "Proximal point method: each step is a problem with a regular W + α I, near the last solution.",
        lambda law: True,
        # `first`: sweeps before Newton's method for the problem itself. α begins at `start`, is multiplied by `gain`
        # after a success and by `loss` after a failure, within its limits; after a failure it decreases again once
        # `wait` problems are solved.
        {
            "first": (30, 60, 120, 240, 480, 960),
            "steps": 2000,
            "start": 1e-3,
            "gain": 0.5,
            "loss": 4.0,
            "wait": 4,
            "smallest": 1e-9,
            "largest": 10.0,
            "sweeps": (0, 500),
            "newton": 12,
            "damping": 1e-13,
            "tol": 1e-12,
        },
    ),
)


def rungs(law: Law) -> list[str]:
    """Names of the rungs that apply to a law, in order."""
    return [rung.name for rung in BATCH + PATIENT if rung.applies(law)]
