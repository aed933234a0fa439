"""Contact of two sheets: the vertices of one against the faces of the other."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.sparse import csr_matrix

from fem_reference.sheet import Place, Sheet
from fem_reference.shell.part import ShellPart
from mic.compliance.functional import Functionals
from mic.geometry.surface import Patch

__all__ = ["Contact", "Pairs"]

FACING = np.tan(np.radians(30.0))  # largest sideways distance of a facing point, relative to that along the normal
BESIDE = 0.05  # further sideways distance allowed, in thicknesses of the thinner sheet


@dataclass(eq=False)
class Contact:
    """Unilateral contact of two sheets with Coulomb friction, at the vertices of the first sheet.

    Attributes
    ----------
    first, second : Sheet
        The finer mesh first: vertices of the second sheet are not checked.
    friction : float
        μ.
    where : Place or None
        Vertices of the first sheet that may touch; None for all that face the second sheet.
    reach : float
        Largest gap between the facing surfaces at which a pair is formed, mm.
    """

    first: Sheet
    second: Sheet
    friction: float
    where: Place | None = None
    reach: float = 2.0


@dataclass(frozen=True)
class Pairs:
    """Pairs of a contact: vertices (m,) of the first sheet, frames (m, 3, 3) with columns n, t1, t2, gaps (m,), mm."""

    vertex: np.ndarray
    frame: np.ndarray
    gap: np.ndarray
    sides: np.ndarray
    patches: tuple[tuple[Patch, ...], tuple[Patch, ...]]

    @classmethod
    def of(cls, contact: Contact) -> Pairs:
        first, second = (sheet.shell for sheet in (contact.first, contact.second))
        surface, other = first.surface, second.surface
        names = f"contact of {contact.first.name!r} and {contact.second.name!r}"
        if not (np.isfinite(contact.friction) and contact.friction >= 0):
            raise ValueError(f"{names}: friction must not be negative, but is {contact.friction}")
        everywhere = np.arange(len(surface.points))
        vertex = everywhere if contact.where is None else contact.first.marked(contact.where)
        half = (first.thickness + second.thickness) / 2
        normal = surface.vertex_normals[vertex]
        beside = BESIDE * min(first.thickness, second.thickness)
        reach = contact.reach + half
        foot = other.project(surface.points[vertex], normal, reach=np.hypot(reach, FACING * reach + beside))
        step = np.where(foot.triangle[:, None] >= 0, foot.point - surface.points[vertex], np.nan)
        along = np.einsum("ij,ij->i", step, normal)
        sideways = np.linalg.norm(step - along[:, None] * normal, axis=1)
        with np.errstate(invalid="ignore"):
            faces = np.flatnonzero((np.abs(along) <= reach) & (sideways <= FACING * np.abs(along) + beside))
        if not len(faces):
            raise ValueError(f"{names}: no vertex faces the second sheet within {contact.reach:g} mm; raise reach")
        vertex, sign = vertex[faces], np.where(along[faces] < 0, -1.0, 1.0)
        n = normal[faces] * sign[:, None]
        axis = np.eye(3)[np.abs(n).max(axis=0).argmin()]  # least aligned with any normal
        t1 = axis - (n @ axis)[:, None] * n
        t1 /= np.linalg.norm(t1, axis=1)[:, None]
        own = np.array([np.argmax((surface.triangles == v).any(axis=1)) for v in vertex])
        corner = np.argmax(surface.triangles[own] == vertex[:, None], axis=1)
        triangle, barycentric = foot.triangle[faces], foot.barycentric[faces]
        sides = [
            np.sign(s * np.einsum("ij,ij->i", body.normals[t], n))
            for s, body, t in ((1, surface, own), (-1, other, triangle))
        ]
        return cls(
            vertex,
            np.stack([n, t1, np.cross(n, t1)], axis=2),
            np.abs(along[faces]) - half,
            np.array(sides),
            (
                tuple(Patch(np.array([t]), np.eye(3)[[c]], np.ones(1)) for t, c in zip(own, corner)),
                tuple(Patch(np.array([t]), b[None], np.ones(1)) for t, b in zip(triangle, barycentric)),
            ),
        )

    def rows(self, shell: ShellPart, body: int) -> csr_matrix:
        """(3 m, n) motion n, t1, t2 of the faces of one body at the pairs."""
        m = len(self.vertex)
        direction = self.frame.transpose(0, 2, 1).reshape(-1, 3)
        functionals = Functionals(
            self.patches[body],
            np.repeat(np.arange(m), 3),
            direction,
            np.zeros(3 * m, dtype=bool),
            np.repeat(self.sides[body], 3),
            ("",) * (3 * m),
        )
        return shell.functional_matrix(functionals)
