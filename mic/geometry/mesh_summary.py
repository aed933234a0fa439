"""What a mesh file was taken for, in words: where thickness, offset and material come from, what was mended."""

from __future__ import annotations

from typing import Any

import numpy as np

from mic.geometry.deck import Deck
from mic.geometry.surface import Surface

__all__ = ["mended", "told"]

KEYS = {"thickness": ("t", " mm"), "offset": ("offset", " t"), "young": ("E", " MPa"), "poisson": ("ν", "")}


def told(asked: Any, part: Any, deck: Deck, surface: Surface) -> list[str]:
    """One sentence a subject about a part with a mesh file.

    Parameters
    ----------
    asked, part : mic.scene.part.Part
        As the scene has it, and with what the file tells filled in.
    deck : Deck
    surface : Surface
        The middle of the sheet.
    """
    tells = deck.told()
    values = []
    for key, (symbol, unit) in KEYS.items():
        by_deck = {getattr(sheet, key) for sheet in tells} - {None}
        source = "scene" if getattr(asked, key) is not None else part.mesh if by_deck else "usual"
        other = sorted(by_deck - {getattr(part, key)})
        also = f"; {part.mesh} tells {', '.join(f'{value:g}' for value in other)}" if other else ""
        values.append(f"{symbol} = {getattr(part, key):g}{unit} ({source}{also})")
    sentences = [f"{part.name}: {', '.join(values)}"]
    if part.offset:
        normal = surface.areas @ surface.normals
        length = np.linalg.norm(normal)
        towards = ", ".join(f"{x:.2f}" for x in np.sign(part.offset) * normal / length) if length else ""
        side = f", on the whole towards ({towards})" if length > 0.1 * surface.areas.sum() else ""
        sentences.append(f"{part.name}: moved {abs(part.offset * part.thickness):.3g} mm off the mesh{side}")
    return sentences + mended(part, deck)


def mended(part: Any, deck: Deck) -> list[str]:
    """One sentence on what was mended in a part's mesh, dropped or passed over; none where nothing was."""
    notes = deck.notes()
    return [f"{part.name}: {part.mesh}: {'; '.join(notes)}"] if notes else []
