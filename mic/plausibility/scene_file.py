"""What the scene file alone shows to be unusual; :mod:`mic.plausibility.rules` says what is usual instead."""

from __future__ import annotations

import itertools
from collections.abc import Iterator
from typing import Any

import numpy as np

from mic.contact.laws import LAWS
from mic.plausibility.rule import Seen, of
from mic.scene.stages import moves_assembly, set_down_in

PARALLEL = 0.99  # cosine of the angle between two directions that are one
PINNED = 1.0  # mm: points that are nearer to each other are one place

_Held = tuple[str, Any, float]  # what prescribes a position: its table, the item, and where along its direction


def held_twice(scene) -> Iterator[Seen]:
    """Locators, and clamps that hold a position, of one part, place and direction."""
    rows: list[_Held] = [("locators", item, 0.0) for item in scene.locators]
    rows += [("clamps", item, item.stroke) for item in scene.clamps if item.stroke is not None]
    moved = {(item.moves, name): item.mean for item in scene.deviations if item.moves for name in _targets(item)}
    for (one, a, at), (other, b, to) in itertools.combinations(rows, 2):
        cosine = _cosine(a, b)
        if a.part == b.part and abs(cosine) > PARALLEL and _apart(a, b) < PINNED and _together(scene, a, b):
            at_a, at_b = at + moved.get((one, a.name), 0.0), to + moved.get((other, b.name), 0.0)
            off = abs(at_a - np.sign(cosine) * at_b)
            words = f"and ask for positions {off:.3g} mm apart: they contradict" if off > 1e-6 else "a second time"
            yield (
                of(one, a),
                f"holds the same point of part {a.part} as {of(other, b)}, in the same direction, {words}",
                a.point,
            )


def clamped_twice(scene) -> Iterator[Seen]:
    """Clamps with forces at one place of one part in one direction."""
    pushing = [clamp for clamp in scene.clamps if clamp.force is not None]
    for a, b in itertools.combinations(pushing, 2):
        if a.part == b.part and _cosine(a, b) > PARALLEL and _apart(a, b) < PINNED:
            if a.stage == b.stage:
                yield of("clamps", a), f"stands where clamp {b.name} stands, and pushes the same way", a.point


def tongs_askew(scene) -> Iterator[Seen]:
    """Two clamps of different parts at one place that do not press these together with one force.

    Tongs that press a stack of sheets pair by pair push some of them alike, but all of them together push nothing.
    """
    for a, b in itertools.combinations(scene.clamps, 2):
        if a.part == b.part or not _jaws(a, b):
            continue
        cosine, step = _cosine(a, b), np.subtract(b.point, a.point)
        item, other = of("clamps", a), f"clamp {b.name} of part {b.part} opposite"
        if cosine > 0.5 and not _balanced([clamp for clamp in scene.clamps if clamp is a or _jaws(a, clamp)]):
            yield item, f"pushes the same way as {other}: they press one side only", a.point
        elif cosine < -0.5 and np.linalg.norm(step) > 0.1 and np.dot(step, a.direction) < -0.5 * np.linalg.norm(step):
            yield item, f"and {other} pull the parts apart", a.point
        elif cosine < -0.5 and None not in (a.force, b.force) and abs(a.force - b.force) > 0.2 * max(a.force, b.force):
            yield item, f"pushes with {a.force:g} N, {other} with {b.force:g} N: the rest pushes both parts", a.point


def _jaws(a: Any, b: Any) -> bool:
    """Whether two clamps stand at one place in one stage."""
    return a.stage == b.stage and _apart(a, b) <= a.radius + b.radius


def _balanced(clamps: list[Any]) -> bool:
    """Whether clamps together push nothing; those that hold a position count alike."""
    if any(isinstance(clamp.direction, str) for clamp in clamps):
        return False  # not placed yet
    forces = np.array([1.0 if clamp.force is None else clamp.force for clamp in clamps])
    total = forces @ np.array([clamp.direction for clamp in clamps])
    return bool(np.linalg.norm(total) <= 0.2 * np.abs(forces).max())


