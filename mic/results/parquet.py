"""One table of one block as a Parquet file, with units, format and identity in its metadata.

Between the columns and the footer stands the SHA-256 of all other bytes, a gap that other readers skip. It is verified
before the file is parsed: Parquet's own checksums cover neither the footer nor the headers of pages, and altered ones
can crash the process.
"""

from __future__ import annotations

import hashlib
import io
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any

import pandas as pd
import pyarrow as pa
import pyarrow.parquet as pq

from mic.results.schema import DATASETS, Table
from mic.system.files import Format, Group, reading, replacing
from mic.system.regular_files import read_regular

__all__ = ["read_identity", "read_names", "read_table", "with_digest", "write_table"]

MAGIC, LENGTH, DIGEST = b"PAR1", 4, 32  # end of a Parquet file; bytes of the length before it, and of a SHA-256
_AGAIN = "run the scene again into this folder"
_FORMATS = {table.name: Format(f"block of {table.name}", table.version, _AGAIN) for table in DATASETS}


def write_table(
    path: Path,
    table: Table,
    frame: pd.DataFrame,
    identity: str,
    names: Sequence[str] = (),
    group: Group | None = None,
) -> None:
    """Write a table as Parquet, with units, format and the identity of its run in the metadata.

    `names` are those of all tables that are written with it; `group` as for :func:`mic.system.files.replacing`.

    Raises
    ------
    FormatError
        If the frame differs from the declaration.
    """
    table.check(frame, path, "this is a fault of the program")
    columns = [column for column in table.columns if column.name in frame]
    # Column by column: pa.Table.from_pandas takes as long as writing the file.
    arrays = [_arrow(frame[column.name].array) for column in columns]
    fields = [
        pa.field(column.name, array.type, metadata={"unit": column.unit, "meaning": column.meaning})
        for column, array in zip(columns, arrays)
    ]
    kind = _FORMATS[table.name]
    header = {"kind": kind.kind, "format": str(kind.version), "identity": identity, "tables": " ".join(names)}
    content = pa.Table.from_arrays(arrays, schema=pa.schema(fields, header))
    floats = [column.name for column in columns if column.dtype.startswith("float")]  # these rarely repeat
    others = [column.name for column in columns if column.name not in floats]
    buffer = io.BytesIO()
    pq.write_table(content, buffer, use_dictionary=others, use_byte_stream_split=floats, compression="zstd")
    with replacing(path, group=group) as temporary:
        temporary.write_bytes(with_digest(buffer.getvalue()))


def with_digest(content: bytes) -> bytes:
    """The bytes of a Parquet file with their SHA-256 before the footer."""
    footer = _footer(content)
    return content[:footer] + hashlib.sha256(content).digest() + content[footer:]


def _verified(content: bytes) -> bytes:
    """The bytes of a file of :func:`write_table` if they are unaltered.

    Raises
    ------
    ValueError
    """
    footer = _footer(content)
    columns = max(footer - DIGEST, 0)
    if content[columns:footer] != hashlib.sha256(content[:columns] + content[footer:]).digest():
        raise ValueError("the checksum is wrong")
    return content


def _footer(content: bytes) -> int:
    """Offset of the footer of a Parquet file."""
    length, magic = content[-LENGTH - len(MAGIC) : -len(MAGIC)], content[-len(MAGIC) :]
    footer = len(content) - len(MAGIC) - LENGTH - int.from_bytes(length, "little")
    if magic != MAGIC or footer < 0:
        raise ValueError("this is no Parquet file")
    return footer


def _arrow(values: Any) -> pa.Array:
    """Values of one column as an Arrow array; missing names and numbers are null."""
    if isinstance(values, pd.Categorical):
        names = pa.array(values.categories, pa.string())
        return pa.DictionaryArray.from_arrays(pa.array(values.codes, pa.int32()), names, from_pandas=True)
    return pa.array(values.to_numpy(), from_pandas=True)


def read_table(path: Path, table: Table) -> tuple[pd.DataFrame, str]:
    """The table in a file of :func:`write_table`, and the identity of its run.

    Raises
    ------
    FileNotFoundError
    FormatError
        If the file differs from the declaration, or is truncated or altered.
    """
    identity, frame = _read(path, table, lambda file: file.read().to_pandas())
    table.check(frame, path, _AGAIN)
    return frame, identity


def read_identity(path: Path, table: Table) -> str:
    """Identity of a table's run.

    Raises
    ------
    FileNotFoundError
    FormatError
        If the file is of another kind, truncated or altered.
    """
    return _read(path, table, lambda file: None)[0]


def read_names(path: Path, table: Table) -> list[str]:
    """Names of the tables that were written with a table; errors as :func:`read_identity`."""
    return _read(path, table, lambda file: file.schema_arrow.metadata[b"tables"].decode().split())[1]


def _read(path: Path, table: Table, read: Callable[[pq.ParquetFile], Any]) -> tuple[str, Any]:
    """Identity in a file, and what `read` takes from it."""
    kind = _FORMATS[table.name]
    with reading(path, kind), pq.ParquetFile(pa.BufferReader(_verified(read_regular(path)))) as file:
        header = _header(file.schema_arrow)
        kind.check(path, header)
        return str(header["identity"]), read(file)


def _header(schema: pa.Schema) -> dict[str, object]:
    """Kind, format and identity in the metadata."""
    entries = {key.decode(): value.decode() for key, value in (schema.metadata or {}).items()}
    number = entries.get("format", "")
    return {
        "kind": entries.get("kind"),
        "format": int(number) if number.isdigit() else None,
        "identity": entries.get("identity", ""),
    }
