"""Disk cache of influence coefficients: each file is named by the hash of everything that it depends on."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

from mic.compliance import provider
from mic.compliance.coefficients import InfluenceCoefficients
from mic.compliance.part import Part
from mic.compliance.thickness import Thicknesses, chebyshev
from mic.system.disk_cache import ABSENT, Cache
from mic.system.files import Format

__all__ = ["influence_coefficients", "is_cached"]

FORMAT = Format("set of influence coefficients", 2, ABSENT)
SAME = 1e-9  # relative difference of thicknesses that count as equal


def influence_coefficients(
    assembly, cache: Path, progress=None, comm: Any = None
) -> tuple[dict[str, InfluenceCoefficients], dict[str, bool]]:
    """Influence coefficients of all parts, from the cache or else from the part's provider.

    For a part whose thickness varies they are computed at several thicknesses, each as a separate part.

    Parameters
    ----------
    assembly : mic.model.assembly_types.Assembly
    cache : Path
        Cache folder, see :mod:`mic.system.disk_cache`.
    progress : callable, optional
        Called with one line of text before each part that is computed.
    comm : mpi4py.MPI.Comm, optional
        Processes that call together and share the parts; default: this one alone. Only the first reads and writes the
        cache, so that all agree on the missing parts.

    Returns
    -------
    coefficients : dict
        By part name, on the first process; on the others the computed ones only.
    cached : dict
        By part name: whether the cache had them.

    Raises
    ------
    MissingProvider
        If they must be computed and no provider is installed.
    """
    first = comm is None or comm.rank == 0
    variants = {part.name: [part, *_at_thicknesses(part)] for part in assembly.parts}
    every = list({one.name: one for parts in variants.values() for one in parts}.values())
    stored = {part.name: _read(part, cache) if first else None for part in every}
    cached = {name: coefficients is not None for name, coefficients in stored.items()}
    if comm is not None:
        cached = comm.bcast(cached)
    available = {name: coefficients for name, coefficients in stored.items() if coefficients is not None}
    missing = [part for part in every if not cached[part.name]]
    for part in missing:
        if progress:
            progress(
                f"influence coefficients of {part.name}: {len(part.functionals)} functionals, "
                f"{len(part.surface.points)} nodes"
            )
    providers = {part.name: provider.find(part) for part in missing}
    for one in dict.fromkeys(providers.values()):
        parts_of_provider = [part for part in missing if providers[part.name] is one]
        computed = one.coefficients(parts_of_provider, comm)
        for part in parts_of_provider:
            available[part.name] = computed[part.name]
            if first:
                _write(part, computed[part.name], cache)
    whole = {
        part.name: _combined(part, available)
        for part in assembly.parts
        if all(one.name in available for one in variants[part.name])
    }
    return whole, {name: all(cached[one.name] for one in parts) for name, parts in variants.items()}


def is_cached(part: Part, cache: Path) -> bool:
    """Whether the cache holds valid influence coefficients of a part, at all its thicknesses."""
    return all(_read(one, cache) is not None for one in [part, *_at_thicknesses(part)])


def _at_thicknesses(part: Part) -> list[Part]:
    """The part at the thicknesses of its coefficients; an empty list if its thickness does not vary."""
    if part.thickness_range is None:
        return []
    tolerance = SAME * part.thickness
    return [part if abs(t - part.thickness) <= tolerance else part.at(t) for t in chebyshev(*part.thickness_range)]


def _combined(part: Part, available: dict[str, InfluenceCoefficients]) -> InfluenceCoefficients:
    """A part's coefficients with those at its other thicknesses."""
    nominal, variants = available[part.name], _at_thicknesses(part)
    if part.thickness_range is None:
        return nominal
    H, G = (np.array([getattr(available[one.name], name) for one in variants]) for name in ("H", "G"))
    t = np.array([one.thickness for one in variants])
    return replace(nominal, thicknesses=Thicknesses(t, *part.thickness_range, H, G))


def _read(part: Part, cache: Path) -> InfluenceCoefficients | None:
    stored = Cache(cache, "influence", FORMAT).load(part.fingerprint())
    if stored is None:
        return None
    header, arrays = stored
    return InfluenceCoefficients(part.name, arrays["H"], arrays["G"], header["provenance"])


def _write(part: Part, coefficients: InfluenceCoefficients, cache: Path) -> None:
    header = {"part": part.name, "provenance": coefficients.provenance}
    Cache(cache, "influence", FORMAT).store(part.fingerprint(), header, {"H": coefficients.H, "G": coefficients.G})
