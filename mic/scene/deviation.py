"""The tables of what varies: deviations of every kind, and what ties them to each other."""

from __future__ import annotations

from typing import Annotated, ClassVar, Literal

import numpy as np
from pydantic import AfterValidator, Field, model_validator

from mic.scene.distribution import check_distribution
from mic.scene.keys import (
    NORMAL,
    TOWARDS,
    Direction,
    FiniteFloat,
    Flag,
    Name,
    NonNegative,
    OnPart,
    Positive,
    Table,
    Vector,
    unit_vector,
)

__all__ = [
    "ClampDeviation",
    "Correlation",
    "Deviation",
    "FieldDeviation",
    "ForceDeviation",
    "FrictionDeviation",
    "GravityDeviation",
    "LocatorDeviation",
    "MeasuredDeviation",
    "ShapeDeviation",
    "TemperatureDeviation",
    "ThicknessDeviation",
]


class _Deviation(Table):
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


class ForceDeviation(OnPart, _Deviation):
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
    direction: Annotated[Vector | None, AfterValidator(unit_vector)] = Field(
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
    direction: Annotated[Vector, AfterValidator(unit_vector)] = Field(
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


class ThicknessDeviation(_Deviation):
    """``kind = "thickness"``: by how much a sheet is thicker all over than its part's `thickness`.

    Its stiffness, its weight and its faces follow; the shape stays that of the middle of the sheet, and deviations of
    shape stay as large as they are. Its samples are solved one by one. One that lies beyond six σ is counted as failed.
    """

    kind: Literal["thickness"] = Field(description='`"thickness"`')
    part: Name = Field(description="the part whose thickness varies")
    mean: FiniteFloat = Field(0.0, description="mm, added to the part's `thickness`")
    sigma: NonNegative = Field(description="standard deviation, mm")
    skin: Literal[-1, 0, 1] = Field(
        0,
        description="what of the sheet stays where it is drawn, and is located, clamped and measured: 0 its middle, 1 "
        "the skin on the side of the mesh's normals, -1 the other; gaps change by what the other faces move",
    )


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
    pieces: Annotated[list[Name], Field(min_length=2)] | None = Field(
        None, description="with `scores`: names of these pieces, by which a table of samples may call them"
    )

    @model_validator(mode="after")
    def _one_value_each(self):
        if self.pieces is not None and len(set(self.pieces)) != len(self.scores or []):
            raise ValueError(
                f"there are {len(self.scores or [])} scores and {len(set(self.pieces))} names of pieces: give each of "
                "them one"
            )
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
        "about 200, or as many as measured points allow",
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
    direction: Annotated[Vector | None, AfterValidator(unit_vector)] = Field(
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
    | ThicknessDeviation
    | FrictionDeviation,
    Field(discriminator="kind"),
]


class Correlation(Table):
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
