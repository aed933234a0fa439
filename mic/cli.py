"""Command line: ``mic run``, ``mic check``, ``mic report``, ``mic init``."""

from __future__ import annotations

import json
import sys
import time
import traceback
from contextlib import contextmanager
from enum import Enum
from pathlib import Path
from typing import Annotated, Optional

import typer
from rich.console import Console
from rich.markup import escape
from rich.progress import BarColumn, MofNCompleteColumn, Progress, TextColumn, TimeElapsedColumn, TimeRemainingColumn
from rich.table import Table

from mic import cache_folder, examples
from mic.compliance.influence import influence_coefficients, is_cached
from mic.errors import MicError, SceneError
from mic.sampling.montecarlo import communicator
from mic.scene import load_scene

__all__ = ["main"]

app = typer.Typer(
    add_completion=False,
    no_args_is_help=True,
    rich_markup_mode="markdown",
    pretty_exceptions_enable=False,
    help="""
Will a sheet-metal assembly be within tolerance when its parts are not nominal and its contacts have friction?

A *scene* (a TOML file) states parts, locators, clamps, welds, contact zones, process stages, deviations and measurements.
`mic check` validates it and says what will be modelled; `mic run` does the Monte Carlo and writes a report.

Start with:  mic init --example lap_joint  and then  mic check lap_joint  and  mic run lap_joint --samples 50
""",
)


class Law(str, Enum):
    """Contact laws."""

    coulomb = "coulomb"
    associated = "associated"
    frictionless = "frictionless"


SceneArgument = Annotated[
    Path, typer.Argument(help="Scene file, or a folder that holds scene.toml.", show_default=False)
]
LawOption = Annotated[
    Optional[list[Law]],
    typer.Option(
        "--law",
        help="Contact law; repeat for several. `coulomb`: Coulomb's law. `associated`: the convex programme (13) of the paper, "
        "which lets sliding contacts open. `frictionless`: normals only. Default: the scene's.",
        show_default=False,
    ),
]


class _Clock:
    """Wall time by phase, s."""

    def __init__(self):
        self.seconds: dict[str, float] = {}

    @contextmanager
    def __call__(self, phase):
        start = time.perf_counter()
        yield
        self.seconds[phase] = self.seconds.get(phase, 0.0) + time.perf_counter() - start


class Backend(str, Enum):
    """Who solves the contacts."""

    native = "native"
    paper = "paper"


def _requested(scene, laws, samples=None, seed=None, backend=None):
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


@app.command()
def run(
    scene: SceneArgument,
    samples: Annotated[
        Optional[int], typer.Option(min=1, help="Number of samples. Default: the scene's.", show_default=False)
    ] = None,
    seed: Annotated[
        Optional[int], typer.Option(min=0, help="Seed of the deviations. Default: the scene's.", show_default=False)
    ] = None,
    law: LawOption = None,
    backend: Annotated[
        Optional[Backend],
        typer.Option(
            help="`paper` solves (12) with OSQP and (13) with ECOS through CVXPY, some "
            "hundred times slower. Default: the scene's.",
            show_default=False,
        ),
    ] = None,
    out: Annotated[
        Optional[Path], typer.Option(help="Folder for the results. Default: results/NAME-OF-SCENE.", show_default=False)
    ] = None,
):
    """Run the Monte Carlo of a scene and write tables, fields and a report.

    Influence coefficients are computed once and cached; a second run of the same scene reuses them. Finished blocks of samples
    are kept: call again to complete an interrupted run. Under `mpirun -n N` the samples are shared out over N processes.
    """
    world = communicator()
    first = world is None or world.rank == 0
    console = Console(quiet=not first)
    clock = _Clock()
    with clock("scene"):
        scene = _requested(load_scene(scene), law, samples, seed, backend and backend.value)
        folder = out or Path("results") / scene.name
        from mic.model.assembly import assemble
        from mic.model.reduced import ReducedModel
        from mic.results.outcome import keep_inputs
        from mic.sampling.montecarlo import run as monte_carlo
    cache = cache_folder()
    with clock("meshes and pairs"):
        console.print(f"[bold]{scene.name}[/]: meshing and pairing …")
        assembly = assemble(scene, cache)
    with clock("influence coefficients"):
        influence, cached = influence_coefficients(assembly, cache, lambda line: console.print(line + " …"))
        reused = [name for name, hit in cached.items() if hit]
        if reused:
            console.print(f"influence coefficients of {', '.join(reused)}: reused from {cache}")
    with clock("reduced model"):
        model = ReducedModel.build(assembly, influence)
        for sentence in model.process().redundant:
            console.print(f"[yellow]note:[/] {escape(sentence)}", highlight=False)
    if first:
        keep_inputs(folder, assembly)
    laws, count = scene.report.laws, scene.monte_carlo.samples
    with clock("Monte Carlo"), _progress(console) as progress:
        bars = {name: progress.add_task(f"{name} samples", total=count) for name in laws}
        reused = monte_carlo(
            model, folder, laws, count, scene.monte_carlo.seed, lambda name, n: progress.advance(bars[name], n)
        )
    if not first:
        return
    for name, n in reused.items():
        if n:
            console.print(f"{name}: {n} of {count} samples found finished in {folder}")
    _finish(console, folder, clock)


