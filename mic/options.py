"""The command line: which commands there are, and their options. What they do, :mod:`mic.commands` says.

Nothing slow is imported here: whoever asks for help is not kept waiting for numerics and tables.
"""

from __future__ import annotations

from enum import Enum
from importlib import import_module
from pathlib import Path
from typing import Annotated, Any

import typer

from mic import examples
from mic.contact.laws import LAWS

__all__ = ["app"]

app = typer.Typer(
    add_completion=False,
    no_args_is_help=True,
    rich_markup_mode="markdown",
    pretty_exceptions_enable=False,
    help="""
Will a sheet-metal assembly be within tolerance when its parts are not nominal and its contacts have friction?

A *scene* (a TOML file) states parts, locators, clamps, welds, contact zones, process stages, deviations and
measurements. `mic check` validates it and says what will be modelled; `mic run` does the Monte Carlo and writes a
report.

Start with:  mic init --example lap_joint  and then  mic check lap_joint  and  mic run lap_joint --samples 50
""",
)


#: Names for the options; the vocabularies themselves are the contact laws' and the scene's.
Law = Enum("Law", {name: name for name in LAWS}, type=str)  # type: ignore[misc]
Backend = Enum("Backend", {name: name for name in ("native", "paper")}, type=str)  # type: ignore[misc]

SceneArgument = Annotated[
    Path, typer.Argument(help="Scene file, or a folder that holds scene.toml.", show_default=False)
]
LawOption = Annotated[
    list[Law] | None,
    typer.Option(
        "--law",
        help="Contact law; repeat for several. "
        + " ".join(f"`{law.name}`: {law.title}" for law in LAWS.values())
        + " Default: the scene's.",
        show_default=False,
    ),
]


StrictOption = Annotated[bool, typer.Option("--strict", help="Take warnings for errors: exit status 2.")]


def _carry_out(name: str, *values: Any) -> None:
    """Carry out a command with the values of its options."""
    home = {"report": "run"} | {
        own: own for own in ("check", "compare", "explain", "explore", "init", "optimise", "predict", "run")
    }
    module = f"mic.commands.{home.get(name, 'studies')}"
    # Only now: numerics and tables take a second to import.
    getattr(import_module(module), name)(*values)


@app.command()
def run(
    scene: SceneArgument,
    samples: Annotated[
        int | None, typer.Option(min=1, help="Number of samples. Default: the scene's.", show_default=False)
    ] = None,
    seed: Annotated[
        int | None,
        typer.Option(min=0, max=2**63 - 1, help="Seed of the deviations. Default: the scene's.", show_default=False),
    ] = None,
    law: LawOption = None,
    backend: Annotated[
        Backend | None,
        typer.Option(
            help="`paper` solves (12) with OSQP and (13) with ECOS through CVXPY, some "
            "hundred times slower. Default: the scene's.",
            show_default=False,
        ),
    ] = None,
    out: Annotated[
        Path | None, typer.Option(help="Folder for the results. Default: results/NAME-OF-SCENE.", show_default=False)
    ] = None,
    replace: Annotated[
        bool,
        typer.Option(
            "--replace",
            help="Remove the results of another run from the folder, the files that a run writes and no others. "
            "Without it, such a folder is refused.",
        ),
    ] = False,
    strict: StrictOption = False,
):
    """Run the Monte Carlo of a scene and write tables, fields and a report.

    Influence coefficients are computed once and cached; a second run of the same scene reuses them. Finished samples
    are kept: call again to complete an interrupted run, or with more samples to extend one. Under `mpirun -n N` the
    samples are shared out over N processes.
    """
    _carry_out("run", scene, samples, seed, law, backend, out, replace, strict)


@app.command()
def report(
    folder: Annotated[
        Path, typer.Argument(help="Results folder of a run, finished or interrupted.", show_default=False)
    ],
    excel: Annotated[bool, typer.Option("--excel", help="Write its tables into tables.xlsx as well.")] = False,
):
    """Write the statistics, fields and report of a results folder again."""
    _carry_out("report", folder, excel)


