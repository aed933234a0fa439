"""Places a scene's items on the surfaces of its parts.

A scene may state a position by a node, a set of nodes or a hole, and a direction by words:

- ``node``: that point of the surface. ``set``: the mean of its points, projected onto the surface. Both are names in
  the part's own mesh file; for a weld or a tong in that of its first part.
- ``hole``: the centre of the nearest rim; rows read the mean over the rim (:mod:`mic.geometry.holes`).
- ``normal``: the sheet's normal n there, on the side of its triangles' normals; for a hole the normal of its plane.
  ``in-plane x``: ``x − (x · n) n``, normalised. A leading minus reverses the direction.
- a clamp with ``parts`` is a tong: two jaws at one point, pushing along n, from its first part to its second, and −n.
- a pad with ``part`` touches the skin that it faces: with its outward normal ν, a point x on the mid-surface and s the
  sign of ν · n, its centre is ``x − s t/2 n``.

In a placed scene all points and directions are vectors, and every clamp acts on one part.
"""

from __future__ import annotations

import difflib
from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np

from mic.errors import Problems, SceneError
from mic.geometry.deck import Deck
from mic.geometry.holes import Hole, find_holes
from mic.geometry.measured_points import spread
from mic.geometry.pairing import Side, pair_at
from mic.geometry.surface import Surface
from mic.model.rows import REACH, on_part, xyz
from mic.scene import Scene
from mic.scene.checks import entry, find_errors
from mic.scene.deviation import ClampDeviation, targets
from mic.scene.frame import Frame
from mic.scene.keys import NORMAL
from mic.scene.measurement import Measurement

__all__ = ["place"]

ALONG = 0.1  # smallest component of an axis within the sheet that gives an in-plane direction
APART = 0.1  # mm: smallest distance of two points that define a direction
TOGETHER = 0.5  # smallest cosine between a tong's direction and the normal from its first part to its second
LONGEST = 60  # letters of a name

Vector = tuple[float, float, float]


def place(
    scene: Scene, surfaces: Mapping[str, Surface], decks: Mapping[str, Deck | None], problems: Problems
) -> tuple[Scene, tuple[str, ...]]:
    """Replace nodes, sets, holes and direction words by points and vectors.

    After a problem, the scene lacks the items that could not be placed and those that refer to them, so that the others
    can be checked further.

    Parameters
    ----------
    scene : Scene
        A scene that is placed already is returned as it is.
    surfaces : mapping of str to Surface
        Of the parts, by name.
    decks : mapping of str to Deck or None
        Further content of the parts' mesh files; None for a part without one.
    problems : Problems
        Collects each :class:`SceneError`: a node, set, hole or direction that does not exist, with the nearest existing
        one; a part that is not held after placing.

    Returns
    -------
    scene : Scene
        With every point and direction a vector, and tongs as two clamps.
    messages : tuple of str
        The position of each node, set, hole, tong and pad.
    """
    work = _Placing(scene, surfaces, decks, problems)
    changes: dict[str, Any] = {
        table: [new for i, item in enumerate(getattr(scene, table)) for new in work.item(table, i, item)]
        for table in ("locators", "clamps", "welds", "deviations", "measurements", "fixtures")
    }
    changes["frames"] = [work.frame(i, frame) for i, frame in enumerate(scene.frames)]
    changes = {table: items for table, items in changes.items() if items != getattr(scene, table)}
    if not changes:
        return scene, ()
    if work.jaws:
        changes["stages"] = [work.stage(stage) for stage in scene.stages]
        changes["report"] = work.report(scene.report)
        changes["deviations"] = [work.deviation(item) for item in changes.get("deviations", scene.deviations)]
    placed = scene.model_copy(update=changes)
    if work.dropped:
        return _without_references(placed, work.dropped), tuple(work.messages)
    with problems:
        wrong = find_errors(placed)
        if wrong:
            raise SceneError("\n".join(wrong))
    return placed, tuple(work.messages)


def _without_references(scene: Scene, dropped: set[tuple[str, str]]) -> Scene:
    """The scene without what refers to dropped items, given by table and name."""
    lost = lambda table, names: any((table, name) in dropped for name in names)
    zones = [zone for zone in scene.zones if not lost("fixtures", zone.parts)]
    dropped = dropped | {("zones", zone.name) for zone in scene.zones if zone not in zones}
    deviations = [item for item in scene.deviations if item.moves is None or not lost(item.moves, targets(item))]
    return scene.model_copy(update={"zones": zones, "deviations": deviations})


