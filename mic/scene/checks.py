"""What no single table of a scene can know: names that exist, parts that are held."""

from __future__ import annotations

import numpy as np

from mic.contact.laws import LAWS
from mic.scene.stages import check_stages, known, set_down_in

__all__ = ["check_held", "check_references"]


def check_references(scene) -> None:
    """Every name that the scene uses exists, and its stages make a process.

    Raises
    ------
    ValueError
        Naming the key and the remedy.
    """
    part_names = _unique("parts", scene.parts + scene.fixtures)
    bodies = {part.name for part in scene.parts}
    for key in ("locators", "clamps", "welds", "zones", "deviations", "measurements"):
        _unique(key, getattr(scene, key))
    _unique("stages", scene.stages)
    for key in ("locators", "clamps", "measurements", "deviations"):
        for i, item in enumerate(getattr(scene, key)):
            if getattr(item, "part", None) is not None:
                known(f"{key}[{i}].part", item.part, bodies, "part")
    tongs = [(i, clamp) for i, clamp in enumerate(scene.clamps) if clamp.parts is not None]
    for key, allowed, items in (
        ("welds", bodies, enumerate(scene.welds)),
        ("clamps", bodies, tongs),
        ("zones", part_names, enumerate(scene.zones)),
    ):
        for i, item in items:
            for name in item.parts:
                known(f"{key}[{i}].parts", name, allowed, "part")
            if item.parts[0] == item.parts[1]:
                raise ValueError(f"{key}[{i}].parts: a part cannot be joined to itself, name two different parts")
            if not bodies & set(item.parts):
                raise ValueError(f"{key}[{i}].parts: at least one of the two must be a part, not a fixture")
    for i, item in enumerate(scene.deviations):
        if item.moves is not None:
            targets = {target.name for target in getattr(scene, item.moves)}
            for name in [item.target] if isinstance(item.target, str) else item.target:
                known(f"deviations[{i}].target", name, targets, item.moves.removesuffix("s"))
    check_stages(scene)
    _check_friction(scene)


#: Keys of a zone that give a law what it reads beyond a coefficient (`mic.contact.laws.Law.reads`).
READ = {"pressure": ("friction_table", "friction_power"), "compliance": ("tangential_stiffness",)}


def _check_friction(scene) -> None:
    """Friction by stage names stages, and no law asks in vain for what a zone may give it."""
    stages = {stage.name for stage in scene.stages}
    for i, zone in enumerate(scene.zones):
        for name in zone.friction if isinstance(zone.friction, dict) else ():
            if name != "default":
                known(f"zones[{i}].friction", name, stages, "stage")
    for law in scene.report.laws:
        keys = READ.get(LAWS[law].reads, ())
        if keys and all(getattr(zone, key) is None for zone in scene.zones for key in keys):
            raise ValueError(
                f"report.laws: no zone has {' or '.join(keys)}, without which {law} is Coulomb's law; give it in a "
                'zone, or ask for "coulomb"'
            )


def check_held(scene) -> None:
    """Every part needs six independent locators when it is set down, before anything can be computed.

    Of a part whose locators are not placed yet nothing is said.

    Raises
    ------
    ValueError
        Naming the part and how many of its motions are held.
    """
    stations = set_down_in(scene)
    for i, part in enumerate(scene.parts):
        stage = stations[part.name]
        own = [locator for locator in scene.locators if locator.part == part.name and locator.stage == stage]
        if any(locator.point is None or isinstance(locator.direction, str) for locator in own):
            continue  # told once the scene is placed on its meshes
        points = np.array([locator.point for locator in own]).reshape(-1, 3)
        scale = max(1.0, float(np.ptp(points, axis=0).max(initial=0.0)))
        arms = (points - points.mean(0)) / scale if len(own) else points
        rows = np.array([[*locator.direction, *np.cross(arm, locator.direction)] for locator, arm in zip(own, arms)])
        rank = np.linalg.matrix_rank(rows, tol=1e-6) if len(own) else 0
        if rank < 6:
            raise ValueError(
                f"parts[{i}] ({part.name}): its {len(own)} locators of the locate stage hold {rank} of its 6 "
                "rigid-body motions; add locators (at least a 3-2-1 scheme) until all six are held"
            )


def _unique(key, items):
    names = [item.name for item in items]
    for name in names:
        if names.count(name) > 1:
            raise ValueError(f"{key}: the name {name!r} stands more than once; give each its own")
    return set(names)
