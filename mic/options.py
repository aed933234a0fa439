"""Command line: the commands and their options. :mod:`mic.commands` implements them.

``options.toml`` holds the help texts of the options and the limits of their values. Nothing slow is imported here, so
that ``mic --help`` appears at once.
"""

from __future__ import annotations

import os
import tomllib
from collections.abc import Callable
from enum import Enum
from functools import wraps
from importlib import import_module
from inspect import Parameter, signature
from pathlib import Path
from typing import Any

import typer
from rich.console import Console

from mic import examples
from mic.contact.laws import LAWS
from mic.errors import RunError
from mic.system.console import plain
from mic.system.foreign_files import ALSO_READ, NO_SCRIPTS

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
Objective = Enum("Objective", {name: name for name in ("yield", "rms", "cpk", "cost")}, type=str)  # type: ignore[misc]
Backend = Enum("Backend", {name: name for name in ("native", "paper")}, type=str)  # type: ignore[misc]


_ARGUMENTS = {"scene", "source", "folder", "before", "after", "meshes"}  # given without --NAME
_SOURCES = {"scene", "source", "before", "meshes"}  # arguments of commands that read files of a user
#: What a scene may reach: options of all these commands.
_READING = [
    Parameter("also_read", Parameter.KEYWORD_ONLY, default=None, annotation=list[Path] | None),
    Parameter("no_scripts", Parameter.KEYWORD_ONLY, default=False, annotation=bool),
]


def _prediction(
    *,
    adjust: list[str] | None = None,
    shim: float | None = None,
    force: float | None = None,
    objective: Objective | None = None,
    step: float | None = None,
    most: int | None = None,
    error: float = 0.0,
    exact: bool = False,
    law: Law | None = None,
): ...


_PREDICTION = [*signature(_prediction, eval_str=True).parameters.values()]  # options of `mic predict` and `mic serve`
_OPTIONS = tomllib.loads(Path(__file__).with_suffix(".toml").read_text(encoding="utf-8"))
_LISTS = {
    "laws": " ".join(f"`{law.name}`: {law.title}" for law in LAWS.values()),
    "examples": ", ".join(examples.names()),
}


def _command(module: str, first: str = "") -> Callable[[Callable[..., None]], Callable[..., None]]:
    """Decorator that adds a command with the parameters of a function.

    The function of the same name in a module of :mod:`mic.commands` implements it. `first` is a line that is printed
    at once, with the values of the parameters.
    """

    def add(function: Callable[..., None]) -> Callable[..., None]:
        name, own = function.__name__, signature(function)
        reads = _READING if _SOURCES & own.parameters.keys() else []
        declared = _OPTIONS["shared"] | _OPTIONS.get(name, {})

        @wraps(function)
        def command(**values: Any) -> None:
            _set_access(values)
            if first:
                Console().print(plain(first.format(**values)), highlight=False, soft_wrap=True)
            getattr(import_module(f"mic.commands.{module}"), name)(**values)  # numerics and tables take a second

        stated = [one for one in own.parameters.values() if one.kind is not Parameter.VAR_KEYWORD]
        every = [*stated, *(_PREDICTION if "prediction" in own.parameters else []), *reads]
        parameters = [one.replace(default=_parameter(one, **declared[one.name])) for one in every]
        command.__signature__ = own.replace(parameters=parameters)  # type: ignore[attr-defined]
        return app.command()(command)

    return add


def _set_access(values: dict[str, Any]) -> None:
    """Take the options of what a scene may reach out of a command's values, and set their environment variables."""
    if values.pop("no_scripts", False):
        os.environ[NO_SCRIPTS] = "1"
    if folders := values.pop("also_read", None):
        for folder in folders:
            if not folder.is_dir():
                raise RunError(f"--also-read {folder}: there is no such folder; correct the name")
        given = [os.environ[ALSO_READ]] if os.environ.get(ALSO_READ) else []
        os.environ[ALSO_READ] = os.pathsep.join([*given, *map(os.path.abspath, folders)])


