"""Command line: the commands and their options. :mod:`mic.commands` implements them.

Nothing slow is imported here, so that ``mic --help`` appears at once.
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
Variation simulation of sheet-metal assemblies: do they stay within tolerance when parts deviate from nominal and
contacts have friction?

A *scene* (a TOML file) states parts, locators, clamps, welds, contact zones, process stages, deviations and
measurements. `mic check` validates it and shows what will be modelled; `mic run` does the Monte Carlo and writes a
report.

Start with:  mic init --example lap_joint  then  mic check lap_joint  and  mic run lap_joint --samples 50
""",
)

#: Values of the options; the contact laws and the scene define them.
Law = Enum("Law", {name: name for name in LAWS}, type=str)  # type: ignore[misc]
Backend = Enum("Backend", {name: name for name in ("native", "paper")}, type=str)  # type: ignore[misc]


def _option(text: str, *names: str, **settings: Any) -> Any:
    """An option without a value shown as its default: its help text says what applies if it is not given."""
    return typer.Option(*names, help=text, show_default=False, **settings)


SceneArgument = Annotated[
    Path, typer.Argument(help="Scene file, or a folder that contains scene.toml.", show_default=False)
]
SourceArgument = Annotated[
    Path,
    typer.Argument(
        metavar="SCENE|FOLDER",
        help="Scene file, or a folder that contains scene.toml; a saved model (.npz); or the results folder of a run.",
        show_default=False,
    ),
]
Laws = Annotated[
    list[Law] | None,
    _option(
        "Contact law; repeat the option for several. "
        + " ".join(f"`{law.name}`: {law.title}" for law in LAWS.values())
        + " Default: the scene's.",
        "--law",
    ),
]
StudyLaw = Annotated[
    Law | None, _option("Contact law. Default: the first law of the scene that has friction, else its first law.")
]
Seed = Annotated[int | None, _option("Seed of the random deviations. Default: the scene's.", min=0, max=2**63 - 1)]
Strict = Annotated[bool, typer.Option("--strict", help="Treat warnings as errors: exit status 2.")]
Shim = Annotated[float, typer.Option(help="Largest shift of a locator or clamp, mm.")]
ForceFactor = Annotated[float, typer.Option(help="Largest factor by which a clamp force is multiplied or divided.")]


def _run_command(name: str, *values: Any) -> None:
    """Call the implementation of a command with the values of its options."""
    module = {"report": "run"} | {
        own: own for own in ("check", "compare", "explain", "explore", "init", "optimise", "predict", "run")
    }
    # Imported only now: numerics and tables take a second.
    getattr(import_module(f"mic.commands.{module.get(name, 'studies')}"), name)(*values)


@app.command()
def run(
    scene: SceneArgument,
    samples: Annotated[int | None, _option("Number of samples. Default: the scene's.", min=1)] = None,
    seed: Seed = None,
    law: Laws = None,
    backend: Annotated[
        Backend | None,
        _option(
            "`paper` solves (12) with OSQP and (13) with ECOS through CVXPY and takes some hundred times as long. "
            "Default: the scene's."
        ),
    ] = None,
    out: Annotated[Path | None, _option("Results folder. Default: results/NAME-OF-SCENE.")] = None,
    replace: Annotated[
        bool,
        typer.Option(
            "--replace",
            help="Remove the results of another run from the folder; other files stay. Without this option, a folder "
            "with the results of another run is refused.",
        ),
    ] = False,
    strict: Strict = False,
):
    """Run the Monte Carlo of a scene and write tables, fields and a report.

    Influence coefficients are computed once and cached; later runs of the same scene reuse them. Finished samples are
    saved: run the command again to complete an interrupted run, or with more samples to extend it. Under
    `mpirun -n N`, N processes share the samples.
    """
    _run_command("run", scene, samples, seed, law, backend, out, replace, strict)


@app.command()
def report(
    folder: Annotated[
        Path, typer.Argument(help="Results folder of a run, complete or interrupted.", show_default=False)
    ],
    excel: Annotated[bool, typer.Option("--excel", help="Also write all tables to tables.xlsx.")] = False,
):
    """Rewrite statistics, fields and report of a results folder from its samples."""
    _run_command("report", folder, excel)


