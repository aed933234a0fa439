"""The outcome of a run: its folder read back, and what the samples say.

Everything is computed from the files of the run folder, so that an interrupted run, or one carried here from another
machine, can be read too. Samples that failed, or are not there yet, enter no statistic; they are counted and named.
"""

from __future__ import annotations

import json
import math
import shutil
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path

import numpy as np
import pandas as pd

from mic.compliance.functional import Functionals
from mic.compliance.part import Part
from mic.contact.comparison import compare_laws
from mic.geometry.surface import Patch, Surface
from mic.model.reduced import ReducedModel
from mic.process.process import STATES
from mic.results import statistics
from mic.results.statistics import Estimate
from mic.store import replacing

__all__ = [
    "PUBLISHED",
    "Outcome",
    "keep_inputs",
    "kept_parts",
    "read_outcome",
    "write_friction_study",
    "write_summary",
]

PUBLISHED = "paper.toml"  # published figures beside a scene, to set beside its results
STUDIED_SAMPLES = 12
STUDIED_FRICTION = (0.1, 0.4, 0.7, 1.0, 1.5, 2.0)  # multiples of the scene's friction
MEASUREMENT_STATISTICS = ("mean", "sigma", "six_sigma", "min", "max", "cp", "cpk", "share_outside")


@dataclass(frozen=True)
class Outcome:
    """What a run folder holds.

    Attributes
    ----------
    folder : Path
    record : dict
        ``run.json``: scene, samples and seed asked for, laws, versions, and ``wall_time`` (s by phase) where known.
    model : ReducedModel
    samples : dict of str to DataFrame
        By law, one row per finished sample in ascending order; columns as :func:`mic.sampling.montecarlo.tables` writes them.
    contacts : dict of str to DataFrame
        By law, one row per sample, stage and contact pair; forces in N, displacements in mm.
    """

    folder: Path
    record: dict
    model: ReducedModel
    samples: dict[str, pd.DataFrame]
    contacts: dict[str, pd.DataFrame]

    @property
    def laws(self) -> list[str]:
        """Laws with at least one finished sample, in the order in which they were asked for."""
        return [law for law in self.record["laws"] if len(self.samples[law])]

    @cached_property
    def stages(self) -> list[str]:
        """Stages that resolve contact, in their order in the process."""
        first = self.samples[self.laws[0]] if self.laws else pd.DataFrame()
        return [name.removeprefix("residual:") for name in first.columns if name.startswith("residual:")]

    @property
    def zones(self) -> list[str]:
        """Contact zones of the scene."""
        return [zone.name for zone in self.model.scene.zones]

    @property
    def has_slip(self) -> bool:
        """Whether tangential motion was modelled."""
        return len(self.model.contacts) > 0 and self.model.contacts.dimension == 3

    @property
    def failed(self) -> dict[str, list[int]]:
        """Numbers of the failed samples, by law."""
        return {law: [int(i) for i in table["sample"][table["failed"]]] for law, table in self.samples.items()}

    @property
    def missing(self) -> dict[str, int]:
        """Samples that were asked for and are not in the folder, by law; all zero for a finished run."""
        return {law: self.record["samples"] - len(table) for law, table in self.samples.items()}

    def valid(self, law: str) -> pd.DataFrame:
        """The samples that did not fail."""
        return self.samples[law][~self.samples[law]["failed"]]

    def sample_numbers(self, law: str) -> np.ndarray:
        """(n,) numbers of the valid samples, ascending."""
        return self.valid(law)["sample"].to_numpy()

    def deviation(self, law: str, name: str) -> np.ndarray:
        """(n,) values of one deviation in the valid samples."""
        return self.valid(law)[f"deviation:{name}"].to_numpy()

    def residual(self, law: str, stage: str) -> np.ndarray:
        """(n,) certificate residuals of one stage in the valid samples."""
        return self.valid(law)[f"residual:{stage}"].to_numpy()

    def slip(self, law: str, stage: str, zone: str) -> np.ndarray:
        """(n,) RMS slip over one zone in the valid samples, mm."""
        return self.valid(law)[f"slip:{stage}:{zone}"].to_numpy()

    def measured(self, law: str, name: str) -> np.ndarray:
        """(n,) values of one key characteristic in the valid samples, mm."""
        return self.valid(law)[f"measurement:{name}"].to_numpy()

    @cached_property
    def friction_study(self) -> pd.DataFrame | None:
        """The laws under scaled friction, as :func:`write_friction_study` left it; None where the run has none."""
        path = self.folder / "tables" / "friction.csv"
        return pd.read_csv(path, float_precision="round_trip") if path.is_file() else None

    def contact(self, law: str, stage: str, column: str) -> np.ndarray:
        """One quantity of all contacts, (n, m): n valid samples of the law in the order of :meth:`valid`, m pairs.

        Parameters
        ----------
        column : str
            ``f_n, f_t1, f_t2`` (N), ``u_n, u_t1, u_t2`` (mm), ``state`` (index into ``mic.process.process.STATES``), or the
            magnitudes ``f_t`` (N) and ``u_t`` (mm) of the tangential parts.
        """
        if column in ("f_t", "u_t"):
            return np.hypot(self.contact(law, stage, f"{column}1"), self.contact(law, stage, f"{column}2"))
        values = self._arrays[law][stage][column]
        return values[~self.samples[law]["failed"].to_numpy()]

    @cached_property
    def _arrays(self):
        """law -> stage -> column -> (samples, pairs)."""
        arrays = {}
        for law in self.laws:
            table = self.contacts[law]
            arrays[law] = {}
            for code, stage in enumerate(table["stage"].cat.categories if len(table) else ()):
                part = table[(table["stage"].cat.codes == code).to_numpy()]
                shape = (len(self.samples[law]), len(self.model.contacts))
                columns = {name: part[name].to_numpy() for name in part.columns if name.startswith(("f_", "u_"))}
                columns["state"] = part["state"].cat.codes.to_numpy()
                arrays[law][stage] = {name: values.reshape(shape) for name, values in columns.items()}
        return arrays

    # ------------------------------------------------------------------------------------------ statistics

    @cached_property
    def zone_statistics(self) -> pd.DataFrame:
        """RMS slip over each zone, one row per law, stage and zone.

        Columns: ``law, stage, zone, contacts, friction, samples``; ``mean_rms_slip, six_sigma_rms_slip`` (mm), each
        with ``_low`` and ``_high``. Slip is counted from where the contact was left in the stage before. NaN where no
        tangential motion was modelled.
        """
        rows = []
        pairs = np.bincount(self.model.contacts.zone, minlength=len(self.zones))
        for law in self.laws:
            valid = self.valid(law)
            for stage in self.stages:
                for zone, count in zip(self.model.scene.zones, pairs):
                    name = f"slip:{stage}:{zone.name}"
                    slip = valid[name].to_numpy() if name in valid else np.full(len(valid), np.nan)
                    rows.append(
                        {
                            "law": law,
                            "stage": stage,
                            "zone": zone.name,
                            "contacts": int(count),
                            "friction": 0.0 if law == "frictionless" else zone.friction,
                            "samples": len(valid),
                        }
                        | _spread("mean_rms_slip", statistics.mean(slip))
                        | _spread("six_sigma_rms_slip", statistics.six_sigma(slip))
                    )
        return pd.DataFrame(rows)

    @cached_property
    def contact_statistics(self) -> pd.DataFrame:
        """Forces and states of each contact pair, one row per law, stage and pair.

        Columns: ``law, stage, zone, contact, samples``; ``mean_f_n, six_sigma_f_n`` (N), ``mean_gap`` (mm); where tangential
        motion is modelled ``mean_slip_force, six_sigma_slip_force`` (N, of ``‖f_t‖``) and ``mean_slip`` (mm, of
        ``‖u_t‖``), each force and slip with ``_low`` and ``_high``; shares of the samples ``open, stick, slip``, each with
        ``_low`` and ``_high``.
        """
        frames = []
        m = len(self.model.contacts)
        zone = np.array(self.zones, dtype=object)[self.model.contacts.zone] if m else np.zeros(0, dtype=object)
        for law in self.laws:
            for stage in self.stages:
                f_n, state = self.contact(law, stage, "f_n"), self.contact(law, stage, "state")
                columns = {"law": law, "stage": stage, "zone": zone, "contact": np.arange(m), "samples": len(f_n)}
                columns |= _spread("mean_f_n", statistics.mean(f_n)) | _spread(
                    "six_sigma_f_n", statistics.six_sigma(f_n)
                )
                columns["mean_gap"] = statistics.mean(self.contact(law, stage, "u_n")).value
                if self.has_slip:
                    force, slip = self.contact(law, stage, "f_t"), self.contact(law, stage, "u_t")
                    columns |= _spread("mean_slip_force", statistics.mean(force))
                    columns |= _spread("six_sigma_slip_force", statistics.six_sigma(force))
                    columns |= _spread("mean_slip", statistics.mean(slip))
                for code, name in enumerate(STATES):
                    columns |= _spread(name, statistics.share((state == code).sum(axis=0), len(state)))
                frames.append(pd.DataFrame(columns, index=np.arange(m)))
        return pd.concat(frames, ignore_index=True) if frames else pd.DataFrame()

    @cached_property
    def measurement_statistics(self) -> pd.DataFrame:
        """Key characteristics, one row per law and measurement.

        Columns: ``law, measurement, lower, upper, samples``; ``mean, sigma, six_sigma, min, max`` (mm), ``cp, cpk``,
        ``share_outside``, each with ``_low`` and ``_high``.
        """
        rows = []
        for law in self.laws:
            valid = self.valid(law)
            for item in self.model.scene.measurements:
                x = valid[f"measurement:{item.name}"].to_numpy()
                estimates = (
                    statistics.mean(x),
                    statistics.sigma(x),
                    statistics.six_sigma(x),
                    statistics.minimum(x),
                    statistics.maximum(x),
                    statistics.capability(x, item.lower, item.upper),
                    statistics.centred_capability(x, item.lower, item.upper),
                    statistics.share_outside(x, item.lower, item.upper),
                )
                row = {
                    "law": law,
                    "measurement": item.name,
                    "lower": item.lower,
                    "upper": item.upper,
                    "samples": estimates[0].used,
                }
                for name, estimate in zip(MEASUREMENT_STATISTICS, estimates):
                    row |= _spread(name, estimate)
                rows.append(row)
        return pd.DataFrame(rows)

    def worst_residual(self, law: str) -> float:
        """Largest certificate residual of the valid samples, over all stages; 0 where no contact is resolved, NaN without samples."""
        valid = self.valid(law)
        if not len(valid):
            return float("nan")
        return max((float(valid[f"residual:{stage}"].max()) for stage in self.stages), default=0.0)

    def failures(self, law: str) -> pd.DataFrame:
        """Why samples failed: ``sample, stage, residual, status``, one row per failed sample and stage that did not converge."""
        table = self.samples[law][self.samples[law]["failed"]]
        rows = [
            {
                "sample": int(row["sample"]),
                "stage": stage,
                "residual": row[f"residual:{stage}"],
                "status": row[f"status:{stage}"],
            }
            for _, row in table.iterrows()
            for stage in self.stages
            if row[f"status:{stage}"] != "converged"
        ]
        return pd.DataFrame(rows, columns=["sample", "stage", "residual", "status"])

    def summary(self) -> dict:
        """The outcome in one JSON-ready dict (``summary.json``).

        The zone figures of each law are those of the first stage that resolves contact, clamping in the default process;
        every stage stands under ``"stages"``. Intervals ``…_ci`` are at 95 %. What does not exist is None.
        """
        laws = {}
        for law in self.laws:
            zones = {}
            for _, row in (
                self.zone_statistics[self.zone_statistics["law"] == law].iterrows() if len(self.zone_statistics) else ()
            ):
                entry = _with_intervals(row, ("mean_rms_slip", "six_sigma_rms_slip"))
                zone = zones.setdefault(
                    row["zone"], {"contacts": row["contacts"], "friction": row["friction"], **entry, "stages": {}}
                )
                zone["stages"][row["stage"]] = entry
            table = self.measurement_statistics
            measurements = {
                row["measurement"]: {"lower": row["lower"], "upper": row["upper"]}
                | _with_intervals(row, MEASUREMENT_STATISTICS)
                for _, row in (table[table["law"] == law].iterrows() if len(table) else ())
            }
            laws[law] = {
                "samples": len(self.valid(law)),
                "worst_residual": self.worst_residual(law),
                "failed": len(self.failed[law]),
                "zones": zones,
                "measurements": measurements,
            }
        return _json_ready(
            {
                "scene": self.model.scene.name,
                "description": self.model.scene.description,
                "samples": self.record["samples"],
                "seed": self.record["seed"],
                "failed_samples": self.failed,
                "missing_samples": self.missing,
                "confidence_level": statistics.LEVEL,
                "laws": laws,
                "versions": self.record["versions"],
                "wall_time": self.record.get("wall_time", {}),
            }
        )