@app.command()
def check(
    scene: SceneArgument,
    law: LawOption = None,
    accuracy: Annotated[
        bool,
        typer.Option(
            "--accuracy",
            help="Estimate the error that each part's mesh leaves: its influence coefficients are computed on it, and "
            "at half its size.",
        ),
    ] = False,
    converge: Annotated[
        bool,
        typer.Option(
            "--converge",
            help="Repeat the nominal assembly and some samples with pairs at a smaller "
            "distance, about twice as many, and tell how the key characteristics move.",
        ),
    ] = False,
    normals: Annotated[
        Path | None,
        typer.Option(
            help="Draw into this file, NAME.png, where the parts' normals come from: geometry, deck or estimate.",
            show_default=False,
        ),
    ] = None,
    overlap: Annotated[
        Path | None,
        typer.Option(
            help="Draw into this file, NAME.png, where the surfaces of the contact zones are drawn into each other.",
            show_default=False,
        ),
    ] = None,
    strict: StrictOption = False,
    page: Annotated[
        Path | None,
        typer.Option(
            help="Draw the assembly and what is placed on it into this file. Default: "
            "results/NAME-OF-SCENE/check.html, where a run writes its report.",
            show_default=False,
        ),
    ] = None,
):
    """Validate a scene and print what will be modelled, the process step by step, and at what cost.

    Errors stop. Warnings name what no workshop would build: the item, the number, what is usual, and the remedy.

    Nothing is factorised but where --accuracy, --converge or an `accuracy` of a part asks for it. Where the influence
    coefficients are at hand, a few samples show whether friction matters in each stage, and whether the outcome hangs
    on how the parts are set down.
    """
    _carry_out("check", scene, law, accuracy, converge, normals, overlap, strict, page)


SourceArgument = Annotated[
    Path,
    typer.Argument(
        metavar="SCENE|FOLDER",
        help="Scene file, or a folder that holds scene.toml; a saved model (.npz); or the results folder of a run, "
        "which then keeps what is found, and shows it in its report.",
        show_default=False,
    ),
]
StudyLaw = Annotated[
    Law | None,
    typer.Option(help="Contact law. Default: the scene's first with friction, or its first.", show_default=False),
]
StudySeed = Annotated[
    int | None,
    typer.Option(min=0, max=2**63 - 1, help="Seed of the deviations. Default: the scene's.", show_default=False),
]


@app.command()
def compare(
    before: SourceArgument,
    after: SourceArgument,
    samples: Annotated[
        int | None,
        typer.Option(
            min=3,
            help="Samples to evaluate on both sides. Default: 200; two results folders are compared as they stand.",
            show_default=False,
        ),
    ] = None,
    seed: StudySeed = None,
    law: Annotated[
        list[Law] | None,
        typer.Option(
            "--law",
            help="Contact law of both; repeat it for the second's. Default: the scene's first with friction, or its "
            "first.",
            show_default=False,
        ),
    ] = None,
    out: Annotated[
        Path | None,
        typer.Option(help="Folder for page and tables. Default: results/BEFORE_AFTER.", show_default=False),
    ] = None,
):
    """Compare two scenes, models or runs on the same samples: before and after a change.

    Differences of each mean, 6σ, Cpk and share outside, with the interval that pairing leaves; what the scenes say
    otherwise; and, of two runs with fields, maps of what changes where.
    """
    _carry_out("compare", before, after, samples, seed, law, out)


