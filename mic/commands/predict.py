"""``mic predict``: assemblies foretold as their parts come in, and a log that survives."""

from __future__ import annotations

import csv
import time
from collections.abc import Iterator
from pathlib import Path

import numpy as np
import pandas as pd
from rich.console import Console
from rich.progress import Progress, TextColumn

from mic.commands.invocation import law_of, on_one_process, studied
from mic.errors import FormatError, SceneError, Stopped
from mic.results.run_identity import identity
from mic.results.schema import PREDICTIONS
from mic.scene.tables import read_cells, read_number
from mic.studies.emulator_training import tolerance
from mic.studies.prediction import Predictor
from mic.system.console import plain
from mic.system.disk_cache import cache_folder
from mic.system.files import append_text, write_text

__all__ = ["Log", "predict", "read_parts"]

PAUSE = 0.2  # s between two looks into a folder that is watched
STYLES = {"accepted": "green", "rejected": "red", "open": "yellow", "refused": "red", "failed": "red"}


@on_one_process
def predict(source, parts, watch, log, adjust, shim, force, error, exact, law):
    """``mic predict``, with the values of its options (:mod:`mic.options`)."""
    console = Console()
    if (parts is None) == (watch is None):
        raise SceneError("predict: give either --parts FILE, a file of parts, or --watch FOLDER, where they come in")
    if watch is not None and not watch.is_dir():
        raise SceneError(f"--watch: there is no folder {watch}; make it, or name another")
    model, _ = studied(console, source)
    kept = Log(log, identity(model, 0)[:12])
    if parts is not None:
        list(read_parts(parts, model.parameters))  # before anything is learnt
    try:
        predictor = _ready(console, model, law_of(model, law), adjust or (), shim, force, error, exact)
    except ValueError as problem:
        raise SceneError(f"predict: {problem}") from None
    if parts is not None:
        _file(console, predictor, kept, parts)
        return
    console.print(f"watching {plain(watch)} for CSV files; end with Ctrl-C", highlight=False)
    seen: dict[Path, tuple[int, int]] = {}
    done: dict[Path, tuple[int, int]] = {}
    try:
        while True:
            for path in sorted(watch.glob("*.csv")):
                now = _stamp(path)
                if seen.get(path) == now != done.get(path):  # not while it is being written
                    done[path] = now
                    try:
                        _file(console, predictor, kept, path)
                    except SceneError as problem:  # one file at fault stops no line
                        console.print(plain(str(problem)), style="red", highlight=False, soft_wrap=True)
                seen[path] = now
            time.sleep(PAUSE)
    except (KeyboardInterrupt, Stopped):
        console.print(f"Ended: {kept.count} assemblies stand in {plain(log)}.", highlight=False, soft_wrap=True)


def _ready(console, model, law, adjust, shim, factor, error, exact) -> Predictor:
    """A predictor; what it learns beforehand is shown, and what that errs by said."""
    with Progress(TextColumn("{task.description}"), TextColumn("{task.completed:.0f}"), console=console) as progress:
        bar = progress.add_task("assemblies evaluated beforehand", total=None, visible=False)
        advance = lambda count: progress.update(bar, advance=count, visible=True)
        predictor = Predictor(model, law, adjust, shim, factor, error, exact, cache_folder(), advance)
    learnt = predictor.learnt
    if learnt is not None:
        share = learnt.off / tolerance(model.scene, learnt.h)
        worst, names = int(share.argmax()), [item.name for item in model.scene.measurements]
        said = f"Answers lie between {len(learnt.x)} assemblies that were evaluated, and err by "
        said += f"{1e3 * learnt.off[worst]:.2g} µm at {names[worst]} in 95 %, {share[worst]:.2%} of its tolerance."
        console.print(plain(said), highlight=False, soft_wrap=True)
    elif not exact:
        console.print("Every assembly is evaluated: too few could be beforehand.", highlight=False, soft_wrap=True)
    return predictor


def _stamp(path: Path) -> tuple[int, int]:
    """Size and time of a file; of one that is gone again, none."""
    try:
        found = path.stat()
    except OSError:
        return 0, 0
    return found.st_size, found.st_mtime_ns


