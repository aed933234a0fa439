"""Checks between the tables of a scene: names that exist, parts that are held.

Each check yields one line per error, with the key, the name of the item and the remedy.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterator
from typing import Any

import numpy as np
from scipy.linalg import null_space

from mic.contact.laws import LAWS
from mic.scene.deviation import targets
from mic.scene.keys import FilePath
from mic.scene.optimisation import check_optimisation
from mic.scene.stages import CLOSING, check_stages, moves_assembly, placing_stages, unknown
from mic.system.foreign_files import reason_to_refuse, scripts_allowed

__all__ = ["entry", "find_errors", "free_motions"]

AS_IT_STANDS = "none"  # `frame` of a measurement without one
NAMED = (*CLOSING, "zones", "deviations", "measurements", "frames", "stages")  # tables of items with names


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
        check_files,
        check_parts,
        check_characteristics,
        check_targets,
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
            errors += [*check(scene)]
        except (AttributeError, KeyError, TypeError, IndexError):  # caused by invalid items
            if complete:
                raise
    return errors


def check_names(scene) -> Iterator[str]:
    """Names are unique in their table."""
    tables = {"parts": [*scene.parts, *scene.fixtures], **{key: getattr(scene, key) for key in NAMED}}
    for key, items in tables.items():
        for name, count in Counter(item.name for item in items).items():
            if count > 1:
                yield f"{key}: the name {name!r} is used more than once; give each item its own"


def check_files(scene) -> Iterator[str]:
    """Files lie in the scene's folder, or in one that the user named; geometry scripts are not refused."""
    if not scene.folder.is_absolute():
        return  # the scene of a saved model, whose files are not read any more
    for key, name in _files("", scene):
        if reason := reason_to_refuse(scene.folder / name, scene.folder):
            yield f"{key}: {name} {reason}"
        elif key.endswith(".geometry") and not scripts_allowed():
            yield f"{key}: {name} is a program, and --no-scripts refuses it; give the part a mesh file"


def _files(key: str, item: Any) -> Iterator[tuple[str, FilePath]]:
    """Key and name of each file that an item of a scene, or its members, names."""
    if isinstance(item, FilePath):
        yield key, item
    elif isinstance(item, (list, tuple)):
        for i, member in enumerate(item):
            yield from _files(f"{key}[{i}]" + (f" ({member.name})" if hasattr(member, "name") else ""), member)
    elif hasattr(item, "__dict__"):
        for name, member in vars(item).items():
            yield from _files(f"{key}.{name}".lstrip("."), member)


def _items(scene, *keys: str) -> Iterator[tuple[str, int, Any]]:
    """The items of tables, each with the key of its table and its index."""
    return ((key, i, item) for key in keys for i, item in enumerate(getattr(scene, key)))


def check_parts(scene) -> Iterator[str]:
    """Referenced parts exist, and joints connect two bodies."""
    bodies = {part.name for part in scene.parts}
    fixtures = {fixture.name for fixture in scene.fixtures}
    for key, i, item in _items(scene, "fixtures", "locators", "clamps", "measurements", "deviations"):
        if getattr(item, "part", None) is not None:
            yield from unknown(entry(key, i, item, "part"), item.part, bodies, "part")
    for key, i, item in _items(scene, "welds", "clamps", "zones"):
        if getattr(item, "parts", None) is None:
            continue  # a clamp that is no tong
        at = entry(key, i, item, "parts")
        for name in item.parts:
            yield from unknown(at, name, bodies | (fixtures if key == "zones" else set()), "part")
        if item.parts[0] == item.parts[1]:
            yield f"{at}: a part cannot be joined to itself, name two different parts"
        elif set(item.parts) <= fixtures:
            yield f"{at}: at least one of the two must be a part, not a fixture"
    for key, i, item in _items(scene, "measurements"):
        if getattr(item, "to", None) is not None:
            yield from unknown(entry(key, i, item, "to.part"), item.to.part, bodies, "part")


def check_characteristics(scene) -> Iterator[str]:
    """Measurements of a best fit and frames exist; a required accuracy has something to vary and to measure."""
    if scene.monte_carlo.accuracy is not None:
        yield from _accuracy_errors(scene, set(scene.monte_carlo.accuracy.required))
    measured = {item.name for item in scene.measurements}
    for key, i, item in _items(scene, "measurements"):
        for name in getattr(item, "best_fit", None) or ():
            yield from unknown(entry(key, i, item, "best_fit"), name, measured, "measurement")
        if getattr(item, "frame", None) is not None:
            frames = {AS_IT_STANDS, *(frame.name for frame in scene.frames)}
            yield from unknown(entry(key, i, item, "frame"), item.frame, frames, "frame")
    yield from _frame_errors(scene, measured)


