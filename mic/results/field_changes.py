"""Changes of the displacement fields between two runs, by part, at the vertices of the first run's meshes."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from scipy.spatial import cKDTree

from mic.geometry.readers.vtu import write_vtu
from mic.geometry.surface import Surface
from mic.results.fields import read_fields
from mic.results.outcome import Outcome

__all__ = ["FieldChange", "field_changes", "write_field_changes"]

FAR = 1.0  # times the longest edge of the second mesh: largest distance of corresponding vertices


@dataclass(frozen=True)
class FieldChange:
    """Changes at the v vertices of one part.

    Attributes
    ----------
    part : str
    surface : Surface
        Mesh of the first run.
    mean : (v, 3) array
        Change of the mean displacement, mm; NaN at vertices without a counterpart in the second run.
    mean_normal : (v,) array
        Its component along the vertex normal.
    six_sigma : (v,) array
        Change of the magnitude of 6σ, mm.
    same_mesh : bool
        Whether both runs have the same vertices; otherwise each vertex is compared with the nearest one.
    """

    part: str
    surface: Surface
    mean: np.ndarray
    mean_normal: np.ndarray
    six_sigma: np.ndarray
    same_mesh: bool


def field_changes(a: Outcome, law_a: str, b: Outcome, law_b: str) -> list[FieldChange]:
    """Changes from run `a` to run `b` of the parts that both have by name; empty if either has no fields.

    Parameters
    ----------
    a, b : Outcome
    law_a, law_b : str
    """
    fields, surfaces = [], []
    for outcome, law in ((a, law_a), (b, law_b)):
        fields.append({field.part: field for field in read_fields(outcome.folder)[0] if field.law == law})
        surfaces.append({part.name: part.surface for part in outcome.parts})
    changes = []
    for name, before in fields[0].items():
        after = fields[1].get(name)
        if after is None or name not in surfaces[0] or name not in surfaces[1]:
            continue
        surface, other = surfaces[0][name], surfaces[1][name]
        vertex, same = _counterparts(surface, other)
        matched = vertex >= 0
        mean = np.where(matched[:, None], after.mean[vertex] - before.mean, np.nan)
        spread = np.where(matched, after.six_sigma_magnitude[vertex] - before.six_sigma_magnitude, np.nan)
        normal = np.einsum("vi,vi->v", mean, surface.vertex_normals)
        changes.append(FieldChange(name, surface, mean, normal, spread, same))
    return changes


def _counterparts(surface: Surface, other: Surface) -> tuple[np.ndarray, bool]:
    """(v,) nearest vertex of the other surface, -1 if none is near; and whether the meshes are the same."""
    if surface.points.shape == other.points.shape and np.array_equal(surface.points, other.points):
        return np.arange(len(surface.points)), True
    corners = other.points[other.triangles]
    longest = np.linalg.norm(corners - np.roll(corners, 1, axis=1), axis=2).max()
    distance, nearest = cKDTree(other.points).query(surface.points)
    return np.where(distance <= FAR * longest, nearest, -1), False


def write_field_changes(folder: Path, changes: Sequence[FieldChange]) -> list[Path]:
    """Write ``difference_PART.vtu`` of each part, for ParaView; returns their paths."""
    paths = []
    for change in changes:
        path = folder / f"difference_{change.part}.vtu"
        data = {
            "mean_change": change.mean,
            "mean_normal_change": change.mean_normal,
            "six_sigma_change": change.six_sigma,
        }
        write_vtu(path, change.surface.points, change.surface.triangles, data)
        paths.append(path)
    return paths
