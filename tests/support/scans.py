"""Synthetic scans: points of a deformed surface with noise, outliers and holes, in a position of their own."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from mic.geometry.surface import Surface
from mic.geometry.triangles import rotation

__all__ = ["scanned", "write_ply"]


def scanned(surface, shape, points, seed, noise=0.05, outliers=0.05, holes=0.2, shift=5.0, turn=3.0):
    """(n, 3) points of a surface displaced by a shape (v, 3), and the motion (R, t) that brings them back."""
    rng = np.random.default_rng(seed)
    sheet = Surface(surface.points + shape, surface.triangles)
    centres, open_ = sheet.corners.mean(axis=1), np.zeros(len(sheet.triangles), dtype=bool)
    while sheet.areas[open_].sum() < holes * sheet.areas.sum():
        about = centres[rng.integers(len(centres))]
        open_ |= np.linalg.norm(centres - about, axis=1) < 0.06 * sheet.diameter
    area = sheet.areas * ~open_
    triangle = rng.choice(len(area), points, p=area / area.sum())
    x = sheet.at(triangle, rng.dirichlet(np.ones(3), points)) + rng.normal(0, noise, (points, 3))
    wild = rng.choice(points, int(outliers * points), replace=False)
    x[wild] = rng.uniform(x.min(axis=0) - 10, x.max(axis=0) + 10, (len(wild), 3))
    R, t, c = rotation(rng.normal(size=3), np.radians(turn)), rng.normal(size=3), surface.centroid
    t *= shift / np.linalg.norm(t)
    return (x - c) @ R.T + c + t, (R.T, c - R.T @ (c + t))


def write_ply(path: Path, points: np.ndarray) -> Path:
    """Write points (n, 3) as a binary PLY file."""
    head = f"ply\nformat binary_little_endian 1.0\nelement vertex {len(points)}\n"
    head += "".join(f"property float {axis}\n" for axis in "xyz") + "end_header\n"
    path.write_bytes(head.encode() + points.astype("<f4").tobytes())
    return path
