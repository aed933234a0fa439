"""One run, from a scene to its results folder: reduced model, Monte Carlo, statistics, fields.

The report is drawn afterwards from the folder alone, see :mod:`mic.report.page`.
"""

from __future__ import annotations

import time
from collections.abc import Callable, Iterator, Sequence
from contextlib import AbstractContextManager, contextmanager, nullcontext
from pathlib import Path

from threadpoolctl import threadpool_limits

from mic.compliance.cache import influence_coefficients
from mic.compliance.part import Part
from mic.model.assembly import assemble
from mic.process.evaluation import Evaluation
from mic.process.model import ReducedModel
from mic.results.fields import write_fields
from mic.results.folder import Block, RunFolder, identity, versions
from mic.results.outcome import Outcome, read_outcome
from mic.results.summary import write_summary, write_tables
from mic.results.tables import tables
from mic.sampling.montecarlo import blocks, monte_carlo
from mic.sampling.ranks import communicator, on_first
from mic.scene import Scene

__all__ = ["Listener", "conclude", "read_run", "run", "sample_into"]


class Listener:
    """What a run tells while it goes on; this one hears nothing."""

    def say(self, sentence: str) -> None:
        """One line of text for the user."""

    def sampling(self, laws: Sequence[str], samples: int) -> AbstractContextManager[Callable[[str, int], None]]:
        """Entered for the Monte Carlo; what it gives is called with (law, number of samples) after each block."""
        return nullcontext(lambda law, count: None)


def run(scene: Scene, folder: Path, cache: Path, listener: Listener | None = None) -> Outcome | None:
    """Run the Monte Carlo of a scene into a results folder.

    Influence coefficients and meshes are computed once and cached. Finished blocks of samples of the same run are kept.
    Under MPI a collective call that shares the samples out.

    Parameters
    ----------
    scene : Scene
    folder : Path
    cache : Path
        Folder of generated meshes and influence coefficients.
    listener : Listener, optional

    Returns
    -------
    Outcome or None
        None on all processes but the first.

    Raises
    ------
    SceneError, MissingProvider, FormatError
    """
    world, clock, folder = communicator(), _Clock(), Path(folder)
    listener = listener or Listener()
    with clock("meshes and pairs"):
        listener.say(f"{scene.name}: meshing and pairing …")
        assembly = on_first(world, lambda: assemble(scene, cache))
        scene = assembly.scene  # the first process's, should the file have changed meanwhile
    with clock("influence coefficients"):
        influence, cached = influence_coefficients(assembly, cache, lambda line: listener.say(f"{line} …"), world)
        reused = [name for name, hit in cached.items() if hit]
        if reused:
            listener.say(f"influence coefficients of {', '.join(reused)}: reused from {cache}")
    with clock("reduced model"):
        with threadpool_limits(limits=1, user_api="blas"):  # the same bits on every process and for any number of them
            model = ReducedModel.build(assembly, influence)
        for sentence in model.process().redundant:
            listener.say(f"note: {sentence}")
    on_first(world, lambda: RunFolder(folder).keep_inputs(assembly))
    laws, samples, seed = scene.report.laws, scene.monte_carlo.samples, scene.monte_carlo.seed
    with clock("Monte Carlo"):
        found = sample_into(folder, model, laws, samples, seed, assembly.parts, listener)
    if world is not None and world.rank > 0:
        return None
    for law, count in found.items():
        if count:
            listener.say(f"{law}: {count} of {samples} samples found finished in {folder}")
    return conclude(folder, clock.seconds, listener)


def sample_into(
    folder: Path,
    model: ReducedModel,
    laws: Sequence[str],
    samples: int,
    seed: int,
    parts: Sequence[Part] = (),
    listener: Listener | None = None,
) -> dict[str, int]:
    """The Monte Carlo of a reduced model into a results folder, without statistics; under MPI a collective call.

    Parameters
    ----------
    folder : Path
        Finished blocks of the same run that it holds already are kept; those of another are removed.
    model : ReducedModel
    laws : sequence of str
    samples, seed : int
    parts : sequence of Part, optional
        The parts that the model was reduced from, see :func:`mic.results.folder.identity`.
    listener : Listener, optional

    Returns
    -------
    dict of str to int
        Samples per law that were found finished.
    """
    store, world, listener = RunFolder(Path(folder)), communicator(), listener or Listener()
    fields = model.scene.report.fields

    def prepare() -> str:
        whose = identity(model, seed, parts)
        record = {
            "scene": model.scene.name,
            "samples": samples,
            "seed": seed,
            "laws": list(laws),
            "identity": whose,
            "versions": versions(),
        }
        wanted = [Block(*block) for block in blocks(laws, samples, len(model.contacts))]
        for sentence in store.prepare(record, wanted, fields):
            listener.say(sentence)
        model.save(store.path / "model.npz")
        return whose

    whose = on_first(world, prepare)

    def sink(law: str, first: int, evaluation: Evaluation) -> None:
        forces = {"force": evaluation.functional_force, "motion": evaluation.motion} if fields else None
        block = Block(law, first, len(evaluation.deviations))
        store.write_block(block, whose, tables(model, evaluation, first), forces)

    def done(law: str, first: int, count: int) -> bool:
        return store.has_block(Block(law, first, count))

    with listener.sampling(laws, samples) as advance:
        return monte_carlo(model, laws, samples, seed, sink, done, advance)


def conclude(folder: Path, wall_time: dict[str, float] | None = None, listener: Listener | None = None) -> Outcome:
    """Statistics and fields of a results folder, finished or interrupted, computed anew from its samples.

    Parameters
    ----------
    folder : Path
    wall_time : dict of str to float, optional
        Seconds by phase so far, for the record.
    listener : Listener, optional

    Raises
    ------
    RunError, FormatError
    """
    clock, folder = _Clock(), Path(folder)
    with clock("statistics"):
        outcome = read_outcome(folder)
        for sentence in outcome.damaged:
            (listener or Listener()).say(sentence)
        write_tables(outcome)
    with clock("fields"):
        if outcome.model.scene.report.fields:
            write_fields(folder, outcome)
    outcome.record.update(RunFolder(folder).add_wall_time((wall_time or {}) | clock.seconds))
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
