"""Read and write the folder of a run, and check that its files belong to it.

The folder is readable at any moment, and the same command completes an interrupted run. Every file of a block carries
the identity of its run (:mod:`mic.results.run_identity`), its law and its samples. Unreadable blocks, and blocks of
another run or of other samples, count as missing. Results of another run are removed only with `--replace`, and only
files that the program wrote.

========================================= ==============================================================================
``.lock``                                 process that is writing to the folder
``run.json``                              record: scene, samples, seed, laws, identity, inputs, versions, wall time
``model.npz``                             the reduced model
``parts.npz``, ``paper.toml``             further inputs of fields and report
``TABLE/law=LAW/FIRST-LAST.parquet``      the datasets of :data:`mic.results.schema.DATASETS`, one file per block
``sums/law=LAW/FIRST-LAST.npz``           moments of a block without stored contact pairs
``forces/law=LAW/FIRST-LAST.npz``         forces and motions in the last stage, if fields are requested
``condensed/law=LAW/FIRST-LAST.npz``      low-rank factor of the forces of such a block
``one_step/law=LAW/FIRST-LAST.npz``       deviations and outputs of samples in one step
``tables/*.csv``, ``summary.json``        statistics; ``tables/.NAME.csv.sha256``: their checksums
``fields/``                               displacement fields
========================================= ==============================================================================

The file under ``samples`` is written last: if it exists, the block is complete. The first blocks store their contact
pairs and forces (:func:`stores_pairs`). A block of which only a part is requested is used if it has its pairs;
otherwise its samples are evaluated again.

General-purpose code: atomic writes, checksums and locks are those of :mod:`mic.system`, which says why they are not a
library's; Parquet is pyarrow's. ``pyarrow.dataset`` and pandas can read the partitions ``law=LAW``. Blocks are listed
and checked here, because such a reader fails as a whole if one file is damaged and does not compare identities.
"""

from __future__ import annotations

import platform
import re
from collections.abc import Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass
from importlib.metadata import requires
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd

from mic.compliance.part import Part
from mic.errors import FormatError, RunError
from mic.results.contact_sums import ContactSums
from mic.results.low_rank_forces import CompressedForces, pack_forces, unpack_forces
from mic.results.output_samples import OutputSamples
from mic.results.parquet import read_identity, read_names, read_table, write_table
from mic.results.run_identity import NOT_INSTALLED, differences, installed_version, program_version
from mic.results.schema import (
    CONDENSED,
    CONTACTS,
    DATASETS,
    FORCES,
    ONE_STEP,
    SAMPLES,
    STATISTICS,
    STUDIES,
    SUMS,
    Table,
)
from mic.results.stored_parts import pack_parts, unpack_parts
from mic.scene.schema import Report
from mic.statistics.estimates import Moments
from mic.system import foreign_files
from mic.system.files import (
    DAMAGED,
    Format,
    Group,
    arrays_header,
    clean,
    fingerprint,
    json_header,
    load_arrays,
    load_json,
    reading,
    save_arrays,
    save_json,
    set_aside,
    together,
    write_text,
)
from mic.system.memoise import pack, unpack

__all__ = ["EXCEL", "FOREIGN", "PUBLISHED", "Block", "RunFolder", "stores_pairs", "versions"]

PUBLISHED = "paper.toml"  # published values, for comparison with the results
EXCEL = "tables.xlsx"  # the tables in one workbook
FOREIGN = ".other-run"  # suffix of a block of another run that was set aside

