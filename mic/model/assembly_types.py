"""Data types of an assembly: contact pairs, gap points, and parts with the rows over their retained functionals."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from scipy.sparse import csr_matrix

from mic.compliance.part import Part
from mic.contact.friction import Friction
from mic.geometry.deck import Deck
from mic.geometry.surface import Surface
from mic.model.rows import WithWelds
from mic.scene import Scene

__all__ = ["Assembly", "AssemblyRows", "Contacts", "GapPoints"]


@dataclass(frozen=True)
class Contacts:
    """The contact pairs of all zones, in the scene's order.

    Attributes
    ----------
    zone : (m,) int array
        Index of the pair's zone in ``scene.zones``.
    stages : (k,) array of str
        Names of the stages for which a zone states its own friction.
    friction : (k + 1, m) array
        Coefficients in these stages, then in all others.
    pressure : (m, q, 5) array
        Piecewise friction coefficient as a function of the normal force (`mic.contact.laws.pressure_dependent`); NaN
        for zones with a constant coefficient.
    compliance : (m,) array
        Tangential compliance ``1/(k_t A)``, mm/N; 0 for rigid sticking.
    gap : (m,) array
        Nominal gap between the facing surfaces, mm, positive when they are apart; 0 for closed overlap
        (:mod:`mic.model.overlap`).
    overlap, overlapping : (m,) array
        Deepest overlap within the pair as drawn, mm, and the overlapping area, mm².
    area : (m,) array
        Share of the zone's area, mm².
    watched : (m,) bool array
        Whether the pair is a candidate: the working set includes it only where it would penetrate.
    layer : (m,) array
        Through-thickness compliance of a candidate, ``(t_a + t_b)/2 / (E A)``, mm/N.
    nugget : (m,) int array
        Index of the weld whose nugget contains the candidate's centre, -1 for none. A finished weld replaces it.
    bearing : (m,) array
        Area A for pressure and stiffness per area, mm²: the share of the zone, or the disc given by ``patch``.
    point : (m, 3) array
        mm.
    frame : (m, 3, 3) array
        Columns ``[n, t1, t2]``; n points from the first body to the second.
    dimension : int
        Rows per pair: 3 (n, t1, t2), or 1 if nothing needs tangential motion.
    """

    zone: np.ndarray
    stages: np.ndarray
    friction: np.ndarray
    pressure: np.ndarray
    compliance: np.ndarray
    gap: np.ndarray
    overlap: np.ndarray
    overlapping: np.ndarray
    area: np.ndarray
    watched: np.ndarray
    layer: np.ndarray
    nugget: np.ndarray
    bearing: np.ndarray
    point: np.ndarray
    frame: np.ndarray
    dimension: int

    def __len__(self):
        return len(self.zone)

    @property
    def frictional(self) -> bool:
        """Whether any pair has friction."""
        return bool(self.friction.any() or self.pressure.shape[1])

    def excluded(self, welds: Sequence[int], absent_zones: Sequence[int] = ()) -> np.ndarray:
        """(m,) mask of candidates replaced by finished welds, and of pairs in absent zones."""
        return np.isin(self.nugget, welds) | np.isin(self.zone, absent_zones)

    def friction_in(self, stage: str) -> Friction:
        """Friction parameters of the pairs in a stage."""
        stages, pressure = [*self.stages, stage], None
        coefficient = self.friction[stages.index(stage)]
        if self.pressure.shape[1]:
            constant = np.isnan(self.pressure[:, 0, 0])
            pressure = np.where(constant[:, None, None], 0.0, self.pressure)
            pressure[constant, 1:, 0] = np.inf
            pressure[constant, 0, 1] = coefficient[constant]
        return Friction(coefficient, pressure, self.compliance)


@dataclass(frozen=True)
class GapPoints:
    """Points between the contact pairs, which carry no force: they show penetration that the pairs do not see.

    Attributes
    ----------
    zone : (q,) int array
        Index of each point's zone in ``scene.zones``.
    gap : (q,) array
        Nominal gap, mm, as in `Contacts`.
    nugget : (q,) int array
        Index of the weld whose nugget contains the point, -1 for none.
    point : (q, 3) array
        mm.
    """

    zone: np.ndarray
    gap: np.ndarray
    nugget: np.ndarray
    point: np.ndarray

    def __len__(self):
        return len(self.zone)


@dataclass(frozen=True)
class AssemblyRows(WithWelds):
    """The costly part of an :class:`Assembly`, cached on disk.

    Attributes
    ----------
    parts : tuple of Part
        With the meshes used for solving (:mod:`mic.model.refined_mesh`).
    rows : dict of str to (r, F) csr_matrix
        Rows over the stacked functionals of all parts (F in total), by kind (`mic.model.rows.KINDS`).
    labels : dict of str to list of str
        One name per row.
    contacts : Contacts
    between : GapPoints
    weld_size : tuple of int
        Rows of each weld; the first is its mean along the normal of the sheets, towards the second part.
    weld_gap : (r,) array
        Nominal gap read by each weld row, mm or rad: its mean and its tilt; 0 for tangential rows and closed overlap.
    spacing : tuple of float or None
        Distance between the candidates of each zone, mm; None for zones that state their pairs.
    position_gap : (q,) array
        Growth of the weld gap per unit motion of each position row; 0 for rows of other items.
    """

    parts: tuple[Part, ...]
    rows: dict[str, csr_matrix]
    labels: dict[str, list[str]]
    contacts: Contacts
    between: GapPoints
    weld_size: tuple[int, ...]
    weld_gap: np.ndarray
    spacing: tuple[float | None, ...]
    position_gap: np.ndarray


@dataclass(frozen=True)
class Assembly(AssemblyRows):
    """Parts with their retained functionals, and the rows that the process works with.

    Attributes
    ----------
    scene : Scene
        With values from the mesh files filled in and all items placed (:mod:`mic.model.placement`): points and
        directions are vectors, and every clamp acts on one part.
    inputs : dict of str to str
        Hashes of the input files of parts and fixtures.
    sizes : dict of str to float
        Element sizes, mm, of the parts that state an accuracy.
    decks : dict of str to Deck
        Further content of the parts' mesh files.
    placed : tuple of str
        Messages about each placed node, set, hole and tong, and each measured shape and field.
    surfaces : dict of str to Surface
        Surfaces of the parts as drawn, before refinement.
    identity : str
        Hash of all inputs and of the program.
    """

    scene: Scene
    inputs: dict[str, str | None]
    sizes: Mapping[str, float]
    decks: Mapping[str, Deck]
    placed: tuple[str, ...]
    surfaces: Mapping[str, Surface]
    identity: str

    @property
    def centres(self) -> np.ndarray:
        """(P, 3) centres of the parts' surfaces, mm."""
        return np.array([part.surface.centroid for part in self.parts])

    @property
    def offsets(self) -> np.ndarray:
        """First stacked functional of each part, and the total at the end."""
        return np.concatenate([[0], np.cumsum([len(part.functionals) for part in self.parts])])
