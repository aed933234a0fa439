"""A 3-2-1 fixture for a part, and further supports.

Three locators along the normal, on surfaces near the main direction, span the largest triangle; two are across the
longest direction of the part, as far apart as possible; one is along it. Two round holes, if there are any, take pins.
The choice is evaluated by the singular values of the readings G of the rigid-body motions,

    G_i = [d_i, (x_i − c) × d_i / ρ],        c the centre of the points, ρ half their extent,

and if these are badly conditioned, six rows among all places and directions are chosen by QR with pivoting.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.linalg import qr
from scipy.spatial import cKDTree

from mic.geometry.holes import Hole, find_holes
from mic.wizard.bodies import Body

__all__ = ["Place", "Support", "conditioning", "find_places", "propose_fixture"]

PAD = 4.0  # mm, radius of a locator's pad
FLAT = 12.0  # degrees by which normals turn under a pad
MAIN = 25.0  # degrees between the main direction and the first three locators
ENOUGH = 0.1  # least ratio of singular values of G of an accepted 3-2-1
SHARE = 0.6  # or relative to that of the pivoted six rows
PIN = (4.0, 40.0)  # mm, diameters of holes for pins
MOST = 400  # places that are considered
TRIED = 100  # directions considered for the main one
FURTHER = 3  # supports of a part beyond the six, at most


@dataclass(frozen=True)
class Place:
    """A possible place of a pad.

    Attributes
    ----------
    point, normal : (3,) array
    """

    point: np.ndarray
    normal: np.ndarray


@dataclass(frozen=True)
class Support:
    """One locator.

    Attributes
    ----------
    point : (3,) array
        mm.
    words : str
        Direction as a text of the scene.
    direction : (3,) array
    hole : bool
        Whether it is a pin in a hole.
    further : bool
        Whether it is one beyond the six.
    """

    point: np.ndarray
    words: str
    direction: np.ndarray
    hole: bool = False
    further: bool = False


def conditioning(supports: list[Support]) -> float:
    """Ratio of the smallest to the largest singular value of G; 0 if a motion is free."""
    return _conditioning(np.array([one.point for one in supports]), np.array([one.direction for one in supports]))


def _conditioning(points: np.ndarray, directions: np.ndarray) -> float:
    values = np.linalg.svd(_readings(points, directions), compute_uv=False)
    return float(values[5] / values[0]) if len(values) == 6 else 0.0


def _readings(points: np.ndarray, directions: np.ndarray, scale: float | None = None) -> np.ndarray:
    arms = points - points.mean(0)
    size = scale or max(1e-9, float(np.linalg.norm(np.ptp(points, axis=0)) / 2))
    return np.column_stack([directions, np.cross(arms, directions) / size])


def find_places(body: Body) -> list[Place]:
    """Flat places of a part, a pad's radius off its edges, spread over it; other places if there are none."""
    surface = body.surface
    triangles = np.arange(len(surface.triangles))
    points, normals = surface.corners.mean(1), surface.normals
    tree = cKDTree(points)
    radius = max(PAD, body.element)
    around = tree.query_ball_point(points, radius)
    flat = np.array([float((normals[own] @ normals[i]).min()) for i, own in zip(triangles, around)])
    off = body.off_edge(points)
    for wide, turn in ((1.5 * PAD, FLAT), (PAD, FLAT), (0.5 * PAD, 2 * FLAT), (0.0, 180.0)):
        found = np.flatnonzero((off >= wide) & (flat >= np.cos(np.radians(turn))))
        if len(found) >= 6:
            break
    chosen = found[spread(points[found], MOST)] if len(found) > MOST else found
    return [Place(points[i], normals[i]) for i in chosen]


def propose_fixture(body: Body, taken: np.ndarray) -> list[Support]:
    """Six locators that hold a part, and further supports.

    Parameters
    ----------
    body : Body
    taken : (n, 3) array
        Points in laps with other parts, mm: avoided if the rest of the part is sufficient.
    """
    every, main = find_places(body), _main_direction(body)
    holes = [hole for hole in find_holes(body.surface) if _pin(hole, main)]
    options = [every]
    if len(taken):
        away = cKDTree(taken).query(np.array([one.point for one in every]))[0]
        free = [one for one, distance in zip(every, away) if distance > 2 * PAD]
        options = [free, every] if len(free) >= 6 else [every]
    best, places = _six(options, holes, main)
    return best + _further(best, _facing(places, main) or places)


def _facing(places: list[Place], main: np.ndarray) -> list[Place]:
    return [one for one in places if abs(one.normal @ main) >= np.cos(np.radians(MAIN))]


def _six(options: list[list[Place]], holes: list[Hole], main: np.ndarray) -> tuple[list[Support], list[Place]]:
    """A 3-2-1, with pins in holes if there are two; pivoted rows if it is badly conditioned."""
    pivoted = [(_pivoted(places), places) for places in options]
    best = max(pivoted, key=lambda one: conditioning(one[0]))
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
    own = near[int(np.argmax(near @ area))]
    main = np.linalg.eigh((n[own] * area[own, None]).T @ n[own])[1][:, 2]
    return main * np.sign(main[np.argmax(np.abs(main))])


