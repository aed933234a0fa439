"""One run, from a scene to its results folder: reduced model, Monte Carlo, statistics, fields.

The report is drawn afterwards from the folder alone, see :mod:`mic.report.page`.
"""

from __future__ import annotations

import sys
import time
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from contextlib import AbstractContextManager, ExitStack, contextmanager, nullcontext
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd

from mic.compliance.coefficients import InfluenceCoefficients, solver_versions
from mic.errors import SceneError
from mic.execution.engine import Engine, choose
from mic.execution.monte_carlo import blocks, monte_carlo
from mic.execution.ranks import communicator, on_first, shared
from mic.geometry.mesh_summary import repair_summary
from mic.model.assembly import Assembly
from mic.model.mesh_accuracy import estimate_accuracy
from mic.model.overlap import frozen_gaps
from mic.plausibility import find_warnings, find_warnings_unplaced, loadable_parts, raise_warnings
from mic.process.evaluation import Evaluation
from mic.process.feasible_assembly import assemble_feasible
from mic.process.model import ReducedModel
from mic.process.stiffness import coefficients
from mic.process.stiffness_choice import stiffness_sentences
from mic.results.block_samples import BlockSamples
from mic.results.block_statistics import Accumulator
from mic.results.contact_sums import ContactSums
from mic.results.cost_estimate import duration, forecast
from mic.results.fields import write_fields
from mic.results.improved import FURTHER
from mic.results.low_rank_forces import CompressedForces
from mic.results.mesh_error import FinerModel, accuracy_table, mesh_changes
from mic.results.outcome import CACHE_SIZE, BlockCache, Outcome, memory, read_outcome
from mic.results.output_samples import OutputSamples
from mic.results.required_accuracy import Uncertainty
from mic.results.run_folder import Block, RunFolder, stores_pairs, versions
from mic.results.run_identity import identity, inputs
from mic.results.sample_tables import tables
from mic.results.schema import ACCURACY, CONDENSED, CONTACTS, FORCES, MESH_CHANGES, SUMS, Table
from mic.results.table_writer import write_path_study, write_summary, write_tables
from mic.scene import Scene
from mic.scene.settings import AUTO
from mic.setting_choice import Choice
from mic.setting_choice import choose as choose_setting
from mic.system.arguments import checked
from mic.system.cores import available_cores
from mic.system.files import clean
from mic.system.lock import locked
from mic.system.progress_bar import ProgressBar

__all__ = ["Progress", "conclude", "finished", "hold", "read_run", "run", "sample_into", "write_evaluation"]

GROWTH = 1.3  # factor on the samples between two checks of the accuracy
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


class BarProgress(Progress):
    """Prints sentences, and a bar of the samples, on the standard error stream.

    Parameters
    ----------
    shown : bool or None
        As for :class:`mic.system.progress_bar.ProgressBar`.
    """

    def __init__(self, shown: bool | None):
        self._shown = shown

    def report(self, sentence: str) -> None:
        if ProgressBar(self._shown).shown:
            print(sentence, file=sys.stderr)

    @contextmanager
    def sampling(self, laws: Sequence[str], samples: int) -> Iterator[Callable[[str, int], None]]:
        with ProgressBar(self._shown, samples * len(laws)) as bar:
            yield lambda law, count: bar.advance(count)


def _report_notes(progress: Progress, sentences: Iterable[str]) -> None:
    for sentence in sentences:
        progress.report(f"note: {sentence}")


