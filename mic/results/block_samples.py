"""Valid samples of one block as arrays."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numpy as np
import pandas as pd

from mic.contact.states import STATES

__all__ = ["BlockSamples"]


@dataclass(frozen=True)
class BlockSamples:
    """The valid samples of one block: those that did not fail, and are among the samples asked for.

    Attributes
    ----------
    tables : dict of str to DataFrame
        By name, the datasets of :data:`mic.results.schema.DATASETS`; not all blocks have their contact pairs.
    contacts : int
        Number of contact pairs, m.
    samples : int
        How many samples were asked for: later ones, of a longer run before, do not count.
    """

    tables: Mapping[str, pd.DataFrame]
    contacts: int
    samples: int

    @property
    def found(self) -> int:
        """Samples that are there, failed ones included."""
        return int(self._wanted.sum())

    @property
    def numbers(self) -> np.ndarray:
        """(n,) numbers of the valid samples."""
        return self.tables["samples"]["sample"].to_numpy()[self.valid]

    @property
    def failed(self) -> np.ndarray:
        """Numbers of the failed samples."""
        return self.tables["samples"]["sample"].to_numpy()[self._wanted & ~self.valid]

    @cached_property
    def valid(self) -> np.ndarray:
        """Which of the block's samples are valid."""
        return self._wanted & ~self.tables["samples"]["failed"].to_numpy()

    @cached_property
    def _wanted(self) -> np.ndarray:
        return self.tables["samples"]["sample"].to_numpy() < self.samples

    @cached_property
    def _known(self) -> dict[tuple[str, str], tuple[dict[str, int], np.ndarray]]:
        return {}

    def _named(self, table: str, key: str, name: str) -> np.ndarray:
        """Which rows of a table have a name in a column of names."""
        if (table, key) not in self._known:
            names = self.tables[table][key].cat
            self._known[table, key] = {one: i for i, one in enumerate(names.categories)}, names.codes.to_numpy()
        number, codes = self._known[table, key]
        return codes == number.get(name, len(number))

    @property
    def stages(self) -> list[str]:
        """Stages that resolve contact."""
        return list(self.tables["resolutions"]["stage"].cat.categories)

    def column(self, table: str, column: str, **keys: str) -> np.ndarray:
        """(n,) one column of the rows with the given keys.

        Raises
        ------
        KeyError
            If no row has one of the keys.
        """
        asked = (table, *keys.items())
        if asked not in self._rows:
            chosen = np.ones(len(self.tables[table]), dtype=bool)
            for key, name in keys.items():
                chosen &= self._named(table, key, name)
                if name not in (known := self._known[table, key][0]):
                    raise KeyError(f"{key} {name!r}: the run has none; known: {', '.join(known)}")
            self._rows[asked] = np.flatnonzero(chosen)[self.valid]
        return self._values(table, column)[self._rows[asked]]

    @cached_property
    def _rows(self) -> dict[tuple[Any, ...], np.ndarray]:
        return {}

    @cached_property
    def _columns(self) -> dict[tuple[str, str], np.ndarray]:
        return {}

    def _values(self, table: str, column: str) -> np.ndarray:
        """One column as it stands; that takes a frame longer than anything that is done with it."""
        if (table, column) not in self._columns:
            self._columns[table, column] = self.tables[table][column].to_numpy()
        return self._columns[table, column]

    def contact(self, stage: str, column: str) -> np.ndarray:
        """(n, m) one quantity of all contact pairs, see :meth:`mic.results.outcome.Outcome.contact`."""
        if column in ("f_t", "u_t"):
            return np.hypot(self.contact(stage, f"{column}1"), self.contact(stage, f"{column}2"))
        if column == "state":
            values = self.tables["contacts"][column].cat.set_categories(STATES).cat.codes.to_numpy()
        else:
            values = self._values("contacts", column)
        own = values[self._named("contacts", "stage", stage)]
        return own.reshape(len(self.valid), self.contacts)[self.valid]

    def profile(self, measurement: str) -> np.ndarray:
        """(n, q) what a measurement over many points reads at each of them, mm."""
        frame = self.tables["profiles"]
        values = frame["value"].to_numpy()[self._named("profiles", "measurement", measurement)]
        return values.reshape(-1, len(self.valid)).T[self.valid]

    @property
    def unbuilt(self) -> np.ndarray:
        """Numbers of the valid samples that are not built."""
        return self.numbers[~self.tables["samples"]["built"].to_numpy()[self.valid]]

    def failures(self) -> pd.DataFrame:
        """See :meth:`mic.results.outcome.Outcome.failures`."""
        table = self.tables["resolutions"]
        table = table[table["sample"].isin(self.failed) & ~table["converged"]]
        return table[["sample", "stage", "residual", "status"]].astype({"stage": str, "status": str})