@app.command()
def check(
    scene: SceneArgument,
    law: Laws = None,
    accuracy: Annotated[
        bool,
        typer.Option(
            "--accuracy",
            help="Estimate the error of each part's mesh: compare its influence coefficients with those of a mesh with "
            "half the element size.",
        ),
    ] = False,
    converge: Annotated[
        bool,
        typer.Option(
            "--converge",
            help="Evaluate the nominal assembly and some samples again with about twice as many contact pairs, and "
            "print how the key characteristics change.",
        ),
    ] = False,
    normals: Annotated[
        Path | None,
        _option(
            "Write a picture, NAME.png, that shows how each surface normal was obtained: given, estimated or flat."
        ),
    ] = None,
    overlap: Annotated[
        Path | None, _option("Write a picture, NAME.png, of the nominal overlap of the surfaces in the contact zones.")
    ] = None,
    strict: Strict = False,
    page: Annotated[
        Path | None,
        _option(
            "Write the page with the assembly and everything placed on it to this file. Default: "
            "results/NAME-OF-SCENE/check.html."
        ),
    ] = None,
):
    """Validate a scene and print what will be modelled, the process step by step, and the cost.

    Errors stop the command. A warning names the item, its unusual value, the usual range and the remedy.

    No stiffness matrix is factorised unless --accuracy, --converge or `accuracy` of a part asks for it. If the
    influence coefficients are cached, a few samples show whether friction matters in each stage and whether the
    result depends on how the parts are placed.
    """
    _run_command("check", scene, law, accuracy, converge, normals, overlap, strict, page)


@app.command()
def compare(
    before: SourceArgument,
    after: SourceArgument,
    samples: Annotated[
        int | None,
        _option(
            "Samples evaluated on both sides. Default: 200; two results folders are compared with the samples they "
            "have.",
            min=3,
        ),
    ] = None,
    seed: Seed = None,
    law: Annotated[
        list[Law] | None,
        _option(
            "Contact law of both sides; give it twice for different laws. Default: the first law of the scene that has "
            "friction, else its first law.",
            "--law",
        ),
    ] = None,
    out: Annotated[Path | None, _option("Folder for page and tables. Default: results/BEFORE_AFTER.")] = None,
):
    """Compare two scenes, models or runs on the same samples: before and after a change.

    Prints the differences of each mean, 6σ, Cpk and share outside the limits with the confidence intervals of paired
    samples, and the differences between the scenes. For two runs with fields, the page maps the changes.
    """
    _run_command("compare", before, after, samples, seed, law, out)


@app.command()
def explain(
    source: SourceArgument,
    measured: Annotated[
        Path,
        _option(
            "CSV file with the measurements of one assembly: columns `measurement` (a key characteristic), `value` (mm "
            "from nominal) and `gauge` (standard deviation of the gauge, mm)."
        ),
    ],
    gauge: Annotated[
        float | None, _option("Standard deviation of the gauge, mm, for rows of the file that give none.")
    ] = None,
    friction: Annotated[
        float | None,
        _option(
            "Standard deviation of the zones' coefficients of friction, if these are to be estimated too.", min=1e-6
        ),
    ] = None,
    seed: Seed = None,
    law: StudyLaw = None,
    out: Annotated[Path | None, _option("Folder for page and tables. Default: results/SCENE_MEASURED.")] = None,
):
    """Infer the most probable deviations of one assembly from its measured key characteristics.

    Prints each deviation with its confidence interval, the deviations that the measurements cannot distinguish, and
    the further key characteristic whose measurement would be most informative.
    """
    _run_command("explain", source, measured, gauge, friction, seed, law, out)


@app.command()
def predict(
    source: SourceArgument,
    parts: Annotated[
        Path | None,
        _option(
            "CSV file of measured parts with one row for each assembly: columns are the scene's deviations; leave a "
            "cell empty if the deviation was not measured."
        ),
    ] = None,
    watch: Annotated[Path | None, _option("Folder to watch for such files, until Ctrl-C.")] = None,
    log: Annotated[
        Path, typer.Option(help="CSV file to which each prediction is appended; rows that it contains are skipped.")
    ] = Path("predictions.csv"),
    adjust: Annotated[
        list[str] | None, _option("Locator or clamp that may be adjusted; repeat the option for several.")
    ] = None,
    shim: Shim = 0.5,
    force: ForceFactor = 2.0,
    error: Annotated[float, typer.Option(min=0, help="Standard deviation of the model error, mm.")] = 0.0,
    exact: Annotated[
        bool,
        typer.Option(
            "--exact",
            help="Evaluate every assembly. Without this option a spline emulator, trained on some dozen cached "
            "evaluations, predicts in milliseconds; its error widens each interval, and if the verdict remains open, "
            "the assembly is evaluated.",
        ),
    ] = False,
    law: StudyLaw = None,
):
    """Predict individual assemblies from their measured parts: accepted or rejected, and what to adjust.

    Each key characteristic is given with the interval that follows from the deviations that were not measured. Rows
    with a deviation beyond six standard deviations are refused. Each prediction is saved before the next row is read.
    """
    _run_command("predict", source, parts, watch, log, adjust, shim, force, error, exact, law)


