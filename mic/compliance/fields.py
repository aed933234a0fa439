"""Displacement fields of a part; those of unit forces on its functionals are cached on disk.

A field is linear in the forces, so cached unit fields serve for all later forces: a later run only multiplies, and
needs no finite elements if it loads no other functionals. Only few functionals are loaded, because a sheet touches at
few of its contact candidates.
"""

from __future__ import annotations

from pathlib import Path

import numpy as np

from mic.compliance import provider
from mic.compliance.part import Part
from mic.system.disk_cache import ABSENT, Cache
from mic.system.files import Format

__all__ = ["displacement_field"]

FORMAT = Format("set of displacement fields of unit forces", 1, ABSENT)
LARGEST = 2**26  # bytes of a part's cached fields; beyond it only the field of the given forces is solved for
MOST = 32  # cached parts


def displacement_field(part: Part, forces: np.ndarray, cache: Path | None = None) -> tuple[np.ndarray, np.ndarray]:
    """Displacements at the v vertices of the part's surface, mm.

    Parameters
    ----------
    part : Part
    forces : (F, r) array
        r self-balanced sets of forces on the part's functionals, N and N mm.
    cache : Path, optional
        The cache folder; default: no cache.

    Returns
    -------
    solved : (v, 3, r) array
        On the support of the part's influence coefficients.
    rigid : (v, 3, 6) array
        Of each rigid-body mode, mode last.

    Raises
    ------
    MissingProvider
        If the fields must be computed and no provider is installed.
    """
    loaded, v = np.flatnonzero(forces.any(axis=1)), len(part.surface.points)
    if cache is None or 8 * 3 * v * len(loaded) > LARGEST:
        solved, rigid = provider.find(part).field(part, forces)
        return solved[:, :3], rigid[:, :3]
    known, unit, rigid = _unit_fields(part, loaded, cache)
    solved = unit[np.searchsorted(known, loaded)].T @ forces[loaded]
    return solved.reshape(v, 3, -1), rigid.reshape(v, 3, 6)


def _unit_fields(part: Part, loaded: np.ndarray, cache: Path) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Ascending functionals, at least the loaded ones; fields (3 v,) of a unit force on each; rigid modes (3 v, 6).

    The pins of the part's support balance each unit force.
    """
    disk_cache, identity, v = Cache(cache, "fields", FORMAT, MOST), part.fingerprint(), len(part.surface.points)
    known, unit, rigid = np.zeros(0, dtype=int), np.zeros((0, 3 * v)), None
    cached = disk_cache.load(identity)
    if cached is not None:
        known, unit, rigid = (cached[1][name] for name in ("functional", "unit", "rigid"))
    missing = np.setdiff1d(loaded, known)
    if rigid is None or len(missing):
        forces = np.zeros((len(part.functionals), len(missing)))
        forces[missing, np.arange(len(missing))] = 1.0
        solved, modes = provider.find(part).field(part, forces)
        if 8 * 3 * v * (len(known) + len(missing)) > LARGEST:  # drop fields of earlier runs
            keep = np.isin(known, loaded)
            known, unit = known[keep], unit[keep]
        order = np.argsort(np.concatenate([known, missing]))
        known = np.concatenate([known, missing])[order]
        unit = np.concatenate([unit, solved[:, :3].reshape(3 * v, -1).T])[order]
        rigid = np.ascontiguousarray(modes[:, :3].reshape(3 * v, 6))
        disk_cache.store(identity, {"part": part.name}, {"functional": known, "unit": unit, "rigid": rigid})
    return known, unit, rigid
