"""``mic optimise``."""

from __future__ import annotations

from pathlib import Path

import pandas as pd
from rich.console import Console
from rich.progress import Progress
from rich.table import Table

from mic.commands.invocation import keep_studies, law_of, on_one_process, seed_of, studied, threads
from mic.errors import SceneError, Stopped
from mic.results.schema import COMPARISON, OPTIMA, OPTIMUM_CHANGES, OPTIMUM_MATCHES
from mic.statistics.estimates import Estimate
from mic.studies.optimisation import Matched, Optimum
from mic.studies.optimisation import optimise as optimised
from mic.studies.optimisation.description import OBJECTIVES as WORDS
from mic.studies.optimisation.scene_changes import rewritten
from mic.system.console import plain
from mic.system.files import write_text

__all__ = ["optimise"]

LISTED = 12  # assemblies of matched parts that are printed


@on_one_process
def optimise(source, samples, fresh, budget, seed, law, save, out):
    """``mic optimise``, with the values of its options (:mod:`mic.options`)."""
    console = Console()
    scene_file = _scene_file(source, save)
    model, run = studied(console, source)
    scene, asked = model.scene, law_of(model, law)
    if scene.optimise is None:
        raise SceneError(f"{source}: the scene has no table [optimise], which says what may be changed; add it")
    folder = out or run or Path("results") / f"{scene.name}_optimised"
    ledger, last = folder / "evaluated.jsonl", list[tuple[list, float]]()
    try:
        with Progress(console=console) as progress:
            bar = progress.add_task(f"assemblies under {asked}", total=budget + 2 * fresh)

            def better(changes, value):
                last.append((changes, value))
                progress.update(bar, description=f"{WORDS[scene.optimise.objective].rstrip(',')} so far {value:.4g}")

            found = optimised(
                model, asked, samples, fresh, budget, seed_of(scene, seed), threads(), ledger,
                say=lambda line: _say(console, f"{line} …"),
                progress=lambda count: progress.advance(bar, count), better=better,
            )  # fmt: skip
    except (KeyboardInterrupt, Stopped):
        _stopped(console, scene, last, ledger)
        raise
    _print(console, found)
    tables = _tables(found)
    keep_studies(console, run if folder == run else None, tables)
    for table, frame in tables.items() if folder != run else ():
        table.write(folder, frame)
    if save is not None and found.gained:
        text = scene_file.read_text(encoding="utf-8")
        write_text(save, rewritten(text, scene, found.changes))
        _say(console, f"scene: {save}")
    elif save is not None:
        _say(console, f"Nothing was gained, so that {save} is not written.")
    _say(console, f"tables: {folder / 'tables'}   evaluated: {ledger}")


def _say(console, sentence: str) -> None:
    console.print(plain(sentence), highlight=False, soft_wrap=True)


def _scene_file(source: Path, save: Path | None) -> Path:
    """The scene file, of which a changed copy may be written."""
    file = source / "scene.toml" if source.is_dir() else source
    if save is None:
        return file
    if not file.is_file() or file.suffix != ".toml":
        raise SceneError(f"{source}: --save writes a changed copy of a scene file; name one, or leave --save out")
    if save.resolve().parent != file.resolve().parent:
        raise SceneError(f"--save: {save} is not beside {file}, where its file names lead from; name a file there")
    return file


def _stopped(console, scene, last, ledger: Path) -> None:
    """What was found so far."""
    if last:
        changes, value = last[-1]
        _say(
            console, f"Stopped. {WORDS[scene.optimise.objective].capitalize()} so far {value:.4g} on the samples of the"
        )
        _say(console, "search, not judged on fresh ones, with:" if changes else "search, as the scene is.")
        for one in changes:
            _say(console, f"  {one}")
    _say(console, f"What is evaluated stands in {ledger}: call again, and it goes on from there.")


