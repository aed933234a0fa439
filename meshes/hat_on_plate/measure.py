"""Write the point clouds of ``measured.toml``: twelve hats with known deviations and noise.

``python measure.py`` writes ``hat-01.csv`` … into the folder of this file.
"""

from __future__ import annotations

from pathlib import Path

import numpy as np

PIECES = 12
NOISE = 0.02  # mm, standard deviation of a measured point
MEAN = np.array([0.40, 0.15])  # mm, at the edges of the flanges
SIGMA = np.array([0.15, 0.08])  # mm
SEED = 11


def amplitudes() -> np.ndarray:
    """(12, 2) opening and flange curl of each hat, mm at the edges of the flanges."""
    return MEAN + SIGMA * np.random.default_rng(SEED).standard_normal((PIECES, 2))


def deviation(points: np.ndarray, opening: float, curl: float) -> np.ndarray:
    """(n,) deviations of points of the nominal hat along its normals, positive up and outwards, mm.

    The shape is that of springback: the top is arched, so that webs and flanges turn with its folds by φ, and the
    flanges are curled in addition. All faces bend about x, so that no fibre is stretched.
    """
    _, y, z = np.abs(points).T
    φ = opening / 25.0
    top = 0.5 * φ / 20.0 * (y**2 - 20.0**2)
    web = φ * np.hypot(y - 20.0, z - 31.0)
    flange = φ * (5.0 + y - 25.0) + curl * ((y - 25.0) / 20.0) ** 2
    return np.where(z > 30.5, top, np.where(z < 1.5, flange, web))


def nominal() -> np.ndarray:
    """(n, 3) measured points of the nominal hat."""
    section = [(y, 1.0 if abs(y) > 25 else 31.0) for y in (-43.0, -35.0, -28.0, -12.0, 0.0, 12.0, 28.0, 35.0, 43.0)]
    section += [(side * (25.0 - height / 6.0), 1.0 + height) for side in (-1.0, 1.0) for height in (8.0, 22.0)]
    return np.array([(x, *point) for x in np.linspace(4.0, 156.0, 12) for point in section])


def cloud(piece: int) -> str:
    """The CSV file of one hat."""
    points = nominal()
    off = deviation(points, *amplitudes()[piece])
    off += NOISE * np.random.default_rng([SEED, piece]).standard_normal(len(off))
    rows = (f"{x:.3f},{y:g},{z:g},{d:.4f}" for (x, y, z), d in zip(points, off))
    return "\n".join(["x,y,z,deviation", *rows]) + "\n"


if __name__ == "__main__":
    for piece in range(PIECES):
        (Path(__file__).parent / f"hat-{piece + 1:02}.csv").write_text(cloud(piece), encoding="utf-8")
