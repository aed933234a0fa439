"""Statistics of the samples of one law, merged from those of its blocks, so that no block stays in memory."""

from __future__ import annotations

import copy
from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field, fields

import numpy as np
import pandas as pd

from mic.results.block_samples import BlockSamples
from mic.results.contact_sums import ContactSums
from mic.results.output_samples import MOST, OutputSamples
from mic.results.schema import SLIPS
from mic.statistics.capability import outside
from mic.statistics.estimates import Moments

__all__ = ["Accumulator", "MomentTable"]


class MomentTable(Mapping[tuple[str, ...], Moments]):
    """Moments by key, all in one array for each of their fields, so that two tables are merged in one step.

    Parameters
    ----------
    moments : mapping of tuple to Moments
    """

    def __init__(self, moments: Mapping[tuple[str, ...], Moments]) -> None:
        self._shapes = {key: np.shape(one.mean) for key, one in moments.items()}
        ends = np.cumsum([int(np.prod(shape)) for shape in self._shapes.values()]).tolist()
        self._ranges = {key: slice(first, end) for key, first, end in zip(moments, [0, *ends], ends)}
        together = ([np.ravel(getattr(one, item.name)) for one in moments.values()] for item in fields(Moments))
        self._all = Moments(*(np.concatenate(arrays) if arrays else np.zeros(0) for arrays in together))

    def __getitem__(self, key: tuple[str, ...]) -> Moments:
        shape, own = self._shapes[key], self._all.at(self._ranges[key])
        return own.at(0) if shape == () else Moments(*(getattr(own, item.name).reshape(shape) for item in fields(own)))

    def __iter__(self) -> Iterator[tuple[str, ...]]:
        return iter(self._shapes)

    def __len__(self) -> int:
        return len(self._shapes)

    def merged(self, other: MomentTable) -> MomentTable:
        """The moments of both sets of samples."""
        if self._shapes != other._shapes:
            both = {key: self[key].merged(other[key]) if key in self and key in other else one
                    for key, one in (dict(other) | dict(self)).items()}  # fmt: skip
            return MomentTable(both)
        found = copy.copy(self)
        found._all = self._all.merged(other._all)
        return found


