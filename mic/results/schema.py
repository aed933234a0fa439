"""Tables of a results folder: columns, types, units; ``python -m mic.results.schema`` prints the reference.

``schema.toml`` declares them; files are written, read and checked by this declaration. Keys (``stage``, ``zone``,
``measurement``) are columns, not parts of column names, so that tables can be filtered and grouped by them. Each CSV
file has its SHA-256 in a hidden file beside it, which ``sha256sum --check`` reads too: an altered digit would otherwise
be read as a number.
"""

from __future__ import annotations

import hashlib
import io
import tomllib
from contextlib import nullcontext
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import pandas as pd
from pandas.api import types

from mic.errors import FormatError
from mic.system.files import Format, Group, reading, replacing, together
from mic.system.regular_files import read_regular


@dataclass(frozen=True)
class Column:
    """One column of a table.

    Attributes
    ----------
    name : str
    dtype : {"bool", "int32", "int64", "float32", "float64", "category", "str"}
        ``category``: one of few names, stored as a code.
    unit : str
        Empty for names and counts.
    meaning : str
    optional : bool
        Whether a table may lack it: tangential quantities if only normal contact is modelled.
    shape : str
        Shape of one row's value; empty for a scalar.
    """

    name: str
    dtype: str
    unit: str
    meaning: str
    optional: bool = False
    shape: str = ""

    def fits(self, dtype: Any) -> bool:
        """Whether values have the declared type."""
        if self.dtype == "category":
            return isinstance(dtype, pd.CategoricalDtype)
        if self.dtype == "str":
            return types.is_object_dtype(dtype) or types.is_string_dtype(dtype)
        return str(dtype) == self.dtype


@dataclass(frozen=True)
class Table:
    """One table and the file or dataset that holds it.

    Attributes
    ----------
    name : str
        Name of the dataset's folder, or of the file under ``tables/``.
    rows : str
        Meaning of one row.
    columns : tuple of Column
    description : str
    place : str
        File, relative to the run folder.
    version : int
        Version of its columns and their meaning; files of another version are rejected with a message.
    """

    name: str
    rows: str
    columns: tuple[Column, ...]
    description: str
    place: str
    version: int = 1

    @property
    def names(self) -> list[str]:
        """Names of the columns, in order."""
        return [column.name for column in self.columns]

    def check(self, frame: pd.DataFrame, where: object, remedy: str) -> None:
        """Check a frame against the declaration.

        Parameters
        ----------
        frame : DataFrame
        where : path-like
            Location named in the message.
        remedy : str
            Remedy stated in the message.

        Raises
        ------
        FormatError
            For the first column that is missing, unknown, out of order, or of another type.
        """
        names = list(frame.columns)
        # All at once: reading dtypes column by column takes as long as writing the table.
        dtypes = dict(zip(names, frame.dtypes))
        for column in self.columns:
            if column.name not in dtypes:
                if column.optional:
                    continue
                raise FormatError(f"{where}: table {self.name!r} lacks the column {column.name!r}; {remedy}")
            if not column.fits(dtypes[column.name]):
                raise FormatError(
                    f"{where}: table {self.name!r}: column {column.name!r} holds {dtypes[column.name]}, "
                    f"expected {column.dtype}; {remedy}"
                )
        known = [name for name in self.names if name in names]
        if names != known:
            unexpected = next(name for name, expected in zip(names, [*known, None]) if name != expected)
            what = "is out of order" if unexpected in known else "is not declared"
            raise FormatError(f"{where}: table {self.name!r}: column {unexpected!r} {what}; {remedy}")

    def read(self, folder: Path, remedy: str) -> pd.DataFrame | None:
        """Read its CSV file from a run folder; None if there is no such file.

        Parameters
        ----------
        folder : Path
        remedy : str
            Remedy for a file that differs from the declaration.

        Raises
        ------
        FormatError
            Also for a file that is not as :meth:`write` wrote it.
        """
        path, format = folder / self.place, Format("table", 1, remedy)
        try:
            with reading(path, format):
                content = read_regular(path)
        except FileNotFoundError:
            return None
        floats = [column.name for column in self.columns if column.dtype == "float64"]
        with reading(path, format):
            checksum = checksum_path(path)
            if not checksum.is_file() or read_regular(checksum, 1000) != _checksum_line(path, content):
                raise ValueError("the checksum is wrong")
            frame = pd.read_csv(
                io.BytesIO(content),
                keep_default_na=False,  # a zone may be called NA
                converters=dict.fromkeys(floats, _exact),
                dtype={column.name: str for column in self.columns if column.dtype == "str"},
            )
            self.check(frame, path, remedy)
            return frame

    def write(self, folder: Path, frame: pd.DataFrame, exact: bool = False, group: Group | None = None) -> None:
        """Write its CSV file into a run folder, with nine digits or, if `exact`, all.

        `group` as for :func:`mic.system.files.replacing`.

        Raises
        ------
        FormatError
            If the frame differs from the declaration.
        """
        path = folder / self.place
        self.check(frame, path, "this is a fault of the program")
        content = frame.to_csv(index=False, float_format=None if exact else "%.9g").encode()
        with together() if group is None else nullcontext(group) as files:
            for file, text in ((checksum_path(path), _checksum_line(path, content)), (path, content)):
                with replacing(file, group=files) as temporary:
                    temporary.write_bytes(text)

    def remove(self, folder: Path) -> None:
        """Remove its CSV file from a run folder."""
        for file in (folder / self.place, checksum_path(folder / self.place)):
            file.unlink(missing_ok=True)

    def empty(self) -> pd.DataFrame:
        """An empty frame without the optional columns."""
        dtypes = {column.name: "object" if column.dtype == "str" else column.dtype for column in self.columns}
        return pd.DataFrame(
            {column.name: pd.Series([], dtype=dtypes[column.name]) for column in self.columns if not column.optional}
        )


