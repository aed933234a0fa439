"""The outcome of a run: samples, statistics and studies of its folder.

One pass over the blocks accumulates the statistics and discards the samples, so memory does not grow with their
number. Accessors of single samples read their blocks again.
"""

from __future__ import annotations

import copy
import warnings
from collections.abc import Mapping, Sequence
from functools import cached_property
from pathlib import Path
from typing import Any

import pandas as pd

from mic.errors import FormatError, RunError
from mic.process.model import ReducedModel
from mic.results import statistic_tables
from mic.results.block_samples import BlockSamples
from mic.results.block_statistics import Accumulator
from mic.results.headline import headline
from mic.results.improved import Improved
from mic.results.required_accuracy import Uncertainty, largest_uncertainty
from mic.results.run_folder import Block, RunFolder
from mic.results.run_identity import differences, inputs
from mic.results.run_samples import RunSamples
from mic.results.schema import CONTACTS, SAMPLES, SUMS
from mic.results.summary import summary
from mic.system.files import Format, reading

__all__ = ["CACHE_SIZE", "BlockCache", "Outcome", "memory", "read_outcome"]

CACHE_SIZE = 48_000_000  # bytes of tables in memory
_AGAIN = "run the scene again into this folder"


class Outcome(RunSamples):
    """Samples and statistics of a run."""

    zone_statistics = cached_property(statistic_tables.zone_statistics)
    contact_statistics = cached_property(statistic_tables.contact_statistics)
    measurement_statistics = cached_property(statistic_tables.measurement_statistics)
    profile_statistics = cached_property(statistic_tables.profile_statistics)
    limit_statistics = cached_property(statistic_tables.limit_statistics)

    @cached_property
    def measurement_headlines(self) -> pd.DataFrame:
        """`measurement_statistics` with the best estimates (:func:`mic.results.headline.headline`)."""
        return headline(self.measurement_statistics)

    @cached_property
    def zone_headlines(self) -> pd.DataFrame:
        """`zone_statistics` with the best estimates."""
        return headline(self.zone_statistics)

    def uncertainty(self, required: Mapping[str, float]) -> Uncertainty:
        """The quantity that is farthest from its required accuracy (:class:`mic.scene.schema.Accuracy`)."""
        zones = self.zone_headlines if "slip" in required else None
        return largest_uncertainty(self.measurement_headlines, zones, required)

    def summary(self) -> dict:
        """The outcome in one JSON-ready dict (``summary.json``), see :func:`mic.results.summary.summary`."""
        accuracy, reached = self.model.scene.monte_carlo.accuracy, {}
        if accuracy is not None:
            found = self.uncertainty(accuracy.required)
            sentence = found.sentence(self.record["samples"])
            reached = {"required_accuracy": {"reached": bool(found.reached), "sentence": sentence}}
        return summary(self, self.zone_statistics, self.measurement_statistics, self.limit_statistics) | reached

    # ---------------------------------------------------------------------------------------------- names of 0.1.0

    @property
    def samples(self) -> dict[str, pd.DataFrame]:
        """Deprecated: one wide table per law, one row per sample, with keys in the column names."""
        warnings.warn("Outcome.samples is deprecated: use the accessors of Outcome", DeprecationWarning, 2)
        return {law: self._wide(law) for law in self.blocks}

    def valid(self, law: str) -> pd.DataFrame:
        """Deprecated: the valid samples of a law as one wide table."""
        warnings.warn("Outcome.valid is deprecated: use the accessors of Outcome", DeprecationWarning, 2)
        wide = self._wide(law)
        return wide[wide["sample"].isin(self.sample_numbers(law))]

    def _wide(self, law: str) -> pd.DataFrame:
        frames = [_wide(self._block(block).tables) for block in self.blocks[law]]
        return pd.concat(frames, ignore_index=True) if frames else SAMPLES.empty()


