"""The parts as they are drawn: thinned surfaces, and what each force on a part moves of them.

A part is displaced by ``u(x) = Φ(x) f + R(x) q`` (:mod:`mic.results.fields`); here Φ is computed once for all forces
there can be, one finite-element solve for each retained functional that a force can act on, at the vertices that a
screen shows. Kept in a file
of their own beside the model's, they are drawn where no finite elements are installed.
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
from mic.system.files import Format, fingerprint, load_arrays, save_arrays

__all__ = ["PartShape", "Shapes", "beside"]

FORMAT = Format("set of drawn shapes", 2, "write it again with `mic explore SCENE --keep`")
ACTING = ("locator", "clamp", "weld", "contact")  # kinds of rows along which something pushes
ROOM = 250_000_000  # bytes that the solutions of some forces may take together

_ARRAYS = ("points", "triangles", "basis", "rigid", "acting")
_NONE = (
    "Parts are drawn as nominal, and contacts and measured points alone move: shapes take finite elements, which are "
    "not installed here, and are not known of a superelement."
)


@dataclass(frozen=True)
class PartShape:
    """One part as it is drawn.

    Attributes
    ----------
    name : str
    points : (v, 3) array
        Nominal, mm.
    triangles : (t, 3) int array
    basis : (a, v, 3) float32 array or None
        Φ of the functionals `acting`, mm/N and mm/(N mm); None where it is not known.
    rigid : (v, 3, 6) array
        R.
    acting : (a,) int array
        The part's functionals that forces can act on.
    """

    name: str
    points: np.ndarray
    triangles: np.ndarray
    basis: np.ndarray | None
    rigid: np.ndarray
    acting: np.ndarray

    def displaced(self, force: np.ndarray, motion: np.ndarray) -> np.ndarray:
        """(v, 3) displacements under forces (F,) on its functionals, and its rigid motion (6,), mm."""
        if self.basis is None:
            return np.zeros_like(self.points)
        here = np.flatnonzero(force[self.acting])  # most contacts are open
        flat = force[self.acting[here]].astype(np.float32) @ self.basis.reshape(len(self.basis), -1)[here]
        return flat.reshape(-1, 3) + self.rigid @ motion


@dataclass(frozen=True)
class Shapes:
    """All parts of a model; none where nothing is known of them.

    Attributes
    ----------
    parts : tuple of PartShape
    said : str
        Why they are not drawn as they deform; empty where they are.
    """

    parts: tuple[PartShape, ...] = ()
    said: str = "No shapes of the parts are kept with this model: contacts and measured points alone are drawn."

    @classmethod
    def of(cls, model, parts: Sequence[Part], cache: Path, say: Callable[[str], None] = lambda line: None) -> Shapes:
        """Of the parts of a model, from the cache or computed and kept there.

        Parameters
        ----------
        model : mic.process.model.ReducedModel
        parts : sequence of Part
            None where they are not known.
        cache : Path
        say : callable
            Called with what is done, where it takes time.
        """
        if not parts:
            return cls()
        kept, own = Cache(cache, "shapes", Format(FORMAT.kind, FORMAT.version, ABSENT)), _identity(model)
        found = kept.load(own)
        if found is not None:
            return cls._from(*found)
        try:
            say("Shapes of the parts")
            pushed, rows = _pushed(model), model.compliance.functionals
            acting = [np.flatnonzero(pushed[one]) for one in rows]
            made = cls(tuple(map(_shape, parts, acting)), "")
        except MissingProvider:
            nowhere, none = np.zeros(0, dtype=int), [thinned(part.surface) for part in parts]
            bare = tuple(
                PartShape(part.name, part.surface.points[which], triangles, None, np.zeros((len(which), 3, 6)), nowhere)
                for part, (which, triangles) in zip(parts, none)
            )
            return cls(bare, _NONE)
        kept.store(own, *made._written())
        return made

    def save(self, path: Path, model) -> None:
        """Write them to a file, for the model that they belong to."""
        header, arrays = self._written()
        save_arrays(Path(path), FORMAT, header | {"identity": _identity(model)}, arrays)

    @classmethod
    def load(cls, path: Path, model) -> Shapes:
        """Read what :meth:`save` wrote.

        Raises
        ------
        FileNotFoundError
        FormatError
            If the file is something else, is damaged, or belongs to another model.
        """
        header, arrays = load_arrays(Path(path), FORMAT)
        if header["identity"] != _identity(model):
            raise FormatError(f"{path}: these shapes belong to another model; {FORMAT.remedy}, or move the file away")
        return cls._from(header, arrays)

    def _written(self) -> tuple[dict[str, Any], dict[str, np.ndarray]]:
        arrays = {
            f"{i}_{name}": getattr(part, name)
            for i, part in enumerate(self.parts)
            for name in _ARRAYS
            if getattr(part, name) is not None
        }
        return {"parts": [part.name for part in self.parts], "said": self.said}, arrays

    @classmethod
    def _from(cls, header, arrays) -> Shapes:
        parts = (
            PartShape(name, *(arrays.get(f"{i}_{key}") for key in _ARRAYS)) for i, name in enumerate(header["parts"])
        )
        return cls(tuple(parts), header["said"])

    def displaced(self, model, force: np.ndarray, motion: np.ndarray) -> list[np.ndarray]:
        """(v, 3) displacements of each part under forces (F,) and motions (6P,) of the whole assembly, mm."""
        blocks = model.compliance
        return [
            part.displaced(force[rows], motion[modes])
            for part, rows, modes in zip(self.parts, blocks.functionals, blocks.motions)
        ]


def beside(path: Path) -> Path:
    """Where the shapes of a model's file lie."""
    return path.with_name(f"{path.stem}.shapes.npz")


def _identity(model) -> str:
    """Of the model and of what is retained of it, which what is asked of a report changes."""
    return fingerprint([identity(model, 0), [len(H) for H in model.compliance.H]])


def _pushed(model) -> np.ndarray:
    """(F,) which retained functionals a force can act on: those of fixtures, welds, contacts and shapes."""
    found = np.abs(model.shape_forces).any(axis=1)
    for kind in ACTING:
        found[model.rows[kind].indices] = True
    return np.asarray(found)


def _shape(part: Part, acting: np.ndarray) -> PartShape:
    """Some forces at a time, so that what is solved for finds room."""
    kept, triangles = thinned(part.surface)
    count, size = len(part.functionals), len(part.surface.points)
    step = max(1, ROOM // (8 * 6 * 2 * size))
    found, one = provider.find(part), np.eye(count)[:, acting]
    basis, rigid = np.zeros((len(acting), len(kept), 3), dtype=np.float32), np.zeros((size, 6, 6))
    for first in range(0, max(len(acting), 1), step):
        solved, rigid = found.field(part, one[:, first : first + step])
        basis[first : first + step] = np.moveaxis(solved[kept, :3], 2, 0)
    return PartShape(part.name, part.surface.points[kept], triangles, basis, rigid[kept, :3], acting)
