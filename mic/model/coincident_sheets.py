"""Refusing sheets that are drawn onto each other, with the offsets that set them side by side."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from mic.errors import SceneError
from mic.geometry.coincident_sheets import offsets, untold
from mic.geometry.pairing import ContactPair, Side

__all__ = ["refuse_untold"]


def refuse_untold(key: str, names: Sequence[str], pairs: list[ContactPair], first: Side, second: Side) -> None:
    """Refuse a zone whose normals only rounding would decide.

    Parameters
    ----------
    key : str
        Where the zone stands in the scene, for messages.
    names : (2,) sequence of str
        Of the bodies.
    pairs : list of ContactPair
    first, second : Side

    Raises
    ------
    SceneError
        With the offsets that would set the sheets side by side.
    """
    near = untold(pairs, first, second)
    if not near:
        return
    pair = min(near, key=lambda pair: pair.gap)
    apart = pair.gap + first.half_thickness + second.half_thickness
    where = ", ".join(f"{x:.1f}" for x in pair.point)
    share, told = offsets(pair, first, second)
    bodies, signs = zip(names, (first, second)), {name: f"{value:+g}" for name, value in zip(names, share)}
    wanted = [f"offset = {signs[name]} for {name}" for name, body in bodies if not body.rigid]
    remedy = f"give {' and '.join(wanted)}" if told else f"give {' and '.join(wanted)}, or both with the other sign"
    why = ", as the rest of the sheets lies" if told else ""
    normals = first.surface.normals[pair.patches[0].triangle]
    upwards = ", ".join(f"{x:.2f}" for x in np.average(normals, axis=0, weights=pair.patches[0].weight))
    raise SceneError(
        f"{key}: {names[0]} and {names[1]} are drawn onto each other ({abs(apart):.3g} mm apart at ({where})), so that "
        f"nothing tells which of them lies on which side; draw their mid-surfaces, or {remedy}{why}: offset "
        f"moves a part by so many thicknesses along its normals, which are ({upwards}) for {names[0]} there"
    )
