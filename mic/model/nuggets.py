"""Assigns points of contact zones to the nuggets of welds."""

from __future__ import annotations

import numpy as np

from mic.scene import Scene

__all__ = ["nuggets"]


def nuggets(scene: Scene, zone: np.ndarray, point: np.ndarray, normal: np.ndarray, radii: float = 1.0) -> np.ndarray:
    """The weld whose nugget contains each point, seen along the normal, with its radius scaled by `radii`.

    Parameters
    ----------
    scene : Scene
    zone : (m,) int array
        Zone of each point; only welds that join the zone's parts count.
    point, normal : (m, 3) array
        mm; unit vectors.
    radii : float

    Returns
    -------
    (m,) int array
        Number of the weld in the scene, the last of several; -1 for none.
    """
    weld_of_point = np.full(len(zone), -1)
    for i, weld in enumerate(scene.welds):
        same_parts = [z for z, one in enumerate(scene.zones) if set(one.parts) == set(weld.parts)]
        step = point - np.array(weld.point)
        along = np.einsum("ij,ij->i", step, normal)
        sideways = np.linalg.norm(step - along[:, None] * normal, axis=1)
        reach = max(part.sheet[0] for part in scene.parts if part.name in weld.parts) + weld.radius
        weld_of_point[np.isin(zone, same_parts) & (sideways <= radii * weld.radius) & (np.abs(along) <= reach)] = i
    return weld_of_point
