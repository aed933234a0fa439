"""``mic compare``."""

from __future__ import annotations

import re
from pathlib import Path

from rich.console import Console
from rich.table import Table

from mic.commands.invocation import counting, on_one_process, studied, threads
from mic.process.model import ReducedModel
from mic.results.field_changes import field_changes, write_field_changes
from mic.results.outcome import Outcome, read_outcome
from mic.results.schema import COMPARISON
from mic.scene import Scene, load_scene
from mic.studies.comparison import SAMPLES, need_common
from mic.studies.comparison import compare as compared
from mic.system.console import plain

__all__ = ["compare"]


@on_one_process
def compare(before, after, samples, seed, law, out):
    """``mic compare``, with the values of its options (:mod:`mic.options`)."""
    from mic.report.comparison_page import sentences, write_comparison  # drawing libraries are slow to import

    console = Console()
    known = [_known(source) for source in (before, after)]
    need_common(*map(_scene, known))  # before any of them is reduced
    sides = [
        studied(console, source)[0] if isinstance(one, Scene) else one for source, one in zip((before, after), known)
    ]
    laws = [one.value for one in law or []]
    with counting(console, "evaluations", 2 * (samples or SAMPLES)) as advance:
        found = compared(*sides, laws, samples, seed, threads(), advance)
    fields = []
    if found.a.outcome is not None and found.b.outcome is not None:
        fields = field_changes(found.a.outcome, found.a.law, found.b.outcome, found.b.law)
    folder = out or Path("results") / f"{_short(found.a.name)}_{_short(found.b.name)}"
    COMPARISON.write(folder, found.table)
    write_field_changes(folder, fields)
    page = write_comparison(folder / "comparison.html", found, fields)
    _print(console, found)
    for sentence in sentences(found):
        console.print(plain(sentence), highlight=False, soft_wrap=True)
    console.print(f"page: [bold]{plain(page)}[/]   table: {plain(folder / COMPARISON.place)}", soft_wrap=True)


def _known(source):
    """What is there before anything is reduced: a run, a saved model or a scene."""
    if (source / "run.json").is_file():
        return read_outcome(source)
    return ReducedModel.load(source) if source.suffix == ".npz" and source.is_file() else load_scene(source)


def _scene(known):
    """The scene of what is known."""
    if isinstance(known, Scene):
        return known
    return known.model.scene if isinstance(known, Outcome) else known.scene


def _short(name: str) -> str:
    """A name for a folder."""
    return re.sub(r"[^\w.+-]+", "-", Path(name).name) or "run"


def _print(console, found):
    from mic.report.style import number

    table = Table("", "mean, µm", "change", "6σ, µm", "change", "Cpk", "after", title="Before and after")
    for row in found.table.to_dict("records"):
        if not row["quantity"]:
            continue
        cells = [plain(row["quantity"])]
        for figure in ("mean", "six_sigma"):
            low, high = (number(1e3 * row[f"{figure}_change_{end}"], 2) for end in ("low", "high"))
            change = f"{number(1e3 * row[f'{figure}_change'], 2)} ({low} … {high})"
            cells += [number(1e3 * row[f"{figure}_a"]), change]
        table.add_row(*cells, number(row["cpk_a"]), number(row["cpk_b"]))
    console.print(table)