@app.command()
def explain(
    source: SourceArgument,
    measured: Annotated[
        Path,
        typer.Option(
            help="CSV file of what was measured on one assembly: columns `measurement` (a key characteristic), `value` "
            "(mm from nominal) and `gauge` (its standard deviation, mm).",
            show_default=False,
        ),
    ],
    gauge: Annotated[
        float | None,
        typer.Option(
            help="Standard deviation of the gauge, mm, of all for which the file says none.", show_default=False
        ),
    ] = None,
    friction: Annotated[
        float | None,
        typer.Option(
            min=1e-6,
            help="Standard deviation of the zones' coefficients of friction, should they be unknown as well.",
            show_default=False,
        ),
    ] = None,
    seed: StudySeed = None,
    law: StudyLaw = None,
    out: Annotated[
        Path | None,
        typer.Option(help="Folder for page and tables. Default: results/SCENE_MEASURED.", show_default=False),
    ] = None,
):
    """Go back from the measured key characteristics of one assembly to the most probable sources.

    How far each deviation was off and how surely that is known, which of them the measurement cannot tell apart, and
    which further key characteristic would tell most.
    """
    _carry_out("explain", source, measured, gauge, friction, seed, law, out)


@app.command()
def predict(
    source: SourceArgument,
    parts: Annotated[
        Path | None,
        typer.Option(
            help="CSV file of measured parts, a row for each assembly: columns are the scene's deviations, an empty "
            "cell is one that was not measured.",
            show_default=False,
        ),
    ] = None,
    watch: Annotated[
        Path | None, typer.Option(help="Folder in which such files come in, until Ctrl-C.", show_default=False)
    ] = None,
    log: Annotated[
        Path, typer.Option(help="CSV file to which each assembly is added; what stands in it is not done again.")
    ] = Path("predictions.csv"),
    adjust: Annotated[
        list[str] | None,
        typer.Option(help="Locator or clamp that may be adjusted; may be repeated.", show_default=False),
    ] = None,
    shim: Annotated[float, typer.Option(help="Largest move of a locator or clamp, mm.")] = 0.5,
    force: Annotated[float, typer.Option(help="By which a clamp's force is multiplied or divided at most.")] = 2.0,
    error: Annotated[float, typer.Option(min=0, help="Standard deviation of the model's error, mm.")] = 0.0,
    exact: Annotated[
        bool,
        typer.Option(
            "--exact",
            help="Evaluate every assembly. Otherwise answers come in milliseconds, from a spline between some dozen "
            "assemblies that are evaluated beforehand and kept; what it errs by is part of each interval, and where "
            "it does not decide, the assembly is evaluated.",
        ),
    ] = False,
    law: StudyLaw = None,
):
    """Foretell assemblies one by one from their measured parts: accepted or not, and what to adjust.

    Every key characteristic with the interval that unmeasured deviations leave. Rows farther off than six standard
    deviations are refused. Each answer is on disk before the next row is read.
    """
    _carry_out("predict", source, parts, watch, log, adjust, shim, force, error, exact, law)


@app.command()
def explore(
    source: SourceArgument,
    port: Annotated[
        int, typer.Option(min=0, max=65535, help="Port at which this machine is listened at; 0 takes a free one.")
    ] = 0,
    browser: Annotated[bool, typer.Option("--browser/--no-browser", help="Open the page in the browser.")] = True,
    keep: Annotated[
        Path | None,
        typer.Option(
            help="Write the model to this .npz file, and the shapes of its parts beside it: both are enough to explore "
            "it where there are no finite elements.",
            show_default=False,
        ),
    ] = None,
    shim: Annotated[float, typer.Option(help="The most by which a locator or clamp is moved, mm.")] = 0.5,
    force: Annotated[float, typer.Option(help="The most by which a clamp's force is multiplied, or divided.")] = 2.0,
    law: StudyLaw = None,
):
    """Move sources, shims, clamp forces and friction on a page, and see what becomes of the assembly.

    The deformed assembly in space with the state of its contacts, the key characteristics against their tolerances and
    the certificate of the contact solution follow each move. Samples are picked from their histogram. The page is
    served on this machine alone, to whoever has its address.
    """
    _carry_out("explore", source, port, browser, keep, shim, force, law)


