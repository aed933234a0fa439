"""Compare two scenes, models or runs on paired samples.

Deviations of the same name take the same probability in both, whatever their means and standard deviations, so that the
sampling error of the differences is small. Runs with the same draws are compared on their stored samples.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
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
from mic.statistics.draw import keys, placed
from mic.statistics.estimates import Estimate, six_sigma
from mic.statistics.paired_differences import centred_capability_change, mean_change, share_change, six_sigma_change
from mic.studies.order import quantities

__all__ = ["SAMPLES", "Comparison", "Side", "compare", "differences", "need_common", "scene_differences"]

SAMPLES = 200
BLOCK = 20  # samples between two calls of `progress`
ALIKE = 1e-9  # standard deviations: deviations that are no further apart were drawn alike
PAIRED = 2  # word of the counter that tells the streams of pairs from those of single runs
_ARRANGED = ("samples", "seed", "values", "table", "design", "accuracy", "backend")  # of the Monte Carlo, not the scene


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
        (n, q) of the n samples, in the order of the other side's, each key characteristic and each ``slip STAGE ZONE``
        (as :func:`mic.studies.order.quantities` has them), mm; NaN in samples that failed.
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
        Quantities that only one side has.
    """

    a: Side
    b: Side
    table: pd.DataFrame
    changes: list[str]
    left_out: int
    alone: list[str]


def compare(
    a: ReducedModel | Outcome,
    b: ReducedModel | Outcome,
    laws: Sequence[str] = (),
    samples: int | None = None,
    seed: int | None = None,
    threads: int = 1,
    progress: Callable[[int], None] = lambda count: None,
) -> Comparison:
    """Compare two assemblies on the same samples.

    Parameters
    ----------
    a, b : ReducedModel or Outcome
        Before and after. Two runs are compared as they stand, unless `samples` asks for samples of their models.
    laws : sequence of str, optional
        Contact law of both, or of `a` and of `b`; default: of each scene the first with friction, or its first.
    samples : int, optional
        To evaluate; default 200, or all that two runs have in common.
    seed : int, optional
        Default: that of the scene of `a`.
    threads : int
    progress : callable, optional
        Called with the number of evaluations that were done.

    Raises
    ------
    SceneError
        If the two have no part or no key characteristic in common, or one states its samples and the other does not.
    RunError
        If two runs drew other samples.
    """
    need_common(*(each.model.scene if isinstance(each, Outcome) else each.scene for each in (a, b)))
    law_a, law_b = (_law_of(each, law) for each, law in zip((a, b), _two(laws)))
    group = None
    if isinstance(a, Outcome) and isinstance(b, Outcome) and samples is None:
        before, after, group = _stored(a, law_a, b, law_b)
    else:
        models = [each.model if isinstance(each, Outcome) else each for each in (a, b)]
        drawn = _drawn(models[0].scene, models[1].scene, samples or SAMPLES, seed)
        before, after = (
            _evaluated(model, each, law, deviations, threads, progress)
            for model, each, law, deviations in zip(models, (a, b), (law_a, law_b), drawn)
        )
    table, valid = differences(before, after, group)
    return Comparison(
        before,
        after,
        table,
        scene_differences(before.scene, after.scene),
        int((~valid).sum()),
        sorted(str(name) for name in set(before.values) ^ set(after.values)),
    )


def differences(before: Side, after: Side, group: np.ndarray | None = None) -> tuple[pd.DataFrame, np.ndarray]:
    """What differs between two sides, as :data:`mic.results.schema.COMPARISON` declares it, and which samples (n,)
    neither side failed.

    Parameters
    ----------
    before, after : Side
        Of the same samples.
    group : (n,) int array, optional
        Which of them a design made together.
    """
    valid = (before.values.notna().all(axis=1) & after.values.notna().all(axis=1)).to_numpy()
    rows = list(_rows(before, after, valid, None if group is None else group[valid]))
    return pd.DataFrame(rows, columns=COMPARISON.names).assign(samples=int(valid.sum())), valid


def scene_differences(a: Scene, b: Scene) -> list[str]:
    """What the scene `b` says otherwise than `a`, a line each: ``clamps.C1.force: 200 → 300``.

    What names, describes or draws is left out, and how many samples are drawn.
    """
    left_out = {"name", "description", "setting", "report", "optimise"}
    tables = [scene.model_dump(mode="json", exclude=left_out) for scene in (a, b)]
    for table in tables:
        table["monte_carlo"] = {k: v for k, v in table["monte_carlo"].items() if k not in _ARRANGED}
    return list(_differing("", *tables))