def _parameter(parameter: Parameter, help: str, **settings: Any) -> Any:
    """An argument or option as ``options.toml`` declares it; without a default, its text says what then applies."""
    default = ... if parameter.default is Parameter.empty else parameter.default
    settings |= {"help": help.format(**_LISTS), "show_default": default not in (None, ...)}
    if parameter.name in _ARGUMENTS:
        return typer.Argument(default, **settings)
    names = (f"--{parameter.name.replace('_', '-')}",) if default is False else ()  # no --no-NAME
    return typer.Option(default, *names, **settings)


@_command("run")
def run(
    scene: Path,
    samples: int | None = None,
    accuracy: float | None = None,
    seed: int | None = None,
    law: list[Law] | None = None,
    backend: Backend | None = None,
    out: Path | None = None,
    replace: bool = False,
    strict: bool = False,
    no_report: bool = False,
    engine: str | None = None,
):
    """Run the Monte Carlo of a scene and write tables, fields and a report.

    Influence coefficients are computed once and cached; later runs of the same scene reuse them. Finished samples are
    saved: run the command again to complete an interrupted run, or with more samples to extend it. All cores share the
    samples; under `mpirun -n N`, N processes do.
    """


@_command("run")
def report(folder: Path, excel: bool = False):
    """Rewrite statistics, fields and report of a results folder from its samples."""


@_command("check", "Reading {scene} …")
def check(
    scene: Path,
    law: list[Law] | None = None,
    accuracy: bool = False,
    converge: bool = False,
    normals: Path | None = None,
    overlap: Path | None = None,
    strict: bool = False,
    page: Path | None = None,
):
    """Validate a scene and print what will be modelled, the process step by step, and the cost.

    Errors stop the command. A warning names the item, its unusual value, the usual range and the remedy.

    No stiffness matrix is factorised unless --accuracy, --converge or a part's key `accuracy` requests it. If the
    influence coefficients are cached, a few samples show whether friction matters in each stage and whether the
    result depends on how the parts are placed.
    """


@_command("compare")
def compare(
    before: Path,
    after: Path,
    samples: int | None = None,
    seed: int | None = None,
    law: list[Law] | None = None,
    out: Path | None = None,
):
    """Compare two scenes, models or runs on the same samples: before and after a change.

    Prints the differences of each mean, 6σ, Cpk and share outside the limits with the confidence intervals of paired
    samples, and the differences between the scenes. For two runs with fields, the page maps the changes.
    """


@_command("explain")
def explain(
    source: Path,
    measured: Path,
    gauge: float | None = None,
    piece: str | None = None,
    align: bool = False,
    friction: float | None = None,
    seed: int | None = None,
    law: Law | None = None,
    out: Path | None = None,
):
    """Infer the most probable deviations of one assembly from its measured key characteristics.

    Prints each deviation with its confidence interval, the deviations that the measurements cannot distinguish, and
    the further key characteristic whose measurement would be most informative.
    """


@_command("predict")
def predict(
    source: Path,
    parts: Path | None = None,
    scan: Path | None = None,
    watch: Path | None = None,
    log: Path = Path("predictions.csv"),
    **prediction: Any,
):
    """Predict individual assemblies from their measured parts: accepted or rejected, and what to adjust.

    Each key characteristic is given with the interval that follows from the deviations that were not measured. Rows
    with a deviation beyond six standard deviations are refused. Each prediction is saved before the next row is read.
    """


@_command("serve")
def serve(
    source: Path,
    port: int = 8046,
    host: str = "127.0.0.1",
    token: Path = Path("serve.token"),
    log: Path = Path("assemblies.jsonl"),
    queue: int = 100,
    seconds: float = 30.0,
    engine: str | None = None,
    scans: Path | None = None,
    **prediction: Any,
):
    """Serve predictions of individual assemblies over HTTP, for a production line.

    As `mic predict`: measured deviations or scans in; verdict, characteristics, adjustment and certificate out. The
    service describes itself at /openapi.json. Every request and answer is logged before it takes effect; requests that
    a kill interrupted are answered at the next start.
    """


@_command("serve")
def export(source: Path, fmu: Path, shim: float = 0.5, force: float = 2.0, law: Law | None = None):
    """Export the reduced model as an FMI 3.0 unit for co-simulation.

    Inputs are the deviations, and changes of locators and clamps; outputs are the key characteristics. The unit
    contains the model; it needs Python with this program where it is used.
    """


