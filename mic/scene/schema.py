"""The scene file: everything that a user states about an assembly, validated before any work starts.

Lengths are mm, forces N, stiffness MPa; keys that hold degrees end in ``_deg``. Unknown keys are errors.
"""

from __future__ import annotations

import difflib
import tomllib
from pathlib import Path
from typing import Annotated, Literal

import numpy as np
from pydantic import BaseModel, ConfigDict, Field, FiniteFloat, ValidationError, field_validator, model_validator

from mic.errors import SceneError

__all__ = ["SETTINGS", "Scene", "SceneError", "load_scene"]

#: What a named setting gives wherever the scene leaves it open: the geometry's named element size, contact pairs per zone, load
#: increments per stage, samples. What each of them costs, and how far off it is, `verification/trade` measures. The tolerance of the
#: contact solver is not among them: the tightest costs no more than the loosest.
SETTINGS = {
    "draft": {"size": "coarse", "pairs": 17, "increments": 1, "samples": 100},
    "standard": {"size": "medium", "pairs": 34, "increments": 16, "samples": 500},
    "reference": {"size": "fine", "pairs": 68, "increments": 32, "samples": 2000},
}


class _Table(BaseModel):
    model_config = ConfigDict(extra="forbid", frozen=True, str_strip_whitespace=True)


Name = Annotated[str, Field(min_length=1, max_length=60, pattern=r"^[A-Za-z0-9_.+-]+$")]
Vector = tuple[FiniteFloat, FiniteFloat, FiniteFloat]
Positive = Annotated[FiniteFloat, Field(gt=0)]
NonNegative = Annotated[FiniteFloat, Field(ge=0)]


def _unit(value: Vector) -> Vector:
    length = float(np.linalg.norm(value))
    if length < 1e-9:
        raise ValueError("a direction must not be zero: give a vector of any length, such as [0, 0, 1]")
    return tuple(component / length for component in value)


class Part(_Table):
    """One sheet-metal part."""

    name: Name
    mesh: str | None = Field(None, description="mesh file of the mid-surface, relative to the scene file")
    geometry: str | None = Field(None, description="Python file with build(part, size) -> (points, triangles)")
    size: str | Positive | None = Field(None, description="element size in mm, or a named size of the geometry")
    thickness: Positive = Field(description="mm")
    young: Positive = Field(210e3, description="Young's modulus, MPa")
    poisson: Annotated[FiniteFloat, Field(gt=-1, lt=0.5)] = 0.3

    @model_validator(mode="after")
    def _one_source(self):
        if (self.mesh is None) == (self.geometry is None):
            raise ValueError('give either mesh = "file" or geometry = "file.py", not both and not neither')
        if self.geometry is None and self.size is not None:
            raise ValueError("size applies to geometry sources only: remove it, or give geometry instead of mesh")
        if self.geometry is not None and self.size is None:
            raise ValueError(
                "a geometry source needs size: an element size in mm, or one of the geometry's named sizes"
            )
        return self


class Fixture(_Table):
    """A rigid surface that parts may touch."""

    name: Name
    mesh: str | None = Field(None, description="mesh file, relative to the scene file")
    point: Vector | None = Field(None, description="centre of a flat round pad")
    normal: Vector | None = Field(None, description="the pad's outward normal")
    radius: Positive | None = Field(None, description="the pad's radius, mm")

    _normal = field_validator("normal")(lambda v: None if v is None else _unit(v))

    @model_validator(mode="after")
    def _one_shape(self):
        pad = [self.point, self.normal, self.radius]
        if (self.mesh is None) == all(value is None for value in pad) or (self.mesh is None and None in pad):
            raise ValueError('give either mesh = "file", or point, normal and radius of a flat pad')
        return self


class Locator(_Table):
    """A bilateral support of a part in one direction, over a pad of the given radius.

    It engages in the named stage: those of the locate stage place the part (a 3-2-1 scheme), further ones of an N-2-1
    scheme close when the clamps do and force the part.
    """

    name: Name
    part: Name
    point: Vector
    direction: Vector
    radius: NonNegative = 4.0
    stage: Name = "locate"

    _direction = field_validator("direction")(_unit)


class Clamp(_Table):
    """A clamp pushes a part along `direction`, by a force or to a position."""

    name: Name
    part: Name
    point: Vector
    direction: Vector
    force: FiniteFloat | None = Field(None, description="N along direction")
    stroke: FiniteFloat | None = Field(None, description="prescribed position along direction, mm from nominal")
    radius: NonNegative = 5.0
    stage: Name = "clamp"

    _direction = field_validator("direction")(_unit)

    @model_validator(mode="after")
    def _force_or_stroke(self):
        if (self.force is None) == (self.stroke is None):
            raise ValueError("give either force (N) or stroke (mm from the nominal position), not both and not neither")
        return self


