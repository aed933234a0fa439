"""``mic run`` and ``mic report``."""

from __future__ import annotations

import shlex
import sys
import time
from pathlib import Path

import typer

from mic.commands.invocation import ConsoleProgress, choose_law, first_rank_only, with_options
from mic.commands.output import CommandConsole
from mic.contact.solution import advice_on
from mic.errors import RunError, Stopped
from mic.execution.ranks import communicator, on_first
from mic.report.background_pictures import BackgroundPictures
from mic.report.style import change, number, signed_micrometres
from mic.results.excel import write_excel
from mic.results.run_folder import EXCEL, RunFolder
from mic.results.schema import CONTRIBUTORS, LINEARITY, MESH_CHANGES
from mic.runs import conclude, finished, hold
from mic.runs import run as run_scene
from mic.scene import load_scene
from mic.statistics.draw import draw
from mic.studies import contributors as contributor_study
from mic.system.cores import available_cores
from mic.system.disk_cache import cache_folder

__all__ = ["ReportProgress", "report", "run"]

CHEAP = 0.1  # of the time of the run: contributors that take less are computed without request
PROBED = 8  # assemblies that are evaluated to estimate this


class ReportProgress(ConsoleProgress):
    """Prints the progress of a run, and starts to draw its pictures as soon as the samples are complete.

    Attributes
    ----------
    draws : bool
        Whether there will be a report.
    pictures : BackgroundPictures or None
        None also without contact: there are so few pictures that a worker would only import the drawing library twice.
    """

    draws = True
    pictures: BackgroundPictures | None = None

    def statistics_ready(self, outcome):
        self.stop()
        if self.draws and outcome.stages:
            self.pictures = BackgroundPictures(outcome)

    def stop(self):
        """Stop drawing."""
        if self.pictures is not None:
            self.pictures.end()


def run(scene, law, backend, out, replace, strict, no_report, engine, **sampling):
    """``mic run``, with the values of its options (:mod:`mic.options`)."""
    world = communicator()
    engine = engine or ("mpi" if world else "local")
    console = CommandConsole(quiet=world is not None and world.rank > 0)
    scene = on_first(world, lambda: with_options(load_scene(scene), law, backend=backend and backend.value, **sampling))
    if out is None and scene.name.strip(".") == "":
        raise RunError(f"scene name {scene.name!r}: not usable as the name of a results folder; give one with --out")
    folder, progress, start = out or Path("results") / scene.name, ReportProgress(console), time.perf_counter()
    progress.draws = not no_report
    try:
        with hold(folder, progress):
            outcome = run_scene(
                scene, folder, cache_folder(), progress, replace, strict, engine or ("mpi" if world else "local")
            )
            if outcome is not None:
                _add_contributors(console, outcome, time.perf_counter() - start)
                _report(console, outcome, progress)
    except (KeyboardInterrupt, Stopped) as interrupt:
        laws, count = scene.report.laws, scene.monte_carlo.samples
        console.say(
            f"Interrupted: {finished(folder, laws, count)} of {len(laws) * count} samples are finished and saved in "
            f"{folder}. To complete the run, run the same command again: {shlex.join(['mic', *sys.argv[1:]])}"
        )
        raise typer.Exit(getattr(interrupt, "status", 130)) from None
    finally:
        progress.stop()


def _add_contributors(console, outcome, seconds):
    """Compute the contributors of a run that took some seconds, if they are expected to take less than a tenth of it.

    A few assemblies are evaluated for the estimate.
    """
    model, scene = outcome.model, outcome.model.scene
    count = contributor_study.evaluation_count(scene) if scene.deviations else None
    if not scene.measurements or count is None or scene.monte_carlo.values is not None:
        return
    if outcome.study(CONTRIBUTORS) is not None:
        return
    affordable = CHEAP * seconds * PROBED / count  # s, for the assemblies of the estimate
    law, seed, threads = choose_law(model, None), scene.monte_carlo.seed, available_cores()
    start = time.perf_counter()
    model.process(law, threads=threads).attempt(draw(scene, seed, 0, PROBED))
    if time.perf_counter() - start < affordable:
        with console.progress_bar(f"contributors under {law}", count) as advance:
            found = contributor_study.contributors(model, law, seed=seed, threads=threads, progress=advance)
        CONTRIBUTORS.write(outcome.folder, found.table)
        LINEARITY.write(outcome.folder, found.linearity)


@first_rank_only
def report(folder, excel):
    """``mic report``, with the values of its options (:mod:`mic.options`)."""
    console = CommandConsole()
    progress = ReportProgress(console)
    try:
        outcome = conclude(folder, progress=progress)
        _report(console, outcome, progress)
        if excel:
            with hold(folder, ConsoleProgress(console)):
                console.say_files(Excel=write_excel(folder, folder / EXCEL))
    except (KeyboardInterrupt, Stopped) as interrupt:
        console.say(f"Interrupted: the samples in {folder} are unchanged. Run mic report again.")
        raise typer.Exit(getattr(interrupt, "status", 130)) from None
    finally:
        progress.stop()


