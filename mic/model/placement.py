"""Where a scene's items stand, once the surfaces of its parts are known.

A scene may say where something stands by a node, a set of nodes or a hole, and in which direction it acts by words:

- ``node``: that point of the surface. ``set``: the mean of its points, projected onto the surface. Both by the names of
  the part's own mesh file; of a weld or a tong those of its first part.
- ``hole``: the centre of the nearest rim, of which rows read the mean (:mod:`mic.geometry.holes`).
- ``normal``: n, the sheet's normal there, on the side that its triangles have; of a hole that of its plane.
  ``in-plane x``: ``x − (x · n) n``, made a unit vector. With a minus before it, the other way.
- a clamp with ``parts`` is a tong: jaws at one point, pushing along n, from its first part to its second, and −n.
- a pad with ``part`` touches the skin that it looks at: with ν its outward normal, x on the middle of the sheet and s
  the sign of ν · n, its centre is ``x − s t/2 n``.

Everything after this sees points and directions as vectors, and single clamps.
"""

from __future__ import annotations

import difflib
from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np

from mic.errors import SceneError
from mic.geometry.deck import Deck
from mic.geometry.holes import Hole, find_holes
from mic.geometry.measured_points import spread
from mic.geometry.pairing import Side, pair_at
from mic.geometry.surface import Surface
from mic.model.rows import REACH
from mic.scene import Scene
from mic.scene.checks import problems
from mic.scene.deviation import ClampDeviation
from mic.scene.keys import NORMAL
from mic.scene.measurement import Measurement

__all__ = ["place"]

ALONG = 0.1  # of an axis that is laid into a sheet, at least so much must lie in it
APART = 0.1  # mm: between the two points of a characteristic whose direction is that of the line between them
TOGETHER = 0.5  # cosine between a tong's direction and the normal from its first part to its second, at least
LONGEST = 60  # letters of a name


def place(
    scene: Scene, surfaces: Mapping[str, Surface], decks: Mapping[str, Deck | None]
) -> tuple[Scene, tuple[str, ...]]:
    """Put a scene's items where it says.

    Parameters
    ----------
    scene : Scene
        As it is written. One that is placed is returned as it is.
    surfaces : mapping of str to Surface
        Of the parts, by name.
    decks : mapping of str to Deck or None
        What the parts' mesh files tell; None for a part that has none.

    Returns
    -------
    scene : Scene
        With every point and direction a vector, tongs as two clamps.
    sentences : tuple of str
        What was found for each node, set, hole, tong and pad.

    Raises
    ------
    SceneError
        A line for every node, set, hole or direction that is not there, with the nearest that is; or if, once placed,
        a part is not held.
    """
    work = _Placing(scene, surfaces, decks)
    changes: dict[str, Any] = {
        table: [new for i, item in enumerate(getattr(scene, table)) for new in work.item(f"{table}[{i}]", item)]
        for table in ("locators", "clamps", "welds", "deviations", "measurements")
    }
    changes["fixtures"] = [work.pad(f"fixtures[{i}] ({item.name})", item) for i, item in enumerate(scene.fixtures)]
    if work.problems:
        raise SceneError("\n".join(work.problems))
    changes = {table: items for table, items in changes.items() if items != getattr(scene, table)}
    if not changes:
        return scene, ()
    if work.jaws:
        changes["stages"] = [work.stage(stage) for stage in scene.stages]
        moved = changes.get("deviations", scene.deviations)
        changes["deviations"] = [work.deviation(item) for item in moved]
    placed = scene.model_copy(update=changes)
    wrong = problems(placed)
    if wrong:
        raise SceneError("\n".join(wrong))
    return placed, tuple(work.sentences)


