"""One run, from a scene to its results folder: reduced model, Monte Carlo, statistics, fields.

The report is drawn afterwards from the folder alone, see :mod:`mic.report.page`.
"""

from __future__ import annotations

import os
import time
from collections.abc import Callable, Iterator, Sequence
from contextlib import AbstractContextManager, ExitStack, contextmanager, nullcontext
from pathlib import Path

import numpy as np
import pandas as pd

from mic.compliance.coefficients import InfluenceCoefficients
from mic.errors import SceneError
from mic.execution.monte_carlo import blocks, monte_carlo
from mic.execution.ranks import communicator, on_first, shared
from mic.geometry.mesh_summary import repair_summary
from mic.model.assembly import Assembly, assemble
from mic.model.mesh_accuracy import estimate_accuracy
from mic.model.overlap import frozen_gaps
from mic.plausibility import find_warnings, find_warnings_unplaced, loadable_parts, raise_warnings
from mic.process.evaluation import Evaluation
from mic.process.model import ReducedModel
from mic.process.plan import plan_assembly
from mic.process.stiffness import coefficients
from mic.results.block_samples import BlockSamples
from mic.results.contact_sums import Sums
from mic.results.cost_estimate import duration, forecast
from mic.results.fields import write_fields
from mic.results.low_rank_forces import Condensed
from mic.results.mesh_error import write_accuracy
from mic.results.outcome import Outcome, TableCache, read_outcome
from mic.results.run_folder import Block, RunFolder, keeps, versions
from mic.results.run_identity import identity, inputs
from mic.results.sample_tables import tables
from mic.results.schema import CONTACTS
from mic.results.table_writer import write_path_study, write_summary, write_tables
from mic.scene import Scene
from mic.system.files import clean
from mic.system.lock import locked

__all__ = ["Progress", "conclude", "finished", "hold", "read_run", "run", "sample_into", "write_evaluation"]

GROWTH = 1.3  # factor on the samples between two accuracy checks
LONG = 3600.0  # s; a longer run reports its expected time before it starts


class Progress:
    """Callbacks of a run; these do nothing."""

    def report(self, sentence: str) -> None:
        """Show one line of text to the user."""

    def sampling(self, laws: Sequence[str], samples: int) -> AbstractContextManager[Callable[[str, int], None]]:
        """Context of the Monte Carlo; its value is called with (law, number of samples) after each block."""
        return nullcontext(lambda law, count: None)

    def statistics_ready(self, outcome: Outcome) -> None:
        """Called with samples and path study complete, before tables and fields are written."""


