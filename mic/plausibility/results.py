"""Findings of the rules on what sources do to free parts, and on solved samples: results out of all proportion.

Each function has the name of its rule in ``rules.toml``, and finds what is outside the range that is usual.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping
from dataclasses import dataclass, field
from typing import Any

import numpy as np

from mic.model.one_sigma import Displacement
from mic.plausibility.finding import Finding, about

__all__ = ["Results"]

SHARE = 0.1  # of the extent of a part
THICKNESSES = 5.0  # of the sheet: at such deflections it stretches, unless it rolls up as a strip does
TENTH = 0.5  # mm: a tenth of a 6σ of 5 mm
LOAD = 5e4  # N at one support or contact pair


@dataclass(frozen=True)
class Results:
    """Results of a scene's samples.

    Attributes
    ----------
    scene : mic.scene.Scene
        With all items placed.
    extent : mapping of str to float
        Diagonal of each part, mm, by name.
    mean, six_sigma : (k,) array
        Of the key characteristics in the scene's order, mm.
    force : mapping of str to float
        Largest force of a support or a contact pair, N, by stage, as far as it is known.
    """

    scene: Any
    extent: Mapping[str, float]
    mean: np.ndarray
    six_sigma: np.ndarray
    force: Mapping[str, float] = field(default_factory=dict)


def moves_far(results: Results) -> Iterator[Finding]:
    """Key characteristics that are a large share of the size of their part, or many thicknesses, or not finite."""
    thickness = {part.name: part.thickness or np.inf for part in results.scene.parts}
    for item, mean, spread in zip(results.scene.measurements, results.mean, results.six_sigma):
        if item.part not in results.extent:
            continue  # its run stored no meshes
        size, sheet = results.extent[item.part], thickness.get(item.part, np.inf)
        values = {"its mean is": abs(float(mean)), "its 6σ is": abs(float(spread))}
        words, largest = max(values.items(), key=lambda one: np.nan_to_num(one[1], nan=0.0))
        if largest > min(SHARE * size, THICKNESSES * sheet):
            text = f"{words} {largest:.3g} mm, and part {item.part} measures {size:.3g} mm"
            if np.isfinite(sheet):
                text += f" and is {sheet:.3g} mm thick"
            yield *about("measurements", item, text), largest > size


def source_moves_far(found: Iterable[Displacement]) -> Iterator[Finding]:
    """Sources whose standard deviation alone moves a free part far."""
    for one in found:
        if one.length > TENTH:
            what = f"part {one.part}" if one.part else "its item"
            roughly = "about " if one.rule == "estimate" else ""
            where = None if one.point is None else tuple(one.point.tolist())
            yield f"deviation {one.name}", f"its 1 σ moves {what} by {roughly}{one.length:.2g} mm", where


def pressed_hard(results: Results) -> Iterator[Finding]:
    """Stages with very large forces."""
    for stage, force in results.force.items():
        if force > LOAD:
            yield f"stage {stage}", f"a support or a contact pair carries {force:.3g} N", None