class Weld(_Table):
    """A spot weld; it freezes the relative position that it finds, or closes the gap first."""

    name: Name
    parts: tuple[Name, Name]
    point: Vector
    radius: NonNegative = 2.5
    close: bool = False
    moment: bool = Field(True, description="whether the nugget also ties the rotations")
    stage: Name = "weld"


class Zone(_Table):
    """A contact zone: candidate contact pairs between two parts, or between a part and a rigid fixture.

    The zone is where the two surfaces face each other within `max_gap` and `max_angle_deg`, inside the region: a box,
    or a tube of radius `within` about the polyline `path`.
    """

    name: Name
    parts: tuple[Name, Name]
    friction: NonNegative = 0.0
    box: tuple[Vector, Vector] | None = None
    path: Annotated[list[Vector], Field(min_length=1)] | None = None
    within: Positive | None = None
    pairs: Annotated[int, Field(gt=0)] | None = Field(None, description="number of contact pairs")
    spacing: Positive | None = Field(None, description="distance between contact pairs, mm")
    points: Annotated[list[Vector], Field(min_length=1)] | None = Field(
        None, description="the contact points themselves"
    )
    max_gap: Positive = Field(2.0, description="largest nominal gap between the facing surfaces, mm")
    max_angle_deg: Annotated[FiniteFloat, Field(gt=0, lt=90)] = 30.0
    patch: Literal["tributary"] | NonNegative = Field(
        "tributary", description="patch radius in mm, or the tributary area"
    )
    mid_surface: bool = Field(False, description="read the mid-surfaces instead of the facing surfaces")

    @model_validator(mode="after")
    def _consistent(self):
        if self.box is not None and self.path is not None:
            raise ValueError("give box or path, not both")
        if (self.path is None) != (self.within is None):
            raise ValueError("path and within (mm) belong together")
        if sum(value is not None for value in (self.pairs, self.spacing, self.points)) != 1:
            raise ValueError("give exactly one of pairs (how many), spacing (mm) or points (coordinates)")
        if self.box is not None and any(low >= high for low, high in zip(*self.box)):
            raise ValueError("box is [[xmin, ymin, zmin], [xmax, ymax, zmax]] with each minimum below its maximum")
        return self


class Stage(_Table):
    """One step of the process.

    ``locate`` sets the parts down on the locators that name it; ``clamp`` closes the clamps and further locators that name
    it; ``weld`` makes the welds that name it; ``release`` opens all clamps and every locator but `keep`; ``measure`` reads
    the measurements.
    """

    kind: Literal["locate", "clamp", "weld", "release", "measure"]
    name: Name | None = None
    keep: list[Name] | None = Field(None, description="release only: locators that still hold the assembly")
    increments: Annotated[int, Field(ge=1)] = Field(1, description="load increments of the contact resolution")

    @model_validator(mode="after")
    def _fill(self):
        if self.keep is not None and self.kind != "release":
            raise ValueError(f"keep applies to release stages only, this one is of kind {self.kind!r}: remove it")
        if self.name is None:
            object.__setattr__(self, "name", self.kind)
        return self


class Deviation(_Table):
    """One random source of variation, of normal or uniform distribution with the given mean and sigma.

    ``force`` (N, at `point` along `direction`, over `radius`) shapes a part as a corrective force would, the part held on
    a statically determinate choice of the locators that it is set down on; ``locator`` and ``clamp`` move the named element along its direction
    (mm; N for a clamp with a force).
    """

    name: Name
    kind: Literal["force", "locator", "clamp"]
    part: Name | None = None
    point: Vector | None = None
    direction: Vector | None = None
    radius: NonNegative = 8.0
    target: Name | None = Field(None, description="the locator or clamp that moves")
    mean: FiniteFloat = 0.0
    sigma: NonNegative
    distribution: Literal["normal", "uniform"] = "normal"

    _direction = field_validator("direction")(lambda v: None if v is None else _unit(v))

    @model_validator(mode="after")
    def _complete(self):
        place = (self.part, self.point, self.direction)
        if self.kind == "force" and (None in place or self.target is not None):
            raise ValueError("a force deviation needs part, point and direction, and no target")
        if self.kind != "force" and (self.target is None or any(value is not None for value in place)):
            raise ValueError(
                f'a {self.kind} deviation needs target = "<name of the {self.kind}>" and no part, point or direction'
            )
        return self


