"""What the path left in the results of a run: its first samples once more on a tighter one, pair by pair.

The same assemblies on two paths differ by what the paths leave alone: no scatter comes between, so that a dozen of them
tell an effect that a dozen others would hide.
"""

from __future__ import annotations

import os
from dataclasses import dataclass, replace
from functools import cached_property
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
import pandas as pd

from mic.contact.laws import LAWS
from mic.contact.path import Increments
from mic.contact.path import Path as ContactPath
from mic.process.process import Process
from mic.results.sample_tables import tables
from mic.results.schema import PATH, PATH_ERRORS, SLIPS

if TYPE_CHECKING:
    from mic.results.outcome import Outcome

__all__ = ["SAMPLES", "SMALLEST", "Effect", "PathStudy", "read_path_study", "study_path", "tighter"]

SAMPLES = 12  # the first valid ones
TOLERANCE = 1 / 16  # of the path's: of second order, it leaves about a sixth of the error
INCREMENTS = 4  # times as many: of first order, they leave a quarter of the error
SMALLEST = 0.01  # mm: of less than this no share is told; a hundredth of it nobody can measure
_ZONES = ("rms_tangential", "rms_slip")


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


def tighter(path: ContactPath) -> ContactPath:
    """The path that a study compares with."""
    if isinstance(path, Increments):
        return Increments(INCREMENTS * path.count)
    return replace(path, tolerance=TOLERANCE * path.tolerance)


def study_path(outcome: Outcome) -> PathStudy | None:
    """Take the first valid samples of every law with friction through the process once more, on a tighter path.

    Returns
    -------
    PathStudy or None
        None where no path is followed: without contacts, friction or valid samples.
    """
    laws = [law for law in outcome.laws if LAWS[law].frictional and len(outcome.with_pairs(law))]
    if not (outcome.has_slip and outcome.stages and laws):
        return None
    found = [_repeat(outcome, law, outcome.with_pairs(law)[:SAMPLES]) for law in laws]
    pairs, errors = (pd.concat(frames, ignore_index=True) for frames in zip(*found))
    return PathStudy(pairs, errors)


def _repeat(outcome, law, numbers) -> tuple[pd.DataFrame, pd.DataFrame]:
    model = outcome.model
    backend, threads = model.scene.monte_carlo.backend, len(os.sched_getaffinity(0))
    deviations = np.column_stack(
        [np.zeros((len(numbers), 0)), *(outcome.deviation(law, name, numbers) for name in model.parameters)]
    )
    process = Process(model, law, backend=backend, threads=threads)
    for stage in process.stages:
        stage.path = tighter(stage.path)
    evaluation = process.attempt(deviations)
    again = tables(model, evaluation)
    converged = ~evaluation.failed
    last = process.stages[-1].plan.name
    rows = [
        ("measurement", last, item.name, outcome.measured(law, item.name, numbers), evaluation.measurements[:, k])
        for k, item in enumerate(model.scene.measurements[: evaluation.measurements.shape[1]])
    ]
    motion = again[SLIPS.name]
    for stage in outcome.stages:
        for zone in outcome.zones:
            own = motion[(motion["stage"] == stage) & (motion["zone"] == zone)]
            for column, read in zip(_ZONES, (outcome.tangential, outcome.slip)):
                rows.append((column, stage, zone, read(law, stage, zone, numbers), own[column].to_numpy()))
    pairs = [
        pd.DataFrame(
            {
                "law": law,
                "sample": numbers.astype(np.int64),
                "quantity": quantity,
                "stage": stage,
                "name": name,
                "value": value,
                "tighter": tight,
                "converged": converged,
            }
        )
        for quantity, stage, name, value, tight in rows
    ]
    return pd.concat(pairs, ignore_index=True), _errors(outcome, law, numbers, evaluation, converged)


def _errors(outcome, law, numbers, evaluation, converged) -> pd.DataFrame:
    """Tangential positions are what the stages so far moved."""
    frames = []
    change = np.zeros((len(numbers), len(outcome.model.contacts), 2))
    for stage in outcome.stages:
        moved = np.stack([outcome.contact(law, stage, f"u_t{axis}", numbers) for axis in (1, 2)], axis=2)
        change = change + evaluation.resolutions[stage].displacement[:, :, 1:] - moved
        frames.append(
            pd.DataFrame(
                {
                    "law": law,
                    "sample": numbers.astype(np.int64),
                    "stage": stage,
                    "estimate": outcome.path_error(law, stage, numbers),
                    "measured": np.sqrt((change**2).sum(axis=2).mean(axis=1)),
                    "converged": converged,
                }
            )
        )
    return pd.concat(frames, ignore_index=True)


def read_path_study(folder: Path) -> PathStudy | None:
    """The study as the run stored it; None where it stored none.

    Raises
    ------
    FormatError
        If a file is not what :data:`mic.results.schema.PATH` or :data:`~mic.results.schema.PATH_ERRORS` declares.
    """

    pairs, errors = (table.read(folder, "call `mic report` on the run folder") for table in (PATH, PATH_ERRORS))
    return None if pairs is None or errors is None else PathStudy(pairs, errors)