@checked
def run(
    scene: Scene,
    folder: Path,
    cache: Path,
    progress: Progress | bool | None = None,
    replace: bool = False,
    strict: bool = False,
    engine: str | None = None,
) -> Outcome | None:
    """Run the Monte Carlo of a scene into a results folder.

    Meshes and influence coefficients are cached, finished samples of the same run reused. Collective under MPI.

    Parameters
    ----------
    scene : Scene
    folder : Path
    cache : Path
        Folder of generated meshes and influence coefficients.
    progress : Progress or bool, optional
        Or whether a bar is shown; default: after a second, in a notebook or an interactive session.
    replace : bool
        Whether results of another run in the folder may be removed.
    strict : bool
        Whether to refuse a scene that :mod:`mic.plausibility` warns of.
    engine : str, optional
        What evaluates the samples, as :func:`mic.execution.engine.choose` takes it: ``"local"``, ``"local:4"``,
        ``"mpi"``, ``"dask"``, ``"dask:ADDRESS"``. Default: all cores, under ``mpirun`` its processes.

    Returns
    -------
    Outcome or None
        None on all processes but the first.

    Raises
    ------
    SceneError, MissingProvider, RunError, FormatError, StorageError
    """
    world, clock, folder, chosen = communicator(), _Clock(), Path(folder), choose(engine)
    progress = progress if isinstance(progress, Progress) else BarProgress(progress)
    with hold(folder, progress):
        clean([Path(cache) / "meshes", Path(cache) / "influence"])
        with clock("meshes and pairs"):
            progress.report(f"{scene.name}: meshing and pairing …")
            report_line = lambda line: progress.report(f"{line} …")
            assembly, warnings, choice = on_first(world, lambda: _assemble(scene, cache, report_line, progress, strict))
            scene = assembly.scene  # that of the first process, in case the file has changed
        laws, samples, seed = scene.report.laws, scene.monte_carlo.samples, scene.monte_carlo.seed

        def prepare() -> None:
            expected = forecast(assembly, laws, samples, cores=available_cores())
            expected.check(folder)
            if expected.seconds > LONG:
                progress.report(f"{samples} samples under {len(laws)} laws: {expected}")
            _prepare(folder, assembly, laws, samples, seed, progress, replace, warnings)
            _store_inputs(folder, assembly, choice)

        on_first(world, prepare)  # refuse an unusable folder before computing
        with clock("influence coefficients"):
            influence, cached = coefficients(assembly, cache, report_line, world)
            on_first(world, lambda: RunFolder(folder).add_to_record("versions", solver_versions(influence.values())))
            if reused := [name for name, hit in cached.items() if hit]:
                progress.report(f"influence coefficients of {', '.join(reused)}: reused from {cache}")
        finer = None
        if scene.report.accuracy:
            with clock("accuracy of the meshes"):
                finer = _estimate_accuracy(folder, assembly, influence, cache, report_line, world)
        with clock("reduced model"):
            model = shared(world, lambda: _reduce(assembly, influence))
            influence.clear()  # the model holds it
            _report_notes(progress, _notes(folder, assembly, model, world))
        with clock("Monte Carlo"):
            cached_blocks = BlockCache()
            reused_samples = _sample_to_accuracy(folder, model, laws, samples, seed, progress, cached_blocks, chosen)
            samples = on_first(world, lambda: RunFolder(folder).record()["samples"])
        if world is not None and world.rank > 0:
            return None
        for law in (law for law, count in reused_samples.items() if count):
            progress.report(f"{law}: {reused_samples[law]} of {samples} samples were already finished in {folder}")
        return conclude(folder, clock.seconds, progress, cache, model, cached_blocks, finer)


def sample_into(
    folder: Path,
    model: ReducedModel,
    laws: Sequence[str],
    samples: int,
    seed: int,
    progress: Progress | None = None,
    replace: bool = False,
    engine: str | None = None,
) -> dict[str, int]:
    """Run the Monte Carlo of a reduced model into a results folder, without statistics; under MPI a collective call.

    Finished samples of the same run (:mod:`mic.results.run_identity`) stay in the folder, including those beyond the
    requested number or of other laws; a folder of another run is refused.

    Parameters
    ----------
    folder : Path
    model : ReducedModel
    laws : sequence of str
    samples, seed : int
    progress : Progress, optional
    replace : bool
        Whether results of another run in the folder may be removed.
    engine : str, optional
        As in :func:`run`.

    Returns
    -------
    dict of str to int
        Number of samples by law that were already finished.

    Raises
    ------
    RunError, StorageError
    """
    folder, progress = Path(folder), progress or Progress()
    with hold(folder, progress):
        on_first(communicator(), lambda: _prepare(folder, model, laws, samples, seed, progress, replace))
        return _sample_to_accuracy(folder, model, laws, samples, seed, progress, BlockCache(), choose(engine))


