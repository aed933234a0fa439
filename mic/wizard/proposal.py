"""Propose a scene from the meshes of its parts."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from itertools import combinations

import numpy as np
from scipy.spatial import cKDTree

from mic.wizard.bodies import NO_POINTS, Body
from mic.wizard.faying import Faying, find_faying, nearest_distance, restrict
from mic.wizard.fixture import Support, conditioning, propose_fixture, spread
from mic.wizard.joints import Joints, propose_joints
from mic.wizard.standing import Standing, find_standing
from mic.wizard.variation import Variation, propose_variation

__all__ = ["Proposal", "Tong", "propose"]

CLOSED = 0.25  # of the thinner sheet: overlap that a zone closes by default
BETWEEN = 0.8  # of the thickness of a sheet between two others: least gap of these
PAIRS = 800  # approximate number of contact pairs of a first run
ACROSS = 4.0  # thicknesses between two candidates on finer meshes
MEASURED = 4  # measured points of each part, on its free edges
LAP_DISTANCE = 12.0  # mm between a measured point and a lap
OVERLAP_FACTOR = 1.1  # of the largest overlap found here, since a zone has more points


@dataclass(frozen=True)
class Tong:
    """A tong that presses the outer two sheets of a stack at its point.

    Attributes
    ----------
    first, second : Body
    point : (3,) array
        mm.
    """

    first: Body
    second: Body
    point: np.ndarray


@dataclass(frozen=True)
class Proposal:
    """A proposed scene, by the names of its parts.

    Attributes
    ----------
    bodies : list of Body
    offsets : dict of str to float
        Thicknesses from the drawn surface to the mid-surface.
    why : dict of str to str
        Reason for an offset other than zero.
    laps : list of Faying
        The largest first.
    overlap : list of float
        By lap, the overlap that its zone must close beyond the default, mm; 0 for none.
    spacing : float or None
        Between the candidates of all zones, mm, if the default gives too many.
    reach : list of float
        By lap, the gap beyond which another sheet is between the two, mm; 0 if there is none.
    joints : list of Joints
        By lap.
    standing : list of Standing
        Parts that stand on others by their edges.
    tongs : list of Tong
    fixtures : dict of str to list of Support
        The first six of each hold the part.
    conditioned : dict of str to float
        Ratio of the singular values of the six.
    base : list of str
        The part of each welded group whose six locators stay closed.
    measured : dict of str to (k, 3) array
    variation : dict of str to Variation
    sentences : list of str
        Notes for the user.
    """

    bodies: list[Body]
    offsets: dict[str, float]
    why: dict[str, str]
    laps: list[Faying]
    overlap: list[float]
    spacing: float | None
    reach: list[float]
    joints: list[Joints]
    standing: list[Standing]
    tongs: list[Tong]
    fixtures: dict[str, list[Support]]
    conditioned: dict[str, float]
    base: list[str]
    measured: dict[str, np.ndarray]
    variation: dict[str, Variation]
    sentences: list[str]

    @property
    def welds(self) -> int:
        """Number of proposed welds."""
        return sum(len(joint.welds) for joint in self.joints) + sum(len(edge.welds) for edge in self.standing)

    def summary(self) -> str:
        """Numbers of proposed items."""
        count = {
            "part": len(self.bodies),
            "locator": sum(map(len, self.fixtures.values())),
            "contact zone": len(self.laps),
            "clamp": len(self.tongs),
            "weld": self.welds,
        }
        return ", ".join(f"{number or 'no'} {what}{'' if number == 1 else 's'}" for what, number in count.items())


def propose(bodies: Sequence[Body], welds: Mapping[tuple[str, str], np.ndarray] | None = None) -> Proposal:
    """A scene for these parts.

    Parameters
    ----------
    bodies : sequence of Body
    welds : mapping of (str, str) to (n, 3) array, optional
        Points of welds by the parts that they join; by default welds are proposed.
    """
    sentences = [
        f"{body.file}: {body.name} is {body.surface.diameter / 1e3:.3g} long in the file's unit: taken for metres"
        for body in bodies
        if body.unit == "m"
    ]
    laps = [lap for pair in combinations(bodies, 2) if (lap := find_faying(*pair)) is not None]
    laps.sort(key=lambda lap: -lap.area)
    offsets, why = _offsets(bodies, laps, sentences)
    laps, reach = _touching(bodies, laps, offsets)
    joints = _joints(laps, offsets, welds)
    standing = _standing(bodies, laps, welds, sentences)
    lap_points = {body.name: _lap_points(body, laps, standing) for body in bodies}
    fixtures = {body.name: propose_fixture(body, lap_points[body.name]) for body in bodies}
    _note_unconnected(bodies, laps, joints, standing, sentences)
    variation = {body.name: propose_variation(body, fixtures[body.name][:6]) for body in bodies}
    sentences += [
        f"{name} has too few or too many elements for a proposed random field of its shape: only its locators vary"
        for name, proposed in variation.items()
        if not proposed.sigma
    ]
    return Proposal(
        bodies=list(bodies),
        offsets=offsets,
        why=why,
        laps=laps,
        overlap=[_overlap(lap, offsets) for lap in laps],
        spacing=_spacing(laps),
        reach=reach,
        joints=joints,
        standing=standing,
        tongs=_tongs(laps, joints),
        fixtures=fixtures,
        conditioned={name: conditioning(supports[:6]) for name, supports in fixtures.items()},
        base=_base(bodies, laps, joints, [one.names for one in standing], welds),
        measured={body.name: _measured(body, lap_points[body.name]) for body in bodies},
        variation=variation,
        sentences=sentences,
    )


def _offsets(bodies, laps: Sequence[Faying], sentences) -> tuple[dict[str, float], dict[str, str]]:
    """Offsets of mid-surfaces: from the mesh file, else so that sheets drawn on touching skins are side by side."""
    known = {body.name: body.offset for body in bodies if body.offset is not None}
    why = {name: "from the mesh file" for name, value in known.items() if value}
    for lap in laps:
        a, b = lap.first, lap.second
        if not lap.coincident or a.name in known and b.name in known:
            continue
        side = lap.side or 1.0
        if a.name not in known and b.name not in known:
            known[a.name] = -0.5 * side
            why[a.name] = f"it is drawn on the skin that touches {b.name}, and its sheet is on the other side"
        if a.name in known:
            middle = known[a.name] * a.thickness + side * (a.thickness + b.thickness) / 2
            known[b.name] = lap.turned * middle / b.thickness
            why[b.name] = f"it is drawn on the skin that touches {a.name}"
        else:
            middle = lap.turned * known[b.name] * b.thickness - side * (a.thickness + b.thickness) / 2
            known[a.name] = middle / a.thickness
            why[a.name] = f"it is drawn on the skin that touches {b.name}"
        sentences.append(
            f"{a.name} and {b.name} are drawn on the same surface: offsets place their sheets side by side"
            + ("" if lap.side else "; the side is a guess, check it")
        )
    return {body.name: known.get(body.name, 0.0) for body in bodies}, why


def _touching(bodies, laps: Sequence[Faying], offsets) -> tuple[list[Faying], list[float]]:
    """Laps without points where another sheet is between, and by lap the gap that excludes these, mm."""
    touching, reach = [], []
    for lap in laps:
        gap = lap.gap(offsets)
        max_gap = min((BETWEEN * body.thickness for body in bodies if _between(body, lap, gap)), default=np.inf)
        rest = lap if np.isinf(max_gap) else restrict(lap, gap < max_gap)
        if rest is not None:
            touching.append(rest)
            reach.append(0.0 if np.isinf(max_gap) else round(max_gap, 2))
    return touching, reach


def _between(body: Body, lap: Faying, gap: np.ndarray) -> bool:
    """Whether another sheet is between those of a lap, at some of its points."""
    wide = gap >= BETWEEN * body.thickness
    if body in (lap.first, lap.second) or not wide.any():
        return False
    height = lap.height[wide]
    middle = lap.point[wide] + lap.normal[wide] * height[:, None] / 2
    distance = body.surface.project(middle, reach=float(np.abs(height).max() + body.thickness)).distance
    return bool(np.mean(distance <= np.abs(height) / 2 + body.thickness / 4) > 0.5)


def _joints(laps: Sequence[Faying], offsets, welds) -> list[Joints]:
    """Welds and tongs lap by lap, without repeating those of a stack."""
    joints: list[Joints] = []
    for lap in laps:
        pair = lap.names
        listed = None
        if welds is not None:
            listed = np.concatenate([welds.get(pair, NO_POINTS), welds.get(pair[::-1], NO_POINTS)])
        same_stack = [done.welds for other, done in zip(laps, joints) if {*other.names} & {*pair}]
        other_welds = np.concatenate([NO_POINTS, *same_stack])
        other_tongs = np.concatenate([NO_POINTS, *(done.tongs for done in joints)])
        joints.append(propose_joints(lap, lap.gap(offsets), listed, other_welds, other_tongs))
    return joints


def _tongs(laps: Sequence[Faying], joints: Sequence[Joints]) -> list[Tong]:
    """Tongs on the outer sheets of the stacks at their points."""
    points = [(lap, point) for lap, joint in zip(laps, joints) for point in joint.tongs]
    tongs = []
    for number, (lap, point) in enumerate(points):
        stack = {body.name: body for body in lap.bodies}
        for other, joint in zip(laps, joints):
            if number in joint.through and {*other.names} & {*stack}:
                stack |= {body.name: body for body in other.bodies}
        n = lap.normal[np.argmin(np.linalg.norm(lap.point - point, axis=1))]
        feet = {name: body.surface.project(point).point[0] for name, body in stack.items()}
        order = sorted(stack, key=lambda name: float((feet[name] - point) @ n) * (lap.side or 1.0))
        first, second = order[0], order[-1]
        tongs.append(Tong(stack[first], stack[second], (feet[first] + feet[second]) / 2))
    return tongs


def _overlap(lap: Faying, offsets: Mapping[str, float]) -> float:
    """The overlap to be closed, mm, if a zone does not close it by default; else 0."""
    deepest = -float(lap.gap(offsets).min())
    if deepest <= 0.9 * CLOSED * _thinner(lap):
        return 0.0
    return float(np.ceil(OVERLAP_FACTOR * deepest * 100) / 100)


def _spacing(laps: Sequence[Faying]) -> float | None:
    """A distance of candidates that gives about `PAIRS` of them, if the default gives more."""
    if not laps:
        return None
    defaults = [max(lap.first.element, lap.second.element, ACROSS * _thinner(lap)) for lap in laps]
    if sum(lap.area / spacing**2 for lap, spacing in zip(laps, defaults)) <= PAIRS:
        return None
    return max(float(np.ceil(np.sqrt(sum(lap.area for lap in laps) / PAIRS))), *defaults)


def _thinner(lap: Faying) -> float:
    return min(lap.first.thickness, lap.second.thickness)


def _standing(bodies, laps: Sequence[Faying], welds, sentences) -> list[Standing]:
    """Parts without a common lap of which one stands on the other by its edge; their welds, unless these are listed."""
    lapped = [{*lap.names} for lap in laps]
    apart = [pair for pair in combinations(bodies, 2) if {pair[0].name, pair[1].name} not in lapped]
    standing = [found for pair in apart if (found := find_standing(*pair)) is not None]
    for one in standing:
        sheet, edge = one.names
        count = f"{len(one.welds)} proposed" if welds is None else "listed"
        place = f"over {one.length:.0f} mm and {round(one.gap, 2) + 0.0:g} mm off its face"
        sentences.append(
            f"{edge} stands on {sheet} by its edge, {place}: {count} welds along it join the two; the contact of an "
            "edge is not modelled, so between welds it may pass into the sheet"
        )
    return standing if welds is None else [replace(one, welds=NO_POINTS) for one in standing]


def _lap_points(body: Body, laps: Sequence[Faying], standing: Sequence[Standing]) -> np.ndarray:
    """(n, 3) points of a part in its laps, and along the edges on which parts stand, mm."""
    points = [
        lap.point if body is lap.first else body.surface.project(lap.point).point for lap in laps if body in lap.bodies
    ]
    return np.concatenate([NO_POINTS, *points, *(one.point for one in standing if body.name in one.names)])


def _note_unconnected(bodies, laps, joints, standing, sentences) -> None:
    joined = {name for one in standing for name in one.names}
    for body in bodies:
        welds = [len(joint.welds) for lap, joint in zip(laps, joints) if body in lap.bodies]
        others = [other for other in bodies if other is not body]
        if not welds and others and body.name not in joined:
            distance, name = min((nearest_distance(body, other), other.name) for other in others)
            sentences.append(f"{body.name} has no lap with another part; the nearest is {name}, {distance:.3g} mm away")
        elif welds and not any(welds):
            sentences.append(f"{body.name} has no weld: its laps have no room for one")


def _base(bodies, laps, joints, standing, welds) -> list[str]:
    """The largest part of every welded group."""
    group = {body.name: body.name for body in bodies}
    pairs = [lap.names for lap, joint in zip(laps, joints) if len(joint.welds)]
    for a, b in [*pairs, *standing, *(welds or {})]:
        old, new = group[b], group[a]
        group = {name: new if label == old else label for name, label in group.items()}
    area = {body.name: float(body.surface.areas.sum()) for body in bodies}
    return [
        max((name for name in group if group[name] == label), key=area.__getitem__)
        for label in dict.fromkeys(group.values())
    ]


def _free_edge(body: Body, lap_points: np.ndarray, distance: float) -> np.ndarray:
    """(n, 3) points on the edges of a part, if possible at this distance from its laps, mm."""
    points = body.edge if len(body.edge) else body.surface.corners.mean(1)
    if len(lap_points):
        to_lap = cKDTree(lap_points).query(points)[0]
        for least in (distance, distance / 3):
            if np.count_nonzero(to_lap >= least) >= MEASURED:
                return points[to_lap >= least]
    return points


def _measured(body: Body, lap_points: np.ndarray) -> np.ndarray:
    points = _free_edge(body, lap_points, LAP_DISTANCE)
    return points[spread(points, MEASURED)]