def _accuracy_errors(scene, required: set[str]) -> Iterator[str]:
    """Samples can be added until a required accuracy is reached, and there is something to vary and to measure."""
    settings = scene.monte_carlo
    for given in ("table", "values"):
        if getattr(settings, given) is not None:
            yield f"monte_carlo: accuracy and {given} exclude each other; remove one of them"
    if settings.design != "independent":
        yield 'monte_carlo: accuracy adds samples one by one and needs design = "independent"; remove one of them'
    if not scene.deviations or (required - {"slip"} and not scene.measurements):
        yield "monte_carlo.accuracy: it needs measurements and deviations; add them, or remove it"
    if "slip" in required and not scene.zones:
        yield "monte_carlo.accuracy.slip: the scene has no contact zone; add one, or remove slip"
    elif "slip" in required and not scene.reads_slip:
        yield "monte_carlo.accuracy.slip: nothing slips without friction; set slip = true under [report], or remove it"


def _frame_errors(scene, measured: set[str]) -> Iterator[str]:
    """Points of frames exist, and at most one frame is for all measurements."""
    bodies, located = {part.name for part in scene.parts}, {item.name for item in scene.locators}
    for key, i, frame in _items(scene, "frames"):
        at = entry(key, i, frame, "points")
        for point in frame.points or ():
            if not isinstance(point, str):
                yield from unknown(at, point.part, bodies, "part")
                if point.name in measured | located:
                    yield f"{at}: a measurement or locator is called {point.name!r}, too; rename one of them"
            elif point in measured and point in located:
                yield f"{at}: {point!r} is a measurement and a locator; rename one of them"
            else:
                yield from unknown(at, point, measured | located, "measurement or locator")
        if frame.name == AS_IT_STANDS:
            yield f"{entry(key, i, frame, 'name')}: this name means no frame; give another"
        if frame.all and any(other.all for other in scene.frames[:i]):
            yield f"{entry(key, i, frame, 'all')}: another frame is for all measurements; leave all out of one of them"


def check_targets(scene) -> Iterator[str]:
    """Targets of deviations exist, and no thickness is varied twice."""
    thickness_of: dict[str, str] = {}  # deviation by part
    for key, i, item in _items(scene, "deviations"):
        if item.kind == "thickness" and thickness_of.setdefault(item.part, item.name) != item.name:
            at, other = entry(key, i, item, "part"), thickness_of[item.part]
            yield f"{at}: the thickness of {item.part!r} is varied by {other!r} already; merge the two"
        if getattr(item, "moves", None) is not None:
            known = {target.name for target in getattr(scene, item.moves)}
            for name in targets(item):
                yield from unknown(entry(key, i, item, "target"), name, known, item.moves.removesuffix("s"))


#: Keys of a zone that some laws need beyond a coefficient, by `mic.contact.laws.Law.reads`.
LAW_KEYS = {"pressure": ("friction_table", "friction_power"), "compliance": ("tangential_stiffness",)}


def check_friction(scene) -> Iterator[str]:
    """Friction by stage names existing stages, and each law has the keys that it needs in some zone."""
    stages = {"default", *(stage.name for stage in scene.stages)}
    for key, i, zone in _items(scene, "zones"):
        for name in zone.friction if isinstance(zone.friction, dict) else ():
            yield from unknown(entry(key, i, zone, "friction"), name, stages, "stage")
    for law in scene.report.laws:
        keys = LAW_KEYS.get(LAWS[law].reads, ())
        if keys and all(getattr(zone, key) is None for zone in scene.zones for key in keys):
            yield (
                f"report.laws: no zone has {' or '.join(keys)}, without which {law} is Coulomb's law; add it to a "
                'zone, or use "coulomb"'
            )


def check_stations(scene) -> Iterator[str]:
    """Gravity acts in stages that place parts or the assembly."""
    stations = [str(stage.name) for stage in scene.stages if stage is scene.stages[0] or moves_assembly(scene, stage)]
    for key, i, item in _items(scene, "deviations"):
        if item.kind == "gravity" and item.stage is not None and item.stage not in stations:
            at = entry(key, i, item, "stage")
            yield f"{at}: no part is placed in {item.stage!r}; name one of {', '.join(stations)}"