@app.command()
def order(
    source: SourceArgument,
    samples: Annotated[int, typer.Option(min=3, help="Number of samples, the same for every order.")] = 20,
    seed: Annotated[
        int | None,
        typer.Option(min=0, max=2**63 - 1, help="Seed of the deviations. Default: the scene's.", show_default=False),
    ] = None,
    law: Annotated[
        Law | None,
        typer.Option(help="Contact law. Default: the scene's first with friction.", show_default=False),
    ] = None,
    permutations: Annotated[
        int | None,
        typer.Option(min=0, help="Random orders beside those that have a name. Default: a few.", show_default=False),
    ] = None,
    variants: Annotated[
        Path | None,
        typer.Option(
            help="TOML file of `[[orders]]` to compare instead, each with a `name` and, in `stages`, the keys that "
            "change by stage: `stages.clamp.order = [[…], […]]`.",
            show_default=False,
        ),
    ] = None,
    table: Annotated[Path | None, typer.Option(help="Write all numbers to this CSV file.", show_default=False)] = None,
):
    """Say how much hangs on the order in which locators, clamps and welds close and open.

    The key characteristics of the same samples under other orders: in reverse, locators first, clamps first, all
    together, parts that overlap settled before or while the first thing closes, and a few at random.
    """
    _carry_out("order", source, samples, seed, law, permutations, variants, table)


@app.command()
def contributors(
    source: SourceArgument,
    samples: Annotated[
        int, typer.Option(min=8, help="Samples N; N (g + 2) evaluations are made of g contributors.")
    ] = 128,
    seed: StudySeed = None,
    law: StudyLaw = None,
):
    """Say what drives each key characteristic, and whether a linear analysis would have found it.

    Sobol's indices on the reduced model itself, with their intervals: which share of the variance each deviation makes
    alone, and which with its interactions. Beside them what a linear analysis says, and a warning where it misleads.
    """
    _carry_out("contributors", source, samples, seed, law)


@app.command()
def sensitivity(
    source: SourceArgument,
    samples: Annotated[
        int, typer.Option(min=0, help="Samples beside the mean assembly, over which the derivatives' range is told.")
    ] = 20,
    seed: StudySeed = None,
    law: StudyLaw = None,
):
    """Say what a step of each deviation, locator, clamp and friction changes, and how far the next contact change is.

    Exact derivatives of the key characteristics, through contact, friction and what the stages remember.
    """
    _carry_out("sensitivity", source, samples, seed, law)


@app.command()
def friction(
    source: SourceArgument,
    samples: Annotated[int, typer.Option(min=3, help="Samples, the same for every coefficient of friction.")] = 60,
    seed: StudySeed = None,
    law: StudyLaw = None,
):
    """Say whether friction matters: what no, half and twice the friction change of each key characteristic.

    All zones together and each alone, with the same samples; and how well each zone's coefficient must be known.
    """
    _carry_out("friction", source, samples, seed, law)


@app.command()
def rare(
    source: SourceArgument,
    measurement: Annotated[
        list[str] | None,
        typer.Option(help="Key characteristic to look at by itself as well; may be repeated.", show_default=False),
    ] = None,
    samples: Annotated[int, typer.Option(min=100, help="Samples of each level, a multiple of 10.")] = 1000,
    seed: StudySeed = None,
    law: StudyLaw = None,
):
    """Say how often limits are missed where that is rare, below a thousand in a million.

    Subset simulation on the reduced model itself: no distribution is fitted, nothing is extrapolated. Each tenth of the
    probability takes about as many evaluations as there are samples.
    """
    _carry_out("rare", source, measurement, samples, seed, law)


