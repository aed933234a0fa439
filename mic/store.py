"""Files that survive: written whole or not at all, and read back only as what they are.

Every file that the program reads again goes through here. A reader sees the old content or the new, never a half;
what it meets instead (an older or newer format, a foreign file, one cut short or altered) ends in one sentence that
says so.
"""

from __future__ import annotations

import hashlib
import json
import os
import zipfile
import zlib
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from mic.errors import FormatError

__all__ = ["PARTIAL", "Format", "load_arrays", "load_json", "replacing", "save_arrays", "save_json", "write_text"]

PARTIAL = ".partial"  # stands in the name of every file that is being written, and of none that is finished


@dataclass(frozen=True)
class Format:
    """Kind and version of a file's content.

    Attributes
    ----------
    kind : str
        In words, such as ``"reduced model"``; stands in the file and in messages.
    version : int
        Raised whenever an older reader would misread the content.
    remedy : str
        What to do about a file that cannot be read, such as ``"build the model again"``.
    """

    kind: str
    version: int
    remedy: str

    def check(self, path: Path, header: Any) -> None:
        """Raise :class:`FormatError` unless a file's header names this very format."""
        if not isinstance(header, dict) or header.get("kind") != self.kind or not isinstance(header.get("format"), int):
            raise FormatError(f"{path}: this is no {self.kind}; {self.remedy}")
        if header["format"] != self.version:
            age = "an older" if header["format"] < self.version else "a newer"
            raise FormatError(
                f"{path}: this {self.kind} was written by {age} version of the program (format {header['format']}, "
                f"this version reads {self.version}); {self.remedy}"
            )

    def damaged(self, path: Path) -> FormatError:
        """The error of a file that was cut short or altered."""
        return FormatError(f"{path}: this {self.kind} is cut short or damaged; {self.remedy}")


@contextmanager
def replacing(path: Path) -> Iterator[Path]:
    """A temporary path beside `path`, of the same suffix, that takes its place once the block has ended well.

    The content is on disk before the name changes; after an error the old file stands untouched and nothing is left
    behind.
    """
    path = Path(path)
    path.parent.mkdir(parents=True, exist_ok=True)
    temporary = path.with_name(f".{path.stem}.{os.getpid()}{PARTIAL}{path.suffix}")
    try:
        yield temporary
        with open(temporary, "rb") as file:
            os.fsync(file.fileno())
        temporary.replace(path)
    finally:
        temporary.unlink(missing_ok=True)


def write_text(path: Path, text: str) -> None:
    """Write a text file, UTF-8."""
    with replacing(path) as temporary:
        temporary.write_text(text, encoding="utf-8")


def save_json(path: Path, format: Format, content: Mapping[str, Any]) -> None:
    """Write a dict; its keys must not be ``kind`` or ``format``, which name the format."""
    document = {"kind": format.kind, "format": format.version, **content}
    write_text(path, json.dumps(document, indent=2, allow_nan=False) + "\n")


def load_json(path: Path, format: Format) -> dict[str, Any]:
    """Read what :func:`save_json` wrote.

    Raises
    ------
    FileNotFoundError
    FormatError
    """
    try:
        document = json.loads(Path(path).read_text(encoding="utf-8"))
    except ValueError:
        raise format.damaged(path) from None
    format.check(path, document)
    return {key: value for key, value in document.items() if key not in ("kind", "format")}


def save_arrays(path: Path, format: Format, header: Mapping[str, Any], arrays: Mapping[str, np.ndarray]) -> None:
    """Write named arrays, and a JSON-ready header beside them, to one ``.npz`` file with a checksum over all of it."""
    arrays = {name: np.asarray(array) for name, array in arrays.items()}
    document = {"kind": format.kind, "format": format.version, **header}
    document["checksum"] = _checksum(document, arrays)
    with replacing(path) as temporary:
        np.savez_compressed(temporary, header=np.array(json.dumps(document)), **arrays)  # type: ignore[arg-type]


def load_arrays(path: Path, format: Format) -> tuple[dict[str, Any], dict[str, np.ndarray]]:
    """Header and arrays that :func:`save_arrays` wrote. No content of the file is ever executed.

    Raises
    ------
    FileNotFoundError
    FormatError
    """
    try:
        with np.load(Path(path), allow_pickle=False) as data:
            arrays = {name: data[name] for name in data.files}
        document = json.loads(str(arrays.pop("header")))
    except FileNotFoundError:
        raise
    except (ValueError, KeyError, OSError, EOFError, TypeError, zipfile.BadZipFile, zlib.error):
        raise format.damaged(path) from None
    format.check(path, document)
    checksum = document.pop("checksum", None)
    if checksum != _checksum(document, arrays):
        raise format.damaged(path)
    return {key: value for key, value in document.items() if key not in ("kind", "format")}, arrays


def _checksum(document: Mapping[str, Any], arrays: Mapping[str, np.ndarray]) -> str:
    digest = hashlib.sha256(json.dumps(document, sort_keys=True).encode())
    for name in sorted(arrays):
        array = np.ascontiguousarray(arrays[name])
        digest.update(repr((name, array.shape, array.dtype.str)).encode())
        digest.update(array.tobytes())
    return digest.hexdigest()
