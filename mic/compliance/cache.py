"""Influence coefficients kept from run to run, each file named by the hash of everything that it depends on."""

from __future__ import annotations

from pathlib import Path
from typing import Any

from mic.cache import ABSENT, Cache
from mic.compliance import provider
from mic.compliance.coefficients import InfluenceCoefficients
from mic.compliance.part import Part
from mic.store import Format

__all__ = ["influence_coefficients", "is_cached"]

KEPT = Format("set of influence coefficients", 2, ABSENT)


def influence_coefficients(
    assembly, cache: Path, progress=None, comm: Any = None
) -> tuple[dict[str, InfluenceCoefficients], dict[str, bool]]:
    """Influence coefficients of all parts, from the cache where they fit, else from the part's provider.

    Parameters
    ----------
    assembly : mic.model.assembly.Assembly
    cache : Path
        Folder of cached coefficients, see :mod:`mic.cache`.
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
    kept = {part.name: _kept(part, cache) if first else None for part in assembly.parts}
    cached = {name: coefficients is not None for name, coefficients in kept.items()}
    if comm is not None:
        cached = comm.bcast(cached)
    found = {name: coefficients for name, coefficients in kept.items() if coefficients is not None}
    missing = [part for part in assembly.parts if not cached[part.name]]
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
    return {part.name: found[part.name] for part in assembly.parts if part.name in found}, cached


def is_cached(part: Part, cache: Path) -> bool:
    """Whether the cache folder holds the part's influence coefficients, fit to be used."""
    return _kept(part, cache) is not None


def _kept(part, cache):
    kept = Cache(cache, "influence", KEPT).find(part.fingerprint())
    if kept is None:
        return None
    header, arrays = kept
    return InfluenceCoefficients(part.name, arrays["H"], arrays["G"], header["provenance"])


def _keep(part, coefficients, cache):
    header = {"part": part.name, "provenance": coefficients.provenance}
    Cache(cache, "influence", KEPT).keep(part.fingerprint(), header, {"H": coefficients.H, "G": coefficients.G})
