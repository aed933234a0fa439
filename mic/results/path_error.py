"""Path error of a run: its first samples repeated on a tighter load path.

Both runs use the same assemblies, so their differences contain no sampling scatter and a dozen samples suffice.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pandas as pd

from mic.contact.laws import LAWS
from mic.contact.path import Increments
from mic.contact.path import Path as ContactPath
from mic.process.process import Process
from mic.results.path_effect import PathStudy
from mic.results.run_samples import RunSamples
from mic.results.sample_tables import tables
from mic.results.schema import SLIPS
from mic.system.cores import available_cores

__all__ = ["SAMPLES", "study_path", "tighter"]

SAMPLES = 12  # first valid samples that are repeated
TOLERANCE = 1 / 16  # factor on the path tolerance; the error is of second order and falls to about a sixth
INCREMENTS = 4  # factor on the increments; the error is of first order and falls to a quarter
_ZONES = ("rms_tangential", "rms_slip")


def tighter(path: ContactPath) -> ContactPath:
    """A path with smaller tolerance or more increments."""
    if isinstance(path, Increments):
        return Increments(INCREMENTS * path.count)
    return replace(path, tolerance=TOLERANCE * path.tolerance)


def study_path(outcome: RunSamples) -> PathStudy | None:
    """Repeat the first valid samples of every law with friction on a tighter path.

    Returns
    -------
    PathStudy or None
        None if no path is followed: no contacts, no friction or no valid samples.
    """
    laws = [law for law in outcome.laws if LAWS[law].frictional and len(outcome.with_pairs(law))]
    if not (outcome.has_slip and outcome.stages and laws):
        return None
    studies = [_repeat(outcome, law, outcome.with_pairs(law)[:SAMPLES]) for law in laws]
    pairs, errors = (pd.concat(frames, ignore_index=True) for frames in zip(*studies))
    return PathStudy(pairs, errors)


def _repeat(outcome, law, numbers) -> tuple[pd.DataFrame, pd.DataFrame]:
    """The tables PATH and PATH_ERRORS of one law, for samples with these numbers."""
    model = outcome.model
    backend, threads = model.scene.monte_carlo.backend, available_cores()
    deviations = np.column_stack(
        [np.zeros((len(numbers), 0)), *(outcome.deviation(law, name, numbers) for name in model.parameters)]
    )
    process = Process(model, law, backend=backend, threads=threads)
    for stage in process.stages:
        stage.path = tighter(stage.path)
    evaluation = process.attempt(deviations)
    motion = tables(model, evaluation)[SLIPS.name]
    converged = ~evaluation.failed
    last = process.stages[-1].plan.name
    rows = [
        ("measurement", last, item.name, outcome.measured(law, item.name, numbers), evaluation.measurements[:, k])
        for k, item in enumerate(model.scene.measurements[: evaluation.measurements.shape[1]])
    ]
    for stage in outcome.stages:
        for zone in outcome.zones:
            repeated = motion[(motion["stage"] == stage) & (motion["zone"] == zone)]
            for column, read in zip(_ZONES, (outcome.tangential, outcome.slip)):
                rows.append((column, stage, zone, read(law, stage, zone, numbers), repeated[column].to_numpy()))
    keys, columns = {"law": law, "sample": numbers.astype(np.int64)}, ("quantity", "stage", "name", "value", "tighter")
    pairs = [pd.DataFrame(keys | dict(zip(columns, row)) | {"converged": converged}) for row in rows]
    return pd.concat(pairs, ignore_index=True), _errors(outcome, law, numbers, evaluation, converged)


def _errors(outcome, law, numbers, evaluation, converged) -> pd.DataFrame:
    """Estimated and measured path errors of one law; tangential positions are the sum over the stages so far."""
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
