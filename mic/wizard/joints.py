"""Welds and tongs in laps, and the parts of listed welds.

Welds are 10 mm off the edge of the lap, or in the middle of a narrower flange, along it. Tongs are between them. Both
are chosen among the points of sufficient depth by farthest-point sampling, until the distance falls below the pitch.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.spatial import cKDTree

from mic.wizard.bodies import Body
from mic.wizard.faying import Faying
from mic.wizard.fixture import spread

__all__ = ["Joints", "force", "joined", "propose_joints"]

DEEP = 10.0  # mm from the edge of a lap
LEAST = 4.0  # mm: least depth of a lap for a nugget of 5 mm
CLOSE = 0.1  # mm above the lower quartile of the gaps of a lap
FLAT = 12.0  # degrees by which normals turn around a weld
PITCH = 45.0  # mm between welds
MOST = 12  # welds of a pair of parts
CLEAR = 8.0  # mm between the centres of a tong and a weld
NEAR = 5.0  # mm: a listed weld joins the parts within this distance


@dataclass(frozen=True)
class Joints:
    """The joints of two parts.

    Attributes
    ----------
    welds, tongs : (n, 3) array
        mm, midway between the drawn surfaces, or in a stack.
    through : (m,) int array
        Tongs of other laps that also press this one.
    """

    welds: np.ndarray
    tongs: np.ndarray
    through: np.ndarray


NONE = np.zeros((0, 3))


def propose_joints(
    lap: Faying,
    gap: np.ndarray,
    listed: np.ndarray | None = None,
    welded: np.ndarray = NONE,
    pressed: np.ndarray = NONE,
) -> Joints:
    """Welds and tongs of a lap; tongs only if welds are `listed`, (n, 3).

    Every piece of the lap with room for a nugget gets a weld, where possible at flat places with small gaps.

    Parameters
    ----------
    lap : Faying
    gap : (n,) array
        Between the facing surfaces at its points, mm.
    listed : (w, 3) array, optional
    welded, pressed : (n, 3) array
        Welds and tongs of laps that share a sheet with this one.
    """
    pitch, lines = PITCH, _lines(lap, gap)
    through, pressing = welded[_on_lap(lap, welded)], np.flatnonzero(_on_lap(lap, pressed))
    while True:
        welds = (
            [] if listed is not None else [one for own in lines for one in own[_row(lap.point[own], pitch, through)]]
        )
        if len(welds) <= MOST or pitch > 1e4:
            break
        pitch *= 1.25
    points = np.concatenate([through, lap.point[np.array(welds, dtype=np.int64)]]) if listed is None else listed
    tongs: list[int] = []
    for own in lines:
        at = lap.point[own]
        there = cKDTree(at).query(pressed[pressing])[0] <= DEEP
        count = max(1, round(len(_row(at, pitch)) / 2)) - int(there.sum())
        near = np.concatenate([points, pressed[pressing]])
        for one in spread(at, max(0, count), near if len(near) else None):
            others = np.concatenate([near, lap.point[np.array(tongs, dtype=np.int64)]])
            if not len(others) or np.linalg.norm(others - at[one], axis=1).min() >= CLEAR:
                tongs.append(own[one])
    if listed is None:
        points = np.concatenate([through, _middle(lap, points[len(through) :])])
    return Joints(points, lap.point[np.array(tongs, dtype=np.int64)], pressing)


def _on_lap(lap: Faying, points: np.ndarray) -> np.ndarray:
    """(n,) whether points of other laps are on this one along its normal, a nugget's width off its edge."""
    if not len(points):
        return np.zeros(0, dtype=bool)
    near = cKDTree(lap.point).query(points)[1]
    step = points - lap.point[near]
    along = np.einsum("ij,ij->i", step, lap.normal[near])
    beside = np.linalg.norm(step - along[:, None] * lap.normal[near], axis=1)
    thick = lap.first.thickness + lap.second.thickness
    return (beside <= lap.spacing) & (np.abs(along) <= NEAR + thick) & (lap.depth[near] >= LEAST)


