"""How a command is called: the scene or model asked for, one process or all, what is shown meanwhile, how it ends."""

from __future__ import annotations

import os
from contextlib import contextmanager
from functools import wraps

from rich.progress import BarColumn, MofNCompleteColumn, Progress, TextColumn, TimeElapsedColumn, TimeRemainingColumn

from mic.contact.laws import LAWS
from mic.errors import RunError, Stopped
from mic.execution.ranks import communicator
from mic.model.assembly import assemble
from mic.process.model import ReducedModel
from mic.process.plan import plan_assembly
from mic.process.stiffness import coefficients
from mic.results.run_folder import RunFolder
from mic.results.run_identity import identity
from mic.runs import Progress as RunProgress
from mic.runs import hold
from mic.scene import load_scene
from mic.system.console import plain
from mic.system.disk_cache import cache_folder

__all__ = [
    "OnConsole",
    "counting",
    "keep_studies",
    "law_of",
    "on_one_process",
    "reduced",
    "requested",
    "seed_of",
    "status",
    "studied",
    "threads",
]


def on_one_process(command):
    """A command that takes one process; under ``mpirun`` the others leave it to the first."""

    @wraps(command)
    def alone(*args, **options):
        world = communicator()
        if world is None or world.rank == 0:
            command(*args, **options)

    return alone


def requested(scene, laws, samples=None, seed=None, backend=None):
    """The scene with what the command line asks for instead."""
    changes = {}
    if laws:
        changes["report"] = scene.report.model_copy(update={"laws": list(dict.fromkeys(law.value for law in laws))})
    updates = {
        key: value for key, value in (("samples", samples), ("seed", seed), ("backend", backend)) if value is not None
    }
    if updates:
        changes["monte_carlo"] = scene.monte_carlo.model_copy(update=updates)
    return scene.model_copy(update=changes)


class OnConsole(RunProgress):
    """Shows a run on the console."""

    def __init__(self, console):
        self.console = console

    def report(self, sentence):
        self.console.print(plain(sentence), highlight=False, soft_wrap=True)

    @contextmanager
    def sampling(self, laws, samples):
        columns = TextColumn("{task.description}"), BarColumn(), MofNCompleteColumn(), TimeElapsedColumn()
        with Progress(*columns, TimeRemainingColumn(), console=self.console, disable=self.console.quiet) as progress:
            bars = {law: progress.add_task(f"{law} samples", total=samples) for law in laws}
            yield lambda law, count: progress.advance(bars[law], count)


def studied(console, source):
    """The reduced model to study, and the results folder that it comes from; None where it comes from none."""
    if not (source / "run.json").is_file():
        return reduced(console, source)[0], None
    record, path = RunFolder(source).record(), source / "model.npz"
    if not path.is_file():
        raise RunError(f"{path}: is missing; run the scene again into this folder")
    model = ReducedModel.load(path)
    if identity(model, record["seed"]) != record["identity"]:
        raise RunError(f"{path}: belongs to another run; run the scene again into this folder")
    return model, source


def reduced(console, source):
    """The reduced model of a scene, or one that was saved; and its parts, none of one that was saved."""
    if source.is_file() and source.suffix == ".npz":
        return ReducedModel.load(source), ()
    scene = load_scene(source)
    say = lambda line: console.print(f"{plain(line)} …", highlight=False)
    assembly = assemble(scene, cache_folder(), progress=say, check=plan_assembly)
    plan_assembly(assembly)
    influence, _ = coefficients(assembly, cache_folder(), say)
    return ReducedModel.build(assembly, influence), assembly.parts


def law_of(model, law):
    """The law asked for; else the scene's first with friction, else its first."""
    laws = model.scene.report.laws
    return law.value if law else next((name for name in laws if LAWS[name].frictional), laws[0])


def seed_of(scene, seed):
    """The seed asked for; else the scene's."""
    return scene.monte_carlo.seed if seed is None else seed


def threads():
    """How many threads may work."""
    return len(os.sched_getaffinity(0))


@contextmanager
def counting(console, what, count):
    """A bar; what it gives is called with the number of evaluations done."""
    with Progress(console=console) as progress:
        bar = progress.add_task(what, total=count)
        yield lambda done: progress.advance(bar, done)


def keep_studies(console, folder, tables):
    """Tables into the results folder that they belong to, and its page drawn anew."""
    if folder is None:
        return
    from mic.report.page import write_report  # drawing libraries are slow to import

    with hold(folder, OnConsole(console)):
        for table, frame in tables.items():
            table.write(folder, frame)
        page = write_report(folder)
    where = ", ".join(str(folder / table.place) for table in tables)
    console.print(f"report: [bold]{plain(page)}[/]   tables: {plain(where)}", soft_wrap=True)


def status(stop):
    """Exit status of a program that was interrupted."""
    return stop.status if isinstance(stop, Stopped) else 130
