"""``mic explain``."""

from __future__ import annotations

import re
from pathlib import Path

import numpy as np

from mic.commands.invocation import first_rank_only, open_model
from mic.errors import SceneError
from mic.report.style import number, percent
from mic.results.schema import EXPLANATION, FURTHER
from mic.scene.tables import read_cells, read_number
from mic.studies.explanation import explain as infer_sources
from mic.system.cores import available_cores

__all__ = ["explain", "read_measured"]

COLUMNS = ("measurement", "value", "gauge")
MAX_SOURCES = 12  # sources that are printed


@first_rank_only
def explain(source, measured, gauge, friction, seed, law, out):
    """``mic explain``, with the values of its options (:mod:`mic.options`)."""
    from mic.report.explanation_page import sentences, write_explanation  # drawing libraries are slow to import

    values, gauges = read_measured(measured, gauge)
    console, model, _, law, seed = open_model(source, law, seed)
    unknown = [name for name in values if name not in {item.name for item in model.scene.measurements}]
    if unknown:
        names = ", ".join(item.name for item in model.scene.measurements) or "none"
        raise SceneError(
            f"{measured}: scene {model.scene.name!r} has no key characteristic {unknown[0]!r}; it has: {names}; "
            "correct the name, or use the file of this scene"
        )
    with console.progress_bar(f"evaluations under {law}", None) as advance:
        found = infer_sources(model, values, gauges, law, friction, seed, available_cores(), advance)
    folder = out or Path("results") / re.sub(r"[^\w.+-]+", "-", f"{model.scene.name}_{measured.stem}")
    EXPLANATION.write(folder, found.table)
    FURTHER.write(folder, found.further)
    page = write_explanation(folder / "explanation.html", found)
    _print_sources(console, found)
    console.say_each(sentences(found))
    console.say_files(page=page, table=folder / EXPLANATION.place)


def read_measured(path: Path, gauge: float | None) -> tuple[dict[str, float], dict[str, float]]:
    """Measured values and standard deviations of the gauges by key characteristic, mm, from a CSV file.

    Parameters
    ----------
    path : Path
        Columns ``measurement``, ``value`` and, unless `gauge` is given, ``gauge``.
    gauge : float or None
        Standard deviation of the gauge for rows that give none, mm.

    Raises
    ------
    SceneError
        If the file is invalid; the message names file, row and column.
    """
    cells, separator = read_cells(path)
    columns = [str(name) for name in cells.columns]
    for name in columns:
        if name not in COLUMNS:
            raise SceneError(f"{path}: row 1: unknown column {name!r}; columns are {', '.join(COLUMNS)}")
    for name in COLUMNS[: 2 if gauge is not None else 3]:
        if name not in columns:
            remedy = "add it, or give --gauge" if name == "gauge" else "add it"
            raise SceneError(f"{path}: row 1: column {name!r} is missing; {remedy}")
    values: dict[str, float] = {}
    gauges: dict[str, float] = {}
    for line, row in enumerate(cells.to_dict("records"), 2):
        texts = {str(key): str(cell).strip() for key, cell in row.items()}
        if not any(texts.values()):
            continue
        name = texts["measurement"]
        if not name or name in values:
            what = f"{name!r} is given twice; delete one row" if name else "is empty; name the key characteristic"
            raise SceneError(f"{path}: row {line}, column measurement: {what}")
        values[name] = _number(path, line, "value", texts["value"], separator)
        own = texts.get("gauge", "")
        if own or gauge is None:
            gauges[name] = _number(path, line, "gauge", own, separator)
        else:
            gauges[name] = gauge
    if not values:
        raise SceneError(f"{path}: no row below the header; add one for each measured key characteristic")
    return values, gauges


def _number(path: Path, row: int, column: str, cell: str, separator: str) -> float:
    value = read_number(cell, separator)
    if not np.isfinite(value) or (column == "gauge" and value <= 0):
        kind = "number above 0" if column == "gauge" else "finite number"
        raise SceneError(f"{path}: row {row}, column {column}: {cell!r} is not a {kind}; give mm")
    return value


def _print_sources(console, found):
    rows = [
        (
            row["source"],
            f"{number(row['prior_mean'])} ± {number(row['prior_sigma'])}",
            f"{number(row['mean'])} ± {number(row['sigma'])}",
            f"{number(row['low'])} … {number(row['high'])}",
            f"{number(row['off'], 2)} σ",
            percent(row["told"]),
        )
        for row in found.table.head(MAX_SOURCES).to_dict("records")
    ]
    heads = ("source", "in the scene", "this assembly", "95 % interval", "distance from mean", "variance removed")
    console.table("Most probable sources", heads, rows)
