"""Shared parts of the commands: load the scene or model, choose law and seed, report progress, store results."""

from __future__ import annotations

from contextlib import contextmanager
from functools import wraps

from rich.progress import BarColumn, MofNCompleteColumn, Progress, TextColumn, TimeElapsedColumn, TimeRemainingColumn

from mic.commands.output import CommandConsole
from mic.errors import RunError, SceneError
from mic.execution.ranks import alone, communicator
from mic.process.feasible_assembly import assemble_feasible
from mic.process.model import ReducedModel
from mic.process.stiffness import coefficients
from mic.results.run_folder import RunFolder
from mic.results.run_identity import identity
from mic.runs import Progress as RunProgress
from mic.runs import hold
from mic.scene import load_scene
from mic.scene.checks import find_errors
from mic.scene.schema import Accuracy
from mic.studies.samples import first_frictional
from mic.system.disk_cache import cache_folder

__all__ = [
    "ConsoleProgress",
    "choose_law",
    "first_rank_only",
    "load_model",
    "open_model",
    "reduce_source",
    "store_study",
    "with_options",
]


def first_rank_only(command):
    """Decorator: under ``mpirun``, the command runs on the first process only, which waits for no other meanwhile."""

    @wraps(command)
    def run(*args, **options):
        world = communicator()
        if world is None or world.rank == 0:
            with alone():
                command(*args, **options)

    return run


def with_options(scene, laws, samples=None, accuracy=None, seed=None, backend=None):
    """The scene with laws and Monte Carlo settings replaced by those of the command line; None changes nothing.

    Raises
    ------
    SceneError
        If the scene excludes an accuracy.
    """
    changes = {}
    if laws:
        changes["report"] = scene.report.model_copy(update={"laws": list(dict.fromkeys(law.value for law in laws))})
    given = {"samples": samples, "seed": seed, "backend": backend}
    settings = {key: value for key, value in given.items() if value is not None}
    if accuracy is not None:
        settings["accuracy"] = Accuracy(six_sigma=accuracy)
    if settings:
        changes["monte_carlo"] = scene.monte_carlo.model_copy(update=settings)
    changed = scene.model_copy(update=changes)
    if accuracy is not None and (found := find_errors(changed)):
        raise SceneError("\n".join(f"--accuracy: {line}" for line in found))
    return changed


class ConsoleProgress(RunProgress):
    """Prints the progress of a run on the console."""

    def __init__(self, console):
        self.console = console

    def report(self, sentence):
        self.console.say(sentence)

    @contextmanager
    def sampling(self, laws, samples):
        columns = TextColumn("{task.description}"), BarColumn(), MofNCompleteColumn(), TimeElapsedColumn()
        with Progress(*columns, TimeRemainingColumn(), console=self.console, disable=self.console.quiet) as progress:
            bars = {law: progress.add_task(f"{law} samples", total=samples) for law in laws}
            yield lambda law, count: progress.advance(bars[law], count)


def load_model(console, source):
    """The reduced model of a scene, model file or results folder; and that folder, else None.

    Raises
    ------
    RunError
        If the model of a results folder is missing or belongs to another run.
    """
    if not (source / "run.json").is_file():
        return reduce_source(console, source)[0], None
    record, path = RunFolder(source).record(), source / "model.npz"
    if not path.is_file():
        raise RunError(f"{path}: is missing; run the scene again into this folder")
    model = ReducedModel.load(path)
    if identity(model, record["seed"]) != record["identity"]:
        raise RunError(f"{path}: belongs to another run; run the scene again into this folder")
    return model, source


def reduce_source(console, source):
    """The reduced model of a scene or model file, and its parts (none from a model file)."""
    if source.is_file() and source.suffix == ".npz":
        return ReducedModel.load(source), ()
    scene, report_step = load_scene(source), console.say_step
    assembly = assemble_feasible(scene, cache_folder(), report_step)
    influence, _ = coefficients(assembly, cache_folder(), report_step)
    return ReducedModel.build(assembly, influence), assembly.parts


def open_model(source, law, seed=None):
    """Console, reduced model, its results folder or None, law and seed; from the command line, else from the scene."""
    console = CommandConsole()
    model, folder = load_model(console, source)
    seed = model.scene.monte_carlo.seed if seed is None else seed
    return console, model, folder, choose_law(model, law), seed


def choose_law(model, law):
    """The law of the command line, else the first law of the scene with friction, else its first."""
    return law.value if law else first_frictional(model.scene.report.laws)


def store_study(console, folder, tables):
    """Write tables of a study into a results folder and redraw its report; nothing if the folder is None."""
    if folder is None:
        return
    from mic.report.page import write_report  # drawing libraries are slow to import

    with hold(folder, ConsoleProgress(console)):
        for table, frame in tables.items():
            table.write(folder, frame)
        page = write_report(folder)
    console.say_files(report=page, tables=", ".join(str(folder / table.place) for table in tables))
