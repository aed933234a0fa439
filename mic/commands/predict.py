"""``mic predict``: predicts assemblies as their parts are measured, and appends the predictions to a log file."""

from __future__ import annotations

import csv
import time
from collections import deque
from collections.abc import Callable, Iterator, Mapping
from pathlib import Path
from types import MappingProxyType
from typing import Any

import pandas as pd
from rich.progress import Progress, TextColumn

from mic.commands.invocation import choose_law, first_rank_only, open_model
from mic.commands.output import CommandConsole
from mic.errors import FormatError, SceneError, Stopped
from mic.process.description import alignments
from mic.report.style import percent
from mic.results.run_identity import identity
from mic.results.schema import PREDICTIONS
from mic.scene import load_scene
from mic.scene.deviation import deviation_unit
from mic.scene.measured_report import read_measured_report
from mic.studies.adjustable import Adjustable
from mic.studies.drift import WINDOWS, drifts
from mic.studies.emulator_training import tolerance
from mic.studies.prediction import Predictor
from mic.studies.scan import ScanReader, checksum, scan_files
from mic.system.console import micrometres, plain
from mic.system.disk_cache import cache_folder
from mic.system.files import Format, append_text, fingerprint, reading, write_text
from mic.system.regular_files import read_regular

__all__ = ["PredictionLog", "predict", "scan_predictor", "scene_with_meshes", "train_predictor"]

WATCHED = (".csv", ".txt", ".tsv", ".xlsx", ".dfq", ".dfx")  # files of measured parts
PAUSE = 0.2  # s between two looks into a watched folder
STYLES = {"accepted": "green", "rejected": "red", "open": "yellow", "refused": "red", "failed": "red"}


@first_rank_only
def predict(source, parts, scan, watch, log, law, **options):
    """``mic predict``, with the values of its options (:mod:`mic.options`)."""
    if (parts is not None) + (scan is not None or watch is not None) != 1:
        raise SceneError(
            "predict: give either --parts FILE with measured parts, or --scan FOLDER with scans, or --watch FOLDER"
        )
    for option, folder in (("scan", scan), ("watch", watch)):
        if folder is not None and not folder.is_dir():
            raise SceneError(f"--{option} {folder}: there is no such folder; create it, or give another")
    if scan is not None:
        _predict_scans(CommandConsole(), source, scan, watch, log, law, options)
        return
    console, model, _, law, _ = open_model(source, law)
    console.say_each(alignments(model.scene))
    predictions = _open_log(log, model, law, options)
    if parts is not None:
        _read_parts(parts, model)  # reports errors before the training
    try:
        predictor = train_predictor(console, model, law, **options)
    except ValueError as problem:
        raise SceneError(f"predict: {problem}") from None
    if parts is not None:
        _predict_file(console, predictor, predictions, parts)
        return
    console.say(f"Watching {watch} for tables and Q-DAS files. Press Ctrl-C to stop.")
    try:
        _watch_folder(console, predictor, predictions, watch)
    except (KeyboardInterrupt, Stopped):
        console.say(f"Stopped: {log} contains {predictions.count} assemblies.")


def _predict_scans(console, source: Path, folder: Path, watch: Path | None, log: Path, law, options) -> None:
    """Predict the assemblies whose parts were scanned into a folder, or are scanned while it is watched."""
    if watch is not None and watch.resolve() != folder.resolve():
        raise SceneError(f"--watch {watch}: with --scan it is the folder of the scans; give {folder}")
    scene = scene_with_meshes(source)
    files, others = scan_files(folder, scene)
    usual = " or ".join(f"{scene.parts[0].name}{mark}SERIAL.stl" for mark in "-/")
    if others:
        console.say(f"Ignored, since their names begin with no part: {', '.join(others)}. Call them {usual}.")
    if not files and watch is None:
        raise SceneError(f"--scan {folder}: there are no scans; name each by part and serial number, {usual}")
    reader, predictor = scan_predictor(console, scene, law, options)
    predictions = _open_log(log, reader.model, predictor.law, options)
    if watch is None:
        failed = [_predict_scan(console, reader, predictor, predictions, folder, *item) for item in files.items()]
        _say_skipped(console, failed.count(None), "assembly", "assemblies", predictions)
        if any(failed):
            raise SceneError(
                f"--scan {folder}: {failed.count(True)} of {len(failed)} assemblies could not be predicted"
            )
        return
    console.say(f"Watching {folder} for scans. Press Ctrl-C to stop.")
    try:
        _watch_scans(console, reader, predictor, predictions, folder)
    except (KeyboardInterrupt, Stopped):
        console.say(f"Stopped: {log} contains {predictions.count} assemblies.")