def _store_inputs(folder: Path, assembly: Assembly, choice: Choice | None) -> None:
    RunFolder(folder).store_inputs(assembly)
    if choice is not None:
        RunFolder(folder).add_to_record("setting", choice.record())


def _assemble(
    scene: Scene, cache: Path, report_line, progress: Progress, strict: bool
) -> tuple[Assembly, list[str], Choice | None]:
    """The assembly with a valid process plan, its warnings, which are reported at once, and what `auto` has chosen."""
    choice = choose_setting(scene, cache, progress.report) if scene.setting == AUTO else None
    scene = choice.scene if choice else scene
    try:
        assembly = assemble_feasible(scene, cache, report_line)
    except SceneError:
        for warning in find_warnings_unplaced(scene, loadable_parts(scene, cache)):
            progress.report(f"warning: {warning}")
        raise
    warnings = find_warnings(scene, assembly, cache)
    if strict:
        raise_warnings(warnings)
    for warning in warnings:
        progress.report(f"warning: {warning}")
    for part in (part for part in assembly.scene.parts if part.name in assembly.decks):
        _report_notes(progress, repair_summary(part, assembly.decks[part.name]))
    return assembly, [str(warning) for warning in warnings], choice


def _estimate_accuracy(folder, assembly: Assembly, influence, cache: Path, report_line, world) -> FinerModel | None:
    """Write the estimated mesh errors of the parts; returns the model on finer meshes, for the key characteristics."""
    estimated = lambda: accuracy_table(estimate_accuracy(assembly, cache, report_line))
    on_first(world, lambda: ACCURACY.write(folder, estimated()))
    return FinerModel.of(assembly, influence, cache, report_line, world)


def _notes(folder: Path, assembly: Assembly, model: ReducedModel, world) -> list[str]:
    """Notes on a model; what they say of its stiffness is recorded for the report."""
    of_stiffness = stiffness_sentences(assembly, model)
    on_first(world, lambda: RunFolder(folder).add_to_record("stiffness", {"sentences": of_stiffness}))
    said = assembly.scene.stiffness == "auto"  # before its influence coefficients were computed
    return [*model.process().redundant, *frozen_gaps(model), *([] if said else of_stiffness)]


def _reduce(assembly: Assembly, influence: dict[str, InfluenceCoefficients]) -> ReducedModel:
    """The reduced model, with the cached properties that all laws share."""
    model = ReducedModel.build(assembly, influence)
    model.eliminations  # noqa: B018
    model.forecast  # noqa: B018
    return model


def _prepare(
    folder, source: Assembly | ReducedModel, laws, samples, seed, progress, replace, warnings: Sequence[str] = ()
) -> None:
    """Prepare the folder for a run; raises RunError if it belongs to another run."""
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
        progress.report(sentence)


def _sample_to_accuracy(
    folder, model: ReducedModel, laws, samples, seed, progress: Progress, cached: BlockCache, engine: Engine
) -> dict[str, int]:
    """Sample until the required accuracy or number of samples is reached; returns the reused samples by law.

    The accuracy is checked after whole blocks, each time with a third more samples, so that an interrupted run
    continues with the same samples.
    """
    accuracy, world = model.scene.monte_carlo.accuracy, communicator()
    if accuracy is None:
        return _sample(folder, model, laws, samples, seed, progress, cached, engine)
    ends = [first + count for _, first, count in blocks(laws[:1], samples, len(model.contacts))]
    store, checked = RunFolder(folder), 0
    reused: dict[str, int] = {}

    def check() -> Uncertainty:
        """The largest uncertainty with these samples, which become the number of requested samples."""
        store.write_record(store.record() | {"samples": checked})
        return read_outcome(folder, model, cached).uncertainty(accuracy.required)

    for end in ends:
        if end < GROWTH * checked and end < samples:
            continue
        checked = end
        already_finished = _sample(folder, model, laws, end, seed, progress, cached, engine)
        reused = reused or already_finished
        _sample_one_step(folder, model, laws, (1 + FURTHER) * end, seed, engine)
        uncertainty = on_first(world, check)
        if uncertainty.reached or end == samples:
            progress.report(uncertainty.sentence(end))
            break
    return reused


