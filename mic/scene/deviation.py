"""The tables of deviations, and of their correlations."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from typing import Annotated, Any, ClassVar, Literal

import numpy as np
from pydantic import AfterValidator, Field, PrivateAttr, model_validator

from mic.scene.distribution import check_distribution
from mic.scene.keys import (
    NORMAL,
    Direction,
    FileName,
    FiniteFloat,
    Flag,
    LengthUnit,
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
    "DeviationKeys",
    "FieldDeviation",
    "ForceDeviation",
    "FrictionDeviation",
    "GravityDeviation",
    "LocatorDeviation",
    "MeasuredDeviation",
    "ShapeDeviation",
    "TemperatureDeviation",
    "ThicknessDeviation",
    "deviation_unit",
    "targets",
]


class DeviationKeys(Table):
    """Keys of every kind of deviation."""

    name: Name
    """name of the deviation in results and in `model.evaluate`"""

    mean: FiniteFloat = 0.0
    """N or mm"""

    sigma: NonNegative
    """standard deviation, N or mm"""

    distribution: Annotated[str, Field(min_length=1)] = "normal"
    """`normal`, `uniform`, or a continuous distribution of `scipy.stats` with mean and standard deviation, scaled
    to `mean` and `sigma`"""

    parameters: dict[str, FiniteFloat] = {}
    """shape parameters by SciPy's names, such as `{ a = 4 }` with `skewnorm`"""

    truncated: tuple[FiniteFloat, FiniteFloat] | None = None
    """smallest and largest value, N or mm; `mean` and `sigma` are those before truncation"""

    #: The scene's table of `target`, for deviations that move an item.
    moves: ClassVar[str | None] = None

    #: Whether it becomes several modes, each with the distribution.
    several: ClassVar[bool] = False

    _entry: int | None = PrivateAttr(None)

    def entry(self, index: int) -> int:
        """Index in the scene file of the deviation, or of the one that it is a mode of; `index` is its own."""
        return index if self._entry is None else self._entry

    @staticmethod
    def with_entries(deviations: Sequence[Any], entries: Iterable[int]) -> list[Any]:
        """Deviations with their indices in the scene file."""
        found = list(deviations)
        for index, entry in enumerate(entries):
            if entry != found[index].entry(index):
                found[index] = found[index].model_copy()
                found[index]._entry = entry
        return found

    @model_validator(mode="after")
    def _distributed(self):
        if self.several and self.truncated is not None:
            raise ValueError("truncated: not possible for several modes; remove it")
        check_distribution(self)
        return self


class ForceDeviation(OnPart, DeviationKeys):
    """``kind = "force"``: shapes a part as a corrective force would.

    The part is held by a statically determinate choice of its first locators.
    """

    kind: Literal["force"]

    name: Name
    """name of the deviation in results and in `model.evaluate`"""

    part: Name
    """the part that it shapes"""

    direction: Direction = NORMAL
    """of the force"""

    radius: NonNegative = 8.0
    """of the disc that it is spread over, mm"""


class LocatorDeviation(DeviationKeys):
    """``kind = "locator"``: moves a locator along its direction, mm; or a pin or hole that several locators read."""

    kind: Literal["locator"]

    target: Name | Annotated[list[Name], Field(min_length=1)]
    """the locator; or those of one pin, with its `direction`"""

    direction: Annotated[Vector | None, AfterValidator(unit_vector)] = None
    """motion of the pin: each locator moves by the component along its own direction; default: that of the locator"""

    where: Literal["fixture", "part"] = "fixture"
    """whether the pin is displaced in its fixture, or the hole in its part"""

    moves: ClassVar[str | None] = "locators"

    @model_validator(mode="after")
    def _one_way(self):
        if not isinstance(self.target, str) and self.direction is None:
            raise ValueError("several locators of one pin need its direction = [x, y, z]: add it")
        return self


class ClampDeviation(DeviationKeys):
    """``kind = "clamp"``: moves a clamp along its direction, mm; for a clamp with a force, adds to it, N."""

    kind: Literal["clamp"]

    target: Name | Annotated[list[Name], Field(min_length=1)]
    """the clamp (both jaws of a tong), or several that move alike"""

    moves: ClassVar[str | None] = "clamps"


class GravityDeviation(DeviationKeys):
    """``kind = "gravity"``: the weight of all parts in one station.

    Each later station needs a deviation of its own.
    """

    kind: Literal["gravity"]

    direction: Annotated[Vector, AfterValidator(unit_vector)] = (0.0, 0.0, -1.0)
    """of gravity, in the coordinates of the drawing"""

    mean: FiniteFloat = 1.0
    """multiples of the earth's gravity, 9.80665 m/s²"""

    sigma: NonNegative = 0.0
    """standard deviation, in the same multiples"""

    stage: Name | None = None
    """the locate or measure stage in whose station it acts; default: the first"""


class TemperatureDeviation(DeviationKeys):
    """``kind = "temperature"``: a part is uniformly warmer than drawn, from the beginning to the end.

    It is measured warm. Fixtures and thicknesses do not expand.
    """

    kind: Literal["temperature"]

    part: Name | None = None
    """the part; default: all"""

    mean: FiniteFloat = 0.0
    """K"""

    sigma: NonNegative
    """standard deviation, K"""


