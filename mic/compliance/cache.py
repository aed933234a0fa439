"""Influence coefficients kept from run to run, each file named by the hash of everything that it depends on."""

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

KEPT = Format("set of influence coefficients", 2, ABSENT)
SAME = 1e-9  # of a thickness: one that differs by less is the part's own


def influence_coefficients(
    assembly, cache: Path, progress=None, comm: Any = None
) -> tuple[dict[str, InfluenceCoefficients], dict[str, bool]]:
    """Influence coefficients of all parts, from the cache where they fit, else from the part's provider.

    Of a part whose thickness varies they are computed at several thicknesses, each as a part of its own.

    Parameters
    ----------
    assembly : mic.model.assembly.Assembly
    cache : Path
        Folder of cached coefficients, see :mod:`mic.system.disk_cache`.
    progress : callable, optional
        Called with one line of text before each part that is computed.
    comm : mpi4py.MPI.Comm, optional
        Processes that call together and share the parts out; default: this one alone. The first alone looks into the
        cache and writes to it, so that all agree on what is missing.

    Returns
    -------
    coefficients : dict
        By part name, on the first process; on the others those that were computed, not those that the cache had.
    cached : dict
        By part name: whether the cache had them.

    Raises
    ------
    MissingProvider
        If they must be computed and nothing that can is installed.
    """
    first = comm is None or comm.rank == 0
    families = {part.name: [part, *_varied(part)] for part in assembly.parts}
    every = list({one.name: one for family in families.values() for one in family}.values())
    kept = {part.name: _kept(part, cache) if first else None for part in every}
    cached = {name: coefficients is not None for name, coefficients in kept.items()}
    if comm is not None:
        cached = comm.bcast(cached)
    found = {name: coefficients for name, coefficients in kept.items() if coefficients is not None}
    missing = [part for part in every if not cached[part.name]]
    for part in missing:
        if progress:
            progress(
                f"influence coefficients of {part.name}: {len(part.functionals)} functionals, "
                f"{len(part.surface.points)} nodes"
            )
    providers = {part.name: provider.find(part) for part in missing}
    for one in dict.fromkeys(providers.values()):
        own = [part for part in missing if providers[part.name] is one]
        computed = one.coefficients(own, comm)
        for part in own:
            found[part.name] = computed[part.name]
            if first:
                _keep(part, computed[part.name], cache)
    whole = {
        part.name: _whole(part, found)
        for part in assembly.parts
        if all(one.name in found for one in families[part.name])
    }
    return whole, {name: all(cached[one.name] for one in family) for name, family in families.items()}


def is_cached(part: Part, cache: Path) -> bool:
    """Whether the cache folder holds the part's influence coefficients, fit to be used, at all thicknesses."""
    return all(_kept(one, cache) is not None for one in [part, *_varied(part)])


def _varied(part: Part) -> list[Part]:
    """The part at the thicknesses at which its coefficients are wanted; none where its thickness does not vary."""
    if part.range is None:
        return []
    apart = SAME * part.thickness
    return [part if abs(t - part.thickness) <= apart else part.at(t) for t in chebyshev(*part.range)]


def _whole(part: Part, found: dict[str, InfluenceCoefficients]) -> InfluenceCoefficients:
    """A part's coefficients with those at other thicknesses, all found by name."""
    own, varied = found[part.name], _varied(part)
    if part.range is None:
        return own
    H, G = (np.array([getattr(found[one.name], name) for one in varied]) for name in ("H", "G"))
    t = np.array([one.thickness for one in varied])
    return replace(own, thicknesses=Thicknesses(t, *part.range, H, G))


def _kept(part, cache):
    kept = Cache(cache, "influence", KEPT).find(part.fingerprint())
    if kept is None:
        return None
    header, arrays = kept
    return InfluenceCoefficients(part.name, arrays["H"], arrays["G"], header["provenance"])


def _keep(part, coefficients, cache):
    header = {"part": part.name, "provenance": coefficients.provenance}
    Cache(cache, "influence", KEPT).keep(part.fingerprint(), header, {"H": coefficients.H, "G": coefficients.G})