def _differing(at: str, a: Any, b: Any) -> Iterator[str]:
    """Lines for what differs below a key; items of lists go by their names."""
    if a == b:
        return
    a, b = _by_name(a), _by_name(b)
    if isinstance(a, dict) and isinstance(b, dict):
        for key in dict.fromkeys([*a, *b]):
            below = f"{at}.{key}" if at else str(key)
            if key not in a:
                yield f"{below}: added"
            elif key not in b:
                yield f"{below}: removed"
            else:
                yield from _differing(below, a[key], b[key])
        return
    told = [f"{x:.6g}" if isinstance(x, float) else str(x) for x in (a, b)]
    yield f"{at}: {told[0]} → {told[1]}" if sum(map(len, told)) < 100 else f"{at}: changed"


def _by_name(value: Any) -> Any:
    if isinstance(value, list) and value and all(isinstance(item, dict) and item.get("name") for item in value):
        return {item["name"]: item for item in value}
    return value


def _two(laws: Sequence[str]) -> tuple[str | None, str | None]:
    if len(laws) > 2:
        raise SceneError("law: two sides take two laws at most, the first's and the second's; name fewer")
    return (laws[0], laws[-1]) if laws else (None, None)


def _law_of(source: ReducedModel | Outcome, law: str | None) -> str:
    if isinstance(source, Outcome):
        known = source.laws
        if law is not None and law not in known:
            raise RunError(f"{source.folder}: was not run under {law}; it has: {', '.join(known) or 'no samples'}")
        if not known:
            raise RunError(f"{source.folder}: no sample is finished; complete the run first")
    else:
        known = source.scene.report.laws
    return law or next((name for name in known if LAWS[name].frictional), known[0])


# ------------------------------------------------------------------------------------------------------- samples


def _drawn(a: Scene, b: Scene, count: int, seed: int | None) -> tuple[np.ndarray, np.ndarray]:
    """Deviations (n, p) of two scenes: of the same name, or pieces of the same batch, at the same probability."""
    if a.monte_carlo.values is not None or b.monte_carlo.values is not None:
        return _given(a, b, count), _given(b, a, count)
    every = {key: i for i, key in enumerate(dict.fromkeys([*keys(a), *keys(b)]))}
    u = np.empty((count, len(every)))
    for i in range(count):
        key = np.array([a.monte_carlo.seed if seed is None else seed, i], dtype=np.uint64)
        u[i] = np.random.Generator(np.random.Philox(key=key, counter=[0, 0, 0, PAIRED])).random(len(every))
    own, other = (placed(scene, u[:, [every[key] for key in keys(scene)]]) for scene in (a, b))
    return own, other


def _given(scene: Scene, other: Scene, count: int) -> np.ndarray:
    """Samples (n, p) that a scene states in its table, or else the other does."""
    names = [[item.name for item in each.deviations] for each in (scene, other)]
    own, others = scene.monte_carlo.values, other.monte_carlo.values
    if sorted(names[0]) != sorted(names[1]) or (own is not None and others is not None and len(own) != len(others)):
        raise SceneError(
            f"scenes {scene.name!r} and {other.name!r}: samples that stand in a table must go together; give both the "
            "same deviations, and tables of as many rows"
        )
    if own is not None:
        return np.array(own)[:count]
    return np.array(others)[:count, [names[1].index(name) for name in names[0]]]


def _evaluated(model, source, law, deviations, threads, progress) -> Side:
    process, frames = model.process(law, threads=threads), []
    for first in range(0, len(deviations), BLOCK):
        found = process.attempt(deviations[first : first + BLOCK])
        frame = quantities(model, found)
        frame[found.failed] = np.nan
        frames.append(frame)
        progress(len(frame))
    outcome = source if isinstance(source, Outcome) else None
    return Side(_named(model, outcome), model.scene, law, pd.concat(frames, ignore_index=True), outcome)


def _named(model: ReducedModel, outcome: Outcome | None) -> str:
    return str(outcome.folder) if outcome is not None else model.scene.name


def _stored(a: Outcome, law_a: str, b: Outcome, law_b: str) -> tuple[Side, Side, np.ndarray | None]:
    """Two runs as they stand, on the samples that are valid in both, and which of these were made together."""
    sides = ((a, law_a), (b, law_b))
    common = np.intersect1d(a.sample_numbers(law_a), b.sample_numbers(law_b))
    _need_same_draws(sides, common)
    found = []
    for outcome, law in sides:
        scene = outcome.model.scene
        columns = {item.name: outcome.measured(law, item.name, common) for item in scene.measurements}
        if outcome.has_slip and LAWS[law].frictional:
            for stage in outcome.stages:
                for zone in outcome.zones:
                    slip = outcome.slip(law, stage, zone, common)
                    if np.isfinite(slip).any():
                        columns[f"slip {stage} {zone}"] = slip
        found.append(Side(str(outcome.folder), scene, law, pd.DataFrame(columns), outcome))
    together = max(a.together, b.together)
    return found[0], found[1], common // together if together > 1 else None


