"""A 3-2-1 fixture for a part, and further supports.

Three locators along the normal, on surfaces near the main direction, span the largest triangle; two are across the
longest direction of the part, as far apart as possible; one is along it. Two round holes, if there are any, take pins.
The choice is evaluated by the singular values of the readings G of the rigid-body motions,

    G_i = [d_i, (x_i − c) × d_i / ρ],        c the centre of the points, ρ half their extent,

and if these are badly conditioned, six rows among all places and directions are chosen by QR with pivoting.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from itertools import combinations

import numpy as np
from scipy.linalg import qr
from scipy.spatial import cKDTree

from mic.geometry.holes import Hole, find_holes
from mic.wizard.bodies import NO_POINTS, Body

__all__ = ["Support", "conditioning", "propose_fixture", "readings", "spread"]

PAD = 4.0  # mm, radius of a locator's pad
FLAT = 12.0  # degrees by which normals turn under a pad
MAIN = 25.0  # degrees between the main direction and the first three locators
ENOUGH = 0.1  # least ratio of singular values of G of an accepted 3-2-1
SHARE = 0.6  # or relative to that of the six rows chosen by QR
PIN = (4.0, 40.0)  # mm, diameters of holes for pins
MOST = 400  # places that are considered
TRIED = 100  # directions considered for the main one
FURTHER = 3  # supports of a part beyond the six, at most


@dataclass(frozen=True)
class Support:
    """One locator.

    Attributes
    ----------
    point : (3,) array
        mm.
    direction_text : str
        Direction as a text of the scene.
    direction : (3,) array
    hole : bool
        Whether it is a pin in a hole.
    further : bool
        Whether it is one beyond the six.
    """

    point: np.ndarray
    direction_text: str
    direction: np.ndarray
    hole: bool = False
    further: bool = False


def conditioning(supports: list[Support]) -> float:
    """Ratio of the smallest to the largest singular value of G; 0 if a motion is free."""
    values = np.linalg.svd(readings(supports), compute_uv=False)
    return float(values[5] / values[0]) if len(values) == 6 else 0.0


def readings(supports: Sequence[Support], scale: float | None = None) -> np.ndarray:
    """(n, 6) readings G of the rigid-body motions about the mean point; ρ is half the extent, or as given, mm."""
    points, directions = _points(supports), np.array([support.direction for support in supports])
    arms = points - points.mean(0)
    return np.column_stack([directions, np.cross(arms, directions) / (scale or max(1e-9, _extent(points) / 2))])


def _points(supports: Sequence[Support]) -> np.ndarray:
    return np.array([support.point for support in supports])


def _extent(points: np.ndarray) -> float:
    return float(np.linalg.norm(np.ptp(points, axis=0)))


def _find_places(body: Body) -> list[Support]:
    """Locators along the normal at flat places of a part, spread over it.

    The places are a pad's radius off the edges; if there are too few, less flat ones and some nearer to the edge count.
    """
    points, normals = body.surface.corners.mean(1), body.surface.normals
    around = cKDTree(points).query_ball_point(points, max(PAD, body.element))
    flat = np.array([float((normals[near] @ normal).min()) for normal, near in zip(normals, around)])
    edge_distance = cKDTree(body.edge).query(points)[0] if len(body.edge) else np.full(len(points), np.inf)
    for distance, turn in ((1.5 * PAD, FLAT), (PAD, FLAT), (0.5 * PAD, 2 * FLAT), (0.0, 180.0)):
        chosen = np.flatnonzero((edge_distance >= distance) & (flat >= np.cos(np.radians(turn))))
        if len(chosen) >= 6:
            break
    if len(chosen) > MOST:
        chosen = chosen[spread(points[chosen], MOST)]
    return [Support(points[i], "normal", normals[i]) for i in chosen]


def propose_fixture(body: Body, lap_points: np.ndarray) -> list[Support]:
    """Six locators that hold a part, and further supports.

    Parameters
    ----------
    body : Body
    lap_points : (n, 3) array
        Points in laps with other parts, mm: avoided if the rest of the part is sufficient.
    """
    places, main = _find_places(body), _main_direction(body)
    holes = [hole for hole in find_holes(body.surface) if _takes_pin(hole, main)]
    options = [places]
    if len(lap_points):
        distances = cKDTree(lap_points).query(_points(places))[0]
        outside = [place for place, distance in zip(places, distances) if distance > 2 * PAD]
        if len(outside) >= 6:
            options = [outside, places]
    six, places = _six(options, holes, main)
    return six + _further(six, _facing(places, main) or places)


def _facing(places: list[Support], main: np.ndarray) -> list[Support]:
    return [place for place in places if abs(place.direction @ main) >= np.cos(np.radians(MAIN))]


def _six(options: list[list[Support]], holes: list[Hole], main: np.ndarray) -> tuple[list[Support], list[Support]]:
    """A 3-2-1, with pins in holes if there are two; six rows by QR if it is badly conditioned; and its places."""
    by_qr = [(_six_by_qr(places), places) for places in options]
    best = max(by_qr, key=lambda choice: conditioning(choice[0]))
    enough = min(ENOUGH, SHARE * conditioning(best[0]))  # for a narrow strip, any six are badly conditioned
    for places in options:
        facing = _facing(places, main)
        if len(facing) < 3:
            continue
        first = _three(facing, main)
        for rest in (_pins(holes, main), _two_and_one(facing, main)):
            if conditioning(first + rest) >= enough:
                return first + rest, places
    return best


def _main_direction(body: Body) -> np.ndarray:
    """The direction, of either sign, near the normals of most of the sheet."""
    n, area = body.surface.normals, body.surface.areas
    tried = n[np.argsort(-area, kind="stable")[:: max(1, len(n) // TRIED)]]
    near = np.abs(tried @ n.T) >= np.cos(np.radians(MAIN))
    best = near[int(np.argmax(near @ area))]
    main = np.linalg.eigh((n[best] * area[best, None]).T @ n[best])[1][:, 2]
    return main * np.sign(main[np.argmax(np.abs(main))])


def _takes_pin(hole: Hole, main: np.ndarray) -> bool:
    return bool(
        hole.round
        and PIN[0] <= hole.size[0] <= PIN[1]
        and hole.uneven < 0.05 * hole.size[0]
        and abs(hole.normal @ main) > np.cos(np.radians(MAIN))
    )


def _three(places: list[Support], main: np.ndarray) -> list[Support]:
    """The three places that span the largest triangle, seen along the main direction."""
    points = _points(places)
    flat = points - np.outer(points @ main, main)
    chosen = spread(flat, 40)
    corner = flat[chosen]
    i, j, k = np.array(list(combinations(range(len(chosen)), 3))).T
    area = np.linalg.norm(np.cross(corner[j] - corner[i], corner[k] - corner[i]), axis=1)
    best = int(np.argmax(area))
    return [places[chosen[index[best]]] for index in (i, j, k)]


def _pins(holes: list[Hole], main: np.ndarray) -> list[Support]:
    """A pin in two directions in one hole, and in one direction across the line to the farthest other hole."""
    if len(holes) < 2:
        return []
    centres = np.array([hole.centre for hole in holes])
    distance = np.linalg.norm(centres[:, None] - centres[None], axis=2)
    i, j = np.unravel_index(int(np.argmax(distance)), distance.shape)
    axes = _axes(main)
    across = min(axes, key=lambda axis: abs(_projected(axis, holes[j].normal) @ (centres[j] - centres[i])))
    rows = [(holes[i], axis) for axis in axes] + [(holes[j], across)]
    return [_in_plane(hole.centre, axis, hole.normal, hole=True) for hole, axis in rows]


def _two_and_one(places: list[Support], main: np.ndarray) -> list[Support]:
    """Two locators across the longer of two axes, at its ends, and one along it."""
    points = _points(places)
    axes = _axes(main)
    extents = [float(np.ptp(points @ _projected(axis, main))) for axis in axes]
    long, short = (axes[i] for i in np.argsort(extents)[::-1])
    along, across = points @ _projected(long, main), points @ _projected(short, main)
    side = across.min() if abs(across.min() - across.mean()) > abs(across.max() - across.mean()) else across.max()
    row = np.flatnonzero(np.abs(across - side) <= 0.35 * np.ptp(across) + 1e-9)
    ends = (row[np.argmin(along[row])], row[np.argmax(along[row])])
    middle = int(np.argmin(np.abs(across - across.mean()) + (along - along.min())))
    rows = [(places[i], short) for i in ends] + [(places[middle], long)]
    return [_in_plane(place.point, axis, place.direction) for place, axis in rows]


def _six_by_qr(places: list[Support]) -> list[Support]:
    """Six rows among all places and directions, by QR with pivoting."""
    rows = []
    for place in places:
        rows += [place, *(_in_plane(place.point, axis, place.direction) for axis in _axes(place.direction))]
    order = qr(readings(rows).T, pivoting=True, mode="r")[1]
    return sorted((rows[i] for i in order[:6]), key=lambda row: row.direction_text != "normal")


def _further(six: list[Support], places: list[Support]) -> list[Support]:
    """Supports along the normal at places far from the others."""
    points = _points(places)
    far = 0.3 * _extent(points)
    supports: list[Support] = []
    while len(supports) < FURTHER:
        distance = cKDTree(_points(six + supports)).query(points)[0]
        best = int(np.argmax(distance))
        if distance[best] < far:
            break
        supports.append(replace(places[best], further=True))
    return supports


def _axes(normal: np.ndarray) -> list[str]:
    """The two axes with the smallest angles to a plane."""
    return ["xyz"[i] for i in sorted(np.argsort(np.abs(normal), kind="stable")[:2])]


def _projected(axis: str, normal: np.ndarray) -> np.ndarray:
    """An axis projected into a plane, of unit length."""
    unit = np.eye(3)["xyz".index(axis)]
    projection = unit - (unit @ normal) * normal
    return projection / np.linalg.norm(projection)


def _in_plane(point: np.ndarray, axis: str, normal: np.ndarray, hole: bool = False) -> Support:
    return Support(point, f"in-plane {axis}", _projected(axis, normal), hole)


def spread(points: np.ndarray, count: int, near: np.ndarray = NO_POINTS) -> np.ndarray:
    """Indices of points by farthest-point sampling; the first is farthest from `near`, or from the centre."""
    distance = cKDTree(near).query(points)[0] if len(near) else np.linalg.norm(points - points.mean(0), axis=1)
    chosen: list[int] = []
    for step in range(min(count, len(points))):
        chosen.append(int(np.argmax(distance)))
        to_last = np.linalg.norm(points - points[chosen[-1]], axis=1)
        distance = np.minimum(distance, to_last) if step or len(near) else to_last
    return np.array(chosen, dtype=np.int64)
