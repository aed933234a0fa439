"""Stops among the contacts of a step: what the contact solver sees of rows that are pushed by a limited force.

A stop is a contact of one row, normal, without friction. Where the solver wants three rows for each contact, a stop has
two more that nothing drives and nothing loads: uncoupled, of the compliance of its first, without friction, so that
they stay zero.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import partial

import numpy as np

from mic.contact.compliance_columns import Columns
from mic.contact.friction import Friction
from mic.contact.path import PathSolution, Trace

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

    def spread(self, values: np.ndarray) -> np.ndarray:
        """(n, d (m + s)) for the solver, from (n, d m + s)."""
        if not self.count:
            return values
        stops = np.zeros((len(values), self.count, self.dimension))
        stops[:, :, 0] = values[:, self.rows :]
        return np.concatenate([values[:, : self.rows], stops.reshape(len(values), -1)], axis=1)

    def compliance(self, S: Columns, own: np.ndarray) -> Columns:
        """(d (m + s), d (m + s)) for the solver, from (d m + s, d m + s) and its diagonal."""
        if not self.count:
            return S
        wide = self.dimension * self.total
        return Columns(partial(self._spread, S, own), (wide, wide))

    def _spread(self, S: Columns, own: np.ndarray, numbers: np.ndarray) -> np.ndarray:
        """(k, d (m + s)) columns for the solver."""
        stop = self.rows + self.dimension * np.arange(self.count)
        place = np.concatenate([np.arange(self.rows), stop])
        found = np.zeros((len(numbers), self.dimension * self.total))
        driven = np.isin(numbers, place)
        found[np.ix_(driven, place)] = S.passed(np.searchsorted(place, numbers[driven]))
        idle = numbers[~driven]
        found[~driven, idle] = own[self.rows + (idle - self.rows) // self.dimension]
        return found

    def friction(self, friction: Friction) -> Friction:
        """Of the contacts and the stops, from that of the contacts."""
        if not self.count:
            return friction
        none, pressure = np.zeros(self.count), friction.pressure
        if pressure is not None:
            constant = np.zeros((self.count, *pressure.shape[1:]))
            constant[:, 1:, 0] = np.inf
            pressure = np.concatenate([pressure, constant])
        compliance = friction.compliance
        return Friction(
            np.concatenate([friction.coefficient, none]),
            pressure,
            None if compliance is None else np.concatenate([compliance, none]),
        )

    def split(self, solution: PathSolution) -> tuple[PathSolution, np.ndarray]:
        """The contacts' part of a solution, and the forces (n, s) of the stops."""
        if not self.count:
            return solution, np.zeros((len(solution.force), 0))
        m, trace = self.contacts, solution.trace
        own = replace(
            solution,
            force=solution.force[:, : self.rows],
            displacement=solution.displacement[:, : self.rows],
            anchor=solution.anchor[:, :m],
            trace=Trace(
                trace.slip[:, :m],
                trace.length[:, :m],
                trace.work[:, :m],
                trace.share[:, :m],
                trace.error * np.sqrt(self.total / max(m, 1)),  # a root mean square, of contacts alone
                trace.steps,
                trace.factorisations,
            ),
        )
        return own, solution.force[:, self.rows :: self.dimension]
