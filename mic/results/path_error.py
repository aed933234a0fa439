"""Path error of a run: its first samples repeated on a tighter load path.

Both runs use the same assemblies, so their differences contain no sampling scatter and a dozen samples suffice.
"""

from __future__ import annotations

from dataclasses import replace
from functools import partial

import numpy as np
import pandas as pd

from mic.contact.laws import LAWS
from mic.contact.path import Increments
from mic.contact.path import Path as ContactPath
from mic.contact.second_start import has_other_solution
from mic.contact.solver import ContactSolver
from mic.process.process import Process
from mic.results.path_effect import PathStudy
from mic.results.run_samples import RunSamples
from mic.results.sample_tables import tables
from mic.results.schema import SLIPS
from mic.system.cores import available_cores

__all__ = ["SAMPLES", "other_solution_of", "study_path", "tighter"]

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
    process = Process(model, law, backend=backend, threads=threads)
    several = {stage.plan.name: np.zeros(len(numbers), dtype=bool) for stage in process.stages}
    for stage in process.stages:
        stage.path = tighter(stage.path)
        if LAWS[law].followed and model.contacts.dimension == 3:
            stage.inspect = partial(_note_other_solutions, model, law, stage.plan.name, several)
    evaluation = process.attempt(outcome.deviations(law, numbers))
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
    return pd.concat(pairs, ignore_index=True), _errors(outcome, law, numbers, evaluation, several)


def _note_other_solutions(model, law, stage, several, eliminated, state, solution) -> None:
    """Note the samples in which the pairs that carry force in a step could also carry other forces."""
    n, m = solution.force.shape[0], len(model.contacts)
    force = solution.force.reshape(n, m, 3)
    if len(several[stage]) != n:  # a part of the samples, with a model of their own
        return
    S, friction = eliminated.compliance[0], model.contacts.friction_in(stage)
    for sample in np.flatnonzero(solution.converged & ~several[stage]):
        own = np.flatnonzero((force[sample, :, 0] > 0) | (state.force[sample, :, 0] > 0))
        if not len(own):
            continue
        several[stage][sample] = other_solution_of(S, friction, law, state, solution, sample, own)


def other_solution_of(S, friction, law, state, solution, sample: int, own: np.ndarray) -> bool:
    """Whether the pairs `own` could also carry other forces than a sample's after a step.

    Parameters
    ----------
    S : (3m, 3m) Columns
        mm/N.
    friction : Friction
    law : str
    state : mic.process.state.ProcessState
        Before the step.
    solution : mic.contact.path.PathSolution
        Of the step, for n samples.
    sample : int
        One of them.
    own : (k,) int array
    """
    rows = (3 * own[:, None] + np.arange(3)).ravel()
    block = S.block(rows)
    load = (solution.displacement[sample, rows] - block @ solution.force[sample, rows]).reshape(-1, 3)
    load[:, 1:] -= state.anchor[sample, own]
    solver = ContactSolver(block, friction.take(own), law, certify_each=False)
    return bool(has_other_solution(solver, load.reshape(1, -1))[0])


def _errors(outcome, law, numbers, evaluation, several) -> pd.DataFrame:
    """Estimated and measured path errors of one law; tangential positions are the sum over the stages so far."""
    frames = []
    change = np.zeros((len(numbers), len(outcome.model.contacts), 2))
    for stage in outcome.stages:
        again, components = evaluation.resolutions[stage], ("n", "t1", "t2")
        moved, force = (
            np.stack([outcome.contact(law, stage, f"{what}_{axis}", numbers) for axis in axes], axis=2)
            for what, axes in (("u", components[1:]), ("f", components))
        )
        change = change + again.displacement[:, :, 1:] - moved
        force = again.force - force
        frames.append(
            pd.DataFrame(
                {
                    "law": law,
                    "sample": numbers.astype(np.int64),
                    "stage": stage,
                    "estimate": outcome.path_error(law, stage, numbers),
                    "measured": _size(change),
                    "force_estimate": outcome.path_force_error(law, stage, numbers),
                    "normal_measured": _size(force[:, :, :1]),
                    "friction_measured": _size(force[:, :, 1:]),
                    "several": several[stage],
                    "converged": ~evaluation.failed,
                }
            )
        )
    return pd.concat(frames, ignore_index=True)


def _size(vectors: np.ndarray) -> np.ndarray:
    """(n,) root mean square over the pairs of vectors (n, m, k)."""
    return np.sqrt((vectors**2).sum(axis=2).mean(axis=1))
