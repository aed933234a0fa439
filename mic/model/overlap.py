"""Nominal overlap: surfaces that are drawn into each other before anything moves.

Chords across bends, offsets of the drawing and rounded thicknesses leave gaps g⁰ < 0 that no real sheets have. They
would separate the sheets of the nominal assembly, more so with finer pairs, and pairs that close them would work
against welds that keep them. So overlap is closed, g = max(g⁰, 0), at pairs and welds alike, up to a limit that drawing
explains. A scene with more overlap is refused. A zone may keep intended overlap, for example at a stop that preloads.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from mic.errors import SceneError
from mic.scene.zone import Zone

__all__ = ["CLOSED", "close_overlap", "frozen_gaps", "mean_gaps", "zone_of_weld"]

#: Default limit of closed overlap, relative to the thinner sheet: enough for one sheet whose thickness has changed
#: since it was drawn, or that was drawn on its skin.
CLOSED = 0.5
REPORTED = 0.02  # mm: smallest frozen gap that is reported; chords of curved sheets leave less


def close_overlap(scene, key: str, joint, rule: str | float, gap: np.ndarray, point: np.ndarray) -> np.ndarray:
    """Gaps (m,) with nominal overlap closed, mm.

    Parameters
    ----------
    scene : mic.scene.Scene
    key : str
        Scene key of the pairs or the weld, for messages.
    joint : mic.scene.zone.Zone or mic.scene.weld.Weld
        Whose sheets overlap.
    rule : "close", "keep" or float
        A zone's ``nominal_overlap``; a number is the limit, mm.
    gap : (m,) array
        As drawn, mm.
    point : (m, 3) array
        mm.

    Raises
    ------
    SceneError
        If a gap overlaps by more than the limit.
    """
    gap = np.asarray(gap, dtype=float)
    if rule == "keep" or not len(gap):
        return gap
    thinner = min(part.thickness for part in scene.parts if part.name in joint.parts)
    limit = CLOSED * thinner if isinstance(rule, str) else float(rule)
    worst = int(np.argmin(gap))
    if -gap[worst] > limit * (1.0 + 1e-9):
        where = ", ".join(f"{x:.1f}" for x in point[worst])
        raise SceneError(
            f"{key}: the surfaces are drawn into each other by {-gap[worst]:.3g} mm at ({where}), and at most "
            f"{limit:.3g} mm of nominal overlap is closed; correct the thickness or the meshes (mid-surfaces lie "
            "half a thickness off the facing surfaces: a part that is drawn on its skin needs `offset`), or set "
            'nominal_overlap of the zone to a larger limit, or to "keep" if the overlap is intended'
        )
    return np.maximum(gap, 0.0)


def zone_of_weld(zones: Sequence, zone_of_pair: np.ndarray, points: np.ndarray, weld) -> Zone | None:
    """The zone that contains a weld: among the zones of its two parts, the one with the nearest pair.

    Parameters
    ----------
    zones : sequence of mic.scene.zone.Zone
    zone_of_pair : (m,) int array
    points : (m, 3) array
        Points of the pairs, mm.
    weld : mic.scene.weld.Weld
    """
    candidates = [i for i, zone in enumerate(zones) if set(zone.parts) == set(weld.parts)]
    pairs = np.flatnonzero(np.isin(zone_of_pair, candidates))
    if not len(pairs):
        return None
    nearest = pairs[np.argmin(np.linalg.norm(points[pairs] - np.array(weld.point), axis=1))]
    return zones[zone_of_pair[nearest]]


def mean_gaps(model) -> np.ndarray:
    """(w,) mean nominal gaps of the welds of an assembly or a reduction, mm."""
    return model.weld_gap[model.joints.first]


def frozen_gaps(model) -> list[str]:
    """One sentence for each weld that freezes a nominal gap or kept overlap instead of closing it.

    Parameters
    ----------
    model : mic.model.assembly_types.Assembly or mic.model.reduction.Reduction
    """
    return [
        f"weld {weld.name} lies over {'a nominal gap' if gap > 0 else 'an overlap'} of {abs(gap):.3f} mm and freezes "
        "the gap that remains after clamping; close = true closes it first"
        for weld, gap in zip(model.scene.welds, mean_gaps(model))
        if abs(gap) > REPORTED and not weld.close
    ]
