"""Read and write the folder of a run, and check that its files belong to it.

Readable at any moment. An interrupted run is completed by a second call; a file that cannot be read counts as absent.
Every block names the identity of the run that it belongs to (:mod:`mic.results.run_identity`), and is used by no other.
Files of other runs are removed only with `--replace`, and only if the program wrote them.

========================================= ==============================================================================
``.lock``                                 process that is writing to the folder
``run.json``                              the record: scene, samples, seed, laws, identity, inputs, versions, wall time
``model.npz``                             the reduced model
``parts.npz``, ``paper.toml``             further inputs of fields and report
``TABLE/law=LAW/FIRST-LAST.parquet``      the datasets of :data:`mic.results.schema.DATASETS`, one file per block
``sums/law=LAW/FIRST-LAST.npz``           moments of a block without stored contact pairs
``forces/law=LAW/FIRST-LAST.npz``         forces and motions in the last stage, if fields are requested
``condensed/law=LAW/FIRST-LAST.npz``      low-rank factor of the forces of such a block
``tables/*.csv``, ``summary.json``        statistics
``fields/``                               displacement fields
========================================= ==============================================================================

A block is finished once its file under ``samples`` stands: that one is written last. The first blocks keep their
contact pairs and forces (:func:`keeps`). Another one counts as a whole or not at all: of a run that is asked for fewer
samples than stand here, the last ones are evaluated again.
"""

from __future__ import annotations

import json
import platform
import re
import shutil
from bisect import bisect
from collections.abc import Mapping, Sequence
from contextlib import suppress
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
from mic.results.contact_sums import Sums
from mic.results.low_rank_forces import Condensed
from mic.results.parquet import read_identity, read_table, write_table
from mic.results.run_identity import differences
from mic.results.schema import (
    ACCURACY,
    CONDENSED,
    CONTACTS,
    DATASETS,
    FORCES,
    SAMPLES,
    STATISTICS,
    STUDIES,
    SUMS,
    Table,
)
from mic.scene.schema import Report
from mic.statistics.estimates import Moments
from mic.system.files import (
    DAMAGED,
    Format,
    arrays_header,
    clean,
    fingerprint,
    load_arrays,
    load_json,
    replacing,
    save_arrays,
    save_json,
    set_aside,
    together,
)
from mic.system.memoise import pack, unpack

__all__ = ["EXCEL", "FOREIGN", "PUBLISHED", "Block", "RunFolder", "keeps", "versions"]

PUBLISHED = "paper.toml"  # published figures beside a scene, to set beside its results
EXCEL = "tables.xlsx"  # the tables in one workbook
FOREIGN = ".other-run"  # stands behind the name of a block that belongs to another run and was set aside

