"""The scene's tables: every key that a user may write, with its meaning, its unit and its default.

Lengths are mm, forces N, stiffness MPa; keys that hold degrees end in ``_deg``. Unknown keys are errors. The
descriptions here are the scene reference: the documentation is generated from them.
"""

from __future__ import annotations

import re
from pathlib import Path
from typing import Annotated, Any, ClassVar, Literal

import numpy as np
from pydantic import (
    AfterValidator,
    BaseModel,
    ConfigDict,
    Discriminator,
    Field,
    Tag,
    WrapValidator,
    field_validator,
    model_validator,
)

from mic.contact.laws import LAWS, pressure_dependent
from mic.contact.path import Followed
from mic.scene.checks import problems
from mic.scene.distribution import check_distribution
from mic.scene.settings import fill_in
from mic.scene.tables import written_out

__all__ = [
    "Clamp",
    "ClampDeviation",
    "Correlation",
    "Deviation",
    "Fixture",
    "FrictionDeviation",
    "FollowedPath",
    "FieldDeviation",
    "ForceDeviation",
    "GravityDeviation",
    "Locator",
    "LocatorDeviation",
    "MeasuredDeviation",
    "Measurement",
    "MonteCarlo",
    "Part",
    "Report",
    "Scene",
    "ShapeDeviation",
    "Stage",
    "TemperatureDeviation",
    "Weld",
    "Zone",
]

# Tolerances of a followed path: the contact problems inside it are solved to 1e-5, and a tenth is no path any more.
FINEST, COARSEST = 1e-5, 0.1

#: Suffixes of CAD files, which are meshed when they are read.
CAD = (".step", ".stp", ".iges", ".igs", ".brep")
#: What a sheet is where neither the scene nor a mesh file tells it: drawn in its middle, of steel; MPa.
USUAL = {"offset": 0.0, "young": 210e3, "poisson": 0.3}


class _Table(BaseModel):
    model_config = ConfigDict(extra="forbid", frozen=True, str_strip_whitespace=True)


# A number is a number: neither true, which Python takes for 1, nor the text of one.
FiniteFloat = Annotated[float, Field(strict=True, allow_inf_nan=False)]
Count = Annotated[int, Field(strict=True)]
Flag = Annotated[bool, Field(strict=True)]
Name = Annotated[str, Field(min_length=1, max_length=60, pattern=r"^[A-Za-z0-9_.+-]+$")]
Vector = tuple[FiniteFloat, FiniteFloat, FiniteFloat]
Positive = Annotated[FiniteFloat, Field(gt=0)]
NonNegative = Annotated[FiniteFloat, Field(ge=0)]


def _unit(value: Vector | None) -> Vector | None:
    if value is None:
        return None
    length = float(np.linalg.norm(value))
    if length < 1e-9:
        raise ValueError("a direction must not be zero: give a vector of any length, such as [0, 0, 1]")
    if abs(length - 1) < 1e-14:  # so that a scene read back from a model is the scene that was written
        return value
    x, y, z = value
    return x / length, y / length, z / length


#: The directions that a surface gives, in words; `mic.model.placing` says which vector each is.
WORDS = re.compile(r"-?(normal|in-plane [xyz])")


def _if_given(value: Any, handler: Any) -> Any:
    return None if value is None else handler(value)


def _vector_or_words(value: Any, handler: Any) -> Any:
    if not isinstance(value, str):
        return _unit(handler(value))
    words = " ".join(value.split())
    if not WORDS.fullmatch(words):
        raise ValueError(
            f'{value!r} is no direction; give [x, y, z], or "normal", "-normal", "in-plane x", "-in-plane x", … y, … z'
        )
    return words


#: A point, a part, a direction: typed as what they are once `mic.model.placing` has placed the scene on its meshes,
#: which everything comes after that reads them. In a scene as it is written a point or a part may be None, and a
#: direction words.
Place = Annotated[Vector, WrapValidator(_if_given)]
Owner = Annotated[Name, WrapValidator(_if_given)]
Direction = Annotated[Vector, WrapValidator(_vector_or_words)]
UNPLACED: Any = None
NORMAL: Any = "normal"
TOWARDS = "`[x, y, z]`; or `normal` or `in-plane x`, y, z (the axis laid into the sheet), with a minus the other way"


def stands_once(item: Any) -> Any:
    """The item, if one key says where it stands; raises ValueError for none and for two."""
    keys = [key for key in ("point", "node", "set", "hole") if key in type(item).model_fields]
    given = [key for key in keys if getattr(item, key) is not None]
    if not given:
        raise ValueError(f"give point = [x, y, z], or {' or '.join(keys[1:])}, where it stands")
    placed = given == ["point", "hole"] and item.point == item.hole  # which rows find the rim by
    if len(given) > 1 and not placed:
        raise ValueError(f"{' and '.join(given)} each say where it stands: give one of them")
    return item


class _OnSheet(_Table):
    """What stands on a part, at a point that its coordinates, a node or a set of nodes tell."""

    name: Name = Field(description="names it")
    point: Place = Field(UNPLACED, description="where, mm, at most 5 mm off the part")
    node: Count | None = Field(None, description="or a node by its number in the part's mesh file")
    set: Annotated[str, Field(min_length=1)] | None = Field(
        None, description="or a set of nodes by its name in the part's mesh file: their middle"
    )

    @model_validator(mode="after")
    def _one_place(self):
        return stands_once(self)


class _OnPart(_OnSheet):
    """What stands on a part, or in a hole of it."""

    hole: Vector | None = Field(
        None, description="or a point near the centre of a hole: its rim is read, as a pin does, at its own centre"
    )