def _lines(lap: Faying, gap: np.ndarray) -> list[np.ndarray]:
    """Points for welds in each piece with room."""
    lines = []
    around = cKDTree(lap.point).query_ball_point(lap.point, max(LEAST, 2.5 * lap.spacing))
    flat = np.array([float((lap.normal[own] @ lap.normal[i]).min()) for i, own in enumerate(around)])
    for piece in range(lap.piece.max() + 1):
        own = np.flatnonzero(lap.piece == piece)
        depth = lap.depth[own]
        if depth.max() < LEAST:
            continue
        near = cKDTree(lap.point[own]).query_ball_point(lap.point[own], 1.5 * DEEP)
        deepest = np.array([depth[each].max() for each in near])
        wanted = np.minimum(DEEP, 0.85 * deepest)
        fits = (depth >= np.maximum(wanted, LEAST)) & (depth <= np.maximum(DEEP, wanted) + 1.5 * lap.spacing)
        closest = gap[own] <= np.quantile(gap[own], 0.25) + CLOSE
        good = fits & closest & (flat[own] >= np.cos(np.radians(FLAT)))
        chosen = own[good] if good.any() else own[fits]
        lines.append(chosen if len(chosen) else own[[int(np.argmax(depth))]])
    return lines


def _row(points: np.ndarray, pitch: float, given: np.ndarray = NONE) -> np.ndarray:
    """Indices of points a pitch apart, the ends first; at least two if half a pitch apart; a pitch off `given`."""
    if len(given):
        chosen = spread(points, min(len(points), 4 * MOST), given)
        others = [np.concatenate([given, points[chosen[:i]]]) for i in range(len(chosen))]
        off = [float(np.linalg.norm(own - points[one], axis=1).min()) for own, one in zip(others, chosen)]
        return chosen[: next((i for i, one in enumerate(off) if one < 0.75 * pitch), len(off))]
    chosen = spread(points, min(len(points), 4 * MOST))
    at = points[chosen]
    if len(at) > 1 and np.linalg.norm(at[1] - at[0]) < pitch:
        return chosen[: 2 if np.linalg.norm(at[1] - at[0]) >= pitch / 2 else 1]
    away = [np.inf] + [float(np.linalg.norm(at[:i] - at[i], axis=1).min()) for i in range(1, len(at))]
    return chosen[: next((i for i, one in enumerate(away) if one < 0.75 * pitch), len(away))]


def _middle(lap: Faying, points: np.ndarray) -> np.ndarray:
    foot = lap.second.surface.project(points)
    return (points + foot.point) / 2


def joined(point: np.ndarray, bodies: list[Body]) -> tuple[list[tuple[str, str]], list[tuple[str, float]]]:
    """The parts that a weld at a point joins, in pairs of neighbours in the stack.

    Returns
    -------
    pairs : list of (str, str)
        Empty if there are fewer than two parts within reach.
    nearest : list of (str, float)
        The parts by their distance, mm.
    """
    feet = [body.surface.project(point) for body in bodies]
    order = np.argsort([foot.distance[0] for foot in feet])
    nearest = [(bodies[i].name, float(feet[i].distance[0])) for i in order]
    within = [i for i in order if feet[i].distance[0] <= NEAR]
    if len(within) < 2:
        return [], nearest
    n = bodies[within[0]].surface.normals[feet[within[0]].triangle[0]]
    stack = sorted(within, key=lambda i: float((feet[i].point[0] - point) @ n))
    return [(bodies[a].name, bodies[b].name) for a, b in zip(stack, stack[1:])], nearest


def force(first: Body, second: Body) -> float:
    """Force of a tong, N: 100 N/mm² times the squared thickness of the thinner sheet, to one digit."""
    value = 100.0 * min(first.thickness, second.thickness) ** 2
    digit = 10.0 ** np.floor(np.log10(value))
    return float(max(1.0, round(value / digit)) * digit)