def clamps_that_may_pull(scene) -> Iterator[Seen]:
    """Clamps whose force changes sign within three standard deviations."""
    forces = {clamp.name: clamp.force for clamp in scene.clamps if clamp.force is not None}
    for item in scene.deviations:
        for name in _targets(item) if item.kind == "clamp" else ():
            least = forces.get(name, 0.0) + item.mean - 3 * item.sigma
            if forces.get(name, 0.0) > 0 > least:
                yield of("deviations", item), f"lets clamp {name} push with {least:.3g} N at three sigma", None


def moves_much(scene) -> Iterator[Seen]:
    """Deviations of position that no fixture has, and forces that shape no sheet."""
    strokes = {clamp.name for clamp in scene.clamps if clamp.stroke is not None}
    for item in scene.deviations:
        if item.kind in ("measured", "gravity", "temperature", "friction"):
            continue  # what was measured is told with the mesh; the others have neither mm nor N
        position = item.kind not in ("force", "clamp") or (item.kind == "clamp" and strokes & {*_targets(item)})
        high, unit = (MOVED, "mm") if position else (SHAPED, "N")
        for key in ("mean", "sigma"):
            value = getattr(item, key) * (np.abs(item.known).max() if item.kind == "shape" else 1.0)
            if abs(value) > high:
                yield of("deviations", item), f"{key} = {value:g} {unit}", getattr(item, "point", None)


MOVED = 3.0  # mm
SHAPED = 1000.0  # N


def nothing_varies(scene) -> Iterator[Seen]:
    """A Monte Carlo of samples that are all alike."""
    if scene.monte_carlo.samples > 1 and not any(item.sigma for item in scene.deviations):
        words = "all sigma are 0" if scene.deviations else "there are none"
        yield "deviations", f"{words}: the {scene.monte_carlo.samples} samples are all alike", None


def deviates_by_nothing(scene) -> Iterator[Seen]:
    """Deviations without mean and sigma."""
    for item in scene.deviations:
        if item.mean == item.sigma == 0:
            yield of("deviations", item), "has mean 0 and sigma 0: it does nothing", getattr(item, "point", None)


def force_on_a_locator(scene) -> Iterator[Seen]:
    """Corrective forces that a locator takes where they act: they shape nothing."""
    for item in scene.deviations:
        for locator in scene.locators if item.kind == "force" else ():
            along = abs(_cosine(item, locator)) > PARALLEL
            if along and item.part == locator.part and _apart(item, locator) < PINNED:
                if locator.stage == set_down_in(scene).get(item.part):
                    yield of("deviations", item), f"pushes straight onto locator {locator.name}", item.point


def deviates_twice(scene) -> Iterator[Seen]:
    """Two deviations of one target, or two forces in one place."""
    for a, b in itertools.combinations(scene.deviations, 2):
        if a.kind != b.kind or (a.moves is None and a.kind != "force"):
            continue
        if a.kind == "force":
            same = a.part == b.part and _apart(a, b) < PINNED and abs(_cosine(a, b)) > PARALLEL
        else:
            same = bool({*_targets(a)} & {*_targets(b)})
        if same:
            yield of("deviations", b), f"does what deviation {a.name} does: their sigmas add in squares", None


def limits_aside(scene) -> Iterator[Seen]:
    """Tolerances that the nominal part misses."""
    for item in scene.measurements:
        if not item.lower <= 0 <= item.upper:
            said = f"limits {item.lower:g} to {item.upper:g} mm leave out the nominal 0"
            yield of("measurements", item), said, _where(item)


def tolerance_odd(scene) -> Iterator[Seen]:
    """Widths of tolerances."""
    for item in scene.measurements:
        width = item.upper - item.lower
        if not TOLERANCE[0] <= width <= TOLERANCE[1]:
            yield of("measurements", item), f"the tolerance is {width:g} mm wide", _where(item)