def _report(console, outcome, progress):
    """Write the report if requested; print the zones, the validity of the samples and the main results."""
    from mic.report.verdict import verdict

    written = {"tables": outcome.folder / "summary.json"}
    if progress.draws:
        from mic.report.page import write_report  # drawing libraries are slow to import

        written = {"report": write_report(outcome.folder, outcome, progress.pictures)} | written
    else:
        RunFolder(outcome.folder).remove_report()  # of fewer samples
    laws = outcome.summary()["laws"]
    _print_zones(console, laws, "rms_tangential", "RMS tangential displacement, mm")
    _print_zones(console, laws, "rms_slip", "RMS slip under load, mm")
    _print_mesh_changes(console, outcome.study(MESH_CHANGES))
    for name, law in laws.items():
        _print_validity(console, name, law, outcome.failures(name))
    found = verdict(outcome)
    console.say_each(found.sentences if found else ())
    console.say_files(**written)


def _print_zones(console, laws, motion, title):
    """Best mean and 6σ of a motion in each zone under each law (Table 1 of the paper), and their errors."""
    shown = {
        name: law["zones"]
        for name, law in laws.items()
        if any(zone[f"mean_{motion}"] is not None for zone in law["zones"].values())
    }
    figures = [f"{figure}_{motion}" for figure in ("mean", "six_sigma")]
    rows, with_path = [], False
    for zone in dict.fromkeys(name for law in laws.values() for name in law["zones"]):
        cells = [zone]
        for zones in shown.values():
            own = zones[zone]
            cell = " / ".join(number(own["headline"][figure], 4) for figure in figures)
            if any(own["headline"][figure] != own[figure] for figure in figures):
                cell += f"\nsamples alone {' / '.join(number(own[figure], 4) for figure in figures)}"
            if own[f"{figures[0]}_path"] is not None:
                changes = (change(own[f"{figure}_path"], own[f"{figure}_path_share"]) for figure in figures)
                cell += f"\npath error {' / '.join(changes)}"
                with_path = True
            cells.append(cell)
        rows.append(cells)
    if shown:
        note = "; path error: change with a tighter load path" if with_path else ""
        console.table(title + note, ("zone", *(f"{law}: mean / 6σ" for law in shown)), rows)


def _print_mesh_changes(console, table):
    """Expected change of each key characteristic on ever finer meshes, if it was requested."""
    figures = ("mean_change", "six_sigma_change")
    rows = [] if table is None else table.to_dict("records")
    cells = [(row["measurement"], row["law"], *(signed_micrometres(row[name]) for name in figures)) for row in rows]
    console.table("Expected changes on ever finer meshes, µm", ("key characteristic", "law", "mean", "6σ"), cells)


def _print_validity(console, name, law, failures):
    """Residual, failed samples, error of the load path, incomplete assemblies and penetration under one law."""
    console.say(
        f"{name}: largest residual {number(law['worst_residual'], 2)}, {law['failed']} samples failed, "
        f"{law['rescued']} solved with fixed increments{_path_error(law)}"
    )
    if several := law["path"]["several_solutions"]:
        console.say(
            f"  several solutions in {several} of {law['path']['repeated']} repeated samples: which one is reached "
            "depends on the load path",
            style="yellow",
        )
    for status, found in failures.groupby("status", sort=False):
        console.say(f"  {status}: {found['sample'].nunique()} of them. {advice_on(str(status))}", style="yellow")
    if law["not_built"]:
        console.say(f"  not built: {law['not_built']} of {law['samples']} samples", style="yellow")
    for row in law["limits"]:
        if row["short"]:
            console.say(
                f"  {row['name']} does not reach its position in {row['short']} samples (stage {row['stage']}): "
                f"{number(row['max_left'], 3)} mm short at most; it needs up to {number(row['max_needed'], 3)} N and "
                f"has {number(row['limit'], 3)} N"
            )
    if unseen := law["unseen_penetration"]:
        place = ", ".join(f"{x:.1f}" for x in unseen["point"])
        console.say(
            f"  deepest penetration between the contact pairs: {unseen['depth']:.2g} mm, zone {unseen['zone']}, at "
            f"({place}), stage {unseen['stage']}, sample {unseen['sample']}"
        )


def _path_error(law):
    """Largest change of key characteristics with a tighter load path; empty if it was not computed."""
    changes = []
    for figure, text in (("mean", "means"), ("six_sigma", "6σ")):
        known = [item for item in law["measurements"].values() if item[f"{figure}_path"] is not None]
        if known:
            largest = max(known, key=lambda item: abs(item[f"{figure}_path"]))
            changes.append(f"{text} {change(largest[f'{figure}_path'], largest[f'{figure}_path_share'])}")
    if not changes:
        return ""
    repeated = law["path"]["repeated"]
    return (
        f"; largest change of key characteristics with a tighter load path ({repeated} samples): {', '.join(changes)}"
    )
