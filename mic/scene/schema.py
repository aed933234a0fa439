"""The whole scene, and the tables that configure a run."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, Literal

from pydantic import BaseModel, Field, field_validator, model_validator

from mic.contact.laws import LAWS
from mic.scene import notebook
from mic.scene.checks import find_errors
from mic.scene.deviation import Correlation, Deviation
from mic.scene.fixture import Clamp, Fixture, Locator
from mic.scene.frame import Frame, FramePoint
from mic.scene.keys import Count, FileName, FiniteFloat, Flag, Name, Positive, Table
from mic.scene.measurement import Measurement
from mic.scene.optimisation import Optimisation
from mic.scene.part import Part
from mic.scene.process import FollowedPath, Stage
from mic.scene.scan import Scan
from mic.scene.settings import AUTO, SETTINGS, fill_in
from mic.scene.tables import expand_tables
from mic.scene.weld import Weld
from mic.scene.zone import Zone

__all__ = [
    "Accuracy",
    "DESIGNS",
    "MonteCarlo",
    "Report",
    "Scene",
    "TABLES",
]

#: Samples per independent group of each sampling design.
DESIGNS = {"independent": 1, "antithetic": 2, "latin-hypercube": 50, "sobol": 64}

Fraction = Annotated[FiniteFloat, Field(gt=0, lt=1)]

if TYPE_CHECKING:
    DesignName = str
    SettingName = str
else:
    DesignName = Literal[tuple(DESIGNS)]
    SettingName = Literal[(*SETTINGS, AUTO)]


class Report(Table):
    """Requested results; others are not computed."""

    laws: Annotated[list[str], Field(min_length=1)] = Field(
        ["coulomb"],
        description="contact laws: "
        + ", ".join(f"`{law.name}` ({law.title.removesuffix('.')})" for law in LAWS.values()),
    )
    slip: Flag = False
    """report tangential motion without friction, too; otherwise a third of the contact readings suffices"""

    accuracy: Flag = False
    """estimate the mesh error: each part is solved once more at half the element size"""

    fields: Flag = False
    """mean and 6σ displacement fields, for the report and ParaView"""

    target_cpk: Positive = 1.33
    """required Cpk of every key characteristic, for the verdict"""

    target_outside: Annotated[float, Field(gt=0, lt=1)] | None = None
    """or the largest permitted share of assemblies outside any limit, such as 0.001"""

    contacts: Annotated[Count, Field(ge=0)] = 2000
    """number of samples per law with stored contact pairs (`contacts/`: forces, gaps, states), in whole blocks, at
    least one; statistics use all samples"""

    positions: list[str] = []
    """`welds.NAME`, `locators.NAME`, `clamps.NAME`, or all of a kind (`welds`): their positions become inputs of
    `mic sensitivity` (`welds.NAME.x` …), at the cost of additional readings"""

    @field_validator("laws")
    @classmethod
    def _known_once(cls, laws):
        for law in laws:
            if law not in LAWS:
                raise ValueError(f"there is no law called {law!r}; known: {', '.join(LAWS)}")
        if len(set(laws)) != len(laws):
            raise ValueError("each law may be named once")
        return laws


class Accuracy(Table):
    """Required half-widths of the 95 % intervals of a run."""

    six_sigma: Fraction | None = None
    """of the 6σ of each key characteristic, relative to it"""

    mean: Fraction | None = None
    """of each mean, relative to the 6σ"""

    share_outside: Fraction | None = None
    """of each share outside the limits"""

    cpk: Positive | None = None
    """of each Cpk"""

    slip: Fraction | None = None
    """of the mean and 6σ of each zone's slip, relative to them; of its tangential displacement without friction"""

    @model_validator(mode="before")
    @classmethod
    def _of_six_sigma(cls, given: Any):
        return given if isinstance(given, (dict, cls)) else {"six_sigma": given}

    @model_validator(mode="after")
    def _some(self):
        if not self.required:
            raise ValueError(f"it is empty; give at least one of {', '.join(type(self).model_fields)}")
        return self

    @property
    def required(self) -> dict[str, float]:
        """The given half-widths by key."""
        return self.model_dump(exclude_none=True)