def _sample(
    folder,
    model: ReducedModel,
    laws,
    samples,
    seed,
    progress: Progress,
    cached: BlockCache,
    engine: Engine,
) -> dict[str, int]:
    """Compute and write the missing samples of a prepared folder; returns the reused samples by law."""
    store = RunFolder(Path(folder).resolve())  # workers may have another working directory

    def start() -> dict[str, np.ndarray]:
        model.save(store.path / "model.npz")
        return {law: store.finished(law, samples) for law in laws}

    finished = on_first(communicator(), start)

    def done(law: str, first: int, count: int) -> bool:
        start, stop = np.searchsorted(finished[law], (first, first + count))
        return bool(stop - start == count)

    def take(law: str, first: int, count: int, written: tuple[Accumulator, Mapping[str, pd.DataFrame] | None]) -> None:
        cached.store(Block(law, first, count), *written)

    def expect(seconds: float) -> None:
        if seconds > LONG:
            progress.report(
                f"The remaining samples take about {duration(seconds)}, estimated from the first. Finished samples "
                'stay stored if the run is stopped; path = "one-step" in the stages takes a fraction.'
            )

    sink = _BlockWriter(store, model, identity(model, seed), len(laws))
    with progress.sampling(laws, samples) as advance:
        return monte_carlo(model, laws, samples, seed, sink, done, advance, expect, take, engine)


def _sample_one_step(folder, model: ReducedModel, laws, samples, seed, engine: Engine) -> None:
    """Compute and write the missing samples in one step, which show what few others do not."""
    one_step = model.one_step
    if one_step is None or not len(model.contacts):
        return
    store, run_identity = RunFolder(Path(folder).resolve()), identity(model, seed)
    finished = on_first(communicator(), lambda: {block for law in laws for block in store.one_step(law, run_identity)})
    monte_carlo(
        one_step,
        laws,
        samples,
        seed,
        _OneStepWriter(store, one_step, run_identity),
        lambda law, first, count: Block(law, first, count) in finished,
        engine=engine,
    )


@dataclass(frozen=True)
class _OneStepWriter:
    """Writes the blocks of samples in one step, in any process."""

    store: RunFolder
    model: ReducedModel
    identity: str

    def __call__(self, law: str, first: int, evaluation: Evaluation) -> None:
        block = Block(law, first, len(evaluation.deviations))
        samples = BlockSamples(tables(self.model, evaluation, first), len(self.model.contacts), block.end)
        self.store.write_one_step(block, self.identity, OutputSamples.of(samples, self.model))


@dataclass(frozen=True)
class _BlockWriter:
    """Writes the blocks of a run, in any process; returns their statistics, and the tables of the first ones."""

    store: RunFolder
    model: ReducedModel
    identity: str
    laws: int

    def __call__(
        self, law: str, first: int, evaluation: Evaluation
    ) -> tuple[Accumulator, Mapping[str, pd.DataFrame] | None]:
        block = Block(law, first, len(evaluation.deviations))
        tables, statistics = write_evaluation(self.store, block, self.identity, self.model, evaluation)
        cacheable = memory(tables) / block.count * block.end * self.laws <= CACHE_SIZE
        return statistics, tables if cacheable else None