class Part(_Table):
    """One sheet-metal part."""

    name: Name = Field(description="names the part in every other table")
    mesh: str | None = Field(
        None,
        description="mesh file of the sheet, triangles or quadrilaterals: gmsh, Abaqus, Nastran, LS-DYNA, STL, VTK, …; "
        "or a CAD file of its mid-surface, STEP, IGES",
    )
    set: str | Annotated[list[str], Field(min_length=1)] | None = Field(
        None,
        description="with `mesh`: the element sets, properties or physical groups of the file that are this part; "
        "left out, all of it",
    )
    unit: Literal["mm", "cm", "m", "um", "in", "ft"] = Field(
        "mm", description="with `mesh`: of length in the file; its stresses are in the unit that goes with it"
    )
    geometry: str | None = Field(
        None,
        description="or a Python file with `build(part, size) -> (points (n, 3), triangles (k, 3))`, or with normals "
        "(k, 3, 3) at the corners of the triangles as a third; it is executed",
    )
    size: str | Positive | None = Field(
        None, description="with `geometry`: element size in mm, or a name from its `SIZES`; with a CAD file in mm"
    )
    accuracy: Annotated[FiniteFloat, Field(gt=0, le=0.5)] | None = Field(
        None,
        description="or the share by which influence coefficients may be off, such as 0.01: the size is then found by "
        "solving the part on finer and finer meshes",
    )
    thickness: Positive | None = Field(
        None, description="of the sheet, mm; may be left out where the mesh file tells it"
    )
    offset: Annotated[FiniteFloat, Field(ge=-5, le=5)] | None = Field(
        None,
        description="from the surface as drawn to the middle of the sheet, as a share of the thickness, positive along "
        "the normals of the mesh: ±0.5 where it is drawn on a skin; left out, what the mesh file tells, else 0",
    )
    young: Positive | None = Field(
        None, description="Young's modulus, MPa; left out, what the mesh file tells, else 210 000"
    )
    poisson: Annotated[FiniteFloat, Field(gt=-1, lt=0.5)] | None = Field(
        None, description="Poisson's ratio, −1 < ν < ½; left out, what the mesh file tells, else 0.3"
    )
    density: Positive | None = Field(None, description="kg/m³, such as 7850; needed where gravity acts")
    expansion: Positive | None = Field(
        None, description="coefficient of thermal expansion, 1/K, such as 1.2e-5; needed where temperature deviates"
    )
    rests: Flag = Field(
        False,
        description="whether it rests on other parts or fixtures: what its locators leave free, contact and friction "
        "in its zones must hold; it is put down where it is drawn, or as near to that as nothing overlaps",
    )

    stiffness: str | None = Field(
        None,
        description="with `mesh`: file of the part's reduced stiffness on named nodes, in place of finite elements: a "
        "Matrix Market file or Nastran `OUTPUT4` with a node table beside it (`a.mtx` or `a.op4`, `a.csv` with node, "
        "x, y, z), Nastran `DMIG`, output of Abaqus `*MATRIX GENERATE`; free of supports",
    )
    compliance: str | None = Field(
        None, description="or of its reduced compliance, on any statically determinate support; the same formats"
    )

    @model_validator(mode="after")
    def _one_source(self):
        if self.stiffness is not None and self.compliance is not None:
            raise ValueError("give stiffness or compliance, not both")
        for key in ("stiffness", "compliance"):
            if self.mesh is None and getattr(self, key) is not None:
                raise ValueError(f"{key} needs mesh: the surface of the part, for pairs and pictures; add it")
        if (self.mesh is None) == (self.geometry is None):
            raise ValueError('give either mesh = "file" or geometry = "file.py", not both and not neither')
        for key in ("set", "unit"):
            if self.mesh is None and getattr(self, key) not in (None, "mm"):
                raise ValueError(f"{key} applies to mesh files only: remove it, or give mesh instead of geometry")
        if self.geometry is not None:
            if self.thickness is None:
                raise ValueError("a geometry source needs thickness, mm: add it")
            for key, usual in USUAL.items():  # nobody else will be asked for them
                object.__setattr__(self, key, usual if getattr(self, key) is None else getattr(self, key))
        for key in ("size", "accuracy"):
            if self.geometry is None and getattr(self, key) is not None and not (key == "size" and self._cad):
                raise ValueError(f"{key} applies to geometry sources only: remove it, or give geometry instead of mesh")
        if self._cad and not isinstance(self.size, float):
            raise ValueError("a CAD file is meshed here and needs size, mm: add it")
        if self.geometry is not None and self.size is None and self.accuracy is None:
            raise ValueError(
                "a geometry source needs size: an element size in mm, or one of the geometry's named sizes; or accuracy"
            )
        if self.size is not None and self.accuracy is not None:
            raise ValueError("give either size or accuracy, not both: accuracy finds the size")
        return self

    @property
    def _cad(self) -> bool:
        return self.mesh is not None and self.mesh.lower().endswith(CAD)

    @property
    def sheet(self) -> tuple[float, float, float]:
        """Thickness, mm, Young's modulus, MPa, and Poisson's ratio, once what the mesh file tells is filled in."""
        if self.thickness is None or self.young is None or self.poisson is None:
            raise ValueError(f"part {self.name}: its mesh file has not been asked for thickness and material")
        return self.thickness, self.young, self.poisson