def read_outcome(folder) -> Outcome:
    """Read a run folder, finished or not.

    Parameters
    ----------
    folder : path-like

    Raises
    ------
    FileNotFoundError
        If it is no run folder.
    """
    folder = Path(folder)
    if not (folder / "run.json").is_file():
        raise FileNotFoundError(
            f"{folder}: no run.json, so this is not the folder of a run; name the folder that mic run wrote"
        )
    record = json.loads((folder / "run.json").read_text())
    samples, contacts = {}, {}
    for law in record["laws"]:
        # A block counts once its samples are there: they are written last.
        blocks = [
            path
            for path in sorted((folder / "samples" / f"law={law}").glob("*.parquet"))
            if not path.name.startswith(".")
        ]
        samples[law] = _read(blocks, ["sample", "failed"])
        contacts[law] = _read([folder / "contacts" / f"law={law}" / path.name for path in blocks], ["sample"])
    return Outcome(folder, record, ReducedModel.load(folder / "model.npz"), samples, contacts)


def write_summary(outcome: Outcome) -> Path:
    """Write ``summary.json`` and ``tables/*.csv`` into the run folder; returns the path of the summary."""
    tables = outcome.folder / "tables"
    tables.mkdir(exist_ok=True)
    for name in ("zone", "contact", "measurement"):
        table = getattr(outcome, f"{name}_statistics")
        if len(table):
            table.to_csv(tables / f"{name}s.csv", index=False, float_format="%.9g")
    path = outcome.folder / "summary.json"
    temporary = path.with_suffix(".partial")
    temporary.write_text(json.dumps(outcome.summary(), indent=2, allow_nan=False) + "\n")
    temporary.replace(path)
    return path