def _print(console, found: Optimum) -> None:
    from mic.report.style import number  # drawing libraries are slow to import

    what = WORDS[found.objective]
    if found.fresh and found.changes:
        _say(console, "Change:")
        for change in found.changes:
            _say(console, f"  {change}")
        gain, low, high = (number(getattr(found.gain, end), 3) for end in ("value", "low", "high"))
        _say(
            console,
            f"On {found.fresh} fresh samples {what} {number(found.before, 4)} → {number(found.after, 4)}: gain {gain} "
            f"({low} … {high}); {number(found.found, 4)} on the {found.samples} samples of the search.",
        )
        if not found.gained:
            _say(console, "Nothing was gained: leave the scene as it is.")
        elif float(found.gain.low) <= 0:
            _say(console, "The gain is that constraints are missed by less.")
        _print_changes(console, found.table)
    elif found.fresh:
        _say(console, f"Nothing better was found; {what} is {number(found.before, 4)} on {found.fresh} fresh samples.")
    for one in found.kept:
        if one.short > 0:
            _say(console, f"Not kept: {one.name}; it is {one.value:.4g}, {one.short:.3g} short of it.")
    if found.fresh:
        _say(console, f"{found.evaluations} evaluations in the search.")
    if found.matched is not None and found.matched_gain is not None:
        _print_matched(console, found.matched, found.matched_gain)


def _print_changes(console, table: pd.DataFrame) -> None:
    from mic.report.style import number, percent

    shown = Table("", "mean, µm", "change", "6σ, µm", "change", "Cpk", "change", "outside", title="What it changes")
    for row in table.to_dict("records"):
        cells = [plain(row["quantity"] or "any of them")]
        for figure, scale in (("mean", 1e3), ("six_sigma", 1e3), ("cpk", 1.0)):
            if not row["quantity"]:
                cells += ["", ""]
                continue
            low, high = (number(scale * row[f"{figure}_change_{end}"], 2) for end in ("low", "high"))
            pair = (number(scale * row[f"{figure}_{side}"], 3) for side in "ab")
            cells += [" → ".join(pair), f"{number(scale * row[f'{figure}_change'], 2)} ({low} … {high})"]
        shown.add_row(*cells, f"{percent(row['outside_a'], 1)} → {percent(row['outside_b'], 1)}")
    console.print(shown)


def _print_matched(console, matched: Matched, gain: Estimate) -> None:
    shown = Table("assembly", *matched.kinds, title="Rows that go together")
    for i, rows in enumerate(matched.rows[:LISTED].tolist(), 1):
        shown.add_row(str(i), *map(str, rows))
    if len(matched.rows) > LISTED:
        shown.add_row("…", *("" for _ in matched.kinds))
    console.print(shown)
    interval = "" if gain.low != gain.low else f" ({gain.low:.3g} … {gain.high:.3g}, on fresh samples of the rest)"
    _say(
        console,
        f"Average loss of an assembly {matched.before:.4g} as the files have them, {matched.after:.4g} matched: gain "
        f"{gain.value:.3g}{interval}"
        + ("; all was measured, so that it is exact under the model." if not interval else "."),
    )
    if interval and gain.low <= 0:
        _say(console, "Nothing was gained: leave them as they come.")
    if len(matched.kinds) > 2:
        _say(console, "More than two kinds are assigned one after the other: another matching may be better still.")
    for kind, rows in zip(matched.kinds, matched.left):
        if rows:
            _say(console, f"Left over of {kind}: rows {', '.join(map(str, rows))}.")


def _tables(found: Optimum) -> dict:
    """The tables that are written."""
    gain = {
        f"gain{end}": float(getattr(found.gain, key))
        for end, key in (("", "value"), ("_low", "low"), ("_high", "high"))
    }
    whole = {
        "law": found.law,
        "objective": found.objective,
        "before": found.before,
        "after": found.after,
        **gain,
        "gained": found.gained,
        "found": found.found,
        "samples": found.samples,
        "fresh": found.fresh,
        "evaluations": found.evaluations,
    }
    tables = {OPTIMA: pd.DataFrame([whole])[OPTIMA.names]} if found.fresh else {}
    rows = [(found.law, one.kind, " ".join(one.targets), _cell(one.before), _cell(one.after)) for one in found.changes]
    tables[OPTIMUM_CHANGES] = pd.DataFrame(rows, columns=OPTIMUM_CHANGES.names) if rows else OPTIMUM_CHANGES.empty()
    if found.fresh:
        tables[COMPARISON] = found.table
    if found.matched is not None:
        each = [
            (i, kind, row)
            for i, rows in enumerate(found.matched.rows.tolist(), 1)
            for kind, row in zip(found.matched.kinds, rows)
        ]
        tables[OPTIMUM_MATCHES] = pd.DataFrame(each, columns=OPTIMUM_MATCHES.names)
    return tables


def _cell(value) -> str:
    if value is None:
        return ""
    if isinstance(value, list):
        nested = isinstance(value[0], list)
        return "; ".join(" ".join(group) for group in value) if nested else " ".join(f"{x:g}" for x in value)
    return f"{value:g}"
