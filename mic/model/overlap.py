"""Nominal overlap: surfaces that are drawn into each other before anything moves.

Chords across bends, offsets of the drawing and rounded thicknesses leave gaps g⁰ < 0 that no sheet has. Solved as they
stand they press the nominal assembly apart, the more the finer the pairs; and pairs that close them fight welds that
keep them. So overlap is closed, g = max(g⁰, 0), at pairs and welds alike, up to a limit that drawing explains; beyond
it, something else is wrong, and the scene is refused. A zone may keep its overlap where it is meant, such as at a stop
that preloads.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from mic.errors import SceneError
from mic.scene.zone import Zone

__all__ = ["CLOSED", "closed", "frozen_gaps", "joined_by", "mean_gaps"]

#: Of the thinner sheet, overlap that is closed where a zone states no limit of its own: what one sheet explains whose
#: thickness has changed since it was drawn, or that was drawn on its skin.
CLOSED = 0.5
TOLD = 0.02  # mm: chords of curved sheets leave less, and a weld that freezes it is not worth a word


def closed(key: str, rule: str | float, gap: np.ndarray, thinner: float, point: np.ndarray) -> np.ndarray:
    """Gaps (m,) without the nominal overlap that a rule closes, mm.

    Parameters
    ----------
    key : str
        Where the pairs or the weld stand in the scene, for messages.
    rule : "close", "keep" or float
        A zone's ``nominal_overlap``; a number is the limit, mm.
    gap : (m,) array
        As drawn, mm.
    thinner : float
        Thickness of the thinner sheet, mm.
    point : (m, 3) array
        Where, mm.

    Raises
    ------
    SceneError
        If a gap overlaps by more than the limit.
    """
    gap = np.asarray(gap, dtype=float)
    if rule == "keep" or not len(gap):
        return gap
    limit = CLOSED * thinner if isinstance(rule, str) else float(rule)
    worst = int(np.argmin(gap))
    if -gap[worst] > limit * (1.0 + 1e-9):
        where = ", ".join(f"{x:.1f}" for x in point[worst])
        raise SceneError(
            f"{key}: the surfaces are drawn into each other by {-gap[worst]:.3g} mm at ({where}), and up to "
            f"{limit:.3g} mm of nominal overlap is closed; correct the thickness or the meshes (mid-surfaces stand "
            "half a thickness off the facing surfaces: a part that is drawn on its skin needs `offset`), or let "
            'nominal_overlap of the zone be a larger limit, or "keep" where the overlap is meant'
        )
    return np.maximum(gap, 0.0)


def joined_by(zones: Sequence, of_pair: np.ndarray, points: np.ndarray, weld) -> Zone | None:
    """The zone that a weld lies in: of those that join its parts, the one with the nearest pair.

    Parameters
    ----------
    zones : sequence of mic.scene.zone.Zone
    of_pair : (m,) int array
        Zone of each pair.
    points : (m, 3) array
        Of the pairs, mm.
    weld : mic.scene.weld.Weld
    """
    alike = [i for i, zone in enumerate(zones) if set(zone.parts) == set(weld.parts)]
    own = np.flatnonzero(np.isin(of_pair, alike))
    if not len(own):
        return None
    nearest = own[np.argmin(np.linalg.norm(points[own] - np.array(weld.point), axis=1))]
    return zones[of_pair[nearest]]


def mean_gaps(model) -> np.ndarray:
    """(w,) nominal gaps of the welds of an assembly or a reduction, over their nuggets, mm."""
    return model.weld_gap[np.cumsum([0, *model.weld_size[:-1]])] if model.weld_size else np.zeros(0)


def frozen_gaps(model) -> list[str]:
    """One sentence for each weld that freezes a nominal gap, or an overlap that is kept, in place of closing it.

    Parameters
    ----------
    model : mic.model.assembly.Assembly or mic.model.reduction.Reduction
    """
    return [
        f"weld {weld.name} lies over {'a nominal gap' if gap > 0 else 'an overlap'} of {abs(gap):.3f} mm and freezes "
        "what clamping leaves of it; close = true closes it first"
        for weld, gap in zip(model.scene.welds, mean_gaps(model))
        if abs(gap) > TOLD and not weld.close
    ]
