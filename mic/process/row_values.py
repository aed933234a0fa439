"""Values of all samples by row: one array, and the names of its columns."""

from __future__ import annotations

from collections.abc import Hashable, Iterable, Iterator, Mapping
from typing import Any

import numpy as np

__all__ = ["Names", "Values", "columns"]


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


class Values(Mapping[Any, np.ndarray]):
    """(n,) values by name: views of the columns of one array, so that a step reads or writes them all at once.

    Attributes
    ----------
    names : Names
    table : (n, k) array
        At least one column for each name.
    """

    __slots__ = ("names", "table")

    def __init__(self, names: Names, table: np.ndarray):
        self.names, self.table = names, table

    @classmethod
    def of(cls, values: Mapping[Any, np.ndarray], n: int) -> Values:
        """Values of n samples from any mapping."""
        return cls(Names(values), columns(n, list(values.values())))

    def __getitem__(self, name: Hashable) -> np.ndarray:
        return self.table[:, self.names.column[name]]

    def take(self, names: Iterable[Hashable]) -> np.ndarray:
        """(n, k) values of some of the names."""
        return self.table[:, [self.names.column[name] for name in names]]

    def __contains__(self, name: object) -> bool:
        return name in self.names.column

    def __iter__(self) -> Iterator[Any]:
        return iter(self.names.column)

    def __len__(self) -> int:
        return len(self.names)


def columns(n: int, values: list[np.ndarray]) -> np.ndarray:
    """(n, k) array of k columns (n,); k may be 0."""
    return np.array(values).T if values else np.zeros((n, 0))