@app.command()
def explore(
    source: SourceArgument,
    port: Annotated[
        int, typer.Option(min=0, max=65535, help="Port of the page on this machine; 0: any free port.")
    ] = 0,
    browser: Annotated[bool, typer.Option("--browser/--no-browser", help="Open the page in the browser.")] = True,
    keep: Annotated[
        Path | None,
        _option(
            "Save the model to this .npz file and the displacement shapes of its parts beside it. With both files, mic "
            "explore needs no finite-element code."
        ),
    ] = None,
    shim: Shim = 0.5,
    force: ForceFactor = 2.0,
    law: StudyLaw = None,
):
    """Change deviations, shims, clamp forces and friction on an interactive page and see the deformed assembly.

    Each change updates the deformed assembly with the state of its contacts, the key characteristics against their
    tolerances, and the certificate of the contact solution. A click on a histogram shows one of its samples. Only
    this machine can open the page.
    """
    _run_command("explore", source, port, browser, keep, shim, force, law)


@app.command()
def order(
    source: SourceArgument,
    samples: Annotated[int, typer.Option(min=3, help="Number of samples; the same samples for every order.")] = 20,
    seed: Seed = None,
    law: StudyLaw = None,
    permutations: Annotated[
        int | None, _option("Random orders in addition to the named ones. Default: a few.", min=0)
    ] = None,
    variants: Annotated[
        Path | None,
        _option(
            "TOML file of `[[orders]]` to compare instead, each with a `name` and, under `stages`, the keys that "
            "change by stage: `stages.clamp.order = [[…], […]]`."
        ),
    ] = None,
    table: Annotated[Path | None, _option("Write all numbers to this CSV file.")] = None,
):
    """Show how much the result depends on the order in which locators, clamps and welds close and open.

    Evaluates the same samples in other orders: reversed, locators first, clamps first, all together, overlapping parts
    settled before or while the first item closes, and a few at random.
    """
    _run_command("order", source, samples, seed, law, permutations, variants, table)


@app.command()
def contributors(
    source: SourceArgument,
    samples: Annotated[int, typer.Option(min=8, help="Samples N; g contributors take N (g + 2) evaluations.")] = 128,
    seed: Seed = None,
    law: StudyLaw = None,
):
    """Rank the deviations by their share of the variance of each key characteristic.

    Computes Sobol indices on the reduced model, with confidence intervals: the share of the variance that each
    deviation causes alone (first-order) and including interactions (total). A linear analysis is shown beside them,
    with a warning if it misleads.
    """
    _run_command("contributors", source, samples, seed, law)


@app.command()
def sensitivity(
    source: SourceArgument,
    samples: Annotated[
        int,
        typer.Option(min=0, help="Samples, besides the mean assembly, over which the range of derivatives is given."),
    ] = 20,
    seed: Seed = None,
    law: StudyLaw = None,
):
    """Show the effect of a step of each deviation, locator, clamp and friction coefficient.

    Exact derivatives of the key characteristics through contact, friction and the history of the stages, and how many
    steps away the next change of a contact state is.
    """
    _run_command("sensitivity", source, samples, seed, law)


@app.command()
def friction(
    source: SourceArgument,
    samples: Annotated[
        int, typer.Option(min=3, help="Samples; the same samples for every coefficient of friction.")
    ] = 60,
    seed: Seed = None,
    law: StudyLaw = None,
):
    """Show whether friction matters: effect of zero, half and twice the friction on each key characteristic.

    All zones together and each zone alone, with the same samples; and how accurately each zone's coefficient must be
    known.
    """
    _run_command("friction", source, samples, seed, law)