class BlockCache:
    """Statistics and tables of the blocks that a run has just written, which need not be read.

    Statistics are merged as soon as those of all blocks before are, so that few wait; tables are cached up to a total
    size.

    Parameters
    ----------
    size : int
        Bytes of tables.

    Attributes
    ----------
    tables : dict of Block to dict of str to DataFrame
    estimates : dict of (str, int) to Improved
        By law and number of samples.
    """

    def __init__(self, size: int = CACHE_SIZE) -> None:
        self.tables: dict[Block, Mapping[str, pd.DataFrame]] = {}
        self.estimates: dict[tuple[str, int], Improved | None] = {}
        self._free = size  # bytes
        self._waiting: dict[tuple[str, int], tuple[Block, Accumulator]] = {}  # by law and first sample
        self._merged: dict[str, tuple[list[Block], Accumulator]] = {}

    def store(self, block: Block, statistics: Accumulator, tables: Mapping[str, pd.DataFrame] | None = None) -> None:
        """Store a block, with its tables if they fit."""
        blocks, merged = self._merged.setdefault(block.law, ([], Accumulator()))
        self._waiting[block.law, block.first] = block, statistics
        while found := self._waiting.pop((block.law, blocks[-1].end if blocks else 0), None):
            blocks.append(found[0])
            merged.merge(found[1])
        size = memory(tables) if tables is not None else 0
        if tables is not None and size <= self._free:
            self.tables[block] = tables
            self._free -= size

    def statistics(self, law: str, blocks: Sequence[Block], samples: int) -> tuple[Accumulator, int]:
        """Statistics of the first of these blocks, and the number of blocks they are of."""
        merged, found = self._merged.get(law, ([], Accumulator()))
        if merged and list(blocks[: len(merged)]) == merged and merged[-1].end <= samples:
            return copy.deepcopy(found), len(merged)
        return Accumulator(), 0

    def waiting(self, block: Block, samples: int) -> Accumulator | None:
        """Statistics of a block that are not merged, since a block before was not written by this run."""
        found = self._waiting.get((block.law, block.first))
        return found[1] if found and found[0] == block and block.end <= samples else None


def memory(tables: Mapping[str, pd.DataFrame]) -> int:
    """Bytes of tables."""
    return sum(int(frame.memory_usage(index=False).sum()) for frame in tables.values())


def read_outcome(folder, model: ReducedModel | None = None, cached: BlockCache | None = None) -> Outcome:
    """Read a run folder, finished or interrupted.

    Parameters
    ----------
    folder : path-like
    model : ReducedModel, optional
        Model of the run, if already loaded.
    cached : BlockCache, optional
        Blocks in memory.

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
    cached = cached or BlockCache()
    blocks: dict[str, list[Block]] = {law: [] for law in record["laws"]}
    accumulators, damaged, free = {}, [], CACHE_SIZE
    cached_tables: dict[Block, dict[str, pd.DataFrame]] = {}
    for law in record["laws"]:
        every = store.blocks(law, record["samples"])
        accumulators[law], known = cached.statistics(law, every, record["samples"])
        for i, block in enumerate(every):
            tables, statistics = cached.tables.get(block), cached.waiting(block, record["samples"])
            if i >= known and statistics is None:
                try:
                    tables = tables or store.read_block(block, record["identity"])
                    sums = None if CONTACTS.name in tables else store.read_arrays(SUMS, block, record["identity"])
                except FormatError as problem:
                    damaged.append(f"{problem}.")
                    continue
                with reading(store.path, Format(f"block {block.law} {block.name}", 1, _AGAIN)):
                    samples = BlockSamples(tables, len(model.contacts), record["samples"])
                    statistics = Accumulator.of(samples, model, sums)
            if i >= known and statistics is not None:
                accumulators[law].merge(statistics)
            blocks[law].append(block)
            cached_tables[block] = {}
            for name, frame in (tables or {}).items():  # contact tables get half of the cache; the others are small
                size = memory({name: frame})
                if size <= (free - CACHE_SIZE // 2 if name == "contacts" else free):
                    cached_tables[block][name], free = frame, free - size
            del tables, statistics  # frees memory before the next block
    return Outcome(store.path, record, model, blocks, accumulators, tuple(damaged), cached_tables, cached.estimates)


def _model(store: RunFolder, record: Mapping[str, Any]) -> ReducedModel:
    """The model of a run folder, checked against the inputs in its record."""
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
    return tables["samples"].assign(**columns)