class Fixture(_Table):
    """A rigid surface that parts may touch: a mesh, or a flat round pad.

    A pad with `part` is set against that part as it is drawn: its face touches the skin, at a place told as elsewhere.
    """

    name: Name = Field(description="names the fixture in `[[zones]]`")
    mesh: str | None = Field(None, description="mesh file, relative to the scene file")
    point: Vector | None = Field(
        None, description="or the centre of a flat round pad, mm; with `part` a place at most 5 mm off the part"
    )
    part: Name | None = Field(None, description="the part that the pad is set against, touching its skin")
    node: Count | None = Field(None, description="with `part`, in place of `point`: a node by its number")
    set: Annotated[str, Field(min_length=1)] | None = Field(
        None, description="or a set of nodes by its name in the part's mesh file: their middle"
    )
    hole: Vector | None = Field(None, description="or a point near the centre of a hole, over which the pad then lies")
    normal: Direction | None = Field(
        None,
        description="the pad's outward normal; with `part` also `normal`, the default, which is that of the sheet, or "
        "`-normal`: the pad lies on the side that it comes from",
    )
    radius: Positive | None = Field(None, description="the pad's radius, mm")
    stage: Name | None = Field(None, description="the locate stage in whose station it stands; if left out, the first")

    @model_validator(mode="after")
    def _one_shape(self):
        places = [key for key in ("point", "node", "set", "hole") if getattr(self, key) is not None]
        given = places + [key for key in ("part", "normal", "radius") if getattr(self, key) is not None]
        if (self.mesh is None) == (not given):
            raise ValueError('give either mesh = "file", or point, normal and radius of a flat pad')
        if self.mesh is not None:
            return self
        if self.part is None:
            alone = [key for key in places if key != "point"]
            if alone:
                raise ValueError(f"{alone[0]} is one of a part's: add part, which the pad is set against")
            if not {"point", "normal", "radius"} <= set(given):
                raise ValueError('give either mesh = "file", or point, normal and radius of a flat pad')
            if isinstance(self.normal, str):
                raise ValueError(f"normal = {self.normal!r} is a part's: add part, or give normal = [x, y, z]")
            return self
        if len(places) != 1:
            raise ValueError(
                f"{' and '.join(places)} each say where the pad lies: give one of them"
                if places
                else "give point = [x, y, z], or node or set or hole, where the pad lies on its part"
            )
        if self.radius is None:
            raise ValueError("a pad needs radius, mm: add it")
        if self.normal is None:
            object.__setattr__(self, "normal", NORMAL)
        if isinstance(self.normal, str) and "in-plane" in self.normal:
            raise ValueError('a pad lies flat against its part: normal is "normal", "-normal" or [x, y, z]')
        return self


class Locator(_OnPart):
    """A bilateral support of a part in one direction, over a pad of the given radius.

    It engages in the named stage: those of the locate stage place the part (a 3-2-1 scheme), further ones of an N-2-1
    scheme close when the clamps do and force the part. Those of a later locate stage, or of the measure stage, hold an
    assembly that is set down there: all that held it before opens.
    """

    name: Name = Field(description="names the locator in `keep` and in deviations")
    part: Name = Field(description="the part that it supports")
    direction: Direction = Field(NORMAL, description=f"of the support: {TOWARDS}")
    radius: NonNegative = Field(4.0, description="of the pad, mm; 0 is nodal")
    stage: Name = Field(
        "locate",
        description="the stage in which it engages; those of the locate stage must hold all six motions of their part",
    )
    stiffness: Positive | None = Field(
        None,
        description="N/mm: it yields under its load; left out, it is rigid. Soft ones carry a part that is to rest on "
        "another, until clamps press it there",
    )


class Clamp(_OnPart):
    """A clamp pushes a part along `direction`, by a force or to a position.

    With `parts` it is a tong: one jaw pushes the first part towards the second, the other the second towards the first.
    Its jaws are called `NAME-PART`; `order`, `keep` and deviations may name it as a whole.
    """

    name: Name = Field(description="names the clamp in deviations")
    part: Owner = Field(UNPLACED, description="the part that it pushes")
    parts: tuple[Name, Name] | None = Field(None, description="or the two parts that it presses together, as a tong")
    direction: Direction = Field(
        NORMAL, description=f"into which it pushes, a tong its first part: {TOWARDS}; of a tong: together"
    )
    force: FiniteFloat | None = Field(None, description="N along `direction`")
    stroke: FiniteFloat | None = Field(
        None, description="or the position that it enforces along `direction`, mm from nominal"
    )
    limit: Positive | None = Field(
        None,
        description="with `stroke`: the most that it pushes with, N; where its position takes more, it stops short of "
        "it and pushes with its limit, the assembly counts as not built, and the force that it would need is told",
    )
    radius: NonNegative = Field(5.0, description="of the pad, mm; 0 is nodal")
    stage: Name = Field("clamp", description="the clamp stage that closes it; a release opens it")

    @model_validator(mode="after")
    def _force_or_stroke(self):
        if (self.force is None) == (self.stroke is None):
            raise ValueError("give either force (N) or stroke (mm from the nominal position), not both and not neither")
        if self.limit is not None and self.stroke is None:
            raise ValueError("limit goes with stroke; a clamp with a force pushes with just that: remove limit")
        return self

    @model_validator(mode="after")
    def _one_or_two(self):
        if (self.part is None) == (self.parts is None):
            raise ValueError("give either part, which it pushes, or parts = [a, b], which it presses together")
        if self.parts is not None and (isinstance(self.direction, str) and self.direction != "normal"):
            raise ValueError("a tong presses its parts together: leave direction out, or give [x, y, z] for parts[0]")
        if self.parts is not None and self.hole is not None:
            raise ValueError("a tong presses on sheets, and there is none in a hole: give point, node or set")
        return self

    @property
    def owners(self) -> tuple[Name, ...]:
        """The parts that it pushes."""
        return self.parts or (self.part,)


class Weld(_OnSheet):
    """A spot weld; it freezes the relative position that it finds, or closes the gap first."""

    name: Name = Field(description="names the weld in results")
    parts: tuple[Name, Name] = Field(description="the two parts that it joins; nodes and sets are those of the first")
    radius: NonNegative = Field(2.5, description="of the nugget, mm")
    close: Flag = Field(False, description="close the gap first (one more contact resolution), or freeze what is found")
    gun: Positive | None = Field(
        None,
        description="force with which the gun presses the two parts together while the weld is made, N; it opens "
        "after. Where it leaves a gap, the weld keeps it, the assembly counts as not built, and the force that the gun "
        "would need is told",
    )
    moment: Flag = Field(True, description="whether the nugget carries moment, or ties its mean displacement alone")
    fused: Flag = Field(
        True,
        description="whether all of the nugget is one piece; `false` ties its mean displacement and rotation, which is "
        "softer",
    )
    stage: Name = Field("weld", description="the weld stage that makes it")

    @model_validator(mode="after")
    def _one_way_to_close(self):
        if self.close and self.gun is not None:
            raise ValueError("close closes the gap whatever that takes, a gun with its force: remove one of them")
        return self


