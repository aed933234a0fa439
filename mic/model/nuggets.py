"""Which points of a contact zone lie at which weld."""

from __future__ import annotations

import numpy as np

from mic.scene import Scene

__all__ = ["nuggets"]


def nuggets(scene: Scene, zone: np.ndarray, point: np.ndarray, normal: np.ndarray, radii: float = 1.0) -> np.ndarray:
    """The weld at which each point lies: sideways, seen along the normal, within so many radii of its nugget.

    Parameters
    ----------
    scene : Scene
    zone : (m,) int array
        Zone of each point; a weld is looked for among those that join the zone's parts.
    point, normal : (m, 3) array
        mm; of length 1.
    radii : float

    Returns
    -------
    (m,) int array
        Its number in the scene, of the last where several are as near; -1 for none.
    """
    found = np.full(len(zone), -1)
    for i, weld in enumerate(scene.welds):
        alike = [z for z, one in enumerate(scene.zones) if set(one.parts) == set(weld.parts)]
        step = point - np.array(weld.point)
        along = np.einsum("ij,ij->i", step, normal)
        sideways = np.linalg.norm(step - along[:, None] * normal, axis=1)
        reach = max(part.sheet[0] for part in scene.parts if part.name in weld.parts) + weld.radius
        found[np.isin(zone, alike) & (sideways <= radii * weld.radius) & (np.abs(along) <= reach)] = i
    return found
