"""Rigid motions of a part: how its functionals read them, and how far a misplaced support moves it."""

from __future__ import annotations

import numpy as np

from mic.compliance.part import Part

__all__ = ["amplification", "rigid_readings"]


def rigid_readings(part: Part) -> np.ndarray:
    """(n, 6) readings of a part's functionals under its rigid motions, about the surface's centroid.

    u = a + ω × (x − c), θ = ω; a functional off the mid-surface by s reads u + θ × s n.
    """
    f, surface = part.functionals, part.surface
    G = np.zeros((len(f), 6))
    for i in range(len(f)):
        patch, d = f.patches[f.patch[i]], f.direction[i]
        if f.rotation[i]:
            G[i, 3:] = d
            continue
        offset = f.side[i] * part.thickness / 2 * surface.normals[patch.triangle]
        arm = patch.weight @ (surface.at(patch.triangle, patch.barycentric) + offset) - surface.centroid
        G[i, :3], G[i, 3:] = d, np.cross(arm, d)
    return G


def amplification(G: np.ndarray, arms: np.ndarray) -> np.ndarray:
    """(v, k, 3) displacement of points of a rigid part per mm that one of its k supports is misplaced.

    With more than six supports it is the best fit to all of them.

    Parameters
    ----------
    G : (k, 6) array
        Readings of the supports under translations and rotations about a centre.
    arms : (v, 3) array
        Points less the centre, mm.
    """
    scale = np.array([1.0] * 3 + [max(1e-9, float(np.linalg.norm(arms, axis=1).max()))] * 3)
    motion = np.linalg.pinv(G / scale, rcond=1e-9) / scale[:, None]
    return motion[:3].T + np.cross(motion[3:].T, arms[:, None])