class PressurePower(_Table):
    """A coefficient of friction that is a power of pressure, within bounds."""

    mu0: Positive = Field(description="μ at p0")
    p0: Positive = Field(description="MPa")
    n: FiniteFloat = Field(description="exponent, at most 1")
    mu_min: NonNegative = Field(description="smallest μ")
    mu_max: Positive = Field(description="largest μ")


def _number_or_table(value: Any) -> str:
    return "friction-table" if isinstance(value, dict) else "friction-number"


class Zone(_Table):
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
        "left out, one element, or if that is more the less of four thicknesses and one and a half clamp radii",
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


class Stage(_Table):
    """One stage of the process; in order. The first is ``locate``, ``measure`` may only come last.

    ``locate`` sets the parts down on the locators that name it: further parts beside the others; or, where the others
    have locators in it too, in another station, all that held them open; ``clamp`` closes the clamps and further
    locators that
    name it; ``weld`` makes the welds that name it; ``release`` opens all clamps and every locator but `keep`;
    ``measure`` reads the measurements, of the assembly as it is held, or where locators name the stage, set down on
    these alone. What each of them does is a list of steps, one after the other, in each of which
    actions happen together (`mic.process.actions`); `mic check` prints them.
    """

    kind: Literal["locate", "clamp", "weld", "release", "measure"] = Field(description="what the stage does")
    name: Name | None = Field(None, description="what `stage` keys refer to; the kind if left out")
    keep: list[Name] | None = Field(
        None, description="release only: the locators and clamps that stay closed; if left out, all locators"
    )
    order: Annotated[list[list[Name]], Field(min_length=1)] | None = Field(
        None,
        description="clamp, weld, release: what closes, or opens, one after the other: groups of names, each group "
        "together. Left out, further locators close first and together, then clamps as the file has them, neighbours "
        "that press two parts together as one; welds are made together; a release opens last what closed first",
    )
    sequence: Flag = Field(False, description="weld only: one weld after the other, in the order of the file")
    settle: Flag = Field(
        True,
        description="locate only: parts that overlap where they were set down come to rest on each other before "
        "anything closes; `false`: while the first thing closes",
    )
    path: Literal["followed", "increments", "one-step"] | None = Field(
        None,
        description="how friction's path is followed where something closes or opens: `followed`, the default, by "
        "steps of controlled error; `increments`, so many for each step of the stage, short at both its ends; "
        "`one-step`, all that the stage does at once, overlaps included, as the paper has it",
    )
    increments: Annotated[Count, Field(ge=1)] | None = Field(
        None, description='of each step of the stage; means path = "increments"'
    )

    #: Kinds of stages to which a key applies.
    applies: ClassVar[dict[str, tuple[str, ...]]] = {
        "keep": ("release",),
        "order": ("clamp", "weld", "release"),
        "sequence": ("weld",),
        "settle": ("locate",),
        "path": ("locate", "clamp", "weld", "release", "measure"),
        "increments": ("locate", "clamp", "weld", "release", "measure"),
    }

    @model_validator(mode="after")
    def _fill(self):
        for key, kinds in self.applies.items():
            if self.kind not in kinds and getattr(self, key) != type(self).model_fields[key].default:
                raise ValueError(
                    f"{key} applies to {', '.join(kinds)} stages only, this one is of kind {self.kind!r}: remove it"
                )
        if self.order is not None and self.sequence:
            raise ValueError("order and sequence both say in which order welds are made: remove one of them")
        if self.path == "one-step" and (self.order is not None or self.sequence):
            key = "sequence" if self.sequence else "order"
            raise ValueError(f'path = "one-step" does all at once, {key} one after the other: remove one of them')
        if self.increments is not None and self.path not in (None, "increments"):
            raise ValueError(f"increments do not go with path = {self.path!r}: remove one of them")
        if self.increments is None and self.path == "increments":
            raise ValueError('path = "increments" needs increments, how many for each step of the stage: give it')
        if self.name is None:
            object.__setattr__(self, "name", self.kind)
        return self


class _Deviation(_Table):
    """What every source of variation has."""

    name: Name = Field(description="names the deviation in results and in `model.evaluate`")
    mean: FiniteFloat = Field(0.0, description="N or mm")
    sigma: NonNegative = Field(description="standard deviation, N or mm")
    distribution: Annotated[str, Field(min_length=1)] = Field(
        "normal",
        description="with this mean and this sigma: `normal`, `uniform`, or the name of any continuous distribution of "
        "`scipy.stats` that has both",
    )
    parameters: dict[str, FiniteFloat] = Field(
        {}, description="its shape parameters by SciPy's names, such as `{ a = 4 }` with `skewnorm`"
    )
    truncated: tuple[FiniteFloat, FiniteFloat] | None = Field(
        None, description="smallest and largest value, N or mm: cut off there; mean and sigma are those before"
    )

    #: The scene's table in which `target` stands, where the deviation moves something.
    moves: ClassVar[str | None] = None

    #: Whether it becomes several, each with the distribution.
    several: ClassVar[bool] = False

    @model_validator(mode="after")
    def _distributed(self):
        if self.several and self.truncated is not None:
            raise ValueError("truncated: it stands for several modes, which have no limits of their own; remove it")
        check_distribution(self)
        return self


class ForceDeviation(_OnPart, _Deviation):
    """``kind = "force"``: shapes a part as a corrective force would.

    The part is held meanwhile on a statically determinate choice of the locators that it is set down on.
    """

    kind: Literal["force"] = Field(description='`"force"`')
    name: Name = Field(description="names the deviation in results and in `model.evaluate`")
    part: Name = Field(description="the part that it shapes")
    direction: Direction = Field(NORMAL, description=f"into which the force acts: {TOWARDS}")
    radius: NonNegative = Field(8.0, description="of the disc that it is spread over, mm")


