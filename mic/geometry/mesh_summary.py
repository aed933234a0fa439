"""Summary of a mesh file: sources of thickness, offset and material, and repairs."""

from __future__ import annotations

from typing import Any

import numpy as np

from mic.geometry.deck import Deck
from mic.geometry.surface import Surface

__all__ = ["mesh_summary", "repair_summary"]

KEYS = {"thickness": ("t", " mm"), "offset": ("offset", " t"), "young": ("E", " MPa"), "poisson": ("ν", "")}


def mesh_summary(given: Any, part: Any, deck: Deck, surface: Surface) -> list[str]:
    """Sentences about a part with a mesh file, one per subject.

    Parameters
    ----------
    given, part : mic.scene.part.Part
        As stated in the scene, and completed from the file.
    deck : Deck
    surface : Surface
        Mid-surface of the sheet.
    """
    sheets = deck.distinct_sheets()
    values = []
    for key, (symbol, unit) in KEYS.items():
        by_deck = {getattr(sheet, key) for sheet in sheets} - {None}
        source = "scene" if getattr(given, key) is not None else part.mesh if by_deck else "default"
        other = sorted(by_deck - {getattr(part, key)})
        also = f"; {part.mesh} gives {', '.join(f'{value:g}' for value in other)}" if other else ""
        values.append(f"{symbol} = {getattr(part, key):g}{unit} ({source}{also})")
    sentences = [f"{part.name}: {', '.join(values)}"]
    if part.offset:
        normal = surface.areas @ surface.normals
        length = np.linalg.norm(normal)
        towards = ", ".join(f"{x:.2f}" for x in np.sign(part.offset) * normal / length) if length else ""
        side = f", mostly in the direction ({towards})" if length > 0.1 * surface.areas.sum() else ""
        sentences.append(f"{part.name}: moved {abs(part.offset * part.thickness):.3g} mm from the mesh{side}")
    return sentences + repair_summary(part, deck)


def repair_summary(part: Any, deck: Deck) -> list[str]:
    """A sentence on what was repaired, dropped or ignored in a part's mesh, in a list; empty if nothing was."""
    notes = deck.notes()
    return [f"{part.name}: {part.mesh}: {'; '.join(notes)}"] if notes else []