TOLERANCE = (0.02, 30.0)  # mm


def measured_at_a_locator(scene) -> Iterator[Seen]:
    """Measurements of what a locator that still holds prescribes."""
    kept: set[str] = set()
    for stage in scene.stages:
        if moves_assembly(scene, stage):
            kept = set()
        if stage.kind == "release" and stage.keep is not None:
            kept &= set(stage.keep)
        kept |= {locator.name for locator in scene.locators if locator.stage == stage.name}
    for item in scene.measurements:
        for locator in scene.locators if item.kind == "point" and item.best_fit is None else ():
            along = abs(_cosine(item, locator)) > PARALLEL
            if along and locator.name in kept and item.part == locator.part and _apart(item, locator) < PINNED:
                yield of("measurements", item), f"reads where locator {locator.name} holds the part", item.point


def measured_twice(scene) -> Iterator[Seen]:
    """Two measurements of one place and direction."""
    for a, b in itertools.combinations(scene.measurements, 2):
        if a.kind != b.kind or a.best_fit != b.best_fit or a.part != b.part:
            continue
        along = a.kind == "profile" or abs(_cosine(a, b)) > 1 - 1e-6
        apart = _apart(a, b) if a.kind == "point" else 0.0 if a.places == b.places else np.inf
        if along and apart < 1e-6:
            yield of("measurements", b), f"reads what measurement {a.name} reads", _where(b)


def nothing_read(scene) -> Iterator[Seen]:
    """Scenes that report nothing."""
    if not scene.measurements and (not scene.zones or any(stage.kind == "measure" for stage in scene.stages)):
        yield "measurements", "there are none: no key characteristic is reported", None


def welds_upon_each_other(scene) -> Iterator[Seen]:
    """Nuggets that overlap."""
    for a, b in itertools.combinations(scene.welds, 2):
        apart = _apart(a, b)
        if set(a.parts) & set(b.parts) and apart < max(PINNED, a.radius + b.radius):
            # A stack of three sheets is welded through in one place, pair by pair.
            if set(a.parts) == set(b.parts) or apart > PINNED:
                yield of("welds", b), f"lies {apart:.3g} mm from weld {a.name}: the nuggets overlap", b.point


def welded_without_zone(scene) -> Iterator[Seen]:
    """Parts that are welded where nothing keeps them from passing through each other."""
    joined = {frozenset(zone.parts) for zone in scene.zones}
    for parts in dict.fromkeys(frozenset(weld.parts) for weld in scene.welds):
        if parts not in joined:
            own = next(weld for weld in scene.welds if set(weld.parts) == parts)
            yield of("welds", own), f"joins parts {' and '.join(own.parts)}, between which there is no zone", own.point


def path_doubles_back(scene) -> Iterator[Seen]:
    """Polylines of zones that stand still or turn round."""
    for zone in scene.zones:
        steps = np.diff(np.array(zone.path or ()).reshape(-1, 3), axis=0)
        lengths = np.linalg.norm(steps, axis=1)
        for i, (a, b) in enumerate(itertools.pairwise(range(len(steps)))):
            if lengths[a] * lengths[b] > 0 and steps[a] @ steps[b] < -0.8 * lengths[a] * lengths[b]:
                yield of("zones", zone), f"path runs back on itself at its point {i + 2}", zone.path[i + 1]


def friction_forgotten(scene) -> Iterator[Seen]:
    """Laws with friction where no zone states any."""
    laws = [law for law in scene.report.laws if LAWS[law].frictional]
    if laws and scene.zones and not any(zone.frictional for zone in scene.zones):
        for zone in scene.zones:
            if "friction" not in zone.model_fields_set:
                yield of("zones", zone), f"has no friction, and {laws[0]} asks for one", None


