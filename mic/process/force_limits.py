"""Stops of limited forces, as additional contacts of a step.

A stop is a frictionless contact of one normal row. If the solver needs three rows for each contact, a stop has two more
rows that nothing drives or loads: uncoupled, with the compliance of its first row and without friction, so that they
stay zero.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import partial

import numpy as np

from mic.contact.compliance_columns import Columns
from mic.contact.friction import Friction
from mic.contact.path import PathSolution

__all__ = ["Stops"]


@dataclass(frozen=True)
class Stops:
    """m contacts of d rows each, then s stops of one: (d m + s) rows in a stage, d (m + s) in the solver.

    Attributes
    ----------
    contacts, count, dimension : int
        m, s and d.
    """

    contacts: int
    count: int
    dimension: int

    @property
    def total(self) -> int:
        """m + s."""
        return self.contacts + self.count

    @property
    def rows(self) -> int:
        """d m."""
        return self.contacts * self.dimension

    def pad(self, values: np.ndarray) -> np.ndarray:
        """(n, d (m + s)) values for the solver, from (n, d m + s)."""
        if not self.count:
            return values
        stops = np.zeros((len(values), self.count, self.dimension))
        stops[:, :, 0] = values[:, self.rows :]
        return np.concatenate([values[:, : self.rows], stops.reshape(len(values), -1)], axis=1)

    def compliance(self, S: Columns, diagonal: np.ndarray) -> Columns:
        """(d (m + s), d (m + s)) compliance for the solver, from (d m + s, d m + s) and its diagonal."""
        if not self.count:
            return S
        size = self.dimension * self.total
        return Columns(partial(self._padded_columns, S, diagonal), (size, size))

    def _padded_columns(self, S: Columns, diagonal: np.ndarray, numbers: np.ndarray) -> np.ndarray:
        """(k, d (m + s)) columns of the padded compliance."""
        stop = self.rows + self.dimension * np.arange(self.count)
        rows_used = np.concatenate([np.arange(self.rows), stop])
        columns = np.zeros((len(numbers), self.dimension * self.total))
        present = np.isin(numbers, rows_used)
        columns[np.ix_(present, rows_used)] = S.uncached(np.searchsorted(rows_used, numbers[present]))
        padding = numbers[~present]
        columns[~present, padding] = diagonal[self.rows + (padding - self.rows) // self.dimension]
        return columns

    def friction(self, friction: Friction) -> Friction:
        """Friction of the contacts and stops, from that of the contacts."""
        return friction.padded(self.count) if self.count else friction

    def split(self, solution: PathSolution) -> tuple[PathSolution, np.ndarray]:
        """The contacts' part of a solution, and the forces (n, s) of the stops."""
        if not self.count:
            return solution, np.zeros((len(solution.force), 0))
        m, trace = self.contacts, solution.trace
        own = {name: getattr(trace, name)[:, :m] for name in ("slip", "length", "work", "share")}
        # errors are root mean squares over contacts only
        own |= {name: getattr(trace, name) * np.sqrt(self.total / max(m, 1)) for name in ("error", "force_error")}
        contacts_only = replace(
            solution,
            force=solution.force[:, : self.rows],
            displacement=solution.displacement[:, : self.rows],
            anchor=solution.anchor[:, :m],
            trace=replace(trace, **own),
        )
        return contacts_only, solution.force[:, self.rows :: self.dimension]
