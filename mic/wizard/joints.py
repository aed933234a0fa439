"""Welds and tongs in laps, and the parts of listed welds.

Welds are 10 mm off the edge of the lap, or in the middle of a narrower flange, along it. Tongs are between them. Both
are chosen among the points of sufficient depth by farthest-point sampling, until the distance falls below the pitch.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.spatial import cKDTree

from mic.wizard.bodies import NO_POINTS, Body
from mic.wizard.faying import Faying
from mic.wizard.fixture import spread

__all__ = ["Joints", "at_pitch", "force", "joined", "propose_joints"]

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


def propose_joints(
    lap: Faying,
    gap: np.ndarray,
    listed: np.ndarray | None = None,
    other_welds: np.ndarray = NO_POINTS,
    other_tongs: np.ndarray = NO_POINTS,
) -> Joints:
    """Welds and tongs of a lap; tongs only if welds are `listed`, (n, 3).

    Every piece of the lap with room for a nugget gets a weld, where possible at flat places with small gaps.

    Parameters
    ----------
    lap : Faying
    gap : (n,) array
        Between the facing surfaces at its points, mm.
    listed : (w, 3) array, optional
    other_welds, other_tongs : (n, 3) array
        Welds and tongs of laps that share a sheet with this one.
    """
    candidates, pitch = _candidates(lap, gap), PITCH
    stack_welds = other_welds[_on_lap(lap, other_welds)]
    through = np.flatnonzero(_on_lap(lap, other_tongs))
    stack_tongs = other_tongs[through]
    if listed is None:
        while len(chosen := _weld_points(candidates, pitch, stack_welds)) > MOST and pitch <= 1e4:
            pitch *= 1.25
    welds = np.concatenate([stack_welds, chosen]) if listed is None else listed
    occupied = np.concatenate([welds, stack_tongs])
    tongs = NO_POINTS
    for points in candidates:
        present = np.count_nonzero(cKDTree(points).query(stack_tongs)[0] <= DEEP)
        count = max(1, round(len(at_pitch(points, pitch)) / 2)) - present
        for point in points[spread(points, count, occupied)]:
            others = np.concatenate([occupied, tongs])
            if np.linalg.norm(others - point, axis=1).min(initial=np.inf) >= CLEAR:
                tongs = np.vstack([tongs, point])
    if listed is None:
        proposed = welds[len(stack_welds) :]
        welds[len(stack_welds) :] = (proposed + lap.second.surface.project(proposed).point) / 2
    return Joints(welds, tongs, through)


def _on_lap(lap: Faying, points: np.ndarray) -> np.ndarray:
    """(n,) whether points of other laps are on this one along its normal, a nugget's width off its edge."""
    if not len(points):
        return np.zeros(0, dtype=bool)
    near = cKDTree(lap.point).query(points)[1]
    step = points - lap.point[near]
    along = np.einsum("ij,ij->i", step, lap.normal[near])
    beside = np.linalg.norm(step - along[:, None] * lap.normal[near], axis=1)
    reach = NEAR + (lap.first.thickness + lap.second.thickness)
    return (beside <= lap.spacing) & (np.abs(along) <= reach) & (lap.depth[near] >= LEAST)


def _candidates(lap: Faying, gap: np.ndarray) -> list[np.ndarray]:
    """(n, 3) possible points of welds, mm, in each piece of a lap with room for a nugget."""
    around = cKDTree(lap.point).query_ball_point(lap.point, max(LEAST, 2.5 * lap.spacing))
    flat = np.array([float((lap.normal[near] @ normal).min()) for normal, near in zip(lap.normal, around)])
    candidates = []
    for number in range(lap.piece.max() + 1):
        piece = np.flatnonzero(lap.piece == number)
        depth = lap.depth[piece]
        if depth.max() < LEAST:
            continue
        around = cKDTree(lap.point[piece]).query_ball_point(lap.point[piece], 1.5 * DEEP)
        wanted = np.minimum(DEEP, 0.85 * np.array([depth[near].max() for near in around]))
        deep = (depth >= np.maximum(wanted, LEAST)) & (depth <= np.maximum(DEEP, wanted) + 1.5 * lap.spacing)
        close = gap[piece] <= np.quantile(gap[piece], 0.25) + CLOSE
        good = deep & close & (flat[piece] >= np.cos(np.radians(FLAT)))
        chosen = piece[good] if good.any() else piece[deep]
        candidates.append(lap.point[chosen if len(chosen) else piece[[int(np.argmax(depth))]]])
    return candidates


def _weld_points(candidates: list[np.ndarray], pitch: float, given: np.ndarray) -> np.ndarray:
    return np.concatenate([NO_POINTS, *(points[at_pitch(points, pitch, given)] for points in candidates)])


def at_pitch(points: np.ndarray, pitch: float, given: np.ndarray = NO_POINTS) -> np.ndarray:
    """Indices of points a pitch apart and a pitch off `given`, the ends first; at least two if half a pitch apart."""
    chosen = spread(points, 4 * MOST, given)
    at = points[chosen]
    if not len(given) and len(at) > 1 and np.linalg.norm(at[1] - at[0]) < pitch:
        return chosen[: 2 if np.linalg.norm(at[1] - at[0]) >= pitch / 2 else 1]
    for i, point in enumerate(at):
        others = np.concatenate([given, at[:i]])
        if np.linalg.norm(others - point, axis=1).min(initial=np.inf) < 0.75 * pitch:
            return chosen[:i]
    return chosen


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
    return float(round(value / digit) * digit)