class LocatorDeviation(_Deviation):
    """``kind = "locator"``: moves a locator along its direction, mm; or a pin or hole that several read."""

    kind: Literal["locator"] = Field(description='`"locator"`')
    target: Name | Annotated[list[Name], Field(min_length=1)] = Field(
        description="the locator that moves; or those of one pin, with its `direction`"
    )
    direction: Annotated[Vector | None, AfterValidator(_unit)] = Field(
        None,
        description="in which the pin moves: each locator by what of it lies along its own; left out, the locator's",
    )
    where: Literal["fixture", "part"] = Field(
        "fixture", description="whether the pin is out of place in its fixture, or the hole in its part"
    )
    moves: ClassVar[str | None] = "locators"

    @model_validator(mode="after")
    def _one_way(self):
        if not isinstance(self.target, str) and self.direction is None:
            raise ValueError("several locators move as one pin: give its direction = [x, y, z]")
        return self


class ClampDeviation(_Deviation):
    """``kind = "clamp"``: moves a clamp along its direction, mm; for a clamp with a force, adds to it, N."""

    kind: Literal["clamp"] = Field(description='`"clamp"`')
    target: Name | Annotated[list[Name], Field(min_length=1)] = Field(
        description="the clamp that moves, a tong with both its jaws; or several that move alike"
    )
    moves: ClassVar[str | None] = "clamps"


class GravityDeviation(_Deviation):
    """``kind = "gravity"``: the weight of all parts, from when they are set down in a station until they leave it.

    Nothing of it is left where the assembly is set down elsewhere; there it may hang another way, by a deviation of its
    own.
    """

    kind: Literal["gravity"] = Field(description='`"gravity"`')
    direction: Annotated[Vector, AfterValidator(_unit)] = Field(
        (0.0, 0.0, -1.0), description="in which weight pulls, as the parts are drawn"
    )
    mean: FiniteFloat = Field(1.0, description="multiples of the earth's gravity, 9.80665 m/s²")
    sigma: NonNegative = Field(0.0, description="standard deviation, in the same multiples")
    stage: Name | None = Field(
        None, description="the locate or measure stage in whose station it acts; left out, the first"
    )


class TemperatureDeviation(_Deviation):
    """``kind = "temperature"``: a part is uniformly warmer than it was drawn, from before it is set down to the end.

    It is measured warm. Fixtures do not grow; neither does its thickness.
    """

    kind: Literal["temperature"] = Field(description='`"temperature"`')
    part: Name | None = Field(None, description="which part; left out, all of them")
    mean: FiniteFloat = Field(0.0, description="K")
    sigma: NonNegative = Field(description="standard deviation, K")


class FrictionDeviation(_Deviation):
    """``kind = "friction"``: what the coefficient of friction of zones is higher by, in all stages.

    Its samples are solved one by one. One whose coefficient would be negative is counted as failed: give `truncated`.
    """

    kind: Literal["friction"] = Field(description='`"friction"`')
    target: Name | Annotated[list[Name], Field(min_length=1)] = Field(
        description="the zone, or several that vary alike; each with a constant `friction`"
    )
    mean: FiniteFloat = Field(0.0, description="added to the coefficient")
    sigma: NonNegative = Field(description="standard deviation of the coefficient")
    moves: ClassVar[str | None] = "zones"


class ShapeDeviation(_Deviation):
    """``kind = "shape"``: how far a part is out of shape at points of it, mm along the normals of its mesh.

    The deviation's value multiplies `values`. Between the points the sheet takes the shape of least bending energy.
    """

    kind: Literal["shape"] = Field(description='`"shape"`')
    part: Name = Field(description="the part whose shape it is")
    points: Annotated[list[Vector], Field(min_length=1)] = Field(description="where, mm, at most 5 mm off the part")
    values: Annotated[list[FiniteFloat], Field(min_length=1)] | None = Field(
        None, description="how far the part is off at each of them, mm; left out, 1 everywhere"
    )
    radius: NonNegative = Field(0.0, description="of the discs over which these are means, mm; 0 is nodal")
    loose: Flag = Field(
        False,
        description="whether the values hold of the part in any position, as measured shapes do, and not of the part "
        "set down on its locators; takes more than six points",
    )
    noise: NonNegative | Annotated[list[Positive], Field(min_length=1)] = Field(
        0.0,
        description="standard uncertainty of the values, or of each of them, mm: the shape passes them by as much, and "
        "is smoother",
    )
    batch: Name | None = Field(
        None, description="deviations of one batch have the same part and points, and `scores` of the same pieces"
    )
    scores: Annotated[list[FiniteFloat], Field(min_length=2)] | None = Field(
        None,
        description="of each measured piece of the batch, in standard deviations: a sample is one of the pieces, "
        "drawn at random, in place of the distribution",
    )

    @model_validator(mode="after")
    def _one_value_each(self):
        if self.values is not None and len(self.values) != len(self.points):
            raise ValueError(f"there are {len(self.points)} points and {len(self.values)} values: give one for each")
        if isinstance(self.noise, list) and len(self.noise) != len(self.points):
            raise ValueError(f"there are {len(self.points)} points and noise of {len(self.noise)}: give it for each")
        if self.loose and len(self.points) <= 6:
            raise ValueError("loose takes more than six points: fewer are met by moving the part as it is; add some")
        return self

    @property
    def known(self) -> np.ndarray:
        """(c,) its values, mm."""
        return np.ones(len(self.points)) if self.values is None else np.array(self.values)