class _Placing:
    """Places the items of a scene one by one, and collects errors and messages."""

    def __init__(self, scene: Scene, surfaces: Mapping[str, Surface], decks: Mapping[str, Deck | None], problems):
        self.surfaces, self.decks = surfaces, decks
        self.sides = {part.name: Side(surfaces[part.name], part.thickness) for part in scene.parts}
        self.problems = problems
        self.dropped: set[tuple[str, str]] = set()  #: table and name of items that could not be placed
        self.messages: list[str] = []
        self.jaws: dict[str, tuple[str, ...]] = {}
        self._holes: dict[str, list[Hole]] = {}

    def item(self, table: str, i: int, item: Any) -> list[Any]:
        """The placed item, or the two jaws of a tong; after an error nothing."""
        at = entry(table, i, item)
        with self.problems:
            if table == "fixtures":
                return [self._pad(at, item)]
            if isinstance(item, Measurement) and item.kind != "point":
                return [self._characteristic(at, item)]
            if not hasattr(item, "point"):
                return [item]
            tong = getattr(item, "parts", None) is not None and hasattr(item, "force")
            words = isinstance(getattr(item, "direction", None), str)
            hole = getattr(item, "hole", None)
            named = item.node is not None or item.set is not None or (hole is not None and hole != item.point)
            if not (tong or words or named):
                return [item]
            point, rim = self._point(at, item)
            if tong:
                return self._tong(at, item, point)
            changes = _position(point, rim)
            if words:
                changes["direction"] = self._direction(at, item, point, rim)
            return [item.model_copy(update=changes)]
        self.dropped.add((table, item.name))
        return []

    def frame(self, i: int, frame: Frame) -> Frame:
        """A frame with its own points placed."""
        placed = lambda point: [point] if isinstance(point, str) else self.item("frames", i, point)
        points = None if frame.points is None else [new for point in frame.points for new in placed(point)]
        return frame.model_copy(update={"points": points})

    def _pad(self, key: str, fixture: Any) -> Any:
        """A pad that touches a part, with its own centre and normal."""
        if fixture.part is None:
            return fixture
        point, rim = self._point(key, fixture)
        surface = self.surfaces[fixture.part]
        x = rim.centre if rim is not None else on_part(f"{key}.point", fixture.part, surface, point).point[0]
        n = self._sheet_normal(fixture.part, point, rim)
        ν = {"normal": n, "-normal": -n}[fixture.normal] if isinstance(fixture.normal, str) else fixture.normal
        side = 1.0 if np.dot(ν, n) > 0 else -1.0
        centre = _vector(x - side * self.sides[fixture.part].half_thickness * n)
        self.messages.append(f"{key}: touches {fixture.part} at {xyz(centre)}, facing along {xyz(ν)}")
        changes = {"point": centre, "normal": _vector(ν), "part": None, "node": None, "set": None, "hole": None}
        return fixture.model_copy(update=changes)

    def _jaw_names(self, names: Sequence[str]) -> list[str]:
        """The names with every tong replaced by its jaws."""
        return [jaw for name in names for jaw in self.jaws.get(name, (name,))]

    def stage(self, stage: Any) -> Any:
        """A stage that names jaws instead of tongs."""
        keep = None if stage.keep is None else self._jaw_names(stage.keep)
        order = None if stage.order is None else [self._jaw_names(group) for group in stage.order]
        return stage.model_copy(update={"keep": keep, "order": order})

    def report(self, report: Any) -> Any:
        """Requested results of the jaws instead of the tong."""
        jaws = {f"clamps.{tong}": [f"clamps.{jaw}" for jaw in both] for tong, both in self.jaws.items()}
        positions = [name for given in report.positions for name in jaws.get(given, [given])]
        return report.model_copy(update={"positions": positions})

    def deviation(self, item: Any) -> Any:
        """A deviation of the jaws instead of the tong."""
        if not isinstance(item, ClampDeviation):
            return item
        names = targets(item)
        jaws = self._jaw_names(names)
        return item if jaws == names else item.model_copy(update={"target": jaws})

    def _point(self, key: str, item: Any) -> tuple[Vector, Hole | None]:
        """The point of an item, and the hole that it is in."""
        parts = getattr(item, "parts", None)
        part = parts[0] if parts is not None else item.part
        surface, deck = self.surfaces[part], self.decks[part]
        if item.node is not None:
            return self._node(f"{key}.node", item.node, part, surface, deck), None
        if item.set is not None:
            return self._set(f"{key}.set", item.set, part, surface, deck), None
        if getattr(item, "hole", None) is not None:
            hole = self._hole(f"{key}.hole", item.hole, part)
            return _vector(hole.centre), hole
        return item.point, None

    def _node(self, key, number, part, surface: Surface, deck: Deck | None) -> Vector:
        if deck is None or not len(deck.nodes):
            raise SceneError(f"{key}: the mesh of part {part!r} has no node numbers; give point = [x, y, z]")
        matches = deck.points_of(number)
        if len(matches) > 1:
            places = " and ".join(xyz(surface.points[i]) for i in matches[:3])
            raise SceneError(f"{key}: {number} occurs more than once in part {part!r}, at {places}; give one as point")
        if not len(matches):
            on_surface = np.flatnonzero(deck.node_points >= 0)
            near = on_surface[np.argmin(np.abs(deck.nodes[on_surface] - number))]
            raise SceneError(
                f"{key}: part {part!r} has no node {number} on its surface; the nearest number is {deck.nodes[near]}, "
                f"at {xyz(surface.points[deck.node_points[near]])}"
            )
        point = surface.points[matches[0]]
        self.messages.append(f"{key} {number}: {xyz(point)}")
        return _vector(point)

    def _set(self, key, name, part, surface: Surface, deck: Deck | None) -> Vector:
        sets = deck.node_sets if deck is not None else {}
        if name not in sets or not len(sets[name]):
            near = difflib.get_close_matches(name, sets, 1, cutoff=0.0)
            hint = f"the nearest name is {near[0]!r}" if near else "its mesh has no sets of nodes"
            raise SceneError(f"{key}: part {part!r} has no set of nodes {name!r}; {hint}")
        points = surface.points[np.unique(sets[name])]
        middle = points.mean(axis=0)
        foot = surface.project(middle)
        point, distance = foot.point[0], float(foot.distance[0])
        if distance > REACH:
            nearest = points[np.argmin(np.linalg.norm(points - middle, axis=1))]
            raise SceneError(
                f"{key}: the mean of the {len(points)} nodes of {name!r} is {distance:.3g} mm away from part {part!r} "
                f"(at most {REACH:g} mm is allowed); give a set of nodes closer together, the rim of a hole as hole, "
                f"or a point: the node nearest to the mean is at {xyz(nearest)}"
            )
        self.messages.append(
            f"{key} {name}: {xyz(point)}, the mean of {len(points)} nodes"
            + (f", moved {distance:.2g} mm onto the part" if distance > surface.tie else "")
        )
        return _vector(point)

    def _hole(self, key, near, part) -> Hole:
        if part not in self._holes:
            self._holes[part] = find_holes(self.surfaces[part])
        holes = self._holes[part]
        if not holes:
            raise SceneError(f"{key}: part {part!r} has no hole; give point = [x, y, z]")
        distance = np.linalg.norm([hole.centre - np.array(near) for hole in holes], axis=1)
        hole = holes[int(np.argmin(distance))]
        size = f"{hole.size[0]:.3g} mm across" if hole.round else f"{hole.size[0]:.3g} × {hole.size[1]:.3g} mm"
        found = f"{size}, its centre at {xyz(hole.centre)}, {distance.min():.2g} mm from the given point"
        if distance.min() > hole.size[0] / 2 + REACH:
            raise SceneError(f"{key}: no hole of part {part!r} is near {xyz(near)}; the nearest is {found}")
        self.messages.append(f"{key}: {found}")
        return hole

    def _sheet_normal(self, part: str, point, hole: Hole | None) -> np.ndarray:
        """Unit normal of a hole's plane, or else of the curved sheet at a point's projection."""
        if hole is not None:
            return hole.normal
        surface = self.surfaces[part]
        foot = surface.project(point)
        n = foot.barycentric[0] @ surface.corner_normals[foot.triangle[0]]
        return n / np.linalg.norm(n)

    def _direction(self, key, item, point, hole: Hole | None) -> Vector:
        *_, axis = words = item.direction.removeprefix("-").split()
        sign = -1.0 if item.direction.startswith("-") else 1.0
        n = self._sheet_normal(item.part, point, hole)
        if len(words) == 1:
            return _vector(sign * n)
        unit = np.eye(3)["xyz".index(axis)]
        along = unit - (unit @ n) * n
        length = float(np.linalg.norm(along))
        if length < ALONG:
            others = " or ".join(f'"in-plane {other}"' for other in "xyz" if other != axis)
            raise SceneError(
                f"{key}.direction: {axis} stands across the sheet there, whose normal is {xyz(n)}; give {others}"
            )
        return _vector(sign * along / length)

    def _characteristic(self, key: str, item: Measurement) -> Measurement:
        """A measurement of two or more points, with points and direction."""
        if item.kind in item.OVER:
            return self._many_points(key, item)
        assert item.to is not None  # the schema requires it for these kinds
        point, rim = self._point(key, item)
        far, far_rim = self._point(f"{key}.to", item.to)
        if far is None:
            far = self._nearest(f"{key}.to", item, point)
        along = item.direction
        if item.kind == "distance" or (item.kind == "gap" and along == NORMAL):
            line = np.subtract(far, point)
            if item.kind == "gap":
                n = self._sheet_normal(item.part, point, rim)
                line = line - (line @ n) * n
            length = float(np.linalg.norm(line))
            if length < APART:
                raise SceneError(
                    f"{key}.to: along the {'sheet' if item.kind == 'gap' else 'line between them'}, {xyz(far)} and "
                    f"{xyz(point)} are {length:.2g} mm apart, which defines no direction; give a gap with a direction"
                )
            along = _vector(line / length)
        elif isinstance(along, str):
            along = self._direction(key, item, point, rim)
        to = item.to.model_copy(update=_position(far, far_rim))
        return item.model_copy(update=_position(point, rim) | {"to": to, "direction": along})

    def _nearest(self, key: str, item: Measurement, point: Vector) -> Vector:
        """The point of the second part that is nearest to the first point, on its own part."""
        assert item.to is not None  # the schema requires it for these kinds
        start = on_part(f"{key.removesuffix('.to')}.point", item.part, self.surfaces[item.part], point).point[0]
        foot = self.surfaces[item.to.part].project(start)
        self.messages.append(
            f"{key}: {xyz(foot.point[0])}, the nearest point of {item.to.part}, {foot.distance[0]:.3g} mm"
        )
        return _vector(foot.point[0])

    def _many_points(self, key: str, item: Measurement) -> Measurement:
        """A measurement over many points, with all of them."""
        surface, points = self.surfaces[item.part], item.points
        if item.spacing is not None:
            chosen = surface.points[spread(surface, item.spacing, item.box)]
            if len(chosen) < 2:
                raise SceneError(
                    f"{key}.{'spacing' if item.box is None else 'box'}: {len(chosen)} points of part "
                    f"{item.part!r} lie there, {item.spacing:g} mm apart; give a smaller spacing or a larger box"
                )
            points = [_vector(point) for point in chosen]
            self.messages.append(f"{key}: {len(points)} points on {item.part}")
        assert points is not None  # the schema requires them for these kinds
        changes: dict[str, Any] = {"points": points, "spacing": None, "box": None}
        if item.kind == "parallelism" and isinstance(item.direction, str):
            changes["direction"] = self._direction(key, item, np.mean(points, axis=0), None)
        return item.model_copy(update=changes)

    def _tong(self, key, item, point) -> list[Any]:
        """The two jaws of a tong, one on each of its parts."""
        first, second = item.parts
        names = tuple(f"{item.name}-{part}" for part in item.parts)
        if max(map(len, names)) > LONGEST:
            raise SceneError(f"{key}.name: the names of its jaws, {', '.join(names)}, are too long; shorten it")
        for part in item.parts:
            on_part(f"{key}.point", part, self.surfaces[part], point)
        try:
            n = pair_at(point, item.radius, self.sides[first], self.sides[second]).frame[:, 0]
        except ValueError:
            raise SceneError(
                f"{key}.point: {first!r} and {second!r} do not face each other at {xyz(point)}, so a tong cannot "
                "press them together there; move it to where they do, or give two clamps"
            ) from None
        along = n
        if not isinstance(item.direction, str):
            along = np.array(item.direction)
            if along @ n < TOGETHER:
                raise SceneError(
                    f"{key}.direction: {xyz(along)} does not push {first!r} towards {second!r}, which lies along "
                    f"{xyz(n)}; leave direction out, or reverse it"
                )
        self.jaws[item.name] = names
        self.messages.append(f"{key}: pushes {first} along {xyz(along)}, and {second} against it")
        common = {"parts": None, "node": None, "set": None, "point": point}
        return [
            item.model_copy(update=common | {"name": name, "part": part, "direction": _vector(sign * along)})
            for name, part, sign in zip(names, item.parts, (1.0, -1.0))
        ]


def _position(point: Vector, rim: Hole | None) -> dict[str, Any]:
    """Changes that give an item its point, and the hole that it is in."""
    return {"node": None, "set": None, "point": point} | ({"hole": point} if rim is not None else {})


def _vector(x: Sequence[float] | np.ndarray) -> Vector:
    a, b, c = (float(value) + 0.0 for value in x)
    return a, b, c