@app.command()
def report(
    folder: Annotated[
        Path, typer.Argument(help="Results folder of a run, finished or interrupted.", show_default=False)
    ],
):
    """Write the statistics, fields and report of a results folder again."""
    if not (folder / "run.json").is_file():
        raise SceneError(
            f"{folder}: holds no run (run.json is missing); give the folder that `mic run` wrote, such as results/wheelhouse"
        )
    _finish(Console(), folder, _Clock())


def _finish(console, folder, clock):
    """Statistics, fields and report of a run folder; the end of every run."""
    with clock("statistics"):
        from mic.report.page import write_report
        from mic.results.outcome import read_outcome

        outcome = read_outcome(folder)
    with clock("fields"):
        if outcome.model.scene.report.fields:
            from mic.results.fields import write_fields

            write_fields(folder)
    with clock("report"):
        record = folder / "run.json"
        content = json.loads(record.read_text())
        content["wall_time"] = content.get("wall_time", {}) | {phase: round(s, 3) for phase, s in clock.seconds.items()}
        record.write_text(json.dumps(content, indent=2) + "\n")
        page = write_report(folder)
    _print_zones(console, outcome)
    console.print(f"report: [bold]{page}[/]   tables: {folder / 'summary.json'}")


def _print_zones(console, outcome):
    """The paper's Table 1, and how many samples failed."""
    from mic.report.pictures import number

    summary = outcome.summary()
    zones = list(dict.fromkeys(zone for law in summary["laws"].values() for zone in law["zones"]))
    if zones:
        table = Table("zone", *(f"{law}: mean / 6σ" for law in summary["laws"]), title="RMS slip, mm")
        for zone in zones:
            table.add_row(
                zone,
                *(
                    f"{number(law['zones'][zone]['mean_rms_slip'], 4)} / {number(law['zones'][zone]['six_sigma_rms_slip'], 4)}"
                    for law in summary["laws"].values()
                ),
            )
        console.print(table)
    for name, law in summary["laws"].items():
        console.print(f"{name}: worst residual {number(law['worst_residual'], 2)}, failed samples {law['failed']}")


@app.command()
def check(scene: SceneArgument, law: LawOption = None):
    """Validate a scene and print what will be modelled, and at what cost, without solving anything."""
    from mic.model.assembly import assemble
    from mic.process.process import plan_stages

    console = Console()
    scene = _requested(load_scene(scene), law)
    assembly = assemble(scene, cache_folder())
    console.print(f"[bold]{scene.name}[/] {scene.description}")
    _print_parts(console, assembly)
    _print_contacts(console, assembly)
    plans = plan_stages(scene, assembly.weld_size)
    table = Table("stage", "kind", "rows held", "clamp forces", "welds closed", "contact resolution", title="Stages")
    for plan in plans:
        resolves = plan.resolves and len(assembly.contacts) > 0
        table.add_row(
            plan.name,
            plan.kind,
            str(len(plan.bilateral)),
            str(len(plan.loads)),
            str(len(plan.closing)),
            (f"yes, {plan.increments} increments" if plan.increments > 1 else "yes") if resolves else "no",
        )
    console.print(table)
    _print_cost(console, assembly, plans)
    console.print("[green]The scene is valid.[/]")


