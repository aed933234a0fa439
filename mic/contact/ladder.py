"""The ladder: which methods look for a solution, in which order, with which settings, and for which laws.

Every sample starts on the first rung that applies to its law and leaves at the first whose force is good enough.  The
rungs of :data:`BATCH` are cheap and take all samples together; those of :data:`PATIENT` take one stubborn sample at a
time, until :data:`BUDGET` is spent.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
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

#: The compiled kernels work to this fraction of the tolerance, because their residual and the certificate weigh
#: contacts differently.
MARGIN = 1e-2
#: The patient rungs may spend ``BUDGET (1 + 1000/m)`` factorisations of ``W`` on one sample, about 2 s for 100 contacts
#: and 100 s for 600.
BUDGET = 500.0
#: Contacts that hang together are solved, apart from the others, once their own residual is this fraction of the
#: tolerance.
APART = 0.1


def _smooth(law: Law) -> bool:
    return not law.frictional


def _frictional(law: Law) -> bool:
    return law.frictional


def _swept(law: Law) -> bool:
    return law.gauss_seidel


def _unswept(law: Law) -> bool:
    return law.frictional and not law.gauss_seidel


def _varying(law: Law) -> bool:
    return law.varies


def _every(law: Law) -> bool:
    return True


@dataclass(frozen=True)
class Rung:
    """One method.

    Attributes
    ----------
    name : str
        What :class:`mic.contact.ContactSolution` reports.
    reason : str
        One sentence: why it is there.
    applies : function of a law
        Whether the method serves the law.
    settings : mapping of str to number or tuple
        Its tunables; ``rung["steps"]`` reads one.
    """

    name: str
    reason: str
    applies: Callable[[Law], bool]
    settings: Mapping[str, Any] = field(default_factory=dict)

    def __post_init__(self):
        object.__setattr__(self, "settings", MappingProxyType(dict(self.settings)))

    def __getitem__(self, name):
        return self.settings[name]


# Another rung shares its settings.
SPLITTING = Rung(
    "splitting",
    "Each step is one product with an inverse formed once per S, however many contacts touch: for loads that stick.",
    _swept,
    # Steps before the first Newton, and rounds of twice as many each: under Coulomb's law what does not stick by then
    # is better left to Newton's method. Newton uses W⁻¹ up to this condition number of W: the inverse is then good to
    # 1e-8, and each step gains that much.
    {"steps": 20, "rounds": 4, "invertible": 1e8},
)
#: Cheap methods, for all samples together.
BATCH = (
    Rung(
        "sweeps",
        "A few sweeps of Gauss-Seidel find which contacts touch, and one run of Newton lands.",
        _swept,
        # Above this share of contacts that are not open, Newton for their forces costs more than the splitting.
        {"sweeps": 10, "rounds": 1, "crowd": 0.65},
    ),
    Rung(
        "guess",
        "Newton lands from a guess that is near; from afar it is a waste, so it is tried with a guess alone.",
        _unswept,
        {"crowd": 0.65},
    ),
    SPLITTING,
    Rung(
        "splitting",
        "Where the problem is convex the steps converge from anywhere, so they are given time.",
        _unswept,
        # Newton is mostly wasted after 20 steps.
        dict(SPLITTING.settings) | {"steps": 50, "rounds": 5},
    ),
    Rung(
        "active set",
        "Without friction a few sweeps of projected Gauss-Seidel and the Newton steps of an active set suffice.",
        _smooth,
        {"rounds": 3},
    ),
)

#: Methods for one sample that the cheap ones did not solve. Each of their problems is tried by so many steps of
#: Newton's method, the derivative damped so, after each of so many more sweeps where the law has them, to a tolerance.
PATIENT = (
    Rung(
        "renewed friction",
        "With the coefficients of friction held the law is Coulomb's; then they are renewed from its normal forces.",
        _varying,
        # At this tolerance Newton for the whole lands.
        {"steps": 20, "sweeps": (10, 20, 40), "newton": 15, "damping": 1e-12, "tol": 1e-8},
    ),
    Rung(
        "proximal points",
        "Each step is a problem with a regular W + α I near the last answer, solved or rejected: whatever is left.",
        _every,
        # First the problem itself, Newton after each of these sweeps. Then α starts here, is multiplied by `gain` after
        # a success at once and by `loss` after a failure, between its limits; after a failure it falls again once so
        # many problems are solved.
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
    """Names of the rungs that serve a law, from the first to the last."""
    return [rung.name for rung in BATCH + PATIENT if rung.applies(law)]
