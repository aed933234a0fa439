"""The scene: all its tables, and what is asked of a run."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated, Any, Literal

from pydantic import BaseModel, Field, field_validator, model_validator

from mic.contact.laws import LAWS
from mic.scene.checks import problems
from mic.scene.deviation import Correlation, Deviation
from mic.scene.fixture import Clamp, Fixture, Locator
from mic.scene.keys import Count, FiniteFloat, Flag, Name, Table
from mic.scene.measurement import Measurement
from mic.scene.optimisation import Optimisation
from mic.scene.part import Part
from mic.scene.process import FollowedPath, Stage
from mic.scene.settings import fill_in
from mic.scene.tables import written_out
from mic.scene.weld import Weld
from mic.scene.zone import Zone

__all__ = [
    "MonteCarlo",
    "Report",
    "Scene",
    "TABLES",
]


class Report(Table):
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
    contacts: Annotated[Count, Field(ge=0)] = Field(
        2000,
        description="of how many samples under each law the results keep every contact pair (`contacts/`: forces, "
        "gaps, states), in whole blocks, the first always; statistics are of all samples, whatever is kept",
    )
    positions: list[str] = Field(
        [],
        description="`welds.NAME`, `locators.NAME` and `clamps.NAME` whose places in their sheets are inputs of "
        "`mic sensitivity`, too (`welds.NAME.x` …), or all of a kind: `welds`; each takes functionals of its own",
    )

    @field_validator("laws")
    @classmethod
    def _known_once(cls, laws):
        for law in laws:
            if law not in LAWS:
                raise ValueError(f"there is no law called {law!r}; known: {', '.join(LAWS)}")
        if len(set(laws)) != len(laws):
            raise ValueError("each law may be named once")
        return laws


class MonteCarlo(Table):
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


class Scene(Table):
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
    stiffness: Literal["nominal", "mean", "first-order"] = Field(
        "nominal",
        description="of which shape the parts have their stiffness: of the nominal one; of that which the means of "
        "the deviations give them, gaps and normals with it, by a second set of influence coefficients for each part; "
        "or to first order of each sample's own, by two more sets for each source that matters, and work for each",
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
    optimise: Optimisation | None = None
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