def write_friction_study(outcome: Outcome) -> None:
    """Write ``tables/friction.csv``: :func:`mic.contact.comparison.compare_laws` on evenly spread samples.

    Nothing is written where the run does not hold the associated law beside Coulomb's, or no friction.
    """
    if (
        not outcome.has_slip
        or not {"coulomb", "associated"} <= set(outcome.laws)
        or not outcome.model.contacts.friction.any()
    ):
        return
    stage, n = outcome.stages[0], len(outcome.valid("coulomb"))
    chosen = np.unique(np.linspace(0, n - 1, min(n, STUDIED_SAMPLES)).round().astype(int)) if n else []
    if not len(chosen):
        return
    S = next(prepared.response.S for prepared in outcome.model.process("coulomb").stages if prepared.plan.name == stage)
    force, displacement = (
        np.stack(
            [outcome.contact("coulomb", stage, f"{quantity}_{axis}")[chosen] for axis in ("n", "t1", "t2")], axis=2
        ).reshape(len(chosen), -1)
        for quantity in ("f", "u")
    )
    b = displacement - force @ S  # u = S f + b
    study = compare_laws(S, b, [scale * outcome.model.contacts.friction for scale in STUDIED_FRICTION], threads=2)
    with replacing(outcome.folder / "tables" / "friction.csv") as temporary:
        study.to_csv(temporary, index=False)