class MeasuredDeviation(_Deviation):
    """``kind = "measured"``: shapes that were measured, of one piece or of several.

    Of several pieces the mean shape and the principal modes about it become deviations of kind `shape`, called
    ``NAME.mean``, ``NAME.1``, ``NAME.2`` …, each of standard deviation 1.
    """

    kind: Literal["measured"] = Field(description='`"measured"`')
    several: ClassVar[bool] = True
    part: Name = Field(description="the part that was measured")
    files: str = Field(
        description="a file for each piece, as a name or a pattern such as `measured/outer-*.csv`: CSV with a header "
        "x, y, z (points, mm), or x, y, z, deviation (nominal points, mm along the normals), or node, deviation; or a "
        "cloud of points as PLY, STL, VTK, …"
    )
    unit: Literal["mm", "cm", "m", "um", "in", "ft"] = Field("mm", description="of length in the files")
    mean: FiniteFloat = Field(1.0, description="how many times the mean shape is taken")
    sigma: NonNegative = Field(1.0, description="how many times the modes are: 1 is the spread that was measured")
    pieces: Flag = Field(
        False, description="whether a sample is one of the pieces as it was measured, drawn at random, not modes"
    )
    skin: Literal[-1, 0, 1] = Field(
        0,
        description="where the points lie: 1 on the skin on the side of the mesh's normals, -1 on the other, 0 in "
        "the middle of the sheet; of points with a deviation it does not matter",
    )
    align: Flag = Field(
        True, description="whether points are first moved, as a rigid body, to where they fit the nominal part best"
    )
    within: Positive = Field(5.0, description="points farther off the part than this, mm, are left out, and counted")
    spacing: Positive | None = Field(
        None,
        description="distance of the points at which the shape is taken, each from the measured points about it, mm; "
        "left out, the measured points themselves where all pieces have the same few, else one such that there are "
        "about 200",
    )
    noise: NonNegative = Field(0.0, description="standard uncertainty of a measured point, mm")
    share: Annotated[FiniteFloat, Field(gt=0, le=1)] = Field(
        0.99, description="of the variance over the pieces that the modes keep; all of it with `pieces`"
    )


class FieldDeviation(_Deviation):
    """``kind = "field"``: a random field of deviations along the normals all over a part, stationary along the sheet.

    Its correlation is of Matérn's family with ν = 1, by the sheet's own Laplacian. Its principal modes become
    deviations of kind `shape`, called ``NAME.1``, ``NAME.2`` …. With `points` it is known at these alone, of the part
    set down on its locators; between them the sheet takes the shape of least bending energy.
    """

    kind: Literal["field"] = Field(description='`"field"`')
    several: ClassVar[bool] = True
    part: Name = Field(description="the part whose shape varies")
    mean: Annotated[FiniteFloat, Field(ge=0, le=0)] = Field(0.0, description="0: give a mean shape as `shape`")
    sigma: Positive = Field(description="standard deviation at every point, mm, before the part is set down")
    length: Positive = Field(description="correlation length, mm: where the correlation has fallen to 0.14")
    direction: Annotated[Vector | None, AfterValidator(_unit)] = Field(
        None, description="along which it is longer or shorter, such as along a bend; laid into the sheet everywhere"
    )
    stretch: Annotated[FiniteFloat, Field(ge=0.1, le=10)] = Field(
        1.0, description="with `direction`: correlation length along it, as a multiple of `length`"
    )
    points: Annotated[list[Vector], Field(min_length=1)] | None = Field(
        None, description="control points, mm, at most 5 mm off the part, where `sigma` is that of the part set down"
    )
    values: Annotated[list[Positive], Field(min_length=1)] | None = Field(
        None, description="with `points`: by what `sigma` is multiplied at each of them; left out, 1 everywhere"
    )
    share: Annotated[FiniteFloat, Field(gt=0, lt=1)] = Field(
        0.95, description="of the variance that the modes keep at every point; the rest is shared out among them"
    )

    @model_validator(mode="after")
    def _one_value_each(self):
        if (self.direction is None) != (self.stretch == 1.0):
            raise ValueError("direction and stretch say together along what it is longer: give both, or neither")
        if self.values is not None and self.points is None:
            raise ValueError("values are those at points: give points, or remove values")
        if self.values is not None and len(self.values) != len(self.points or []):
            raise ValueError(f"there are {len(self.points or [])} points and {len(self.values)} values: give one each")
        return self


Deviation = Annotated[
    ForceDeviation
    | LocatorDeviation
    | ClampDeviation
    | ShapeDeviation
    | MeasuredDeviation
    | FieldDeviation
    | GravityDeviation
    | TemperatureDeviation
    | FrictionDeviation,
    Field(discriminator="kind"),
]


class OtherPoint(_Table):
    """The second point of a characteristic between two: by `point`, `node`, `set` or `hole`, on a part."""

    part: Name = Field(description="the part that it is on")
    point: Place = Field(UNPLACED, description="where, mm, at most 5 mm off the part")
    node: Count | None = Field(None, description="or a node by its number in the part's mesh file")
    set: Annotated[str, Field(min_length=1)] | None = Field(
        None, description="or a set of nodes by its name in the part's mesh file: their middle"
    )
    hole: Vector | None = Field(None, description="or a point near the centre of a hole: its rim is read")
    radius: NonNegative = Field(2.5, description="of the probe, mm; 0 is nodal")

    @model_validator(mode="after")
    def _one_place(self):
        return stands_once(self)


