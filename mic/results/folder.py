"""The folder of a run: what it is called, how it is written, and what it takes to be believed when it is read.

Readable at any moment. An interrupted run is completed by a second call; a file that cannot be read counts as absent.
Every block names the identity of the run that it belongs to, and is used by no other.

========================================= ==============================================================================
``run.json``                              the record: scene, samples, seed, laws, identity, versions, wall time
``model.npz``                             the reduced model
``parts.npz``, ``paper.toml``             what fields and report need beside the results
``TABLE/law=LAW/FIRST-LAST.parquet``      the datasets of :data:`mic.results.schema.DATASETS`, one file per block
``forces/law=LAW/FIRST-LAST.npz``         forces and motions in the last stage, only where fields are asked for
``tables/*.csv``, ``summary.json``        statistics
``fields/``                               displacement fields
========================================= ==============================================================================

A block is finished once its file under ``samples`` stands: that one is written last.
"""

from __future__ import annotations

import hashlib
import platform
import re
import shutil
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from importlib.metadata import PackageNotFoundError, version
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd

from mic.compliance.functional import Functionals
from mic.compliance.part import Part
from mic.errors import FormatError, RunError
from mic.geometry.surface import Patch, Surface
from mic.results.parquet import read_table, write_table
from mic.results.schema import DATASETS, FORCES, SAMPLES, Table
from mic.store import Format, load_arrays, load_json, replacing, save_arrays, save_json

__all__ = ["DAMAGED", "PUBLISHED", "Block", "RunFolder", "identity", "versions"]

PUBLISHED = "paper.toml"  # published figures beside a scene, to set beside its results
DAMAGED = ".damaged"  # stands behind the name of a file that could not be read and was set aside

_AGAIN = "run the scene again into this folder"
_RUN = Format("record of a run", 2, _AGAIN)
_PARTS = Format("set of parts", 1, _AGAIN)
_FORCES = Format("block of forces", 1, _AGAIN)
_BLOCK_NAME = re.compile(r"(\d{6,})-(\d{6,})")


@dataclass(frozen=True, order=True)
class Block:
    """Samples that are evaluated and stored together.

    Attributes
    ----------
    law : str
    first, count : int
        Number of the first sample, and how many follow from it.
    """

    law: str
    first: int
    count: int

    @property
    def name(self) -> str:
        """Stem of the block's files."""
        return f"{self.first:06d}-{self.first + self.count - 1:06d}"