def keep_inputs(folder, assembly) -> None:
    """Copy into a run folder what fields and report need beside the results, so that the folder can be read on any machine.

    These are the parts with their retained functionals (``parts.npz``) and, if the scene's folder has one, the published
    figures (``paper.toml``) to set beside the results.

    Parameters
    ----------
    folder : path-like
    assembly : mic.model.assembly.Assembly
    """
    folder = Path(folder)
    folder.mkdir(parents=True, exist_ok=True)
    arrays = {}
    for i, part in enumerate(assembly.parts):
        f = part.functionals
        table = {
            "points": part.surface.points,
            "triangles": part.surface.triangles,
            "patch": f.patch,
            "direction": f.direction,
            "rotation": f.rotation,
            "side": f.side,
            "label": np.array(f.label, dtype=str),
            "ends": np.cumsum([len(patch.weight) for patch in f.patches]),
        }
        table |= {
            name: np.concatenate([getattr(patch, name) for patch in f.patches])
            for name in ("triangle", "barycentric", "weight")
        }
        arrays |= {f"{i}_{name}": array for name, array in table.items()}
    temporary = folder / "parts.partial.npz"
    np.savez(temporary, **arrays)
    temporary.replace(folder / "parts.npz")
    published = assembly.scene.folder / PUBLISHED
    if published.is_file():
        shutil.copyfile(published, folder / PUBLISHED)
    else:
        (folder / PUBLISHED).unlink(missing_ok=True)


