"""Inputs and outputs of the first samples of a run, for the estimates with surrogates."""

from __future__ import annotations

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
        """Those of a block.

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
        """These outputs only."""
        return replace(self, keys=keys, y=self.y[:, [self.keys.index(key) for key in keys]])

    def joined(self, other: OutputSamples, most: int | None = MOST) -> OutputSamples:
        """These samples and then others, the first `most` of them, with the outputs that both have."""
        keys = tuple(key for key in self.keys if key in other.keys)
        mine, its = self.of_keys(keys), other.of_keys(keys)
        pairs = ((mine.numbers, its.numbers), (mine.x, its.x), (mine.y, its.y))
        numbers, x, y = (np.concatenate(pair)[:most] for pair in pairs)
        return OutputSamples(keys, numbers, x, y)
