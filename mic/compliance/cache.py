"""Influence coefficients kept from run to run, each file named by the hash of everything that it depends on."""

from __future__ import annotations

from pathlib import Path
from typing import Any

from mic.compliance import provider
from mic.compliance.coefficients import InfluenceCoefficients
from mic.compliance.part import Part
from mic.errors import FormatError

__all__ = ["influence_coefficients", "is_cached"]


def influence_coefficients(
    assembly, cache: Path, progress=None, comm: Any = None
) -> tuple[dict[str, InfluenceCoefficients], dict[str, bool]]:
    """Influence coefficients of all parts, from the cache where they fit, else from the part's provider.

    Parameters
    ----------
    assembly : mic.model.assembly.Assembly
    cache : Path
        Folder of cached coefficients. A file there that cannot be read counts as absent.
    progress : callable, optional
        Called with one line of text before each part that is computed.
    comm : mpi4py.MPI.Comm, optional
        Processes that call together and share the parts out; default: all.

    Returns
    -------
    coefficients : dict
        By part name.
    cached : dict
        By part name: whether the cache had them.

    Raises
    ------
    MissingProvider
        If they must be computed and nothing that can is installed.
    """
    found = {part.name: _cached(part, cache) for part in assembly.parts}
    missing = [part for part in assembly.parts if found[part.name] is None]
    for part in missing:
        if progress:
            progress(
                f"influence coefficients of {part.name}: {len(part.functionals)} functionals, "
                f"{len(part.surface.points)} nodes"
            )
    providers = {part.name: provider.find(part) for part in missing}
    for one in dict.fromkeys(providers.values()):
        own = [part for part in missing if providers[part.name] is one]
        for name, coefficients in one.coefficients(own, comm).items():
            found[name] = coefficients
            # Every process holds the whole result; each may write it, for a file is replaced as a whole.
            coefficients.save(_file(next(part for part in own if part.name == name), cache))
    return {name: value for name, value in found.items()}, {
        part.name: part.name not in providers for part in assembly.parts
    }


def is_cached(part: Part, cache: Path) -> bool:
    """Whether the cache folder holds the part's influence coefficients."""
    return _file(part, cache).is_file()


def _cached(part, cache):
    try:
        return InfluenceCoefficients.load(_file(part, cache))
    except (FileNotFoundError, FormatError):
        return None


def _file(part, cache):
    return Path(cache) / "influence" / f"{part.fingerprint()}.npz"
