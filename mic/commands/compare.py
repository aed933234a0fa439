"""``mic compare``."""

from __future__ import annotations

import re
from pathlib import Path

from mic.commands.invocation import first_rank_only, load_model
from mic.commands.output import CommandConsole, interval
from mic.process.model import ReducedModel
from mic.report.style import number
from mic.results.field_changes import field_changes, write_field_changes
from mic.results.outcome import Outcome, read_outcome
from mic.results.schema import COMPARISON
from mic.scene import Scene, load_scene
from mic.studies.comparison import SAMPLES, check_comparable
from mic.studies.comparison import compare as compare_sides
from mic.system.cores import available_cores

__all__ = ["compare"]


@first_rank_only
def compare(before, after, samples, seed, law, out):
    """``mic compare``, with the values of its options (:mod:`mic.options`)."""
    from mic.report.comparison_page import sentences, write_comparison  # drawing libraries are slow to import

    console = CommandConsole()
    loaded = [_load(source) for source in (before, after)]
    check_comparable(*map(_scene, loaded))  # before the slow reduction
    sides = [
        load_model(console, source)[0] if isinstance(side, Scene) else side
        for source, side in zip((before, after), loaded)
    ]
    laws = [own.value for own in law or []]
    with console.progress_bar("evaluations", 2 * (samples or SAMPLES)) as advance:
        found = compare_sides(*sides, laws, samples, seed, available_cores(), advance)
    fields = []
    if found.a.outcome is not None and found.b.outcome is not None:
        fields = field_changes(found.a.outcome, found.a.law, found.b.outcome, found.b.law)
    folder = out or Path("results") / f"{_folder_name(found.a.name)}_{_folder_name(found.b.name)}"
    COMPARISON.write(folder, found.table)
    write_field_changes(folder, fields)
    page = write_comparison(folder / "comparison.html", found, fields)
    _print_changes(console, found)
    console.say_each(sentences(found))
    console.say_files(page=page, table=folder / COMPARISON.place)


def _load(source):
    """A run, a saved model or a scene; nothing is reduced."""
    if (source / "run.json").is_file():
        return read_outcome(source)
    return ReducedModel.load(source) if source.suffix == ".npz" and source.is_file() else load_scene(source)


def _scene(loaded):
    """The scene of a run, a saved model or a scene."""
    if isinstance(loaded, Scene):
        return loaded
    return loaded.model.scene if isinstance(loaded, Outcome) else loaded.scene


def _folder_name(name: str) -> str:
    """A name that every file system accepts."""
    return re.sub(r"[^\w.+-]+", "-", Path(name).name) or "run"


def _print_changes(console, found):
    rows = []
    for row in found.table.to_dict("records"):
        if not row["quantity"]:
            continue
        cells = [row["quantity"]]
        for figure in ("mean", "six_sigma"):
            cells += [number(1e3 * row[f"{figure}_a"]), interval(row, f"{figure}_change")]
        rows.append((*cells, number(row["cpk_a"]), number(row["cpk_b"])))
    heads = ("", "mean before, µm", "change (95 %)", "6σ before, µm", "change (95 %)", "Cpk before", "Cpk after")
    console.table("Before and after, of the common samples alone", heads, rows)
