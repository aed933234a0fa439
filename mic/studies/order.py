"""Effect of the process order on the key characteristics and slips of a scene.

All orders are evaluated on the same samples, so that the differences are effects of the order. A variant changes only
the sequence in which a stage closes its locators and clamps, makes its welds or releases them, and whether overlapping
parts settle before anything closes; the assignment to stages and the path settings stay.
"""

from __future__ import annotations

import tomllib
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, replace
from itertools import chain
from pathlib import Path

import numpy as np
import pandas as pd
from pydantic import ValidationError

from mic.contact.laws import LAWS
from mic.contact.states import OPEN
from mic.errors import SceneError
from mic.process.actions import Close, Hold, Open, Press, Push, Withdraw, stage_moves, together
from mic.process.evaluation import Evaluation
from mic.process.model import ReducedModel
from mic.results.sample_tables import zone_motion
from mic.results.schema import ORDERS
from mic.scene import Scene
from mic.scene.settings import FOLLOWING
from mic.statistics.draw import draw
from mic.statistics.paired_differences import mean_change, six_sigma_change, standard_error

__all__ = [
    "PERMUTATIONS",
    "STATED",
    "Order",
    "compare",
    "doubts",
    "named",
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
        In words.
    scene : Scene
        The scene with this order.
    """

    name: str
    scene: Scene


def orders(scene: Scene, permutations: int = PERMUTATIONS, seed: int = 1) -> list[Order]:
    """The order that a scene states, first, and all that are worth a comparison.

    Parameters
    ----------
    scene : Scene
    permutations : int
        Random orders of what the clamp stages close.
    seed : int
        Of these.
    """
    found = {STATED: scene}
    for name, change in chain(_closing(scene), _welding(scene), _releasing(scene)):
        found.setdefault(name, change)
    settle = scene.stages[0].settle
    found["parts settle while the first thing closes" if settle else "parts settle first"] = _changed(
        scene, {0: {"settle": not settle}}
    )
    draws = np.random.default_rng(seed)
    for number in range(permutations):
        found[f"random {number + 1}"] = _reordered(
            scene, "clamp", lambda groups: [groups[i] for i in draws.permutation(len(groups))]
        )
    unique: list[Order] = []
    for name, other in found.items():
        same = [each for each in unique if _process(each.scene) == _process(other)]
        if not same:
            unique.append(Order(name, other))
    return unique


def variants(scene: Scene, path: Path) -> list[Order]:
    """The order that a scene states, first, and those of a file.

    The file is a TOML table: each of ``[[orders]]`` has a ``name``, and in ``stages`` by their names the keys that are
    others in the scene's stages; an empty list takes a key away.

    Raises
    ------
    SceneError
        Naming the file, the order, the key and the remedy.
    """
    try:
        table = tomllib.loads(Path(path).read_text(encoding="utf-8"))
    except OSError as error:
        raise SceneError(f"{path}: cannot be read ({str(error.strerror).lower()}); check the path") from None
    except (tomllib.TOMLDecodeError, UnicodeDecodeError) as error:
        raise SceneError(f"{path}: not valid TOML: {error}; mend the syntax there") from None
    found = [Order(STATED, scene)]
    listed = table.get("orders")
    if set(table) != {"orders"} or not isinstance(listed, list) or not listed:
        raise SceneError(f"{path}: give one or more [[orders]], and nothing else")
    for i, order in enumerate(listed):
        key = f"{path}: orders[{i}]"
        if set(order) != {"name", "stages"} or not isinstance(order["stages"], dict):
            raise SceneError(f"{key}: give name and stages, the stages by their names, and nothing else")
        dumped = scene.model_dump(mode="json")
        own = {str(stage.name): dumped["stages"][number] for number, stage in enumerate(scene.stages)}
        unknown = set(order["stages"]) - set(own)
        if unknown:
            raise SceneError(
                f"{key}.stages: the scene has no stage called {min(unknown)!r}; name one of: {', '.join(own)}"
            )
        for name, keys in order["stages"].items():
            own[name].update({key: None if value == [] else value for key, value in keys.items()})
        try:
            changed = Scene(**dumped).model_copy(update={"folder": scene.folder})
        except ValidationError as error:
            told = error.errors()[0]
            place = ".".join(map(str, told["loc"]))
            raise SceneError(f"{key}: {place}{': ' * bool(place)}{told['msg'].removeprefix('Value error, ')}") from None
        found.append(Order(str(order["name"]), changed))
    names = [order.name for order in found]
    twice = [name for name in names if names.count(name) > 1]
    if twice:
        raise SceneError(f"{path}: the name {twice[0]!r} stands more than once; give each order its own")
    return found


def _process(scene: Scene):
    """What happens, whatever it is called: what makes two orders one."""
    told = []
    for stage, moves in stage_moves(scene):
        told.append([frozenset(move) for move in (together(moves) if stage.path == "one-step" else moves)])
    return told, scene.stages[0].settle


def _closing(scene: Scene) -> Iterator[tuple[str, Scene]]:
    locators = {locator.name for locator in scene.locators}

    def by_kind(groups: Groups, first: bool) -> Groups:
        own = [[name for name in group if name in locators] for group in groups]
        rest = [[name for name in group if name not in locators] for group in groups]
        return [group for group in (own + rest if first else rest + own) if group]

    yield "reverse", _reordered(scene, "clamp", lambda groups: groups[::-1])
    yield "locators first", _reordered(scene, "clamp", lambda groups: by_kind(groups, True))
    yield "clamps first", _reordered(scene, "clamp", lambda groups: by_kind(groups, False))
    yield "clamps first, in reverse", _reordered(scene, "clamp", lambda groups: by_kind(groups[::-1], False))
    yield "all together", _reordered(scene, "clamp", lambda groups: [list(chain(*groups))])


def _welding(scene: Scene) -> Iterator[tuple[str, Scene]]:
    """A weld that keeps what it finds moves nothing: only those that close their gaps, or have guns, have an order."""
    if any(weld.close or weld.gun is not None for weld in scene.welds):
        yield "welds one by one", _reordered(scene, "weld", lambda groups: [[name] for name in chain(*groups)])
        yield "welds in reverse", _reordered(scene, "weld", lambda groups: [[n] for n in chain(*groups)][::-1])
        yield "welds together", _reordered(scene, "weld", lambda groups: [list(chain(*groups))])


def _releasing(scene: Scene) -> Iterator[tuple[str, Scene]]:
    yield "opened in the order of closing", _reordered(scene, "release", lambda groups: groups[::-1])
    yield "opened all together", _reordered(scene, "release", lambda groups: [list(chain(*groups))])


def _reordered(scene: Scene, kind: str, change: Callable[[Groups], Groups]) -> Scene:
    """The scene with the groups of all its stages of a kind changed."""
    updates: dict[int, dict] = {}
    for i, (stage, moves) in enumerate(stage_moves(scene)):
        groups = [names for move in moves if (names := named(scene, move))]
        if stage.kind == kind and len(groups) + len(groups[0] if groups else ()) > 2:
            path = None if stage.path == "one-step" else stage.path
            updates[i] = {"order": [group for group in change(groups) if group], "sequence": False, "path": path}
    return _changed(scene, updates)


def named(scene: Scene, move) -> list[str]:
    """Names of what a move closes or opens."""
    found: list[str] = []
    for action in move:
        if isinstance(action, Hold | Open):
            found += [scene.locators[i].name for i in action.locators]
        if isinstance(action, Hold):
            found += [scene.clamps[i].name for i in action.strokes]
        if isinstance(action, Push):
            found += [scene.clamps[i].name for i in action.forces]
        if isinstance(action, Press):
            found += [scene.clamps[i].name for i in action.limited]
        if isinstance(action, Withdraw):
            found += [scene.clamps[i].name for i in action.clamps]
        if isinstance(action, Close):
            found += [scene.welds[i].name for i in action.welds]
    return found


def _changed(scene: Scene, updates: dict[int, dict]) -> Scene:
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
    """Key characteristics and slips under each order, and how they differ from the first.

    Parameters
    ----------
    model : ReducedModel
    others : sequence of Order
    law : str
    samples, seed : int
        The same samples for all.
    threads : int
    done : callable, optional
        Called with the name of each order that is evaluated.

    Returns
    -------
    DataFrame
        One row for each order and quantity, the stated order first, then those that change most of a tolerance:
        ``order``; ``quantity``, a key characteristic's name or ``"slip STAGE ZONE"``, a zone's RMS slip under load in a
        stage; ``tolerance`` (mm, NaN for slips); ``mean`` and ``six_sigma`` (mm); ``mean_change`` and
        ``six_sigma_change`` (mm) with jackknife standard errors ``mean_error`` and ``six_sigma_error``; ``samples``
        that neither order failed.
    """
    deviations = draw(model.scene, seed, 0, samples)
    tables, base, base_failed = [], None, None
    for other in others:
        own = replace(model, scene=other.scene)
        evaluation = own.process(law, threads=threads).evaluate(deviations)
        values = quantities(own, evaluation)
        if base is None or base_failed is None:
            base, base_failed = values, evaluation.failed
        tables.append(_changes(other.name, values, base, ~(evaluation.failed | base_failed)))
        done(other.name)
    table = pd.concat(tables, ignore_index=True)
    tolerance = {item.name: item.upper - item.lower for item in model.scene.measurements}
    table.insert(2, "tolerance", table["quantity"].map(tolerance).astype(float))
    return _by_largest(table)


def order(
    model: ReducedModel,
    others: Sequence[Order] | None = None,
    law: str | None = None,
    samples: int = SAMPLES,
    seed: int = 0,
    threads: int = 1,
) -> pd.DataFrame:
    """How much hangs on the order of the process: :func:`compare` of all orders that are worth it.

    Parameters
    ----------
    model : ReducedModel
    others : sequence of Order, optional
        The order as stated and others; default: those that :func:`orders` finds.
    law : str, optional
        Contact law; default: the first of the scene's report.
    samples, seed, threads : int

    Returns
    -------
    DataFrame
        As :data:`mic.results.schema.ORDERS` declares it.

    Raises
    ------
    SceneError
        If the process has one order only.
    """
    others = orders(model.scene) if others is None else others
    if len(others) < 2:
        raise SceneError(f"scene {model.scene.name!r}: its process has one order only; there is nothing to compare")
    asked = law or model.scene.report.laws[0]
    found = compare(model, others, asked, samples, seed, threads)
    return found.assign(law=asked)[ORDERS.names]


def quantities(model, evaluation: Evaluation) -> pd.DataFrame:
    """One column for each key characteristic, under its name, and for the slip under load of each zone with friction in
    each stage, as ``slip STAGE ZONE`` and as a run's results have it, mm."""
    names = [item.name for item in model.scene.measurements] if evaluation.measurements.size else []
    columns = dict(zip(names, evaluation.measurements.T))
    if LAWS[evaluation.law].frictional:
        for stage, resolution in evaluation.resolutions.items():
            for i, zone in enumerate(model.scene.zones):
                own = model.contacts.zone == i
                if _rubs(model.contacts, stage)[own].any():
                    columns[f"slip {stage} {zone.name}"] = zone_motion(resolution, model.contacts, own, True)[
                        "rms_slip"
                    ]
    return pd.DataFrame(columns)


def _changes(name: str, values: pd.DataFrame, base: pd.DataFrame, valid: np.ndarray) -> pd.DataFrame:
    """How much mean and 6σ of each column differ from the stated order's, over the samples that are valid in both."""
    a, b, n = values.to_numpy()[valid], base.to_numpy()[valid], int(valid.sum())

    def statistics(x):
        return x.mean(axis=0), 6 * x.std(axis=0, ddof=1) if len(x) > 1 else np.full(x.shape[1], np.nan)

    mean, six_sigma = statistics(a)
    base_mean, base_six_sigma = statistics(b)
    mean_error, six_sigma_error = (
        [standard_error(change(before, now)) for before, now in zip(b.T, a.T)]
        for change in (mean_change, six_sigma_change)
    )
    return pd.DataFrame(
        {
            "order": name,
            "quantity": values.columns,
            "mean": mean,
            "mean_change": mean - base_mean,
            "mean_error": mean_error,
            "six_sigma": six_sigma,
            "six_sigma_change": six_sigma - base_six_sigma,
            "six_sigma_error": six_sigma_error,
            "samples": n,
        }
    )


def _by_largest(table: pd.DataFrame) -> pd.DataFrame:
    change = table[["mean_change", "six_sigma_change"]].abs().max(axis=1)
    scale = table["tolerance"].where(table["tolerance"].notna(), np.inf)
    largest = (change / scale).groupby(table["order"]).max()
    rank = table["order"].map(largest.rank(ascending=False, method="first")).where(table["order"] != STATED, 0)
    return table.assign(_rank=rank).sort_values("_rank", kind="stable").drop(columns="_rank").reset_index(drop=True)


def doubts(model: ReducedModel) -> list[str]:
    """What a process as stated leaves to doubt: stages in which friction hardly matters, and an outcome that hangs on
    how the parts are set down; one sentence each.

    A few samples under one increment for each step say it: enough for a doubt, not for a number.

    Parameters
    ----------
    model : ReducedModel
    """
    scene = model.scene
    law = next((law for law in scene.report.laws if LAWS[law].frictional), None)
    if law is None or model.contacts.dimension == 1 or not model.contacts.frictional:
        return []
    rough = {
        i: {"path": "increments", "increments": 1}
        for i, stage in enumerate(scene.stages)
        if stage.path != "one-step" and stage.kind in FOLLOWING
    }
    stated = _changed(scene, rough)
    other = _changed(stated, {0: {"settle": not scene.stages[0].settle}})
    deviations = draw(scene, scene.monte_carlo.seed, 0, DOUBT_SAMPLES)
    rubbing, unsettled = (replace(model, scene=each).process(law).evaluate(deviations) for each in (stated, other))
    try:
        smooth = replace(model, scene=stated).process("frictionless").evaluate(deviations)
    except SceneError:  # friction holds what rests by contact alone
        found = []
    else:
        found = [_idle_friction(model, rubbing, smooth, stage) for stage in rubbing.resolutions]
    return [sentence for sentence in (*found, _hangs_on_settling(model, rubbing, unsettled)) if sentence]


def _rubs(contacts, stage: str) -> np.ndarray:
    """(m,) whether a pair has friction in a stage."""
    friction = contacts.friction_in(stage)
    by_pressure = False if contacts.pressure.shape[1] == 0 else ~np.isnan(contacts.pressure[:, 0, 0])
    return (friction.coefficient > 0) | by_pressure


def _idle_friction(model, rubbing: Evaluation, smooth: Evaluation, stage: str) -> str | None:
    """Tangential motion of the contacts that end the stage closed, with friction and without."""
    with_, without = rubbing.resolutions[stage], smooth.resolutions[stage]
    closed = (with_.state != OPEN) & _rubs(model.contacts, stage)
    if not closed.any():
        return None  # nothing that presses has friction here
    moved = without.displacement[closed][:, 1:]
    held = np.linalg.norm(with_.displacement[closed][:, 1:] - moved)
    if held > FRICTION_MATTERS * np.linalg.norm(moved):
        return None
    return (
        f"stage {stage}: friction changes where the contacts end by no more than {100 * FRICTION_MATTERS:g} % of their "
        "motion: what moves here moves before the parts press on each other, or not along them"
    )


def _hangs_on_settling(model, stated: Evaluation, other: Evaluation) -> str | None:
    limits = np.array([item.upper - item.lower for item in model.scene.measurements])
    a, b = (each.measurements for each in (stated, other))
    if not a.size:
        return None
    change = np.maximum(np.abs(a.mean(0) - b.mean(0)), 6 * np.abs(a.std(0, ddof=1) - b.std(0, ddof=1)))
    worst = int(np.argmax(change / limits))
    if change[worst] <= SETTLING_MATTERS * limits[worst]:
        return None
    when = "while" if model.scene.stages[0].settle else "before"
    return (
        f"the outcome hangs on how the parts are set down: {model.scene.measurements[worst].name} changes by "
        f"{1000 * change[worst]:.0f} µm, {100 * change[worst] / limits[worst]:.0f} % of its tolerance, if parts that "
        f"overlap come to rest on each other {when} the first thing closes"
    )