@app.command()
def remedy(
    source: SourceArgument,
    adjust: Annotated[
        list[str] | None,
        typer.Option(
            help="Locator or clamp that may be adjusted; may be repeated. Default: all but the locators that hold the "
            "assembly while it is measured.",
            show_default=False,
        ),
    ] = None,
    shim: Annotated[float, typer.Option(help="The most by which a locator or clamp is moved, mm.")] = 0.5,
    force: Annotated[float, typer.Option(help="The most by which a clamp's force is multiplied, or divided.")] = 2.0,
    capability: Annotated[float, typer.Option(min=0.0, help="Cpk that is asked for.")] = 1.0,
    samples: Annotated[int, typer.Option(min=3, help="Samples of each set.")] = 60,
    seed: StudySeed = None,
    law: StudyLaw = None,
    save: Annotated[
        Path | None,
        typer.Option(help="Write the scene with the last remedy that serves to this file.", show_default=False),
    ] = None,
):
    """Say which shim, locator move or clamp force would bring the assembly within its limits.

    From exact derivatives, one adjustment at a time for the worst characteristic, and the smallest changes of all
    together for all of them; each is evaluated in full on other samples before it is told.
    """
    _carry_out("remedy", source, adjust or [], shim, force, capability, samples, seed, law, save)


@app.command()
def optimise(
    source: SourceArgument,
    samples: Annotated[
        int, typer.Option(min=20, help="Samples with which designs are compared, rounded up to a multiple of 20.")
    ] = 60,
    fresh: Annotated[int, typer.Option(min=20, help="Other samples, with which the best is judged.")] = 400,
    budget: Annotated[int, typer.Option(min=20, help="Evaluations of an assembly in the search.")] = 20_000,
    seed: StudySeed = None,
    law: StudyLaw = None,
    save: Annotated[
        Path | None,
        typer.Option(help="Write the scene with the changes to this file, beside the scene.", show_default=False),
    ] = None,
    out: Annotated[
        Path | None,
        typer.Option(
            help="Folder for tables, and for what is evaluated. Default: results/NAME-OF-SCENE_optimised.",
            show_default=False,
        ),
    ] = None,
):
    """Find the clamp forces, shims, orders, places and matching of parts that make an assembly best.

    What may be changed, what for and what must be kept stands in the scene's table `[optimise]`. Designs are judged
    over the variation of the inputs, the best on samples that had no part in the search, with the interval of its gain.
    A call that was stopped goes on where it was.
    """
    _carry_out("optimise", source, samples, fresh, budget, seed, law, save, out)


@app.command()
def init(
    meshes: Annotated[
        list[Path] | None, typer.Argument(help="Mesh files of the parts, one or several.", show_default=False)
    ] = None,
    example: Annotated[
        str | None,
        typer.Option(help=f"Copy an example instead: one of {', '.join(examples.names())}.", show_default=False),
    ] = None,
    out: Annotated[
        Path | None, typer.Option(help="The new folder. Default: one called after the meshes.", show_default=False)
    ] = None,
    thickness: Annotated[
        list[str] | None,
        typer.Option(
            help="mm, of the parts whose mesh file tells none; or PART=mm, of one. May be repeated.", show_default=False
        ),
    ] = None,
    welds: Annotated[
        Path | None,
        typer.Option(
            help="CSV file of the spot welds, columns x, y, z and perhaps name, parts. Default: welds are proposed.",
            show_default=False,
        ),
    ] = None,
    points: Annotated[
        Path | None,
        typer.Option(
            help="CSV file of the points to measure, columns x, y, z and perhaps name, part, direction, lower, upper.",
            show_default=False,
        ),
    ] = None,
):
    """Write a first scene for meshes of your own, or copy an example, to start from.

    From the meshes alone come parts, a 3-2-1 for each and further supports, contact zones where they lie on each other,
    clamps and welds along these, points to measure at the free edges and a few deviations; every line says what it
    means. The scene runs as it is.
    """
    _carry_out("init", meshes, example, out, thickness, welds, points)
