"""Checks between the tables of a scene: names that exist, parts that are held."""

from __future__ import annotations

from collections import Counter

import numpy as np
from scipy.linalg import null_space

from mic.contact.laws import LAWS
from mic.scene.optimisation import check_optimisation
from mic.scene.stages import check_known, check_stages, error_lines, moves_assembly, placing_stages, raise_errors

__all__ = ["entry", "find_errors"]

MOVING = ("welds", "locators", "clamps")  # tables of items whose position in the sheet may be an input
NAMED = ("locators", "clamps", "welds", "zones", "deviations", "measurements", "stages")  # tables of items with names


def find_errors(scene, complete: bool = True) -> list[str]:
    """All errors between the scene's tables: unknown names, impossible stages, parts that are not held.

    Parameters
    ----------
    scene : mic.scene.schema.Scene
    complete : bool
        Whether every item is valid. Else numbers are not checked, and checks that fail on invalid items are skipped.

    Returns
    -------
    list of str
        One line per error, with the key, the name of the item and the remedy.
    """
    errors: list[str] = []
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
        *(check_held,) * complete,
    ):
        try:
            errors += error_lines(check, scene)
        except (AttributeError, KeyError, TypeError, IndexError):  # caused by invalid items
            if complete:
                raise
    return errors


def check_names(scene) -> None:
    """Names are unique in their table.

    Raises
    ------
    ValueError
        Here as below, one line per error, with the key and the remedy.
    """
    raise_errors(
        f"{key}: the name {name!r} is used more than once; give each item its own"
        for key, items in (
            ("parts", [*scene.parts, *scene.fixtures]),
            *((key, getattr(scene, key)) for key in NAMED),
        )
        for name, count in Counter(item.name for item in items).items()
        if count > 1
    )


def check_references(scene) -> None:
    """Referenced parts, locators, clamps and measurements exist, and joints connect two bodies."""
    bodies = {part.name for part in scene.parts}
    with_fixtures = bodies | {fixture.name for fixture in scene.fixtures}
    errors = []
    for key in ("fixtures", "locators", "clamps", "measurements", "deviations"):
        for i, item in enumerate(getattr(scene, key)):
            if getattr(item, "part", None) is not None:
                errors += error_lines(check_known, entry(key, i, item, "part"), item.part, bodies, "part")
    for key, allowed in (("welds", bodies), ("clamps", bodies), ("zones", with_fixtures)):
        for i, item in enumerate(getattr(scene, key)):
            if getattr(item, "parts", None) is None:
                continue  # a clamp that is no tong
            at = entry(key, i, item, "parts")
            errors += [line for name in item.parts for line in error_lines(check_known, at, name, allowed, "part")]
            if item.parts[0] == item.parts[1]:
                errors.append(f"{at}: a part cannot be joined to itself, name two different parts")
            elif set(item.parts) <= with_fixtures - bodies:
                errors.append(f"{at}: at least one of the two must be a part, not a fixture")
    if scene.monte_carlo.accuracy is not None and not (scene.measurements and scene.deviations):
        errors.append("monte_carlo.accuracy: it needs measurements and deviations; add them, or remove it")
    measured = {item.name for item in scene.measurements}
    for i, item in enumerate(scene.measurements):
        if getattr(item, "to", None) is not None:
            errors += error_lines(check_known, entry("measurements", i, item, "to.part"), item.to.part, bodies, "part")
        for name in getattr(item, "best_fit", None) or ():
            errors += error_lines(
                check_known, entry("measurements", i, item, "best_fit"), name, measured, "measurement"
            )
    thickness_of: dict[str, str] = {}  # deviation by part
    for i, item in enumerate(scene.deviations):
        if item.kind == "thickness" and thickness_of.setdefault(item.part, item.name) != item.name:
            at, other = entry("deviations", i, item, "part"), thickness_of[item.part]
            errors.append(f"{at}: the thickness of {item.part!r} is varied by {other!r} already; merge the two")
        if getattr(item, "moves", None) is not None:
            targets = {target.name for target in getattr(scene, item.moves)}
            at = entry("deviations", i, item, "target")
            for name in [item.target] if isinstance(item.target, str) else item.target:
                errors += error_lines(check_known, at, name, targets, item.moves.removesuffix("s"))
    raise_errors(errors)


#: Keys of a zone that some laws need beyond a coefficient, by `mic.contact.laws.Law.reads`.
LAW_KEYS = {"pressure": ("friction_table", "friction_power"), "compliance": ("tangential_stiffness",)}


def check_friction(scene) -> None:
    """Friction by stage names existing stages, and each law has the keys that it needs in some zone."""
    stages = {stage.name for stage in scene.stages}
    errors = []
    for i, zone in enumerate(scene.zones):
        for name in zone.friction if isinstance(zone.friction, dict) else ():
            if name != "default":
                errors += error_lines(check_known, entry("zones", i, zone, "friction"), name, stages, "stage")
    for law in scene.report.laws:
        keys = LAW_KEYS.get(LAWS[law].reads, ())
        if keys and all(getattr(zone, key) is None for zone in scene.zones for key in keys):
            errors.append(
                f"report.laws: no zone has {' or '.join(keys)}, without which {law} is Coulomb's law; add it to a "
                'zone, or use "coulomb"'
            )
    raise_errors(errors)


