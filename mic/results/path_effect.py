"""Effect of a tighter load path on means and 6σ, from repeated samples."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from pathlib import Path

import numpy as np
import pandas as pd

from mic.results.schema import PATH, PATH_ERRORS

__all__ = ["SMALLEST", "Effect", "PathStudy", "read_path_study"]

SMALLEST = 0.01  # mm; no share is given relative to less


@dataclass(frozen=True)
class Effect:
    """What a tighter path changes of a figure.

    Attributes
    ----------
    change : float
        mm; NaN where it is not known.
    share : float
        Of the figure; NaN where that is below :data:`SMALLEST`.
    """

    change: float
    share: float


@dataclass(frozen=True)
class PathStudy:
    """Samples of a run beside their repetitions.

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
        """Repetitions that did not converge, over all laws."""
        return len(self.pairs.loc[~self.pairs["converged"], ["law", "sample"]].drop_duplicates())

    def repeated(self, law: str) -> int:
        """Samples that stand beside their repetition."""
        found = self.pairs[(self.pairs["law"] == law) & self.pairs["converged"]]
        return int(found["sample"].nunique())

    def effects(self, law: str, quantity: str, name: str, stage: str | None = None) -> tuple[Effect, Effect]:
        """What a tighter path changes of mean and 6σ.

        Parameters
        ----------
        law, quantity, name : str
        stage : str, optional
            Not for measurements.
        """
        found = self._beside.get((law, quantity, name, None if quantity == "measurement" else stage))
        if found is None:
            return _UNKNOWN, _UNKNOWN
        value, tight = found
        change = float(np.mean(tight - value))
        if len(value) < 2:
            return _effect(change, float(value[0]) if quantity != "measurement" else 0.0), _UNKNOWN
        spread, tight_spread = (6 * float(np.std(x, ddof=1)) for x in (value, tight))
        return (
            _effect(change, spread if quantity == "measurement" else float(np.mean(value))),
            _effect(tight_spread - spread, spread),
        )

    @cached_property
    def _beside(self) -> dict[tuple, tuple[np.ndarray, np.ndarray]]:
        """Values in the run and on the tighter path, of the repetitions that converged."""
        groups = self.pairs[self.pairs["converged"]].groupby(["law", "quantity", "name", "stage"], sort=False)
        return {
            (law, quantity, name, None if quantity == "measurement" else stage): (
                rows["value"].to_numpy(),
                rows["tighter"].to_numpy(),
            )
            for (law, quantity, name, stage), rows in groups
        }


_UNKNOWN = Effect(float("nan"), float("nan"))


def _effect(change: float, figure: float) -> Effect:
    return Effect(change, change / figure if figure >= SMALLEST else float("nan"))


def read_path_study(folder: Path) -> PathStudy | None:
    """The study as the run stored it; None where it stored none.

    Raises
    ------
    FormatError
        If a file is not what :data:`mic.results.schema.PATH` or :data:`~mic.results.schema.PATH_ERRORS` declares.
    """

    pairs, errors = (table.read(folder, "call `mic report` on the run folder") for table in (PATH, PATH_ERRORS))
    return None if pairs is None or errors is None else PathStudy(pairs, errors)
