"""``mic optimise``."""

from __future__ import annotations

from pathlib import Path

import pandas as pd
from rich.progress import Progress

from mic.commands.invocation import first_rank_only, open_model, store_study
from mic.commands.output import interval
from mic.errors import SceneError, Stopped
from mic.report.style import number, percent
from mic.results.schema import COMPARISON, OPTIMA, OPTIMUM_CHANGES, OPTIMUM_MATCHES
from mic.statistics.estimates import Estimate
from mic.studies.optimisation import Matched, Optimum
from mic.studies.optimisation import optimise as search_optimum
from mic.studies.optimisation.description import OBJECTIVES
from mic.studies.optimisation.scene_changes import scene_text_with_changes
from mic.system.cores import available_cores
from mic.system.files import write_text

__all__ = ["optimise"]

MAX_ASSEMBLIES = 12  # assemblies of matched parts that are printed


@first_rank_only
def optimise(source, samples, fresh, budget, seed, law, save, out):
    """``mic optimise``, with the values of its options (:mod:`mic.options`)."""
    scene_file = _scene_file(source, save)
    console, model, run, law, seed = open_model(source, law, seed)
    scene = model.scene
    if scene.optimise is None:
        raise SceneError(f"{source}: the scene has no table [optimise], which states what may be changed; add it")
    folder = out or run or Path("results") / f"{scene.name}_optimised"
    log, improvements = folder / "evaluated.jsonl", list[tuple[list, float]]()
    try:
        with Progress(console=console) as progress:
            task = progress.add_task(f"assemblies under {law}", total=budget + 2 * fresh)

            def show_improvement(changes, value):
                improvements.append((changes, value))
                objective = OBJECTIVES[scene.optimise.objective].rstrip(",")
                progress.update(task, description=f"{objective} so far {value:.4g}")

            found = search_optimum(
                model, law, samples, fresh, budget, seed, available_cores(), log,
                say=console.say_step,
                progress=lambda count: progress.advance(task, count), better=show_improvement,
            )  # fmt: skip
    except (KeyboardInterrupt, Stopped):
        _print_interrupted(console, scene, improvements, log)
        raise
    _print_optimum(console, found)
    tables = _tables(found)
    if folder == run:
        store_study(console, run, tables)
    else:
        for table, frame in tables.items():
            table.write(folder, frame)
    if save is not None and found.gained:
        write_text(save, scene_text_with_changes(scene_file.read_text(encoding="utf-8"), scene, found.changes))
        console.say_files(scene=save)
    elif save is not None:
        console.say(f"No improvement: {save} is not written.")
    console.say_files(tables=folder / "tables", evaluations=log)


def _scene_file(source: Path, save: Path | None) -> Path:
    """The scene file; checks that a changed copy can be saved beside it."""
    file = source / "scene.toml" if source.is_dir() else source
    if save is None:
        return file
    if not file.is_file() or file.suffix != ".toml":
        raise SceneError(f"{source}: --save writes a changed copy of a scene file; give a scene file, or omit --save")
    if save.resolve().parent != file.resolve().parent:
        raise SceneError(f"--save {save}: file names in {file} are relative to its folder; save to the same folder")
    return file


def _print_interrupted(console, scene, improvements, log: Path) -> None:
    """Print the best design so far."""
    if improvements:
        changes, value = improvements[-1]
        objective = OBJECTIVES[scene.optimise.objective].capitalize()
        design = "with:" if changes else "for the unchanged scene."
        console.say(
            f"Stopped. {objective} so far {value:.4g} on the samples of the search (not on fresh ones), {design}"
        )
        for change in changes:
            console.say(f"  {change}")
    console.say(f"All evaluations are saved in {log}. Run the command again to continue.")


