"""What a run leaves behind, declared once: tables, columns, types, units.

The files are written and read by this declaration, and the reference of the results is printed from it (``python -m
mic.results.schema``). Keys are columns of their own (``stage``, ``zone``, ``measurement``), never parts of a column's
name, so that a table is selected and grouped without taking names apart.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import pandas as pd
from pandas.api import types

from mic.errors import FormatError
from mic.system.files import replacing

__all__ = [
    "ACCURACY",
    "COMPARISON",
    "CONTACTS",
    "CONDENSED",
    "CONTACT_STATISTICS",
    "CONTRIBUTORS",
    "DATASETS",
    "DENSITY",
    "DESIGN_POINTS",
    "DEVIATIONS",
    "EXPLANATION",
    "FIELDS",
    "FORCES",
    "FRICTION",
    "FRICTION_EFFECTS",
    "FURTHER",
    "LIMITS",
    "LIMIT_STATISTICS",
    "LINEARITY",
    "MEASUREMENTS",
    "MEASUREMENT_STATISTICS",
    "OPTIMA",
    "OPTIMUM_CHANGES",
    "OPTIMUM_MATCHES",
    "ORDERS",
    "PROFILES",
    "PROFILE_STATISTICS",
    "PATH",
    "PATH_ERRORS",
    "PREDICTIONS",
    "RARE",
    "REMEDIES",
    "REMEDY_EFFECTS",
    "RESOLUTIONS",
    "SAMPLES",
    "SENSITIVITIES",
    "SLIPS",
    "SPREADS",
    "STATISTICS",
    "STUDIES",
    "SUMS",
    "ZONE_STATISTICS",
    "Column",
    "Table",
    "reference",
]


@dataclass(frozen=True)
class Column:
    """One quantity.

    Attributes
    ----------
    name : str
    dtype : {"bool", "int32", "int64", "float32", "float64", "category", "str"}
        ``category``: a name out of few, stored once.
    unit : str
        Empty where there is none.
    meaning : str
    optional : bool
        Whether a table may lack it: tangential quantities where only normals are modelled.
    shape : str
        Of one row's value; empty for a single number or name.
    """

    name: str
    dtype: str
    unit: str
    meaning: str
    optional: bool = False
    shape: str = ""

    def fits(self, dtype: Any) -> bool:
        """Whether values of a type are of the declared one."""
        if self.dtype == "category":
            return isinstance(dtype, pd.CategoricalDtype)
        if self.dtype == "str":
            return types.is_object_dtype(dtype) or types.is_string_dtype(dtype)
        return str(dtype) == self.dtype


@dataclass(frozen=True)
class Table:
    """One table, and the file or the dataset that holds it.

    Attributes
    ----------
    name : str
        Of the dataset's folder, or of the file under ``tables/``.
    rows : str
        What one row stands for.
    columns : tuple of Column
    description : str
    place : str
        The file, from the run folder.
    version : int
        Of its columns and what they mean; files of another version are refused in words.
    """

    name: str
    rows: str
    columns: tuple[Column, ...]
    description: str
    place: str
    version: int = 1

    @property
    def names(self) -> list[str]:
        """Names of the columns, in order."""
        return [column.name for column in self.columns]

    def check(self, frame: pd.DataFrame, where: object, remedy: str) -> None:
        """Compare a frame with the declaration.

        Parameters
        ----------
        frame : DataFrame
        where : path-like
            Named in the message.
        remedy : str
            What to do about it.

        Raises
        ------
        FormatError
            Naming the first column that is missing, unknown, out of order, or of another type.
        """
        found = list(frame.columns)
        # Together: taking columns out one by one takes as long as to write them.
        dtypes = dict(zip(found, frame.dtypes))
        for column in self.columns:
            if column.name not in dtypes:
                if column.optional:
                    continue
                raise FormatError(f"{where}: table {self.name!r} lacks the column {column.name!r}; {remedy}")
            if not column.fits(dtypes[column.name]):
                raise FormatError(
                    f"{where}: table {self.name!r}: column {column.name!r} holds {dtypes[column.name]}, "
                    f"expected {column.dtype}; {remedy}"
                )
        known = [name for name in self.names if name in found]
        if found != known:
            odd = next(name for name, place in zip(found, [*known, None]) if name != place)
            what = "is out of order" if odd in known else "is none of this table's"
            raise FormatError(f"{where}: table {self.name!r}: column {odd!r} {what}; {remedy}")

    def read(self, folder: Path, remedy: str) -> pd.DataFrame | None:
        """The CSV file that a run folder holds of it; None where there is none.

        Parameters
        ----------
        folder : Path
        remedy : str
            What to do about a file that is not as declared.

        Raises
        ------
        FormatError
        """
        path = folder / self.place
        if not path.is_file():
            return None
        floats = [column.name for column in self.columns if column.dtype == "float64"]
        frame = pd.read_csv(
            path,
            float_precision="round_trip",
            keep_default_na=False,  # a zone may be called NA
            na_values={name: [""] for name in floats},
            dtype={column.name: str for column in self.columns if column.dtype == "str"},
        )
        whole = [name for name in floats if name in frame and types.is_integer_dtype(frame[name])]
        frame = frame.astype(dict.fromkeys(whole, "float64"))
        self.check(frame, path, remedy)
        return frame

    def write(self, folder: Path, frame: pd.DataFrame) -> None:
        """Write the CSV file of it into a run folder, to nine digits.

        Raises
        ------
        FormatError
            If the frame is not as declared.
        """
        path = folder / self.place
        self.check(frame, path, "this is a fault of the program")
        with replacing(path) as temporary:
            frame.to_csv(temporary, index=False, float_format="%.9g")

    def empty(self) -> pd.DataFrame:
        """A frame of no rows, without the optional columns."""
        dtypes = {column.name: "object" if column.dtype == "str" else column.dtype for column in self.columns}
        return pd.DataFrame(
            {column.name: pd.Series([], dtype=dtypes[column.name]) for column in self.columns if not column.optional}
        )


def _dataset(name, rows, columns, description, version=1):
    return Table(name, rows, columns, description, f"{name}/law=LAW/FIRST-LAST.parquet", version)


def _statistic(name, rows, columns, description, version=1):
    return Table(name, rows, columns, description, f"tables/{name}.csv", version)


_SAMPLE = Column("sample", "int32", "", "number of the sample, from 0")
_STAGE = Column("stage", "category", "", "stage that resolves contact")
_ZONE = Column("zone", "category", "", "contact zone")

SAMPLES = _dataset(
    "samples",
    "one sample",
    (
        _SAMPLE,
        Column("failed", "bool", "", "whether contact missed its tolerance in some stage"),
        Column("built", "bool", "", "whether every clamp and gun of limited force reached its position, see `limits`"),
    ),
    "Samples that are finished. Written last of a block: once it stands, the block is whole.",
    version=2,
)
DEVIATIONS = _dataset(
    "deviations",
    "one sample and deviation",
    (
        _SAMPLE,
        Column("deviation", "category", "", "name of the deviation in the scene"),
        Column("value", "float64", "N or mm", "drawn value: N of a force or of a clamp that pushes, else mm"),
    ),
    "What was drawn.",
)
RESOLUTIONS = _dataset(
    "resolutions",
    "one sample and stage",
    (
        _SAMPLE,
        _STAGE,
        Column(
            "residual",
            "float64",
            "1",
            "scale-free residual of the contact law, the largest of the increments, or of the ends of what is followed",
        ),
        Column("status", "category", "", "outcome of the last step, or why the sample could not be computed"),
        Column(
            "rung",
            "category",
            "",
            "`followed` or `increments` where the path was gone like that; else the rung of the ladder that found the "
            "last forces",
        ),
        Column("rescued", "bool", "", "whether a path could not be followed, and plain increments took its place"),
        Column("iterations", "int64", "", "iterations of the solver, over all steps"),
        Column("converged", "bool", "", "whether everything met its tolerance"),
        Column(
            "path_error",
            "float64",
            "mm",
            "estimate of the error that the path up to the end of the stage left in the contacts' tangential "
            "positions, and in the slip of those that opened, root mean square over the pairs: what the stage's path "
            "left, and those of the stages before; NaN where nothing estimates it",
        ),
        Column("steps", "int64", "", "steps along the path"),
        Column(
            "factorisations",
            "int64",
            "",
            "factorisations of the active contacts, of all rungs, in vain or not; 0 where a backend tells none",
        ),
        Column("unseen", "float64", "mm", "deepest penetration between the pairs at the stage's end, which none sees"),
        Column("unseen_at", "int32", "", "at which of the model's points between the pairs; −1 where there is none"),
    ),
    "How contact was resolved, and what the way there left.",
    version=5,
)
SLIPS = _dataset(
    "slips",
    "one sample, stage and zone",
    (
        _SAMPLE,
        _STAGE,
        _ZONE,
        Column(
            "rms_tangential",
            "float64",
            "mm",
            "tangential displacement: root mean square of ‖u_t‖ over the zone's pairs, open ones included, since the "
            "stage before",
        ),
        Column(
            "rms_slip",
            "float64",
            "mm",
            "slip: root mean square over the zone's pairs of what each slipped under load in the stage, net; of "
            "candidates weighed by the work of friction on each, for the denser they are, the less of the area touches",
        ),
        Column("slip_length", "float64", "mm", "the same of the length of the way that each slipped"),
        Column(
            "friction_work", "float64", "N mm", "work that friction dissipated in the stage, sum over the zone's pairs"
        ),
        Column(
            "open",
            "float64",
            "1",
            "share of the stage's path that a pair was open, mean over the zone's pairs; of candidates it grows with "
            "their number, as stuck and slipping shares fall",
        ),
        Column("stick", "float64", "1", "share of the path that a pair stuck"),
        Column("slip", "float64", "1", "share of the path that a pair slipped"),
    ),
    "Motion of the zones along their surfaces; no rows where only normals are modelled. Without friction nothing slips "
    "under load and no path is followed: all but `rms_tangential` is NaN. Pairs that a zone states count alike, "
    "candidates by their area, and for slip under load by friction's work.",
    version=3,
)
MEASUREMENTS = _dataset(
    "measurements",
    "one sample and measurement",
    (
        _SAMPLE,
        Column("measurement", "category", "", "name of the key characteristic"),
        Column("value", "float64", "mm", "deviation from nominal"),
    ),
    "Key characteristics.",
)
PROFILES = _dataset(
    "profiles",
    "one sample, measurement over many points, and point",
    (
        _SAMPLE,
        Column("measurement", "category", "", "name of the key characteristic"),
        Column("point", "int32", "", "number of the point, from 0, in the order of the scene's `points`"),
        Column("value", "float64", "mm", "deviation from nominal there, after a best fit if one is asked for"),
    ),
    "What parallelisms and profiles read at each of their points. No rows where the scene has none.",
)
CONTACTS = _dataset(
    "contacts",
    "one sample, stage and contact pair",
    (
        _SAMPLE,
        _STAGE,
        _ZONE,
        Column("contact", "int32", "", "number of the pair, from 0"),
        Column("f_n", "float64", "N", "normal force, compression positive"),
        Column("f_t1", "float64", "N", "first tangential force", optional=True),
        Column("f_t2", "float64", "N", "second tangential force", optional=True),
        Column("u_n", "float64", "mm", "gap, positive when apart"),
        Column("u_t1", "float64", "mm", "first tangential displacement since the stage before", optional=True),
        Column("u_t2", "float64", "mm", "second tangential displacement since the stage before", optional=True),
        Column("state", "category", "", "open, stick or slip, at the end of the stage"),
        Column("path_stick", "float32", "1", "share of the stage's path that the pair stuck", optional=True),
        Column("path_slip", "float32", "1", "share of the stage's path that it slipped", optional=True),
    ),
    "Forces and displacements of the contact pairs at the end of a stage, and their states on the way: where a pair "
    "neither stuck nor slipped, it was open. The shares of the path are NaN without friction. Of the first samples "
    "only, as many as the scene's report asks for under `contacts`; what the others add up to is in `sums`.",
    version=2,
)
LIMITS = _dataset(
    "limits",
    "one sample, stage and clamp or gun of limited force",
    (
        _SAMPLE,
        _STAGE,
        Column("name", "category", "", "clamp with a limit, or weld with a gun"),
        Column("pushed", "float64", "N", "force that it pushes with"),
        Column("left", "float64", "mm", "way that is left to its position: to its stroke, or of the weld's gap"),
        Column("reached", "bool", "", "whether that is less than 1 µm"),
        Column(
            "needed",
            "float64",
            "N",
            "force that its position takes where it is not reached, all others of the sample at theirs; else NaN",
        ),
    ),
    "Clamps with a limit at the end of each stage that leaves them closed, guns when their weld is made. No rows where "
    "the scene has none.",
)
#: The Parquet datasets; :data:`SAMPLES` stands last, as it is written last.
DATASETS = (DEVIATIONS, RESOLUTIONS, SLIPS, MEASUREMENTS, PROFILES, CONTACTS, LIMITS, SAMPLES)

FORCES = Table(
    "forces",
    "one sample",
    (
        Column("force", "float64", "N, N mm", "forces on the retained functionals in the last stage", shape="F"),
        Column("motion", "float64", "mm, rad", "rigid-body motions of the parts in the last stage", shape="6P"),
    ),
    "What the fields are computed from; kept only where the scene asks for fields, and of the samples whose contact "
    "pairs are kept.",
    "forces/law=LAW/FIRST-LAST.npz",
)
#: What stands for the contact pairs and the forces of many samples; arrays of the program's own.
SUMS = Table(
    "sums",
    "one block",
    (),
    "What the contact pairs of a block's valid samples add up to, where it keeps none: moments and counts, from which "
    "the statistics come.",
    "sums/law=LAW/FIRST-LAST.npz",
)
CONDENSED = Table(
    "condensed",
    "one block",
    (),
    "In place of `forces`, where a block keeps no contact pairs: as few rows for each part as have the same products.",
    "condensed/law=LAW/FIRST-LAST.npz",
)
FIELDS = Table(
    "fields",
    "one vertex of the part's mesh",
    (
        Column("mean", "float64", "mm", "mean displacement from nominal", shape="3"),
        Column("six_sigma", "float64", "mm", "6σ of the displacement along x, y, z", shape="3"),
        Column("six_sigma_magnitude", "float64", "mm", "root of the summed squares of `six_sigma`"),
        Column("six_sigma_normal", "float64", "mm", "6σ of the displacement along the vertex normal"),
    ),
    "Displacement fields of one part under one law, for ParaView. The same arrays stand in `fields/fields.npz`, and "
    "the nominal surface of each part, with its `normal`, in `fields/PART.vtu`.",
    "fields/LAW-PART.vtu",
)


def _estimate(name, unit, meaning, optional=False) -> tuple[Column, ...]:
    """An estimate and the ends of its confidence interval."""
    return (
        Column(name, "float64", unit, meaning, optional),
        Column(f"{name}_low", "float64", unit, f"lower end of the 95 % interval of `{name}`", optional),
        Column(f"{name}_high", "float64", unit, f"upper end of the 95 % interval of `{name}`", optional),
    )


def _before_and_after(name, unit, meaning) -> tuple[Column, ...]:
    """A figure on two sides, and how it changes."""
    return (
        Column(f"{name}_a", "float64", unit, f"{meaning}, before"),
        Column(f"{name}_b", "float64", unit, f"{meaning}, after"),
        *_estimate(f"{name}_change", unit, f"by how much `{name}_b` is more than `{name}_a`, of pairs of samples"),
    )


def _hanging(name, unit, meaning, optional=False) -> tuple[Column, ...]:
    """An estimate, its interval, and what a tighter path changes of it."""
    return (
        *_estimate(name, unit, meaning, optional),
        Column(f"{name}_path", "float64", unit, f"what a tighter path changes of `{name}`, see `path`"),
        Column(f"{name}_path_share", "float64", "1", f"`{name}_path` as a share, see `path`"),
    )


_LAW = Column("law", "str", "", "contact law")
_USED = Column("samples", "int64", "", "samples that the row rests on")

ZONE_STATISTICS = _statistic(
    "zones",
    "one law, stage and zone",
    (
        _LAW,
        Column("stage", "str", "", "stage that resolves contact"),
        Column("zone", "str", "", "contact zone"),
        Column("contacts", "int64", "", "contact pairs of the zone"),
        Column("friction", "float64", "1", "coefficient of friction under this law; none where it depends on pressure"),
        _USED,
        *_hanging("mean_rms_tangential", "mm", "mean of the zone's RMS tangential displacement"),
        *_hanging("six_sigma_rms_tangential", "mm", "6σ of the zone's RMS tangential displacement"),
        *_hanging("mean_rms_slip", "mm", "mean of the zone's RMS slip under load"),
        *_hanging("six_sigma_rms_slip", "mm", "6σ of the zone's RMS slip under load"),
        *_estimate("mean_slip_length", "mm", "mean of the length of the way slipped"),
        *_estimate("mean_friction_work", "N mm", "mean of the work that friction dissipates in the zone"),
        *_estimate("mean_normal_force", "N", "mean of the sum of the pairs' normal forces at the end of the stage"),
        *_estimate("six_sigma_normal_force", "N", "its 6σ"),
        *_estimate(
            "mean_normal_force_clear",
            "N",
            "mean of the same sum over the pairs farther than three nugget radii from every weld: beside a nugget the "
            "sum grows with the number of pairs, there it converges",
        ),
        *_estimate("six_sigma_normal_force_clear", "N", "its 6σ"),
        Column("open", "float64", "1", "mean share of the stage's path that a pair of the zone is open"),
        Column("stick", "float64", "1", "mean share of the path that it sticks"),
        Column("slip", "float64", "1", "mean share of the path that it slips"),
    ),
    "Motion of each zone along its surfaces, stage by stage, as in the dataset `slips`, empty where no tangential "
    "motion was modelled, or no friction; and what presses the zone together.",
    version=3,
)
CONTACT_STATISTICS = _statistic(
    "contacts",
    "one law, stage and contact pair",
    (
        _LAW,
        Column("stage", "str", "", "stage that resolves contact"),
        Column("zone", "str", "", "contact zone"),
        Column("contact", "int64", "", "number of the pair, from 0"),
        _USED,
        *_estimate("mean_f_n", "N", "mean normal force"),
        *_estimate("six_sigma_f_n", "N", "6σ of the normal force"),
        Column("mean_gap", "float64", "mm", "mean gap"),
        *_estimate("mean_slip_force", "N", "mean of ‖f_t‖", optional=True),
        *_estimate("six_sigma_slip_force", "N", "6σ of ‖f_t‖", optional=True),
        *_estimate("mean_tangential", "mm", "mean of ‖u_t‖, the tangential displacement", optional=True),
        *_estimate("open", "1", "share of the samples in which the pair is open at the end of the stage"),
        *_estimate("stick", "1", "share of the samples in which it sticks"),
        *_estimate("slip", "1", "share of the samples in which it slips"),
        Column("path_open", "float64", "1", "mean share of the stage's path that it is open", optional=True),
        Column("path_stick", "float64", "1", "mean share of the path that it sticks", optional=True),
        Column("path_slip", "float64", "1", "mean share of the path that it slips", optional=True),
    ),
    "Forces and states of each contact pair.",
    version=2,
)
MEASUREMENT_STATISTICS = _statistic(
    "measurements",
    "one law and measurement",
    (
        _LAW,
        Column("measurement", "str", "", "name of the key characteristic"),
        Column("lower", "float64", "mm", "lower limit"),
        Column("upper", "float64", "mm", "upper limit"),
        _USED,
        *_hanging("mean", "mm", "mean deviation from nominal"),
        *_estimate("sigma", "mm", "standard deviation, n - 1 in the denominator"),
        *_hanging("six_sigma", "mm", "six standard deviations"),
        *_estimate("min", "mm", "smallest sample; nothing bounds the population from below"),
        *_estimate("max", "mm", "largest sample; nothing bounds the population from above"),
        *_estimate(
            "cp", "1", "Cp = (upper - lower) / 6σ; NaN of what is never negative, which has an upper limit only"
        ),
        *_estimate("cpk", "1", "Cpk = min(upper - mean, mean - lower) / 3σ, of these (upper - mean) / 3σ"),
        *_estimate("share_outside", "1", "share of the samples outside the limits"),
        Column(
            "improved",
            "str",
            "",
            "what the following rest on: `linear` or `quadratic` regression on the deviations, whose moments are known "
            "(`mic.statistics.regression`); `plain` where none is narrower, or the samples are too few, and the figures "
            "are empty",
        ),
        Column("explained", "float64", "1", "share of the variance that the regression explains"),
        *_estimate("improved_mean", "mm", "mean by regression"),
        *_estimate("improved_six_sigma", "mm", "six standard deviations by regression"),
    ),
    "Key characteristics against their limits.",
    version=3,
)
PROFILE_STATISTICS = _statistic(
    "profiles",
    "one law, measurement over many points, and point",
    (
        _LAW,
        Column("measurement", "str", "", "name of the key characteristic"),
        Column("point", "int64", "", "number of the point, from 0"),
        Column("x", "float64", "mm", "where"),
        Column("y", "float64", "mm", "where"),
        Column("z", "float64", "mm", "where"),
        _USED,
        *_estimate("mean", "mm", "mean deviation from nominal there"),
        *_estimate("six_sigma", "mm", "six standard deviations"),
    ),
    "Maps of deviation: what parallelisms and profiles read at each of their points.",
)
LIMIT_STATISTICS = _statistic(
    "limits",
    "one law, stage and clamp or gun of limited force",
    (
        _LAW,
        Column("stage", "str", "", "stage"),
        Column("name", "str", "", "clamp with a limit, or weld with a gun"),
        Column("limit", "float64", "N", "its force at most"),
        _USED,
        Column("short", "int64", "", "samples in which it does not reach its position: those are not built"),
        *_estimate("share_short", "1", "their share"),
        *_estimate("mean_pushed", "N", "mean of the force that it pushes with"),
        Column("max_left", "float64", "mm", "most of the way that is left"),
        Column("max_needed", "float64", "N", "most of the forces that the position would take where it is not reached"),
    ),
    "Clamps and guns of limited force. Only where the scene has any. Samples that are not built enter all statistics "
    "as they are, held with what force there is.",
)
PATH = _statistic(
    "path",
    "one law, repeated sample and quantity",
    (
        _LAW,
        Column("sample", "int64", "", "number of the sample"),
        Column("quantity", "str", "", "`measurement`, `rms_tangential` or `rms_slip`"),
        Column("stage", "str", "", "stage at whose end it is read"),
        Column("name", "str", "", "key characteristic or contact zone"),
        Column("value", "float64", "mm", "in the run"),
        Column("tighter", "float64", "mm", "on a tighter path"),
        Column("converged", "bool", "", "whether the repetition converged; else leave the row out"),
    ),
    "The first samples of the run once more on a tighter path: followed to a sixteenth of the tolerance, or in four "
    "times the increments (under the law (13), whose increments are part of it, that says how much hangs on them). The "
    "effect of the path on a mean or 6σ, the columns `…_path` of the other tables, is that of these repetitions less "
    "that of the same samples in the run; `…_path_share` is its share of the mean or 6σ of these samples, and of their "
    "6σ for the mean of a key characteristic, which may be 0. Of less than 10 µm no share is told.",
)
PATH_ERRORS = _statistic(
    "path_errors",
    "one law, repeated sample and stage",
    (
        _LAW,
        Column("sample", "int64", "", "number of the sample"),
        Column("stage", "str", "", "stage that resolves contact"),
        Column("estimate", "float64", "mm", "`path_error` of `resolutions`"),
        Column(
            "measured",
            "float64",
            "mm",
            "what a tighter path changes of the contacts' tangential positions, root mean square over the pairs",
        ),
        Column("converged", "bool", "", "whether the repetition converged; else leave the row out"),
    ),
    "The estimated error of the path beside the measured one, for the samples of `path`.",
)
FRICTION = _statistic(
    "friction",
    "one friction coefficient, law and studied sample",
    (
        Column("mu", "float64", "1", "friction coefficient, mean over the pairs"),
        _LAW,
        Column("sample", "int64", "", "number within the study, from 0"),
        Column("converged", "bool", "", "whether this law and Coulomb's both converged; else leave the row out"),
        Column("normal_force", "float64", "N", "sum of the normal forces"),
        Column("friction_force", "float64", "N", "sum of ‖f_t‖"),
        Column("slip", "float64", "mm", "root mean square of ‖u_t‖ over all pairs"),
        Column("gap_at_load", "float64", "mm", "largest gap at a pair that carries load"),
        Column("contacts_open", "int64", "", "open pairs"),
        Column("contacts_stick", "int64", "", "pairs that stick"),
        Column("contacts_slip", "int64", "", "pairs that slip"),
        Column("force_change", "float64", "1", "‖f - f_c‖ / ‖f_c‖ against Coulomb's solution"),
        Column("slip_change", "float64", "1", "‖u_t - u_ct‖ / ‖u_ct‖ against Coulomb's solution"),
        Column("changed_states", "int64", "", "pairs whose state differs from Coulomb's"),
    ),
    "A few samples solved anew in one step under every law, with the scene's friction scaled: what the choice of the "
    "law costs. Only where both Coulomb's and the associated law were asked for.",
)
ACCURACY = _statistic(
    "accuracy",
    "one part and quantity",
    (
        Column("part", "str", "", "name of the part"),
        Column("quantity", "str", "", "`H`, or the key characteristic whose influence it is"),
        Column("set_down", "float64", "1", "estimated error over its size, on the six locators of the first stage"),
        Column("located", "float64", "1", "the same on all locators of the part"),
        Column("nodes", "int64", "", "of the part's mesh"),
        Column("seconds", "float64", "s", "that its influence coefficients took, at the functionals compared"),
        Column("memory", "float64", "MB", "that its factors took; 0 where that is not known"),
        Column("finer_nodes", "int64", "", "of the mesh at half the size"),
        Column("finer_seconds", "float64", "s", "that it took"),
        Column("finer_memory", "float64", "MB", "that it took"),
    ),
    "What meshes leave (`mic.model.mesh_accuracy`). Only where the report asks for `accuracy`; written by the run.",
)
CONTRIBUTORS = _statistic(
    "contributors",
    "one law, key characteristic and contributor",
    (
        _LAW,
        Column("measurement", "str", "", "name of the key characteristic"),
        Column("contributor", "str", "", "a deviation, or deviations that belong together, such as a part's modes"),
        *_estimate("first", "1", "share of the variance that it makes alone, S"),
        *_estimate("total", "1", "share with all interactions that it has a part in, T"),
        Column("regression", "float64", "1", "share by a linear regression on the deviations"),
        Column(
            "tangent", "float64", "1", "share by the differences at the mean, as a linear chain of tolerances has it"
        ),
        Column("bound", "float64", "1", "what the total index is at most, by derivatives; empty where few contribute"),
    ),
    "What makes the variance of the key characteristics: Sobol's indices on the reduced model itself, beside what a "
    "linear analysis says. Estimates are not cut to 0 … 1: what lies outside is noise. Empty where a characteristic "
    "does not vary, and of contributors that were left out: of many, those that hardly matter count as one.",
)
SENSITIVITIES = _statistic(
    "sensitivities",
    "one law, key characteristic and input",
    (
        _LAW,
        Column("measurement", "str", "", "name of the key characteristic"),
        Column("input", "str", "", "a deviation, or where in the scene what is held fixed stands"),
        Column("step", "float64", "N, mm or 1", "by how much it is moved: a deviation by its standard deviation"),
        Column("samples", "int64", "", "samples that the range rests on, the mean assembly among them"),
        Column("effect", "float64", "mm", "what that changes of the mean assembly: the derivative times the step"),
        Column("effect_low", "float64", "mm", "the smallest over the samples"),
        Column("effect_high", "float64", "mm", "the largest"),
        Column("effect_below", "float64", "mm", "of the mean assembly at a change of state, towards smaller values"),
        Column("effect_above", "float64", "mm", "likewise towards larger values; `effect` where it is at none"),
        Column(
            "reach", "float64", "1", "steps until a contact of the mean assembly changes its state; inf if none does"
        ),
    ),
    "What steps of the inputs change: exact derivatives through contact and memory (`mic.process.sensitivity`). "
    "Written by `mic sensitivity`.",
    version=2,
)
SPREADS = _statistic(
    "spreads",
    "one law and key characteristic",
    (
        _LAW,
        Column("measurement", "str", "", "name of the key characteristic"),
        _USED,
        *_estimate("plain_six_sigma", "mm", "6σ of these samples alone"),
        Column("kind", "str", "", "`linear` or `quadratic` in the deviations; `plain` where neither is narrower"),
        Column("explained", "float64", "1", "share of the variance that it explains"),
        *_estimate("mean", "mm", "mean by a regression on values and derivatives"),
        *_estimate("six_sigma", "mm", "6σ by it"),
    ),
    "What few samples with their exact derivatives tell of mean and 6σ (`mic.statistics.derivative_regression`). Written by "
    "`mic sensitivity`; empty where the deviations' moments are not known, or they depend on each other.",
)
LINEARITY = _statistic(
    "linearity",
    "one law and key characteristic",
    (
        _LAW,
        Column("measurement", "str", "", "name of the key characteristic"),
        _USED,
        Column("failed", "int64", "", "samples left out, since one of their evaluations failed"),
        Column("evaluations", "int64", "", "evaluations of the reduced model, for all key characteristics together"),
        *_estimate("sigma", "mm", "standard deviation"),
        Column("r_squared", "float64", "1", "R² of the linear regression, corrected for its number of inputs"),
        *_estimate("interaction", "1", "largest T - S"),
        Column("tangent_sigma", "float64", "mm", "standard deviation by the differences at the mean"),
        Column("linear", "bool", "", "whether a linear analysis can be believed"),
    ),
    "How far a linear analysis holds: not where R² is below 0.95, an interaction makes more than 0.05 of the variance, "
    "or the tangent's standard deviation is off by more than a tenth.",
)
FRICTION_EFFECTS = _statistic(
    "friction_effects",
    "one law, zone, factor and key characteristic",
    (
        _LAW,
        Column("zone", "str", "", "the zone whose friction is scaled; empty for all of them"),
        Column("factor", "float64", "1", "by which its coefficient is multiplied"),
        Column("measurement", "str", "", "name of the key characteristic"),
        _USED,
        *_estimate("mean_change", "mm", "what that changes of the mean"),
        *_estimate("six_sigma_change", "mm", "what that changes of 6σ"),
        Column("six_sigma", "float64", "mm", "6σ of these samples with the friction of the scene"),
    ),
    "Does friction matter: the same samples with all friction scaled, and with that of one zone.",
)
RARE = _statistic(
    "rare",
    "one law and key characteristic, or all of them together",
    (
        _LAW,
        Column("measurement", "str", "", "name of the key characteristic; empty for any of them"),
        *_estimate("outside", "1", "probability of a value outside its limits"),
        Column("levels", "int64", "", "levels of the subset simulation; 1 is a plain Monte Carlo"),
        Column("evaluations", "int64", "", "evaluations of the reduced model"),
        Column("failed", "int64", "", "of these, such that failed; none counts as outside"),
        Column(
            "first_order", "float64", "1", "probability to first order (FORM); empty where there are no derivatives"
        ),
        Column(
            "agrees", "bool", "", "whether the two agree; where not, limits are curved or the miss has several ways"
        ),
    ),
    "How often limits are missed where that is rare, by subset simulation on the reduced model.",
)
DESIGN_POINTS = _statistic(
    "design_points",
    "one law, limit of a key characteristic and deviation",
    (
        _LAW,
        Column("measurement", "str", "", "name of the key characteristic"),
        Column("limit", "str", "", "`lower` or `upper`"),
        Column(
            "beta",
            "float64",
            "1",
            "distance of the likeliest miss, in standard normal numbers; negative if missed at the mean",
        ),
        Column("probability", "float64", "1", "of missing that limit to first order, Φ(-β)"),
        Column("found", "bool", "", "whether the search ended on such a point"),
        Column("deviation", "str", "", "name of the deviation"),
        Column("value", "float64", "N or mm", "its value there"),
        Column("sigmas", "float64", "1", "that less its mean, in standard deviations"),
        Column("share", "float64", "1", "of the square of the direction to that point, as an importance"),
    ),
    "The likeliest miss of every limit, by exact derivatives (`mic.studies.first_order_reliability`). Written by `mic rare`.",
)
REMEDIES = _statistic(
    "remedies",
    "one law, remedy and adjustment",
    (
        _LAW,
        Column("remedy", "str", "", "the adjustment that is made alone, or `together`"),
        Column(
            "adjustment", "str", "", "where it stands in the scene: `locators.NAME` (its shim), `clamps.NAME.force` …"
        ),
        Column("change", "float64", "N or mm", "by which it is changed, as it can be set"),
        Column("value", "float64", "N or mm", "to which: position of a locator or clamp along its direction, or force"),
        Column("reached", "bool", "", "whether fresh samples are within the limits: of the worst, `together` of all"),
        Column("rounds", "int64", "", "how often the samples were taken through the process to find it"),
    ),
    "What would bring the key characteristics within their limits (`mic.studies.remedy`): single adjustments for the "
    "worst, and the smallest changes of all together for all of them. Written by `mic remedy`.",
)
REMEDY_EFFECTS = _statistic(
    "remedy_effects",
    "one law, remedy, set of samples and key characteristic",
    (
        _LAW,
        Column("remedy", "str", "", "as in `remedies`"),
        Column("fresh", "bool", "", "whether the samples had no part in finding the remedy"),
        Column("measurement", "str", "", "name of the key characteristic"),
        _USED,
        Column("failed", "int64", "", "samples left out, since one of their evaluations failed"),
        Column("mean_before", "float64", "mm", "mean of these samples as the scene is"),
        Column("mean", "float64", "mm", "with the remedy, evaluated in full"),
        Column("six_sigma_before", "float64", "mm", "6σ as the scene is"),
        Column("six_sigma", "float64", "mm", "with the remedy"),
        Column("cpk_before", "float64", "1", "Cpk as the scene is"),
        Column("cpk", "float64", "1", "with the remedy"),
        Column(
            "margin_before", "float64", "mm", "how far mean ± 3Cσ lies within the limits, negative beyond; C: asked for"
        ),
        Column("margin", "float64", "mm", "with the remedy"),
        *_estimate("gain", "mm", "what it adds to the margin of the same samples"),
        *_estimate("outside_before", "1", "share outside the limits as the scene is"),
        *_estimate("outside", "1", "with the remedy"),
    ),
    "What each remedy does to every key characteristic.",
)
ORDERS = _statistic(
    "orders",
    "one law, order and quantity",
    (
        _LAW,
        Column("order", "str", "", "name of the order; the stated one first"),
        Column("quantity", "str", "", "key characteristic, or `slip STAGE ZONE`"),
        Column("tolerance", "float64", "mm", "its limits apart; none for slip"),
        Column("mean", "float64", "mm", "mean under this order"),
        Column("mean_change", "float64", "mm", "how it differs from that of the stated order"),
        Column("mean_error", "float64", "mm", "standard error of that, by the jackknife"),
        Column("six_sigma", "float64", "mm", "6σ under this order"),
        Column("six_sigma_change", "float64", "mm", "how it differs from that of the stated order"),
        Column("six_sigma_error", "float64", "mm", "standard error of that, by the jackknife"),
        _USED,
    ),
    "How much hangs on the order in which locators, clamps and welds close and open.",
)
OPTIMA = _statistic(
    "optima",
    "one law",
    (
        _LAW,
        Column("objective", "str", "", "as the scene names it"),
        Column("before", "float64", "mm or 1", "objective of fresh samples as the scene is: 6σ in mm, others 1"),
        Column("after", "float64", "mm or 1", "with the changes"),
        *_estimate("gain", "mm or 1", "what the changes gain of it on the same samples, positive: better"),
        Column("gained", "bool", "", "whether a gain is sure, of the objective or of constraints that were missed"),
        Column("found", "float64", "mm or 1", "objective on the samples that the changes were found with"),
        Column("samples", "int64", "", "how many these were"),
        Column("fresh", "int64", "", "fresh samples, which had no part in the search"),
        Column("evaluations", "int64", "", "of an assembly, that the search took"),
    ),
    "What the changes that `mic optimise` has found are worth.",
)
OPTIMUM_CHANGES = _statistic(
    "optimum_changes",
    "one change",
    (
        _LAW,
        Column("kind", "str", "", "`force`, `shim`, `order` or `place`"),
        Column("targets", "str", "", "clamps or locators, the stage, or the item, with blanks between them"),
        Column("before", "str", "N or mm", "force, position, or point as the scene has it; empty for an order"),
        Column("after", "str", "N or mm", "with the change; an order as groups of names, with semicolons between them"),
    ),
    "What `mic optimise` changes.",
)
OPTIMUM_MATCHES = _statistic(
    "optimum_matches",
    "one part of an assembly",
    (
        Column("assembly", "int64", "", "number of the assembly, from 1"),
        Column("kind", "str", "", "of the part, as the scene names it"),
        Column("row", "int64", "", "where it stands in its file; the first row below the header is 2"),
    ),
    "Which measured parts go together.",
)
DENSITY = _statistic(
    "density",
    "one law and key characteristic",
    (
        _LAW,
        Column("measurement", "str", "", "name of the key characteristic"),
        Column("pairs", "int64", "", "contact pairs"),
        Column("denser", "int64", "", "contact pairs of the denser repetition"),
        Column("nominal_change", "float64", "mm", "what that changes of the nominal assembly"),
        Column("mean_change", "float64", "mm", "what it changes of the mean"),
        Column("six_sigma_change", "float64", "mm", "what it changes of 6σ"),
        Column("failed", "int64", "", "samples that either lost"),
    ),
    "How much hangs on how dense the contact pairs are.",
)
COMPARISON = _statistic(
    "comparison",
    "one quantity that both sides have",
    (
        Column("quantity", "str", "", "key characteristic, or `slip STAGE ZONE`; empty for the whole assembly"),
        Column("tolerance", "float64", "mm", "its limits apart, before; none for slip"),
        _USED,
        *_before_and_after("mean", "mm", "mean"),
        *_before_and_after("six_sigma", "mm", "6σ"),
        *_before_and_after("cpk", "1", "Cpk, each against its own limits"),
        *_before_and_after("outside", "1", "share outside its limits, or with any characteristic outside"),
    ),
    "Two assemblies on the same samples, before and after. Written by `mic compare` into a folder of its own.",
)
EXPLANATION = _statistic(
    "explanation",
    "one source",
    (
        Column("source", "str", "", "name of the deviation"),
        Column("prior_mean", "float64", "N, mm or 1", "its mean in the scene"),
        Column("prior_sigma", "float64", "N, mm or 1", "its standard deviation in the scene"),
        Column("mean", "float64", "N, mm or 1", "its mean, given what was measured"),
        Column("sigma", "float64", "N, mm or 1", "its standard deviation, given what was measured"),
        Column("low", "float64", "N, mm or 1", "below which it lies with a probability of 0.025"),
        Column("high", "float64", "N, mm or 1", "above which it lies with a probability of 0.025"),
        Column("off", "float64", "1", "by how many of the scene's standard deviations its mean is off"),
        Column("told", "float64", "1", "share of its variance that the measurement takes away"),
    ),
    "The most probable sources of a measured assembly. Written by `mic explain` into a folder of its own.",
)
FURTHER = _statistic(
    "further",
    "one key characteristic that was not measured",
    (
        Column("measurement", "str", "", "name of the key characteristic"),
        Column("sigma", "float64", "mm", "how well it is known already, a standard deviation"),
        Column("bits", "float64", "1", "information that measuring it would give"),
        Column("source", "str", "", "the source of which it would tell most"),
        Column("told", "float64", "1", "share of that source's remaining variance that it would take away"),
    ),
    "What else could be measured, with a gauge like those used. Written by `mic explain` into a folder of its own.",
)
PREDICTIONS = _statistic(
    "predictions",
    "one assembly and key characteristic, or the whole of it",
    (
        Column("file", "str", "", "the file that told of its parts"),
        Column("row", "int64", "", "in which row; the header is row 1"),
        Column("model", "str", "", "fingerprint of the model"),
        _LAW,
        Column("measurement", "str", "", "name of the key characteristic; empty for the whole assembly"),
        Column("value", "float64", "mm", "foretold, from nominal"),
        Column("low", "float64", "mm", "below which it lies with a probability of 0.025, by what is not known"),
        Column("high", "float64", "mm", "above which it lies with a probability of 0.025"),
        Column("verdict", "str", "", "`accepted`, `open`, `rejected`; `refused` or `failed` where nothing is foretold"),
        Column("way", "str", "", "`learnt` beforehand, or `evaluated`; of the whole assembly what took longest"),
        Column("said", "str", "", "why, or the smallest adjustment that suffices, else what helps most, and how far"),
        Column("far", "float64", "1", "by how many standard deviations the farthest deviation is off its mean"),
    ),
    "Assemblies foretold from their measured parts, one after the other: the log of `mic predict`, a file of its own.",
)
#: The CSV tables that a command of its own adds to the folder of a run.
STUDIES = (
    CONTRIBUTORS,
    LINEARITY,
    SENSITIVITIES,
    FRICTION_EFFECTS,
    RARE,
    DESIGN_POINTS,
    REMEDIES,
    REMEDY_EFFECTS,
    ORDERS,
    OPTIMA,
    OPTIMUM_CHANGES,
    OPTIMUM_MATCHES,
    DENSITY,
)
#: The CSV tables of statistics.
STATISTICS = (
    ZONE_STATISTICS,
    CONTACT_STATISTICS,
    MEASUREMENT_STATISTICS,
    PROFILE_STATISTICS,
    LIMIT_STATISTICS,
    PATH,
    PATH_ERRORS,
    FRICTION,
)


def reference() -> str:
    """The reference of the results folder, in Markdown."""
    lines = [
        "# Results",
        "",
        "A run writes one folder; an interrupted run can be read, and completed by calling it again.",
        "",
        "| file | holds |",
        "| --- | --- |",
        "| `run.json` | scene, samples and seed asked for, laws, identity, the inputs behind it, versions, wall time |",
        "| `model.npz` | the reduced model; `mic.ReducedModel.load` reads it, no finite elements needed |",
        "| `parts.npz` | meshes and functionals of the parts |",
        "| `paper.toml` | published figures to compare with, where the scene has any |",
        "| `summary.json` | the statistics by law, zone and measurement, each with its interval |",
        "| `report.html`, `assembly.png` | the report, and its picture of the assembly |",
        "| `tables.xlsx` | the tables in one workbook, where `mic report --excel` was called |",
    ]
    lines += [
        f"| `{table.place}` | {table.description} |"
        for table in (*_samples_first(DATASETS), SUMS, FORCES, CONDENSED, FIELDS)
    ]
    lines += [f"| `{table.place}` | {table.description} |" for table in (*STATISTICS, ACCURACY, *STUDIES)]
    lines += [
        "",
        "`LAW` is a contact law, `FIRST-LAST` the numbers of a block's first and last sample. The datasets are Apache "
        "Parquet, partitioned by law: `pandas.read_parquet(folder / 'slips')` reads all laws at once and adds the "
        "column `law`. Units stand in the metadata of each Parquet column too. A file whose name ends in `.damaged` "
        "could not be read; it was set aside and computed anew. `.other-run` marks a block of another run that stood "
        "here. `.lock` names the process that writes here now. [What is promised](promises.md) says what a "
        "second call, or another scene, does to a folder.",
    ]
    for title, tables in (
        ("Datasets", _samples_first(DATASETS)),
        ("Statistics", (*STATISTICS, ACCURACY)),
        ("Studies", STUDIES),
        ("Fields", (FORCES, FIELDS)),
    ):
        lines += ["", f"## {title}"]
        for table in tables:
            lines += [
                "",
                f"### {table.name}",
                "",
                f"`{table.place}`: one row for {table.rows}. {table.description}",
                "",
            ]
            lines += ["| column | type | unit | meaning |", "| --- | --- | --- | --- |"]
            lines += [_described(column) for column in table.columns]
    return "\n".join(lines) + "\n"


def _samples_first(tables: Sequence[Table]) -> list[Table]:
    """The samples stand first on the page, though they are written last."""
    return sorted(tables, key=lambda table: table is not SAMPLES)


def _described(column):
    kind = f"{column.dtype} ({column.shape})" if column.shape else column.dtype
    meaning = column.meaning + ("; absent where only normals are modelled" if column.optional else "")
    return f"| `{column.name}` | {kind} | {column.unit} | {meaning} |"


if __name__ == "__main__":
    print(reference(), end="")
