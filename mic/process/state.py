"""The state that one stage passes to the next.

Every stage is solved in total displacements from the stress-free parts, so only friction and welds have memory: a weld
keeps the relative displacement at which it was made, and slip is measured from the contact's position at the end of the
previous step.
"""

from __future__ import annotations

from collections.abc import Hashable, Iterable, Mapping
from dataclasses import dataclass

import numpy as np

__all__ = ["Names", "ProcessState", "Values", "columns"]

ROW_VALUES = ("value", "reaction", "push", "stop", "frozen")


class Names:
    """Names of columns; one object for all values with the same columns.

    Attributes
    ----------
    column : dict
        The column of each name.
    """

    def __init__(self, names):
        self.column = {name: j for j, name in enumerate(names)}

    def __len__(self) -> int:
        return len(self.column)


NO_NAMES = Names(())  # of every initial state


class Values:
    """(n,) values by name: views of the columns of one array, so that a step reads or writes them all at once.

    Attributes
    ----------
    names : Names
    table : (n, k) array
        At least one column for each name.
    """

    def __init__(self, names: Names, table: np.ndarray):
        self.names, self.table = names, table

    def __getitem__(self, name: Hashable) -> np.ndarray:
        return self.table[:, self.names.column[name]]

    def take(self, names: Iterable[Hashable]) -> np.ndarray:
        """(n, k) values of some of the names."""
        return self.table[:, [self.names.column[name] for name in names]]

    def __contains__(self, name: object) -> bool:
        return name in self.names.column


def columns(n: int, values: list[np.ndarray]) -> np.ndarray:
    """(n, k) array of k columns (n,); k may be 0."""
    return np.array(values).T if values else np.zeros((n, 0))


@dataclass(frozen=True)
class ProcessState:
    """n assemblies at the end of a stage.

    Attributes
    ----------
    reading : dict of str to (n, r) array
        Readings of the displacement by the rows of each kind, mm and rad.
    force : (n, m, d) array
        Contact forces, N.
    left : (n, m, d) array
        Relative displacement δ of each contact at the end, mm.
    anchor : (n, m, d - 1) array
        Anchor of each contact's slip, mm (`mic.contact.path`).
    value : Values of (str, int)
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
        Samples whose contact did not meet its tolerance in some stage.
    path_error : (n,) array
        Estimated error of the anchors due to the paths of all stages so far, root mean square over the contacts, mm
        (:class:`mic.contact.path.Trace`); NaN once one of them has no estimate.
    force_error : (n,) array
        Likewise of the contact forces, N.
    """

    reading: Mapping[str, np.ndarray]
    force: np.ndarray
    left: np.ndarray
    anchor: np.ndarray
    failed: np.ndarray
    path_error: np.ndarray
    force_error: np.ndarray
    value: Values
    reaction: Values
    push: Values
    stop: Values
    frozen: Values

    @classmethod
    def start(cls, n: int, m: int, d: int, rows: Mapping[str, int]) -> ProcessState:
        """Free, unloaded parts: n assemblies, m contacts of dimension d, and the number of rows of each kind."""
        reading = {kind: np.zeros((n, count)) for kind, count in rows.items()}
        zero, empty = np.zeros((n, m, d)), dict.fromkeys(ROW_VALUES, Values(NO_NAMES, np.zeros((n, 0))))
        anchor, failed = np.zeros((n, m, d - 1)), np.zeros(n, dtype=bool)
        error, force_error = np.zeros((2, n))
        return cls(reading, zero, zero.copy(), anchor, failed, error, force_error, **empty)
