"""``mic run`` and ``mic report``."""

from __future__ import annotations

import shlex
import sys
from pathlib import Path

import typer
from rich.console import Console
from rich.table import Table

from mic.commands.invocation import OnConsole, on_one_process, requested, status
from mic.errors import RunError, Stopped
from mic.execution.ranks import communicator, on_first
from mic.report.background_pictures import Ahead
from mic.results.excel import write_excel
from mic.results.run_folder import EXCEL
from mic.runs import conclude, finished, hold
from mic.runs import run as run_scene
from mic.scene import load_scene
from mic.system.console import plain
from mic.system.disk_cache import cache_folder

__all__ = [
    "Drawing",
    "report",
    "run",
]


class Drawing(OnConsole):
    """Shows a run on the console, and has its pictures begun while it goes on."""

    ahead: Ahead | None = None

    def statistics_ready(self, outcome):
        self.end()
        self.ahead = Ahead(outcome)

    def end(self):
        """Nothing is drawn any longer."""
        if self.ahead is not None:
            self.ahead.end()


def run(scene, samples, seed, law, backend, out, replace, strict):
    """``mic run``, with the values of its options (:mod:`mic.options`)."""
    world = communicator()
    console = Console(quiet=world is not None and world.rank > 0)
    asked = on_first(world, lambda: requested(load_scene(scene), law, samples, seed, backend and backend.value))
    if out is None and asked.name.strip(".") == "":
        raise RunError(f"scene name {asked.name!r}: cannot name a results folder; name the folder with --out")
    folder, listener = out or Path("results") / asked.name, Drawing(console)
    try:
        with hold(folder, listener):
            outcome = run_scene(asked, folder, cache_folder(), listener, replace, strict)
            if outcome is not None:
                _report(console, outcome, listener.ahead)
    except (KeyboardInterrupt, Stopped) as stop:
        laws, samples = asked.report.laws, asked.monte_carlo.samples
        console.print(
            f"Interrupted: {finished(folder, laws, samples)} of {len(laws) * samples} samples are finished and kept in "
            f"{plain(folder)}; run the same command again to complete it: {plain(shlex.join(['mic', *sys.argv[1:]]))}",
            highlight=False,
            soft_wrap=True,
        )
        raise typer.Exit(status(stop)) from None
    finally:
        listener.end()


@on_one_process
def report(folder, excel):
    """``mic report``, with the values of its options (:mod:`mic.options`)."""
    console = Console()
    listener = Drawing(console)
    try:
        outcome = conclude(folder, listener=listener)
        _report(console, outcome, listener.ahead)
        if excel:
            with hold(folder, OnConsole(console)):
                book = write_excel(folder, folder / EXCEL)
            console.print(f"Excel: [bold]{plain(book)}[/]", soft_wrap=True)
    except (KeyboardInterrupt, Stopped) as stop:
        console.print(f"Interrupted: the samples in {plain(folder)} stand untouched; call mic report again.")
        raise typer.Exit(status(stop)) from None
    finally:
        listener.end()


def _report(console, outcome, ahead):
    """The page, and on the console the least that a user wants to know."""
    from mic.report.page import write_report
    from mic.report.verdict import answer  # drawing libraries are slow to import, and most commands need none

    page = write_report(outcome.folder, outcome, ahead)
    _print_zones(console, outcome)
    found = answer(outcome)
    for sentence in found.sentences if found else ():
        console.print(plain(sentence), highlight=False, soft_wrap=True)
    console.print(f"report: [bold]{plain(page)}[/]   tables: {plain(outcome.folder / 'summary.json')}")


def _print_zones(console, outcome):
    """The paper's Table 1, slip under load beside it, what the path left, and how many samples failed."""
    from mic.report.style import change, number

    laws = outcome.summary()["laws"]
    zones = list(dict.fromkeys(zone for law in laws.values() for zone in law["zones"]))
    for motion, title in (
        ("rms_tangential", "RMS tangential displacement, mm"),
        ("rms_slip", "RMS slip under load, mm"),
    ):
        shown = {
            name: law["zones"]
            for name, law in laws.items()
            if any(zone[f"mean_{motion}"] is not None for zone in law["zones"].values())
        }
        if not shown:
            continue
        table = Table(
            "zone", *(f"{law}: mean / 6σ" for law in shown), title=f"{title}; path: what a tighter one changes"
        )
        for zone in zones:
            cells = []
            for found in shown.values():
                names = [f"{figure}_{motion}" for figure in ("mean", "six_sigma")]
                cell = " / ".join(number(found[zone][name], 4) for name in names)
                if found[zone][f"{names[0]}_path"] is not None:
                    changes = (change(found[zone][f"{name}_path"], found[zone][f"{name}_path_share"]) for name in names)
                    cell += f"\npath {' / '.join(changes)}"
                cells.append(cell)
            table.add_row(zone, *cells)
        console.print(table)
    for name, law in laws.items():
        console.print(
            f"{name}: worst residual {number(law['worst_residual'], 2)}, failed samples {law['failed']}, "
            f"rescued by plain increments {law['rescued']}{_hanging(law)}",
            soft_wrap=True,
        )
        _print_limits(console, law)
        if law["unseen_penetration"]:
            console.print(_unseen_words(law["unseen_penetration"]), highlight=False, soft_wrap=True)


def _print_limits(console, law):
    """How many assemblies are not built, and which clamps and guns fall short of their position."""
    from mic.report.style import number

    if law["not_built"]:
        console.print(f"  not built: {law['not_built']} of {law['samples']} samples", style="yellow")
    for row in law["limits"]:
        if row["short"]:
            console.print(
                f"  {plain(row['name'])} falls short of its position in {row['short']} samples (stage "
                f"{plain(row['stage'])}): by up to {number(row['max_left'], 3)} mm; that would take up to "
                f"{number(row['max_needed'], 3)} N, and it has {number(row['limit'], 3)} N",
                soft_wrap=True,
            )


def _unseen_words(unseen) -> str:
    """How deep sheets pass through each other between the contact pairs, and where."""
    where = ", ".join(f"{x:.1f}" for x in unseen["point"])
    return (
        f"  deepest penetration between the contact pairs: {unseen['depth']:.2g} mm, zone {plain(unseen['zone'])}, at "
        f"({where}), stage {plain(unseen['stage'])}, sample {unseen['sample']}"
    )


def _hanging(law):
    """What a tighter path changes of the key characteristics, at most."""
    from mic.report.style import change

    told = []
    for figure, word in (("mean", "means"), ("six_sigma", "6σ")):
        found = [item for item in law["measurements"].values() if item[f"{figure}_path"] is not None]
        if found:
            most = max(found, key=lambda item: abs(item[f"{figure}_path"]))
            told.append(f"{word} {change(most[f'{figure}_path'], most[f'{figure}_path_share'])}")
    if not told:
        return ""
    repeated = law["path"]["repeated"]
    return f"; {repeated} samples on a tighter path change key characteristics by at most: {', '.join(told)}"