def pressure_odd(scene) -> Iterator[Seen]:
    """Coefficients and pressures of friction that depends on pressure."""
    for zone in scene.zones:
        points = list(zone.friction_table or ())
        if zone.friction_power is not None:
            power = zone.friction_power
            points += [(power.p0, power.mu0), (power.p0, power.mu_min), (power.p0, power.mu_max)]
        for p, mu in points:
            if mu > 1 or p > 1000:
                yield of("zones", zone), f"friction of {mu:g} at {p:g} MPa", None


def overlap_let_through(scene) -> Iterator[Seen]:
    """Limits of nominal overlap beyond the sheets' thickness."""
    thickness = {part.name: part.thickness or np.inf for part in scene.parts}  # a mesh file may tell it
    for zone in scene.zones:
        thinner = min(thickness[name] for name in zone.parts if name in thickness)
        if isinstance(zone.nominal_overlap, float) and zone.nominal_overlap > thinner:
            said = f"nominal_overlap = {zone.nominal_overlap:g} mm is more than the {thinner:g} mm of the thinner sheet"
            yield of("zones", zone), said, None


def stands_alone(scene) -> Iterator[Seen]:
    """Parts and fixtures that nothing joins or touches."""
    if len(scene.parts) + len(scene.fixtures) < 2:
        return
    met = {name for joint in (*scene.welds, *scene.zones) for name in joint.parts}
    for table in ("parts", "fixtures"):
        for item in getattr(scene, table):
            if item.name not in met:
                yield of(table, item), "no zone and no weld names it: it meets nothing", None


def welded_open(scene) -> Iterator[Seen]:
    """Welds that are made when every clamp has opened again, or, without a gun, before one of their station closes."""
    closed: set[str] = set()
    opened = False
    for number, stage in enumerate(scene.stages):
        if moves_assembly(scene, stage):
            closed, opened = set(), False  # in another station the first welds hold the sheets together
        if stage.kind == "clamp":
            closed |= {item.name for item in scene.clamps if item.stage == stage.name}
        elif stage.kind == "release":
            opened |= bool(closed)
            closed &= set(stage.keep or ())
        elif stage.kind == "weld" and not closed:
            later = itertools.takewhile(lambda one: not moves_assembly(scene, one), scene.stages[number:])
            waiting = {one.name for one in later} & {clamp.stage for clamp in scene.clamps}
            pressed = all(weld.gun or weld.close for weld in scene.welds if weld.stage == stage.name)
            if opened:
                yield f"stage {stage.name}", "welds when every clamp has opened", None
            elif waiting and not pressed:
                yield f"stage {stage.name}", "welds before a clamp has closed", None


def welds_nothing(scene) -> Iterator[Seen]:
    """Weld stages without welds."""
    for stage in scene.stages:
        if stage.kind == "weld" and not any(weld.stage == stage.name for weld in scene.welds):
            yield f"stage {stage.name}", "makes no weld", None


def _together(scene, a, b) -> bool:
    """Whether two items close in one station, so that they may hold at the same time."""
    station = list(itertools.accumulate(moves_assembly(scene, stage) for stage in scene.stages))
    of_stage = {stage.name: number for stage, number in zip(scene.stages, station)}
    return of_stage[a.stage] == of_stage[b.stage]


def _where(item):
    """The first point of a measurement; None while it is not placed."""
    return item.places[0][1] if item.places else None


def _apart(a, b) -> float:
    """Distance between two items, mm; infinite while one is not placed."""
    placed = a.point is not None and b.point is not None
    return float(np.linalg.norm(np.subtract(a.point, b.point))) if placed else np.inf


def _cosine(a, b) -> float:
    """Cosine of the angle between two items' directions; 0 while one is not placed."""
    placed = not any(item.direction is None or isinstance(item.direction, str) for item in (a, b))
    return float(np.dot(a.direction, b.direction)) if placed else 0.0


def _targets(item) -> list[str]:
    """The names of what a deviation moves."""
    return [item.target] if isinstance(item.target, str) else list(item.target)
