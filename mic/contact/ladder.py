"""The ladder: the solution methods in their order, with their settings and the laws that they apply to.

Each sample starts on the first rung that applies to its law and ends at the first whose force is accurate enough.  The
rungs of :data:`BATCH` are cheap and solve all samples together; :data:`PROXIMAL` solves one remaining sample at
a time, until the work that a sample may take is used up.  ``ladder.toml`` lists them.
"""

from __future__ import annotations

import tomllib
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from operator import attrgetter
from pathlib import Path
from typing import Any

from mic.contact.laws import Law

__all__ = ["APART", "BATCH", "MARGIN", "PROXIMAL", "SPLITTING", "WORK", "Rung", "rungs"]

#: Fraction of the tolerance that the compiled kernels solve to, because their residual and the certificate weight
#: contacts differently.
MARGIN = 1e-2
#: Default of the work of the fallback for one sample. The unit is a factorisation over the closed
#: contacts; as many Gauss-Seidel sweeps as there are contacts count as one. Hard problems that have a solution take up
#: to half of it.
WORK = 2000
#: A connected component of contacts is solved once its own residual is below this fraction of the tolerance.
APART = 0.1
#: Groups of laws, as ``ladder.toml`` names them.
LAWS: dict[str, Callable[[Law], bool]] = {
    "all": lambda law: True,
    "solved by Gauss-Seidel": attrgetter("gauss_seidel"),
    "with friction, not solved by Gauss-Seidel": lambda law: law.frictional and not law.gauss_seidel,
    "without friction": lambda law: not law.frictional,
}


@dataclass(frozen=True)
class Rung:
    """One solution method.

    Attributes
    ----------
    name : str
        Name in :class:`mic.contact.ContactSolution`.
    reason : str
        Purpose in one sentence.
    laws : str
        The laws that the method applies to, one of :data:`LAWS`.
    settings : mapping of str to number or list
        Its parameters; ``rung["steps"]`` reads one.
    """

    name: str
    reason: str
    laws: str
    settings: Mapping[str, Any] = field(default_factory=dict)

    def applies(self, law: Law) -> bool:
        """Whether the method applies to a law."""
        return LAWS[self.laws](law)

    def __getitem__(self, name):
        return self.settings[name]


_TABLES = tomllib.loads(Path(__file__).with_suffix(".toml").read_text(encoding="utf-8"))
#: Methods for all samples together.
BATCH = tuple(Rung(**table) for table in _TABLES["batch"])
#: Fallback for single samples.
PROXIMAL = Rung(**_TABLES["proximal"])
#: The other splitting rung shares its largest condition number.
SPLITTING = next(rung for rung in BATCH if rung.name == "splitting")


def rungs(law: Law) -> list[str]:
    """Names of the rungs that apply to a law, in order."""
    return [rung.name for rung in (*BATCH, PROXIMAL) if rung.applies(law)]