def run(
    scene: Scene,
    folder: Path,
    cache: Path,
    listener: Progress | None = None,
    replace: bool = False,
    strict: bool = False,
) -> Outcome | None:
    """Run the Monte Carlo of a scene into a results folder.

    Influence coefficients and meshes are computed once and cached. Finished samples of the same run are reused, see
    :func:`sample_into`. Under MPI this is a collective call.

    Parameters
    ----------
    scene : Scene
    folder : Path
    cache : Path
        Folder of generated meshes and influence coefficients.
    listener : Progress, optional
    replace : bool
        Whether results of another run in the folder may be removed.
    strict : bool
        Whether a scene that :mod:`mic.plausibility` warns of is refused.

    Returns
    -------
    Outcome or None
        None on all processes but the first.

    Raises
    ------
    SceneError, MissingProvider, RunError, FormatError, StorageError
    """
    world, clock, folder = communicator(), _Clock(), Path(folder)
    listener = listener or Progress()
    with hold(folder, listener):
        clean([Path(cache) / "meshes", Path(cache) / "influence"])
        with clock("meshes and pairs"):
            listener.report(f"{scene.name}: meshing and pairing …")
            say = lambda line: listener.report(f"{line} …")
            assembly, warnings = on_first(world, lambda: _assembled(scene, cache, say, listener, strict))
            _report_repairs(assembly, listener)
            scene = assembly.scene  # that of the first process, in case the file has changed
        laws, samples, seed = scene.report.laws, scene.monte_carlo.samples, scene.monte_carlo.seed

        def prepare() -> None:
            expected = forecast(assembly, laws, samples, cores=len(os.sched_getaffinity(0)))
            expected.check(folder)
            if expected.seconds > LONG:
                listener.report(f"{samples} samples under {len(laws)} laws: {expected}")
            _prepare(folder, assembly, laws, samples, seed, listener, replace, warnings)
            RunFolder(folder).keep_inputs(assembly)

        on_first(world, prepare)  # reject an unusable folder before computing
        with clock("influence coefficients"):
            influence, cached = coefficients(assembly, cache, say, world)
            reused = [name for name, hit in cached.items() if hit]
            if reused:
                listener.report(f"influence coefficients of {', '.join(reused)}: reused from {cache}")
        if scene.report.accuracy:
            with clock("accuracy of the meshes"):
                on_first(world, lambda: write_accuracy(folder, estimate_accuracy(assembly, cache, say)))
        with clock("reduced model"):
            model = shared(world, lambda: _reduced(assembly, influence))
            influence.clear()  # the model holds it
            notes = model.process().redundant + frozen_gaps(model)
            for sentence in notes:
                listener.report(f"note: {sentence}")
        with clock("Monte Carlo"):
            written = TableCache()
            found = _sampled(folder, model, laws, samples, seed, listener, written)
            samples = on_first(world, lambda: RunFolder(folder).record()["samples"])
        if world is not None and world.rank > 0:
            return None
        for law, count in found.items():
            if count:
                listener.report(f"{law}: {count} of {samples} samples found finished in {folder}")
        return conclude(folder, clock.seconds, listener, cache, model, written)


def sample_into(
    folder: Path,
    model: ReducedModel,
    laws: Sequence[str],
    samples: int,
    seed: int,
    listener: Progress | None = None,
    replace: bool = False,
) -> dict[str, int]:
    """The Monte Carlo of a reduced model into a results folder, without statistics; under MPI a collective call.

    Finished samples of the same run (:mod:`mic.results.run_identity`) stay in the folder, including those beyond the
    requested number or of other laws; a folder of another run is refused.

    Parameters
    ----------
    folder : Path
    model : ReducedModel
    laws : sequence of str
    samples, seed : int
    listener : Progress, optional
    replace : bool
        Whether results of another run in the folder may be removed.

    Returns
    -------
    dict of str to int
        Samples per law that were found finished.

    Raises
    ------
    RunError, StorageError
    """
    folder, listener = Path(folder), listener or Progress()
    with hold(folder, listener):
        on_first(communicator(), lambda: _prepare(folder, model, laws, samples, seed, listener, replace))
        return _sampled(folder, model, laws, samples, seed, listener, TableCache())


def _assembled(scene: Scene, cache: Path, say, listener: Progress, strict: bool) -> tuple[Assembly, list[str]]:
    """The assembly with a valid process plan, and its warnings, which are reported at once."""
    try:
        assembly = assemble(scene, cache, progress=say, check=plan_assembly)
        plan_assembly(assembly)
    except SceneError:
        for warned in find_warnings_unplaced(scene, loadable_parts(scene, cache)):
            listener.report(f"warning: {warned}")
        raise
    warnings = find_warnings(scene, assembly, cache)
    if strict:
        raise_warnings(warnings)
    for warned in warnings:
        listener.report(f"warning: {warned}")
    return assembly, [str(warned) for warned in warnings]


def _report_repairs(assembly: Assembly, listener: Progress) -> None:
    """Report the repairs of the parts' meshes."""
    for part in assembly.scene.parts:
        if part.name in assembly.decks:
            for sentence in repair_summary(part, assembly.decks[part.name]):
                listener.report(f"note: {sentence}")


