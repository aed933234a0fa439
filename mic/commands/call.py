"""How a command is called: the scene as asked for, one process or all, what is shown meanwhile, how it ends."""

from __future__ import annotations

from contextlib import contextmanager
from functools import wraps

from rich.progress import BarColumn, MofNCompleteColumn, Progress, TextColumn, TimeElapsedColumn, TimeRemainingColumn

from mic.console import plain
from mic.errors import Stopped
from mic.runs import Listener, hold
from mic.sampling.ranks import communicator

__all__ = [
    "OnConsole",
    "keep_studies",
    "on_one_process",
    "requested",
    "status",
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


class OnConsole(Listener):
    """Shows a run on the console."""

    def __init__(self, console):
        self.console = console

    def say(self, sentence):
        self.console.print(plain(sentence), highlight=False, soft_wrap=True)

    @contextmanager
    def sampling(self, laws, samples):
        columns = TextColumn("{task.description}"), BarColumn(), MofNCompleteColumn(), TimeElapsedColumn()
        with Progress(*columns, TimeRemainingColumn(), console=self.console, disable=self.console.quiet) as progress:
            bars = {law: progress.add_task(f"{law} samples", total=samples) for law in laws}
            yield lambda law, count: progress.advance(bars[law], count)


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