_AGAIN = "run the scene again into this folder"
_REPLACE = "name another folder with --out, or remove the old results (mic run does so with --replace)"
_OTHER_BLOCK = f"this block belongs to another run, or holds other samples; {_AGAIN}"
_RUN = Format("record of a run", 5, _AGAIN)
_PARTS = Format("set of parts", 5, _AGAIN)
_FORMATS = {
    SUMS: Format("sums of a block", 2, _AGAIN),
    FORCES: Format("block of forces", 2, _AGAIN),
    CONDENSED: Format("block of condensed forces", 2, _AGAIN),
    ONE_STEP: Format("block of samples in one step", 1, _AGAIN),
}
#: Types of the entries of the record.
_RECORD = {"scene": str, "samples": int, "laws": list, "versions": dict, "inputs": dict, "wall_time": dict, "seed": int}
_REPORT = ("report.html", "assembly.png")
_SINGLE = ("model.npz", "parts.npz", "summary.json", *_REPORT, EXCEL, PUBLISHED)
_TABLES = tuple(table.place for table in (*STATISTICS, *STUDIES))
_FIELDS = "fields/fields.npz"
_ARRAYS = (SUMS, FORCES, CONDENSED)
_BLOCK_TABLES = (SAMPLES, *(table for table in DATASETS if table is not SAMPLES), *_ARRAYS)  # in order of removal
_WITH_FOLDER = (*_BLOCK_TABLES, ONE_STEP)
_BLOCK_NAME = re.compile(r"(\d{6,})-(\d{6,})")


@dataclass(frozen=True, order=True)
class Block:
    """Samples that are evaluated and stored together.

    Attributes
    ----------
    law : str
    first, count : int
        Number of the first sample, and number of samples.
    """

    law: str
    first: int
    count: int

    @property
    def end(self) -> int:
        """Number of the last sample plus one."""
        return self.first + self.count

    @property
    def name(self) -> str:
        """Stem of the block's files."""
        return f"{self.first:06d}-{self.end - 1:06d}"

    def stamp(self, identity: str) -> str:
        """Metadata of its files: the identity of run, law and samples, which reveals exchanged files."""
        return f"{identity} {self.law} {self.name}"


