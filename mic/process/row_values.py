"""Values that a step keeps by row: one array of all samples, and the rows' names beside it."""

from __future__ import annotations

from collections.abc import Hashable, Iterable, Iterator, Mapping
from typing import Any

import numpy as np

__all__ = ["Names", "Values", "columns"]


class Names:
    """Names of columns, and where each stands; one object for all values that have the same.

    Attributes
    ----------
    place : dict
        By name, which column.
    """

    def __init__(self, names):
        self.place = {name: j for j, name in enumerate(names)}

    def __len__(self) -> int:
        return len(self.place)


class Values(Mapping[Any, np.ndarray]):
    """(n,) values by name: views of the columns of one array, so that a step takes or leaves them all at once.

    Attributes
    ----------
    names : Names
    table : (n, k) array
        One column for each name at least.
    """

    __slots__ = ("names", "table")

    def __init__(self, names: Names, table: np.ndarray):
        self.names, self.table = names, table

    @classmethod
    def of(cls, values: Mapping[Any, np.ndarray], n: int) -> Values:
        """Any values of n samples, so kept."""
        return cls(Names(values), columns(n, list(values.values())))

    def __getitem__(self, name: Hashable) -> np.ndarray:
        return self.table[:, self.names.place[name]]

    def take(self, names: Iterable[Hashable]) -> np.ndarray:
        """(n, k) values of some of the names."""
        return self.table[:, [self.names.place[name] for name in names]]

    def __contains__(self, name: object) -> bool:
        return name in self.names.place

    def __iter__(self) -> Iterator[Any]:
        return iter(self.names.place)

    def __len__(self) -> int:
        return len(self.names)


def columns(n: int, values: list[np.ndarray]) -> np.ndarray:
    """(n, k) array of k columns (n,), of which there may be none."""
    return np.array(values).T if values else np.zeros((n, 0))
