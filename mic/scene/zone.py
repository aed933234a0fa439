"""The table of a contact zone, and of its friction."""

from __future__ import annotations

from typing import Annotated, Any, Literal

import numpy as np
from pydantic import AfterValidator, Discriminator, Field, Tag, model_validator

from mic.contact.laws import pressure_dependent
from mic.scene.keys import Count, FiniteFloat, Flag, Name, NonNegative, Positive, Table, Vector

__all__ = ["PressurePower", "Zone"]


MOST = 10.0  # coefficient of friction; rubber on rubber stays below 4


def _possible(value: float) -> float:
    if value > MOST:
        raise ValueError(
            f"{value:g} is no coefficient of friction: sheet on sheet has 0.05 to 0.6; correct it, or join by "
            "welds what must not slip"
        )
    return value


Friction = Annotated[NonNegative, AfterValidator(_possible)]


class PressurePower(Table):
    """A coefficient of friction as a bounded power of pressure."""

    mu0: Positive
    """μ at p0"""

    p0: Positive
    """MPa"""

    n: FiniteFloat
    """exponent, at most 1"""

    mu_min: NonNegative
    """smallest μ"""

    mu_max: Positive
    """largest μ"""


def _number_or_table(value: Any) -> str:
    return "friction-table" if isinstance(value, dict) else "friction-number"


class Zone(Table):
    """A contact zone: contact pairs between two parts, or between a part and a rigid fixture.

    The zone is where the two surfaces face each other within `max_gap` and `max_angle_deg`, inside a box, or a tube of
    radius `within` about the polyline `path`; without either, everywhere.
    """

    name: Name
    """name of the zone in results"""

    parts: tuple[Name, Name]
    """two parts, or a part and a fixture; normals point from the first to the second"""

    friction: Annotated[
        Annotated[Friction, Tag("friction-number")] | Annotated[dict[Name, Friction], Tag("friction-table")],
        Discriminator(_number_or_table),
    ] = 0.0
    """coefficient μ; or one per stage, `{ clamp = 0.12, default = 0.2 }`, with `default` for the others"""

    friction_table: Annotated[list[tuple[NonNegative, NonNegative]], Field(min_length=1)] | None = None
    """law `pressure-dependent`: points `[pressure in MPa, μ]` in place of `friction`, interpolated linearly,
    constant outside; μ p must not decrease"""

    friction_power: PressurePower | None = None
    """or the power law μ = mu0 (p/p0)^(−n), p and p0 in MPa, bounded by `mu_min` and `mu_max`; n ≤ 1"""

    tangential_stiffness: Positive | None = None
    """law `micro-slip`: tangential contact stiffness per area, N/mm³; default: rigid"""

    box: tuple[Vector, Vector] | None = None
    """region `[[xmin, ymin, zmin], [xmax, ymax, zmax]]`, mm"""

    path: Annotated[list[Vector], Field(min_length=1)] | None = None
    """or the polyline of a tube, mm"""

    within: Positive | None = None
    """radius of the tube about `path`, mm"""

    spacing: Positive | None = None
    """distance between contact candidates, mm, which act where sheets would penetrate. Default: one element, or if
    larger the smaller of four thicknesses and 1.5 clamp radii; on bends 1.3 √(radius · thickness), at least 0.85
    elements; under a clamp 2/3 of its radius"""

    spacing_factor: Positive = 1.0
    """multiplies these distances: 0.7 doubles the candidates, costs more, and reduces the error of slip"""

    pairs: Annotated[Count, Field(gt=0)] | None = None
    """or a fixed number of contact pairs; between them the sheets may penetrate"""

    points: Annotated[list[Vector], Field(min_length=1)] | None = None
    """or the points of the contact pairs, mm"""

    max_gap: Positive = 2.0
    """largest nominal gap between the facing surfaces, mm"""

    gap: NonNegative | None = None
    """nominal gap between the facing surfaces, mm, in place of that of the meshes"""

    max_angle_deg: Annotated[FiniteFloat, Field(gt=0, lt=90)] = 30.0
    """largest angle between the two surfaces"""

    nominal_overlap: Literal["close", "keep"] | Positive = "close"
    """nominal overlaps: `close` counts them as touching, at pairs and welds, up to half of the thinner sheet, or up
    to a number, mm; larger ones are errors. `keep` keeps them"""

    patch: Literal["tributary"] | NonNegative = "tributary"
    """area over which a pair averages: its tributary area, or a disc of this radius, mm"""

    mid_surface: Flag = False
    """read the mid-surfaces, not the facing surfaces: sticking sheets then do not act as one"""

    @model_validator(mode="after")
    def _consistent(self):
        if self.box is not None and self.path is not None:
            raise ValueError("give box or path, not both")
        if (self.path is None) != (self.within is None):
            raise ValueError("path and within (mm) belong together")
        if any(start == end for start, end in zip(self.path or [], (self.path or [])[1:])):
            raise ValueError("path has two equal consecutive points: remove one of them")
        if sum(value is not None for value in (self.pairs, self.spacing, self.points)) > 1:
            raise ValueError("give one of pairs (how many), spacing (mm) and points (coordinates) at most")
        if self.spacing_factor != 1 and not self.candidates:
            raise ValueError("spacing_factor applies to candidates only: remove it, or pairs and points")
        if self.box is not None and any(low >= high for low, high in zip(*self.box)):
            raise ValueError("box is [[xmin, ymin, zmin], [xmax, ymax, zmax]] with each minimum below its maximum")
        return self

    @model_validator(mode="after")
    def _friction_given(self):
        if isinstance(self.friction, dict) and "default" not in self.friction:
            raise ValueError("friction by stage needs default, for the stages that it does not name")
        if self.friction_table is not None and self.friction_power is not None:
            raise ValueError("give friction_table or friction_power, not both")
        key = "friction_table" if self.friction_power is None else "friction_power"
        try:
            depends = self.pressure_pieces() is not None
        except ValueError as error:
            raise ValueError(f"{key}: {error}") from None
        if self.patch == 0 and (depends or self.tangential_stiffness is not None):
            key = key if depends else "tangential_stiffness"
            raise ValueError(f'{key} is per area and patch = 0 has none: give a radius, or "tributary"')
        return self

    def coefficient(self, stage: str) -> float:
        """Coefficient of friction μ in a stage."""
        return self.friction.get(stage, self.friction["default"]) if isinstance(self.friction, dict) else self.friction

    def pressure_pieces(self) -> np.ndarray | None:
        """μ as a function of pressure in MPa, (q, 5) pieces of `mic.contact.laws.pressure_dependent`, if given."""
        if self.friction_table is not None:
            return pressure_dependent.table(self.friction_table)
        if self.friction_power is not None:
            return pressure_dependent.power(**self.friction_power.model_dump())
        return None

    @property
    def candidates(self) -> bool:
        """Whether its pairs are candidates, which act where the sheets would penetrate."""
        return self.pairs is None and self.points is None

    @property
    def frictional(self) -> bool:
        """Whether any key gives it friction, in any stage."""
        given = self.friction.values() if isinstance(self.friction, dict) else [self.friction]
        return max(given) > 0 or self.friction_table is not None or self.friction_power is not None
