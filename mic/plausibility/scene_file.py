"""Findings of the rules that need the scene file alone.

Each function has the name of its rule in ``rules.toml``, and finds what is outside the range that is usual.
"""

from __future__ import annotations

import itertools
from collections.abc import Iterator
from typing import Any

import numpy as np

from mic.contact.laws import LAWS
from mic.plausibility.finding import Finding, about, label
from mic.scene.deviation import targets
from mic.scene.stages import moves_assembly, placing_stages

PARALLEL = 0.99  # cosine of the angle between two directions that count as equal
PINNED = 1.0  # mm between two points that count as one

MOVED = 3.0  # mm
SHAPED = 1000.0  # N
WARMED, RUBBED, WEIGHED = 150.0, 0.5, 1.5  # K; change of a coefficient of friction; multiples of the earth's gravity
BEYOND = 30.0  # times these: no assembly varies so much
TOLERANCE = (0.02, 30.0)  # mm


def held_by_stage(scene) -> Iterator[tuple[Any, set[str]]]:
    """Each stage with the names of the locators and clamps that are closed at its end."""
    held: set[str] = set()
    for stage in scene.stages:
        if stage.kind == "release":
            held = held & ({item.name for item in scene.locators} if stage.keep is None else set(stage.keep))
        else:
            closing = {item.name for item in (*scene.locators, *scene.clamps) if item.stage == stage.name}
            held = closing if moves_assembly(scene, stage) else held | closing
        yield stage, held


def held_at(scene, table: str, item: Any) -> float:
    """Mean position along its direction that a locator or clamp prescribes, mm from nominal."""
    moving = [row.mean for row in scene.deviations if row.moves == table and item.name in targets(row)]
    return (item.stroke if table == "clamps" else 0.0) + sum(moving)


def held_twice(scene) -> Iterator[Finding]:
    """Two locators, or clamps with a stroke, of one part, point and direction."""
    rows = [("locators", item) for item in scene.locators]
    rows += [("clamps", item) for item in scene.clamps if item.stroke is not None]
    for (one, a), (other, b) in itertools.combinations(rows, 2):
        if a.part == b.part and _alike(a, b) and _together(scene, a, b):
            off = abs(held_at(scene, one, a) - np.sign(_cosine(a, b)) * held_at(scene, other, b))
            conflict = f"and prescribes a position {off:.3g} mm away from it" if off > 1e-6 else "a second time"
            text = f"holds the same point of part {a.part} as {label(other, b)}, in the same direction, {conflict}"
            yield about(one, a, text)


def clamped_twice(scene) -> Iterator[Finding]:
    """Two clamps with forces at one point of one part in one direction."""
    pushing = [clamp for clamp in scene.clamps if clamp.force is not None]
    for a, b in itertools.combinations(pushing, 2):
        if a.part == b.part and a.stage == b.stage and _alike(a, b) and _cosine(a, b) > 0:
            yield about("clamps", a, f"has the same point and direction as clamp {b.name}")


def tongs_askew(scene) -> Iterator[Finding]:
    """Two clamps of different parts at one point that do not press these together with equal forces.

    Tongs that press a stack of sheets pair by pair are accepted if their forces balance.
    """
    for a, b in itertools.combinations(scene.clamps, 2):
        if a.part == b.part or not _jaws(a, b):
            continue
        cosine, step, other = _cosine(a, b), np.subtract(b.point, a.point), f"clamp {b.name} of part {b.part} opposite"
        if cosine > 0.5 and not _balanced([clamp for clamp in scene.clamps if clamp is a or _jaws(a, clamp)]):
            yield about("clamps", a, f"pushes in the same direction as {other}: they press one side only")
        elif cosine < -0.5 and np.linalg.norm(step) > 0.1 and np.dot(step, a.direction) < -0.5 * np.linalg.norm(step):
            yield about("clamps", a, f"and {other} pull the parts apart")
        elif cosine < -0.5 and None not in (a.force, b.force) and abs(a.force - b.force) > 0.2 * max(a.force, b.force):
            text = f"pushes with {a.force:g} N, {other} with {b.force:g} N: both parts are pushed"
            yield about("clamps", a, text)


def _jaws(a: Any, b: Any) -> bool:
    """Whether two clamps close at one point in one stage."""
    return a.stage == b.stage and _apart(a, b) <= a.radius + b.radius


def _balanced(clamps: list[Any]) -> bool:
    """Whether the forces of clamps balance; those with a stroke count with equal forces."""
    if any(isinstance(clamp.direction, str) for clamp in clamps):
        return False  # not placed yet
    forces = np.array([1.0 if clamp.force is None else clamp.force for clamp in clamps])
    total = forces @ np.array([clamp.direction for clamp in clamps])
    return bool(np.linalg.norm(total) <= 0.2 * np.abs(forces).max())


def clamp_may_pull(scene) -> Iterator[Finding]:
    """Clamps whose force changes sign within three standard deviations."""
    forces = {clamp.name: clamp.force or 0.0 for clamp in scene.clamps}
    for item in scene.deviations:
        for name in targets(item) if item.kind == "clamp" else ():
            least = forces[name] + item.mean - 3 * item.sigma
            if forces[name] > 0 > least:
                yield label("deviations", item), f"gives clamp {name} a force of {least:.3g} N at three sigma", None


