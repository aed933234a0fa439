"""Laps: regions where two parts lie on each other, as drawn."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace

import numpy as np
from scipy.spatial import cKDTree

from mic.geometry.coincident_sheets import COINCIDENT, offsets
from mic.geometry.pairing import Side, pair_at
from mic.geometry.surface import Surface
from mic.geometry.triangles import components
from mic.wizard.bodies import Body

__all__ = ["Faying", "restrict", "find_faying", "nearest_distance", "pieces"]

GAP = 2.0  # mm between facing surfaces, the default of zones
ANGLE = 30.0  # degrees between facing surfaces, the default of zones
MOST = 40_000  # sample points
LEAST = 25.0  # mm²: smaller areas are no lap


@dataclass(frozen=True)
class Faying:
    """A lap of two parts.

    Attributes
    ----------
    first, second : Body
    point : (n, 3) array
        Sample points on the first part's surface, mm.
    normal : (n, 3) array
        Of the first part's surface.
    height : (n,) array
        Of the second part's drawn surface above the first one's, along the normals of the latter, mm.
    depth : (n,) array
        Distance from the boundary of the lap, mm.
    piece : (n,) int array
        Connected piece of each point, the largest piece first.
    area : float
        mm².
    spacing : float
        Approximate distance of neighbouring points, mm.
    side : float
        +1 if the second part is on the side of the first part's normals, −1 on the other, 0 if unknown.
    turned : float
        +1 if the normals of the two have the same direction, −1 if opposite.
    """

    first: Body
    second: Body
    point: np.ndarray
    normal: np.ndarray
    height: np.ndarray
    depth: np.ndarray
    piece: np.ndarray
    area: float
    spacing: float
    side: float
    turned: float

    @property
    def bodies(self) -> tuple[Body, Body]:
        """The two parts."""
        return self.first, self.second

    @property
    def names(self) -> tuple[str, str]:
        """Their names."""
        return self.first.name, self.second.name

    @property
    def coincident(self) -> bool:
        """Whether both are drawn on the touching skins: more points coincide than are a thickness apart."""
        share = np.abs(self.height) / ((self.first.thickness + self.second.thickness) / 2)
        coinciding, separate = np.mean(share < COINCIDENT), np.mean(np.abs(share - 1) < COINCIDENT)
        return bool(coinciding > 0 and coinciding >= separate)

    def gap(self, offset: Mapping[str, float]) -> np.ndarray:
        """(n,) gaps between the facing surfaces, mm, with these offsets of the sheets in thicknesses."""
        a, b = self.first, self.second
        shift = self.turned * offset[b.name] * b.thickness - offset[a.name] * a.thickness
        return (self.side or 1.0) * (self.height + shift) - (a.thickness + b.thickness) / 2


def find_faying(first: Body, second: Body) -> Faying | None:
    """The lap of two parts; None if there is none."""
    reach = GAP + (first.thickness + second.thickness) / 2
    a, b = first.surface, second.surface
    if (np.maximum(a.points.min(0), b.points.min(0)) - np.minimum(a.points.max(0), b.points.max(0)) > reach).any():
        return None
    triangles = _near(a, b, reach)
    spacing = max(min(first.element, second.element) / 2, float(np.sqrt(a.areas[triangles].sum() / MOST)))
    triangle, barycentric, area = a.sample(triangles, spacing)
    if not len(area):
        return None
    x, n = a.at(triangle, barycentric), a.normals[triangle]
    foot = b.project(x, n, np.radians(ANGLE), reach)
    near = np.isfinite(foot.distance) & (foot.distance <= reach)
    step = np.where(near[:, None], foot.point - x, 0.0)
    along = np.einsum("ij,ij->i", step, n)
    beside = np.linalg.norm(step - along[:, None] * n, axis=1)
    facing = near & (beside <= np.maximum(0.05 * min(first.thickness, second.thickness), 0.35 * np.abs(along)))
    if area[facing].sum() < LEAST:
        return None
    # Points outside the lap: elsewhere on the first sheet, and on its free edge.
    far = np.setdiff1d(np.arange(len(a.triangles)), triangles)
    outside = np.concatenate([x[~facing], a.corners[far].mean(1), first.edge])
    x, n, area, along = x[facing], n[facing], area[facing], along[facing]
    cosine = np.einsum("ij,ij->i", n, b.normals[foot.triangle[facing]])
    lap = Faying(
        first,
        second,
        point=x,
        normal=n,
        height=along,
        depth=cKDTree(outside).query(x)[0] if len(outside) else np.full(len(x), np.inf),
        piece=pieces(x, 2.5 * spacing),
        area=float(area.sum()),
        spacing=spacing,
        side=float(np.sign(area @ along)),
        turned=1.0 if area @ cosine >= 0 else -1.0,
    )
    return replace(lap, side=_side(first, second, x[int(np.argmax(lap.depth))])) if lap.coincident else lap


def restrict(lap: Faying, chosen: np.ndarray) -> Faying | None:
    """The lap restricted to some of its points, by a mask (n,); None if the area is too small."""
    area = lap.area * float(chosen.mean())
    if area < LEAST:
        return None
    point, depth = lap.point[chosen], lap.depth[chosen]
    if not chosen.all():
        depth = np.minimum(depth, cKDTree(lap.point[~chosen]).query(point)[0])
    return replace(
        lap,
        point=point,
        normal=lap.normal[chosen],
        height=lap.height[chosen],
        depth=depth,
        piece=pieces(point, 2.5 * lap.spacing),
        area=area,
    )


def nearest_distance(first: Body, second: Body) -> float:
    """Distance of two parts, mm, from the points of the first to the surface of the second."""
    points = first.surface.points[np.unique(first.surface.triangles)]
    tree = cKDTree(second.surface.points)
    nearest = np.argsort(tree.query(points)[0])[:50]
    return float(second.surface.project(points[nearest]).distance.min())


def _near(a: Surface, b: Surface, reach: float) -> np.ndarray:
    """Triangles of one surface that may be within reach of another."""
    tree = cKDTree(b.corners.mean(1))
    bound = reach + a.reach + b.reach.max()
    return np.flatnonzero(tree.query(a.corners.mean(1))[0] <= bound)


def pieces(points: np.ndarray, link: float) -> np.ndarray:
    """(n,) number of the connected piece of each point, the largest first."""
    pairs = cKDTree(points).query_pairs(link, output_type="ndarray")
    label = components(pairs[:, 0], pairs[:, 1], len(points))[1]
    rank = np.argsort(np.argsort(-np.bincount(label), kind="stable"), kind="stable")
    return rank[label]


def _side(first: Body, second: Body, point: np.ndarray) -> float:
    """Side of the first surface on which the second sheet is, from the rest of the two; 0 if unknown."""
    a, b = Side(first.surface, first.thickness), Side(second.surface, second.thickness)
    (share, _), known = offsets(pair_at(point, min(first.element, second.element), a, b), a, b)
    return -float(np.sign(share)) if known else 0.0