def checksum_path(path: Path) -> Path:
    """The file with the checksum of a table."""
    return path.with_name(f".{path.name}.sha256")


def _exact(text: str) -> float:
    """The number that :meth:`Table.write` wrote, to the last bit; NaN if there is none."""
    return float(text) if text else float("nan")


def _checksum_line(path: Path, content: bytes) -> bytes:
    """The line of ``sha256sum`` for a file."""
    return f"{hashlib.sha256(content).hexdigest()}  {path.name}\n".encode()


def _columns(declared: dict[str, Any]) -> list[Column]:
    """The column, or the family of columns, that an entry of ``schema.toml`` declares."""
    entry: dict[str, Any] = {"type": "float64", "unit": "", "optional": False, "shape": ""} | declared
    name, unit, meaning, optional = (entry[key] for key in ("name", "unit", "meaning", "optional"))

    def number(suffix: str, text: str, unit: str = unit, optional: bool = optional) -> Column:
        return Column(f"{name}{suffix}", "float64", unit, text, optional)

    family = entry.get("family")
    if family is None:
        return [Column(name, entry["type"], unit, meaning, optional, entry["shape"])]
    if family == "before and after":
        change = f"`{name}_b` minus `{name}_a`, estimated from paired samples"
        sides = [number("_a", f"{meaning}, before"), number("_b", f"{meaning}, after")]
        return sides + _columns({"name": f"{name}_change", "family": "interval", "unit": unit, "meaning": change})
    interval = [
        number("", meaning),
        number("_low", f"lower end of the 95 % interval of `{name}`"),
        number("_high", f"upper end of the 95 % interval of `{name}`"),
    ]
    if family == "interval":
        return interval
    return interval + [
        number("_path", f"change of `{name}` on a tighter load path, see `path`", optional=False),
        number("_path_share", f"`{name}_path` relative to the value, see `path`", unit="1", optional=False),
    ]


def _table(key: str, entry: dict[str, Any]) -> Table:
    """The table that an entry of ``schema.toml`` declares."""
    name = entry.get("name", key)
    columns = tuple(column for declared in entry.get("columns", ()) for column in _columns(declared))
    place = f"{name}/law=LAW/FIRST-LAST.parquet" if entry.get("kind") == "dataset" else f"tables/{name}.csv"
    version = entry.get("version", 1)
    return Table(name, entry["rows"], columns, entry["description"], entry.get("place", place), version)


_DECLARED = tomllib.loads(Path(__file__).with_suffix(".toml").read_text(encoding="utf-8"))
_TABLES = {key.upper(): _table(key, entry) for key, entry in _DECLARED.items()}
__all__ = ["DATASETS", "STATISTICS", "STUDIES", "Column", "Table", "checksum_path", "reference", *_TABLES]


def __getattr__(name: str) -> Table:
    """Each table of ``schema.toml`` is an attribute of this module, its name in capitals."""
    if name not in _TABLES:
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
    return _TABLES[name]


def __dir__() -> list[str]:
    """Public names, tables included: for tab completion and the documentation."""
    return __all__


def _of_kind(kind: str) -> tuple[Table, ...]:
    """The tables of a kind, in the order of ``schema.toml``."""
    return tuple(_TABLES[key.upper()] for key, entry in _DECLARED.items() if entry.get("kind") == kind)


#: Parquet datasets in the order of writing: samples last, because they mark a block as finished.
DATASETS = tuple(sorted(_of_kind("dataset"), key=lambda table: table.name == "samples"))
#: CSV tables of a run.
STATISTICS = _of_kind("statistic")
#: CSV tables that separate commands add to a run folder.
STUDIES = _of_kind("study")


def reference() -> str:
    """The reference of the results folder, in Markdown."""
    from jinja2 import Template  # not needed to read tables

    datasets = _of_kind("dataset")
    names = ("SUMS", "FORCES", "CONDENSED", "ONE_STEP", "FIELDS")
    sums, forces, condensed, one_step, fields = (_TABLES[key] for key in names)
    sections = {"Datasets": datasets, "Statistics": STATISTICS, "Studies": STUDIES, "Fields": (forces, fields)}
    text = Path(__file__).with_name("reference.jinja").read_text(encoding="utf-8")
    template = Template(text, keep_trailing_newline=True)
    files = (*datasets, sums, forces, condensed, one_step, fields, *STATISTICS, *STUDIES)
    return template.render(files=files, sections=sections)


if __name__ == "__main__":
    print(reference(), end="")