def _open_log(path: Path, model, law: str, options) -> PredictionLog:
    """The log of predictions of a model with a law and with the values of the command's options."""
    scene = model.scene
    limits = [[float(end) for end in item.bounds] for item in scene.measurements]
    optimise = None if scene.optimise is None else scene.optimise.model_dump(mode="json")
    settings = {**options, "adjust": [*(options["adjust"] or ())], "objective": str(options["objective"] or "")}
    return PredictionLog(path, identity(model, 0)[:12], settings | {"law": law, "limits": limits, "optimise": optimise})


def scene_with_meshes(source: Path):
    """The scene of a file or folder; models and results, which have no meshes, are refused."""
    if source.suffix == ".npz" or (source / "run.json").is_file():
        raise SceneError(f"{source}: scans need the meshes of the parts; give the scene")
    return load_scene(source)


def scan_predictor(console, scene, law, options) -> tuple[ScanReader, Predictor]:
    """A reader of scans of a scene's parts, and a predictor for its assemblies with the options of predictions."""
    reader = ScanReader(scene, cache_folder(), console.say_step)
    console.say_each(alignments(reader.model.scene))
    if reader.free:
        console.say(f"Shapes as scanned, since the scene has no source of their deviation: {', '.join(reader.free)}.")
        options = options | {"exact": True}
    return reader, train_predictor(console, reader.model, choose_law(reader.model, law), **options)


def _watch_scans(console, reader: ScanReader, predictor: Predictor, predictions: PredictionLog, folder: Path) -> None:
    """Predict each assembly when all of its parts are scanned, until interrupted."""
    scene = reader.model.scene
    needed = {one.part for one in scene.scans} or {part.name for part in scene.parts}

    def complete() -> dict[str, Mapping[str, Path]]:
        return {serial: files for serial, files in scan_files(folder, scene)[0].items() if needed <= files.keys()}

    for serial, files in _arrivals(complete):
        _predict_scan(console, reader, predictor, predictions, folder, serial, files)


def _predict_scan(
    console, reader: ScanReader, predictor: Predictor, predictions: PredictionLog, folder: Path, serial: str, files
) -> bool | None:
    """Predict a scanned assembly; whether its scans are invalid, or None if it is in the log."""
    name, settings = f"{folder / serial} {checksum(files):08x}", predictions.checksum({})
    if (name, 0, settings) in predictions:
        return None
    start = time.perf_counter()
    try:
        scanned = reader.read(files, serial)
    except (FormatError, SceneError) as problem:  # an invalid scan does not stop the others
        console.say(problem, style="red")
        return True
    console.say_each(scanned.messages)
    missing = [part.name for part in reader.model.scene.parts if part.name not in files]
    if missing:
        console.say(f"Not scanned, and taken as unknown or nominal: {', '.join(missing)} of {serial or folder.name}.")
    found = predictor.predict(scanned.values, scanned.covariance, scanned.error)
    table = predictions.path.with_name(f"{predictions.path.stem}-scans.csv")
    append_text(table, scanned.registrations.to_csv(index=False, header=not table.is_file()))
    predictions.add(found, Path(name), 0, settings)
    _say_prediction(console, found, serial or folder.name, 1e3 * (time.perf_counter() - start))
    return False


def _watch_folder(console, predictor: Predictor, predictions: PredictionLog, folder: Path) -> None:
    """Predict the assemblies of all files that appear in a folder, until interrupted."""

    def tables() -> dict[str, Mapping[str, Path]]:
        return {file.name: {"": file} for file in sorted(folder.iterdir()) if file.suffix.lower() in WATCHED}

    for _, files in _arrivals(tables):
        try:
            _predict_file(console, predictor, predictions, files[""])
        except SceneError as problem:  # an invalid file does not stop the others
            console.say(problem, style="red")