class Measurement(_Table):
    """A key characteristic: the deviation of a point from nominal along a direction, mm."""

    name: Name
    part: Name
    point: Vector
    direction: Vector
    radius: NonNegative = 2.5
    lower: FiniteFloat
    upper: FiniteFloat

    _direction = field_validator("direction")(_unit)

    @model_validator(mode="after")
    def _ordered(self):
        if self.lower >= self.upper:
            raise ValueError("lower must be smaller than upper")
        return self


class Report(_Table):
    """What the run shall produce; what is not asked for is not computed."""

    laws: Annotated[list[Literal["frictionless", "associated", "coulomb"]], Field(min_length=1)] = ["coulomb"]
    slip: bool = Field(False, description="tangential motion of the contacts even where no friction requires it")
    fields: bool = Field(False, description="mean and 6 sigma displacement fields of the parts")

    @field_validator("laws")
    @classmethod
    def _no_repeats(cls, laws):
        if len(set(laws)) != len(laws):
            raise ValueError("each law may be named once")
        return laws


class MonteCarlo(_Table):
    """Size and seed of the Monte Carlo, and who solves the contacts."""

    samples: Annotated[int, Field(ge=1)] = 500
    seed: Annotated[int, Field(ge=0, lt=2**63)] = 1
    backend: Literal["native", "paper"] = Field(
        "native", description="paper: OSQP for (12) and ECOS for (13) through CVXPY"
    )


class Scene(_Table):
    """A whole scene; see the scene reference in the documentation for every key."""

    name: Name
    description: str = ""
    setting: Literal["draft", "standard", "reference"] | None = Field(
        None, description="fills in what the scene leaves open, see SETTINGS"
    )
    element: Literal["dkt-opt", "p2-cr"] = "dkt-opt"
    parts: Annotated[list[Part], Field(min_length=1)]
    fixtures: list[Fixture] = []
    locators: Annotated[list[Locator], Field(min_length=1)]
    clamps: list[Clamp] = []
    welds: list[Weld] = []
    zones: list[Zone] = []
    stages: Annotated[list[Stage], Field(min_length=1)]
    deviations: list[Deviation] = []
    measurements: list[Measurement] = []
    monte_carlo: MonteCarlo = MonteCarlo()
    report: Report = Report()
    folder: Path = Field(Path("."), exclude=True, description="set by load_scene: where relative file names start")

    @model_validator(mode="before")
    @classmethod
    def _fill_in(cls, table):
        """What the named setting gives, where the scene leaves it open."""
        setting = SETTINGS.get(table.get("setting")) if isinstance(table.get("setting"), str) else None
        if setting is None:
            return table

        def filled(item, key, rivals=(), applies=True):
            given = not isinstance(item, dict) or any(item.get(name) is not None for name in (key, *rivals))
            return item if given or not applies else item | {key: setting[key]}

        def each(key, fill):
            return {key: [fill(item) for item in table[key]]} if isinstance(table.get(key), list) else {}

        return (
            table
            | each("parts", lambda part: filled(part, "size", applies=isinstance(part, dict) and "geometry" in part))
            | each("zones", lambda zone: filled(zone, "pairs", ("spacing", "points")))
            | each("stages", lambda stage: filled(stage, "increments"))
            | {"monte_carlo": filled(table.get("monte_carlo", {}), "samples")}
        )

    @model_validator(mode="after")
    def _references(self):
        part_names = _unique("parts", self.parts + self.fixtures)
        bodies = {part.name for part in self.parts}
        locators = _unique("locators", self.locators)
        clamps = _unique("clamps", self.clamps)
        for key in ("welds", "zones", "deviations", "measurements"):
            _unique(key, getattr(self, key))
        _unique("stages", self.stages)
        for key in ("locators", "clamps", "measurements", "deviations"):
            for i, item in enumerate(getattr(self, key)):
                if item.part is not None:
                    _known(f"{key}[{i}].part", item.part, bodies, "part")
        for key, allowed in (("welds", bodies), ("zones", part_names)):
            for i, item in enumerate(getattr(self, key)):
                for name in item.parts:
                    _known(f"{key}[{i}].parts", name, allowed, "part")
                if item.parts[0] == item.parts[1]:
                    raise ValueError(f"{key}[{i}].parts: a part cannot be joined to itself, name two different parts")
                if not bodies & set(item.parts):
                    raise ValueError(f"{key}[{i}].parts: at least one of the two must be a part, not a fixture")
        for i, item in enumerate(self.deviations):
            if item.kind != "force":
                _known(
                    f"deviations[{i}].target", item.target, locators if item.kind == "locator" else clamps, item.kind
                )
        for key, kinds in (("locators", ("locate", "clamp")), ("clamps", ("clamp",)), ("welds", ("weld",))):
            fitting = [stage.name for stage in self.stages if stage.kind in kinds]
            for i, item in enumerate(getattr(self, key)):
                if item.stage not in fitting:
                    raise ValueError(
                        f"{key}[{i}].stage: no stage of kind {' or '.join(kinds)} is called {item.stage!r}; "
                        f"add one to [[stages]], or name one of: {', '.join(fitting) or 'none yet'}"
                    )
        for i, stage in enumerate(self.stages):
            for name in stage.keep or ():
                _known(f"stages[{i}].keep", name, locators, "locator")
        kinds = [stage.kind for stage in self.stages]
        if kinds[0] != "locate" or kinds.count("locate") != 1:
            raise ValueError("stages: the first stage, and only the first, must be of kind 'locate'")
        if "measure" in kinds[:-1]:
            raise ValueError("stages: 'measure' may only come last, once")
        if self.measurements and "measure" not in kinds:
            raise ValueError("measurements: nothing measures them; add a last stage of kind 'measure' or remove them")
        self._held()
        return self

    def _held(self):
        """Every part needs six independent locators when it is set down, before anything can be computed."""
        for i, part in enumerate(self.parts):
            own = [
                locator
                for locator in self.locators
                if locator.part == part.name and locator.stage == self.stages[0].name
            ]
            points = np.array([locator.point for locator in own]).reshape(-1, 3)
            scale = max(1.0, float(np.ptp(points, axis=0).max(initial=0.0)))
            arms = (points - points.mean(0)) / scale if len(own) else points
            rows = np.array(
                [[*locator.direction, *np.cross(arm, locator.direction)] for locator, arm in zip(own, arms)]
            )
            rank = np.linalg.matrix_rank(rows, tol=1e-6) if len(own) else 0
            if rank < 6:
                raise ValueError(
                    f"parts[{i}] ({part.name}): its {len(own)} locators of the locate stage hold {rank} of its 6 rigid-body motions; "
                    "add locators (at least a 3-2-1 scheme) until all six are held"
                )


