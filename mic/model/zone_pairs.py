"""Contact pairs of the zones, and the places where clamps, welds and locators press their bodies together."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from typing import Any

import numpy as np

from mic.errors import Problems, SceneError
from mic.geometry.coincident_sheets import refuse_coincident
from mic.geometry.pairing import ContactPair, PressedPoint, Side, find_pairs, node_pairs, pair_at
from mic.scene import Scene
from mic.scene.checks import entry

__all__ = ["landmarks", "pressed_places", "zone_pairs"]

OPPOSED = 0.5  # cosine of the angle between a clamp and a locator: above it they press on one line


def landmarks(scene: Scene) -> np.ndarray:
    """(n, 3) points of the locators in the order of their names, mm: they anchor the pattern of contact pairs."""
    return np.array([locator.point for locator in _by_name(scene.locators)]).reshape(-1, 3)


def _by_name(items: Iterable[Any]) -> list[Any]:
    """Items in an order that does not depend on that of the scene file."""
    return sorted(items, key=lambda item: item.name)


def zone_pairs(
    scene: Scene, bodies: Mapping[str, Side], pressed: list[list[PressedPoint]], every_node: bool, problems: Problems
) -> list[list[ContactPair]]:
    """The contact pairs of each zone, none for a zone with an error; an empty list if no stage resolves contact.

    Parameters
    ----------
    scene : Scene
    bodies : mapping of str to Side
        Parts and fixtures by name.
    pressed : list
        Pressed points of each zone.
    every_node : bool
        Whether every mesh vertex in the zones becomes a candidate.
    problems : Problems
        Collects errors.
    """
    pairs: list[list[ContactPair]] = []
    if all(stage.kind == "locate" for stage in scene.stages):
        return pairs
    for i, (zone, places) in enumerate(zip(scene.zones, pressed)):
        first, second = (bodies[name] for name in zone.parts)
        pairs.append([])
        with problems:
            try:
                if every_node:
                    found = node_pairs(zone, first, second, places)
                else:
                    found = find_pairs(zone, first, second, landmarks(scene), places)
            except ValueError as error:
                raise SceneError(f"{entry('zones', i, zone)}: {error}") from None
            refuse_coincident(entry("zones", i, zone), zone.parts, found, first, second)
            pairs[-1] = found
    return pairs


def pressed_places(scene: Scene, zone, bodies: Mapping[str, Side]) -> list[PressedPoint]:
    """Places where clamps, welds and locators press the two bodies of a zone together.

    A clamp, and a locator that backs one, also presses through other sheets: it counts if it stands over the zone
    with only touching sheets in between.
    """
    stacked = _stacked_parts(scene, zone, bodies)
    clamps, places = [], []
    for clamp in _by_name(scene.clamps):
        point = _projected_point(clamp, zone, bodies, stacked)
        if point is not None:
            clamps.append(clamp)
            places.append(PressedPoint(point, clamp.radius))
    for i, weld in enumerate(scene.welds):
        if set(weld.parts) == set(zone.parts):
            places.append(PressedPoint(np.array(weld.point), weld.radius, i, _weld_normal(zone, weld, bodies)))
    for locator in _by_name(scene.locators):
        point = _projected_point(locator, zone, bodies, stacked)
        if point is not None:
            backed = _backed_radius(locator, clamps)
            if backed or locator.part in zone.parts:
                places.append(PressedPoint(point, locator.radius if backed else 0.0, backed_radius=backed))
    return places


def _stacked_parts(scene, zone, bodies) -> dict[str, tuple[str, float]]:
    """Parts that zones connect to a body of this zone: by name that body, and the largest distance between the two
    mid-surfaces, mm."""
    reached = {name: (name, 0.0) for name in zone.parts if not bodies[name].rigid}
    for _ in scene.parts:
        for other in scene.zones:
            if any(bodies[name].rigid for name in other.parts):
                continue  # a fixture transmits nothing to further sheets
            step = other.max_gap + sum(bodies[name].half_thickness for name in other.parts)
            for near, far in (other.parts, other.parts[::-1]):
                if near in reached and reached[near][1] + step < reached.get(far, ("", np.inf))[1]:
                    reached[far] = (reached[near][0], reached[near][1] + step)
    return {name: body for name, body in reached.items() if name not in zone.parts}


def _projected_point(item, zone, bodies, stacked) -> np.ndarray | None:
    """The point of a clamp or locator, moved along its direction to the body of the zone that it presses, or None."""
    point = np.array(item.point)
    if item.part in zone.parts:
        return point
    name, farthest = stacked.get(item.part, ("", 0.0))
    if not name or not item.radius:
        return None
    box = bodies[name].surface.box
    if np.linalg.norm(np.maximum(0.0, np.maximum(box[0] - point, point - box[1]))) > item.radius + farthest:
        return None  # too far, however it is projected
    direction = np.array(item.direction) / np.linalg.norm(item.direction)
    steps = [bodies[body].surface.project(point).point[0] - point for body in (name, *zone.parts)]
    axial = [step @ direction for step in steps]
    lateral = [np.linalg.norm(step - length * direction) for step, length in zip(steps, axial)]
    return point + axial[0] * direction if max(lateral) < item.radius and abs(axial[0]) <= farthest else None


def _backed_radius(locator, clamps) -> float:
    """Largest radius of the clamps that a locator backs: they press on one line and their pads overlap; else 0."""
    radius = 0.0
    for clamp in clamps:
        direction = np.array(clamp.direction) / np.linalg.norm(clamp.direction)
        step = np.array(locator.point) - np.array(clamp.point)
        lateral = np.linalg.norm(step - (step @ direction) * direction)
        opposed = abs(direction @ locator.direction) > OPPOSED * np.linalg.norm(locator.direction)
        if locator.radius and opposed and lateral < clamp.radius + locator.radius:
            radius = max(radius, clamp.radius)
    return radius


def _weld_normal(zone, weld, bodies) -> np.ndarray | None:
    """Normal at a weld from the zone's first body to its second; None if the weld does not find both bodies."""
    try:
        pair = pair_at(weld.point, weld.radius, *(bodies[name] for name in weld.parts))
    except ValueError:
        return None  # the rows of the weld report this error
    return pair.frame[:, 0] if weld.parts[0] == zone.parts[0] else -pair.frame[:, 0]
