"""Displacement fields of a part: those of unit forces on its functionals are kept from run to run.

A field is linear in the forces, so that what was solved for once serves whatever they are: a later run multiplies, and
needs no finite elements at all where no other functional is loaded. Few are: of its candidates for contact a sheet
touches some.
"""

from __future__ import annotations

from pathlib import Path

import numpy as np

from mic.compliance import provider
from mic.compliance.part import Part
from mic.system.disk_cache import ABSENT, Cache
from mic.system.files import Format

__all__ = ["displacement_field"]

KEPT = Format("set of displacement fields of unit forces", 1, ABSENT)
LARGEST = 2**26  # bytes of a part's fields that are kept; of more, those of the forces alone are solved for
MOST = 32  # parts that are kept


def displacement_field(part: Part, forces: np.ndarray, cache: Path | None = None) -> tuple[np.ndarray, np.ndarray]:
    """Displacements at the v vertices of the part's surface, mm.

    Parameters
    ----------
    part : Part
    forces : (F, r) array
        r self-balanced sets of forces on the part's functionals, N and N mm.
    cache : Path, optional
        The cache folder; default: nothing is kept.

    Returns
    -------
    solved : (v, 3, r) array
        On the support that the part's coefficients were computed on.
    rigid : (v, 3, 6) array
        Of each rigid-body mode, mode last.

    Raises
    ------
    MissingProvider
        If they must be computed, and nothing that can is installed.
    """
    loaded, v = np.flatnonzero(forces.any(axis=1)), len(part.surface.points)
    if cache is None or 8 * 3 * v * len(loaded) > LARGEST:
        solved, rigid = provider.find(part).field(part, forces)
        return solved[:, :3], rigid[:, :3]
    known, unit, rigid = _unit_fields(part, loaded, cache)
    solved = unit[np.searchsorted(known, loaded)].T @ forces[loaded]
    return solved.reshape(v, 3, -1), rigid.reshape(v, 3, 6)


def _unit_fields(part: Part, loaded: np.ndarray, cache: Path) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Functionals, ascending, all that are asked for among them; the field (3 v,) of a unit force on each, of which
    the pins carry what it lacks for balance; the rigid modes (3 v, 6)."""
    room, whose, v = Cache(cache, "fields", KEPT, MOST), part.fingerprint(), len(part.surface.points)
    known, unit, rigid = np.zeros(0, dtype=int), np.zeros((0, 3 * v)), None
    found = room.find(whose)
    if found is not None:
        known, unit, rigid = (found[1][name] for name in ("functional", "unit", "rigid"))
    missing = np.setdiff1d(loaded, known)
    if rigid is None or len(missing):
        forces = np.zeros((len(part.functionals), len(missing)))
        forces[missing, np.arange(len(missing))] = 1.0
        solved, modes = provider.find(part).field(part, forces)
        if 8 * 3 * v * (len(known) + len(missing)) > LARGEST:  # the former ones of other runs go
            keep = np.isin(known, loaded)
            known, unit = known[keep], unit[keep]
        order = np.argsort(np.concatenate([known, missing]))
        known = np.concatenate([known, missing])[order]
        unit = np.concatenate([unit, solved[:, :3].reshape(3 * v, -1).T])[order]
        rigid = np.ascontiguousarray(modes[:, :3].reshape(3 * v, 6))
        room.keep(whose, {"part": part.name}, {"functional": known, "unit": unit, "rigid": rigid})
    return known, unit, rigid
