"""Moments and counts of the contact pairs over the samples of one block.

Beyond the first samples of a long run they replace the contact pairs of single samples.
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

__all__ = ["Sums"]

CLEAR = 3.0  # nugget radii from a weld: there the sum of the normal forces converges, nearer it grows with the pairs
_CONTACT = ("f_n", "u_n", "f_t", "u_t", "path_stick", "path_slip")  # the last four where tangential motion is modelled


@dataclass(frozen=True)
class Sums:
    """Of the valid samples of a block, with their keys as :class:`mic.results.block_statistics.Digest` has them.

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
    @one_thread  # the same bits on any number of them
    def of(cls, block: BlockSamples, model) -> Sums:
        """Sums over a block with its contact pairs.

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
            number = np.stack([(state == code).sum(axis=0) for code in range(len(STATES))])
            counts.append((("states", stage), number))
        return cls(tuple(moments), tuple(counts))


def _values(
    block: BlockSamples, contacts, zone_of: np.ndarray, clear: np.ndarray, stage: str
) -> Iterator[tuple[tuple[str, ...], np.ndarray]]:
    """What is added up of a stage: (n, m) by pair, and (n, z) by zone, of the pairs in it (m, z) all and those clear of
    welds (m,)."""
    for column in _CONTACT if len(contacts) and contacts.dimension == 3 else _CONTACT[:2]:
        yield ("contacts", stage, column), block.contact(stage, column)
    pressed = block.contact(stage, "f_n")
    yield ("pressed", stage, "all"), pressed @ zone_of
    yield ("pressed", stage, "clear"), pressed[:, clear] @ zone_of[clear]