def check_stations(scene) -> None:
    """Gravity acts in stages that place parts or the assembly."""
    stations = [str(stage.name) for stage in scene.stages if stage is scene.stages[0] or moves_assembly(scene, stage)]
    errors = []
    for i, item in enumerate(scene.deviations):
        if item.kind == "gravity" and item.stage is not None and item.stage not in stations:
            errors.append(
                f"{entry('deviations', i, item, 'stage')}: no part is placed in {item.stage!r}; name one of "
                f"{', '.join(stations)}"
            )
    raise_errors(errors)


def check_correlations(scene) -> None:
    """Correlated deviations exist, are single variables, and are in one table of correlations."""
    kinds = {item.name: item for item in scene.deviations}
    errors, seen = [], set()
    for i, table in enumerate(scene.correlations):
        for name in table.deviations:
            at = f"correlations[{i}].deviations"
            errors += error_lines(check_known, at, name, kinds, "deviation")
            item = kinds.get(name)
            if item is not None and (item.several or getattr(item, "scores", None) is not None):
                errors.append(f"{at}: {name!r} stands for several modes, which are uncorrelated; remove it")
            if name in seen:
                errors.append(
                    f"{at}: {name!r} is given twice; put all deviations that correlate with it into one matrix"
                )
            seen.add(name)
    raise_errors(errors)


def check_stiffness(scene) -> None:
    """The stiffness of other shapes needs parts of finite elements with constant thickness."""
    if scene.stiffness == "nominal":
        return
    errors = []
    for i, part in enumerate(scene.parts):
        for key in ("stiffness", "compliance"):
            if getattr(part, key) is not None:
                at = entry("parts", i, part, key)
                errors.append(
                    f'{at}: a given matrix does not depend on the shape; set stiffness = "nominal" for the scene'
                )
    for i, item in enumerate(scene.deviations):
        if item.kind == "thickness":
            at = entry("deviations", i, item)
            errors.append(f'{at}: it needs stiffness = "nominal" for the scene; remove one of them')
    if scene.report.fields:
        errors.append('report.fields: fields need stiffness = "nominal"; remove one of them')
    if scene.optimise is not None:
        errors.append('optimise: it needs stiffness = "nominal"; remove one of them')
    raise_errors(errors)


def check_positions(scene) -> None:
    """Items of `report.positions` exist, and are not in holes."""
    errors = []
    for i, position in enumerate(scene.report.positions):
        kind, dot, name = position.partition(".")
        items = {item.name: item for item in getattr(scene, kind)} if kind in MOVING else {}
        # Jaws of a tong: NAME-PART.
        jaws = {f"{item.name}-{part}" for item in items.values() for part in getattr(item, "parts", None) or ()}
        if kind not in MOVING or (dot and name not in items and name not in jaws):
            known = [f"{table}.{item.name}" for table in MOVING for item in getattr(scene, table)]
            errors.append(f"report.positions[{i}]: there is no {position!r}; known: {', '.join([*MOVING, *known])}")
        elif dot and getattr(items.get(name), "hole", None) is not None:
            errors.append(f"report.positions[{i}]: {position!r} is in a hole and cannot move by itself; remove it")
    raise_errors(errors)


def check_held(scene) -> None:
    """Every part has six independent locators when it is placed, or rests in a zone.

    Parts whose locators have no coordinates yet are checked after placement; :mod:`mic.process.free_motions` checks
    whether contact can hold a part that rests.
    """
    errors, stations = [], placing_stages(scene)
    touching = {name for zone in scene.zones for name in zone.parts}
    for i, part in enumerate(scene.parts):
        if part.rests:
            if part.name not in touching:
                errors.append(f"parts[{i}].rests ({part.name}): it is in no zone, so nothing supports it; add a zone")
            continue
        stage = stations[part.name]
        locators = [locator for locator in scene.locators if locator.part == part.name and locator.stage == stage]
        if any(locator.point is None or isinstance(locator.direction, str) for locator in locators):
            continue  # checked after placement
        free = np.eye(6)
        if locators:
            points = np.array([locator.point for locator in locators])
            arms = (points - points.mean(0)) / max(1.0, float(np.ptp(points, axis=0).max()))
            rows = np.array(
                [[*locator.direction, *np.cross(arm, locator.direction)] for locator, arm in zip(locators, arms)]
            )
            free = null_space(rows, rcond=1e-6)
        held = 6 - free.shape[1]
        if held < 6:
            errors.append(
                f"parts[{i}] ({part.name}): its {len(locators)} locators of the locate stage hold {held} of its 6 "
                f"rigid-body motions{_named(free)}; add locators (at least a 3-2-1 scheme) until all six are held; "
                "if it rests on another part, set rests = true and add a zone between the two"
            )
    raise_errors(errors)


def entry(key: str, i: int, item, field: str = "") -> str:
    """Location of an item in the scene, with its name: ``locators[3].part (A4)``."""
    return f"{key}[{i}]{field and '.' + field} ({item.name})"


def _named(free: np.ndarray) -> str:
    """The motions along and about the axes that are completely free, in a basis (6, f) of the free motions."""
    names = [f"{kind} {axis}" for kind in ("along", "about") for axis in "xyz"]
    axes = [name for name, share in zip(names, (free**2).sum(axis=1)) if share > 1 - 1e-9]
    return f" (free: {', '.join(axes)})" if axes else ""