def moves_much(scene) -> Iterator[Finding]:
    """Large deviations."""
    for item, share, text in _deviations(scene):
        if share > 1.0:
            yield *about("deviations", item, text), share > BEYOND


def _deviations(scene) -> Iterator[tuple[Any, float, str]]:
    """Each mean and sigma of the deviations, relative to the largest that is usual, and in words."""
    strokes = {clamp.name for clamp in scene.clamps if clamp.stroke is not None}
    largest = {
        "force": (SHAPED, " N"),
        "temperature": (WARMED, " K"),
        "friction": (RUBBED, ""),
        "gravity": (WEIGHED, ""),
    }
    for item in scene.deviations:
        high, unit = largest.get(item.kind, (MOVED, " mm"))
        if item.kind == "clamp" and not strokes & {*targets(item)}:
            high, unit = largest["force"]
        if item.kind == "measured":  # a factor
            high, unit = MOVED, ""
        for key in ("mean", "sigma"):
            value = getattr(item, key) * (np.abs(item.known).max() if item.kind == "shape" else 1.0)
            yield item, abs(value) / high, f"{key} = {value:g}{unit}"


def nothing_varies(scene) -> Iterator[Finding]:
    """A Monte Carlo of identical samples."""
    if scene.monte_carlo.samples > 1 and not any(item.sigma for item in scene.deviations):
        cause = "every sigma is 0" if scene.deviations else "there are none"
        yield "deviations", f"{cause}: the {scene.monte_carlo.samples} samples are identical", None


def deviates_by_nothing(scene) -> Iterator[Finding]:
    """Deviations without mean and sigma."""
    for item in scene.deviations:
        if item.mean == item.sigma == 0:
            yield about("deviations", item, "has mean 0 and sigma 0: it has no effect")


def force_on_a_locator(scene) -> Iterator[Finding]:
    """Corrective forces that act on a locator."""
    for item in scene.deviations:
        for locator in scene.locators if item.kind == "force" else ():
            placing = locator.stage == placing_stages(scene).get(item.part)
            if placing and item.part == locator.part and _alike(item, locator):
                yield about("deviations", item, f"pushes onto locator {locator.name}")


def deviates_twice(scene) -> Iterator[Finding]:
    """Two deviations of one target, or two forces at one point."""
    for a, b in itertools.combinations(scene.deviations, 2):
        if a.kind == b.kind == "force":
            same = a.part == b.part and _alike(a, b)
        else:
            same = a.kind == b.kind and a.moves is not None and not {*targets(a)}.isdisjoint(targets(b))
        if same:
            yield label("deviations", b), f"has the same effect as deviation {a.name}: their variances add up", None


def limits_aside(scene) -> Iterator[Finding]:
    """Tolerances that exclude the nominal part."""
    for item in scene.measurements:
        if not item.lower <= 0 <= item.upper:
            yield about("measurements", item, f"limits {item.lower:g} to {item.upper:g} mm exclude the nominal 0")


def tolerance_odd(scene) -> Iterator[Finding]:
    """Very narrow or wide tolerances."""
    for item in scene.measurements:
        width = item.upper - item.lower
        if not TOLERANCE[0] <= width <= TOLERANCE[1]:
            yield about("measurements", item, f"the tolerance is {width:g} mm wide")


def measured_at_a_locator(scene) -> Iterator[Finding]:
    """Measurements of what a closed locator prescribes."""
    *_, (_, closed) = held_by_stage(scene)
    for item in scene.measurements:
        for locator in scene.locators if item.kind == "point" and not _aligned(scene, item) else ():
            if locator.name in closed and item.part == locator.part and _alike(item, locator):
                yield about("measurements", item, f"reads where locator {locator.name} holds the part")


def _aligned(scene, item):
    """The best fit or the frame of a measurement; None without either."""
    return item.best_fit or scene.frame_of(item)


def measured_twice(scene) -> Iterator[Finding]:
    """Two measurements of one point and direction."""
    for a, b in itertools.combinations(scene.measurements, 2):
        if a.kind != b.kind or _aligned(scene, a) != _aligned(scene, b) or a.part != b.part:
            continue
        along = a.kind == "profile" or abs(_cosine(a, b)) > 1 - 1e-6
        apart = _apart(a, b) if a.kind == "point" else 0.0 if a.places == b.places else np.inf
        if along and apart < 1e-6:
            yield about("measurements", b, f"reads the same as measurement {a.name}")


def nothing_read(scene) -> Iterator[Finding]:
    """Scenes without measurements."""
    if not scene.measurements and (not scene.zones or any(stage.kind == "measure" for stage in scene.stages)):
        yield "measurements", "there are none: no key characteristic is reported", None


def welds_upon_each_other(scene) -> Iterator[Finding]:
    """Nuggets that overlap."""
    for a, b in itertools.combinations(scene.welds, 2):
        apart = _apart(a, b)
        if set(a.parts) & set(b.parts) and apart < max(PINNED, a.radius + b.radius):
            # A stack of three sheets is welded at one point, pair by pair.
            if set(a.parts) == set(b.parts) or apart > PINNED:
                yield about("welds", b, f"is {apart:.3g} mm from weld {a.name}: the nuggets overlap")


