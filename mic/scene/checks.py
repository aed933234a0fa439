"""What no single table of a scene can know: names that exist, parts that are held."""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterable

import numpy as np
from scipy.linalg import null_space

from mic.contact.laws import LAWS
from mic.scene.optimisation import check_optimisation
from mic.scene.stages import check_stages, known, moves_assembly, set_down_in, told

__all__ = ["entry", "problems"]

MOVING = ("welds", "locators", "clamps")  # what may move in its sheet
NAMED = ("locators", "clamps", "welds", "zones", "deviations", "measurements", "stages")  # tables of items with names


def problems(scene, whole: bool = True) -> list[str]:
    """All that is wrong between the scene's tables: names that exist, stages that make a process, parts that are held.

    Parameters
    ----------
    scene : mic.scene.schema.Scene
    whole : bool
        Whether every item is valid in itself. Else numbers are not looked at, and what cannot be told is not told.

    Returns
    -------
    list of str
        One line a problem, with the key, the name of the item and the remedy.
    """
    found: list[str] = []
    for check in (
        check_names,
        check_references,
        check_stages,
        check_friction,
        check_correlations,
        check_stations,
        check_positions,
        check_optimisation,
        check_stiffness,
        *(check_held,) * whole,
    ):
        try:
            found += told(check, scene)
        except (AttributeError, KeyError, TypeError, IndexError):  # of items that lack keys, or have others
            if whole:
                raise
    return found


def check_names(scene) -> None:
    """Every name stands once in its table.

    Raises
    ------
    ValueError
        Here as below, one line a problem, naming the key and the remedy.
    """
    _raise(
        f"{key}: the name {name!r} stands more than once; give each its own"
        for key, items in (
            ("parts", [*scene.parts, *scene.fixtures]),
            *((key, getattr(scene, key)) for key in NAMED),
        )
        for name, count in Counter(item.name for item in items).items()
        if count > 1
    )


def check_references(scene) -> None:
    """Every part, locator and clamp that another table names exists, and what is joined are two bodies."""
    bodies = {part.name for part in scene.parts}
    every = bodies | {fixture.name for fixture in scene.fixtures}
    found = []
    for key in ("fixtures", "locators", "clamps", "measurements", "deviations"):
        for i, item in enumerate(getattr(scene, key)):
            if getattr(item, "part", None) is not None:
                found += told(known, entry(key, i, item, "part"), item.part, bodies, "part")
    for key, allowed in (("welds", bodies), ("clamps", bodies), ("zones", every)):
        for i, item in enumerate(getattr(scene, key)):
            if getattr(item, "parts", None) is None:
                continue  # a clamp that is no tong
            at = entry(key, i, item, "parts")
            found += [line for name in item.parts for line in told(known, at, name, allowed, "part")]
            if item.parts[0] == item.parts[1]:
                found.append(f"{at}: a part cannot be joined to itself, name two different parts")
            elif set(item.parts) <= every - bodies:
                found.append(f"{at}: at least one of the two must be a part, not a fixture")
    if scene.monte_carlo.accuracy is not None and not (scene.measurements and scene.deviations):
        found.append("monte_carlo.accuracy: is that of key characteristics that vary; give measurements and deviations")
    measured = {item.name for item in scene.measurements}
    for i, item in enumerate(scene.measurements):
        if getattr(item, "to", None) is not None:
            found += told(known, entry("measurements", i, item, "to.part"), item.to.part, bodies, "part")
        for name in getattr(item, "best_fit", None) or ():
            found += told(known, entry("measurements", i, item, "best_fit"), name, measured, "measurement")
    thick: dict[str, str] = {}
    for i, item in enumerate(scene.deviations):
        if item.kind == "thickness" and thick.setdefault(item.part, item.name) != item.name:
            at, other = entry("deviations", i, item, "part"), thick[item.part]
            found.append(f"{at}: the thickness of {item.part!r} is varied by {other!r} already; give both as one")
        if getattr(item, "moves", None) is not None:
            targets = {target.name for target in getattr(scene, item.moves)}
            at = entry("deviations", i, item, "target")
            for name in [item.target] if isinstance(item.target, str) else item.target:
                found += told(known, at, name, targets, item.moves.removesuffix("s"))
    _raise(found)


#: Keys of a zone that give a law what it reads beyond a coefficient (`mic.contact.laws.Law.reads`).
READ = {"pressure": ("friction_table", "friction_power"), "compliance": ("tangential_stiffness",)}


def check_friction(scene) -> None:
    """Friction by stage names stages, and no law asks in vain for what a zone may give it."""
    stages = {stage.name for stage in scene.stages}
    found = []
    for i, zone in enumerate(scene.zones):
        for name in zone.friction if isinstance(zone.friction, dict) else ():
            if name != "default":
                found += told(known, entry("zones", i, zone, "friction"), name, stages, "stage")
    for law in scene.report.laws:
        keys = READ.get(LAWS[law].reads, ())
        if keys and all(getattr(zone, key) is None for zone in scene.zones for key in keys):
            found.append(
                f"report.laws: no zone has {' or '.join(keys)}, without which {law} is Coulomb's law; give it in a "
                'zone, or ask for "coulomb"'
            )
    _raise(found)


