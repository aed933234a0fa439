"""Moments and counts of the contact pairs over the samples of one block.

They replace the contact pairs of single samples beyond the first samples of a run.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np

from mic.contact.states import STATES
from mic.model.nuggets import nuggets
from mic.results.block_samples import BlockSamples
from mic.statistics.estimates import Moments
from mic.system.matrix_product import one_thread

__all__ = ["ContactSums"]

CLEAR = 3.0  # nugget radii from a weld; nearer, the sum of the normal forces grows with the number of pairs
_COLUMNS = ("f_n", "u_n", "f_t", "u_t", "path_stick", "path_slip")  # the last four need tangential motion


@dataclass(frozen=True)
class ContactSums:
    """Moments and counts of a block's valid samples, keyed as in :class:`~mic.results.block_statistics.Accumulator`.

    Attributes
    ----------
    moments : tuple of (tuple of str, Moments)
        ``contacts`` and ``pressed``.
    counts : tuple of (tuple of str, int array)
        ``states``.
    """

    moments: tuple[tuple[tuple[str, ...], Moments], ...]
    counts: tuple[tuple[tuple[str, ...], np.ndarray], ...]

    @classmethod
    @one_thread  # bits independent of the number of threads
    def of(cls, block: BlockSamples, model) -> ContactSums:
        """Sums over a block that has its contact pairs.

        Parameters
        ----------
        block : BlockSamples
        model : mic.model.reduction.Reduction
        """
        moments, counts = [], []
        contacts = model.contacts
        zone_of = np.equal.outer(contacts.zone, np.arange(len(model.scene.zones))).astype(float)
        clear = nuggets(model.scene, contacts.zone, contacts.point, contacts.frame[:, :, 0], CLEAR) < 0
        for stage in block.stages:
            moments += [(key, Moments.of(values)) for key, values in _values(block, contacts, zone_of, clear, stage)]
            state = block.contact(stage, "state")
            count = np.stack([(state == code).sum(axis=0) for code in range(len(STATES))])
            counts.append((("states", stage), count))
        return cls(tuple(moments), tuple(counts))


def _values(
    block: BlockSamples, contacts, zone_of: np.ndarray, clear: np.ndarray, stage: str
) -> Iterator[tuple[tuple[str, ...], np.ndarray]]:
    """Keys and values of a stage: (n, m) by pair, and (n, z) sums by zone.

    Parameters
    ----------
    zone_of : (m, z) array
        1 for the zone of each pair.
    clear : (m,) bool array
        Pairs clear of all welds.
    """
    for column in _COLUMNS if len(contacts) and contacts.dimension == 3 else _COLUMNS[:2]:
        yield ("contacts", stage, column), block.contact(stage, column)
    force = block.contact(stage, "f_n")
    yield ("pressed", stage, "all"), force @ zone_of
    yield ("pressed", stage, "clear"), force[:, clear] @ zone_of[clear]
