"""Compare two scenes, models or runs on paired samples.

Deviations of the same name take the same probability on both sides, regardless of their means and standard deviations,
so that the sampling error of the differences is small. Runs with the same draws are compared on their stored samples.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from itertools import product
from typing import Any

import numpy as np
import pandas as pd

from mic.contact.laws import LAWS
from mic.errors import RunError, SceneError
from mic.process.model import ReducedModel
from mic.results.outcome import Outcome
from mic.results.schema import COMPARISON
from mic.scene import Scene
from mic.statistics.capability import centred_capability
from mic.statistics.draw import at_probabilities, number_keys
from mic.statistics.estimates import Estimate, six_sigma
from mic.statistics.paired_differences import centred_capability_change, mean_change, share_change, six_sigma_change
from mic.studies.order import quantities
from mic.studies.samples import Progress, first_frictional, interval
from mic.system.arguments import checked

__all__ = ["SAMPLES", "Comparison", "Side", "compare", "differences", "check_comparable", "scene_differences"]

SAMPLES = 200
BLOCK = 20  # samples between two calls of `progress`
SAME = 1e-9  # standard deviations: closer deviations count as the same draw
PAIRED = 2  # word of the counter that separates the streams of pairs from those of single runs
#: Monte Carlo settings that do not describe the assembly.
_SAMPLING = ("samples", "seed", "values", "table", "design", "accuracy", "backend")


@dataclass(frozen=True)
class Side:
    """One side of a comparison.

    Attributes
    ----------
    name : str
        Description.
    scene : Scene
    law : str
    values : DataFrame
        (n, q) key characteristics and slips of n samples (:func:`mic.studies.order.quantities`), mm, in the same order
        on both sides; NaN in failed samples.
    outcome : Outcome or None
        The run, if the side is one.
    """

    name: str
    scene: Scene
    law: str
    values: pd.DataFrame
    outcome: Outcome | None = None


@dataclass(frozen=True)
class Comparison:
    """Two sides and their differences.

    Attributes
    ----------
    a, b : Side
        Before and after.
    table : DataFrame
        As :data:`mic.results.schema.COMPARISON` declares it.
    changes : list of str
        Differences between the scenes, a line each.
    left_out : int
        Samples that failed on either side.
    alone : list of str
        Quantities of one side only.
    """

    a: Side
    b: Side
    table: pd.DataFrame
    changes: list[str]
    left_out: int
    alone: list[str]


@checked
def compare(
    a: ReducedModel | Outcome,
    b: ReducedModel | Outcome,
    laws: Sequence[str] = (),
    samples: int | None = None,
    seed: int | None = None,
    threads: int = 1,
    progress: Progress = lambda count: None,
) -> Comparison:
    """Compare two assemblies on the same samples.

    Parameters
    ----------
    a, b : ReducedModel or Outcome
        Before and after. Two runs are compared on their stored samples, unless `samples` is given.
    laws : sequence of str, optional
        Contact law of both, or those of `a` and `b`; default: the first of each scene with friction, or its first.
    samples : int, optional
        Number of samples to evaluate; default: 200, or all stored samples that two runs have in common.
    seed : int, optional
        Default: that of the scene of `a`.
    threads : int
    progress : callable or bool, optional
        Called with the number of evaluations since the last call; or whether a bar is shown.

    Raises
    ------
    SceneError
        If the two have no part or no key characteristic in common, or their tables of samples do not match.
    RunError
        If two runs have different draws.
    """
    models = [source.model if isinstance(source, Outcome) else source for source in (a, b)]
    check_comparable(models[0].scene, models[1].scene)
    if len(laws) > 2:
        raise SceneError(f"law: {len(laws)} laws are given for two sides; give one for both, or one for each")
    law_a, law_b = _law_of(a, laws[0] if laws else None), _law_of(b, laws[-1] if laws else None)
    if isinstance(a, Outcome) and isinstance(b, Outcome) and samples is None:
        (before, after), group = _stored(((a, law_a), (b, law_b)))
    else:
        paired, group = _paired_deviations(models[0].scene, models[1].scene, samples or SAMPLES, seed), None
        before, after = (
            _evaluated(model, source, law, deviations, threads, progress)
            for model, source, law, deviations in zip(models, (a, b), (law_a, law_b), paired)
        )
    table, valid = differences(before, after, group)
    changes = scene_differences(before.scene, after.scene)
    alone = sorted(str(name) for name in set(before.values) ^ set(after.values))
    return Comparison(before, after, table, changes, int((~valid).sum()), alone)


def differences(before: Side, after: Side, group: np.ndarray | None = None) -> tuple[pd.DataFrame, np.ndarray]:
    """Table :data:`mic.results.schema.COMPARISON` of two sides, and (n,) whether a sample is valid on both.

    Parameters
    ----------
    before, after : Side
        Evaluated on the same samples.
    group : (n,) int array, optional
        Group of each sample that a sampling design generated together.
    """
    valid = (before.values.notna().all(axis=1) & after.values.notna().all(axis=1)).to_numpy()
    rows = list(_rows(before, after, valid, None if group is None else group[valid]))
    return pd.DataFrame(rows, columns=COMPARISON.names).assign(samples=int(valid.sum())), valid


def scene_differences(a: Scene, b: Scene) -> list[str]:
    """Differences of scene `b` from `a`, one line each: ``clamps.C1.force: 200 → 300``.

    Names, descriptions, pictures and sampling settings are ignored.
    """
    left_out = {"name", "description", "setting", "report", "optimise"}
    tables = [scene.model_dump(mode="json", exclude=left_out) for scene in (a, b)]
    for table in tables:
        table["monte_carlo"] = {k: v for k, v in table["monte_carlo"].items() if k not in _SAMPLING}
    return list(_differing("", *tables))


def _differing(key: str, a: Any, b: Any) -> Iterator[str]:
    """Lines for the differences below a key; items of lists are identified by their names."""
    if a == b:
        return
    a, b = _by_name(a), _by_name(b)
    if isinstance(a, dict) and isinstance(b, dict):
        for name in dict.fromkeys([*a, *b]):
            below = f"{key}.{name}" if key else str(name)
            if name not in a:
                yield f"{below}: added"
            elif name not in b:
                yield f"{below}: removed"
            else:
                yield from _differing(below, a[name], b[name])
        return
    texts = [f"{x:.6g}" if isinstance(x, float) else str(x) for x in (a, b)]
    yield f"{key}: {texts[0]} → {texts[1]}" if sum(map(len, texts)) < 100 else f"{key}: changed"


def _by_name(value: Any) -> Any:
    if isinstance(value, list) and value and all(isinstance(item, dict) and item.get("name") for item in value):
        return {item["name"]: item for item in value}
    return value


def _law_of(source: ReducedModel | Outcome, law: str | None) -> str:
    """The law of one side; default: the first with friction, or the first."""
    if not isinstance(source, Outcome):
        return law or first_frictional(source.scene.report.laws)
    if law is not None and law not in source.laws:
        known = ", ".join(source.laws) or "no samples"
        raise RunError(f"{source.folder}: the run has no samples under {law}; it has: {known}")
    if not source.laws:
        raise RunError(f"{source.folder}: no sample is finished; complete the run first")
    return law or first_frictional(source.laws)


# ------------------------------------------------------------------------------------------------------- samples


def _paired_deviations(a: Scene, b: Scene, count: int, seed: int | None) -> tuple[np.ndarray, np.ndarray]:
    """Deviations (n, p) of two scenes: those of the same name, or pieces of the same batch, at the same probability."""
    if a.monte_carlo.values is not None or b.monte_carlo.values is not None:
        return _from_tables(a, b, count), _from_tables(b, a, count)
    every = {key: i for i, key in enumerate(dict.fromkeys([*number_keys(a), *number_keys(b)]))}
    u = np.empty((count, len(every)))
    for i in range(count):
        key = np.array([a.monte_carlo.seed if seed is None else seed, i], dtype=np.uint64)
        u[i] = np.random.Generator(np.random.Philox(key=key, counter=[0, 0, 0, PAIRED])).random(len(every))
    x_a, x_b = (at_probabilities(scene, u[:, [every[key] for key in number_keys(scene)]]) for scene in (a, b))
    return x_a, x_b


def _from_tables(scene: Scene, other: Scene, count: int) -> np.ndarray:
    """Samples (n, p) from the table of a scene, or from that of the other scene if it has none."""
    names, other_names = ([item.name for item in each.deviations] for each in (scene, other))
    values, other_values = scene.monte_carlo.values, other.monte_carlo.values
    unequal = values is not None and other_values is not None and len(values) != len(other_values)
    if sorted(names) != sorted(other_names) or unequal:
        raise SceneError(
            f"scenes {scene.name!r} and {other.name!r}: their tables of samples do not match; give both scenes the "
            "same deviations, and tables with the same number of rows"
        )
    if values is not None:
        return np.array(values)[:count]
    return np.array(other_values)[:count, [other_names.index(name) for name in names]]


def _evaluated(model, source, law, deviations, threads, progress) -> Side:
    """One side, evaluated on samples (n, p)."""
    process, frames = model.process(law, threads=threads), []
    for first in range(0, len(deviations), BLOCK):
        evaluation = process.attempt(deviations[first : first + BLOCK])
        frame = quantities(model, evaluation)
        frame[evaluation.failed] = np.nan
        frames.append(frame)
        progress(len(frame))
    outcome = source if isinstance(source, Outcome) else None
    name = model.scene.name if outcome is None else str(outcome.folder)
    return Side(name, model.scene, law, pd.concat(frames, ignore_index=True), outcome)


def _stored(runs: Sequence[tuple[Outcome, str]]) -> tuple[list[Side], np.ndarray | None]:
    """Two runs on their common valid samples, and the groups of these if a design generated them together."""
    first, second = (outcome.sample_numbers(law) for outcome, law in runs)
    common = np.intersect1d(first, second)
    _check_same_draws(runs, common)
    sides = []
    for outcome, law in runs:
        scene = outcome.model.scene
        columns = {item.name: outcome.measured(law, item.name, common) for item in scene.measurements}
        if outcome.has_slip and LAWS[law].frictional:
            for stage, zone in product(outcome.stages, outcome.zones):
                slip = outcome.slip(law, stage, zone, common)
                if np.isfinite(slip).any():
                    columns[f"slip {stage} {zone}"] = slip
        sides.append(Side(str(outcome.folder), scene, law, pd.DataFrame(columns), outcome))
    together = max(outcome.together for outcome, _ in runs)
    return sides, common // together if together > 1 else None


def _check_same_draws(runs, common: np.ndarray) -> None:
    """Check that deviations of the same name have the same standardised values in both runs."""
    (a, law_a), (b, law_b) = runs
    if not len(common):
        raise RunError(f"{a.folder} and {b.folder}: no sample is finished and valid in both; complete the runs")
    others = {item.name: item for item in b.model.scene.deviations}
    for item in a.model.scene.deviations:
        other = others.get(item.name)
        if other is None or not item.sigma or not other.sigma:
            continue
        x = (a.deviation(law_a, item.name, common) - item.mean) / item.sigma
        y = (b.deviation(law_b, item.name, common) - other.mean) / other.sigma
        alike = item.distribution == other.distribution and item.truncated == other.truncated
        if alike and np.abs(x - y).max() > SAME * max(1.0, np.abs(x).max()):
            raise RunError(
                f"{a.folder} and {b.folder}: the runs have different draws (deviation {item.name}); run both with the "
                "same seed and design, or give --samples to evaluate both models on the same samples"
            )


# ---------------------------------------------------------------------------------------------------- statistics


def check_comparable(a: Scene, b: Scene) -> None:
    """Check that two scenes have parts and key characteristics of the same names.

    Raises
    ------
    SceneError
        If they have no part or no key characteristic in common.
    """
    for what, table in (("part", "parts"), ("key characteristic", "measurements")):
        names = [
            [item.name for item in getattr(scene, table)]
            if what == "part" or any(stage.kind == "measure" for stage in scene.stages)
            else []
            for scene in (a, b)
        ]
        if not {*names[0]} & {*names[1]}:
            raise SceneError(
                f"{a.name!r} and {b.name!r} have no {what} in common ({', '.join(names[0]) or 'none'}; "
                f"{', '.join(names[1]) or 'none'}): compare two scenes of one assembly, with the same names for the "
                "same items"
            )


def _rows(a: Side, b: Side, valid: np.ndarray, group: np.ndarray | None) -> Iterator[dict[str, Any]]:
    """Rows of the whole assembly, then of the common key characteristics, then of the common slips."""
    items = [{item.name: item for item in side.scene.measurements} for side in (a, b)]
    samples = {name: [side.values[name].to_numpy()[valid] for side in (a, b)] for name in a.values if name in b.values}
    outside = {
        name: [_outside(x, item[name].bounds) for x, item in zip(pair, items)]
        for name, pair in samples.items()
        if name in items[0] and name in items[1]
    }
    yield {"quantity": ""} | _outside_change([np.any(side, axis=0) for side in zip(*outside.values())], group)
    for name, (x, y) in samples.items():
        row: dict[str, Any] = {"quantity": name}
        row |= _change("mean", x.mean(), y.mean(), mean_change(x, y, group))
        row |= _change("six_sigma", six_sigma(x).value, six_sigma(y).value, six_sigma_change(x, y, group))
        if name in outside:
            first, second = items[0][name].bounds, items[1][name].bounds
            row["tolerance"] = items[0][name].upper - items[0][name].lower
            change = centred_capability_change(x, y, first, second, group)
            row |= _change("cpk", centred_capability(x, *first).value, centred_capability(y, *second).value, change)
            row |= _outside_change(outside[name], group)
        yield row


def _outside(x: np.ndarray, bounds: tuple[float, float]) -> np.ndarray:
    """(n,) whether samples lie outside."""
    return (x < bounds[0]) | (x > bounds[1])


def _outside_change(sides: Sequence[np.ndarray], group: np.ndarray | None) -> dict[str, Any]:
    """Columns of the shares of samples outside, from (n,) whether each lies outside."""
    a, b = sides
    return _change("outside", a.mean(), b.mean(), share_change(a, b, group))


def _change(statistic: str, a: Any, b: Any, change: Estimate) -> dict[str, Any]:
    """Columns of a statistic on both sides and of its change."""
    return {f"{statistic}_a": float(a), f"{statistic}_b": float(b)} | interval(f"{statistic}_change", change)
