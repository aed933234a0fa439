"""Sampling points of one surface and their projections on a facing surface."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from mic.geometry.pairing.contact_pair import ContactPair, Side
from mic.geometry.surface import Patch
from mic.geometry.triangles import place_text

__all__ = ["Bodies", "FacingPoints"]

FINE = 6  # sampling points across a cell
OPPOSITE = -0.5  # cosine between normals: below it, two points lie on different sides of a sheet
SIDEWAYS = 0.05  # of the thinner sheet: distance of a closest point from the normal where surfaces touch


@dataclass(frozen=True)
class FacingPoints:
    """Sampling points of one surface that face the other.

    Attributes
    ----------
    triangle, barycentric, point : (n,), (n, 3) and (n, 3) array
    normal : (n, 3) array
        Normals of the sampled surface, pointing towards the other body.
    area : (n,) array
        Area or length that each point represents.
    distance : (n,) array
        Distance between the mid-surfaces along the normal, mm.
    other_triangle, other_barycentric : (n,) and (n, 3) array
        Closest point on the other surface.
    """

    triangle: np.ndarray
    barycentric: np.ndarray
    point: np.ndarray
    normal: np.ndarray
    area: np.ndarray
    distance: np.ndarray
    other_triangle: np.ndarray
    other_barycentric: np.ndarray

    def take(self, index):
        """The points of an index array."""
        return FacingPoints(*(values[index] for values in vars(self).values()))

    @staticmethod
    def joined(parts: Sequence[FacingPoints]) -> FacingPoints:
        """All points of several sets."""
        return FacingPoints(*(np.concatenate(values) for values in zip(*(vars(part).values() for part in parts))))

    def seen_from(self, body: Side) -> FacingPoints:
        """The same points as sampling points of the other body, which they were projected onto."""
        point = body.surface.at(self.other_triangle, self.other_barycentric)
        along = np.einsum("ij,ij->i", self.point - point, body.surface.normals[self.other_triangle])
        sign = np.where(along < -body.surface.tie, -1.0, 1.0)
        normal = body.surface.smooth_normals(self.other_triangle, self.other_barycentric) * sign[:, None]
        other = self.other_triangle, self.other_barycentric
        return FacingPoints(*other, point, normal, self.area, along * sign, self.triangle, self.barycentric)


@dataclass(frozen=True)
class Bodies:
    """The two bodies of a zone: the one that is sampled and the other one.

    Attributes
    ----------
    zone : mic.scene.zone.Zone
    sampled, other : Side
    swapped : bool
        Whether the sampled body is the second one of the zone.
    max_gap, max_angle : float
        Limits within which points face each other, mm and radians.
    """

    zone: Any
    sampled: Side
    other: Side
    swapped: bool
    max_gap: float
    max_angle: float

    @classmethod
    def of(cls, zone, first: Side, second: Side) -> Bodies:
        """The bodies of a zone; the deformable one is sampled, as the mesh of a rigid fixture may be coarse."""
        sampled, other = (second, first) if first.rigid else (first, second)
        return cls(zone, sampled, other, first.rigid, zone.max_gap, np.radians(zone.max_angle_deg))

    def reversed(self) -> Bodies:
        """The same with the other body sampled."""
        return replace(self, sampled=self.other, other=self.sampled, swapped=not self.swapped)

    @property
    def tie(self) -> float:
        """Distances below this count as zero, mm: the larger tie of both."""
        return max(self.sampled.surface.tie, self.other.surface.tie)

    @property
    def thinner(self) -> float:
        """Smallest thickness of the deformable bodies, mm."""
        return min(body.thickness for body in (self.sampled, self.other) if body.thickness is not None)

    @property
    def reach(self) -> float:
        """Largest distance between facing mid-surfaces, mm."""
        return self.max_gap + self.sampled.half_thickness + self.other.half_thickness

    def anchors(self, landmarks) -> list:
        """Points whose distances break ties."""
        return [self.sampled.surface.centroid, self.other.surface.centroid, *landmarks]

    def gap(self, cloud: FacingPoints) -> np.ndarray:
        """(n,) gaps between the facing surfaces, mm."""
        return cloud.distance - self.sampled.half_thickness - self.other.half_thickness

    def pair(self, cloud, area):
        """Contact pair of a cell; t1 and t2 of its frame are not set.

        Raises
        ------
        ValueError
            If the normals of the cell cancel because the surfaces cross.
        """
        weight = cloud.area / cloud.area.sum()
        n = weight @ cloud.normal
        if not np.linalg.norm(n) > 0.1:
            where = place_text(weight @ cloud.point)
            raise ValueError(f"the surfaces intersect at {where}; correct the meshes so that they do not")
        n /= np.linalg.norm(n)
        apart = self.gap(cloud)
        overlaps = apart < -self.tie
        sides = [
            int(np.sign(weight @ np.einsum("ij,j->i", body.surface.normals[triangle], n) * sign))
            for body, triangle, sign in ((self.sampled, cloud.triangle, 1), (self.other, cloud.other_triangle, -1))
        ]
        patches = [
            Patch(cloud.triangle, cloud.barycentric, weight),
            Patch(cloud.other_triangle, cloud.other_barycentric, weight),
        ]
        if self.swapped:
            n, sides, patches = -n, sides[::-1], patches[::-1]
        return ContactPair(
            weight @ cloud.point,
            np.column_stack([n, np.zeros((3, 2))]),
            float(weight @ apart),
            float((-apart[overlaps]).max(initial=0.0)),
            float(weight[overlaps].sum()),
            float(area),
            tuple(patches),
            tuple(sides),
        )

    def sample(self, spacing=None, pads=()):
        """Sampling points of the zone at a spacing, mm, by default the median edge length; finer near pads.

        Raises
        ------
        ValueError
            If the surfaces face each other nowhere in the zone.
        """
        surface = self.sampled.surface
        spacing = float(np.median(surface.edge_lengths)) if spacing is None else spacing
        middle = surface.corners.mean(1)
        step = np.full(len(middle), spacing)
        for one, apart in pads:
            near = np.linalg.norm(middle - one.point, axis=1) <= surface.reach + 2 * one.radius + surface.tie
            step[near] = np.minimum(step[near], apart / FINE)
        step[~self.in_region(middle, surface.reach + 2 * surface.tie)] = 0.0
        parts = [surface.sample(np.flatnonzero(step == one), one) for one in np.unique(step[step > 0])[::-1]]
        if parts:
            triangle, barycentric, area = (np.concatenate(columns) for columns in zip(*parts))
            inside = self.in_region(surface.at(triangle, barycentric), surface.tie)
            cloud = self.project(triangle[inside], barycentric[inside], area[inside])
            if len(cloud.area):
                return cloud
        raise ValueError(
            f"no contact pair: nowhere in the region do the two surfaces face each other with a gap below "
            f"max_gap = {self.zone.max_gap} mm and an angle below max_angle_deg = {self.zone.max_angle_deg}; "
            "move the region, or raise these limits"
        )

    def in_region(self, x, margin):
        """(n,) bool: whether points lie in the zone's region, widened by `margin`, a number or (n,) array, mm."""
        zone = self.zone
        if zone.box is not None:
            low, high = np.array(zone.box)
            margin = np.reshape(margin, (-1, 1))
            return ((x >= low - margin) & (x <= high + margin)).all(1)
        if zone.path is not None:
            path = np.array(zone.path)
            if len(path) == 1:
                return np.linalg.norm(x - path[0], axis=1) <= zone.within + margin
            start, edge = path[:-1], np.diff(path, axis=0)
            s = np.einsum("nij,ij->ni", x[:, None] - start, edge) / np.einsum("ij,ij->i", edge, edge)
            foot = start + np.clip(s, 0, 1)[..., None] * edge
            return np.linalg.norm(x[:, None] - foot, axis=2).min(1) <= zone.within + margin
        return np.ones(len(x), dtype=bool)

    def project(self, triangle, barycentric, area, normal=None, both=True) -> FacingPoints:
        """Sampling points with their closest points on the other surface; points that face nothing are left out.

        With `both`, a point that faces the other body on both sides of the sheet appears twice.
        """
        surface, opposite = self.sampled.surface, self.other.surface
        point = surface.at(triangle, barycentric)
        smooth = surface.smooth_normals(triangle, barycentric) if normal is None else normal
        normal = surface.normals[triangle] if normal is None else normal
        beside = np.tan(self.max_angle) * self.reach + SIDEWAYS * self.thinner
        farthest = np.hypot(self.reach, beside) + 3 * self.tie

        def facing(rows, side=None):
            foot = opposite.project(point[rows], normal[rows], self.max_angle, farthest, side)
            good, along = self._faces_foot(point[rows], normal[rows], foot)
            sign = np.where(along < -self.tie, -1.0, 1.0)[good]
            rows, along = rows[good], along[good]
            place = triangle[rows], barycentric[rows], point[rows]
            foot = foot.triangle[good], foot.barycentric[good]
            return FacingPoints(*place, smooth[rows] * sign[:, None], area[rows], along * sign, *foot), (rows, sign)

        cloud, (rows, sign) = facing(np.arange(len(point)))
        if both:
            maybe = opposite.behind(surface, cloud.triangle, sign, farthest, self.max_angle)
            if maybe.any():
                cloud = FacingPoints.joined([cloud, facing(rows[maybe], -sign[maybe])[0]])
        return cloud

    def _faces_foot(self, point, normal, foot):
        """(n,) bool whether each point faces its closest point, and (n,) distance to it along the normal, mm."""
        step = np.where(foot.triangle[:, None] >= 0, foot.point - point, np.nan)
        along = np.einsum("ij,ij->i", step, normal)
        # A closest point off the normal line does not face the point: it lies past a bend or corner.
        sideways = np.linalg.norm(step - along[:, None] * normal, axis=1)
        # Neither does one on the border of the other surface that is not the foot of a perpendicular.
        across = np.linalg.norm(np.cross(step, self.other.surface.normals[foot.triangle]), axis=1)
        with np.errstate(invalid="ignore"):
            good = (
                (foot.triangle >= 0)
                & (np.abs(along) <= self.reach + self.tie)
                & (sideways <= np.tan(self.max_angle) * np.abs(along) + SIDEWAYS * self.thinner + self.tie)
                & ~(foot.at_border & (across > 1e-3 * foot.distance + self.tie))
            )
        if self.other.disc is not None:
            centre, radius = self.other.disc
            good &= np.linalg.norm(foot.point - np.array(centre), axis=1) <= radius + self.tie
        return good, along