def path_doubles_back(scene) -> Iterator[Finding]:
    """Paths of zones that reverse their direction."""
    for zone in scene.zones:
        steps = np.diff(np.array(zone.path or ()).reshape(-1, 3), axis=0)
        lengths = np.linalg.norm(steps, axis=1)
        for i, (a, b) in enumerate(itertools.pairwise(range(len(steps)))):
            if lengths[a] * lengths[b] > 0 and steps[a] @ steps[b] < -0.8 * lengths[a] * lengths[b]:
                yield label("zones", zone), f"path reverses at its point {i + 2}", zone.path[i + 1]


def friction_forgotten(scene) -> Iterator[Finding]:
    """Zones without friction under a law with friction."""
    laws = [law for law in scene.report.laws if LAWS[law].frictional]
    if laws and scene.zones and not any(zone.frictional for zone in scene.zones):
        for zone in scene.zones:
            if "friction" not in zone.model_fields_set:
                yield label("zones", zone), f"has no friction, and law {laws[0]} needs it", None


def pressure_odd(scene) -> Iterator[Finding]:
    """Large coefficients and pressures of pressure-dependent friction."""
    for zone in scene.zones:
        points = list(zone.friction_table or ())
        if zone.friction_power is not None:
            power = zone.friction_power
            points += [(power.p0, power.mu0), (power.p0, power.mu_min), (power.p0, power.mu_max)]
        for p, mu in points:
            if mu > 1 or p > 1000:
                yield label("zones", zone), f"friction of {mu:g} at {p:g} MPa", None


def overlap_let_through(scene) -> Iterator[Finding]:
    """Limits of nominal overlap beyond the sheets' thickness."""
    thickness = {part.name: part.thickness or np.inf for part in scene.parts}  # it may come from the mesh file
    for zone in scene.zones:
        thinner = min(thickness[name] for name in zone.parts if name in thickness)
        if isinstance(zone.nominal_overlap, float) and zone.nominal_overlap > thinner:
            text = f"nominal_overlap = {zone.nominal_overlap:g} mm exceeds the {thinner:g} mm of the thinner sheet"
            yield label("zones", zone), text, None


def stands_alone(scene) -> Iterator[Finding]:
    """Parts and fixtures without any weld and zone."""
    if len(scene.parts) + len(scene.fixtures) < 2:
        return
    met = {name for joint in (*scene.welds, *scene.zones) for name in joint.parts}
    for table in ("parts", "fixtures"):
        for item in getattr(scene, table):
            if item.name not in met:
                yield label(table, item), "is in no zone and in no weld", None


def welded_open(scene) -> Iterator[Finding]:
    """Welds made after every clamp has opened, or, without a gun, before any clamp of the station has closed."""
    closed: set[str] = set()
    opened = False
    for number, (stage, held) in enumerate(held_by_stage(scene)):
        if moves_assembly(scene, stage):
            opened = False  # in a later station the welds of the first hold the sheets together
        opened |= stage.kind == "release" and bool(closed)
        closed = held & {clamp.name for clamp in scene.clamps}
        if stage.kind == "weld" and not closed:
            later = itertools.takewhile(lambda one: not moves_assembly(scene, one), scene.stages[number:])
            waiting = {one.name for one in later} & {clamp.stage for clamp in scene.clamps}
            pressed = all(weld.gun or weld.close for weld in scene.welds if weld.stage == stage.name)
            if opened:
                yield f"stage {stage.name}", "welds after every clamp has opened", None
            elif waiting and not pressed:
                yield f"stage {stage.name}", "welds before a clamp has closed", None


def welds_nothing(scene) -> Iterator[Finding]:
    """Weld stages without welds."""
    for stage in scene.stages:
        if stage.kind == "weld" and not any(weld.stage == stage.name for weld in scene.welds):
            yield f"stage {stage.name}", "makes no weld", None


def _together(scene, a, b) -> bool:
    """Whether two items close in one station, so that both may be closed at the same time."""
    station = list(itertools.accumulate(moves_assembly(scene, stage) for stage in scene.stages))
    of_stage = {stage.name: number for stage, number in zip(scene.stages, station)}
    return of_stage[a.stage] == of_stage[b.stage]


def _alike(a, b) -> bool:
    """Whether two items have one point, and one direction or opposite ones."""
    return _apart(a, b) < PINNED and abs(_cosine(a, b)) > PARALLEL


def _apart(a, b) -> float:
    """Distance between two items, mm; infinite while one is not placed."""
    placed = a.point is not None and b.point is not None
    return float(np.linalg.norm(np.subtract(a.point, b.point))) if placed else np.inf


def _cosine(a, b) -> float:
    """Cosine of the angle between two items' directions; 0 while one is not placed."""
    placed = not any(item.direction is None or isinstance(item.direction, str) for item in (a, b))
    return float(np.dot(a.direction, b.direction)) if placed else 0.0