def check_stations(scene) -> None:
    """Gravity acts where something is set down."""
    stations = [str(stage.name) for stage in scene.stages if stage is scene.stages[0] or moves_assembly(scene, stage)]
    found = []
    for i, item in enumerate(scene.deviations):
        if item.kind == "gravity" and item.stage is not None and item.stage not in stations:
            found.append(
                f"{entry('deviations', i, item, 'stage')}: in {item.stage!r} nothing is set down anew; name one of "
                f"{', '.join(stations)}"
            )
    _raise(found)


def check_correlations(scene) -> None:
    """Deviations that vary together exist, are drawn one by one, and stand in one table of correlations."""
    kinds = {item.name: item for item in scene.deviations}
    found, seen = [], set()
    for i, table in enumerate(scene.correlations):
        for name in table.deviations:
            at = f"correlations[{i}].deviations"
            found += told(known, at, name, kinds, "deviation")
            item = kinds.get(name)
            if item is not None and (item.several or getattr(item, "scores", None) is not None):
                found.append(f"{at}: {name!r} stands for several modes, which are uncorrelated; take it out")
            if name in seen:
                found.append(f"{at}: {name!r} stands there twice; put all that varies with it into one matrix, once")
            seen.add(name)
    _raise(found)


def check_stiffness(scene) -> None:
    """The stiffness of the mean shape is that of sheets of one thickness, known by their meshes."""
    if scene.stiffness == "nominal":
        return
    found = []
    for i, part in enumerate(scene.parts):
        for key in ("stiffness", "compliance"):
            if getattr(part, key) is not None:
                at = entry("parts", i, part, key)
                found.append(f"{at}: a matrix cannot follow a shape; leave the scene's stiffness nominal")
    for i, item in enumerate(scene.deviations):
        if item.kind == "thickness":
            at = entry("deviations", i, item)
            found.append(f"{at}: thickness changes the stiffness, too; take it out, or leave the scene's nominal")
    if scene.report.fields:
        found.append("report.fields: are those of parts on their nominal meshes; leave them out, or stiffness nominal")
    if scene.optimise is not None:
        found.append("optimise: knows the nominal stiffness alone; take the table out, or leave stiffness nominal")
    _raise(found)


def check_positions(scene) -> None:
    """What is to move in its sheet exists, and stands on it."""
    wrong = []
    for i, asked in enumerate(scene.report.positions):
        kind, dot, name = asked.partition(".")
        items = {one.name: one for one in getattr(scene, kind)} if kind in MOVING else {}
        # The jaws of a tong are called by it and their part.
        jaws = {f"{one.name}-{part}" for one in items.values() for part in getattr(one, "parts", None) or ()}
        if kind not in MOVING or (dot and name not in items and name not in jaws):
            known_ones = [f"{table}.{one.name}" for table in MOVING for one in getattr(scene, table)]
            wrong.append(f"report.positions[{i}]: there is no {asked!r}; known: {', '.join([*MOVING, *known_ones])}")
        elif dot and getattr(items.get(name), "hole", None) is not None:
            wrong.append(f"report.positions[{i}]: {asked!r} stands in a hole, and moves with it alone; leave it out")
    _raise(wrong)


def check_held(scene) -> None:
    """Every part has six independent locators when it is set down, or rests, in a zone.

    Of a part whose locators are not placed yet nothing is said. Whether contact can hold what rests,
    :mod:`mic.process.free_motions` says.
    """
    found, stations = [], set_down_in(scene)
    touching = {name for zone in scene.zones for name in zone.parts}
    for i, part in enumerate(scene.parts):
        if part.rests:
            if part.name not in touching:
                found.append(
                    f"parts[{i}].rests ({part.name}): it is in no zone, so there is nothing to rest on; add one"
                )
            continue
        stage = stations[part.name]
        own = [locator for locator in scene.locators if locator.part == part.name and locator.stage == stage]
        if any(locator.point is None or isinstance(locator.direction, str) for locator in own):
            continue  # told once the scene is placed on its meshes
        free = np.eye(6)
        if own:
            points = np.array([locator.point for locator in own])
            arms = (points - points.mean(0)) / max(1.0, float(np.ptp(points, axis=0).max()))
            rows = np.array(
                [[*locator.direction, *np.cross(arm, locator.direction)] for locator, arm in zip(own, arms)]
            )
            free = null_space(rows, rcond=1e-6)
        held = 6 - free.shape[1]
        if held < 6:
            found.append(
                f"parts[{i}] ({part.name}): its {len(own)} locators of the locate stage hold {held} of its 6 "
                f"rigid-body motions{_named(free)}; add locators (at least a 3-2-1 scheme) until all six are held; "
                "where it rests on another part, rests = true, and a zone between the two"
            )
    _raise(found)


def entry(key: str, i: int, item, field: str = "") -> str:
    """Where an item stands in the scene, with its name: ``locators[3].part (A4)``."""
    return f"{key}[{i}]{field and '.' + field} ({item.name})"


def _raise(found: Iterable[str]) -> None:
    lines = list(found)
    if lines:
        raise ValueError("\n".join(lines))


def _named(free: np.ndarray) -> str:
    """The motions along and about the axes that nothing holds at all, of those (6, f) that are free."""
    names = [f"{way} {axis}" for way in ("along", "about") for axis in "xyz"]
    own = [name for name, share in zip(names, (free**2).sum(axis=1)) if share > 1 - 1e-9]
    return f" (free: {', '.join(own)})" if own else ""