class FrictionDeviation(DeviationKeys):
    """``kind = "friction"``: change of the coefficient of friction of zones, in all stages.

    Samples are solved one by one. A negative coefficient counts as a failed sample: give `truncated`.
    """

    kind: Literal["friction"]

    target: Name | Annotated[list[Name], Field(min_length=1)]
    """the zone, or several that vary alike; each with a constant `friction`"""

    mean: FiniteFloat = 0.0
    """added to the coefficient"""

    sigma: NonNegative
    """standard deviation of the coefficient"""

    moves: ClassVar[str | None] = "zones"


class ThicknessDeviation(DeviationKeys):
    """``kind = "thickness"``: change of the thickness of a whole sheet.

    It changes stiffness, weight and faces, but neither the shape of the mid-surface nor deviations of shape. Samples
    are solved one by one. One beyond six σ counts as failed.
    """

    kind: Literal["thickness"]

    part: Name
    """the part whose thickness varies"""

    mean: FiniteFloat = 0.0
    """mm, added to the part's `thickness`"""

    sigma: NonNegative
    """standard deviation, mm"""

    skin: Literal[-1, 0, 1] = 0
    """surface that stays in place and is located, clamped and measured: 0 mid-surface, 1 skin on the side of the
    mesh's normals, -1 the other; gaps change accordingly"""


class ShapeDeviation(DeviationKeys):
    """``kind = "shape"``: deviation of a part's shape at points, mm along the normals of its mesh.

    The deviation's value multiplies `values`. Between the points the sheet takes the shape of least bending energy.
    """

    kind: Literal["shape"]

    part: Name
    """the part whose shape varies"""

    points: Annotated[list[Vector], Field(min_length=1)]
    """mm, at most 5 mm from the part"""

    values: Annotated[list[FiniteFloat], Field(min_length=1)] | None = None
    """deviation at each point, mm; default: 1 everywhere"""

    radius: NonNegative = 0.0
    """of the discs over which the values are means, mm; 0: single nodes"""

    loose: Flag = False
    """whether the values hold for the part in any position (measured shapes), not on its locators; needs more than
    six points"""

    noise: NonNegative | Annotated[list[Positive], Field(min_length=1)] = 0.0
    """standard uncertainty of all values, or of each, mm: the shape is a smoothed fit"""

    batch: Name | None = None
    """deviations of one batch have the same part and points, and `scores` of the same pieces"""

    scores: Annotated[list[FiniteFloat], Field(min_length=2)] | None = None
    """of the measured pieces, in standard deviations: each sample is a random piece, in place of the distribution"""

    pieces: Annotated[list[Name], Field(min_length=2)] | None = None
    """with `scores`: names of the pieces, for use in a table of samples"""

    @model_validator(mode="after")
    def _one_value_each(self):
        if self.pieces is not None and len(set(self.pieces)) != len(self.scores or []):
            raise ValueError(
                f"there are {len(self.scores or [])} scores and {len(set(self.pieces))} names: give one per score"
            )
        if self.values is not None and len(self.values) != len(self.points):
            raise ValueError(f"there are {len(self.points)} points and {len(self.values)} values: give one for each")
        if isinstance(self.noise, list) and len(self.noise) != len(self.points):
            raise ValueError(f"there are {len(self.points)} points and noise of {len(self.noise)}: give it for each")
        if self.loose and len(self.points) <= 6:
            raise ValueError("loose takes more than six points: fewer can be fitted by a rigid motion; add some")
        return self

    @property
    def known(self) -> np.ndarray:
        """(c,) values at the points, mm."""
        return np.ones(len(self.points)) if self.values is None else np.array(self.values)


class MeasuredDeviation(DeviationKeys):
    """``kind = "measured"``: measured shapes, of one piece or of several.

    The mean shape of several pieces and its principal modes become deviations of kind `shape`, called
    ``NAME.mean``, ``NAME.1``, ``NAME.2`` …, each of standard deviation 1.
    """

    kind: Literal["measured"]

    several: ClassVar[bool] = True
    part: Name
    """the part that was measured"""

    files: FileName
    """a file per piece, as a name or a pattern such as `measured/outer-*.csv`: a table with columns x, y, z (points,
    mm), or x, y, z, deviation (nominal points, mm along the normals), or node, deviation; or a point cloud (PLY,
    STL, VTK, …). A table may hold several pieces: with a column `serial`, or with a column of deviations for each"""

    unit: LengthUnit = "mm"
    """unit of length of the files"""

    mean: FiniteFloat = 1.0
    """factor of the mean shape"""

    sigma: NonNegative = 1.0
    """factor of the modes: 1 is the measured spread"""

    pieces: Flag = False
    """whether each sample is a random measured piece, not a combination of modes"""

    skin: Literal[-1, 0, 1] = 0
    """surface of the points: 1 skin on the side of the mesh's normals, -1 the other, 0 mid-surface; ignored with a
    deviation"""

    align: Flag = True
    """whether points are first aligned to the nominal part by a rigid best fit"""

    within: Positive = 5.0
    """points farther from the part, mm, are omitted and counted"""

    spacing: Positive | None = None
    """distance of the points of the shape, each fitted to the measured points around it, mm; default: the measured
    points if all pieces have the same few, else about 200 points, or as many as the data allow"""

    noise: NonNegative = 0.0
    """standard uncertainty of a measured point, mm"""

    share: Annotated[FiniteFloat, Field(gt=0, le=1)] = 0.99
    """of the variance that the modes represent; all of it with `pieces`"""