def _file(console, predictor: Predictor, kept: Log, path: Path) -> None:
    """Foretell the rows of a file that the log does not have."""
    for row, values in read_parts(path, predictor.model.parameters):
        if (str(path), row) in kept:
            continue
        before = time.perf_counter()
        found = predictor.judge(values)
        took = time.perf_counter() - before
        kept.add(found, path, row)
        whole = found.iloc[-1]
        bad = [
            f"{one['measurement']} {one['value']:+.4g} mm"
            for one in found.iloc[:-1].to_dict("records")
            if one["verdict"] != "accepted"
        ]
        line = f"{path.name} row {row}: {whole['verdict']}"
        line += f" ({', '.join(bad)})" if bad else ""
        line += f"; {whole['said']}" if whole["said"] else ""
        way = ", evaluated" if whole["way"] == "evaluated" else ""
        console.print(
            f"{plain(line)}   [dim]{1e3 * took:.1f} ms{way}[/]",
            style=STYLES[whole["verdict"]],
            highlight=False,
            soft_wrap=True,
        )


def read_parts(path: Path, names: list[str]) -> Iterator[tuple[int, dict[str, float]]]:
    """Rows of a CSV file of parts, by their number: values of deviations by name, those that the row gives.

    Raises
    ------
    SceneError
        Naming file, row and column.
    """
    cells, separator = read_cells(path, "the folder that you are in")
    strange = [str(name) for name in cells.columns if name not in names]
    if strange:
        raise SceneError(f"{path}: row 1: there is no deviation {strange[0]!r}; known: {', '.join(names)}")
    for number, record in enumerate(cells.to_dict("records"), 2):
        values = {}
        for column, cell in record.items():
            text = str(cell).strip()
            if not text:
                continue
            value = read_number(text, separator)
            if not np.isfinite(value):
                raise SceneError(
                    f"{path}: row {number}, column {column}: {text!r} is no finite number; correct it, or leave the "
                    "cell empty if it was not measured"
                )
            values[str(column)] = value
        if values:
            yield number, values


class Log:
    """A CSV file to which rows are added one assembly at a time, each on disk before the next begins.

    Parameters
    ----------
    path : Path
    model : str
        Fingerprint of the model, which stands in every row.

    Raises
    ------
    FormatError
        If the file is no such log.
    """

    def __init__(self, path: Path, model: str):
        self.path, self.model = path, model
        self._known: set[tuple[str, int]] = set()
        if path.is_file() and path.stat().st_size:
            self._mend()

    def __contains__(self, row: tuple[str, int]) -> bool:
        return row in self._known

    @property
    def count(self) -> int:
        """Assemblies of this model in it."""
        return len(self._known)

    def add(self, found: pd.DataFrame, path: Path, row: int) -> None:
        """Write what was found of a row of a file."""
        told = found.assign(file=str(path), row=row, model=self.model)
        text = told.to_csv(index=False, header=not self.path.is_file() or not self.path.stat().st_size)
        append_text(self.path, text)
        self._known.add((str(path), row))

    def _mend(self) -> None:
        """Read what is there. The row of the whole assembly is its last: what stands behind the last such row was cut
        off when a program was killed, and is taken away, to be done again."""
        remedy = "name another file with --log, or move this one away"
        lines = self.path.read_text(encoding="utf-8").splitlines(keepends=True)
        rows = list(csv.reader(lines))
        if not rows or rows[0] != PREDICTIONS.names:
            raise FormatError(f"{self.path}: this is no log of predictions; {remedy}")
        place = PREDICTIONS.names.index
        ends = [
            i
            for i, (row, line) in enumerate(zip(rows, lines))
            if i and len(row) == len(rows[0]) and line.endswith("\n") and not row[place("measurement")]
        ]
        kept = ends[-1] + 1 if ends else 1
        if kept < len(lines):
            write_text(self.path, "".join(lines[:kept]))
        own = (rows[i] for i in ends if rows[i][place("model")] == self.model)
        self._known = {(row[place("file")], int(row[place("row")])) for row in own}
