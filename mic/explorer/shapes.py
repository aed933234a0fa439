"""Displayed shapes of the parts: decimated surfaces, and their displacement under each unit force.

A part is displaced by ``u(x) = Φ(x) f + R(x) q`` (:mod:`mic.results.fields`). Φ is computed once at the vertices of the
decimated surface, with one finite-element solve for each retained functional that a force can act on. The shapes can be
saved beside a model file, so that exploring it needs no finite-element code.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from mic.compliance import provider
from mic.compliance.part import Part
from mic.errors import FormatError, MissingProvider
from mic.report.mesh_decimation import thinned
from mic.results.run_identity import identity
from mic.system.disk_cache import ABSENT, Cache
from mic.system.files import Format, fingerprint, load_arrays, reading, save_arrays

__all__ = ["PartShape", "Shapes", "shapes_path"]

FORMAT = Format("set of drawn shapes", 3, "write it again with `mic explore SCENE --keep`")
ACTING = ("locator", "clamp", "weld", "contact")  # kinds of rows with forces
MEMORY = 250_000_000  # bytes of the solutions that are computed together

_ARRAYS = ("points", "triangles", "basis", "rigid", "acting")
_NO_SHAPES = (
    "Parts are displayed undeformed, only contacts and measured points move: displacement shapes need a finite-element "
    "code, which is not installed, and are not available for superelements."
)


@dataclass(frozen=True)
class PartShape:
    """Displayed shape of a part.

    Attributes
    ----------
    name : str
    points : (v, 3) array
        Nominal, mm.
    triangles : (t, 3) int array
    basis : (a, v, 3) float32 array
        Φ of the functionals `acting`, mm/N and mm/(N mm).
    rigid : (v, 3, 6) array
        R.
    acting : (a,) int array
        Functionals of the part that forces can act on; none if Φ and R are unknown.
    """

    name: str
    points: np.ndarray
    triangles: np.ndarray
    basis: np.ndarray
    rigid: np.ndarray
    acting: np.ndarray

    def displaced(self, force: np.ndarray, motion: np.ndarray) -> np.ndarray:
        """(v, 3) displacements under forces (F,) on its functionals and a rigid motion (6,), mm."""
        loaded = np.flatnonzero(force[self.acting])  # most contacts are open
        return np.tensordot(force[self.acting[loaded]].astype(np.float32), self.basis[loaded], 1) + self.rigid @ motion


@dataclass(frozen=True)
class Shapes:
    """Displayed shapes of all parts of a model.

    Attributes
    ----------
    parts : tuple of PartShape
    note : str
        Why the parts are not displayed or not deformed; empty if they are.
    """

    parts: tuple[PartShape, ...] = ()
    note: str = "No shapes are saved with this model: only contacts and measured points are displayed."

    @classmethod
    def of(cls, model, parts: Sequence[Part], cache: Path, say: Callable[[str], None] = lambda line: None) -> Shapes:
        """Shapes of the parts of a model, from the cache, or computed and cached.

        Parameters
        ----------
        model : mic.process.model.ReducedModel
        parts : sequence of Part
            Empty if unknown.
        cache : Path
        say : callable
            Called with the name of a slow step.
        """
        if not parts:
            return cls()
        stored, key = Cache(cache, "shapes", Format(FORMAT.kind, FORMAT.version, ABSENT)), _identity(model)
        found = stored.load(key)
        if found is not None:
            return cls._from(*found)
        try:
            say("Shapes of the parts")
            loadable, rows = _loadable(model), model.compliance.functionals
            acting = [np.flatnonzero(loadable[own]) for own in rows]
            shapes = cls(tuple(map(_shape, parts, acting)), "")
        except MissingProvider:
            return cls(tuple(map(_undeformed, parts)), _NO_SHAPES)
        stored.store(key, *shapes._contents())
        return shapes

    def save(self, path: Path, model) -> None:
        """Write the shapes of a model to a file."""
        header, arrays = self._contents()
        save_arrays(Path(path), FORMAT, header | {"identity": _identity(model)}, arrays)

    @classmethod
    def load(cls, path: Path, model) -> Shapes:
        """Read a file written by :meth:`save`.

        Raises
        ------
        FileNotFoundError
        FormatError
            If the file is of another kind, damaged, or of another model.
        """
        with reading(Path(path), FORMAT):
            header, arrays = load_arrays(Path(path), FORMAT)
            if header["identity"] != _identity(model):
                raise FormatError(
                    f"{path}: these shapes belong to another model; {FORMAT.remedy}, or move the file away"
                )
            return cls._from(header, arrays)

    def _contents(self) -> tuple[dict[str, Any], dict[str, np.ndarray]]:
        arrays = {f"{i}_{name}": getattr(part, name) for i, part in enumerate(self.parts) for name in _ARRAYS}
        return {"parts": [part.name for part in self.parts], "said": self.note}, arrays

    @classmethod
    def _from(cls, header, arrays) -> Shapes:
        parts = [PartShape(name, *(arrays[f"{i}_{key}"] for key in _ARRAYS)) for i, name in enumerate(header["parts"])]
        return cls(tuple(parts), header["said"])

    def displaced(self, model, force: np.ndarray, motion: np.ndarray) -> list[np.ndarray]:
        """(v, 3) displacements of each part under forces (F,) and motions (6P,) of the whole assembly, mm."""
        blocks = model.compliance
        return [
            part.displaced(force[rows], motion[modes])
            for part, rows, modes in zip(self.parts, blocks.functionals, blocks.motions)
        ]


def shapes_path(path: Path) -> Path:
    """The file of the shapes that belong to a model file."""
    return path.with_name(f"{path.stem}.shapes.npz")


def _identity(model) -> str:
    """Checksum of the model and of its retained functionals, which depend on the requested report."""
    return fingerprint([identity(model, 0), [len(H) for H in model.compliance.H]])


def _loadable(model) -> np.ndarray:
    """(F,) whether a force can act on a retained functional: those of fixtures, welds, contacts and shapes."""
    loadable = np.abs(model.shape_forces).any(axis=1)
    for kind in ACTING:
        loadable[model.rows[kind].indices] = True
    return np.asarray(loadable)


def _undeformed(part: Part) -> PartShape:
    vertices, triangles = thinned(part.surface)
    basis, rigid = np.zeros((0, len(vertices), 3), dtype=np.float32), np.zeros((len(vertices), 3, 6))
    return PartShape(part.name, part.surface.points[vertices], triangles, basis, rigid, np.zeros(0, dtype=int))


def _shape(part: Part, acting: np.ndarray) -> PartShape:
    """Shape of a part, solved for as many forces at a time as fit into :data:`MEMORY`."""
    vertices, triangles = thinned(part.surface)
    count, size = len(part.functionals), len(part.surface.points)
    step = max(1, MEMORY // (8 * 6 * 2 * size))
    solver, unit = provider.find(part), np.eye(count)[:, acting]
    basis, rigid = np.zeros((len(acting), len(vertices), 3), dtype=np.float32), np.zeros((size, 6, 6))
    for first in range(0, max(len(acting), 1), step):
        solved, rigid = solver.field(part, unit[:, first : first + step])
        basis[first : first + step] = np.moveaxis(solved[vertices, :3], 2, 0)
    return PartShape(part.name, part.surface.points[vertices], triangles, basis, rigid[vertices, :3], acting)