def check_correlations(scene) -> Iterator[str]:
    """Correlated deviations exist, are single variables, and are in one table of correlations."""
    deviations = {item.name: item for item in scene.deviations}
    seen = set()
    for i, table in enumerate(scene.correlations):
        at = f"correlations[{i}].deviations"
        for name in table.deviations:
            yield from unknown(at, name, deviations, "deviation")
            item = deviations.get(name)
            if item is not None and (item.several or getattr(item, "scores", None) is not None):
                yield f"{at}: {name!r} stands for several modes, which are uncorrelated; remove it"
            if name in seen:
                yield f"{at}: {name!r} is given twice; put all deviations that correlate with it into one matrix"
            seen.add(name)


def check_stiffness(scene) -> Iterator[str]:
    """The stiffness of other shapes needs parts of finite elements with constant thickness."""
    if scene.stiffness in ("nominal", "auto"):
        return
    for table, i, part in _items(scene, "parts"):
        for key in ("stiffness", "compliance"):
            if getattr(part, key) is not None:
                at = entry(table, i, part, key)
                yield f'{at}: a given matrix does not depend on the shape; set stiffness = "nominal" for the scene'
    needs = 'stiffness = "nominal"'
    for key, i, item in _items(scene, "deviations"):
        if item.kind == "thickness":
            yield f"{entry(key, i, item)}: it needs {needs} for the scene; remove one of them"
    if scene.report.fields:
        yield f"report.fields: fields need {needs}; remove one of them"
    if scene.optimise is not None:
        yield f"optimise: it needs {needs}; remove one of them"


def check_positions(scene) -> Iterator[str]:
    """Items of `report.positions` exist, and are not in holes."""
    for i, position in enumerate(scene.report.positions):
        kind, dot, name = position.partition(".")
        items = {item.name: item for item in getattr(scene, kind)} if kind in CLOSING else {}
        # Jaws of a tong: NAME-PART.
        jaws = {f"{item.name}-{part}" for item in items.values() for part in getattr(item, "parts", None) or ()}
        if kind not in CLOSING or (dot and name not in items and name not in jaws):
            known = [*CLOSING, *(f"{table}.{item.name}" for table, _, item in _items(scene, *CLOSING))]
            yield f"report.positions[{i}]: there is no {position!r}; known: {', '.join(known)}"
        elif dot and getattr(items.get(name), "hole", None) is not None:
            yield f"report.positions[{i}]: {position!r} is in a hole and cannot move by itself; remove it"


def check_held(scene) -> Iterator[str]:
    """Every part has six independent locators when it is placed, or rests in a zone.

    Parts whose locators have no coordinates yet are checked after placement; :mod:`mic.process.free_motions` checks
    whether contact can hold a part that rests.
    """
    stations = placing_stages(scene)
    touching = {name for zone in scene.zones for name in zone.parts}
    for i, part in enumerate(scene.parts):
        if part.rests:
            if part.name not in touching:
                yield f"parts[{i}].rests ({part.name}): it is in no zone, so nothing supports it; add a zone"
            continue
        stage = stations[part.name]
        locators = [locator for locator in scene.locators if locator.part == part.name and locator.stage == stage]
        if any(locator.point is None or isinstance(locator.direction, str) for locator in locators):
            continue  # checked after placement
        free = np.eye(6)
        if locators:
            points = np.array([locator.point for locator in locators])
            arms = (points - points.mean(0)) / max(1.0, float(np.ptp(points, axis=0).max()))
            directions = np.array([locator.direction for locator in locators])
            free = null_space(np.hstack([directions, np.cross(arms, directions)]), rcond=1e-6)
        held = 6 - free.shape[1]
        if held < 6:
            yield (
                f"parts[{i}] ({part.name}): its {len(locators)} locators of the locate stage hold {held} of its 6 "
                f"rigid-body motions{free_motions(free)}; add locators (at least a 3-2-1 scheme) until all six are "
                "held; if it rests on another part, set rests = true and add a zone between the two"
            )


def entry(key: str, i: int, item, field: str = "") -> str:
    """Location of an item in the scene, with its name: ``locators[3].part (A4)``."""
    return f"{key}[{i}]{field and '.' + field} ({item.name})"


def free_motions(free: np.ndarray) -> str:
    """The motions along and about the axes that are completely free, in a basis (6, f) of the free motions."""
    names = [f"{kind} {axis}" for kind in ("along", "about") for axis in "xyz"]
    axes = [name for name, share in zip(names, (free**2).sum(axis=1)) if share > 1 - 1e-9]
    return f" (free: {', '.join(axes)})" if axes else ""