@dataclass
class Accumulator:
    """Accumulated statistics of the samples of one law.

    Attributes
    ----------
    count : int
        Finished samples, including failed ones.
    stages : set of str
        Stages that resolve contact.
    rescued : list of int
        Numbers of the valid samples that were solved with fixed increments, because path following failed.
    unbuilt : list of int
        Numbers of the valid samples in which a clamp or gun of limited force did not reach its position.
    unseen : tuple of (float, str, int, int)
        Deepest penetration between the contact pairs: depth, mm, stage, sample, and index of the model's check point,
        −1 if there is no penetration. The first one of equal depth.
    outputs : OutputSamples or None
        Deviations and outputs of the first valid samples; None before the first block.
    moments : MomentTable
        Over the valid samples: ``("measurements",)``, (k,) in the order of the scene; ``("profiles", name)``, by point;
        ``("slips", stage, column)``, by zone, columns of :data:`mic.results.schema.SLIPS`; ``("contacts", stage,
        column)``, (m,), columns of :meth:`BlockSamples.contact`; ``("pressed", stage, which)``, by zone: sum of the
        normal forces of ``"all"`` pairs, or of those ``"clear"`` of every weld by three nugget radii; ``("resolutions",
        stage, column)``, scalar: ``residual``, ``path_error``, ``path_force_error``, ``steps`` and
        ``factorisations``; ``("limits", stage, name, column)``, scalar: ``pushed``, ``left`` and ``needed``.
    counts : dict of tuple to int array
        Numbers of valid samples: ``("outside",)``, (k,) beyond their limits; ``("any outside",)``, () with any beyond;
        ``("states", stage)``, (3, m) by state; ``("short", stage, name)``, () in which a clamp or gun falls short.
    """

    count: int = 0
    stages: set[str] = field(default_factory=set)
    rescued: list[int] = field(default_factory=list)
    unbuilt: list[int] = field(default_factory=list)
    unseen: tuple[float, str, int, int] = (0.0, "", -1, -1)
    outputs: OutputSamples | None = None
    moments: MomentTable = field(default_factory=lambda: MomentTable({}))
    counts: dict[tuple[str, ...], np.ndarray] = field(default_factory=dict)
    _numbers: list[np.ndarray] = field(default_factory=list)
    _failed: list[np.ndarray] = field(default_factory=list)
    _failures: list[pd.DataFrame] = field(default_factory=list)

    @property
    def numbers(self) -> np.ndarray:
        """(n,) numbers of the valid samples."""
        return np.concatenate(self._numbers) if self._numbers else np.zeros(0, dtype=np.int32)

    @property
    def failed(self) -> list[int]:
        """Numbers of the failed samples."""
        return [int(number) for block in self._failed for number in block]

    @property
    def failures(self) -> pd.DataFrame:
        """See :meth:`mic.results.outcome.Outcome.failures`."""
        table = pd.concat(self._failures, ignore_index=True)
        return table.sort_values("sample", kind="stable", ignore_index=True)

    @classmethod
    def of(cls, block: BlockSamples, model, sums: ContactSums | None = None) -> Accumulator:
        """The statistics of one block.

        Parameters
        ----------
        block : BlockSamples
        model : mic.model.reduction.Reduction
        sums : ContactSums, optional
            For a block without its contact pairs.
        """
        found = cls(
            count=block.count,
            stages=set(block.stages),
            unbuilt=[int(number) for number in block.unbuilt],
            outputs=OutputSamples.of(block, model),
            _numbers=[block.numbers],
            _failed=[block.failed],
            _failures=[block.failures()],
        )
        moments = found._measurements(block, model)
        sums = sums or ContactSums.of(block, model)
        moments |= dict(sums.moments)
        found.counts |= dict(sums.counts)
        moments |= found._stages(block, model)
        for stage, name in block.tables["limits"][["stage", "name"]].drop_duplicates().itertuples(index=False):
            for column in ("pushed", "left", "needed"):
                values = block.column("limits", column, stage=stage, name=name)
                moments["limits", stage, name, column] = Moments.of(values)
            reached = block.column("limits", "reached", stage=stage, name=name)
            found.counts["short", stage, name] = np.array((~reached).sum())
        found.moments = MomentTable(moments)
        return found

    def merge(self, other: Accumulator) -> None:
        """Add the statistics of a block; the blocks of a law are added in ascending order, on which the bits depend."""
        self.count += other.count
        self.stages |= other.stages
        self.rescued += other.rescued
        self.unbuilt += other.unbuilt
        if other.unseen[0] > self.unseen[0]:
            self.unseen = other.unseen
        if self.outputs is None:
            self.outputs = other.outputs
        elif other.outputs is not None and len(self.outputs.y) < MOST:
            both = OutputSamples.union([self.outputs, other.outputs])
            self.outputs = both and both.first(MOST)
        self.moments = self.moments.merged(other.moments) if self.moments else other.moments
        for key, count in other.counts.items():
            self.counts[key] = self.counts[key] + count if key in self.counts else count
        self._numbers += other._numbers
        self._failed += other._failed
        if len(other.failed) or not self._failures:
            self._failures += other._failures

    def _measurements(self, block: BlockSamples, model) -> dict[tuple[str, ...], Moments]:
        items = model.scene.measurements
        if not items:
            return {}
        y = np.column_stack([block.column("measurements", "value", measurement=item.name) for item in items])
        moments: dict[tuple[str, ...], Moments] = {("measurements",): Moments.of(y)}
        lower, upper = np.array([(item.lower, item.upper) for item in items]).T
        self.counts["outside",] = outside(y, lower, upper)
        self.counts["any outside",] = np.array(((y < lower) | (y > upper)).any(axis=1).sum())
        for item in items:
            if item.points is not None:
                moments["profiles", item.name] = Moments.of(block.profile(item.name))
        return moments

    def _stages(self, block: BlockSamples, model) -> dict[tuple[str, ...], Moments]:
        moments: dict[tuple[str, ...], Moments] = {}
        tangential = len(model.contacts) > 0 and model.contacts.dimension == 3
        rescued = np.zeros(len(block.numbers), dtype=bool)
        for stage in block.stages:
            rescued |= block.column("resolutions", "rescued", stage=stage)
            depth = block.column("resolutions", "unseen", stage=stage)
            if depth.max(initial=0.0) > self.unseen[0]:
                i = int(depth.argmax())
                point = int(block.column("resolutions", "unseen_at", stage=stage)[i])
                self.unseen = float(depth[i]), stage, int(block.numbers[i]), point
            for column in ("residual", "path_error", "path_force_error", "steps", "factorisations"):
                values = block.column("resolutions", column, stage=stage)
                moments["resolutions", stage, column] = Moments.of(values)
            for column in SLIPS.names[3:] if tangential else ():
                zones = [block.column("slips", column, stage=stage, zone=zone.name) for zone in model.scene.zones]
                moments["slips", stage, column] = Moments.of(np.column_stack(zones))
        self.rescued += [int(number) for number in block.numbers[rescued]]
        return moments
