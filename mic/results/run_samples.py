"""Samples of a run, read from its folder when requested.

Everything comes from the files of the run folder, so an interrupted run, or one copied from another machine, can be
read too. Failed and missing samples enter no statistic; they are counted and listed.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from functools import cached_property
from pathlib import Path

import numpy as np
import pandas as pd
from numpy.typing import ArrayLike

from mic.compliance.part import Part
from mic.errors import RunError
from mic.process.model import ReducedModel
from mic.results.block_samples import BlockSamples
from mic.results.block_statistics import Digest
from mic.results.path_effect import PathStudy, read_path_study
from mic.results.run_folder import Block, RunFolder
from mic.results.schema import FRICTION, Table
from mic.scene.samples import DESIGNS
from mic.statistics import estimates

__all__ = ["RunSamples"]


@dataclass(frozen=True)
class RunSamples:
    """Samples of a run folder and the studies stored with them.

    Arrays over samples have one entry for each *valid* sample of a law, one that is there and did not fail, in
    ascending order of the samples' numbers.

    Attributes
    ----------
    folder : Path
    record : dict
        ``run.json``: scene, samples and seed asked for, laws, identity, versions, and ``wall_time`` (s by phase) where
        known.
    model : ReducedModel
    blocks : dict of str to list of Block
        By law, the blocks that were read.
    digests : dict of str to Digest
        By law, what the statistics need of them.
    damaged : tuple of str
        One sentence for each block that was left out since it could not be read.
    kept : dict of Block to dict of str to DataFrame
        Tables of the first blocks, by name, so that few samples need not be read twice.
    """

    folder: Path
    record: dict
    model: ReducedModel
    blocks: Mapping[str, list[Block]]
    digests: Mapping[str, Digest]
    damaged: tuple[str, ...] = ()
    kept: Mapping[Block, Mapping[str, pd.DataFrame]] = field(default_factory=dict, repr=False)

    @property
    def laws(self) -> list[str]:
        """Laws with at least one finished sample, in the order in which they were asked for."""
        return [law for law in self.record["laws"] if self.digests[law].found]

    @cached_property
    def stages(self) -> list[str]:
        """Stages that resolve contact, in their order in the process."""
        found = {stage for law in self.laws for stage in self.digests[law].stages}
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
        return {law: digest.failed for law, digest in self.digests.items()}

    @property
    def rescued(self) -> dict[str, list[int]]:
        """Numbers of the valid samples whose path could not be followed and took plain increments, by law."""
        return {law: digest.rescued for law, digest in self.digests.items()}

    @property
    def unbuilt(self) -> dict[str, list[int]]:
        """Numbers of the valid samples in which a clamp or gun of limited force did not reach its position, by law."""
        return {law: digest.unbuilt for law, digest in self.digests.items()}

    @property
    def missing(self) -> dict[str, int]:
        """Samples that were asked for and are not in the folder, by law; all zero for a finished run."""
        return {law: self.record["samples"] - digest.found for law, digest in self.digests.items()}

    @property
    def uncertainty(self) -> float:
        """Half of the 95 % interval of the 6σ of a key characteristic, as a share of it: of the one that is known
        worst under any law, by regression where that is narrower; infinite where one is not known."""
        worst = 0.0
        for law in self.laws:
            digest = self.digests[law]
            plain = estimates.six_sigma(digest.moments["measurements",])
            value, low, high = (np.atleast_1d(part) for part in (plain.value, plain.low, plain.high))
            better = digest.regression.improved() if digest.regression else None
            if better is not None:
                own = better.kind != "plain"
                value, low, high = (np.where(own, 6 * s, x) for s, x in zip(better.sigma, (value, low, high)))
            with np.errstate(invalid="ignore", divide="ignore"):
                share = np.where(value > 0, 0.5 * (high - low) / value, 0.0)
            worst = max(worst, float(np.where(np.isnan(value) | np.isnan(share), np.inf, share).max(initial=0.0)))
        return worst if self.laws else float("inf")

    @property
    def together(self) -> int:
        """Samples that the design makes together: those of one group are not independent; 1 where all are."""
        return DESIGNS[self.model.scene.monte_carlo.design]

    @cached_property
    def parts(self) -> tuple[Part, ...]:
        """The parts with their meshes, as the run kept them; none where it did not."""
        return RunFolder(self.folder).parts(self.model.scene)

    # ---------------------------------------------------------------------------------------------- samples
    # Each takes the numbers of the valid samples that are wanted, in ascending order; by default all of them, which
    # takes memory in proportion.

    def sample_numbers(self, law: str) -> np.ndarray:
        """(n,) numbers of the valid samples."""
        return self._numbers[law]

    def deviation(self, law: str, name: str, samples: ArrayLike | None = None) -> np.ndarray:
        """(n,) drawn values of a deviation, N or mm."""
        return self._gathered(law, samples, lambda block: block.column("deviations", "value", deviation=name))

    def residual(self, law: str, stage: str, samples: ArrayLike | None = None) -> np.ndarray:
        """(n,) certificate residuals of a stage."""
        return self._gathered(law, samples, lambda block: block.column("resolutions", "residual", stage=stage))

    def path_error(self, law: str, stage: str, samples: ArrayLike | None = None) -> np.ndarray:
        """(n,) estimated error that the path up to a stage's end left, mm (:data:`mic.results.schema.RESOLUTIONS`)."""
        return self._gathered(law, samples, lambda block: block.column("resolutions", "path_error", stage=stage))

    def tangential(self, law: str, stage: str, zone: str, samples: ArrayLike | None = None) -> np.ndarray:
        """(n,) RMS tangential displacement of a zone in a stage, that of open contacts included, mm.

        NaN where no tangential motion was modelled.
        """
        return self._motion(law, stage, zone, "rms_tangential", samples)

    def slip(self, law: str, stage: str, zone: str, samples: ArrayLike | None = None) -> np.ndarray:
        """(n,) RMS slip under load of a zone in a stage, mm; NaN where no friction was modelled."""
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
        """One quantity of all m contact pairs, (n, m).

        Parameters
        ----------
        column : str
            ``f_n, f_t1, f_t2`` (N), ``u_n, u_t1, u_t2`` (mm), ``state`` (index into ``mic.contact.states.STATES``), or
            the magnitudes ``f_t`` (N) and ``u_t`` (mm) of the tangential parts; ``path_stick`` and ``path_slip``, the
            shares of the stage's path.

        Raises
        ------
        RunError
            For samples whose pairs are not kept, see :meth:`with_pairs`.
        """
        wanted, kept = self.sample_numbers(law) if samples is None else np.asarray(samples), self.with_pairs(law)
        if not np.isin(wanted, kept).all():
            raise RunError(
                f"{self.folder}: keeps the contact pairs of {len(kept)} samples under {law}, and others are asked for; "
                "ask for those (Outcome.with_pairs), or run again with more contacts in [report]"
            )
        width = len(self.model.contacts)
        return self._gathered(law, samples, lambda block: block.contact(stage, column), (width,))

    def with_pairs(self, law: str) -> np.ndarray:
        """(n,) numbers of the valid samples whose contact pairs are kept: the first ones, as many as the scene's report
        asks for under ``contacts``."""
        numbers, kept = self.sample_numbers(law), np.zeros(0, dtype=int)
        for block in self.blocks[law]:
            if RunFolder(self.folder).keeps_pairs(block):
                own = (numbers >= block.first) & (numbers < block.first + block.count)
                kept = np.append(kept, numbers[own])
        return kept

    def failures(self, law: str) -> pd.DataFrame:
        """Why samples failed: ``sample, stage, residual, status``.

        One row per failed sample and stage that did not converge.
        """
        return self.digests[law].failures

    def worst_residual(self, law: str) -> float:
        """Largest certificate residual of the valid samples over all stages.

        0 where no contact is resolved, NaN without samples.
        """
        if not len(self.sample_numbers(law)):
            return float("nan")
        moments = self.digests[law].moments
        return max((float(moments["resolutions", stage, "residual"].high) for stage in self.stages), default=0.0)

    @cached_property
    def _numbers(self) -> dict[str, np.ndarray]:
        return {law: digest.numbers for law, digest in self.digests.items()}

    def _gathered(
        self,
        law: str,
        samples: ArrayLike | None,
        read: Callable[[BlockSamples], np.ndarray],
        shape: tuple[int, ...] = (),
    ) -> np.ndarray:
        """What `read` makes of the blocks, for the samples wanted."""
        wanted = None if samples is None else np.unique(samples)
        found = []
        for block in self.blocks[law]:
            if wanted is None:
                found.append(read(self._block(block)))
            elif np.searchsorted(wanted, block.first) < np.searchsorted(wanted, block.first + block.count):
                samples_of = self._block(block)
                found.append(read(samples_of)[np.isin(samples_of.numbers, wanted)])
        values = np.concatenate(found) if found else np.zeros((0, *shape))
        if wanted is not None and len(values) != len(wanted):
            raise KeyError(f"law {law!r}: some of the samples asked for are not among its valid ones")
        return values

    def _block(self, block: Block) -> BlockSamples:
        folder, whose = RunFolder(self.folder), self.record["identity"]
        tables = _Tables(lambda name: folder.read_dataset(block, name, whose), self.kept.get(block, {}))
        return BlockSamples(tables, len(self.model.contacts), self.record["samples"])

    @cached_property
    def path_study(self) -> PathStudy | None:
        """Effect of a tighter load path: :mod:`mic.results.path_effect`; None where not stored."""
        return read_path_study(self.folder)

    @cached_property
    def friction_study(self) -> pd.DataFrame | None:
        """The laws compared as friction grows: :data:`mic.results.schema.FRICTION`; None where not stored."""
        return FRICTION.read(self.folder, "call `mic report` on the run folder")

    def study(self, table: Table) -> pd.DataFrame | None:
        """A table of :data:`mic.results.schema.STUDIES`, or that of the meshes' accuracy; None where not stored.

        Raises
        ------
        FormatError
            If the file is not what the table declares.
        """
        return table.read(self.folder, "call the command that wrote it on the run folder again")


class _Tables(dict[str, pd.DataFrame]):
    """The tables of a block, each read when it is first asked for."""

    def __init__(self, read: Callable[[str], pd.DataFrame], kept: Mapping[str, pd.DataFrame]) -> None:
        super().__init__(kept)
        self._read = read

    def __missing__(self, name: str) -> pd.DataFrame:
        self[name] = self._read(name)
        return self[name]
