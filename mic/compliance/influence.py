"""Influence coefficients of a part, the only thing that the production path needs from the finite elements."""

from __future__ import annotations

import json
import os
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np

from mic.errors import MissingProvider

__all__ = ["InfluenceCoefficients", "influence_coefficients", "is_cached"]


@dataclass(frozen=True)
class InfluenceCoefficients:
    """Compliance of one free part at its retained functionals.

    The readings of the functionals under forces ``f`` on them are ``y = H f + G q`` with ``Gᵀ f = 0``: `H` was
    computed on some statically determinate support, whose reactions vanish because the forces, fixture reactions
    included, balance; ``q`` is the rigid-body motion. ``H = L K⁻¹ Lᵀ`` is equation (2) of the paper.

    Attributes
    ----------
    part : str
    H : (n, n) array
        Symmetric; mm/N for displacement rows under forces, rad/N, rad/(N mm) for rotations.
    G : (n, 6) array
        Readings of the six rigid-body modes (translations along x, y, z, rotations about x, y, z through the
        centroid).
    provenance : dict
        What the coefficients were computed from (element, sizes, versions), for the record.
    """

    part: str
    H: np.ndarray
    G: np.ndarray
    provenance: dict = field(default_factory=dict)

    def __post_init__(self):
        n = len(self.H)
        if self.H.shape != (n, n) or self.G.shape != (n, 6):
            raise ValueError(f"part {self.part!r}: H {self.H.shape} and G {self.G.shape} do not fit together")
        if not (np.isfinite(self.H).all() and np.isfinite(self.G).all()):
            raise ValueError(f"part {self.part!r}: the influence coefficients hold values that are not finite")

    def save(self, path) -> None:
        """Write to one ``.npz`` file; a reader never sees it half written."""
        path = Path(path)
        path.parent.mkdir(parents=True, exist_ok=True)
        temporary = path.with_suffix(f".{os.getpid()}.partial.npz")
        np.savez(temporary, H=self.H, G=self.G, part=self.part, provenance=json.dumps(self.provenance))
        temporary.replace(path)

    @classmethod
    def load(cls, path) -> InfluenceCoefficients:
        """Read what :meth:`save` wrote."""
        with np.load(path) as data:
            return cls(str(data["part"]), data["H"], data["G"], json.loads(str(data["provenance"])))


def influence_coefficients(
    assembly, cache: Path, progress=None, comm=None
) -> tuple[dict[str, InfluenceCoefficients], dict[str, bool]]:
    """Influence coefficients of all parts, from the cache where they fit, else from the finite elements.

    Parameters
    ----------
    assembly : mic.model.assembly.Assembly
    cache : Path
        Folder of cached coefficients; each file is named by the hash of everything that it depends on.
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
        If they must be computed and no finite elements are installed.
    """
    cached = {part.name: is_cached(part, cache) for part in assembly.parts}
    missing = [part for part in assembly.parts if not cached[part.name]]
    for part in missing:
        if progress:
            progress(
                f"influence coefficients of {part.name}: {len(part.functionals)} functionals, {len(part.surface.points)} nodes"
            )
    if missing:
        _compute(missing, cache, comm)
    return {part.name: InfluenceCoefficients.load(_cached_file(part, cache)) for part in assembly.parts}, cached


def is_cached(part, cache: Path) -> bool:
    """Whether the cache folder holds the part's influence coefficients."""
    return _cached_file(part, cache).is_file()


def _cached_file(part, cache):
    return cache / "influence" / f"{part.fingerprint()}.npz"


def _compute(parts, cache, comm):
    """Compute the parts' coefficients into the cache; under MPI a collective call on `comm` that shares the parts out."""
    try:
        from mpi4py import MPI

        from fem_reference.shell.influence import compute_influence
        from fem_reference.shell.part import ShellPart
    except ImportError as error:
        raise MissingProvider(
            f"part {parts[0].name!r}: no cached influence coefficients fit, and the finite elements that compute them are "
            f"not installed ({error}); on Debian: apt-get install python3-dolfinx, or copy a cache folder"
        ) from error
    shells = {
        part.name: lambda part=part: ShellPart(part.surface, part.thickness, part.young, part.poisson, part.element)
        for part in parts
    }
    comm = comm or MPI.COMM_WORLD
    computed = compute_influence(shells, {part.name: part.functionals for part in parts}, comm)
    if comm.rank == 0:
        for part in parts:
            provenance = {
                "element": part.element,
                "nodes": len(part.surface.points),
                "triangles": len(part.surface.triangles),
            }
            InfluenceCoefficients(part.name, *computed[part.name], provenance).save(_cached_file(part, cache))
    comm.Barrier()
