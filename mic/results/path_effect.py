"""Effect of a tighter load path on means and 6σ, from repeated samples."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from pathlib import Path

import numpy as np
import pandas as pd

from mic.results.schema import PATH, PATH_ERRORS

__all__ = ["SMALLEST", "UNKNOWN", "Effect", "PathStudy", "read_path_study"]

SMALLEST = 0.01  # mm; no share is given relative to less


@dataclass(frozen=True)
class Effect:
    """Change of a mean or 6σ on a tighter load path.

    Attributes
    ----------
    change : float
        mm; NaN if not known.
    share : float
        Relative to the value; NaN if that is below :data:`SMALLEST`.
    """

    change: float
    share: float

    @classmethod
    def of(cls, change: float, value: float) -> Effect:
        """An effect relative to a value, mm."""
        return cls(change, change / value if value >= SMALLEST else float("nan"))


UNKNOWN = Effect(float("nan"), float("nan"))


@dataclass(frozen=True)
class PathStudy:
    """Samples of a run and their repetitions on a tighter path.

    Attributes
    ----------
    pairs : DataFrame
        As :data:`mic.results.schema.PATH` declares it.
    errors : DataFrame
        As :data:`mic.results.schema.PATH_ERRORS` declares it.
    """

    pairs: pd.DataFrame
    errors: pd.DataFrame

    @property
    def left_out(self) -> int:
        """Number of repetitions that did not converge, over all laws."""
        return len(self.pairs.loc[~self.pairs["converged"], ["law", "sample"]].drop_duplicates())

    def repeated(self, law: str) -> int:
        """Number of samples whose repetition converged."""
        rows = self.pairs[(self.pairs["law"] == law) & self.pairs["converged"]]
        return int(rows["sample"].nunique())

    def effects(self, law: str, quantity: str, name: str, stage: str | None = None) -> tuple[Effect, Effect]:
        """Effect of a tighter path on mean and 6σ.

        Parameters
        ----------
        law, quantity, name : str
        stage : str, optional
            Ignored for measurements.
        """
        measured = quantity == "measurement"
        values = self._values.get((law, quantity, name, None if measured else stage))
        if values is None:
            return UNKNOWN, UNKNOWN
        value, tight = values
        change = float(np.mean(tight - value))
        if len(value) < 2:
            return Effect.of(change, 0.0 if measured else float(value[0])), UNKNOWN
        spread, tight_spread = (6 * float(np.std(x, ddof=1)) for x in (value, tight))
        return (
            Effect.of(change, spread if measured else float(np.mean(value))),
            Effect.of(tight_spread - spread, spread),
        )

    @cached_property
    def _values(self) -> dict[tuple, tuple[np.ndarray, np.ndarray]]:
        """Values in the run and on the tighter path, of the repetitions that converged."""
        groups = self.pairs[self.pairs["converged"]].groupby(["law", "quantity", "name", "stage"], sort=False)
        return {
            (law, quantity, name, None if quantity == "measurement" else stage): (
                rows["value"].to_numpy(),
                rows["tighter"].to_numpy(),
            )
            for (law, quantity, name, stage), rows in groups
        }


def read_path_study(folder: Path) -> PathStudy | None:
    """The path study of a run folder; None if it has none.

    Raises
    ------
    FormatError
        If a file differs from :data:`mic.results.schema.PATH` or :data:`~mic.results.schema.PATH_ERRORS`.
    """
    pairs, errors = (table.read(folder, "call `mic report` on the run folder") for table in (PATH, PATH_ERRORS))
    return None if pairs is None or errors is None else PathStudy(pairs, errors)
