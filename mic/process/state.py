"""The state that one stage hands to the next.

Every stage is solved in total displacements from the stress-free parts, so only friction and welds carry memory: a weld
keeps the relative displacement that it found, and slip is measured from where the contact was left.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from mic.process.row_values import Names, Values

__all__ = ["ProcessState"]

NONE = Names(())  # of rows, before anything happens
KEPT = ("value", "reaction", "push", "stop", "frozen")


@dataclass(frozen=True)
class ProcessState:
    """n assemblies at the end of a stage.

    Attributes
    ----------
    reading : dict of str to (n, r) array
        What the rows of each kind read of the displacement, mm and rad.
    force : (n, m, d) array
        Contact forces, N.
    left : (n, m, d) array
        Relative displacement δ at which each contact was left, mm.
    anchor : (n, m, d - 1) array
        Where its slip goes on from, mm (`mic.contact.path`).
    value : Values, or any mapping of (str, int) to (n,) array
        Values that the bilateral rows hold.
    reaction : Values of (str, int)
        Forces of the bilateral rows on the parts, N or N mm.
    push : Values of int
        Forces of the clamp rows that push, N.
    stop : Values of (str, int)
        Forces by which stops hold back the rows that are pushed by a limited force (`mic.process.plan.Limit`), N.
    frozen : Values of int
        Relative displacement that each weld row keeps.
    failed : (n,) bool array
        Samples whose contact missed its tolerance in some stage.
    path_error : (n,) array
        Estimate of the error that the paths of all stages so far left in the anchors, root mean square over the
        contacts, mm (:class:`mic.contact.path.Trace`); NaN once one of them estimated none.
    """

    reading: Mapping[str, np.ndarray]
    force: np.ndarray
    left: np.ndarray
    anchor: np.ndarray
    failed: np.ndarray
    path_error: np.ndarray
    value: Values
    reaction: Values
    push: Values
    stop: Values
    frozen: Values

    def __post_init__(self):
        for name in KEPT:
            values = getattr(self, name)
            if not isinstance(values, Values):
                object.__setattr__(self, name, Values.of(values, len(self.failed)))

    @classmethod
    def start(cls, n: int, m: int, d: int, rows: Mapping[str, int]) -> ProcessState:
        """Free, unloaded parts: n assemblies, m contacts of dimension d, and so many rows of each kind."""
        reading = {kind: np.zeros((n, count)) for kind, count in rows.items()}
        none, empty = np.zeros((n, m, d)), dict.fromkeys(KEPT, Values(NONE, np.zeros((n, 0))))
        return cls(reading, none, none.copy(), np.zeros((n, m, d - 1)), np.zeros(n, dtype=bool), np.zeros(n), **empty)