def _need_same_draws(sides, common: np.ndarray) -> None:
    """Deviations of the same name must lie as many standard deviations off their means."""
    (a, law_a), (b, law_b) = sides
    if not len(common):
        raise RunError(f"{a.folder} and {b.folder}: have no sample in common that is valid in both; complete them")
    for item in a.model.scene.deviations:
        other = next((one for one in b.model.scene.deviations if one.name == item.name), None)
        if other is None or not item.sigma or not other.sigma:
            continue
        x, y = (
            (outcome.deviation(law, item.name, common) - own.mean) / own.sigma
            for (outcome, law), own in zip(sides, (item, other))
        )
        plain = item.distribution == other.distribution and item.truncated == other.truncated
        if plain and np.abs(x - y).max() > ALIKE * max(1.0, np.abs(x).max()):
            raise RunError(
                f"{a.folder} and {b.folder}: they drew other samples (deviation {item.name}); run both with the same "
                "seed and design, or ask for samples, so that both models are evaluated on the same ones"
            )


# ---------------------------------------------------------------------------------------------------- statistics


def need_common(a: Scene, b: Scene) -> None:
    """Two scenes are of one assembly, as far as their names tell.

    Raises
    ------
    SceneError
        If they have no part or no key characteristic in common.
    """
    for what, table in (("part", "parts"), ("key characteristic", "measurements")):
        names = [[item.name for item in getattr(scene, table)] for scene in (a, b)]
        if what != "part":  # read by some stage
            names = [own if any(s.kind == "measure" for s in scene.stages) else [] for scene, own in zip((a, b), names)]
        if not {*names[0]} & {*names[1]}:
            raise SceneError(
                f"{a.name!r} and {b.name!r} have no {what} in common ({', '.join(names[0]) or 'none'}; "
                f"{', '.join(names[1]) or 'none'}): give two scenes of one assembly, and name alike what is to be "
                "compared"
            )


def _rows(a: Side, b: Side, valid: np.ndarray, group: np.ndarray | None) -> Iterator[dict[str, Any]]:
    """The whole assembly, then key characteristics, then slips; those that both sides have."""
    items = [{item.name: item for item in side.scene.measurements} for side in (a, b)]
    common = [name for name in a.values if name in b.values]
    measured = [name for name in common if name in items[0] and name in items[1]]
    missed = [
        np.any([_outside(side.values[name].to_numpy()[valid], own[name].bounds) for name in measured], axis=0)
        for side, own in zip((a, b), items)
    ]
    yield {"quantity": ""} | _outside_rows(missed[0], missed[1], group)
    for name in common:
        x, y = (side.values[name].to_numpy()[valid] for side in (a, b))
        row: dict[str, Any] = {"quantity": name}
        row |= _sided("mean", x.mean(), y.mean(), mean_change(x, y, group))
        row |= _sided("six_sigma", six_sigma(x).value, six_sigma(y).value, six_sigma_change(x, y, group))
        if name in measured:
            first, second = items[0][name].bounds, items[1][name].bounds
            row["tolerance"] = items[0][name].upper - items[0][name].lower
            change = centred_capability_change(x, y, first, second, group)
            row |= _sided("cpk", centred_capability(x, *first).value, centred_capability(y, *second).value, change)
            row |= _outside_rows(_outside(x, first), _outside(y, second), group)
        yield row


def _outside(x: np.ndarray, bounds: tuple[float, float]) -> np.ndarray:
    """(n,) whether samples lie outside."""
    return (x < bounds[0]) | (x > bounds[1])


def _outside_rows(a: np.ndarray, b: np.ndarray, group: np.ndarray | None) -> dict[str, Any]:
    return _sided("outside", a.mean(), b.mean(), share_change(a, b, group))


def _sided(figure: str, a: Any, b: Any, change: Estimate) -> dict[str, Any]:
    return {
        f"{figure}_a": float(a),
        f"{figure}_b": float(b),
        f"{figure}_change": change.value,
        f"{figure}_change_low": change.low,
        f"{figure}_change_high": change.high,
    }
