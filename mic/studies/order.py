"""Effect of the process order on the key characteristics and slips of a scene.

All orders are evaluated on the same samples, so that the differences are effects of the order. A variant changes only
the sequence in which a stage closes its locators and clamps, makes its welds or releases them, and whether overlapping
parts settle before anything closes; the assignment to stages and the path settings stay.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from contextlib import suppress
from dataclasses import dataclass, replace
from itertools import chain
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
from pydantic import ValidationError

from mic.contact.laws import LAWS
from mic.contact.states import OPEN
from mic.errors import SceneError
from mic.process.actions import Close, Join, Open, stage_moves, together
from mic.process.evaluation import Evaluation
from mic.process.model import ReducedModel
from mic.results.sample_tables import zone_motion
from mic.results.schema import ORDERS
from mic.scene import Scene
from mic.scene.load import read_toml
from mic.scene.process import MOVING
from mic.statistics.draw import draw
from mic.statistics.paired_differences import mean_change, six_sigma_change, standard_error
from mic.studies.samples import Progress, first_frictional
from mic.system.arguments import checked

__all__ = [
    "PERMUTATIONS",
    "STATED",
    "Order",
    "compare",
    "doubts",
    "few_samples",
    "moved_names",
    "order",
    "orders",
    "quantities",
    "variants",
]

STATED = "as stated"
SAMPLES = 20  #: default number of samples per order
PERMUTATIONS = 4  #: random orders in addition to the named ones

# Checks use a few samples with one increment per step, whose error is some per cent: the limits are well above it.
DOUBT_SAMPLES = 8
FRICTION_MATTERS = 0.05  # share of the contacts' tangential motion that friction must change
SETTLING_MATTERS = 0.02  # of a tolerance: change of a mean or of 6σ

Groups = list[list[str]]


@dataclass(frozen=True)
class Order:
    """One order of a scene's process.

    Attributes
    ----------
    name : str
        Description.
    scene : Scene
        The scene with this order.
    """

    name: str
    scene: Scene


def orders(scene: Scene, permutations: int = PERMUTATIONS, seed: int = 1) -> list[Order]:
    """The stated order of a scene, first, and all distinct others of a fixed list of variants.

    Parameters
    ----------
    scene : Scene
    permutations : int
        Number of random orders of the clamp stages.
    seed : int
        Seed of the random orders.
    """
    candidates = [(STATED, scene)]
    candidates += [(name, _reordered(scene, kind, change)) for name, kind, change in _named_orders(scene)]
    settle = scene.stages[0].settle
    name = "parts settle while the first item closes" if settle else "parts settle first"
    candidates.append((name, _with_stages(scene, {0: {"settle": not settle}})))
    stream = np.random.default_rng(seed)
    shuffle = lambda groups: [groups[i] for i in stream.permutation(len(groups))]
    candidates += [(f"random {i + 1}", _reordered(scene, "clamp", shuffle)) for i in range(permutations)]
    unique, known = [], []
    for name, variant in candidates:
        if (moves := _moves(variant)) not in known:
            known.append(moves)
            unique.append(Order(name, variant))
    return unique


def variants(scene: Scene, path: Path) -> list[Order]:
    """The stated order of a scene, first, and the orders of a file.

    The file is a TOML table: each entry of ``[[orders]]`` has a ``name`` and a table ``stages``, which gives the
    changed keys of each stage by its name; an empty list removes a key.

    Raises
    ------
    SceneError
        Names the file, the order, the key and the remedy.
    """
    table = read_toml(Path(path), "file of orders")
    listed = table.get("orders")
    if set(table) != {"orders"} or not isinstance(listed, list) or not listed:
        raise SceneError(f"{path}: the file must contain at least one [[orders]] and nothing else")
    found = [Order(STATED, scene), *(_variant(scene, f"{path}: orders[{i}]", entry) for i, entry in enumerate(listed))]
    names = [order.name for order in found]
    repeated = [name for name in names if names.count(name) > 1]
    if repeated:
        raise SceneError(f"{path}: several orders are named {repeated[0]!r}; give each order its own name")
    return found


def _variant(scene: Scene, key: str, entry: dict) -> Order:
    """The order of one entry of a file; `key` names the entry in messages."""
    if set(entry) != {"name", "stages"} or not isinstance(entry["stages"], dict):
        raise SceneError(f"{key}: give name and stages, a table of stages by name, and nothing else")
    dumped = scene.model_dump(mode="json")
    stages = {str(stage.name): dumped["stages"][i] for i, stage in enumerate(scene.stages)}
    unknown = set(entry["stages"]) - set(stages)
    if unknown:
        raise SceneError(
            f"{key}.stages: the scene has no stage called {min(unknown)!r}; name one of: {', '.join(stages)}"
        )
    for name, keys in entry["stages"].items():
        stages[name].update({key: None if value == [] else value for key, value in keys.items()})
    try:
        changed = Scene(**dumped).model_copy(update={"folder": scene.folder, "deviations": scene.deviations})
    except ValidationError as error:
        first = error.errors()[0]
        place = ".".join(map(str, first["loc"]))
        raise SceneError(f"{key}: {place}{': ' * bool(place)}{first['msg'].removeprefix('Value error, ')}") from None
    return Order(str(entry["name"]), changed)


def _moves(scene: Scene):
    """Moves by stage, regardless of names: two orders with equal moves are the same."""
    stages = [
        [frozenset(move) for move in (together(moves) if stage.path == "one-step" else moves)]
        for stage, moves in stage_moves(scene)
    ]
    return stages, scene.stages[0].settle


def _named_orders(scene: Scene) -> Iterator[tuple[str, str, Callable[[Groups], Groups]]]:
    """Name of each order, the kind of stages whose groups it changes, and how."""
    locators = {locator.name for locator in scene.locators}

    def by_kind(groups: Groups, first: bool) -> Groups:
        """The groups split into locators and others; the locators come first if `first`."""
        kinds = (first, not first)
        return [[name for name in group if (name in locators) == kind] for kind in kinds for group in groups]

    reverse = lambda groups: groups[::-1]
    all_together = lambda groups: [list(chain(*groups))]
    one_by_one = lambda groups: [[name] for name in chain(*groups)]
    yield "reverse", "clamp", reverse
    yield "locators first", "clamp", lambda groups: by_kind(groups, True)
    yield "clamps first", "clamp", lambda groups: by_kind(groups, False)
    yield "clamps first, in reverse", "clamp", lambda groups: by_kind(groups[::-1], False)
    yield "all together", "clamp", all_together
    if any(weld.close or weld.gun is not None for weld in scene.welds):  # other welds move nothing
        yield "welds one by one", "weld", one_by_one
        yield "welds in reverse", "weld", lambda groups: one_by_one(groups)[::-1]
        yield "welds together", "weld", all_together
    yield "opened in the order of closing", "release", reverse
    yield "opened all together", "release", all_together


def _reordered(scene: Scene, kind: str, change: Callable[[Groups], Groups]) -> Scene:
    """The scene with changed groups in all stages of a kind."""
    updates: dict[int, dict] = {}
    for i, (stage, moves) in enumerate(stage_moves(scene)):
        groups = [names for move in moves if (names := moved_names(scene, move))]
        if stage.kind == kind and len(groups) + len(groups[0] if groups else ()) > 2:
            path = None if stage.path == "one-step" else stage.path
            updates[i] = {"order": [group for group in change(groups) if group], "sequence": False, "path": path}
    return _with_stages(scene, updates)


def moved_names(scene: Scene, move) -> list[str]:
    """Names of the locators, clamps and welds that a move closes or opens."""
    names: list[str] = []
    for action in move:
        match action:
            case Close():
                names += [scene.locators[i].name for i in action.locators]
                names += [scene.clamps[i].name for i in action.clamps]
            case Open():
                names += [scene.clamps[i].name for i in action.clamps]
                names += [scene.locators[i].name for i in action.locators]
            case Join():
                names += [scene.welds[i].name for i in action.welds]
    return names


def _with_stages(scene: Scene, updates: dict[int, dict]) -> Scene:
    """The scene with updated keys of some stages, by number."""
    stages = [stage.model_copy(update=updates.get(i, {})) for i, stage in enumerate(scene.stages)]
    return scene.model_copy(update={"stages": stages})


def compare(
    model: ReducedModel,
    others: Sequence[Order],
    law: str,
    samples: int,
    seed: int,
    threads: int = 1,
    done: Callable[[str], None] = lambda name: None,
) -> pd.DataFrame:
    """Key characteristics and slips under each order, and their changes from the first order.

    Parameters
    ----------
    model : ReducedModel
    others : sequence of Order
    law : str
    samples, seed : int
        All orders take the same samples.
    threads : int
    done : callable, optional
        Called with the name of each evaluated order.

    Returns
    -------
    DataFrame
        One row for each order and quantity, the stated order first, then by decreasing change relative to the
        tolerance: ``order``; ``quantity``, the name of a key characteristic or ``"slip STAGE ZONE"``, the RMS slip of a
        zone under load in a stage; ``tolerance`` (mm, NaN for slips); ``mean`` and ``six_sigma`` (mm); ``mean_change``
        and ``six_sigma_change`` (mm) with jackknife standard errors ``mean_error`` and ``six_sigma_error``;
        ``samples``, the number of samples that failed under neither order.
    """
    deviations, evaluated = draw(model.scene, seed, 0, samples), []
    for variant in others:
        reordered = replace(model, scene=variant.scene)
        evaluation = reordered.process(law, threads=threads).evaluate(deviations)
        evaluated.append((variant.name, quantities(reordered, evaluation), evaluation.failed))
        done(variant.name)
    _, base, base_failed = evaluated[0]
    tables = [_changes(name, values, base, ~(failed | base_failed)) for name, values, failed in evaluated]
    table = pd.concat(tables, ignore_index=True)
    tolerance = {item.name: item.upper - item.lower for item in model.scene.measurements}
    table.insert(2, "tolerance", table["quantity"].map(tolerance).astype(float))
    return _by_largest(table)


@checked
def order(
    model: ReducedModel,
    others: Sequence[Order] | None = None,
    law: str | None = None,
    samples: int = SAMPLES,
    seed: int = 0,
    threads: int = 1,
    progress: Progress = lambda count: None,
) -> pd.DataFrame:
    """Effect of the process order on the results: :func:`compare` of the orders of :func:`orders`.

    Parameters
    ----------
    model : ReducedModel
    others : sequence of Order, optional
        The stated order first; default: the orders of :func:`orders`.
    law : str, optional
        Contact law; default: the first of the scene's report.
    samples, seed, threads : int
    progress : callable or bool, optional
        Called with the number of evaluations of each order; or whether a bar is shown.

    Returns
    -------
    DataFrame
        As :data:`mic.results.schema.ORDERS` declares it.

    Raises
    ------
    SceneError
        If the process has a single order.
    """
    others = orders(model.scene) if others is None else others
    if len(others) < 2:
        raise SceneError(f"scene {model.scene.name!r}: its process has a single order; there is nothing to compare")
    law = law or model.scene.report.laws[0]
    found = compare(model, others, law, samples, seed, threads, lambda name: progress(samples))
    return found.assign(law=law)[ORDERS.names]


def quantities(model, evaluation: Evaluation) -> pd.DataFrame:
    """Key characteristics and slips of samples, one column each, mm.

    A slip is the RMS slip under load of a zone with friction in a stage, as in the results of a run; its column is
    ``slip STAGE ZONE``.
    """
    names = [item.name for item in model.scene.measurements] if evaluation.measurements.size else []
    columns = dict(zip(names, evaluation.measurements.T))
    if LAWS[evaluation.law].frictional:
        for stage, resolution in evaluation.resolutions.items():
            for i, zone in enumerate(model.scene.zones):
                pairs = model.contacts.zone == i
                if _has_friction(model.contacts, stage)[pairs].any():
                    motion = zone_motion(resolution, model.contacts, pairs, True)
                    columns[f"slip {stage} {zone.name}"] = motion["rms_slip"]
    return pd.DataFrame(columns)


def _changes(name: str, values: pd.DataFrame, base: pd.DataFrame, valid: np.ndarray) -> pd.DataFrame:
    """Changes of mean and 6σ of each column from the stated order, over the samples that are valid in both."""
    a, b, columns = values.to_numpy()[valid], base.to_numpy()[valid], {"order": name, "quantity": values.columns}

    def spread(x: np.ndarray) -> np.ndarray:
        return 6 * x.std(axis=0, ddof=1) if len(x) > 1 else np.full(x.shape[1], np.nan)

    for figure, of, change in (
        ("mean", lambda x: x.mean(axis=0), mean_change),
        ("six_sigma", spread, six_sigma_change),
    ):
        columns |= {figure: of(a), f"{figure}_change": of(a) - of(b)}
        columns[f"{figure}_error"] = [standard_error(change(before, now)) for before, now in zip(b.T, a.T)]
    return pd.DataFrame(columns | {"samples": len(a)})


def _by_largest(table: pd.DataFrame) -> pd.DataFrame:
    """The table with the orders sorted by their largest change relative to the tolerance, the stated one first."""
    change = table[["mean_change", "six_sigma_change"]].abs().max(axis=1)
    scale = table["tolerance"].where(table["tolerance"].notna(), np.inf)
    largest = (change / scale).groupby(table["order"]).max()
    rank = table["order"].map(largest.rank(ascending=False, method="first")).where(table["order"] != STATED, 0)
    return table.assign(_rank=rank).sort_values("_rank", kind="stable").drop(columns="_rank").reset_index(drop=True)


def few_samples(model: ReducedModel, law: str | None = None, **first_stage: Any) -> Evaluation:
    """A few samples with one increment per step, which suffice to raise a doubt but not for a number.

    Parameters
    ----------
    model : ReducedModel
    law : str, optional
        Default: the first law of the scene with friction, or its first one.
    **first_stage
        Keys of the first stage that are changed.
    """
    scene = model.scene
    rough: dict[int, dict] = {
        i: {"path": "increments", "increments": 1}
        for i, stage in enumerate(scene.stages)
        if stage.path != "one-step" and stage.kind in MOVING
    }
    variant = _with_stages(scene, {**rough, 0: first_stage})
    deviations = draw(scene, scene.monte_carlo.seed, 0, DOUBT_SAMPLES)
    return replace(model, scene=variant).process(law or first_frictional(scene.report.laws)).evaluate(deviations)


def doubts(model: ReducedModel, frictional: Evaluation | None = None) -> list[str]:
    """Sentences on stages in which friction hardly matters, and on an effect of how the parts settle.

    Parameters
    ----------
    model : ReducedModel
    frictional : Evaluation, optional
        Result of :func:`few_samples`, if it is known already.
    """
    law = first_frictional(model.scene.report.laws)
    if not LAWS[law].frictional or model.contacts.dimension == 1 or not model.contacts.frictional:
        return []
    frictional = frictional or few_samples(model)
    resettled = few_samples(model, settle=not model.scene.stages[0].settle)
    sentences = [_settling_effect(model, frictional, resettled)]
    with suppress(SceneError):  # without friction a part is unconstrained
        frictionless = few_samples(model, "frictionless")
        found = [_small_friction_effect(model, frictional, frictionless, stage) for stage in frictional.resolutions]
        sentences = [*found, *sentences]
    return [sentence for sentence in sentences if sentence]


def _has_friction(contacts, stage: str) -> np.ndarray:
    """(m,) whether a pair has friction in a stage."""
    friction = contacts.friction_in(stage)
    by_pressure = False if contacts.pressure.shape[1] == 0 else ~np.isnan(contacts.pressure[:, 0, 0])
    return (friction.coefficient > 0) | by_pressure


def _small_friction_effect(model, frictional: Evaluation, frictionless: Evaluation, stage: str) -> str | None:
    """A sentence if friction hardly changes the tangential motion of the contacts that end the stage closed."""
    with_, without = frictional.resolutions[stage], frictionless.resolutions[stage]
    closed = (with_.state != OPEN) & _has_friction(model.contacts, stage)
    if not closed.any():
        return None
    motion = without.displacement[closed][:, 1:]
    change = np.linalg.norm(with_.displacement[closed][:, 1:] - motion)
    if change > FRICTION_MATTERS * np.linalg.norm(motion):
        return None
    return (
        f"stage {stage}: friction changes the tangential motion of the closed contacts by at most "
        f"{100 * FRICTION_MATTERS:g} %: the parts reach their positions before they press on each other, or "
        "do not slide along each other"
    )


def _settling_effect(model, stated: Evaluation, other: Evaluation) -> str | None:
    """A sentence if a key characteristic depends on when overlapping parts settle."""
    tolerance = np.array([item.upper - item.lower for item in model.scene.measurements])
    a, b = stated.measurements, other.measurements
    if not a.size:
        return None
    change = np.maximum(np.abs(a.mean(0) - b.mean(0)), 6 * np.abs(a.std(0, ddof=1) - b.std(0, ddof=1)))
    worst = int(np.argmax(change / tolerance))
    if change[worst] <= SETTLING_MATTERS * tolerance[worst]:
        return None
    when = "while" if model.scene.stages[0].settle else "before"
    return (
        f"the results depend on how the parts are set down: {model.scene.measurements[worst].name} changes by "
        f"{1000 * change[worst]:.0f} µm, {100 * change[worst] / tolerance[worst]:.0f} % of its tolerance, if "
        f"overlapping parts settle on each other {when} the first locator or clamp closes"
    )
