"""``python -m verification``: list and run studies, write their report, verify a scene."""

from __future__ import annotations

import sys
import traceback
from pathlib import Path
from typing import Annotated

import typer
from rich.console import Console

from mic import cache_folder
from mic.errors import MicError
from mic.scene import load_scene
from verification.own_scene import verify_scene
from verification.pdf import browser, write_pdf
from verification.report import write_report
from verification.run import compile_kernels, team, write_summary
from verification.run import run as run_studies
from verification.shell_contact import fclib
from verification.shell_contact.case import cases
from verification.shell_contact.publication import publish
from verification.study import studies
from verification.target import advice, choose, share_of, table

AGAIN = 3  # samples that are solved again for the numerical uncertainty
PDF = typer.Option("--pdf", help="Also write report.pdf, printed by chromium or chrome.")

app = typer.Typer(
    add_completion=False,
    no_args_is_help=True,
    pretty_exceptions_enable=False,
    help="""
Compare results of the reduced model with closed forms, other solvers and full finite elements.

Start with:  python -m verification list  and then  python -m verification run --quick
""",
)


def _chosen(names):
    known = studies()
    for name in names or ():
        if name not in known:
            raise typer.BadParameter(f"no study {name!r}; choose from {', '.join(known)}")
    return [known[name] for name in names] if names else list(known.values())


@app.command("list")
def list_studies():
    """List the studies with claim, reference, acceptance limits, and expected time and memory on one core."""
    console = Console(highlight=False)
    for study in studies().values():
        full, quick = study.seconds
        console.print(
            f"[bold]{study.name}[/]: {study.title}, {full:.0f} s, {study.memory:.1f} GB"
            + (f", quick {quick:.0f} s" if quick != full else ", quick the same")
        )
        console.print(f"  {study.claim}", f"  [dim]Reference: {study.reference}[/]", sep="\n", soft_wrap=True)
        for acceptance in study.acceptance:
            console.print(f"  • {acceptance.name}: {acceptance.words()}")


@app.command()
def run(
    names: Annotated[list[str] | None, typer.Argument(help="Studies to run; default: all.", show_default=False)] = None,
    out: Annotated[Path, typer.Option(help="Folder for the results.")] = Path("results/verification"),
    quick: Annotated[bool, typer.Option("--quick", help="Small meshes and few samples.")] = False,
    pdf: Annotated[bool, PDF] = False,
):
    """Run studies; write summary.json and report.html. Exit code 1 if an acceptance limit is not met.

    Results of the same code in the folder are reused: call again to complete an interrupted run. A study that raises an
    error is reported as not measured, and the others still run. Under `mpirun -n N` each process takes whole studies,
    the longest first that fits into memory; all processes share studies that are longer than their part of the total.
    """
    workers = team()
    if pdf:
        browser()  # raise before hours of work
    chosen = _chosen(names)
    compile_kernels(workers)
    run_studies(chosen, out, quick, workers, lambda line: print(line, flush=True))
    if workers.rank == 0:
        print(f"report: {write_report(out, pdf)}")
    failed = [entry for entry in write_summary(out) if not entry["passed"]] if workers.rank == 0 else []
    if failed:
        print(f"{len(failed)} acceptance limits not met: " + ", ".join(f"{e['study']}/{e['name']}" for e in failed))
    raise typer.Exit(1 if failed else 0)


@app.command()
def scene(
    scene: Annotated[Path, typer.Argument(help="Scene file, or folder with scene.toml.", show_default=False)],
    samples: Annotated[
        int,
        typer.Option(min=1, help="Samples to solve by full finite elements; at least three for confidence intervals."),
    ] = 5,
    out: Annotated[
        Path | None,
        typer.Option(help="Folder for the results. Default: results/NAME-OF-SCENE-verified.", show_default=False),
    ] = None,
    nominal: Annotated[
        bool,
        typer.Option(
            "--nominal",
            help="Full solves on the nominal meshes, as the reduced model assumes, instead of meshes with each "
            "sample's shape.",
        ),
    ] = False,
    to: Annotated[
        str | None,
        typer.Option(
            help="Only find the cheapest setting whose error of 6σ is at most this, such as 2%.",
            show_default=False,
        ),
    ] = None,
    pdf: Annotated[bool, PDF] = False,
):
    """Verify your own scene: error budget of its results, and full finite-element solves of some samples.

    The report starts with the error budget: path, order, pairs, mesh, nominal stiffness and sampling, estimated on the
    same samples. Samples for full solves are selected by their Monte Carlo results: one typical, then alternately
    extreme and random ones. Three of them are solved again scaled, rotated, mirrored, renumbered, permuted, on a
    tighter path and by whole finite elements: the largest disagreement about a number is its numerical uncertainty.
    Stored results are reused: call again to complete an interrupted run, or with more samples.
    Under `mpirun -n N` the work is distributed over N processes.
    """
    workers = team()
    if to is not None:
        try:
            target = share_of(to)
        except ValueError as problem:
            raise typer.BadParameter(str(problem), param_hint="--to") from None
    if pdf:
        browser()
    loaded = load_scene(scene)
    folder = out or Path("results") / f"{loaded.name}-verified"
    if to is not None:
        tried = choose(loaded, target, folder / "target", cache_folder(), workers)
        if workers.rank == 0:
            table(tried).to_csv(folder / "target.csv", index=False)
            print(advice(tried, target))
        return
    say = lambda line: print(line, flush=True)
    verify_scene(loaded, folder, cache_folder(), samples, not nominal, workers, say, again=AGAIN)
    if workers.rank == 0:
        page = folder / "report.html"
        print(f"report: {write_pdf(page) if pdf else page}")


@app.command()
def suite(
    names: Annotated[list[str] | None, typer.Argument(help="Cases; default: all.", show_default=False)] = None,
    write: Annotated[
        Path | None,
        typer.Option(help="Folder for the recomputed cases, one subfolder each.", show_default=False),
    ] = None,
    h5py: Annotated[str, typer.Option(help="Python interpreter with h5py, for FCLIB files.")] = fclib.interpreter(),
):
    """List the twelve shell contact cases, or write their pages, data and contact problems."""
    known = cases()
    for name in names or ():
        if name not in known:
            raise typer.BadParameter(f"no case {name!r}; choose from {', '.join(known)}")
    if write and not fclib.available(h5py):
        print(f"{h5py} has no h5py: no contact problems are written; name an interpreter with h5py by --h5py")
    for name in names or known:
        print(f"{name}: {known[name].text.splitlines()[0].removeprefix('# ')}", flush=True)
        if write:
            publish(known[name], write / name, cache_folder(), h5py)


@app.command()
def report(
    folder: Annotated[Path, typer.Argument(help="Run folder, finished or interrupted.", show_default=False)],
    pdf: Annotated[bool, PDF] = False,
):
    """Rewrite summary.json and report.html of a run folder."""
    print(f"report: {write_report(folder, pdf)}")


def main():
    """Entry point; under MPI the first failure ends all processes and prints its traceback."""
    workers = team()
    try:
        app()
    except Exception as error:
        if isinstance(error, (FileNotFoundError, MicError)) and workers.size == 1:
            print(f"error: {error}", file=sys.stderr)
            sys.exit(2)
        traceback.print_exc()
        sys.stderr.flush()
        if workers.size > 1:
            workers.comm.Abort(3)
        sys.exit(3)


if __name__ == "__main__":
    main()