def _print_parts(console, assembly):
    table = Table(
        "part", "nodes", "triangles", "t, mm", "E, MPa", "ν", "functionals", "influence coefficients", title="Parts"
    )
    for part in assembly.parts:
        table.add_row(
            part.name,
            str(len(part.surface.points)),
            str(len(part.surface.triangles)),
            f"{part.thickness:g}",
            f"{part.young:g}",
            f"{part.poisson:g}",
            str(len(part.functionals)),
            "cached" if is_cached(part, cache_folder()) else "to be computed",
        )
    console.print(table)


def _print_contacts(console, assembly):
    scene, contacts = assembly.scene, assembly.contacts
    if not len(contacts):
        console.print("No contact zones: nothing to resolve.")
        return
    table = Table("zone", "between", "pairs", "friction", "area, mm²", "nominal gap, mm", title="Contact zones")
    for i, zone in enumerate(scene.zones):
        own = contacts.zone == i
        table.add_row(
            zone.name,
            " – ".join(zone.parts),
            str(own.sum()),
            f"{zone.friction:g}",
            f"{contacts.area[own].sum():.0f}",
            f"{contacts.gap[own].min():.3f} … {contacts.gap[own].max():.3f}",
        )
    console.print(table)
    if contacts.dimension == 1:
        console.print(
            f"Nothing asks for friction or slip: only normals are modelled, {len(contacts)} rows instead of {3 * len(contacts)}."
        )


def _print_cost(console, assembly, plans):
    scene = assembly.scene
    solved = sum(plan.increments for plan in plans if plan.resolves) if len(assembly.contacts) else 0
    rows = sum(len(part.functionals) for part in assembly.parts)
    lines = [
        f"one factorisation per part not cached: {', '.join(f'{6 * len(p.surface.points)} freedoms' for p in assembly.parts)}"
        if scene.element == "dkt-opt"
        else "one factorisation per part not cached",
        f"reduced model: {rows} functionals, {8 * sum(len(p.functionals) ** 2 for p in assembly.parts) / 1e6:.0f} MB of influence coefficients",
        f"{scene.monte_carlo.samples} samples × {len(scene.report.laws)} laws ({', '.join(scene.report.laws)}) × {solved} contact resolutions "
        f"= {scene.monte_carlo.samples * len(scene.report.laws) * solved} contact solves of {assembly.contacts.dimension * len(assembly.contacts)} unknowns",
        "mean and 6σ fields: a few further solves per part and law"
        if scene.report.fields
        else "no fields asked for: no field solves",
    ]
    if solved == 0:
        lines[2] = f"{scene.monte_carlo.samples} samples × {len(scene.report.laws)} laws, no contact to resolve"
    for line in lines:
        console.print(f"• {line}")


@app.command()
def init(
    example: Annotated[str, typer.Option(help="Name of the example scene.", show_default=False)],
    out: Annotated[Optional[Path], typer.Option(help="The new folder. Default: ./NAME.", show_default=False)] = None,
):
    """Copy an example scene into a new folder, to start from: lap_joint, hat_on_plate or wheelhouse."""
    folder = examples.copy(example, out)
    print(f"{folder}: {', '.join(sorted(path.name for path in folder.iterdir()))}\nNext:  mic check {folder}")


def _progress(console):
    return Progress(
        TextColumn("{task.description}"),
        BarColumn(),
        MofNCompleteColumn(),
        TimeElapsedColumn(),
        TimeRemainingColumn(),
        console=console,
        disable=console.quiet,
    )


def main():
    """Entry point: one clear line for what a user can mend, a traceback for what only we can."""
    world = communicator()
    try:
        app()
    except MicError as error:
        if world is None or world.rank == 0:
            Console(stderr=True).print(f"[bold red]error:[/] {escape(str(error))}", highlight=False, soft_wrap=True)
        sys.exit(2)
    except Exception:
        if world is None:
            raise
        traceback.print_exc()
        world.Abort(1)  # one process must not leave the others waiting


if __name__ == "__main__":
    main()