def _arrivals(look: Callable[[], Mapping[str, Mapping[str, Path]]]) -> Iterator[tuple[str, Mapping[str, Path]]]:
    """Sets of files by name, as `look` finds them, each when all are unchanged since the last look: written completely;
    again after a change, without end."""
    seen: dict[str, dict[str, tuple[int, int]]] = {}
    done: dict[str, dict[str, tuple[int, int]]] = {}
    while True:
        for name, files in look().items():
            versions = {key: _version(path) for key, path in files.items()}
            if seen.get(name) == versions != done.get(name):
                done[name] = versions
                yield name, files
            seen[name] = versions
        time.sleep(PAUSE)


def train_predictor(console, model, law, adjust, shim, force, error, exact, **goal) -> Predictor:
    """Train a predictor; print the error of its emulator."""
    with Progress(TextColumn("{task.description}"), TextColumn("{task.completed:.0f}"), console=console) as progress:
        task = progress.add_task("training evaluations", total=None, visible=False)
        advance = lambda count: progress.update(task, advance=count, visible=True)
        request = Adjustable(adjust or (), shim, force, **goal)
        predictor = Predictor(model, law, request, error=error, exact=exact, cache=cache_folder(), progress=advance)
    emulator = predictor.emulator
    if emulator is not None:
        share = emulator.error_bound / tolerance(model.scene, emulator.h)
        worst, names = int(share.argmax()), [item.name for item in model.scene.measurements]
        console.say(
            f"Emulator trained on {len(emulator.x)} evaluated assemblies; largest error (95 %) "
            f"{micrometres(emulator.error_bound[worst], 2)} at {names[worst]}, {percent(share[worst], 2)} of its "
            "tolerance."
        )
    elif not exact:
        console.say("No emulator: too few assemblies could be evaluated to train it. Every assembly is evaluated.")
    if predictor.target:
        stated = ", ".join(f"{name} {value:+.3g} mm" for name, value in predictor.target.items())
        console.say(f"Target of the adjusted assemblies, which the mean assembly reaches: {stated}.")
    return predictor


def _version(path: Path) -> tuple[int, int]:
    """Size and modification time of a file; zeros if it was deleted."""
    try:
        found = path.stat()
    except OSError:
        return 0, 0
    return found.st_size, found.st_mtime_ns


def _read_parts(path: Path, model):
    """The measured deviations of a file, in the units of the model."""
    units = {item.name: deviation_unit(item, model.scene) for item in model.scene.deviations}
    return read_measured_report(path, model.parameters, "deviation", units=units)


def _predict_file(console, predictor: Predictor, predictions: PredictionLog, path: Path) -> None:
    """Predict the assemblies of a file that are not in the log."""
    report = _read_parts(path, predictor.model)
    console.say_each(report.said)
    skipped = 0
    for row, (piece, values) in zip(report.rows, report.values.items()):
        content = predictions.checksum(values)
        if (str(path), row, content) in predictions:
            skipped += 1
            continue
        start = time.perf_counter()
        found = predictor.predict(values)
        milliseconds = 1e3 * (time.perf_counter() - start)
        predictions.add(found, path, row, content)
        predictions.recent.append(values)
        _say_prediction(console, found, f"{path.name} {piece}", milliseconds)
    _say_skipped(console, skipped, "row", "rows", predictions)
    for sentence in drifts(predictor.model.scene, list(predictions.recent)):
        name = sentence.split(":")[0]
        if name not in predictions.drifted:
            console.warn("drift", sentence)
            predictions.drifted.add(name)


def _say_skipped(console, count: int, one: str, several: str, predictions: PredictionLog) -> None:
    """Print how many predictions were skipped."""
    if count:
        what, was, them = (f"1 {one} is", "was", "it") if count == 1 else (f"{count} {several} are", "were", "them")
        console.say(
            f"{what} already in {predictions.path} with the same values and options, and {was} skipped; give another "
            f"--log to predict {them} again."
        )