class Measurement(_OnPart):
    """A key characteristic: how far a point is from nominal along a direction, or what `kind` makes of several, mm.

    `point` is one point. `flush`, `gap` and `distance` are by how much the point `to` moves away from the first: along
    the normal of the first's sheet, along the line between the two laid into that sheet, and along that line itself.
    `parallelism` is the width between two planes across `direction` that hold all `points`, less what is nominal;
    `profile` twice the largest deviation of any point along the normals there, as ISO 1101 counts both.
    """

    name: Name = Field(description="names the key characteristic in results")
    kind: Literal["point", "flush", "gap", "distance", "parallelism", "profile"] = Field(
        "point", description="what is made of the points"
    )
    part: Name = Field(description="the part that is measured")
    direction: Direction = Field(
        NORMAL,
        description=f"in which the deviation counts positive: {TOWARDS}; of a `gap` left out, of `distance` and "
        "`profile` not given",
    )
    radius: NonNegative = Field(2.5, description="of the probe, mm; 0 is nodal")
    to: OtherPoint | None = Field(
        None, description="`flush`, `gap`, `distance`: the other point, `{ part = NAME, point = [x, y, z] }`"
    )
    points: Annotated[list[Vector], Field(min_length=2)] | None = Field(
        None, description="`parallelism`, `profile`: in place of `point`, where, mm, at most 5 mm off the part"
    )
    spacing: Positive | None = Field(
        None, description="or points all over the part, none of which is farther than this from its neighbours, mm"
    )
    box: tuple[Vector, Vector] | None = Field(
        None, description="with `spacing`: only inside of `[[xmin, ymin, zmin], [xmax, ymax, zmax]]`, mm"
    )
    best_fit: Annotated[list[Name], Field(min_length=1)] | None = Field(
        None,
        description="measurements on which the assembly is aligned before this one is read, as a rigid body, with the "
        "least sum of squares; of `parallelism` and `profile` it may be itself",
    )
    lower: FiniteFloat = Field(
        description="lower limit of the tolerance, mm from nominal; of `parallelism` and `profile` 0, and left out"
    )
    upper: FiniteFloat = Field(description="upper limit of the tolerance, mm from nominal")

    #: Kinds that are read at two points, and at any number.
    BETWEEN: ClassVar[tuple[str, ...]] = ("flush", "gap", "distance")
    OVER: ClassVar[tuple[str, ...]] = ("parallelism", "profile")

    @model_validator(mode="before")
    @classmethod
    def _from_zero(cls, table: Any):
        if isinstance(table, dict) and table.get("kind") in cls.OVER:
            none = ("direction",) if table.get("direction") is None else ()  # a profile, written out
            return {"lower": 0.0} | {key: value for key, value in table.items() if key not in none}
        return table

    @model_validator(mode="after")
    def _one_place(self):
        given = [key for key in ("points", "spacing") if getattr(self, key) is not None]
        if self.kind not in self.OVER:
            if given:
                raise ValueError(f"{given[0]} goes with kind {' or '.join(self.OVER)}; give point, or that kind")
            return stands_once(self)
        single = [key for key in ("point", "node", "set", "hole") if getattr(self, key) is not None]
        if single:
            raise ValueError(f"{self.kind} is read at many points: give points or spacing in place of {single[0]}")
        if len(given) != 1:
            raise ValueError(f"{self.kind} takes either points = [[x, y, z], …] or spacing (mm)")
        return self

    @model_validator(mode="after")
    def _of_its_kind(self):
        if (self.to is not None) != (self.kind in self.BETWEEN):
            raise ValueError(
                f"{self.kind} is read between two points: give the other as to = {{ part = …, point = … }}"
                if self.to is None
                else f"to goes with kind {', '.join(self.BETWEEN)}; {self.kind} has no other point, remove it"
            )
        if self.kind == "profile":
            if self.direction != NORMAL:
                raise ValueError("a profile is read along the normals at its points: remove direction")
            object.__setattr__(self, "direction", UNPLACED)  # it has as many as points
        if self.kind == "distance" and self.direction != NORMAL and not self._along_line():
            raise ValueError("a distance is read along the line between its points: remove direction")
        if self.box is not None and self.spacing is None:
            raise ValueError("box goes with spacing: give the points themselves, or spacing (mm)")
        if self.box is not None and any(low >= high for low, high in zip(*self.box)):
            raise ValueError("box is [[xmin, ymin, zmin], [xmax, ymax, zmax]] with each minimum below its maximum")
        return self

    @model_validator(mode="after")
    def _ordered(self):
        if self.kind in self.OVER and self.lower != 0:
            raise ValueError(f"{self.kind} is never negative and its lower limit is 0: remove lower")
        if self.lower >= self.upper:
            raise ValueError("lower must be smaller than upper")
        return self

    def _along_line(self) -> bool:
        """Whether the direction is the line to the other point, as it is once both are placed."""
        if self.to is None or self.to.point is None or self.point is None or isinstance(self.direction, str):
            return False
        line = np.subtract(self.to.point, self.point)
        return bool(np.allclose(line / np.linalg.norm(line), self.direction, rtol=0, atol=1e-9))

    @property
    def one_sided(self) -> bool:
        """Whether its lower limit is that of the quantity itself, which no spread can cross."""
        return self.kind in self.OVER

    @property
    def bounds(self) -> tuple[float, float]:
        """Limits that its spread may cross, mm."""
        return (-np.inf if self.one_sided else self.lower), self.upper

    @property
    def places(self) -> list[tuple[str, Vector]]:
        """Parts and points where it is read, of those that are placed."""
        found = [(self.part, point) for point in self.points or [self.point]]
        found += [(self.to.part, self.to.point)] if self.to is not None else []
        return [(part, point) for part, point in found if point is not None]


class Report(_Table):
    """What the run shall produce; what is not asked for is not computed."""

    laws: Annotated[list[str], Field(min_length=1)] = Field(
        ["coulomb"], description="contact laws: " + ", ".join(f"`{law.name}` ({law.title})" for law in LAWS.values())
    )
    slip: Flag = Field(
        False,
        description="report tangential motion even where no law with friction is asked for; "
        "without either, a third of the contact functionals suffices",
    )
    accuracy: Flag = Field(
        False,
        description="estimate what the parts' meshes leave of error: each part is solved once more at half the size",
    )
    fields: Flag = Field(False, description="mean and 6σ displacement fields, for the report and ParaView")

    @field_validator("laws")
    @classmethod
    def _known_once(cls, laws):
        for law in laws:
            if law not in LAWS:
                raise ValueError(f"there is no law called {law!r}; known: {', '.join(LAWS)}")
        if len(set(laws)) != len(laws):
            raise ValueError("each law may be named once")
        return laws