@dataclass(frozen=True)
class RunFolder:
    """The folder of a run.

    Attributes
    ----------
    path : Path
    """

    path: Path

    # ---------------------------------------------------------------------------------------------- record

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
        inputs = record.get("inputs", {})
        wrong = [key for key, kind in _RECORD.items() if not isinstance(record.get(key, kind()), kind)]
        if (
            wrong
            or not {"scene", "samples", "laws", "versions"} <= set(record)
            or not all(isinstance(law, str) for law in record["laws"])
            or record.get("identity") != fingerprint(inputs)
            or record.get("seed") != inputs.get("seed")
        ):
            raise _RUN.damaged(self.path / "run.json")
        return record

    def write_record(self, record: Mapping[str, Any]) -> None:
        """Write ``run.json``."""
        save_json(self.path / "run.json", _RUN, record)

    def add_to_record(self, key: str, values: Mapping[str, Any]) -> dict[str, Any]:
        """Add entries to a table of the record, replacing those of the same names; returns the record."""
        record = self.record()
        record[key] = record.get(key, {}) | values
        self.write_record(record)
        return record

    def remove_report(self) -> None:
        """Remove the page and its picture."""
        for name in _REPORT:
            (self.path / name).unlink(missing_ok=True)

    # ---------------------------------------------------------------------------------------------- preparation

    def prepare(self, record: Mapping[str, Any], report: Report, replace: bool = False) -> list[str]:
        """Prepare the folder for a run, or refuse it. The caller holds its lock and has written nothing yet.

        Finished samples of the same run stay, whatever their number and law. Unreadable files are set aside. A folder
        of another run is refused; with `replace`, the files that a run writes are removed from it.

        Parameters
        ----------
        record : dict
            The new ``run.json``, with its ``"identity"`` and ``"inputs"``.
        report : mic.scene.schema.Report
            States which blocks store forces and contact pairs.
        replace : bool
            Whether results of another run may be removed.

        Returns
        -------
        list of str
            One sentence for each file that could not be read or was removed.

        Raises
        ------
        RunError
            If the folder holds another run, or foreign files under names that the run would write.
        """
        self._refuse_links()
        clean(self._folders(), alone=True)
        old, sentences = self._old_record(replace)
        same_run = old is not None and old.get("identity") == record["identity"]
        if old is None:
            sentences += self._check_without_record(record["identity"], replace)
        elif not same_run:
            if not replace:
                raise RunError(self._other_run(differences(old.get("inputs") or {}, record["inputs"])))
            sentences += self._clear()
        for name in ("model.npz", "parts.npz", _FIELDS):
            path = self.path / name
            if path.is_file() and not arrays_header(path):
                sentences.append(_set_aside(path))
        sentences += self._check_blocks(record, report)
        wall_time = {"wall_time": old["wall_time"]} if same_run and old and "wall_time" in old else {}
        self.write_record(wall_time | dict(record))
        return sentences

    def _old_record(self, replace: bool) -> tuple[dict[str, Any] | None, list[str]]:
        """The record, None if missing or damaged, {} if of another version; and sentences for the user."""
        path = self.path / "run.json"
        if not path.is_file():
            return None, []
        try:
            return self.record(), []
        except FormatError as problem:
            header = json_header(path)
            if header is not None and header.get("kind") != _RUN.kind:
                raise RunError(f"{path}: is not the record of a run; name another folder with --out") from None
            if header is None or header.get("format") == _RUN.version:
                return None, [_set_aside(path)]
            if not replace:
                raise RunError(f"{str(problem).partition(';')[0]}; {_REPLACE}") from None
            return {}, []

    def _check_without_record(self, identity: str, replace: bool) -> list[str]:
        """Check a folder without a record: all its blocks must belong to the requested run; returns sentences."""
        blocks = self._blocks_with(SAMPLES)
        stamps = {block: self._stamp(block) for block in blocks}
        own = [block for block, stamp in stamps.items() if stamp == block.stamp(identity)]
        if any(stamp is not None and block not in own for block, stamp in stamps.items()):
            if not replace:
                raise RunError(self._other_run(["run.json is missing, and its samples are not the requested ones"]))
            return self._clear()
        if own:
            return [f"{self.path}: run.json is missing and is written again: its samples are the requested ones."]
        existing = [name for name in (*_SINGLE, *_TABLES) if (self.path / name).exists()]
        written_by_run = any(arrays_header(self.path / name) for name in ("model.npz", "parts.npz"))
        if existing and not blocks and not written_by_run:
            raise RunError(
                f"{self.path / existing[0]}: was not written by a run, and a run would replace it; name another folder "
                "with --out"
            )
        return []

    def _other_run(self, reasons: Sequence[str]) -> str:
        """The error message for a folder of another run."""
        return f"{self.path}: holds another run ({'; '.join(reasons) or 'of another identity'}); {_REPLACE}"

    def _check_blocks(self, record: Mapping[str, Any], report: Report) -> list[str]:
        """Set aside incomplete and foreign blocks that the run would use; returns sentences."""
        sentences = []
        for block in self._all_blocks():
            path = self._path(SAMPLES, block)
            if block.law not in record["laws"] or block.first >= record["samples"] or not path.is_file():
                continue
            try:
                if read_identity(path, SAMPLES) != block.stamp(record["identity"]):
                    self._set_block_aside(block, FOREIGN)
                    sentences.append(f"{path}: belongs to another run, or holds other samples; set aside ({FOREIGN}).")
                    continue
                self._check_complete(block, record["identity"], report)
            except FormatError as problem:
                self._set_block_aside(block)
                sentences.append(f"{problem}. The block is set aside and computed again.")
        return sentences

    def _check_complete(self, block: Block, identity: str, report: Report) -> None:
        """Raise FormatError unless a finished block has all files that statistics and fields need."""
        tables, forces = self.read_block(block, identity), self.read_arrays(FORCES, block, identity)
        if CONTACTS.name not in tables:
            self.read_arrays(SUMS, block, identity)
            if stores_pairs(report, block):
                raise self._missing(CONTACTS, block)
        if report.fields and forces is None:
            if stores_pairs(report, block) or not self.read_arrays(CONDENSED, block, identity):
                raise self._missing(FORCES, block)

    def _missing(self, table: Table, block: Block) -> FormatError:
        return FormatError(f"{self._path(table, block)}: this file of a finished block is missing")

    def _refuse_links(self) -> None:
        """Refuse symbolic links: they could lead out of the folder."""
        names = ("run.json", *_SINGLE, *(table.name for table in _WITH_FOLDER))
        for place in (*(self.path / name for name in names), *self._folders()[1:]):
            if place.is_symlink():
                raise RunError(f"{place}: is a link, and a run writes to its own folder only; remove the link")

    def _folders(self) -> list[Path]:
        """Folders that hold files of a run."""
        partitions = [path for table in _WITH_FOLDER for path in (self.path / table.name).glob("law=*")]
        return [self.path, self.path / "tables", self.path / "fields", *partitions]

    def _clear(self) -> list[str]:
        """Remove the files that a run writes, by name, and folders that are then empty; the record last."""
        for name in arrays_header(self.path / _FIELDS).get("files", []):
            if Path(name).name == name and name.endswith(".vtu"):
                (self.path / "fields" / name).unlink(missing_ok=True)
        for block in self._all_blocks():
            self._remove(block)
        for block in self._blocks_with(ONE_STEP):
            self._path(ONE_STEP, block).unlink()
        for table in (*STATISTICS, *STUDIES):
            table.remove(self.path)
        for name in (*_SINGLE, _FIELDS, "run.json"):
            (self.path / name).unlink(missing_ok=True)
        for folder in sorted({*self._folders(), *(self.path / table.name for table in _WITH_FOLDER)}, reverse=True):
            if folder != self.path:
                with suppress(OSError):  # it holds other files
                    folder.rmdir()
        return [f"{self.path}: the results of another run were removed."]

    # ---------------------------------------------------------------------------------------------- blocks of samples

    def write_block(
        self,
        block: Block,
        identity: str,
        tables: Mapping[str, pd.DataFrame],
        arrays: Mapping[Table, Any] | None = None,
    ) -> None:
        """Write a finished block atomically.

        Parameters
        ----------
        block : Block
        identity : str
            Identity of the run.
        tables : dict of str to DataFrame
            The datasets of :data:`mic.results.schema.DATASETS`.
        arrays : dict of Table, optional
            By :data:`mic.results.schema.FORCES`: `force` (n, F) and `motion` (n, 6P). By ``SUMS``: the `ContactSums`
            that replace the contact pairs. By ``CONDENSED``: the `CompressedForces` that replace the forces, by part.
        """
        with together() as group:
            for table, content in (arrays or {}).items():
                self._write_arrays(table, block, identity, content, group)
            written = [table for table in DATASETS if table is SAMPLES or len(tables.get(table.name, ()))]
            names = [table.name for table in written] + [CONTACTS.name] * (SUMS in (arrays or {}))
            for table in written:  # samples last: they mark the block as finished, and list the tables with rows
                write_table(self._path(table, block), table, tables[table.name], block.stamp(identity), names, group)
        for other in self._blocks_with(SAMPLES, block.law):  # the last block of a shorter run is part of this one
            contained = block.first <= other.first and other.end <= block.end
            if other != block and contained and self._stamp(other) == other.stamp(identity):
                self._remove(other)

    def blocks(self, law: str, samples: int | None = None) -> list[Block]:
        """The finished blocks of a law in ascending order, without overlap.

        Blocks overlap if a longer run was stopped right after it wrote one; the larger block is used.

        Parameters
        ----------
        law : str
        samples : int, optional
            Number of requested samples: later blocks are left out, and so is a block that has further samples, unless
            it has its contact pairs.
        """
        usable = [
            block
            for block in self._blocks_with(SAMPLES, law)
            if samples is None or block.end <= samples or (block.first < samples and self.has_pairs(block))
        ]
        covered = np.zeros(max((block.end for block in usable), default=0), dtype=bool)
        chosen = []
        for block in sorted(usable, key=lambda block: (-block.count, block.first)):
            if not covered[block.first : block.end].any():
                covered[block.first : block.end] = True
                chosen.append(block)
        return sorted(chosen)

    def has_pairs(self, block: Block) -> bool:
        """Whether a block has its contact pairs, if there are any, and not their sums."""
        return self._path(CONTACTS, block).is_file() or not self._path(SUMS, block).is_file()

    def finished(self, law: str, samples: int) -> np.ndarray:
        """Numbers of the finished samples of a law, ascending, for a number of requested samples."""
        numbers = [np.arange(block.first, block.end) for block in self.blocks(law, samples)]
        return np.concatenate(numbers) if numbers else np.zeros(0, dtype=int)

    def read_block(self, block: Block, identity: str) -> dict[str, pd.DataFrame]:
        """Tables of a finished block by name; without its contact pairs if it has their sums.

        Raises
        ------
        FormatError
            If a file is missing, cannot be read, or belongs to another run.
        """
        names = [table.name for table in DATASETS if table is not CONTACTS or self.has_pairs(block)]
        return {name: self.read_dataset(block, name, identity) for name in names}

    def read_dataset(self, block: Block, name: str, identity: str) -> pd.DataFrame:
        """One dataset of a finished block, empty if the block had no rows of it; errors as :meth:`read_block`."""
        table = next(table for table in DATASETS if table.name == name)
        path = self._path(table, block)
        try:
            frame, stored = read_table(path, table)
        except FileNotFoundError:
            samples = self._path(SAMPLES, block)
            if table is not SAMPLES and samples.is_file() and table.name not in read_names(samples, SAMPLES):
                return table.empty()
            raise FormatError(f"{self._missing(table, block)}; {_AGAIN}") from None
        if stored != block.stamp(identity):
            raise FormatError(f"{path}: {_OTHER_BLOCK}")
        return frame

    def read_arrays(self, table: Table, block: Block, identity: str) -> Any:
        """The `arrays` that :meth:`write_block` stored for a table, or None. Errors as :meth:`read_block`."""
        path = self._path(table, block)
        try:
            header, arrays = load_arrays(path, _FORMATS[table])
        except FileNotFoundError:
            return None
        with reading(path, _FORMATS[table]):
            if header["identity"] != block.stamp(identity):
                raise FormatError(f"{path}: {_OTHER_BLOCK}")
            types = (ContactSums, Moments, CompressedForces, OutputSamples)
            return unpack_forces(arrays) if table == FORCES else unpack(header["content"], arrays, types, {})

    def write_one_step(self, block: Block, identity: str, samples: OutputSamples) -> None:
        """Write a block of samples in one step."""
        self._write_arrays(ONE_STEP, block, identity, samples)

    def _write_arrays(
        self, table: Table, block: Block, identity: str, content: Any, group: Group | None = None
    ) -> None:
        packed, arrays = pack_forces(content) if table == FORCES else pack(content, {})
        header = {"identity": block.stamp(identity), "content": packed}
        save_arrays(self._path(table, block), _FORMATS[table], header, arrays, group=group)

    def one_step(self, law: str, identity: str) -> dict[Block, OutputSamples]:
        """The samples in one step of a law by block, in ascending order; blocks that cannot be read are left out."""
        blocks: dict[Block, OutputSamples] = {}
        for block in sorted(self._blocks_with(ONE_STEP, law)):
            with suppress(FormatError):
                blocks[block] = self.read_arrays(ONE_STEP, block, identity)
        return blocks

    # ---------------------------------------------------------------------------------------------- stored inputs

    def store_inputs(self, assembly) -> None:
        """Copy further inputs of fields and report into a prepared folder, so that it can be read on any machine.

        These are the parts with their retained functionals (``parts.npz``) and, if the scene's folder has one, the
        published values (``paper.toml``).

        Parameters
        ----------
        assembly : mic.model.assembly.Assembly
        """
        content, arrays = pack_parts(assembly.parts)
        save_arrays(
            self.path / "parts.npz", _PARTS, {"identity": self.record()["identity"], "content": content}, arrays
        )
        published = assembly.scene.folder / PUBLISHED
        if published.is_symlink() or published.is_file():
            with foreign_files.reading(published, "table of published values", assembly.scene.folder):
                content = published.read_text(encoding="utf-8")
            write_text(self.path / PUBLISHED, content)

    def parts(self) -> tuple[Part, ...]:
        """The parts as :meth:`store_inputs` wrote them; none if it was not called.

        Raises
        ------
        FormatError
            If the file cannot be read, or belongs to another run.
        """
        path = self.path / "parts.npz"
        try:
            header, arrays = load_arrays(path, _PARTS)
        except FileNotFoundError:
            return ()
        with reading(path, _PARTS):
            if header["identity"] != self.record()["identity"]:
                raise FormatError(f"{path}: belongs to another run; {_AGAIN}")
            return unpack_parts(header["content"], arrays)

    # ---------------------------------------------------------------------------------------------- files of a block

    def _path(self, table: Table, block: Block) -> Path:
        return self.path / table.name / f"law={block.law}" / f"{block.name}{Path(table.place).suffix}"

    def _blocks_with(self, table: Table, law: str = "*") -> list[Block]:
        """The blocks of one or all laws that have a file of a table."""
        blocks = []
        for path in (self.path / table.name).glob(f"law={law}/*{Path(table.place).suffix}"):
            if name := _BLOCK_NAME.fullmatch(path.stem):
                first, last = int(name[1]), int(name[2])
                blocks.append(Block(path.parent.name.removeprefix("law="), first, last - first + 1))
        return blocks

    def _all_blocks(self) -> list[Block]:
        """All blocks with any file, finished or not."""
        return sorted({block for table in _BLOCK_TABLES for block in self._blocks_with(table)})

    def _stamp(self, block: Block) -> str | None:
        """Metadata of the files of a block; None if the block is not finished or cannot be read."""
        try:
            return read_identity(self._path(SAMPLES, block), SAMPLES)
        except (FileNotFoundError, FormatError):
            return None

    def _remove(self, block: Block) -> None:
        """Remove the files of a block, samples first, so that it never looks finished."""
        for table in _BLOCK_TABLES:
            self._path(table, block).unlink(missing_ok=True)

    def _set_block_aside(self, block: Block, mark: str = DAMAGED) -> None:
        for table in _BLOCK_TABLES:
            set_aside(self._path(table, block), mark, prefix="_")


def stores_pairs(report: Report, block: Block) -> bool:
    """Whether a block stores its contact pairs and uncompressed forces; the first block always does."""
    return block.first == 0 or block.first < report.contacts


_TASKS = ("test", "check", "docs")  # extras of development, without effect on results


def versions() -> dict[str, str]:
    """Versions of Python, of this program and of its direct dependencies; those that are installed."""
    found = {"python": platform.python_version(), "mic-contact": program_version()}
    for requirement in requires("mic-contact") or () if found["mic-contact"] != NOT_INSTALLED else ():
        name, extra = re.match(r"[\w.-]+", requirement), re.search(r"extra == .(\w+)", requirement)
        if name and not (extra and extra.group(1) in _TASKS):
            found[name.group()] = installed_version(name.group())
    return {name: text for name, text in found.items() if text != NOT_INSTALLED}


def _set_aside(path: Path) -> str:
    """Set a damaged file aside; returns a sentence for the user."""
    aside = set_aside(path)
    return f"{path}: cut short or damaged; set aside as {aside.name if aside else path.name} and written again."