def _say_prediction(console, found: pd.DataFrame, label: str, milliseconds: float) -> None:
    """Print the prediction of an assembly."""
    assembly = found.iloc[-1]
    not_accepted = [
        f"{item['measurement']} {item['value']:+.4g} mm"
        for item in found.iloc[:-1].to_dict("records")
        if item["verdict"] != "accepted"
    ]
    line = f"{label}: {assembly['verdict']}"
    line += f" ({', '.join(not_accepted)})" if not_accepted else ""
    line += f"; {assembly['said']}" if assembly["said"] else ""
    method = ", evaluated" if assembly["way"] == "evaluated" else ""
    console.print(
        f"{plain(line)}   [dim]{milliseconds:.1f} ms{method}[/]",
        style=STYLES[assembly["verdict"]],
        highlight=False,
        soft_wrap=True,
    )
    if found["adjusted"].notna().any():
        changes = [
            f"{row['measurement']} {row['value']:+.4g} → {row['adjusted']:+.4g} mm"
            for row in found.iloc[:-1].to_dict("records")
        ]
        console.say(f"    {', '.join(changes)}")


class PredictionLog:
    """CSV file of predictions; each assembly is saved before the next is predicted.

    Parameters
    ----------
    path : Path
    model : str
        Checksum of the model, written into every row.
    settings : mapping
        What else predictions depend on besides the measured values, JSON-ready.

    Attributes
    ----------
    recent : deque of mapping of str to float
        Deviations of the last assemblies of this call.
    drifted : set of str
        Deviations whose drift was printed.

    Raises
    ------
    FormatError
        If the file is not a log of predictions.
    """

    def __init__(self, path: Path, model: str, settings: Mapping[str, Any] = MappingProxyType({})):
        self.path, self.model, self._settings = path, model, dict(settings)
        self.recent: deque[Mapping[str, float]] = deque(maxlen=max(WINDOWS))
        self.drifted: set[str] = set()
        self._known: dict[tuple[str, int], str] = {}  # checksum of the latest prediction of each row
        if path.is_file() and path.stat().st_size:
            self._read()

    def __contains__(self, row: tuple[str, int, str]) -> bool:
        """Whether the latest prediction of a row of a file has this checksum."""
        return self._known.get(row[:2]) == row[2]

    def checksum(self, values: Mapping[str, float]) -> str:
        """Checksum of measured values and of the settings."""
        return fingerprint({"values": dict(values), "settings": self._settings})[:12]

    @property
    def count(self) -> int:
        """Number of predicted assemblies of this model."""
        return len(self._known)

    def add(self, found: pd.DataFrame, path: Path, row: int, content: str) -> None:
        """Append the prediction of a row of a file, with the checksum of its content."""
        rows = found.assign(file=str(path), row=row, model=self.model, checksum=content)
        text = rows.to_csv(index=False, header=not self.path.is_file() or not self.path.stat().st_size)
        append_text(self.path, text)
        self._known[str(path), row] = content

    def _read(self) -> None:
        """Read the predicted rows."""
        remedy = "give another file with --log, or move this one away"
        with reading(self.path, Format("log of predictions", 1, remedy)):
            lines = read_regular(self.path).decode().splitlines(keepends=True)
            rows = list(csv.reader(lines))
            if not rows or rows[0] != PREDICTIONS.names:
                raise FormatError(f"{self.path}: not a log of predictions; {remedy}")
            self._take(lines, rows)

    def _take(self, lines: list[str], rows: list[list[str]]) -> None:
        """Note the predicted rows; remove an incomplete assembly at the end, left by an interrupt.

        The last row of a complete assembly is the one without a measurement.
        """
        column = PREDICTIONS.names.index
        ends = [
            i
            for i, (row, line) in enumerate(zip(rows, lines))
            if i and len(row) == len(rows[0]) and line.endswith("\n") and not row[column("measurement")]
        ]
        complete = ends[-1] + 1 if ends else 1
        if complete < len(lines):
            write_text(self.path, "".join(lines[:complete]))
        own = (rows[i] for i in ends if rows[i][column("model")] == self.model)
        self._known = {(row[column("file")], int(row[column("row")])): row[column("checksum")] for row in own}