class FieldDeviation(DeviationKeys):
    """``kind = "field"``: a stationary random field of deviations along the normals of a part.

    Its correlation is a Matérn function with ν = 1, by the Laplacian on the sheet. Its principal modes become
    deviations of kind `shape`, called ``NAME.1``, ``NAME.2`` …. With `points` it is defined at these only, for the part
    on its locators; between them the sheet takes the shape of least bending energy.
    """

    kind: Literal["field"]

    several: ClassVar[bool] = True
    part: Name
    """the part whose shape varies"""

    mean: Annotated[FiniteFloat, Field(ge=0, le=0)] = 0.0
    """0: give a mean shape as `shape`"""

    sigma: Positive
    """standard deviation at every point, mm, before the part is placed on its locators"""

    length: Positive
    """correlation length, mm, at which the correlation is 0.14"""

    direction: Annotated[Vector | None, AfterValidator(unit_vector)] = None
    """along which the correlation length differs, such as a bend; projected into the sheet"""

    stretch: Annotated[FiniteFloat, Field(ge=0.1, le=10)] = 1.0
    """with `direction`: correlation length along it, as a multiple of `length`"""

    points: Annotated[list[Vector], Field(min_length=1)] | None = None
    """control points, mm, at most 5 mm from the part, where `sigma` is that of the part on its locators"""

    values: Annotated[list[Positive], Field(min_length=1)] | None = None
    """with `points`: factor of `sigma` at each point; default: 1"""

    share: Annotated[FiniteFloat, Field(gt=0, lt=1)] = 0.95
    """of the variance that the modes represent at every point; the rest is distributed over them"""

    @model_validator(mode="after")
    def _one_value_each(self):
        if (self.direction is None) != (self.stretch == 1.0):
            raise ValueError("direction and stretch belong together: give both, or neither")
        if self.values is not None and self.points is None:
            raise ValueError("values need points: add points, or remove values")
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


def targets(item: Any) -> list[str]:
    """Names of the items that a deviation moves, of a kind with `moves`."""
    return [item.target] if isinstance(item.target, str) else item.target


def deviation_unit(item: Any, scene: Any) -> str:
    """Unit of the amplitude of a deviation, as N or mm; empty for factors and shapes."""
    if item.kind == "clamp":
        first = targets(item)[0]
        return "N" if next(clamp for clamp in scene.clamps if clamp.name == first).force is not None else "mm"
    return {"force": "N", "locator": "mm", "thickness": "mm", "temperature": "K"}.get(item.kind, "")


class Correlation(Table):
    """Correlated deviations: a Gaussian copula, so that each keeps its distribution.

    Each sample has correlated standard normals ``z = L ε`` with ``L Lᵀ`` the matrix; a deviation is the quantile of its
    distribution at ``Φ(z)``. For normal deviations the matrix is their correlation.
    """

    deviations: Annotated[list[Name], Field(min_length=2)]
    """names; a deviation may be in one such table only, and not of kind `measured` or `field`, whose modes are
    uncorrelated"""

    matrix: list[list[FiniteFloat]]
    """correlation matrix: symmetric, 1 on the diagonal, positive semidefinite"""

    @model_validator(mode="after")
    def _is_a_correlation(self):
        n = len(self.deviations)
        if [len(row) for row in self.matrix] != [n] * n:
            raise ValueError(f"matrix: {n} deviations need {n} rows of {n} numbers")
        R = np.array(self.matrix)
        if np.abs(R - R.T).max() > 1e-12:
            i, j = np.argwhere(np.abs(R - R.T) > 1e-12)[0]
            raise ValueError(
                f"matrix is not symmetric: {R[i, j]:g} above the diagonal and {R[j, i]:g} below; correct it"
            )
        if np.abs(np.diag(R) - 1).max() > 1e-12:
            raise ValueError("matrix needs 1 all along its diagonal: give correlations, not covariances")
        if np.abs(R).max() > 1:
            raise ValueError(f"matrix: a correlation lies between -1 and 1; got {R.flat[np.abs(R).argmax()]:g}")
        least = float(np.linalg.eigvalsh(R)[0])
        if least < -1e-9:
            raise ValueError(
                f"matrix: not positive semidefinite: its smallest eigenvalue is {least:.3g} and must not be "
                "negative; correct the correlations"
            )
        return self

    @property
    def factor(self) -> np.ndarray:
        """(k, k) L with ``L Lᵀ`` the matrix, which may be singular."""
        value, vector = np.linalg.eigh(np.array(self.matrix))
        return vector * np.sqrt(value.clip(0.0))
