"""The outcome of a run: its folder read back, sample by sample.

Everything is read from the files of the run folder, so that an interrupted run, or one carried here from another
machine, can be read too. Samples that failed, or are not there yet, enter no statistic; they are counted and named.
"""

from __future__ import annotations

import warnings
from collections.abc import Mapping
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd

from mic.compliance.part import Part
from mic.contact.states import STATES
from mic.errors import FormatError, RunError
from mic.process.model import ReducedModel
from mic.results import summary
from mic.results.folder import Block, RunFolder
from mic.results.identity import differences, inputs
from mic.results.law_comparison import read_friction
from mic.results.schema import DATASETS

__all__ = ["Outcome", "read_outcome"]


@dataclass(frozen=True)
class Outcome:
    """What a run folder holds.

    Arrays over samples have one entry for each *valid* sample of a law, one that is there and did not fail, in
    ascending order of the samples' numbers.

    Attributes
    ----------
    folder : Path
    record : dict
        ``run.json``: scene, samples and seed asked for, laws, identity, versions, and ``wall_time`` (s by phase) where
        known.
    model : ReducedModel
    tables : dict of str to dict of str to DataFrame
        By law, then by name: the datasets of :data:`mic.results.schema.DATASETS`, failed samples included.
    blocks : dict of str to list of Block
        By law, the blocks that were read.
    damaged : tuple of str
        One sentence for each block that was left out since it could not be read.
    """

    folder: Path
    record: dict
    model: ReducedModel
    tables: Mapping[str, Mapping[str, pd.DataFrame]]
    blocks: Mapping[str, list[Block]]
    damaged: tuple[str, ...] = ()

    @property
    def laws(self) -> list[str]:
        """Laws with at least one finished sample, in the order in which they were asked for."""
        return [law for law in self.record["laws"] if len(self.tables[law]["samples"])]

    @cached_property
    def stages(self) -> list[str]:
        """Stages that resolve contact, in their order in the process."""
        found = {stage for law in self.laws for stage in self.tables[law]["resolutions"]["stage"].cat.categories}
        return [name for stage in self.model.scene.stages if (name := str(stage.name)) in found]

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
        tables = {law: found["samples"] for law, found in self.tables.items()}
        return {law: [int(i) for i in table["sample"][table["failed"]]] for law, table in tables.items()}

    @property
    def missing(self) -> dict[str, int]:
        """Samples that were asked for and are not in the folder, by law; all zero for a finished run."""
        return {law: self.record["samples"] - len(found["samples"]) for law, found in self.tables.items()}

    @cached_property
    def parts(self) -> tuple[Part, ...]:
        """The parts with their meshes, as the run kept them; none where it did not."""
        return RunFolder(self.folder).parts(self.model.scene)

    # ---------------------------------------------------------------------------------------------- samples

    def sample_numbers(self, law: str) -> np.ndarray:
        """(n,) numbers of the valid samples."""
        return self.tables[law]["samples"]["sample"].to_numpy()[self._valid[law]]

    def deviation(self, law: str, name: str) -> np.ndarray:
        """(n,) drawn values of a deviation, N or mm."""
        return self._column(law, "deviations", "value", deviation=name)[self._valid[law]]

    def residual(self, law: str, stage: str) -> np.ndarray:
        """(n,) certificate residuals of a stage."""
        return self._column(law, "resolutions", "residual", stage=stage)[self._valid[law]]

    def slip(self, law: str, stage: str, zone: str) -> np.ndarray:
        """(n,) RMS slip of a zone since the stage before, mm; NaN where no tangential motion was modelled."""
        if not self.has_slip:
            return np.full(len(self.sample_numbers(law)), np.nan)
        return self._column(law, "slips", "rms_slip", stage=stage, zone=zone)[self._valid[law]]

    def measured(self, law: str, name: str) -> np.ndarray:
        """(n,) values of a measurement, mm from nominal."""
        return self._column(law, "measurements", "value", measurement=name)[self._valid[law]]

    def contact(self, law: str, stage: str, column: str) -> np.ndarray:
        """One quantity of all m contact pairs, (n, m).

        Parameters
        ----------
        column : str
            ``f_n, f_t1, f_t2`` (N), ``u_n, u_t1, u_t2`` (mm), ``state`` (index into ``mic.contact.states.STATES``), or
            the magnitudes ``f_t`` (N) and ``u_t`` (mm) of the tangential parts.
        """
        if column in ("f_t", "u_t"):
            return np.hypot(self.contact(law, stage, f"{column}1"), self.contact(law, stage, f"{column}2"))
        return self._contacts(law, stage, column)[self._valid[law]]

    def failures(self, law: str) -> pd.DataFrame:
        """Why samples failed: ``sample, stage, residual, status``.

        One row per failed sample and stage that did not converge.
        """
        table = self.tables[law]["resolutions"]
        table = table[table["sample"].isin(self.failed[law]) & ~table["converged"]]
        table = table[["sample", "stage", "residual", "status"]].astype({"stage": str, "status": str})
        return table.sort_values("sample", kind="stable", ignore_index=True)

    def worst_residual(self, law: str) -> float:
        """Largest certificate residual of the valid samples over all stages.

        0 where no contact is resolved, NaN without samples.
        """
        if not len(self.sample_numbers(law)):
            return float("nan")
        return max((float(self.residual(law, stage).max()) for stage in self.stages), default=0.0)

    @cached_property
    def _valid(self) -> dict[str, np.ndarray]:
        """By law, which of the samples that are there did not fail."""
        return {law: ~found["samples"]["failed"].to_numpy() for law, found in self.tables.items()}

    def _column(self, law: str, table: str, column: str, **keys: str) -> np.ndarray:
        """One column of the rows with the given keys, one value per finished sample."""
        frame = self.tables[law][table]
        chosen = np.ones(len(frame), dtype=bool)
        for key, name in keys.items():
            if name not in frame[key].cat.categories:
                raise KeyError(f"{key} {name!r}: the run has none; known: {', '.join(frame[key].cat.categories)}")
            chosen &= (frame[key] == name).to_numpy()
        return frame[column].to_numpy()[chosen]

    def _contacts(self, law: str, stage: str, column: str) -> np.ndarray:
        """One quantity of the contact pairs of all finished samples, (samples, m)."""
        key = (law, stage, column)
        if key not in self._arrays:
            frame = self.tables[law]["contacts"]
            values = frame[column][(frame["stage"] == stage).to_numpy()]
            if column == "state":
                values = values.cat.set_categories(STATES).cat.codes
            shape = (len(self.tables[law]["samples"]), len(self.model.contacts))
            self._arrays[key] = values.to_numpy().reshape(shape)
        return self._arrays[key]

    @cached_property
    def _arrays(self) -> dict[tuple[str, str, str], np.ndarray]:
        return {}

    # ---------------------------------------------------------------------------------------------- statistics

    @cached_property
    def zone_statistics(self) -> pd.DataFrame:
        """RMS slip over each zone: :data:`mic.results.schema.ZONE_STATISTICS`."""
        return summary.zone_statistics(self)

    @cached_property
    def contact_statistics(self) -> pd.DataFrame:
        """Forces and states of each contact pair: :data:`mic.results.schema.CONTACT_STATISTICS`."""
        return summary.contact_statistics(self)

    @cached_property
    def measurement_statistics(self) -> pd.DataFrame:
        """Key characteristics against their limits: :data:`mic.results.schema.MEASUREMENT_STATISTICS`."""
        return summary.measurement_statistics(self)

    @cached_property
    def friction_study(self) -> pd.DataFrame | None:
        """The laws compared as friction grows: :data:`mic.results.schema.FRICTION`; None where not stored."""
        return read_friction(self.folder)

    def summary(self) -> dict:
        """The outcome in one JSON-ready dict (``summary.json``), see :func:`mic.results.summary.summary`."""
        return summary.summary(self)

    # ---------------------------------------------------------------------------------------------- old names

    @property
    def samples(self) -> dict[str, pd.DataFrame]:
        """Deprecated: one wide table per law, one row per sample, with keys in the names of its columns."""
        warnings.warn("Outcome.samples is deprecated: use Outcome.tables or its accessors", DeprecationWarning, 2)
        return {law: _wide(found) for law, found in self.tables.items()}

    def valid(self, law: str) -> pd.DataFrame:
        """Deprecated: the valid samples of a law as one wide table."""
        warnings.warn("Outcome.valid is deprecated: use Outcome.sample_numbers and its kin", DeprecationWarning, 2)
        return _wide(self.tables[law])[self._valid[law]]