@dataclass(frozen=True)
class RunFolder:
    """The folder of a run.

    Attributes
    ----------
    path : Path
    """

    path: Path

    # ---------------------------------------------------------------------------------------------- the record

    def record(self) -> dict[str, Any]:
        """Content of ``run.json``.

        Raises
        ------
        RunError
            If the folder holds no run.
        FormatError
            If the record cannot be read.
        """
        try:
            return load_json(self.path / "run.json", _RUN)
        except FileNotFoundError:
            raise RunError(
                f"{self.path}: holds no run (run.json is missing); name the folder that `mic run` wrote, such as "
                "results/wheelhouse"
            ) from None

    def write_record(self, record: Mapping[str, Any]) -> None:
        """Write ``run.json``."""
        save_json(self.path / "run.json", _RUN, record)

    def add_wall_time(self, seconds: Mapping[str, float]) -> dict[str, Any]:
        """Put the wall time of phases, s, into the record, and return that; phases it has already are replaced."""
        record = self.record()
        record["wall_time"] = record.get("wall_time", {}) | {phase: round(s, 3) for phase, s in seconds.items()}
        self.write_record(record)
        return record

    # ---------------------------------------------------------------------------------------------- blocks of samples

    def prepare(self, record: Mapping[str, Any], blocks: Iterable[Block], forces: bool) -> list[str]:
        """Make the folder ready for a run: what it holds of other runs goes, what cannot be read is set aside.

        Only files that a run writes are touched, by their names. A block is of another run if it has another identity,
        or if it is none of those that the run consists of.

        Parameters
        ----------
        record : dict
            The new ``run.json``, with its ``"identity"``.
        blocks : iterable of Block
            All blocks of the run.
        forces : bool
            Whether its blocks keep forces.

        Returns
        -------
        list of str
            One sentence for each block that could not be read.
        """
        wanted, sentences = set(blocks), []
        for law, name in sorted({key for table in (*DATASETS, FORCES) for key in self._files(table)}):
            block = _parsed(law, name)
            try:
                keep = block in wanted and self._identity(block) == record["identity"]
                if keep:
                    self.read_block(block, record["identity"])
                    if forces and self.read_forces(block, record["identity"]) is None:
                        raise FormatError(f"{self._path(FORCES, block)}: this file of a finished block is missing")
            except FormatError as problem:
                sentences += self._set_aside(block, problem)
            else:
                if not keep:
                    self._remove(block)
        self.write_record(record)
        return sentences

    def write_block(
        self, block: Block, identity: str, tables: Mapping[str, pd.DataFrame], forces: Mapping[str, np.ndarray] | None
    ) -> None:
        """Write a finished block; a reader sees the whole of it or nothing.

        Parameters
        ----------
        block : Block
        identity : str
            Of the run.
        tables : dict of str to DataFrame
            One for each of :data:`mic.results.schema.DATASETS`.
        forces : dict of str to array, optional
            As :data:`mic.results.schema.FORCES` declares them.
        """
        if forces is not None:
            save_arrays(self._path(FORCES, block), _FORCES, {"identity": identity}, forces)
        for table in DATASETS:  # the samples last: they mark the block done
            write_table(self._path(table, block), table, tables[table.name], identity)

    def has_block(self, block: Block) -> bool:
        """Whether a block is finished."""
        return self._path(SAMPLES, block).is_file()

    def blocks(self, law: str) -> list[Block]:
        """The finished blocks of a law, in ascending order."""
        return sorted(_parsed(law, name) for found, name in self._files(SAMPLES) if found == law)

    def read_block(self, block: Block, identity: str) -> dict[str, pd.DataFrame]:
        """Read a finished block by table.

        Raises
        ------
        FormatError
            If a file is missing, cannot be read, or belongs to another run.
        """
        return {table.name: self.read_dataset(block, table.name, identity) for table in DATASETS}

    def read_dataset(self, block: Block, name: str, identity: str) -> pd.DataFrame:
        """Read one of the datasets of a finished block; errors as :meth:`read_block`."""
        table = next(table for table in DATASETS if table.name == name)
        path = self._path(table, block)
        try:
            frame, whose = read_table(path, table)
        except FileNotFoundError:
            raise FormatError(f"{path}: this file of a finished block is missing; {_AGAIN}") from None
        if whose != identity:
            raise FormatError(f"{path}: this block belongs to another run; {_AGAIN}")
        return frame

    def read_forces(self, block: Block, identity: str) -> dict[str, np.ndarray] | None:
        """Forces and motions of a block, (n, F) and (n, 6P); None where the run kept none."""
        path = self._path(FORCES, block)
        if not path.is_file():
            return None
        header, arrays = load_arrays(path, _FORCES)
        if header["identity"] != identity:
            raise FormatError(f"{path}: this block belongs to another run; {_AGAIN}")
        return arrays

    # ---------------------------------------------------------------------------------------------- kept inputs

    def keep_inputs(self, assembly) -> None:
        """Copy into the folder what fields and report need beside the results, so that it can be read on any machine.

        These are the parts with their retained functionals (``parts.npz``) and, if the scene's folder has one, the
        published figures (``paper.toml``) to set beside the results.

        Parameters
        ----------
        assembly : mic.model.assembly.Assembly
        """
        arrays: dict[str, np.ndarray] = {}
        for i, part in enumerate(assembly.parts):
            f = part.functionals
            table = {
                "points": part.surface.points,
                "triangles": part.surface.triangles,
                "patch": f.patch,
                "direction": f.direction,
                "rotation": f.rotation,
                "side": f.side,
                "label": np.array(f.label, dtype=str),
                "ends": np.cumsum([len(patch.weight) for patch in f.patches]),
            }
            table |= {name: np.concatenate([getattr(patch, name) for patch in f.patches]) for name in _PATCH}
            arrays |= {f"{i}_{name}": array for name, array in table.items()}
        save_arrays(self.path / "parts.npz", _PARTS, {"parts": [part.name for part in assembly.parts]}, arrays)
        published = assembly.scene.folder / PUBLISHED
        if published.is_file():
            with replacing(self.path / PUBLISHED) as temporary:
                shutil.copyfile(published, temporary)
        else:
            (self.path / PUBLISHED).unlink(missing_ok=True)

    def parts(self, scene) -> tuple[Part, ...]:
        """The parts as :meth:`keep_inputs` left them; none if it was not called.

        Raises
        ------
        FormatError
            If the file cannot be read.
        """
        try:
            _, arrays = load_arrays(self.path / "parts.npz", _PARTS)
        except FileNotFoundError:
            return ()
        parts = []
        for i, part in enumerate(scene.parts):
            get = lambda name, i=i: arrays[f"{i}_{name}"]
            split = [np.split(get(name), get("ends")[:-1]) for name in _PATCH]
            functionals = Functionals(
                tuple(Patch(*pieces) for pieces in zip(*split)),
                get("patch"),
                get("direction"),
                get("rotation"),
                get("side"),
                tuple(str(label) for label in get("label")),
            )
            surface = Surface(get("points"), get("triangles"))
            parts.append(Part(part.name, surface, part.thickness, part.young, part.poisson, scene.element, functionals))
        return tuple(parts)

    # ---------------------------------------------------------------------------------------------- files of a block

    def _path(self, table: Table, block: Block) -> Path:
        return self.path / table.name / f"law={block.law}" / f"{block.name}{Path(table.place).suffix}"

    def _files(self, table: Table) -> list[tuple[str, str]]:
        """(law, name) of every file of a table that has a block's name."""
        return [
            (path.parent.name.removeprefix("law="), path.stem)
            for path in (self.path / table.name).glob(f"law=*/*{Path(table.place).suffix}")
            if _BLOCK_NAME.fullmatch(path.stem)
        ]

    def _identity(self, block: Block) -> str | None:
        """Identity of the run that a block belongs to; None where it is not finished."""
        path = self._path(SAMPLES, block)
        return read_table(path, SAMPLES)[1] if path.is_file() else None

    def _remove(self, block: Block) -> None:
        for table in reversed(DATASETS):  # the samples first: half a block never looks finished
            self._path(table, block).unlink(missing_ok=True)
        self._path(FORCES, block).unlink(missing_ok=True)

    def _set_aside(self, block: Block, problem: Exception) -> list[str]:
        for table in (*reversed(DATASETS), FORCES):
            path = self._path(table, block)
            if path.is_file():
                path.replace(path.with_name(path.name + DAMAGED))
        return [f"{problem}. The block is set aside ({DAMAGED}) and computed anew."]