_AGAIN = "run the scene again into this folder"
_REPLACE = "name another folder with --out, or remove the old results with --replace"
_RUN = Format("record of a run", 4, _AGAIN)
_SINGLE = ("model.npz", "parts.npz", "summary.json", "report.html", "assembly.png", EXCEL, PUBLISHED)
_TABLES = tuple(table.place for table in (*STATISTICS, ACCURACY, *STUDIES))
_FIELDS = "fields/fields.npz"
_PARTS = Format("set of parts", 2, _AGAIN)
_FORCES = Format("block of forces", 1, _AGAIN)
_SUMS = Format("sums of a block", 1, _AGAIN)
_CONDENSED = Format("block of condensed forces", 1, _AGAIN)
_FILES = (*DATASETS, SUMS, FORCES, CONDENSED)  # that a block may have
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

    def contains(self, other: Block) -> bool:
        """Whether all samples of another block of the same law are among this one's."""
        return self.first <= other.first and other.first + other.count <= self.first + self.count


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
            record = load_json(self.path / "run.json", _RUN)
        except FileNotFoundError:
            raise RunError(
                f"{self.path}: holds no run (run.json is missing); name the folder that `mic run` wrote, such as "
                "results/wheelhouse"
            ) from None
        inputs = record.get("inputs")
        if (
            not isinstance(inputs, dict)
            or not {"scene", "samples", "laws", "versions"} <= set(record)
            or record.get("identity") != fingerprint(inputs)
            or record.get("seed") != inputs.get("seed")
        ):
            raise _RUN.damaged(self.path / "run.json")
        return record

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

    def prepare(self, record: Mapping[str, Any], report: Report, replace: bool = False) -> list[str]:
        """Prepare the folder for a run, or reject it. Call under its lock, before any other write.

        Finished samples of the same run stay, however many are asked for and under which laws. What cannot be read is
        set aside. A folder of another run is refused, or with `replace` freed of the files that a run writes.

        Parameters
        ----------
        record : dict
            The new ``run.json``, with its ``"identity"`` and ``"inputs"``.
        report : mic.scene.schema.Report
            What the run's blocks keep of forces and contact pairs.
        replace : bool
            Whether results of another run may be removed.

        Returns
        -------
        list of str
            One sentence for each file that could not be read or was removed.

        Raises
        ------
        RunError
            If the folder holds another run, or files that no run wrote under names that this one would.
        """
        self._refuse_links()
        clean(self._folders(), alone=True)
        old, sentences = self._old_record(replace)
        if old is not None and old.get("identity") != record["identity"]:
            if not replace:
                raise RunError(self._another(differences(old.get("inputs") or {}, record["inputs"])))
            sentences += self._clear()
        elif old is None:
            sentences += self._without_record(record["identity"], replace)
        for name in ("model.npz", "parts.npz", _FIELDS):
            path = self.path / name
            if path.is_file() and not arrays_header(path):
                sentences.append(_aside(path))
        sentences += self._check_blocks(record, report)
        kept = (
            {"wall_time": old["wall_time"]}
            if old and "wall_time" in old and old.get("identity") == record["identity"]
            else {}
        )
        self.write_record(kept | dict(record))
        return sentences

    def _old_record(self, replace: bool) -> tuple[dict[str, Any] | None, list[str]]:
        """The record that stands here, None where there is none or it is cut; and what is to be said of it."""
        path = self.path / "run.json"
        if not path.is_file():
            return None, []
        try:
            return self.record(), []
        except FormatError as problem:
            stated = _kind_and_format(path)
            if stated is not None and stated[0] != _RUN.kind:
                raise RunError(
                    f"{path}: was written by something else than a run; name another folder with --out"
                ) from None
            if stated is None or stated[1] == _RUN.version:
                return None, [_aside(path)]
            if not replace:
                raise RunError(f"{str(problem).partition(';')[0]}; {_REPLACE}") from None
            return {}, []

    def _without_record(self, identity: str, replace: bool) -> list[str]:
        """What is to be said of a folder without a record: its blocks must all be of the run that is asked for."""
        finished = [_parsed(law, name) for law, name in self._files(SAMPLES)]
        whose = {self._identity(block) for block in finished} - {None}
        if whose - {identity}:
            if not replace:
                raise RunError(self._another(["its run.json is missing, and its samples are not those asked for"]))
            return self._clear()
        if whose:
            return [f"{self.path}: run.json was missing; rebuilt, for the finished samples are those asked for."]
        known = [name for name in (*_SINGLE, *_TABLES) if (self.path / name).exists()]
        own = any(arrays_header(self.path / name) for name in ("model.npz", "parts.npz"))
        if known and not finished and not own:
            raise RunError(
                f"{self.path / known[0]}: stands where the run would write, and no run wrote it; name another folder "
                "with --out"
            )
        return []

    def _another(self, what: Sequence[str]) -> str:
        return f"{self.path}: holds another run ({'; '.join(what) or 'of another identity'}); {_REPLACE}"

    def _check_blocks(self, record: Mapping[str, Any], report: Report) -> list[str]:
        """Set aside what is not whole, or not of this run, among the blocks that the run would use."""
        sentences = []
        for law, name in sorted({key for table in _FILES for key in self._files(table)}):
            block = _parsed(law, name)
            if law not in record["laws"] or block.first >= record["samples"]:
                continue
            path = self._path(SAMPLES, block)
            if not path.is_file():
                continue  # it was never finished
            try:
                if read_identity(path, SAMPLES) != record["identity"]:
                    self._set_block_aside(block, FOREIGN)
                    sentences.append(f"{path}: belongs to another run; set aside ({FOREIGN}).")
                    continue
                self._check_whole(block, record["identity"], report)
            except FormatError as problem:
                self._set_block_aside(block)
                sentences.append(f"{problem}. The block is set aside and computed anew.")
        return sentences

    def _check_whole(self, block: Block, identity: str, report: Report) -> None:
        """Raise FormatError unless a finished block has all that a report is made of."""
        found, forces = self.read_block(block, identity), self.read_forces(block, identity)
        if CONTACTS.name not in found:
            self.read_sums(block, identity)
        missing = [CONTACTS] if keeps(report, block) and CONTACTS.name not in found else []
        if report.fields and forces is None and (keeps(report, block) or not self.read_condensed(block, identity)):
            missing.append(FORCES)
        if missing:
            raise FormatError(f"{self._path(missing[0], block)}: this file of a finished block is missing")

    def _refuse_links(self) -> None:
        """A link below the folder could lead out of it."""
        places = [self.path / name for name in ("run.json", *_SINGLE, "tables", "fields")]
        for table in _FILES:
            places += [self.path / table.name, *(self.path / table.name).glob("law=*")]
        for place in places:
            if place.is_symlink():
                raise RunError(f"{place}: is a link, and a run follows none out of its folder; remove the link")

    def _folders(self) -> list[Path]:
        below = [path for table in _FILES for path in (self.path / table.name).glob("law=*")]
        return [self.path, self.path / "tables", self.path / "fields", *below]

    def _clear(self) -> list[str]:
        """Remove the files that a run writes, by their names, and the folders that are empty then; the record last."""
        for name in arrays_header(self.path / _FIELDS).get("files", []):
            if Path(name).name == name and name.endswith(".vtu"):
                (self.path / "fields" / name).unlink(missing_ok=True)
        blocks = sorted({key for table in _FILES for key in self._files(table)})
        for law, name in blocks:
            self._remove(_parsed(law, name))
        for name in (*_SINGLE, *_TABLES, _FIELDS, "run.json"):
            (self.path / name).unlink(missing_ok=True)
        for folder in sorted({*self._folders(), *(self.path / table.name for table in _FILES)}, reverse=True):
            if folder != self.path:
                with suppress(OSError):  # what is not empty holds files of somebody else
                    folder.rmdir()
        return [f"{self.path}: the results of another run were removed."]

    def write_block(
        self,
        block: Block,
        identity: str,
        tables: Mapping[str, pd.DataFrame],
        forces: Mapping[str, np.ndarray] | None = None,
        sums: Sums | None = None,
        condensed: Sequence[Condensed] | None = None,
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
        sums : Sums, optional
            In place of the contact pairs.
        condensed : sequence of Condensed, optional
            In place of the forces, by part.
        """
        own = {"identity": identity}
        with together() as group:
            if forces is not None:
                save_arrays(self._path(FORCES, block), _FORCES, own, forces, group=group)
            for table, form, content in ((SUMS, _SUMS, sums), (CONDENSED, _CONDENSED, condensed)):
                if content is not None:
                    header, arrays = pack(content, {})
                    save_arrays(self._path(table, block), form, own | {"content": header}, arrays, group=group)
            for table in DATASETS:  # the samples last: they mark the block done, what is missing is computed anew
                if table.name in tables:
                    write_table(self._path(table, block), table, tables[table.name], identity, group=group)
        for other in self._found(block.law):  # the last block of a shorter run: its samples stand in this one now
            if other != block and block.contains(other) and self._identity(other) == identity:
                self._remove(other)

    def blocks(self, law: str, samples: int | None = None) -> list[Block]:
        """The finished blocks of a law, in ascending order, each sample in one of them only.

        Where blocks overlap, since a longer run was stopped right after it wrote one, the larger counts.

        Parameters
        ----------
        law : str
        samples : int, optional
            Only blocks with samples below this number, and of those that have others, too, such as have their pairs.
        """
        chosen: list[Block] = []
        for block in sorted(self._found(law), key=lambda block: (-block.count, block.first)):
            if samples is not None and (block.first >= samples or not self._divides(block, samples)):
                continue
            place = bisect(chosen, block)
            before, after = chosen[max(place - 1, 0) : place], chosen[place : place + 1]
            if all(other.first + other.count <= block.first for other in before) and all(
                block.first + block.count <= other.first for other in after
            ):
                chosen.insert(place, block)
        return chosen

    def _divides(self, block: Block, samples: int) -> bool:
        """Whether a block tells its samples below a number from the others."""
        return block.first + block.count <= samples or self.keeps_pairs(block)

    def keeps_pairs(self, block: Block) -> bool:
        """Whether a block has its contact pairs."""
        return self._path(CONTACTS, block).is_file()

    def finished(self, law: str, samples: int) -> np.ndarray:
        """Numbers of the finished samples of a law, ascending, where so many are asked for."""
        runs = [np.arange(block.first, block.first + block.count) for block in self.blocks(law, samples)]
        return np.concatenate(runs) if runs else np.zeros(0, dtype=int)

    def read_block(self, block: Block, identity: str) -> dict[str, pd.DataFrame]:
        """Read a finished block by table; without its contact pairs where it has their sums.

        Raises
        ------
        FormatError
            If a file is missing, cannot be read, or belongs to another run.
        """
        kept = self.keeps_pairs(block) or not self._path(SUMS, block).is_file()
        tables = [table for table in DATASETS if table is not CONTACTS or kept]
        return {table.name: self.read_dataset(block, table.name, identity) for table in tables}

    def read_sums(self, block: Block, identity: str) -> Sums | None:
        """What a block's contact pairs add up to; None where it has them. Errors as :meth:`read_block`."""
        return self._unpacked(SUMS, _SUMS, block, identity, (Sums, Moments))

    def read_condensed(self, block: Block, identity: str) -> tuple[Condensed, ...] | None:
        """What stands for the forces of a block, by part; None where nothing does. Errors as :meth:`read_block`."""
        return self._unpacked(CONDENSED, _CONDENSED, block, identity, (Condensed,))

    def _unpacked(self, table: Table, form: Format, block: Block, identity: str, classes: Sequence[type]) -> Any:
        path = self._path(table, block)
        if not path.is_file():
            return None
        header, arrays = load_arrays(path, form)
        if header["identity"] != identity:
            raise FormatError(f"{path}: this block belongs to another run; {_AGAIN}")
        return unpack(header["content"], arrays, classes, {})

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
        """Copy into the folder further inputs of fields and report, so that it can be read on any machine.

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
            if part.surface.given_normals is not None:
                table["given_normals"] = part.surface.given_normals
            table |= {name: np.concatenate([getattr(patch, name) for patch in f.patches]) for name in _PATCH}
            arrays |= {f"{i}_{name}": array for name, array in table.items()}
        save_arrays(self.path / "parts.npz", _PARTS, {"parts": [part.name for part in assembly.parts]}, arrays)
        published = assembly.scene.folder / PUBLISHED
        if published.is_file():
            with replacing(self.path / PUBLISHED) as temporary:
                shutil.copyfile(published, temporary)

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
            surface = Surface(get("points"), get("triangles"), arrays.get(f"{i}_given_normals"))
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

    def _found(self, law: str) -> list[Block]:
        """All finished blocks of a law, also where they overlap."""
        return [_parsed(law, name) for other, name in self._files(SAMPLES) if other == law]

    def _identity(self, block: Block) -> str | None:
        """Identity of the run that a block belongs to; None where it is not finished or cannot be read."""
        try:
            return read_identity(self._path(SAMPLES, block), SAMPLES)
        except (FileNotFoundError, FormatError):
            return None

    def _remove(self, block: Block) -> None:
        for table in _SAMPLES_FIRST:  # half a block never looks finished
            self._path(table, block).unlink(missing_ok=True)

    def _set_block_aside(self, block: Block, mark: str = DAMAGED) -> None:
        for table in _SAMPLES_FIRST:
            set_aside(self._path(table, block), mark, prefix="_")


_PATCH = ("triangle", "barycentric", "weight")
_SAMPLES_FIRST = sorted(_FILES, key=lambda table: table is not SAMPLES)


def keeps(report: Report, block: Block) -> bool:
    """Whether a block of samples keeps its contact pairs, and its forces as they are: the first one always does."""
    return block.first == 0 or block.first < report.contacts


def versions() -> dict[str, str]:
    """Versions of what a number may depend on."""
    found = {"python": platform.python_version()}
    for name in ("mic-contact", "numpy", "scipy", "numba", "fenics-dolfinx", "petsc4py"):
        try:
            found[name] = version(name)
        except PackageNotFoundError:
            found[name] = "not installed"
    return found


def _aside(path: Path) -> str:
    aside = set_aside(path)
    return f"{path}: cut short or damaged; set aside as {aside.name if aside else path.name} and written anew."


def _kind_and_format(path: Path) -> tuple[Any, Any] | None:
    """Kind and format that a JSON file states, None where it states none; None for all where it cannot be read."""
    try:
        content = json.loads(path.read_text(encoding="utf-8"))
    except (OSError, ValueError, RecursionError):
        return None
    return (content.get("kind"), content.get("format")) if isinstance(content, dict) else (None, None)


def _parsed(law: str, name: str) -> Block:
    first, last = map(int, name.split("-"))
    return Block(law, first, last - first + 1)