def write_evaluation(
    store: RunFolder, block: Block, identity: str, model: ReducedModel, evaluation: Evaluation
) -> tuple[dict[str, pd.DataFrame], Accumulator]:
    """Write the tables of a block of samples, and its forces if fields are requested; returns tables and statistics.

    Contact pairs and forces are stored for as many samples as the scene's report states; sums for the others.
    """
    frames, report = tables(model, evaluation, block.first), model.scene.report
    force, motion = evaluation.functional_force, evaluation.motion
    samples = BlockSamples(frames, len(model.contacts), block.end)
    sums = ContactSums.of(samples, model)
    statistics = Accumulator.of(samples, model, sums)
    arrays: dict[Table, Any] = {}
    if stores_pairs(report, block):
        if report.fields:
            arrays[FORCES] = {"force": force, "motion": motion}
    else:
        arrays[SUMS], valid = sums, samples.valid
        del frames[CONTACTS.name]
        if report.fields:
            parts = zip(model.compliance.functionals, model.compliance.motions)
            compressed = (CompressedForces.of(force[valid, rows], motion[valid, columns]) for rows, columns in parts)
            arrays[CONDENSED] = tuple(compressed)
    store.write_block(block, identity, frames, arrays)
    return frames, statistics


@contextmanager
def hold(folder: Path, progress: Progress | None = None) -> Iterator[None]:
    """Hold the lock of a results folder (:mod:`mic.system.lock`); under MPI the first process holds it for all.

    Raises
    ------
    RunError, StorageError
        On all processes.
    """
    with ExitStack() as stack:

        def take() -> None:
            if stack.enter_context(locked(folder)):
                (progress or Progress()).report(f"{folder}: taking over the lock of an interrupted run.")

        on_first(communicator(), take)
        yield


def finished(folder: Path, laws: Sequence[str], samples: int) -> int:
    """Number of requested samples that are finished in a results folder, over all laws."""
    store = RunFolder(Path(folder))
    return sum(int((store.finished(law, samples) < samples).sum()) for law in laws)


def conclude(
    folder: Path,
    wall_time: dict[str, float] | None = None,
    progress: Progress | None = None,
    cache: Path | None = None,
    model: ReducedModel | None = None,
    cached: BlockCache | None = None,
    finer: FinerModel | None = None,
) -> Outcome:
    """Compute and write statistics and fields of a results folder, finished or interrupted, from its samples.

    Parameters
    ----------
    folder : Path
    wall_time : dict of str to float, optional
        Seconds by phase so far, for the record.
    progress : Progress, optional
    cache : Path, optional
        Cache folder, for fields of unit forces; default: no cache.
    model : ReducedModel, optional
        Model of the run, if already loaded.
    cached : mic.results.outcome.BlockCache, optional
        Blocks in memory.
    finer : mic.results.mesh_error.FinerModel, optional
        If given, the changes of the key characteristics on finer meshes are computed.

    Raises
    ------
    RunError, FormatError, StorageError
    """
    clock, folder, progress = _Clock(), Path(folder), progress or Progress()
    RunFolder(folder).record()  # raises if the folder holds no run
    with locked(folder):
        with clock("statistics"):
            outcome = read_outcome(folder, model, cached)
            for sentence in outcome.damaged:
                progress.report(sentence)
        with clock("error of the path"):
            write_path_study(outcome)
        if finer is not None:
            with clock("accuracy of the meshes"):
                MESH_CHANGES.write(folder, mesh_changes(outcome, finer), exact=True)
        progress.statistics_ready(outcome)
        with clock("statistics"):
            write_tables(outcome)
        with clock("fields"):
            if outcome.model.scene.report.fields:
                write_fields(folder, outcome, cache)
        seconds = {phase: round(s, 3) for phase, s in ((wall_time or {}) | clock.seconds).items()}
        outcome.record.update(RunFolder(folder).add_to_record("wall_time", seconds))
        write_summary(outcome)
    return outcome


@checked
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