class MonteCarlo(Table):
    """Size and seed of the Monte Carlo, and the contact solver."""

    samples: Annotated[Count, Field(ge=1)] = 500
    """number of assemblies"""

    accuracy: Accuracy | None = None
    """required half-widths of 95 % intervals: `six_sigma` of each key characteristic, relative to it; `mean`, relative
    to 6σ; `share_outside`; `cpk`; `slip`, of the mean and 6σ of each zone's slip, relative to them. A number is that of
    `six_sigma`. Samples are added until all are reached, `samples` at most"""

    seed: Annotated[Count, Field(ge=0, lt=2**63)] = 1
    """of the random numbers"""

    design: DesignName = "independent"
    """independent samples; pairs of opposite deviations; Latin hypercubes of 50 samples; scrambled Sobol' sequences
    of 64. `samples` is a multiple of 2, 50 or 64"""

    table: FileName | None = None
    """file of samples, CSV or Parquet, in place of random numbers: a row per assembly, a column per deviation, N or
    mm (modes `NAME.1` …)"""

    values: list[list[FiniteFloat]] | None = None
    """or the samples, each with a value per deviation in their order"""

    backend: Literal["native", "paper"] = "native"
    """`paper`: OSQP for (12) and ECOS for (13) through CVXPY, as in the paper"""

    solver_work: Annotated[Count, Field(ge=0)] = 2000
    """most factorisations that the contact solver spends on a hard sample at a load before it reports failure"""

    @model_validator(mode="after")
    def _drawn_or_given(self):
        given = "table" if self.table is not None else "values"
        if (self.table is not None or self.values is not None) and self.design != "independent":
            raise ValueError(f"design and {given} exclude each other: remove one of them")
        return self


class Scene(Table):
    """A whole scene: one TOML file, or a folder that holds ``scene.toml``."""

    name: Name
    """name of the results folder; letters, digits, `_ . + -`"""

    description: str = ""
    """one sentence for the report"""

    setting: SettingName | None = None
    """defaults for accuracy, see below"""

    element: Name = "dkt-opt-curved"
    """shell element: `dkt-opt-curved`; `dkmt-opt-curved` for thick parts; `dkt-opt`, on flat triangles; `p2-cr`, an
    independent check; or another of the installed compliance provider"""

    stiffness: Literal["nominal", "mean", "first-order", "auto"] = "nominal"
    """shape for which the stiffness is computed: nominal; mean, with gaps and normals (a second set of influence
    coefficients per part); or each sample's to first order (two more sets per relevant source, more work per
    sample); `auto`: nominal, or first-order where parts are out of shape by more than a quarter of their thickness"""

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
    frames: list[Frame] = []
    scans: list[Scan] = []
    path: FollowedPath = FollowedPath()
    monte_carlo: MonteCarlo = MonteCarlo()
    report: Report = Report()
    optimise: Optimisation | None = None
    folder: Path = Field(Path("."), exclude=True)
    """set by load_scene: where relative file names start"""

    left_open: list[str] = Field([], exclude=True)
    """set for `setting = "auto"`: parts and zones (`parts.NAME`) and `path`, whose values a run chooses"""

    tables_read: list[str] = Field([], exclude=True)
    """set by load_scene: how the columns of files were read, where their headers are not the keys"""

    def __repr__(self) -> str:
        return "\n".join(self._lines)

    __str__ = __repr__

    def _repr_html_(self) -> str:
        """HTML for notebooks."""
        return notebook.html(self, self._lines)

    @property
    def _lines(self) -> list[str]:
        return notebook.lines(self, "Scene", notebook.named(self.zones, "contact zone"))

    @model_validator(mode="before")
    @classmethod
    def _fill_in(cls, table: Any):
        return fill_in(expand_tables(table, TABLES))

    @model_validator(mode="after")
    def _check(self):
        found = find_errors(self)
        if found:
            raise ValueError("\n".join(found))
        return self

    @property
    def reads_slip(self) -> bool:
        """Whether tangential motion of the contacts is modelled."""
        friction = any(LAWS[law].frictional for law in self.report.laws) and any(zone.frictional for zone in self.zones)
        return self.report.slip or friction

    def frame_of(self, item: Measurement) -> Frame | None:
        """The frame in which a measurement is read; None for the assembly as it stands, or a best fit of its own."""
        name = item.frame or next((frame.name for frame in self.frames if frame.all and item.best_fit is None), None)
        return next((frame for frame in self.frames if frame.name == name), None)

    def points_of(self, frame: Frame) -> list[str | FramePoint]:
        """The points of a frame: names of measurements and locators, and points of its own."""
        return frame.points or [item.name for item in self.measurements if item.kind == "point"]


#: Tables that may stand for several items.
TABLES: dict[str, type[BaseModel]] = {
    "locators": Locator,
    "clamps": Clamp,
    "welds": Weld,
    "measurements": Measurement,
}
