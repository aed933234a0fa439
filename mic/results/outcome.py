"""The outcome of a run: samples, statistics and studies of its folder.

One pass over the blocks accumulates the statistics and discards the samples, so memory does not grow with their
number. Accessors of single samples read the blocks that hold them again.
"""

from __future__ import annotations

import warnings
from collections.abc import Mapping
from functools import cached_property
from pathlib import Path
from typing import Any

import pandas as pd

from mic.errors import FormatError, RunError
from mic.process.model import ReducedModel
from mic.results import statistic_tables
from mic.results.block_samples import BlockSamples
from mic.results.block_statistics import Digest
from mic.results.run_folder import Block, RunFolder
from mic.results.run_identity import differences, inputs
from mic.results.run_samples import RunSamples
from mic.results.schema import CONTACTS, DATASETS
from mic.results.summary import summary

__all__ = ["Outcome", "TableCache", "read_outcome"]

CACHE_SIZE = 48_000_000  # bytes of tables in memory


class Outcome(RunSamples):
    """Samples and statistics of a run."""

    @cached_property
    def zone_statistics(self) -> pd.DataFrame:
        """Motion of each zone along its surfaces: :data:`mic.results.schema.ZONE_STATISTICS`."""
        return statistic_tables.zone_statistics(self)

    @cached_property
    def contact_statistics(self) -> pd.DataFrame:
        """Forces and states of each contact pair: :data:`mic.results.schema.CONTACT_STATISTICS`."""
        return statistic_tables.contact_statistics(self)

    @cached_property
    def measurement_statistics(self) -> pd.DataFrame:
        """Key characteristics against their limits: :data:`mic.results.schema.MEASUREMENT_STATISTICS`."""
        return statistic_tables.measurement_statistics(self)

    @cached_property
    def profile_statistics(self) -> pd.DataFrame:
        """Maps of deviation: :data:`mic.results.schema.PROFILE_STATISTICS`."""
        return statistic_tables.profile_statistics(self)

    @cached_property
    def limit_statistics(self) -> pd.DataFrame:
        """Clamps and guns of limited force: :data:`mic.results.schema.LIMIT_STATISTICS`."""
        return statistic_tables.limit_statistics(self)

    def summary(self) -> dict:
        """The outcome in one JSON-ready dict (``summary.json``), see :func:`mic.results.summary.summary`."""
        return summary(self, self.zone_statistics, self.measurement_statistics, self.limit_statistics)

    # ---------------------------------------------------------------------------------------------- old names

    @property
    def tables(self) -> dict[str, dict[str, pd.DataFrame]]:
        """Deprecated: all datasets of :data:`mic.results.schema.DATASETS` by law, failed samples included; of the
        contact pairs those that are kept."""
        warnings.warn("Outcome.tables is deprecated: read the datasets, or use accessors", DeprecationWarning, 2)
        return {law: self._whole(law) for law in self.blocks}

    @property
    def samples(self) -> dict[str, pd.DataFrame]:
        """Deprecated: one wide table per law, one row per sample, with keys in the names of its columns."""
        warnings.warn("Outcome.samples is deprecated: use the accessors of Outcome", DeprecationWarning, 2)
        return {law: _wide(self._whole(law)) for law in self.blocks}

    def valid(self, law: str) -> pd.DataFrame:
        """Deprecated: the valid samples of a law as one wide table."""
        warnings.warn("Outcome.valid is deprecated: use Outcome.sample_numbers and its kin", DeprecationWarning, 2)
        wide = _wide(self._whole(law))
        return wide[wide["sample"].isin(self.sample_numbers(law))]

    def _whole(self, law):
        store, whole = RunFolder(self.folder), {}
        for table in DATASETS:
            own = [block for block in self.blocks[law] if table is not CONTACTS or store.keeps_pairs(block)]
            frames = [self._block(block).tables[table.name] for block in own]
            frame = pd.concat(frames, ignore_index=True) if frames else table.empty()
            for column in table.columns:  # blocks in which other names occur
                if column.dtype == "category":
                    frame[column.name] = frame[column.name].astype("category")
            whole[table.name] = frame
        return whole


class TableCache(dict[Block, Mapping[str, pd.DataFrame]]):
    """Tables of the blocks that this process has just written, up to a total size."""

    def __init__(self, size: int = CACHE_SIZE) -> None:
        super().__init__()
        self._free = size  # bytes

    def keep(self, block: Block, tables: Mapping[str, pd.DataFrame]) -> bool:
        """Store all tables of a block if they fit; returns whether they are stored."""
        if block not in self:
            size = sum(int(frame.memory_usage(index=False).sum()) for frame in tables.values())
            if size <= self._free:
                self[block] = tables
                self._free -= size
        return block in self


def read_outcome(
    folder, model: ReducedModel | None = None, written: Mapping[Block, Mapping[str, pd.DataFrame]] | None = None
) -> Outcome:
    """Read a run folder, finished or interrupted.

    Parameters
    ----------
    folder : path-like
    model : ReducedModel, optional
        Model of the run, if already loaded.
    written : TableCache, optional
        Tables in memory.

    Raises
    ------
    RunError
        If the folder holds no run.
    FormatError
        If its record or model cannot be read. A block that cannot be read counts as missing.
    """
    store = RunFolder(Path(folder))
    record = store.record()
    model = model or _model(store, record)
    blocks: dict[str, list[Block]] = {law: [] for law in record["laws"]}
    digests = {law: Digest() for law in record["laws"]}
    damaged, room = [], CACHE_SIZE
    kept: dict[Block, dict[str, pd.DataFrame]] = {}
    for law in record["laws"]:
        for block in store.blocks(law, record["samples"]):
            try:
                tables = (written or {}).get(block) or store.read_block(block, record["identity"])
                sums = None if CONTACTS.name in tables else store.read_sums(block, record["identity"])
            except FormatError as problem:
                damaged.append(f"{problem}.")
                continue
            samples = BlockSamples(tables, len(model.contacts), record["samples"])
            digests[law].add(samples, model, sums)
            blocks[law].append(block)
            kept[block] = {}
            for name, frame in tables.items():  # contact tables get half of the cache; the others are small
                size = int(frame.memory_usage(index=False).sum())
                if size <= (room - CACHE_SIZE // 2 if name == "contacts" else room):
                    kept[block][name], room = frame, room - size
            del tables, frame  # frees memory before the next block
    return Outcome(store.path, record, model, blocks, digests, tuple(damaged), kept)


def _model(store: RunFolder, record: Mapping[str, Any]) -> ReducedModel:
    """The model of a run folder, checked against the identity in its record."""
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
    """One row per sample, with other quantities as columns ``KIND:KEY:KEY``."""
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
            columns[f"slip:{stage}:{zone}"] = slips["rms_tangential"].to_numpy()
    for name, rows in tables["measurements"].groupby("measurement", observed=True, sort=False):
        columns[f"measurement:{name}"] = rows["value"].to_numpy()
    return wide.assign(**columns)
