"""Samples of a run, read from its folder when requested.

Everything is read from the files of the run folder, which may be interrupted or copied from another machine. Failed
and missing samples are excluded from all statistics, counted and listed.
"""

from __future__ import annotations

import logging
from collections.abc import Callable, Mapping
from contextlib import suppress
from dataclasses import dataclass, field
from functools import cached_property
from pathlib import Path

import numpy as np
import pandas as pd
from numpy.typing import ArrayLike

from mic.compliance.part import Part
from mic.errors import FormatError, RunError, StorageError
from mic.process.model import ReducedModel
from mic.results.block_samples import BlockSamples
from mic.results.block_statistics import Accumulator
from mic.results.improved import FURTHER, Improved, improve, population
from mic.results.output_samples import OutputSamples
from mic.results.path_effect import PathStudy
from mic.results.run_folder import Block, RunFolder
from mic.results.schema import FRICTION, PATH, PATH_ERRORS, Table
from mic.scene.samples import DESIGNS
from mic.system.files import set_aside

__all__ = ["RunSamples"]

_log = logging.getLogger(__name__)


@dataclass(frozen=True)
class RunSamples:
    """Samples of a run folder and the studies stored with them.

    Arrays over samples have one entry for each *valid* sample of a law, one that is finished and did not fail, in
    ascending order of the samples' numbers.

    Attributes
    ----------
    folder : Path
    record : dict
        ``run.json``: scene, requested samples, seed, laws, identity, versions, and ``wall_time`` (s by phase) if known.
    model : ReducedModel
    blocks : dict of str to list of Block
        Finished blocks by law.
    accumulators : dict of str to Accumulator
        Accumulated statistics by law.
    damaged : tuple of str
        One sentence for each block that could not be read.
    cached_tables : dict of Block to dict of str to DataFrame
        Cached tables of the first blocks, by name.
    cached_estimates : dict of (str, int) to Improved
        Cached results of :meth:`improved` by law and number of samples.
    """

    folder: Path
    record: dict
    model: ReducedModel
    blocks: Mapping[str, list[Block]]
    accumulators: Mapping[str, Accumulator]
    damaged: tuple[str, ...] = ()
    cached_tables: Mapping[Block, Mapping[str, pd.DataFrame]] = field(default_factory=dict, repr=False)
    cached_estimates: dict[tuple[str, int], Improved | None] = field(default_factory=dict, repr=False)

    @property
    def laws(self) -> list[str]:
        """Laws with at least one finished sample, in the requested order."""
        return [law for law in self.record["laws"] if self.accumulators[law].count]

    @cached_property
    def stages(self) -> list[str]:
        """Stages that resolve contact, in their order in the process."""
        resolved = {stage for law in self.laws for stage in self.accumulators[law].stages}
        return [name for stage in self.model.scene.stages if (name := str(stage.name)) in resolved]

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
        return {law: accumulator.failed for law, accumulator in self.accumulators.items()}

    @property
    def rescued(self) -> dict[str, list[int]]:
        """Numbers of the valid samples solved with fixed increments because path following failed, by law."""
        return {law: accumulator.rescued for law, accumulator in self.accumulators.items()}

    @property
    def unbuilt(self) -> dict[str, list[int]]:
        """Numbers of the valid samples in which a clamp or gun of limited force did not reach its position, by law."""
        return {law: accumulator.unbuilt for law, accumulator in self.accumulators.items()}

    @property
    def missing(self) -> dict[str, int]:
        """Number of requested samples that are not finished, by law; zero for a finished run."""
        return {law: self.record["samples"] - accumulator.count for law, accumulator in self.accumulators.items()}

    def improved(self, law: str) -> Improved | None:
        """Estimates of a law with surrogates, cached; None without (:func:`mic.results.improved.improve`)."""
        outputs, number = self.accumulators[law].outputs, len(self.sample_numbers(law))
        if (law, number) not in self.cached_estimates:
            points = lambda *_: self._population
            found = None if outputs is None else improve(self.model.scene, outputs, number, self._one_step(law), points)
            self.cached_estimates[law, number] = found
        return self.cached_estimates[law, number]

    def _one_step(self, law: str) -> OutputSamples | None:
        """The samples in one step that belong to the requested samples; an earlier run may have left further ones."""
        if self.model.scene.monte_carlo.accuracy is None:
            return None
        found = OutputSamples.union(RunFolder(self.folder).one_step(law, self.record["identity"]).values())
        end = (1 + FURTHER) * self.record["samples"]
        return found and found.first(int(np.searchsorted(found.numbers, end)))

    @cached_property
    def _population(self) -> np.ndarray:
        """Points of the deviations' distribution, the same under all laws."""
        return population(self.model.scene, self.record["samples"])

    @property
    def together(self) -> int:
        """Number of samples in a group of dependent samples of the sampling design; 1 if all are independent."""
        return DESIGNS[self.model.scene.monte_carlo.design]

    @cached_property
    def parts(self) -> tuple[Part, ...]:
        """The parts with their meshes; none if the run did not store them."""
        return RunFolder(self.folder).parts()

    # ---------------------------------------------------------------------------------------------- samples
    # `samples`: numbers of the requested valid samples, in ascending order; default: all, which needs memory in
    # proportion.

    def sample_numbers(self, law: str) -> np.ndarray:
        """(n,) numbers of the valid samples."""
        return self._numbers[law]

    def deviation(self, law: str, name: str, samples: ArrayLike | None = None) -> np.ndarray:
        """(n,) sampled values of a deviation, N or mm."""
        return self._gathered(law, samples, lambda block: block.column("deviations", "value", deviation=name))

    def deviations(self, law: str, samples: ArrayLike) -> np.ndarray:
        """(n, k) sampled values of all deviations of the model, in its order, N or mm."""
        values = [self.deviation(law, name, samples) for name in self.model.parameters]
        return np.stack(values, axis=1) if values else np.zeros((len(np.asarray(samples)), 0))

    def residual(self, law: str, stage: str, samples: ArrayLike | None = None) -> np.ndarray:
        """(n,) certificate residuals of a stage."""
        return self._gathered(law, samples, lambda block: block.column("resolutions", "residual", stage=stage))

    def path_error(self, law: str, stage: str, samples: ArrayLike | None = None) -> np.ndarray:
        """(n,) estimated path error at the end of a stage, mm (:data:`mic.results.schema.RESOLUTIONS`)."""
        return self._gathered(law, samples, lambda block: block.column("resolutions", "path_error", stage=stage))

    def path_force_error(self, law: str, stage: str, samples: ArrayLike | None = None) -> np.ndarray:
        """(n,) estimated path error of the contact forces, likewise, N."""
        return self._gathered(law, samples, lambda block: block.column("resolutions", "path_force_error", stage=stage))

    def tangential(self, law: str, stage: str, zone: str, samples: ArrayLike | None = None) -> np.ndarray:
        """(n,) RMS tangential displacement of a zone in a stage, including open contacts, mm.

        NaN if tangential motion is not modelled.
        """
        return self._motion(law, stage, zone, "rms_tangential", samples)

    def slip(self, law: str, stage: str, zone: str, samples: ArrayLike | None = None) -> np.ndarray:
        """(n,) RMS slip under load of a zone in a stage, mm; NaN if friction is not modelled."""
        return self._motion(law, stage, zone, "rms_slip", samples)

    def _motion(self, law, stage, zone, column, samples):
        """(n,) a column of the dataset `slips`."""
        if not self.has_slip:
            return self._gathered(law, samples, lambda block: np.full(len(block.numbers), np.nan))
        return self._gathered(law, samples, lambda block: block.column("slips", column, stage=stage, zone=zone))

    def measured(self, law: str, name: str, samples: ArrayLike | None = None) -> np.ndarray:
        """(n,) values of a measurement, mm from nominal."""
        return self._gathered(law, samples, lambda block: block.column("measurements", "value", measurement=name))

    def contact(self, law: str, stage: str, column: str, samples: ArrayLike | None = None) -> np.ndarray:
        """(n, m) a quantity of all m contact pairs.

        Parameters
        ----------
        column : str
            ``f_n, f_t1, f_t2`` (N), ``u_n, u_t1, u_t2`` (mm), ``state`` (index into ``mic.contact.states.STATES``), or
            the magnitudes ``f_t`` (N) and ``u_t`` (mm) of the tangential parts; ``path_stick`` and ``path_slip``, the
            shares of the stage's load path.

        Raises
        ------
        RunError
            For samples whose contact pairs are not stored, see :meth:`with_pairs`.
        """
        requested, stored = self.sample_numbers(law) if samples is None else np.asarray(samples), self.with_pairs(law)
        if not np.isin(requested, stored).all():
            raise RunError(
                f"{self.folder}: stores the contact pairs of {len(stored)} samples under {law}, and others are "
                "requested; request only those (Outcome.with_pairs), or run again with more contacts in [report]"
            )
        width = len(self.model.contacts)
        return self._gathered(law, samples, lambda block: block.contact(stage, column), (width,))

    def with_pairs(self, law: str) -> np.ndarray:
        """(n,) numbers of the valid samples with stored contact pairs (``contacts`` in ``[report]``)."""
        numbers = self.sample_numbers(law)
        stored = np.zeros(len(numbers), dtype=bool)
        for block in self.blocks[law]:
            if RunFolder(self.folder).has_pairs(block):
                stored |= (numbers >= block.first) & (numbers < block.end)
        return numbers[stored]

    def failures(self, law: str) -> pd.DataFrame:
        """Reasons of failure: ``sample, stage, residual, status``, one row per failed sample and stage."""
        return self.accumulators[law].failures

    def worst_residual(self, law: str) -> float:
        """Largest certificate residual of the valid samples; 0 if no contact is resolved, NaN without samples."""
        if not len(self.sample_numbers(law)):
            return float("nan")
        moments = self.accumulators[law].moments
        return max((float(moments["resolutions", stage, "residual"].high) for stage in self.stages), default=0.0)

    @cached_property
    def _numbers(self) -> dict[str, np.ndarray]:
        return {law: accumulator.numbers for law, accumulator in self.accumulators.items()}

    def _gathered(
        self,
        law: str,
        samples: ArrayLike | None,
        read: Callable[[BlockSamples], np.ndarray],
        shape: tuple[int, ...] = (),
    ) -> np.ndarray:
        """Values that `read` returns for each block, for the requested samples."""
        requested = None if samples is None else np.unique(samples)
        pieces = []
        for block in self.blocks[law]:
            if requested is None:
                pieces.append(read(self._block(block)))
            elif np.searchsorted(requested, block.first) < np.searchsorted(requested, block.end):
                block_samples = self._block(block)
                pieces.append(read(block_samples)[np.isin(block_samples.numbers, requested)])
        values = np.concatenate(pieces) if pieces else np.zeros((0, *shape))
        if requested is not None and len(values) != len(requested):
            raise KeyError(f"law {law!r}: some of the requested samples are not valid")
        return values

    def _block(self, block: Block) -> BlockSamples:
        folder, identity = RunFolder(self.folder), self.record["identity"]
        tables = _LazyTables(lambda name: folder.read_dataset(block, name, identity), self.cached_tables.get(block, {}))
        return BlockSamples(tables, len(self.model.contacts), self.record["samples"])

    @cached_property
    def path_study(self) -> PathStudy | None:
        """Effect of a tighter load path: :mod:`mic.results.path_effect`; None if not stored."""
        pairs, errors = self.study(PATH), self.study(PATH_ERRORS)
        return None if pairs is None or errors is None else PathStudy(pairs, errors)

    @cached_property
    def friction_study(self) -> pd.DataFrame | None:
        """Comparison of the laws as friction grows: :data:`mic.results.schema.FRICTION`; None if not stored."""
        return self.study(FRICTION)

    def study(self, table: Table) -> pd.DataFrame | None:
        """A table of :data:`mic.results.schema.STUDIES`, or one that a run writes on request; None if not stored.

        A file that differs from the declaration, or is damaged, is set aside with a warning and counts as absent.
        """
        command = "`mic report`" if table in (PATH, PATH_ERRORS, FRICTION) else "the command that wrote it"
        try:
            return table.read(self.folder, f"call {command} on the run folder")
        except FormatError as problem:
            with suppress(StorageError):  # in a folder that cannot be written it is not read either
                set_aside(self.folder / table.place)
            _log.warning("%s. It is set aside and counts as absent.", problem)
            return None


class _LazyTables(dict[str, pd.DataFrame]):
    """The tables of a block, each read on first access."""

    def __init__(self, read: Callable[[str], pd.DataFrame], cached: Mapping[str, pd.DataFrame]) -> None:
        super().__init__(cached)
        self._read = read

    def __missing__(self, name: str) -> pd.DataFrame:
        self[name] = self._read(name)
        return self[name]