class _Placing:
    """The items of a scene, one after the other, and what is wrong with them."""

    def __init__(self, scene: Scene, surfaces: Mapping[str, Surface], decks: Mapping[str, Deck | None]):
        self.surfaces, self.decks = surfaces, decks
        self.sides = {part.name: Side(surfaces[part.name], part.thickness) for part in scene.parts}
        self.problems: list[str] = []
        self.sentences: list[str] = []
        self.jaws: dict[str, tuple[str, ...]] = {}
        self._holes: dict[str, list[Hole]] = {}

    def item(self, key: str, item: Any) -> list[Any]:
        """What an item becomes: itself, itself with point and direction, or the two jaws of a tong."""
        if isinstance(item, Measurement) and item.kind != "point":
            try:
                return [self._characteristic(f"{key} ({item.name})", item)]
            except _Misplaced as error:
                self.problems.append(str(error))
                return [item]
        if not hasattr(item, "point"):
            return [item]
        tong = getattr(item, "parts", None) is not None and hasattr(item, "force")
        words = isinstance(getattr(item, "direction", None), str)
        hole = getattr(item, "hole", None)
        named = item.node is not None or item.set is not None or (hole is not None and hole != item.point)
        if not (tong or words or named):
            return [item]
        try:
            point, rim = self._point(f"{key} ({item.name})", item)
            if tong:
                return self._tong(f"{key} ({item.name})", item, point)
            found: dict[str, Any] = {"point": point, "node": None, "set": None}
            if rim is not None:
                found["hole"] = point
            if words:
                found["direction"] = self._direction(f"{key} ({item.name})", item, point, rim)
        except _Misplaced as error:
            self.problems.append(str(error))
            return [item]
        return [item.model_copy(update=found)]

    def pad(self, key: str, fixture: Any) -> Any:
        """A pad that is set against a part, by its own centre and normal."""
        if fixture.part is None:
            return fixture
        surface = self.surfaces[fixture.part]
        try:
            point, rim = self._point(key, fixture)
            foot = surface.project(point)
            if rim is None and foot.distance[0] > REACH:
                raise _Misplaced(
                    f"{key}.point: {_words(point)} lies {foot.distance[0]:.3g} mm off part {fixture.part!r} (at most "
                    f"{REACH:g} mm is allowed); the nearest point on it is {_words(foot.point[0])}"
                )
        except _Misplaced as error:
            self.problems.append(str(error))
            return fixture
        x, n = (foot.point[0], _normal(surface, point)) if rim is None else (rim.centre, rim.normal)
        ν = {"normal": n, "-normal": -n}[fixture.normal] if isinstance(fixture.normal, str) else fixture.normal
        side = 1.0 if np.dot(ν, n) > 0 else -1.0
        centre = x - side * self.sides[fixture.part].half_thickness * n
        self.sentences.append(f"{key}: touches {fixture.part} at {_words(centre)}, looking along {_words(ν)}")
        found = {"point": _vector(centre), "normal": _vector(ν), "part": None, "node": None, "set": None, "hole": None}
        return fixture.model_copy(update=found)

    def stage(self, stage: Any) -> Any:
        """A stage that names the jaws where it named the tong."""
        written = lambda names: [jaw for name in names for jaw in self.jaws.get(name, (name,))]
        changes: dict[str, Any] = {}
        if stage.keep is not None:
            changes["keep"] = written(stage.keep)
        if stage.order is not None:
            changes["order"] = [written(group) for group in stage.order]
        return stage.model_copy(update=changes)

    def deviation(self, item: Any) -> Any:
        """A deviation of the jaws where it was one of the tong."""
        if not isinstance(item, ClampDeviation):
            return item
        names = [item.target] if isinstance(item.target, str) else item.target
        jaws = [jaw for name in names for jaw in self.jaws.get(name, (name,))]
        return item if jaws == names else item.model_copy(update={"target": jaws})

    def _point(self, key: str, item: Any) -> tuple[tuple[float, float, float], Hole | None]:
        """Where an item stands, and the hole that it stands in."""
        part = _first_part(item)
        surface, deck = self.surfaces[part], self.decks[part]
        if item.node is not None:
            return self._node(f"{key}.node", item.node, part, surface, deck), None
        if item.set is not None:
            return self._set(f"{key}.set", item.set, part, surface, deck), None
        if getattr(item, "hole", None) is not None:
            hole = self._hole(f"{key}.hole", item.hole, part)
            return _vector(hole.centre), hole
        return item.point, None

    def _node(self, key, number, part, surface: Surface, deck: Deck | None):
        if deck is None or not len(deck.nodes):
            raise _Misplaced(f"{key}: the mesh of part {part!r} has no node numbers; give point = [x, y, z]")
        found = deck.points_of(number)
        if len(found) > 1:
            places = " and ".join(_words(surface.points[i]) for i in found[:3])
            raise _Misplaced(f"{key}: {number} stands more than once in part {part!r}, at {places}; give one as point")
        if not len(found):
            on_surface = np.flatnonzero(deck.node_points >= 0)
            near = on_surface[np.argmin(np.abs(deck.nodes[on_surface] - number))]
            raise _Misplaced(
                f"{key}: part {part!r} has no node {number} on its surface; the nearest number is {deck.nodes[near]}, "
                f"at {_words(surface.points[deck.node_points[near]])}"
            )
        point = surface.points[found[0]]
        self.sentences.append(f"{key} {number}: {_words(point)}")
        return _vector(point)

    def _set(self, key, name, part, surface: Surface, deck: Deck | None):
        sets = deck.node_sets if deck is not None else {}
        if name not in sets or not len(sets[name]):
            near = difflib.get_close_matches(name, sets, 1, cutoff=0.0)
            hint = f"the nearest name is {near[0]!r}" if near else "its mesh has no sets of nodes"
            raise _Misplaced(f"{key}: part {part!r} has no set of nodes {name!r}; {hint}")
        points = surface.points[np.unique(sets[name])]
        middle = points.mean(axis=0)
        foot = surface.project(middle)
        point, distance = foot.point[0], float(foot.distance[0])
        if distance > REACH:
            nearest = points[np.argmin(np.linalg.norm(points - middle, axis=1))]
            raise _Misplaced(
                f"{key}: the middle of the {len(points)} nodes of {name!r} lies {distance:.3g} mm off part {part!r} "
                f"(at most {REACH:g} mm is allowed); give a set that lies closer together, the rim of a hole as hole, "
                f"or a point: its node nearest to the middle is at {_words(nearest)}"
            )
        self.sentences.append(
            f"{key} {name}: {_words(point)}, the middle of {len(points)} nodes"
            + (f", moved {distance:.2g} mm onto the part" if distance > surface.tie else "")
        )
        return _vector(point)

    def _hole(self, key, near, part) -> Hole:
        if part not in self._holes:
            self._holes[part] = find_holes(self.surfaces[part])
        holes = self._holes[part]
        if not holes:
            raise _Misplaced(f"{key}: part {part!r} has no hole; give point = [x, y, z]")
        away = np.linalg.norm([hole.centre - np.array(near) for hole in holes], axis=1)
        hole = holes[int(np.argmin(away))]
        size = f"{hole.size[0]:.3g} mm across" if hole.round else f"{hole.size[0]:.3g} × {hole.size[1]:.3g} mm"
        if away.min() > hole.size[0] / 2 + REACH:
            raise _Misplaced(
                f"{key}: no hole of part {part!r} is near {_words(near)}; the nearest, {size}, has its centre at "
                f"{_words(hole.centre)}, {away.min():.3g} mm away"
            )
        self.sentences.append(
            f"{key}: {size}, its centre at {_words(hole.centre)}, {away.min():.2g} mm from what is given"
        )
        return hole

    def _direction(self, key, item, point, hole: Hole | None):
        *_, axis = words = item.direction.removeprefix("-").split()
        sign = -1.0 if item.direction.startswith("-") else 1.0
        n = hole.normal if hole is not None else _normal(self.surfaces[item.part], point)
        if len(words) == 1:
            return _vector(sign * n)
        unit = np.eye(3)["xyz".index(axis)]
        along = unit - (unit @ n) * n
        length = float(np.linalg.norm(along))
        if length < ALONG:
            others = " or ".join(f'"in-plane {other}"' for other in "xyz" if other != axis)
            raise _Misplaced(
                f"{key}.direction: {axis} stands across the sheet there, whose normal is {_words(n)}; give {others}"
            )
        return _vector(sign * along / length)

    def _characteristic(self, key: str, item: Measurement) -> Measurement:
        """A measurement of more than one point, with points and direction."""
        if item.kind in item.OVER:
            return self._over(key, item)
        assert item.to is not None  # as the schema demands of these kinds
        none = {"node": None, "set": None}
        (point, rim), (far, far_rim) = self._point(key, item), self._point(f"{key}.to", item.to)
        along = item.direction
        if item.kind == "distance" or (item.kind == "gap" and along == NORMAL):
            line = np.subtract(far, point)
            if item.kind == "gap":
                n = rim.normal if rim is not None else _normal(self.surfaces[item.part], point)
                line = line - (line @ n) * n
            length = float(np.linalg.norm(line))
            if length < APART:
                raise _Misplaced(
                    f"{key}.to: along the {'sheet' if item.kind == 'gap' else 'line between them'}, {_words(far)} and "
                    f"{_words(point)} are {length:.2g} mm apart, which tells no direction; give a gap with a direction"
                )
            along = _vector(line / length)
        elif isinstance(along, str):
            along = self._direction(key, item, point, rim)
        to = item.to.model_copy(update=none | {"point": far} | ({"hole": far} if far_rim is not None else {}))
        found = none | {"point": point, "to": to, "direction": along}
        return item.model_copy(update=found | ({"hole": point} if rim is not None else {}))

    def _over(self, key: str, item: Measurement) -> Measurement:
        """A measurement over many points, with all of them."""
        surface, points = self.surfaces[item.part], item.points
        if item.spacing is not None:
            spread_over = surface.points[spread(surface, item.spacing, item.box)]
            if len(spread_over) < 2:
                raise _Misplaced(
                    f"{key}.{'spacing' if item.box is None else 'box'}: {len(spread_over)} points of part "
                    f"{item.part!r} lie there, {item.spacing:g} mm apart; give a smaller spacing or a larger box"
                )
            points = [_vector(point) for point in spread_over]
            self.sentences.append(f"{key}: {len(points)} points on {item.part}")
        assert points is not None  # as the schema demands of these kinds
        found: dict[str, Any] = {"points": points, "spacing": None, "box": None}
        if item.kind == "parallelism" and isinstance(item.direction, str):
            found["direction"] = self._direction(key, item, np.mean(points, axis=0), None)
        return item.model_copy(update=found)

    def _tong(self, key, item, point) -> list[Any]:
        """The jaws of a tong, on each of its parts."""
        first, second = item.parts
        names = tuple(f"{item.name}-{part}" for part in item.parts)
        if max(map(len, names)) > LONGEST:
            raise _Misplaced(f"{key}.name: its jaws would be called {', '.join(names)}, which is too long; shorten it")
        for part in item.parts:
            foot = self.surfaces[part].project(point)
            if foot.distance[0] > REACH:
                raise _Misplaced(
                    f"{key}.point: {_words(point)} lies {foot.distance[0]:.3g} mm off part {part!r} (at most "
                    f"{REACH:g} mm is allowed); the nearest point on it is {_words(foot.point[0])}"
                )
        try:
            n = pair_at(point, item.radius, self.sides[first], self.sides[second]).frame[:, 0]
        except ValueError:
            raise _Misplaced(
                f"{key}.point: {first!r} and {second!r} do not face each other at {_words(point)}, so a tong cannot "
                "press them together there; move it to where they do, or give two clamps"
            ) from None
        along = n
        if not isinstance(item.direction, str):
            along = np.array(item.direction)
            if along @ n < TOGETHER:
                raise _Misplaced(
                    f"{key}.direction: {_words(along)} does not push {first!r} towards {second!r}, which lies along "
                    f"{_words(n)}; leave direction out, or turn it"
                )
        self.jaws[item.name] = names
        self.sentences.append(f"{key}: pushes {first} along {_words(along)}, and {second} against it")
        common = {"parts": None, "node": None, "set": None, "point": point}
        return [
            item.model_copy(update=common | {"name": name, "part": part, "direction": _vector(sign * along)})
            for name, part, sign in zip(names, item.parts, (1.0, -1.0))
        ]


class _Misplaced(ValueError):
    """One item that cannot be placed."""


def _first_part(item: Any) -> str:
    parts = getattr(item, "parts", None)
    return parts[0] if parts is not None else item.part


def _normal(surface: Surface, point) -> np.ndarray:
    """Unit normal of the curved sheet at a point's projection."""
    foot = surface.project(point)
    n = foot.barycentric[0] @ surface.corner_normals[foot.triangle[0]]
    return n / np.linalg.norm(n)


def _vector(x: np.ndarray) -> tuple[float, float, float]:
    a, b, c = (float(value) + 0.0 for value in x)
    return a, b, c


def _words(x: Sequence[float] | np.ndarray) -> str:
    return "(" + ", ".join(f"{round(float(value), 3) + 0.0:g}" for value in x) + ")"