def _pin(hole: Hole, main: np.ndarray) -> bool:
    return bool(
        hole.round
        and PIN[0] <= hole.size[0] <= PIN[1]
        and hole.uneven < 0.05 * hole.size[0]
        and abs(hole.normal @ main) > np.cos(np.radians(MAIN))
    )


def _three(places: list[Place], main: np.ndarray) -> list[Support]:
    """The three places that span the largest triangle, seen along the main direction."""
    points = np.array([one.point for one in places])
    flat = points - np.outer(points @ main, main)
    some = spread(flat, 40)
    at = flat[some]
    i, j, k = (index.ravel() for index in np.meshgrid(*3 * [np.arange(len(some))], indexing="ij"))
    keep = (i < j) & (j < k)
    i, j, k = i[keep], j[keep], k[keep]
    area = np.linalg.norm(np.cross(at[j] - at[i], at[k] - at[i]), axis=1)
    best = int(np.argmax(area))
    return [Support(places[some[one]].point, "normal", places[some[one]].normal) for one in (i[best], j[best], k[best])]


def _pins(holes: list[Hole], main: np.ndarray) -> list[Support]:
    """A pin in two directions in one hole, and in one direction across the line to the farthest other hole."""
    if len(holes) < 2:
        return []
    centres = np.array([hole.centre for hole in holes])
    apart = np.linalg.norm(centres[:, None] - centres[None], axis=2)
    i, j = np.unravel_index(int(np.argmax(apart)), apart.shape)
    words = _axes(main)
    across = min(words, key=lambda axis: abs(_projected(axis, holes[j].normal) @ (centres[j] - centres[i])))
    rows = [(holes[i], axis) for axis in words] + [(holes[j], across)]
    return [Support(hole.centre, f"in-plane {axis}", _projected(axis, hole.normal), hole=True) for hole, axis in rows]


def _two_and_one(places: list[Place], main: np.ndarray) -> list[Support]:
    """Two locators across the longer of two axes, at its ends, and one along it."""
    points = np.array([one.point for one in places])
    axes = _axes(main)
    extents = [float(np.ptp(points @ _projected(axis, main))) for axis in axes]
    long, short = (axes[i] for i in np.argsort(extents)[::-1])
    along, across = points @ _projected(long, main), points @ _projected(short, main)
    side = across.min() if abs(across.min() - across.mean()) > abs(across.max() - across.mean()) else across.max()
    row = np.abs(across - side) <= 0.35 * np.ptp(across) + 1e-9
    ends = [int(np.flatnonzero(row)[np.argmin(along[row])]), int(np.flatnonzero(row)[np.argmax(along[row])])]
    middle = int(np.argmin(np.abs(across - across.mean()) + (along - along.min())))
    rows = [(places[i], short) for i in ends] + [(places[middle], long)]
    return [Support(place.point, f"in-plane {axis}", _projected(axis, place.normal)) for place, axis in rows]


def _pivoted(places: list[Place]) -> list[Support]:
    """Six rows among all places and directions, by QR with pivoting."""
    every = []
    for place in places:
        axes = _axes(place.normal)
        every.append(Support(place.point, "normal", place.normal))
        every += [Support(place.point, f"in-plane {axis}", _projected(axis, place.normal)) for axis in axes]
    points, directions = (np.array([getattr(one, key) for one in every]) for key in ("point", "direction"))
    G = _readings(points, directions, _extent(points) / 2)
    order = qr(G.T, pivoting=True, mode="r")[1]
    return sorted((every[i] for i in order[:6]), key=lambda one: one.words != "normal")


def _further(six: list[Support], places: list[Place]) -> list[Support]:
    """Supports along the normal at places far from the others."""
    held = np.array([one.point for one in six])
    points = np.array([place.point for place in places])
    least = 0.3 * _extent(points)
    found: list[Support] = []
    while len(found) < FURTHER:
        away = cKDTree(held).query(points)[0]
        best = int(np.argmax(away))
        if away[best] < least:
            break
        found.append(Support(points[best], "normal", places[best].normal, further=True))
        held = np.vstack([held, points[best]])
    return found


def _axes(normal: np.ndarray) -> list[str]:
    """The two axes with the smallest angles to a plane."""
    return ["xyz"[i] for i in sorted(np.argsort(np.abs(normal), kind="stable")[:2])]


def _projected(axis: str, normal: np.ndarray) -> np.ndarray:
    """An axis projected into a plane, of unit length."""
    unit = np.eye(3)["xyz".index(axis)]
    laid = unit - (unit @ normal) * normal
    return laid / np.linalg.norm(laid)


def _extent(points: np.ndarray) -> float:
    return float(np.linalg.norm(np.ptp(points, axis=0)))


def spread(points: np.ndarray, count: int, near: np.ndarray | None = None) -> np.ndarray:
    """Indices of points by farthest-point sampling; the first is farthest from `near`, or from the centre."""
    away = np.linalg.norm(points - points.mean(0), axis=1) if near is None else cKDTree(near).query(points)[0]
    chosen = []
    for step in range(min(count, len(points))):
        chosen.append(int(np.argmax(away)))
        own = np.linalg.norm(points - points[chosen[-1]], axis=1)
        away = own if near is None and step == 0 else np.minimum(away, own)
    return np.array(chosen, dtype=np.int64)
