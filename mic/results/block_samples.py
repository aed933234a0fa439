"""Samples of one block as arrays."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from functools import cached_property
from typing import Any

import numpy as np
import pandas as pd

from mic.contact.states import STATES

__all__ = ["BlockSamples"]


@dataclass(frozen=True)
class BlockSamples:
    """The valid samples of one block: requested ones that did not fail.

    Attributes
    ----------
    tables : dict of str to DataFrame
        The datasets of :data:`mic.results.schema.DATASETS` by name; some blocks lack their contact pairs.
    contacts : int
        Number of contact pairs, m.
    samples : int
        Number of requested samples; the block may have further ones, of an earlier, longer run.
    """

    tables: Mapping[str, pd.DataFrame]
    contacts: int
    samples: int
    _categories: dict[tuple[str, str], tuple[dict[str, int], np.ndarray]] = field(default_factory=dict, init=False)
    _columns: dict[tuple[str, str], np.ndarray] = field(default_factory=dict, init=False)
    _rows: dict[tuple[Any, ...], np.ndarray] = field(default_factory=dict, init=False)

    @property
    def count(self) -> int:
        """Number of requested samples, including failed ones."""
        return int(self._requested.sum())

    @property
    def numbers(self) -> np.ndarray:
        """(n,) numbers of the valid samples."""
        return self.tables["samples"]["sample"].to_numpy()[self.valid]

    @property
    def failed(self) -> np.ndarray:
        """Numbers of the failed samples."""
        return self.tables["samples"]["sample"].to_numpy()[self._requested & ~self.valid]

    @cached_property
    def valid(self) -> np.ndarray:
        """Which samples of the block are valid."""
        return self._requested & ~self.tables["samples"]["failed"].to_numpy()

    @cached_property
    def _requested(self) -> np.ndarray:
        return self.tables["samples"]["sample"].to_numpy() < self.samples

    def _rows_with(self, table: str, key: str, name: str) -> np.ndarray:
        """Which rows of a table have a name in a column of names."""
        if (table, key) not in self._categories:
            names = self.tables[table][key].cat
            numbers = {category: i for i, category in enumerate(names.categories)}
            self._categories[table, key] = numbers, names.codes.to_numpy()
        numbers, codes = self._categories[table, key]
        return codes == numbers.get(name, len(numbers))

    @property
    def stages(self) -> list[str]:
        """Stages that resolve contact."""
        return list(self.tables["resolutions"]["stage"].cat.categories)

    def column(self, table: str, column: str, **keys: str) -> np.ndarray:
        """(n,) values of a column in the rows with the given keys.

        Raises
        ------
        KeyError
            If no row has one of the keys.
        """
        selection = (table, *keys.items())
        if selection not in self._rows:
            chosen = np.ones(len(self.tables[table]), dtype=bool)
            for key, name in keys.items():
                chosen &= self._rows_with(table, key, name)
                if name not in (known := self._categories[table, key][0]):
                    raise KeyError(f"the run has no {key} {name!r}; it has: {', '.join(known)}")
            self._rows[selection] = np.flatnonzero(chosen)[self.valid]
        return self._values(table, column)[self._rows[selection]]

    def _values(self, table: str, column: str) -> np.ndarray:
        """A whole column, cached: pandas takes longer to return it than the caller to use it."""
        if (table, column) not in self._columns:
            self._columns[table, column] = self.tables[table][column].to_numpy()
        return self._columns[table, column]

    def contact(self, stage: str, column: str) -> np.ndarray:
        """(n, m) a quantity of all contact pairs, see :meth:`mic.results.outcome.Outcome.contact`."""
        if column in ("f_t", "u_t"):
            return np.hypot(self.contact(stage, f"{column}1"), self.contact(stage, f"{column}2"))
        if column == "state":
            values = self.tables["contacts"][column].cat.set_categories(STATES).cat.codes.to_numpy()
        else:
            values = self._values("contacts", column)
        values = values[self._rows_with("contacts", "stage", stage)]
        return values.reshape(len(self.valid), self.contacts)[self.valid]

    def profile(self, measurement: str) -> np.ndarray:
        """(n, q) deviations at the points of a measurement, mm."""
        frame = self.tables["profiles"]
        values = frame["value"].to_numpy()[self._rows_with("profiles", "measurement", measurement)]
        return values.reshape(-1, len(self.valid)).T[self.valid]

    @property
    def unbuilt(self) -> np.ndarray:
        """Numbers of the valid samples in which a limited force did not suffice."""
        return self.numbers[~self.tables["samples"]["built"].to_numpy()[self.valid]]

    def failures(self) -> pd.DataFrame:
        """See :meth:`mic.results.outcome.Outcome.failures`."""
        table = self.tables["resolutions"]
        table = table[table["sample"].isin(self.failed) & ~table["converged"]]
        return table[["sample", "stage", "residual", "status"]].astype({"stage": str, "status": str})