_PATCH = ("triangle", "barycentric", "weight")


def identity(model, seed: int, parts: Sequence[Part] = ()) -> str:
    """Hash of all that the numbers of a run depend on, except how many samples there are and under which law.

    Parameters
    ----------
    model : mic.process.model.ReducedModel
    seed : int
    parts : sequence of Part
        The parts that the model was reduced from. They stand for its influence coefficients, whose last digits may
        change with the number of threads that computed them; without parts the coefficients themselves are taken.
    """
    scene, contacts = model.scene, model.contacts
    digest = hashlib.sha256(repr((seed, versions()["mic-contact"])).encode())
    digest.update(scene.model_dump_json(exclude={"monte_carlo", "report", "description"}).encode())
    digest.update(repr((scene.report.fields, contacts.dimension, scene.monte_carlo.backend)).encode())
    arrays = [contacts.gap, contacts.friction, contacts.frame, contacts.point]
    if parts:
        digest.update(repr([part.fingerprint() for part in parts]).encode())
    else:
        arrays += [*model.compliance.H, *model.compliance.G, model.shape]
    for array in arrays:
        digest.update(np.ascontiguousarray(array).tobytes())
    return digest.hexdigest()[:32]


def versions() -> dict[str, str]:
    """Versions of what a number may depend on."""
    found = {"python": platform.python_version()}
    for name in ("mic-contact", "numpy", "scipy", "numba", "fenics-dolfinx", "petsc4py"):
        try:
            found[name] = version(name)
        except PackageNotFoundError:
            found[name] = "not installed"
    return found


def _parsed(law: str, name: str) -> Block:
    first, last = map(int, name.split("-"))
    return Block(law, first, last - first + 1)
