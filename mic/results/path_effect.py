"""Effect of a tighter load path on means and 6σ, from repeated samples."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np
import pandas as pd

__all__ = ["SMALLEST", "UNKNOWN", "Effect", "PathStudy"]

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

    def several(self, law: str) -> int:
        """Number of samples in which a step has several solutions."""
        rows = self.errors[(self.errors["law"] == law) & self.errors["several"]]
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
        rows = self._groups.get((law, quantity, name, "" if measured else stage))
        if rows is None:
            return UNKNOWN, UNKNOWN
        value, tight = rows["value"].to_numpy(), rows["tighter"].to_numpy()
        change = float(np.mean(tight - value))
        if len(value) < 2:
            return Effect.of(change, 0.0 if measured else float(value[0])), UNKNOWN
        spread, tight_spread = (6 * float(np.std(x, ddof=1)) for x in (value, tight))
        return (
            Effect.of(change, spread if measured else float(np.mean(value))),
            Effect.of(tight_spread - spread, spread),
        )

    @cached_property
    def _groups(self) -> dict[tuple, pd.DataFrame]:
        """Repetitions that converged, by law, quantity, name and stage; without stage for measurements."""
        rows = self.pairs[self.pairs["converged"]]
        stage = rows["stage"].mask(rows["quantity"] == "measurement", "")
        return dict(list(rows.groupby([rows["law"], rows["quantity"], rows["name"], stage], sort=False)))