def kept_parts(outcome: Outcome) -> tuple[Part, ...]:
    """The parts as :func:`keep_inputs` left them in the run folder; none if it was not called."""
    path = outcome.folder / "parts.npz"
    if not path.is_file():
        return ()
    scene, parts = outcome.model.scene, []
    with np.load(path) as data:
        for i, part in enumerate(scene.parts):
            table = {
                name: data[f"{i}_{name}"]
                for name in (
                    "points",
                    "triangles",
                    "patch",
                    "direction",
                    "rotation",
                    "side",
                    "label",
                    "ends",
                    "triangle",
                    "barycentric",
                    "weight",
                )
            }
            split = [np.split(table[name], table["ends"][:-1]) for name in ("triangle", "barycentric", "weight")]
            functionals = Functionals(
                tuple(Patch(*arrays) for arrays in zip(*split)),
                table["patch"],
                table["direction"],
                table["rotation"],
                table["side"],
                tuple(str(label) for label in table["label"]),
            )
            parts.append(
                Part(
                    part.name,
                    Surface(table["points"], table["triangles"]),
                    part.thickness,
                    part.young,
                    part.poisson,
                    scene.element,
                    functionals,
                )
            )
    return tuple(parts)


def _read(paths, columns):
    frames = [pd.read_parquet(path, partitioning=None) for path in paths]
    if not frames:
        return pd.DataFrame({name: np.zeros(0, dtype=bool if name == "failed" else int) for name in columns})
    return pd.concat(frames, ignore_index=True)


def _spread(name, estimate: Estimate) -> dict:
    return {name: estimate.value, f"{name}_low": estimate.low, f"{name}_high": estimate.high}


def _with_intervals(row, names) -> dict:
    entry = {}
    for name in names:
        entry |= {name: row[name], f"{name}_ci": [row[f"{name}_low"], row[f"{name}_high"]]}
    return entry


def _json_ready(value):
    """Plain Python values; numbers that JSON does not know become None."""
    if isinstance(value, dict):
        return {str(key): _json_ready(item) for key, item in value.items()}
    if isinstance(value, (list, tuple)):
        return [_json_ready(item) for item in value]
    if isinstance(value, (bool, np.bool_)):
        return bool(value)
    if isinstance(value, (int, np.integer)):
        return int(value)
    if isinstance(value, (float, np.floating)):
        return float(value) if math.isfinite(value) else None
    return value