class MonteCarlo(_Table):
    """Size and seed of the Monte Carlo, and who solves the contacts."""

    samples: Annotated[Count, Field(ge=1)] = Field(500, description="number of assemblies")
    accuracy: Annotated[float, Field(gt=0, lt=1)] | None = Field(
        None,
        description="how well every 6σ of a key characteristic is to be known: half of its 95 % interval, the plain "
        "one or that by regression, as a share of it. Samples are drawn until it is, `samples` at most",
    )
    seed: Annotated[Count, Field(ge=0, lt=2**63)] = Field(1, description="of the deviations")
    design: Literal["independent", "antithetic", "latin-hypercube", "sobol"] = Field(
        "independent",
        description="how the distributions are sampled: each sample for itself; in pairs of opposite deviations; in "
        "Latin hypercubes of 50 samples; in scrambled Sobol' sequences of 64. The number of samples is a multiple of "
        "these",
    )
    table: Annotated[str, Field(min_length=1)] | None = Field(
        None,
        description="file of samples, CSV or Parquet, in place of all drawing: a row for each assembly, a column for "
        "each deviation under its name, N or mm as it has them (modes as `NAME.1` …); left out, `samples` is all of it",
    )
    values: list[list[FiniteFloat]] | None = Field(
        None, description="or these samples themselves, each with the deviations in their order"
    )
    backend: Literal["native", "paper"] = Field(
        "native", description="`paper`: OSQP for (12) and ECOS for (13) through CVXPY, as the paper did"
    )

    @model_validator(mode="after")
    def _drawn_or_given(self):
        given = "table" if self.table is not None else "values"
        if (self.table is not None or self.values is not None) and self.design != "independent":
            raise ValueError(f"design says how samples are drawn, and {given} gives them: remove one of them")
        if self.accuracy is not None and (self.table is not None or self.values is not None):
            raise ValueError(f"accuracy says how many samples are drawn, and {given} gives them: remove one of them")
        if self.accuracy is not None and self.design != "independent":
            raise ValueError("accuracy adds samples one by one, and a design makes them together: remove one of them")
        return self


class Correlation(_Table):
    """Deviations that vary together: a Gaussian copula, which leaves each its own distribution.

    Sample by sample the copula draws correlated standard normals ``z = L ε`` with ``L Lᵀ`` the matrix; each deviation
    is the quantile of its distribution at ``Φ(z)``. Of normal deviations the matrix is their own correlation.
    """

    deviations: Annotated[list[Name], Field(min_length=2)] = Field(
        description="their names; a deviation may stand in one such table, and not be of kind `measured` or `field`, "
        "whose modes are uncorrelated"
    )
    matrix: list[list[FiniteFloat]] = Field(
        description="correlations between them, symmetric, 1 on the diagonal, no eigenvalue below 0"
    )

    @model_validator(mode="after")
    def _is_a_correlation(self):
        n = len(self.deviations)
        if [len(row) for row in self.matrix] != [n] * n:
            raise ValueError(f"matrix: {n} deviations need {n} rows of {n} numbers")
        R = np.array(self.matrix)
        if np.abs(R - R.T).max() > 1e-12:
            i, j = np.argwhere(np.abs(R - R.T) > 1e-12)[0]
            raise ValueError(f"matrix is not symmetric: {R[i, j]:g} above the diagonal and {R[j, i]:g} below; mend it")
        if np.abs(np.diag(R) - 1).max() > 1e-12:
            raise ValueError("matrix needs 1 all along its diagonal: give correlations, not covariances")
        if np.abs(R).max() > 1:
            raise ValueError(f"matrix: a correlation lies between -1 and 1; got {R.flat[np.abs(R).argmax()]:g}")
        least = float(np.linalg.eigvalsh(R)[0])
        if least < -1e-9:
            raise ValueError(
                f"matrix: no deviations can vary like that: its smallest eigenvalue is {least:.3g} and must not be "
                "negative; correct the correlations"
            )
        return self

    @property
    def factor(self) -> np.ndarray:
        """(k, k) L with ``L Lᵀ`` the matrix, which may be singular."""
        value, vector = np.linalg.eigh(np.array(self.matrix))
        return vector * np.sqrt(value.clip(0.0))


class FollowedPath(_Table):
    """How closely friction's path is followed, in stages that ask for nothing else.

    The tolerance is that of one step: the error that it may leave in the contacts' tangential positions, and in the
    slip of those that open, as a share of the motion that the step of the process asks of the contacts (root mean
    squares over the contacts).
    """

    tolerance: Annotated[FiniteFloat, Field(ge=FINEST, le=COARSEST)] = Field(
        Followed.tolerance, description="relative; below its least value steps would be judged by rounding"
    )


class Scene(_Table):
    """A whole scene: one TOML file, or a folder that holds ``scene.toml``."""

    name: Name = Field(description="names the results folder; letters, digits, `_ . + -`")
    description: str = Field("", description="one sentence for the report")
    setting: Literal["draft", "standard", "reference"] | None = Field(
        None, description="fills in what the scene leaves open, and only that"
    )
    element: Name = Field(
        "dkt-opt-curved",
        description="shell element, of those that the installed provider of compliance knows: `dkt-opt-curved`, the "
        "production shell, `dkt-opt`, the same on flat triangles, `p2-cr`, the independent check, …",
    )
    parts: Annotated[list[Part], Field(min_length=1)]
    fixtures: list[Fixture] = []
    locators: list[Locator] = []
    clamps: list[Clamp] = []
    welds: list[Weld] = []
    zones: list[Zone] = []
    stages: Annotated[list[Stage], Field(min_length=1)]
    deviations: list[Deviation] = []
    correlations: list[Correlation] = []
    measurements: list[Measurement] = []
    path: FollowedPath = FollowedPath()
    monte_carlo: MonteCarlo = MonteCarlo()
    report: Report = Report()
    folder: Path = Field(Path("."), exclude=True, description="set by load_scene: where relative file names start")

    @model_validator(mode="before")
    @classmethod
    def _fill_in(cls, table: Any):
        return fill_in(written_out(table, TABLES))

    @model_validator(mode="after")
    def _check(self):
        found = problems(self)
        if found:
            raise ValueError("\n".join(found))
        return self


#: Tables that may be written out in a CSV file, or that stand for several.
TABLES: dict[str, type[BaseModel]] = {
    "locators": Locator,
    "clamps": Clamp,
    "welds": Weld,
    "measurements": Measurement,
}
