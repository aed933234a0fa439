"""A case's values with their uncertainty, from meshes of three sizes and paths of two tolerances.

    U = max(index, half the range of the three values, least) + |v(1e-5) − v(1e-6)|

The index is that of :func:`verification.mesh.study.converge`: Celik's procedure, with the observed order where values
are monotone and three times the last difference where they are not. Half the range holds where two meshes agree by
chance, and the least, a hundredth of what gauges and load cells tell, where all three do, as sums of forces that
equilibrium prescribes. The last term is the path's, on the medium mesh: the values are those of the second tolerance,
so that it says more than what is left. The value is that of the finest mesh; nothing is extrapolated.
"""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import numpy as np
import pandas as pd

from verification.mesh.study import converge
from verification.shell_contact.case import LEVELS, TOLERANCES, Case, Quantity

__all__ = ["FINEST_TOLD", "KNOWN", "LEAST", "Converged", "converged", "read", "write"]

#: What a quantity must reach on some mesh to be told of.
LEAST = {"µm": 0.0, "N": 0.5, "N mm": 2e-3}
#: What no value is told more closely than: a hundredth of what gauges and load cells tell.
FINEST_TOLD = {"µm": 0.01, "N": 0.01, "N mm": 1e-4}
KNOWN = 0.25  # of a value: the uncertainty beyond which it is told, but not to be compared with
DIGITS = 8  # with which values are written
COLUMNS = ("quantity", "unit", "value", "uncertainty", "order", *LEVELS, "path")


@dataclass(frozen=True)
class Converged:
    """A quantity on three meshes.

    Attributes
    ----------
    name, unit : str
    sizes : tuple of three float
        Of the elements, coarse to fine, mm.
    levels : tuple of three float
        Its values, in its unit.
    path : float
        By how much a path of the looser tolerance moves it on the medium mesh.
    """

    name: str
    unit: str
    sizes: tuple[float, float, float]
    levels: tuple[float, float, float]
    path: float

    @property
    def value(self) -> float:
        """Of the finest mesh."""
        return self.levels[-1]

    @property
    def order(self) -> float:
        """Observed over the three meshes; NaN where the values are not monotone."""
        return converge(self.sizes, self.levels).order

    @property
    def uncertainty(self) -> float:
        """Half-width of the interval about the value."""
        found = converge(self.sizes, self.levels).index, float(np.ptp(self.levels)) / 2, FINEST_TOLD[self.unit]
        return max(found) + self.path

    @property
    def known(self) -> bool:
        """Whether its uncertainty lets it be compared with."""
        return self.uncertainty <= KNOWN * abs(self.value)

    @property
    def told(self) -> bool:
        """Whether it is large enough to be compared."""
        return max(abs(value) for value in self.levels) >= LEAST[self.unit]


def converged(case: Case, cache: Path) -> list[Converged]:
    """A case's values, computed anew."""
    levels = [case.quantities(level, cache) for level in LEVELS]
    loose = case.quantities("medium", cache, TOLERANCES[0])
    sizes = tuple(case.sizes[level] for level in LEVELS)
    found = [_one(sizes, *each) for each in zip(*levels, loose)]
    return [one for one in found if one.told]


def _one(sizes, *four: Quantity) -> Converged:
    coarse, medium, fine, loose = (one.value for one in four)
    levels = _written(coarse), _written(medium), _written(fine)
    return Converged(four[0].name, four[0].unit, sizes, levels, _written(abs(loose - medium)))


def _written(value: float) -> float:
    """As a file holds it, so that what is made of it is the same before and after."""
    return float(f"{value:.{DIGITS}g}")


def write(path: Path, values: list[Converged]) -> None:
    """Values as CSV: quantity, unit, value, uncertainty, observed order, the three meshes, and what the path leaves."""
    rows = [(one.name, one.unit, one.value, one.uncertainty, one.order, *one.levels, one.path) for one in values]
    pd.DataFrame(rows, columns=list(COLUMNS)).to_csv(path, index=False, float_format=f"%.{DIGITS}g")


def read(case: Case) -> list[Converged]:
    """The values that the case's folder holds."""
    table = pd.read_csv(case.folder / "values.csv")
    sizes = tuple(case.sizes[level] for level in LEVELS)
    return [
        Converged(row.quantity, row.unit, sizes, tuple(getattr(row, level) for level in LEVELS), row.path)
        for row in table.itertuples()
    ]