def read_outcome(folder) -> Outcome:
    """Read a run folder, finished or not.

    Parameters
    ----------
    folder : path-like

    Raises
    ------
    RunError
        If it is no run folder.
    FormatError
        If its record or model cannot be read. A block that cannot be read counts as missing.
    """
    store = RunFolder(Path(folder))
    record = store.record()
    tables: dict[str, dict[str, pd.DataFrame]] = {}
    blocks: dict[str, list[Block]] = {}
    damaged = []
    for law in record["laws"]:
        found, blocks[law] = [], []
        for block in store.blocks(law, record["samples"]):
            try:
                found.append(store.read_block(block, record["identity"], record["samples"]))
                blocks[law].append(block)
            except FormatError as problem:
                damaged.append(f"{problem}.")
        tables[law] = {
            table.name: pd.concat([block[table.name] for block in found], ignore_index=True) if found else table.empty()
            for table in DATASETS
        }
        for table in DATASETS:  # blocks in which other names occur
            for column in table.columns:
                if column.dtype == "category":
                    tables[law][table.name][column.name] = tables[law][table.name][column.name].astype("category")
    model = _model(store, record)
    return Outcome(store.path, record, model, tables, blocks, tuple(damaged))


def _model(store: RunFolder, record: Mapping[str, Any]) -> ReducedModel:
    """The model of a run folder; it must be the one that the record speaks of."""
    path = store.path / "model.npz"
    try:
        model = ReducedModel.load(path)
    except FileNotFoundError:
        raise RunError(f"{path}: is missing; run the scene again into this folder") from None
    differing = differences(record["inputs"], inputs(model, record["seed"]), program=False)
    if differing:
        raise RunError(f"{path}: belongs to another run ({'; '.join(differing)}); run the scene again into this folder")
    return model


def _wide(tables: Mapping[str, pd.DataFrame]) -> pd.DataFrame:
    """The samples with everything else as columns ``KIND:KEY:KEY``."""
    wide = tables["samples"].copy()
    columns = {}
    for _, row in tables["deviations"].groupby("deviation", observed=True, sort=False):
        columns[f"deviation:{row['deviation'].iloc[0]}"] = row["value"].to_numpy()
    for stage, rows in tables["resolutions"].groupby("stage", observed=True, sort=False):
        for column in ("residual", "status", "iterations"):
            values = rows[column].astype(object) if column == "status" else rows[column]
            columns[f"{column}:{stage}"] = values.to_numpy()
        for zone, slips in tables["slips"][tables["slips"]["stage"] == stage].groupby(
            "zone", observed=True, sort=False
        ):
            columns[f"slip:{stage}:{zone}"] = slips["rms_slip"].to_numpy()
    for name, rows in tables["measurements"].groupby("measurement", observed=True, sort=False):
        columns[f"measurement:{name}"] = rows["value"].to_numpy()
    return wide.assign(**columns)