def _reduced(assembly: Assembly, influence: dict[str, InfluenceCoefficients]) -> ReducedModel:
    """The reduced model, including what all laws share."""
    model = ReducedModel.build(assembly, influence)
    model.eliminations  # noqa: B018
    model.forecast  # noqa: B018
    return model


def _prepare(
    folder, source: Assembly | ReducedModel, laws, samples, seed, listener, replace, warnings: Sequence[str] = ()
) -> None:
    """Prepare the folder for a run, or raise if it belongs to another run."""
    record = {
        "scene": source.scene.name,
        "samples": samples,
        "seed": seed,
        "laws": list(laws),
        "identity": identity(source, seed),
        "inputs": inputs(source, seed),
        "versions": versions(),
        "warnings": list(warnings),
    }
    for sentence in RunFolder(folder).prepare(record, source.scene.report, replace):
        listener.report(sentence)


def _sampled(folder, model: ReducedModel, laws, samples, seed, listener, written: TableCache) -> dict[str, int]:
    """Sample until the required accuracy or number of samples is reached.

    Checks come after whole blocks, each with a third more samples, so that an interrupted run draws the same ones.
    """
    accuracy, world = model.scene.monte_carlo.accuracy, communicator()
    if accuracy is None:
        return _sample(folder, model, laws, samples, seed, listener, written)
    ends = [first + count for _, first, count in blocks(laws[:1], samples, len(model.contacts))]
    store, judged = RunFolder(folder), 0
    found: dict[str, int] = {}

    def look() -> float:
        """Uncertainty of 6σ with these samples, which become the number the folder needs."""
        store.write_record(store.record() | {"samples": judged})
        return read_outcome(folder, model, written).uncertainty

    for end in ends:
        if end < GROWTH * judged and end < samples:
            continue
        judged = end
        reused = _sample(folder, model, laws, end, seed, listener, written)
        found = found or reused
        left = on_first(world, look)
        if left <= accuracy or end == samples:
            enough = "" if left <= accuracy else "; more samples may be had by --samples"
            listener.report(f"{end} samples: every 6σ is known to {left:.2%} ({accuracy:.2%} asked for){enough}")
            break
    return found


def _sample(folder, model: ReducedModel, laws, samples, seed, listener, written: TableCache) -> dict[str, int]:
    """Compute and write the missing samples of a prepared folder."""
    store, world = RunFolder(folder), communicator()
    whose = identity(model, seed)
    there: dict[str, np.ndarray] = {}

    def start() -> None:
        model.save(store.path / "model.npz")
        there.update({law: store.finished(law, samples) for law in laws})

    on_first(world, start)

    def done(law: str, first: int, count: int) -> bool:
        start, stop = np.searchsorted(there[law], (first, first + count))
        return bool(stop - start == count)

    def sink(law: str, first: int, evaluation: Evaluation) -> dict[str, pd.DataFrame] | None:
        block = Block(law, first, len(evaluation.deviations))
        found = write_evaluation(store, block, whose, model, evaluation)
        first_process = world is None or world.rank == 0  # which makes the statistics
        return found if first_process and written.keep(block, found) else None

    def take(law: str, first: int, count: int, found: dict[str, pd.DataFrame] | None) -> None:
        if found is not None:
            written.keep(Block(law, first, count), found)

    def expect(seconds: float) -> None:
        if seconds > LONG:
            listener.report(
                f"The remaining samples take about {duration(seconds)}, estimated from the first. Finished samples "
                'stay stored if the run is stopped; path = "one-step" in the stages takes a fraction.'
            )

    with listener.sampling(laws, samples) as advance:
        return monte_carlo(model, laws, samples, seed, sink, done, advance, expect, take)


