"""``mic explain``."""

from __future__ import annotations

import re
from pathlib import Path

import numpy as np
from rich.console import Console
from rich.table import Table

from mic.commands.invocation import counting, law_of, on_one_process, seed_of, studied, threads
from mic.errors import SceneError
from mic.results.schema import EXPLANATION, FURTHER
from mic.scene.tables import read_cells, read_number
from mic.studies.explanation import explain as explained
from mic.system.console import plain

__all__ = ["explain", "read_measured"]

COLUMNS = ("measurement", "value", "gauge")
LISTED = 12  # sources on the console


@on_one_process
def explain(source, measured, gauge, friction, seed, law, out):
    """``mic explain``, with the values of its options (:mod:`mic.options`)."""
    from mic.report.explanation_page import sentences, write_explanation  # drawing libraries are slow to import

    console = Console()
    values, gauges = read_measured(measured, gauge)
    model, _ = studied(console, source)
    strange = [name for name in values if name not in {item.name for item in model.scene.measurements}]
    if strange:
        names = ", ".join(item.name for item in model.scene.measurements) or "none"
        raise SceneError(
            f"{measured}: scene {model.scene.name!r} has no key characteristic {strange[0]!r}, it has: {names}; "
            "correct the name, or give the file of this scene"
        )
    asked = law_of(model, law)
    with counting(console, f"evaluations under {asked}", None) as advance:
        found = explained(model, values, gauges, asked, friction, seed_of(model.scene, seed), threads(), advance)
    folder = out or Path("results") / re.sub(r"[^\w.+-]+", "-", f"{model.scene.name}_{measured.stem}")
    EXPLANATION.write(folder, found.table)
    FURTHER.write(folder, found.further)
    page = write_explanation(folder / "explanation.html", found)
    _print(console, found)
    for sentence in sentences(found):
        console.print(plain(sentence), highlight=False, soft_wrap=True)
    console.print(f"page: [bold]{plain(page)}[/]   table: {plain(folder / EXPLANATION.place)}", soft_wrap=True)


def read_measured(path: Path, gauge: float | None) -> tuple[dict[str, float], dict[str, float]]:
    """Values and gauges' standard deviations, mm, by key characteristic, of a CSV file.

    Parameters
    ----------
    path : Path
        Columns ``measurement``, ``value`` and, unless one gauge is given for all, ``gauge``.
    gauge : float or None
        Of those for which the file says none.

    Raises
    ------
    SceneError
        Naming file, row and column.
    """
    cells, separator = read_cells(path, "the folder that you are in")
    columns = [str(name) for name in cells.columns]
    for name in columns:
        if name not in COLUMNS:
            raise SceneError(f"{path}: row 1: there is no column {name!r}; columns are {', '.join(COLUMNS)}")
    for name in COLUMNS[: 2 if gauge is not None else 3]:
        if name not in columns:
            remedy = "add it, or give --gauge" if name == "gauge" else "add it"
            raise SceneError(f"{path}: row 1: there is no column {name!r}; {remedy}")
    values: dict[str, float] = {}
    gauges: dict[str, float] = {}
    for number, row in enumerate(cells.to_dict("records"), 2):
        told = {str(key): str(cell).strip() for key, cell in row.items()}
        if not any(told.values()):
            continue
        name = told["measurement"]
        if not name or name in values:
            what = f"{name!r} stands there twice; take one row out" if name else "is empty; name what was measured"
            raise SceneError(f"{path}: row {number}, column measurement: {what}")
        values[name] = _number(path, number, "value", told["value"], separator)
        own = told.get("gauge", "")
        if own or gauge is None:
            gauges[name] = _number(path, number, "gauge", own, separator)
        else:
            gauges[name] = gauge
    if not values:
        raise SceneError(f"{path}: there is no row below the header; give one for each key characteristic measured")
    return values, gauges


def _number(path: Path, row: int, column: str, cell: str, separator: str) -> float:
    value = read_number(cell, separator)
    if not np.isfinite(value) or (column == "gauge" and value <= 0):
        kind = "number above 0" if column == "gauge" else "finite number"
        raise SceneError(f"{path}: row {row}, column {column}: {cell!r} is no {kind}; give mm")
    return value


def _print(console, found):
    from mic.report.style import number, percent

    table = Table("source", "in the scene", "found", "95 %", "off its mean", "told", title="Most probable sources")
    for row in found.table.head(LISTED).to_dict("records"):
        table.add_row(
            plain(row["source"]),
            f"{number(row['prior_mean'])} ± {number(row['prior_sigma'])}",
            f"{number(row['mean'])} ± {number(row['sigma'])}",
            f"{number(row['low'])} … {number(row['high'])}",
            f"{number(row['off'], 2)} σ",
            percent(row["told"]),
        )
    console.print(table)
