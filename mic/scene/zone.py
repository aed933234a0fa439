"""The table of a contact zone, and of its friction."""

from __future__ import annotations

from typing import Annotated, Any, Literal

import numpy as np
from pydantic import Discriminator, Field, Tag, model_validator

from mic.contact.laws import pressure_dependent
from mic.scene.keys import Count, FiniteFloat, Flag, Name, NonNegative, Positive, Table, Vector

__all__ = [
    "PressurePower",
    "Zone",
]


class PressurePower(Table):
    """A coefficient of friction that is a power of pressure, within bounds."""

    mu0: Positive = Field(description="μ at p0")
    p0: Positive = Field(description="MPa")
    n: FiniteFloat = Field(description="exponent, at most 1")
    mu_min: NonNegative = Field(description="smallest μ")
    mu_max: Positive = Field(description="largest μ")


def _number_or_table(value: Any) -> str:
    return "friction-table" if isinstance(value, dict) else "friction-number"


class Zone(Table):
    """A contact zone: contact pairs between two parts, or between a part and a rigid fixture.

    The zone is where the two surfaces face each other within `max_gap` and `max_angle_deg`, inside the region: a box,
    or a tube of radius `within` about the polyline `path`; without either, everywhere.
    """

    name: Name = Field(description="names the zone in results")
    parts: tuple[Name, Name] = Field(
        description="two parts, or a part and a fixture; normals point from the first to the second"
    )
    friction: Annotated[
        Annotated[NonNegative, Tag("friction-number")] | Annotated[dict[Name, NonNegative], Tag("friction-table")],
        Discriminator(_number_or_table),
    ] = Field(
        0.0,
        description="coefficient of friction μ; or by stage, `{ clamp = 0.12, default = 0.2 }`, where `default` is for "
        "the stages that are not named",
    )
    friction_table: Annotated[list[tuple[NonNegative, NonNegative]], Field(min_length=1)] | None = Field(
        None,
        description="law `pressure-dependent`: μ in place of `friction`, as points `[pressure in MPa, μ]`, linear "
        "between them and constant outside; μ p must not fall",
    )
    friction_power: PressurePower | None = Field(
        None,
        description="or as the power law μ = mu0 (p/p0)^(−n), p and p0 in MPa, within `mu_min` and `mu_max`; n ≤ 1",
    )
    tangential_stiffness: Positive | None = Field(
        None,
        description="law `micro-slip`: tangential contact stiffness per area, N/mm³; without it contacts do not yield",
    )
    box: tuple[Vector, Vector] | None = Field(None, description="region `[[xmin, ymin, zmin], [xmax, ymax, zmax]]`, mm")
    path: Annotated[list[Vector], Field(min_length=1)] | None = Field(None, description="or the polyline of a tube, mm")
    within: Positive | None = Field(None, description="radius of the tube about `path`, mm")
    spacing: Positive | None = Field(
        None,
        description="distance between the candidates for contact, mm, of which those carry force that would penetrate; "
        "left out, one element, or if that is more the less of four thicknesses and one and a half clamp radii; nearer "
        "on bends, 1.3 √(radius · thickness) and no less than 0.85 elements, and under a clamp, 2/3 of its radius",
    )
    spacing_factor: Positive = Field(
        1.0,
        description="times these distances, under clamps as well: 0.7 gives twice as many candidates, which are dearer "
        "and leave less of the slips",
    )
    pairs: Annotated[Count, Field(gt=0)] | None = Field(
        None, description="or so many contact pairs, and no others: sheets may pass through each other between them"
    )
    points: Annotated[list[Vector], Field(min_length=1)] | None = Field(
        None, description="or the contact points themselves, mm, and no others"
    )
    max_gap: Positive = Field(2.0, description="largest nominal gap between the facing surfaces, mm")
    gap: NonNegative | None = Field(
        None, description="nominal gap between the facing surfaces, mm, in place of the one that the meshes have"
    )
    max_angle_deg: Annotated[FiniteFloat, Field(gt=0, lt=90)] = Field(
        30.0, description="largest angle between the two surfaces"
    )
    nominal_overlap: Literal["close", "keep"] | Positive = Field(
        "close",
        description="what is done where the surfaces are drawn into each other: `close` counts them as touching, at "
        "pairs and welds, up to half of the thinner sheet; a number is another limit, mm; beyond it the scene is "
        "refused; `keep` leaves the overlap, where it is meant",
    )
    patch: Literal["tributary"] | NonNegative = Field(
        "tributary", description="area that a pair averages over: its tributary area, or a disc of this radius, mm"
    )
    mid_surface: Flag = Field(
        False,
        description="read the mid-surfaces instead of the facing surfaces: stuck sheets then do not act as one",
    )

    @model_validator(mode="after")
    def _consistent(self):
        if self.box is not None and self.path is not None:
            raise ValueError("give box or path, not both")
        if (self.path is None) != (self.within is None):
            raise ValueError("path and within (mm) belong together")
        if any(start == end for start, end in zip(self.path or [], (self.path or [])[1:])):
            raise ValueError("path stands still: two points that follow each other are one, remove one of them")
        if sum(value is not None for value in (self.pairs, self.spacing, self.points)) > 1:
            raise ValueError("give one of pairs (how many), spacing (mm) and points (coordinates) at most")
        if self.spacing_factor != 1 and not self.candidates:
            raise ValueError("spacing_factor is for candidates: leave it out beside pairs or points")
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
        """Whether its pairs are candidates, watched: those carry force that would penetrate."""
        return self.pairs is None and self.points is None

    @property
    def frictional(self) -> bool:
        """Whether any key gives it friction, in any stage."""
        given = self.friction.values() if isinstance(self.friction, dict) else [self.friction]
        return max(given) > 0 or self.friction_table is not None or self.friction_power is not None