@_command("explore")
def explore(
    source: Path,
    port: int = 0,
    browser: bool = True,
    keep: Path | None = None,
    shim: float = 0.5,
    force: float = 2.0,
    law: Law | None = None,
):
    """Change deviations, shims, clamp forces and friction on an interactive page and see the deformed assembly.

    Each change updates the deformed assembly with the state of its contacts, the key characteristics against their
    tolerances, and the certificate of the contact solution. A click on a histogram shows one of its samples. Only
    this machine can open the page.
    """


@_command("studies")
def order(
    source: Path,
    samples: int = 20,
    seed: int | None = None,
    law: Law | None = None,
    permutations: int | None = None,
    variants: Path | None = None,
    table: Path | None = None,
):
    """Show how much the result depends on the order in which locators, clamps and welds close and open.

    Evaluates the same samples in other orders: reversed, locators first, clamps first, all together, overlapping parts
    settled before or while the first item closes, and a few at random.
    """


@_command("studies")
def contributors(source: Path, samples: int = 128, seed: int | None = None, law: Law | None = None):
    """Rank the deviations by their share of the variance of each key characteristic.

    Computes Sobol indices on the reduced model, with confidence intervals: the share of the variance that each
    deviation causes alone (first-order) and including interactions (total). A linear analysis is shown beside them,
    with a warning if it misleads.
    """


@_command("studies")
def sensitivity(source: Path, samples: int = 20, seed: int | None = None, law: Law | None = None):
    """Show the effect of a step of each deviation, locator, clamp and friction coefficient.

    Exact derivatives of the key characteristics through contact, friction and the history of the stages, and how many
    steps away the next change of a contact state is.
    """


@_command("studies")
def friction(source: Path, samples: int = 60, seed: int | None = None, law: Law | None = None):
    """Show whether friction matters: effect of zero, half and twice the friction on each key characteristic.

    All zones together and each zone alone, with the same samples; and how accurately each zone's coefficient must be
    known.
    """


@_command("studies")
def rare(
    source: Path,
    measurement: list[str] | None = None,
    samples: int = 1000,
    seed: int | None = None,
    law: Law | None = None,
):
    """Estimate the probability of rare misses of a limit, below 1000 ppm.

    Subset simulation on the reduced model: no distribution is fitted and nothing is extrapolated. Each factor of ten in
    the probability takes about as many evaluations as --samples.
    """


@_command("studies")
def remedy(
    source: Path,
    adjust: list[str] | None = None,
    shim: float = 0.5,
    force: float = 2.0,
    capability: float = 1.0,
    samples: int = 60,
    seed: int | None = None,
    law: Law | None = None,
    save: Path | None = None,
):
    """Find the shim, locator shift or clamp force that brings the assembly within its limits.

    Uses exact derivatives to find single adjustments for the worst characteristic, and the smallest combined changes
    for all characteristics. Each remedy is evaluated in full on fresh samples before it is reported.
    """


@_command("optimise")
def optimise(
    source: Path,
    samples: int = 60,
    fresh: int = 400,
    budget: int = 20_000,
    seed: int | None = None,
    law: Law | None = None,
    save: Path | None = None,
    out: Path | None = None,
):
    """Optimise clamp forces, shims, orders, positions and the matching of parts.

    The scene's table `[optimise]` states the objective, the allowed changes and the constraints. Designs are compared
    over the variation of the inputs; the best is evaluated on fresh samples, with the confidence interval of its
    gain. A stopped search continues when the command is run again.
    """


@_command("init")
def init(
    meshes: list[Path] | None = None,
    example: str | None = None,
    out: Path | None = None,
    thickness: list[str] | None = None,
    name: list[str] | None = None,
    welds: Path | None = None,
    points: Path | None = None,
    table: str | None = None,
):
    """Write a first scene for your own meshes, or copy an example.

    From the meshes alone, the scene gets parts, 3-2-1 locators and further supports for each part, contact zones where
    parts face each other, clamps and welds along the zones, measurements at free edges, and a few deviations. Comments
    explain every line. The scene runs without changes.
    """