@app.command()
def rare(
    source: SourceArgument,
    measurement: Annotated[
        list[str] | None,
        _option("Key characteristic to analyse on its own as well; repeat the option for several."),
    ] = None,
    samples: Annotated[int, typer.Option(min=100, help="Samples of each level, a multiple of 10.")] = 1000,
    seed: Seed = None,
    law: StudyLaw = None,
):
    """Estimate the probability of rare misses of a limit, below 1000 ppm.

    Subset simulation on the reduced model: no distribution is fitted and nothing is extrapolated. Each factor of ten in
    the probability takes about as many evaluations as --samples.
    """
    _run_command("rare", source, measurement, samples, seed, law)


@app.command()
def remedy(
    source: SourceArgument,
    adjust: Annotated[
        list[str] | None,
        _option(
            "Locator or clamp that may be adjusted; repeat the option for several. Default: all except the locators "
            "that hold the assembly while it is measured."
        ),
    ] = None,
    shim: Shim = 0.5,
    force: ForceFactor = 2.0,
    capability: Annotated[float, typer.Option(min=0.0, help="Required Cpk.")] = 1.0,
    samples: Annotated[int, typer.Option(min=3, help="Samples of each set.")] = 60,
    seed: Seed = None,
    law: StudyLaw = None,
    save: Annotated[Path | None, _option("Write the scene with the last successful remedy to this file.")] = None,
):
    """Find the shim, locator shift or clamp force that brings the assembly within its limits.

    Uses exact derivatives to find single adjustments for the worst characteristic, and the smallest combined changes
    for all characteristics. Each remedy is evaluated in full on fresh samples before it is reported.
    """
    _run_command("remedy", source, adjust or [], shim, force, capability, samples, seed, law, save)


@app.command()
def optimise(
    source: SourceArgument,
    samples: Annotated[
        int, typer.Option(min=20, help="Samples with which designs are compared, rounded up to a multiple of 20.")
    ] = 60,
    fresh: Annotated[
        int, typer.Option(min=20, help="Fresh samples, not used in the search, on which the best design is evaluated.")
    ] = 400,
    budget: Annotated[int, typer.Option(min=20, help="Evaluations of an assembly in the search.")] = 20_000,
    seed: Seed = None,
    law: StudyLaw = None,
    save: Annotated[
        Path | None, _option("Write the scene with the changes to this file, in the folder of the scene.")
    ] = None,
    out: Annotated[
        Path | None,
        _option("Folder for tables and for the log of evaluations. Default: results/NAME-OF-SCENE_optimised."),
    ] = None,
):
    """Optimise clamp forces, shims, orders, places and the matching of parts.

    The scene's table `[optimise]` states the objective, the allowed changes and the constraints. Designs are compared
    over the variation of the inputs; the best is evaluated on fresh samples, with the confidence interval of its
    gain. A stopped search continues when the command is run again.
    """
    _run_command("optimise", source, samples, fresh, budget, seed, law, save, out)


@app.command()
def init(
    meshes: Annotated[
        list[Path] | None, typer.Argument(help="Mesh files of the parts, one or several.", show_default=False)
    ] = None,
    example: Annotated[str | None, _option(f"Copy an example instead: one of {', '.join(examples.names())}.")] = None,
    out: Annotated[Path | None, _option("The new folder. Default: named after the meshes.")] = None,
    thickness: Annotated[
        list[str] | None,
        _option(
            "Thickness in mm of all parts whose mesh file gives none, or PART=mm for one part; repeat the option for "
            "several."
        ),
    ] = None,
    welds: Annotated[
        Path | None,
        _option("CSV file of the spot welds: columns x, y, z and optionally name, parts. Default: welds are proposed."),
    ] = None,
    points: Annotated[
        Path | None,
        _option(
            "CSV file of the points to measure: columns x, y, z and optionally name, part, direction, lower, upper."
        ),
    ] = None,
):
    """Write a first scene for your own meshes, or copy an example.

    From the meshes alone, the scene gets parts, 3-2-1 locators and further supports for each part, contact zones where
    parts face each other, clamps and welds along the zones, measurements at free edges, and a few deviations. Comments
    explain every line. The scene runs without changes.
    """
    _run_command("init", meshes, example, out, thickness, welds, points)
