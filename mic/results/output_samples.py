"""Inputs and outputs of the first samples of a run, for the estimates with surrogates."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass, replace

import numpy as np

from mic.results.block_samples import BlockSamples

__all__ = ["MOST", "MOTIONS", "Key", "OutputSamples"]

MOST = 2000  # samples that are kept; of more, the estimates of the samples alone are narrow
MOTIONS = ("rms_tangential", "rms_slip")  # of zones

Key = tuple[str, ...]


@dataclass(frozen=True)
class OutputSamples:
    """Deviations and outputs of valid samples.

    Attributes
    ----------
    keys : tuple of tuple
        The outputs: ``("measurement", name)``, and ``("slip", stage, zone, motion)`` with friction.
    numbers : (n,) int array
        Numbers of the samples.
    x, y : (n, p), (n, k) array
        Deviations, and outputs, mm.
    """

    keys: tuple[Key, ...]
    numbers: np.ndarray
    x: np.ndarray
    y: np.ndarray

    @classmethod
    def of(cls, block: BlockSamples, model) -> OutputSamples:
        """The outputs of a block.

        Parameters
        ----------
        block : BlockSamples
        model : mic.model.reduction.Reduction
        """
        columns: dict[Key, np.ndarray] = {
            ("measurement", item.name): block.column("measurements", "value", measurement=item.name)
            for item in model.scene.measurements
        }
        moving = len(model.contacts) > 0 and model.contacts.dimension == 3
        for stage in block.stages if moving else ():
            for zone in model.scene.zones:
                for motion in MOTIONS:
                    values = block.column("slips", motion, stage=stage, zone=zone.name)
                    if not np.isnan(values).all():
                        columns["slip", stage, zone.name, motion] = values
        none = np.zeros((len(block.numbers), 0))
        x = [block.column("deviations", "value", deviation=name) for name in model.parameters]
        inputs, outputs = (np.column_stack([none, *part]) for part in (x, columns.values()))
        return cls(tuple(columns), block.numbers, inputs, outputs)

    def of_keys(self, keys: tuple[Key, ...]) -> OutputSamples:
        """The same samples with these outputs only."""
        return replace(self, keys=keys, y=self.y[:, [self.keys.index(key) for key in keys]])

    @classmethod
    def union(cls, parts: Iterable[OutputSamples]) -> OutputSamples | None:
        """All samples of several sets in ascending order, with the outputs that all have; None without sets."""
        parts = list(parts)
        if not parts:
            return None
        keys = tuple(key for key in parts[0].keys if all(key in part.keys for part in parts))
        parts = [part.of_keys(keys) for part in parts]
        numbers, first = np.unique(np.concatenate([part.numbers for part in parts]), return_index=True)
        x, y = (np.concatenate([getattr(part, name) for part in parts])[first] for name in ("x", "y"))
        return cls(keys, numbers, x, y)

    def first(self, count: int) -> OutputSamples:
        """The first samples."""
        return replace(self, numbers=self.numbers[:count], x=self.x[:count], y=self.y[:count])
