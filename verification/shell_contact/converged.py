"""A case's values with their uncertainty, from meshes of three sizes and paths of two tolerances.

    U = max(index, half the range of the three values, least) + |v(1e-5) − v(1e-6)|

The index is that of :func:`verification.mesh.study.converge`: Celik's procedure, with the observed order for monotone
values and three times the last difference otherwise. Half the range covers two meshes that agree by chance. The least,
a hundredth of the resolution of gauges and load cells, covers values on which all three agree, such as sums of forces
given by equilibrium. The last term is the path error on the medium mesh; it is an upper bound, because the values have
the second tolerance. The value is that of the finest mesh; nothing is extrapolated.
"""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import numpy as np
import pandas as pd

from verification.mesh.study import converge
from verification.shell_contact.case import LEVELS, TOLERANCES, Case, Quantity

__all__ = ["FINEST_TOLD", "KNOWN", "LEAST", "Converged", "converged", "read", "write"]

#: Quantities that are smaller on all meshes are not published.
LEAST = {"µm": 0.0, "N": 0.5, "N mm": 2e-3}
#: Smallest uncertainty of a value: a hundredth of the resolution of gauges and load cells.
FINEST_TOLD = {"µm": 0.01, "N": 0.01, "N mm": 1e-4}
KNOWN = 0.25  # relative uncertainty above which a value is published, but not for comparison
DIGITS = 8  # of the published values
COLUMNS = ("quantity", "unit", "value", "uncertainty", "order", *LEVELS, "path")


@dataclass(frozen=True)
class Converged:
    """A quantity on three meshes.

    Attributes
    ----------
    name, unit : str
    sizes : tuple of three float
        Element sizes, coarse to fine, mm.
    levels : tuple of three float
        Values on the three meshes.
    path : float
        Change by a path with the larger tolerance, on the medium mesh.
    """

    name: str
    unit: str
    sizes: tuple[float, float, float]
    levels: tuple[float, float, float]
    path: float

    @property
    def value(self) -> float:
        """Value on the finest mesh."""
        return self.levels[-1]

    @property
    def order(self) -> float:
        """Observed order over the three meshes; NaN if the values are not monotone."""
        return converge(self.sizes, self.levels).order

    @property
    def uncertainty(self) -> float:
        """Half width of the 95 % interval around the value."""
        found = converge(self.sizes, self.levels).index, float(np.ptp(self.levels)) / 2, FINEST_TOLD[self.unit]
        return max(found) + self.path

    @property
    def known(self) -> bool:
        """Whether the value is certain enough for a comparison."""
        return self.uncertainty <= KNOWN * abs(self.value)

    @property
    def published(self) -> bool:
        """Whether the value is large enough to be published."""
        return max(abs(value) for value in self.levels) >= LEAST[self.unit]


def converged(case: Case, cache: Path) -> list[Converged]:
    """Compute the values of a case."""
    levels = [case.quantities(level, cache) for level in LEVELS]
    loose = case.quantities("medium", cache, TOLERANCES[0])
    sizes = tuple(case.sizes[level] for level in LEVELS)
    found = [_one(sizes, *each) for each in zip(*levels, loose)]
    return [one for one in found if one.published]


def _one(sizes, *four: Quantity) -> Converged:
    coarse, medium, fine, loose = (one.value for one in four)
    levels = _written(coarse), _written(medium), _written(fine)
    return Converged(four[0].name, four[0].unit, sizes, levels, _written(abs(loose - medium)))


def _written(value: float) -> float:
    """The number as written to a file, so that results are the same before and after reading."""
    return float(f"{value:.{DIGITS}g}")


def write(path: Path, values: list[Converged]) -> None:
    """Values as CSV: quantity, unit, value, uncertainty, observed order, the three meshes, and the path error."""
    rows = [(one.name, one.unit, one.value, one.uncertainty, one.order, *one.levels, one.path) for one in values]
    pd.DataFrame(rows, columns=list(COLUMNS)).to_csv(path, index=False, float_format=f"%.{DIGITS}g")


def read(case: Case) -> list[Converged]:
    """The published values in the folder of a case."""
    table = pd.read_csv(case.folder / "values.csv")
    sizes = tuple(case.sizes[level] for level in LEVELS)
    return [
        Converged(row.quantity, row.unit, sizes, tuple(getattr(row, level) for level in LEVELS), row.path)
        for row in table.itertuples()
    ]
