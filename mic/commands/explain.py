"""``mic explain``."""

from __future__ import annotations

import re
from pathlib import Path

import numpy as np

from mic.commands.invocation import first_rank_only, open_model
from mic.errors import SceneError
from mic.model.characteristics import aligned, single_readings
from mic.process.description import alignments
from mic.report.style import number, percent
from mic.results.schema import EXPLANATION, FURTHER
from mic.scene import Scene
from mic.scene.measured_report import read_measured_report
from mic.studies.explanation import explain as infer_sources
from mic.system.cores import available_cores

__all__ = ["explain", "read_measured"]

MAX_PIECES = 10  # serial numbers that a message lists
MAX_SOURCES = 12  # sources that are printed


@first_rank_only
def explain(source, measured, gauge, piece, align, friction, seed, law, out):
    """``mic explain``, with the values of its options (:mod:`mic.options`)."""
    from mic.report.explanation_page import sentences, write_explanation  # drawing libraries are slow to import

    console, model, _, law, seed = open_model(source, law, seed)
    values, gauges, said = read_measured(measured, gauge, model.scene, piece, align)
    console.say_each(said)
    with console.progress_bar(f"evaluations under {law}", None) as advance:
        found = infer_sources(model, values, gauges, law, friction, seed, available_cores(), advance)
    folder = out or Path("results") / re.sub(r"[^\w.+-]+", "-", f"{model.scene.name}_{measured.stem}")
    EXPLANATION.write(folder, found.table)
    FURTHER.write(folder, found.further)
    page = write_explanation(folder / "explanation.html", found)
    _print_sources(console, found)
    console.say_each(sentences(found))
    console.say_files(page=page, table=folder / EXPLANATION.place)


def read_measured(
    path: Path, gauge: float | None, scene: Scene, piece: str | None = None, align: bool = False
) -> tuple[dict[str, float], dict[str, float], list[str]]:
    """Measured values and standard deviations of the gauges by key characteristic, mm, and how they were read.

    Parameters
    ----------
    path : Path
        See :func:`mic.scene.measured_report.read_measured_report`.
    gauge : float or None
        Standard deviation of the gauge for characteristics without one in the file, mm.
    scene : Scene
        Placed.
    piece : str, optional
        Serial number of the assembly, if the file holds several.
    align : bool
        Whether the values are as the machine read them, and have to be brought into the frames of the scene.

    Raises
    ------
    SceneError
        If the file is invalid, or holds several assemblies; the message names file, row and column.
    """
    names = [item.name for item in scene.measurements]
    readings = single_readings(scene)
    points = [name for name in readings if name not in names] if align else []
    directions = {name: tuple(reading.rigid[:3]) for name, reading in readings.items()}
    directions |= {item.name: item.direction for item in scene.measurements if item.direction is not None}
    report = read_measured_report(path, [*names, *points], "key characteristic", directions)
    pieces = list(report.values)
    if piece not in pieces and (piece is not None or len(pieces) > 1):
        what = f"no assembly {piece!r}" if piece is not None else f"{len(pieces)} assemblies"
        known = ", ".join(pieces[:MAX_PIECES]) + ", …" * (len(pieces) > MAX_PIECES)
        raise SceneError(f"{path}: the file holds {what}; choose one by --piece: {known}")
    values = report.values[piece or pieces[0]]
    said = [*report.said, *alignments(scene)]
    if align:
        values = aligned(scene, values)
        said.append(f"The values of {path.name} are aligned likewise.")
    gauges = {name: report.gauge.get(name, gauge) for name in values}
    for name, sigma in gauges.items():
        if sigma is None or not 0 < sigma < np.inf:
            given = "no standard deviation of the gauge" if sigma is None else f"{sigma:g}, not a number above 0"
            raise SceneError(f"{path}: {name}, column gauge: {given}; give mm, in the file or by --gauge")
    return values, {name: float(sigma) for name, sigma in gauges.items() if sigma is not None}, said


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
