"""A 3-2-1 for a part, and further supports: where it is held, and how well that holds it.

Three locators along the sheet's normal stand where the sheet looks along its main direction, and span the largest
triangle; two across the line along which the part is longest, as far apart as there is room; one along it. Round holes
take the pins where the part has two, far enough apart. What is chosen is judged by the singular values of the readings
G of the part's rigid motions,

    G_i = [d_i, (x_i − c) × d_i / ρ],        c the middle of the points, ρ half their extent,

and where such a 3-2-1 holds the part badly, six rows are chosen of all places and directions by pivoting instead.
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
FLAT = 12.0  # degrees: over a pad, normals turn by no more
MAIN = 25.0  # degrees about the main direction within which the first three locators push
ENOUGH = 0.1  # least ratio of the singular values of G of a 3-2-1 that is taken
SHARE = 0.6  # or of that of the best six rows of any kind
PIN = (4.0, 40.0)  # mm, diameters of holes that pins go through
MOST = 400  # places that are looked at
TRIED = 100  # directions among which the main one is sought
FURTHER = 3  # supports of a part beyond the six, at most


@dataclass(frozen=True)
class Place:
    """Where a pad may stand.

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
        Its direction as a scene says it.
    direction : (3,) array
    hole : bool
        Whether a pin in a hole does it.
    further : bool
        Whether it is one beyond the six.
    """

    point: np.ndarray
    words: str
    direction: np.ndarray
    hole: bool = False
    further: bool = False


def conditioning(supports: list[Support]) -> float:
    """Smallest over largest singular value of G; 0 where a motion is free."""
    return _conditioning(np.array([one.point for one in supports]), np.array([one.direction for one in supports]))


def _conditioning(points: np.ndarray, directions: np.ndarray) -> float:
    values = np.linalg.svd(_readings(points, directions), compute_uv=False)
    return float(values[5] / values[0]) if len(values) == 6 else 0.0


def _readings(points: np.ndarray, directions: np.ndarray, scale: float | None = None) -> np.ndarray:
    arms = points - points.mean(0)
    size = scale or max(1e-9, float(np.linalg.norm(np.ptp(points, axis=0)) / 2))
    return np.column_stack([directions, np.cross(arms, directions) / size])


def find_places(body: Body) -> list[Place]:
    """Flat places of a part, a pad's radius off its edges, spread over it; any places where it has no such."""
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
        Where it lies on other parts, mm: left free if what remains holds it well.
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
    """A 3-2-1, with pins in holes if there are two; six rows of any kind where it holds the part badly."""
    pivoted = [(_pivoted(places), places) for places in options]
    best = max(pivoted, key=lambda one: conditioning(one[0]))
    enough = min(ENOUGH, SHARE * conditioning(best[0]))  # a narrow strip is held badly by any six
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
    """The direction about which most of the sheet looks, either way: of an angle that of its larger leg."""
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
    """A pin in one hole, both ways, and in the farthest other one, across the line between them; none for one hole."""
    if len(holes) < 2:
        return []
    centres = np.array([hole.centre for hole in holes])
    apart = np.linalg.norm(centres[:, None] - centres[None], axis=2)
    i, j = np.unravel_index(int(np.argmax(apart)), apart.shape)
    words = _axes(main)
    across = min(words, key=lambda axis: abs(_laid(axis, holes[j].normal) @ (centres[j] - centres[i])))
    rows = [(holes[i], axis) for axis in words] + [(holes[j], across)]
    return [Support(hole.centre, f"in-plane {axis}", _laid(axis, hole.normal), hole=True) for hole, axis in rows]


def _two_and_one(places: list[Place], main: np.ndarray) -> list[Support]:
    """Two locators across the longer of two axes, at its ends, and one along it."""
    points = np.array([one.point for one in places])
    axes = _axes(main)
    extents = [float(np.ptp(points @ _laid(axis, main))) for axis in axes]
    long, short = (axes[i] for i in np.argsort(extents)[::-1])
    along, across = points @ _laid(long, main), points @ _laid(short, main)
    side = across.min() if abs(across.min() - across.mean()) > abs(across.max() - across.mean()) else across.max()
    row = np.abs(across - side) <= 0.35 * np.ptp(across) + 1e-9
    ends = [int(np.flatnonzero(row)[np.argmin(along[row])]), int(np.flatnonzero(row)[np.argmax(along[row])])]
    middle = int(np.argmin(np.abs(across - across.mean()) + (along - along.min())))
    rows = [(places[i], short) for i in ends] + [(places[middle], long)]
    return [Support(place.point, f"in-plane {axis}", _laid(axis, place.normal)) for place, axis in rows]


def _pivoted(places: list[Place]) -> list[Support]:
    """Six rows of all places and directions, chosen by pivoting."""
    every = []
    for place in places:
        axes = _axes(place.normal)
        every.append(Support(place.point, "normal", place.normal))
        every += [Support(place.point, f"in-plane {axis}", _laid(axis, place.normal)) for axis in axes]
    points, directions = (np.array([getattr(one, key) for one in every]) for key in ("point", "direction"))
    G = _readings(points, directions, _extent(points) / 2)
    order = qr(G.T, pivoting=True, mode="r")[1]
    return sorted((every[i] for i in order[:6]), key=lambda one: one.words != "normal")


def _further(six: list[Support], places: list[Place]) -> list[Support]:
    """Places along the normal that are far from what holds the part already."""
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
    """The two axes that lie most in a plane."""
    return ["xyz"[i] for i in sorted(np.argsort(np.abs(normal), kind="stable")[:2])]


def _laid(axis: str, normal: np.ndarray) -> np.ndarray:
    """An axis laid into a plane."""
    unit = np.eye(3)["xyz".index(axis)]
    laid = unit - (unit @ normal) * normal
    return laid / np.linalg.norm(laid)


def _extent(points: np.ndarray) -> float:
    return float(np.linalg.norm(np.ptp(points, axis=0)))


def spread(points: np.ndarray, count: int, near: np.ndarray | None = None) -> np.ndarray:
    """Numbers of points, each the farthest from those before; the first from `near`, or from the middle."""
    away = np.linalg.norm(points - points.mean(0), axis=1) if near is None else cKDTree(near).query(points)[0]
    chosen = []
    for step in range(min(count, len(points))):
        chosen.append(int(np.argmax(away)))
        own = np.linalg.norm(points - points[chosen[-1]], axis=1)
        away = own if near is None and step == 0 else np.minimum(away, own)
    return np.array(chosen, dtype=np.int64)