def _print_optimum(console, found: Optimum) -> None:
    objective = OBJECTIVES[found.objective]
    if found.fresh and found.changes:
        console.say("Changes:")
        for change in found.changes:
            console.say(f"  {change}")
        gain, low, high = (number(getattr(found.gain, end), 3) for end in ("value", "low", "high"))
        console.say(
            f"On {found.fresh} fresh samples {objective} {number(found.before, 4)} → {number(found.after, 4)}: "
            f"gain {gain} ({low} … {high}); {number(found.found, 4)} on the {found.samples} samples of the search."
        )
        if not found.gained:
            console.say("No significant gain: leave the scene unchanged.")
        elif float(found.gain.low) <= 0:
            console.say("The gain is a smaller violation of the constraints.")
        _print_changes(console, found.table)
    elif found.fresh:
        best = number(found.before, 4)
        console.say(f"No better design found; {objective} is {best} on {found.fresh} fresh samples.")
    for constraint in found.kept:
        if constraint.short > 0:
            console.say(f"Violated: {constraint.name}; it is {constraint.value:.4g}, short by {constraint.short:.3g}.")
    if found.fresh:
        console.say(f"{found.evaluations} evaluations in the search.")
    if found.matched is not None and found.matched_gain is not None:
        _print_matched(console, found.matched, found.matched_gain)


def _print_changes(console, table: pd.DataFrame) -> None:
    rows = []
    for row in table.to_dict("records"):
        cells = [row["quantity"] or "any limit"]
        for figure, scale in (("mean", 1e3), ("six_sigma", 1e3), ("cpk", 1.0)):
            if not row["quantity"]:
                cells += ["", ""]
                continue
            cells.append(" → ".join(number(scale * row[f"{figure}_{side}"], 3) for side in "ab"))
            cells.append(interval(row, f"{figure}_change", scale))
        rows.append((*cells, f"{percent(row['outside_a'], 1)} → {percent(row['outside_b'], 1)}"))
    heads = ("", "mean, µm", "change", "6σ, µm", "change", "Cpk", "change", "outside limits")
    console.table("Effect of the changes", heads, rows)


def _print_matched(console, matched: Matched, gain: Estimate) -> None:
    rows = [(i, *numbers) for i, numbers in enumerate(matched.rows[:MAX_ASSEMBLIES].tolist(), 1)]
    if len(matched.rows) > MAX_ASSEMBLIES:
        rows.append(("…", *("" for _ in matched.kinds)))
    console.table("Matched parts, by row of their files", ("assembly", *matched.kinds), rows)
    interval = "" if gain.low != gain.low else f" ({gain.low:.3g} … {gain.high:.3g}, over the unmeasured deviations)"
    console.say(
        f"Average loss of an assembly: {matched.before:.4g} in the order of the files, {matched.after:.4g} matched; "
        f"gain {gain.value:.3g}{interval or '; exact under the model, because every deviation was measured'}."
    )
    if interval and gain.low <= 0:
        console.say("No significant gain: keep the order of the files.")
    if len(matched.kinds) > 2:
        console.say("More than two kinds of parts are assigned one after the other; a better matching may exist.")
    for kind, numbers in zip(matched.kinds, matched.left):
        if numbers:
            console.say(f"Unused parts {kind}: rows {', '.join(map(str, numbers))}.")


def _tables(found: Optimum) -> dict:
    """The tables of an optimum, by table of the schema."""
    summary = {key: getattr(found, key) for key in OPTIMA.names if not key.startswith("gain")}
    summary["gained"] = found.gained
    for end, key in (("", "value"), ("_low", "low"), ("_high", "high")):
        summary[f"gain{end}"] = float(getattr(found.gain, key))
    tables = {OPTIMA: pd.DataFrame([summary])[OPTIMA.names]} if found.fresh else {}
    rows = [
        (found.law, change.kind, " ".join(change.targets), _cell(change.before), _cell(change.after))
        for change in found.changes
    ]
    tables[OPTIMUM_CHANGES] = pd.DataFrame(rows, columns=OPTIMUM_CHANGES.names) if rows else OPTIMUM_CHANGES.empty()
    if found.fresh:
        tables[COMPARISON] = found.table
    if found.matched is not None:
        matches = [
            (i, kind, row)
            for i, numbers in enumerate(found.matched.rows.tolist(), 1)
            for kind, row in zip(found.matched.kinds, numbers)
        ]
        tables[OPTIMUM_MATCHES] = pd.DataFrame(matches, columns=OPTIMUM_MATCHES.names)
    return tables


def _cell(value) -> str:
    """A value before or after a change as text: a number, a point, or the groups of an order."""
    if value is None:
        return ""
    if isinstance(value, list):
        nested = isinstance(value[0], list)
        return "; ".join(" ".join(group) for group in value) if nested else " ".join(f"{x:g}" for x in value)
    return f"{value:g}"
