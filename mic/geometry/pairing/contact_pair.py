"""Bodies that may touch, places that press them together, and contact pairs."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from mic.geometry.pairing.cell_centres import first_maximum
from mic.geometry.surface import EQUAL, Patch, Surface

__all__ = ["ContactPair", "PressedPoint", "Side", "set_tangents", "weld_numbers"]


@dataclass(frozen=True)
class Side:
    """One of two bodies that may touch.

    Attributes
    ----------
    surface : Surface
    thickness : float or None
        mm; None for a rigid fixture.
    disc : tuple of ((3,) tuple, float), optional
        Centre and radius of a round pad, mm. Its triangles reach around the circle; only points within the circle
        count.
    """

    surface: Surface
    thickness: float | None = None
    disc: tuple[tuple[float, float, float], float] | None = None

    @property
    def rigid(self) -> bool:
        """Whether the body is a rigid fixture."""
        return self.thickness is None

    @property
    def half_thickness(self) -> float:
        """Distance from the surface to the faying surface, mm; 0 for a fixture, whose surface is the faying one."""
        return 0.0 if self.thickness is None else self.thickness / 2


@dataclass(frozen=True)
class ContactPair:
    """One contact pair.

    Attributes
    ----------
    point : (3,) array
        Centre of the patch on the first body's mid-surface, mm.
    frame : (3, 3) array
        Columns ``n, t1, t2``; n points from the first body to the second.
    gap : float
        Nominal gap between the facing surfaces, positive when separated, mm.
    overlap : float
        Deepest overlap of the undeformed facing surfaces within the patch, mm.
    overlapping : float
        Share of the patch in which they overlap.
    area : float
        Tributary area, mm².
    patches : tuple of two Patch
        Quadrature points on the first and the second body.
    sides : tuple of two int
        Side of each body that faces the other (+1: along its triangle normals); 0 for one that stands on its edge.
    nugget : int
        Number of the weld whose nugget contains the pair; -1 for none.
    spacing : float
        Intended distance to the neighbouring candidates, mm; NaN for a pair that is no candidate.
    offsets : tuple of two float, optional
        Where one body stands on the other by its edge: the points that are read, off the mid-surface of each, in half
        thicknesses along its normals.
    """

    point: np.ndarray
    frame: np.ndarray
    gap: float
    overlap: float
    overlapping: float
    area: float
    patches: tuple[Patch, Patch]
    sides: tuple[int, int]
    nugget: int = -1
    spacing: float = np.nan
    offsets: tuple[float, float] | None = None


@dataclass(frozen=True)
class PressedPoint:
    """Point where a clamp, weld or locator presses two sheets together.

    Attributes
    ----------
    point : (3,) array
        mm.
    radius : float
        Radius of a clamp's pad, of a weld's nugget, or of a rest that backs clamps, mm; 0 for any other locator. No
        candidate's cell crosses this circle; several candidates lie within a pad.
    weld : int
        Number of the weld; -1 for anything else.
    normal : (3,) array, optional
        Normal of a weld, from the zone's first body to its second. In a hem it excludes the sheet's other face, which
        looks the opposite way and is not joined. Without it the weld joins either face.
    backed_radius : float
        Largest pad radius of the clamps that a rest backs, mm; 0 for anything else.
    """

    point: np.ndarray
    radius: float = 0.0
    weld: int = -1
    normal: np.ndarray | None = None
    backed_radius: float = 0.0

    def covers(self, cloud, tie: float) -> np.ndarray:
        """(n,) bool: which points lie within the disc, seen along their normals."""
        step = cloud.point - self.point
        along = np.einsum("ij,ij->i", step, cloud.normal)
        sideways = np.linalg.norm(step - along[:, None] * cloud.normal, axis=1)
        inside = (sideways <= self.radius + tie) & (np.abs(along) <= cloud.distance + self.radius)
        return inside if self.normal is None else inside & (cloud.normal @ self.normal > 0)


def weld_numbers(pressed, cloud, tie) -> np.ndarray:
    """(n,) number of the weld whose nugget, seen along the normal, contains each point; -1 for none."""
    number = np.full(len(cloud.area), -1)
    for place in pressed:
        if place.weld >= 0:
            number[place.covers(cloud, tie)] = place.weld
    return number


def set_tangents(pairs):
    """Set t1 along the global axis least aligned with any normal, so that it varies smoothly over a zone."""
    axis = np.eye(3)[first_maximum(-np.abs([pair.frame[:, 0] for pair in pairs]).max(0), EQUAL)]
    for pair in pairs:
        n = pair.frame[:, 0]
        t1 = axis - (axis @ n) * n
        t1 /= np.linalg.norm(t1)
        pair.frame[:, 1:] = np.column_stack([t1, np.cross(n, t1)])