def write_evaluation(
    store: RunFolder, block: Block, identity: str, model: ReducedModel, evaluation: Evaluation
) -> dict[str, pd.DataFrame]:
    """Write the tables of a block of samples, and its forces if fields are requested; returns the tables.

    Contact pairs and forces are stored for as many samples as the scene's report states; sums for the others.
    """
    found, report = tables(model, evaluation, block.first), model.scene.report
    if keeps(report, block):
        forces = {"force": evaluation.functional_force, "motion": evaluation.motion} if report.fields else None
        store.write_block(block, identity, found, forces)
        return found
    samples = BlockSamples(found, len(model.contacts), block.first + block.count)
    sums, condensed = Sums.of(samples, model), None
    del found[CONTACTS.name]
    if report.fields:
        force, motion, own = evaluation.functional_force, evaluation.motion, samples.valid
        each = zip(model.compliance.functionals, model.compliance.motions)
        condensed = tuple(Condensed.of(force[own, rows], motion[own, columns]) for rows, columns in each)
    store.write_block(block, identity, found, sums=sums, condensed=condensed)
    return found


@contextmanager
def hold(folder: Path, listener: Progress | None = None) -> Iterator[None]:
    """Hold the lock of a results folder (:mod:`mic.system.lock`); under MPI the first process does, for all.

    Raises
    ------
    RunError, StorageError
        On all processes.
    """
    with ExitStack() as stack:

        def take() -> None:
            if stack.enter_context(locked(folder)):
                (listener or Progress()).report(
                    f"{folder}: taking over the lock of an interrupted run."
                )

        on_first(communicator(), take)
        yield


def finished(folder: Path, laws: Sequence[str], samples: int) -> int:
    """Number of requested samples that are finished in a results folder, over all laws."""
    store = RunFolder(Path(folder))
    return sum(int((store.finished(law, samples) < samples).sum()) for law in laws)


def conclude(
    folder: Path,
    wall_time: dict[str, float] | None = None,
    listener: Progress | None = None,
    cache: Path | None = None,
    model: ReducedModel | None = None,
    written: TableCache | None = None,
) -> Outcome:
    """Statistics and fields of a results folder, finished or interrupted, computed anew from its samples.

    Parameters
    ----------
    folder : Path
    wall_time : dict of str to float, optional
        Seconds by phase so far, for the record.
    listener : Progress, optional
    cache : Path, optional
        The cache folder, where fields of unit forces are kept; default: fields are solved for.
    model : ReducedModel, optional
        Model of the run, if already loaded.
    written : mic.results.outcome.TableCache, optional
        Tables in memory.

    Raises
    ------
    RunError, FormatError, StorageError
    """
    clock, folder = _Clock(), Path(folder)
    RunFolder(folder).record()  # raises if the folder holds no run
    with locked(folder):
        return _conclude(folder, clock, wall_time or {}, listener or Progress(), cache, model, written)


def _conclude(
    folder: Path,
    clock: _Clock,
    wall_time: dict[str, float],
    listener: Progress,
    cache: Path | None,
    model: ReducedModel | None,
    written: TableCache | None,
) -> Outcome:
    with clock("statistics"):
        outcome = read_outcome(folder, model, written)
        for sentence in outcome.damaged:
            listener.report(sentence)
    with clock("error of the path"):
        write_path_study(outcome)
    listener.statistics_ready(outcome)
    with clock("statistics"):
        write_tables(outcome)
    with clock("fields"):
        if outcome.model.scene.report.fields:
            write_fields(folder, outcome, cache)
    outcome.record.update(RunFolder(folder).add_wall_time(wall_time | clock.seconds))
    write_summary(outcome)
    return outcome


def read_run(folder: Path) -> Outcome:
    """The results of a run, finished or interrupted.

    Raises
    ------
    RunError, FormatError
    """
    return read_outcome(folder)


class _Clock:
    """Wall time by phase, s."""

    def __init__(self):
        self.seconds: dict[str, float] = {}

    @contextmanager
    def __call__(self, phase: str) -> Iterator[None]:
        start = time.perf_counter()
        yield
        self.seconds[phase] = self.seconds.get(phase, 0.0) + time.perf_counter() - start