def _unique(key, items):
    names = [item.name for item in items]
    for name in names:
        if names.count(name) > 1:
            raise ValueError(f"{key}: the name {name!r} stands more than once; give each its own")
    return set(names)


def _known(key, name, names, what):
    if name not in names:
        near = difflib.get_close_matches(name, names, 1)
        hint = f"did you mean {near[0]!r}?" if near else f"known: {', '.join(sorted(names)) or 'none'}"
        raise ValueError(f"{key}: there is no {what} called {name!r}; {hint}")


def load_scene(path) -> Scene:
    """Read and validate a scene file.

    Parameters
    ----------
    path : path-like
        A TOML file, or a folder that holds ``scene.toml``.

    Raises
    ------
    SceneError
        With one line per problem: file, key, what is wrong, what to do.
    """
    path = Path(path)
    if path.is_dir():
        path = path / "scene.toml"
    try:
        with open(path, "rb") as file:
            table = tomllib.load(file)
    except FileNotFoundError:
        raise SceneError(f"{path}: there is no such scene file; check the path") from None
    except (tomllib.TOMLDecodeError, UnicodeDecodeError) as error:
        raise SceneError(f"{path}: not valid TOML: {error}; mend the syntax there") from None
    if "folder" in table:
        raise SceneError(f"{path}: folder: unknown key; remove it")
    try:
        return Scene(**table, folder=path.parent.resolve())
    except ValidationError as error:
        raise SceneError("\n".join(_explain(path, item) for item in error.errors())) from None


def _explain(path, item) -> str:
    """One line for one problem found by the validation."""
    key = "".join(
        f"[{step}]" if isinstance(step, int) else f".{step}"
        for step in item["loc"]
        if not (isinstance(step, str) and step.startswith(("literal[", "constrained", "float", "str", "function")))
    ).lstrip(".")
    message = item["msg"].removeprefix("Value error, ")
    remedy = {
        "extra_forbidden": "unknown key; remove it or mend its spelling",
        "missing": "required key is missing; add it",
        "greater_than": f"{message}; got {item.get('input')!r}, correct the value",
        "greater_than_equal": f"{message}; got {item.get('input')!r}, correct the value",
        "finite_number": f"{message}; got {item.get('input')!r}, give a finite number",
    }
    text = remedy.get(
        item["type"], message if item["type"] == "value_error" else f"{message}; got {item.get('input')!r}, correct it"
    )
    return f"{path}: {key}: {text}" if key else f"{path}: {text}"
