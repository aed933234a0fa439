"""Statistics of the samples of one law, accumulated block by block, so that no block stays in memory."""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np
import pandas as pd

from mic.results.block_samples import BlockSamples
from mic.results.contact_sums import Sums
from mic.results.schema import SLIPS
from mic.statistics.capability import outside
from mic.statistics.estimates import Moments
from mic.statistics.regression import Regression

__all__ = ["Digest"]


@dataclass
class Digest:
    """Statistics in the making of the samples of one law, over the blocks that were added.

    Attributes
    ----------
    found : int
        Samples that are there, failed ones included.
    stages : set of str
        Stages that resolve contact.
    rescued : list of int
        Numbers of the valid samples that plain increments had to rescue, since their path could not be followed.
    unbuilt : list of int
        Numbers of the valid samples in which a clamp or gun of limited force did not reach its position.
    unseen : tuple of (float, str, int, int)
        Deepest penetration between the pairs, mm, the stage at whose end, the sample, and the model's point between the
        pairs; of the first where several are as deep, point −1 where there is none.
    regression : Regression or None
        Of the key characteristics on the deviations; None where the moments of these are not known.
    moments : dict of tuple to Moments
        Of the valid samples: ``("measurements",)``, (k,) in the order of the scene; ``("profiles", name)``, one per
        point of a measurement over many; ``("slips", stage, column)``, one
        per zone with the columns of :data:`mic.results.schema.SLIPS`; ``("contacts", stage, column)``, (m,) with the
        columns of :meth:`BlockSamples.contact`; ``("pressed", stage, which)``, one per zone: the sum of the normal
        forces of ``"all"`` pairs, and of those ``"clear"`` of every weld by three nugget radii; ``("resolutions",
        stage, column)``, scalar: ``residual``, ``path_error``, ``steps`` and ``factorisations``; ``("limits", stage,
        name, column)``, scalar: ``pushed``, ``left`` and ``needed``.
    counts : dict of tuple to int array
        Of the valid samples: ``("outside",)``, (k,) beyond their limits; ``("any outside",)``, () with any beyond them;
        ``("states", stage)``, (3, m) by state;
        ``("short", stage, name)``, () clamps and guns short of their position.
    """

    found: int = 0
    stages: set[str] = field(default_factory=set)
    rescued: list[int] = field(default_factory=list)
    unbuilt: list[int] = field(default_factory=list)
    unseen: tuple[float, str, int, int] = (0.0, "", -1, -1)
    regression: Regression | None = None
    moments: dict[tuple[str, ...], Moments] = field(default_factory=dict)
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

    def add(self, block: BlockSamples, model, sums: Sums | None = None) -> None:
        """Take a block in; the blocks of a law come in ascending order.

        Parameters
        ----------
        block : BlockSamples
        model : mic.model.reduction.Reduction
        sums : Sums, optional
            Of all its valid samples; without them it has its contact pairs.
        """
        self.found += block.found
        self.stages |= set(block.stages)
        self._numbers.append(block.numbers)
        self._failed.append(block.failed)
        if len(block.failed) or not self._failures:
            self._failures.append(block.failures())
        items = model.scene.measurements
        if items:
            x = np.column_stack([block.column("measurements", "value", measurement=item.name) for item in items])
            self._join(("measurements",), x)
            self._regress(block, model, x)
            limits = np.array([(item.lower, item.upper) for item in items])
            self._count(("outside",), outside(x, *limits.T))
            self._count(("any outside",), np.array(((x < limits[:, 0]) | (x > limits[:, 1])).any(axis=1).sum()))
        for item in items:
            if item.points is not None:
                self._join(("profiles", item.name), block.profile(item.name))
        tangential = len(model.contacts) > 0 and model.contacts.dimension == 3
        rescued = np.zeros(len(block.numbers), dtype=bool)
        sums = sums or Sums.of(block, model)
        for key, moments in sums.moments:
            self._merge(key, moments)
        for key, count in sums.counts:
            self._count(key, count)
        for stage in block.stages:
            rescued |= block.column("resolutions", "rescued", stage=stage)
            depth = block.column("resolutions", "unseen", stage=stage)
            if depth.max(initial=0.0) > self.unseen[0]:
                i = int(depth.argmax())
                at = int(block.column("resolutions", "unseen_at", stage=stage)[i])
                self.unseen = float(depth[i]), stage, int(block.numbers[i]), at
            for column in ("residual", "path_error", "steps", "factorisations"):
                self._join(("resolutions", stage, column), block.column("resolutions", column, stage=stage))
            for column in SLIPS.names[3:] if tangential else ():
                zones = [block.column("slips", column, stage=stage, zone=zone.name) for zone in model.scene.zones]
                self._join(("slips", stage, column), np.column_stack(zones))
        self.unbuilt += [int(number) for number in block.unbuilt]
        limited = block.tables["limits"][["stage", "name"]].drop_duplicates()
        for stage, name in limited.itertuples(index=False):
            for column in ("pushed", "left", "needed"):
                self._join(("limits", stage, name, column), block.column("limits", column, stage=stage, name=name))
            reached = block.column("limits", "reached", stage=stage, name=name)
            self._count(("short", stage, name), np.array((~reached).sum()))
        self.rescued += [int(number) for number in block.numbers[rescued]]

    def _regress(self, block: BlockSamples, model, y: np.ndarray) -> None:
        if self.regression is None and self.found == block.found:  # the first block
            self.regression = Regression.of(model.scene)
        if self.regression is not None:
            x = [block.column("deviations", "value", deviation=name) for name in model.parameters]
            self.regression.add(block.numbers, np.column_stack(x), y)

    def _join(self, key: tuple[str, ...], x: np.ndarray) -> None:
        self._merge(key, Moments.of(x))

    def _merge(self, key: tuple[str, ...], moments: Moments) -> None:
        self.moments[key] = self.moments[key].merged(moments) if key in self.moments else moments

    def _count(self, key: tuple[str, ...], count: np.ndarray) -> None:
        self.counts[key] = self.counts[key] + count if key in self.counts else count
