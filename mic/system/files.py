"""Atomic file writes, and readers that verify kind, version and checksum.

All files that the program reads again are written and read by this module. A reader sees the old content or the new,
never a part; a file of another format, or one that is truncated or altered, raises an error of one sentence. Whatever
goes wrong while reading, :func:`reading` says that the file is damaged: it keeps no list of exceptions.

Not the library ``atomicwrites``, which is unmaintained: several files must be replaced as a group, with ``fsync``, and
partial files of killed processes must be recognised and removed.
"""

from __future__ import annotations

import hashlib
import json
import os
import re
import socket
import zipfile
import zlib
from collections.abc import Iterable, Iterator, Mapping
from concurrent.futures import ThreadPoolExecutor
from contextlib import contextmanager, suppress
from dataclasses import dataclass
from pathlib import Path
from types import MappingProxyType
from typing import Any

import numpy as np

from mic.errors import FormatError, MicError, StorageError
from mic.system.array_archive import read_archive
from mic.system.lock import exclusive
from mic.system.regular_files import open_regular, read_regular

__all__ = [
    "DAMAGED",
    "JSON_LIMIT",
    "PARTIAL",
    "Format",
    "Group",
    "append_text",
    "arrays_header",
    "clean",
    "fingerprint",
    "load_arrays",
    "json_header",
    "load_json",
    "read_line",
    "reading",
    "replacing",
    "save_arrays",
    "save_json",
    "set_aside",
    "to_line",
    "together",
    "write_text",
]

PARTIAL = ".partial"  # part of the name of every file that is being written, and of no complete one
DAMAGED = ".damaged"  # suffix of a file that could not be read and was renamed

JSON_LIMIT = 1 << 25  # characters of a JSON document: a hundred times the largest header of the shipped scenes

PARALLEL_SYNCS = 16  # files synchronised to disk at a time: hardly slower than one

_DESCRIPTION = ("kind", "format", "checksum")
_HOST = f"{zlib.crc32(socket.gethostname().encode()):08x}"
_PARTIAL_NAME = re.compile(rf"\..+\.([0-9a-f]{{8}})-(\d+){re.escape(PARTIAL)}(\.\w+)?")


@dataclass(frozen=True)
class Format:
    """Kind and version of a file's content.

    Attributes
    ----------
    kind : str
        Such as ``"reduced model"``; written to the file and used in messages.
    version : int
        Increased whenever an older reader would misread the content.
    remedy : str
        Remedy for a file that cannot be read, such as ``"build the model again"``.
    """

    kind: str
    version: int
    remedy: str

    def check(self, path: Path, header: Any) -> None:
        """Raise :class:`FormatError` unless the header has this kind and version."""
        if not isinstance(header, dict) or header.get("kind") != self.kind or not isinstance(header.get("format"), int):
            raise FormatError(f"{path}: this is no {self.kind}; {self.remedy}")
        if header["format"] != self.version:
            age = "an older" if header["format"] < self.version else "a newer"
            raise FormatError(
                f"{path}: this {self.kind} was written by {age} version of the program (format {header['format']}, "
                f"this version reads {self.version}); {self.remedy}"
            )

    def damaged(self, path: Path) -> FormatError:
        """The error for a truncated or altered file."""
        return FormatError(f"{path}: this {self.kind} is cut short or damaged; {self.remedy}")


#: Files that are replaced together: temporary and final path of each, in order of writing.
Group = list[tuple[Path, Path]]


@contextmanager
def replacing(path: Path, durable: bool = True, group: Group | None = None) -> Iterator[Path]:
    """Atomic write: a temporary path, of the same suffix, that replaces `path` when the block ends without error.

    The content is synchronised to disk before the file is renamed, and the new name afterwards. After an error the old
    file is unchanged and the temporary file is removed.

    Parameters
    ----------
    path : Path
    durable : bool
        Whether to synchronise the name too. If False, a power failure may lose the file, but never part of its
        content: for files that can be made again, or whose later index file is durable.
    group : optional
        From :func:`together`: the file is replaced together with the others of the group.

    Raises
    ------
    StorageError
        If the file cannot be written.
    """
    path = Path(path)
    temporary = path.with_name(f".{path.stem}.{_HOST}-{os.getpid()}{PARTIAL}{path.suffix}")
    deferred = False
    try:
        with _storage_error(path):
            path.parent.mkdir(parents=True, exist_ok=True)
            yield temporary
            if group is not None:
                group.append((temporary, path))
                deferred = True
                return
            _fsync(temporary)
            temporary.replace(path)
            if durable:
                _fsync(path.parent)
    finally:
        if not deferred:
            with suppress(OSError):
                temporary.unlink(missing_ok=True)


@contextmanager
def together() -> Iterator[Group]:
    """Write several files with :func:`replacing`; none is replaced before all are synchronised to disk.

    They are replaced in the order of writing, so that the last one can serve as an index of the others, and the last
    name is synchronised to disk. If writing fails, all old files are unchanged.

    Raises
    ------
    StorageError
        If a file cannot be written.
    """
    group: Group = []
    try:
        yield group
        with ThreadPoolExecutor(PARALLEL_SYNCS) as pool:
            for (_, path), synced in zip(group, [pool.submit(_fsync, file) for file, _ in group]):
                with _storage_error(path):
                    synced.result()
        for temporary, path in group:
            with _storage_error(path):
                temporary.replace(path)
        if group:
            with _storage_error(path):
                _fsync(path.parent)
    finally:
        for temporary, _ in group:
            with suppress(OSError):
                temporary.unlink(missing_ok=True)


@contextmanager
def _storage_error(path: Path) -> Iterator[None]:
    """Turn an error of the operating system into a :class:`StorageError` of one sentence."""
    try:
        yield
    except OSError as problem:
        raise StorageError(
            f"{path}: cannot be written ({_reason(problem)}); finished work is saved: free disk space or give "
            "permission and run again"
        ) from problem


def set_aside(path: Path, mark: str = DAMAGED, prefix: str = "") -> Path | None:
    """Rename a file by appending `mark`, and a number if that name exists; nothing is overwritten.

    Parameters
    ----------
    path : Path
    mark : str
    prefix : str
        Put before the name: readers of a dataset skip files whose names begin with ``_``.

    Returns
    -------
    Path or None
        The new path; None if there is no file.
    """
    if not path.is_file():
        return None
    number, aside = 1, path.with_name(f"{prefix}{path.name}{mark}")
    while os.path.lexists(aside):
        number += 1
        aside = path.with_name(f"{prefix}{path.name}{mark}-{number}")
    try:
        path.rename(aside)
    except OSError as problem:
        raise StorageError(f"{path}: cannot be renamed ({_reason(problem)}); remove it and run again") from problem
    return aside


def clean(folders: Iterable[Path], alone: bool = False) -> None:
    """Remove partial files of killed processes.

    Parameters
    ----------
    folders : iterable of Path
        Searched without their subfolders. Folders that do not exist and links are skipped.
    alone : bool
        Whether no other process writes there. Otherwise only files of ended processes of this host are removed.
    """
    for folder in folders:
        if folder.is_symlink() or not folder.is_dir():
            continue
        for path in folder.iterdir():
            name = _PARTIAL_NAME.fullmatch(path.name)
            if name and (alone or (name[1] == _HOST and not _alive(int(name[2])))):
                with suppress(OSError):
                    path.unlink()


def fingerprint(content: bytes | Any) -> str:
    """SHA-256 of bytes or of JSON-ready content, shortened to 32 hexadecimal digits."""
    if not isinstance(content, bytes):
        content = json.dumps(content, sort_keys=True).encode()
    return hashlib.sha256(content).hexdigest()[:32]


def _fsync(path: Path) -> None:
    windows = os.name == "nt"  # it synchronises files that are open for writing, and no folders
    if windows and path.is_dir():
        return
    descriptor = os.open(path, os.O_RDWR if windows else os.O_RDONLY)
    try:
        os.fsync(descriptor)
    finally:
        os.close(descriptor)


def _alive(process: int) -> bool:
    if os.name == "nt":
        return True  # os.kill would end it
    try:
        os.kill(process, 0)
    except ProcessLookupError:
        return False
    except PermissionError:
        pass
    return True


def _reason(problem: OSError) -> str:
    """Reason of an error, without the path."""
    return (problem.strerror or str(problem)).lower()


def write_text(path: Path, text: str) -> None:
    """Write a text file in UTF-8, atomically."""
    with replacing(path) as temporary:
        temporary.write_text(text, encoding="utf-8")


def append_text(path: Path, text: str) -> None:
    """Append text to a file and synchronise it to disk; processes that append to one file wait for each other.

    If the last line has no end, because its writer was killed, the text begins on a line of its own. After an error the
    file is as before.

    Raises
    ------
    StorageError
        If the file cannot be written.
    """
    with _storage_error(path):
        path.parent.mkdir(parents=True, exist_ok=True)
        with open(path, "ab+", buffering=0) as file, exclusive(file.fileno()):
            end = file.seek(0, os.SEEK_END)
            file.seek(max(end - 1, 0))
            rest = memoryview((b"" if file.read(1) in (b"", b"\n") else b"\n") + text.encode())
            try:
                while rest:
                    rest = rest[file.write(rest) :]
                os.fsync(file.fileno())
            except BaseException:
                file.truncate(end)
                raise


def save_json(path: Path, format: Format, content: Mapping[str, Any]) -> None:
    """Write a dict with its checksum; the keys ``kind``, ``format`` and ``checksum`` are reserved."""
    document = {"kind": format.kind, "format": format.version, **content}
    document["checksum"] = _checksum(document)
    write_text(path, json.dumps(document, indent=2, allow_nan=False) + "\n")


def load_json(path: Path, format: Format) -> dict[str, Any]:
    """Read a file of :func:`save_json`.

    Raises
    ------
    FileNotFoundError
    FormatError
    """
    with reading(path, format):
        document, valid = _read_json(path)
        return _content(path, format, document, valid)


def json_header(path: Path) -> dict[str, Any] | None:
    """Content of a JSON file of any kind and version, valid or not; empty if it is no table, None if not readable."""
    try:
        document, _ = _read_json(path)
    except Exception:
        return None
    return document if isinstance(document, dict) else {}


def _read_json(path: Path) -> tuple[Any, bool]:
    """Document, and whether its checksum is right."""
    document = json.loads(read_regular(path, JSON_LIMIT))
    return document, isinstance(document, dict) and document.get("checksum") == _checksum(document)


def to_line(record: Mapping[str, Any]) -> str:
    """A record as one line of JSON with its checksum, for a file to which records are appended."""
    return json.dumps({**record, "checksum": _checksum(record)}) + "\n"


def read_line(line: str | bytes) -> dict[str, Any] | None:
    """The record of :func:`to_line`; None if the line is truncated or altered."""
    try:
        record = json.loads(line)
        return record if record.pop("checksum") == _checksum(record) else None
    except Exception:
        return None


def save_arrays(
    path: Path,
    format: Format,
    header: Mapping[str, Any],
    arrays: Mapping[str, np.ndarray],
    durable: bool = True,
    group: Group | None = None,
) -> None:
    """Write named arrays and a JSON-ready header to one ``.npz`` file with a checksum.

    `durable` and `group` as for :func:`replacing`.
    """
    arrays = {name: np.asarray(array) for name, array in arrays.items()}
    document = {"kind": format.kind, "format": format.version, **header}
    document["checksum"] = _checksum(document, arrays)
    # numpy.savez leaves its archive open on a full disk. Compression would save 4 % and take 2 s per 100 MB.
    with replacing(path, durable, group) as temporary, zipfile.ZipFile(temporary, "w") as archive:
        for name, array in ({"header": np.array(json.dumps(document))} | arrays).items():
            with archive.open(f"{name}.npy", "w", force_zip64=True) as member:
                np.lib.format.write_array(member, array, allow_pickle=False)


def load_arrays(path: Path, format: Format) -> tuple[dict[str, Any], dict[str, np.ndarray]]:
    """Header and arrays of a file of :func:`save_arrays`; its content is never executed.

    Raises
    ------
    FileNotFoundError
    FormatError
    """
    with reading(path, format):
        document, arrays, valid = _read_arrays(path)
        return _content(path, format, document, valid), arrays


def arrays_header(path: Path) -> dict[str, Any]:
    """Header of a file of :func:`save_arrays` of any kind and version; empty if it cannot be read or is invalid."""
    try:
        document, _, valid = _read_arrays(path)
    except Exception:
        return {}
    return document if valid else {}


@contextmanager
def reading(path: Path, format: Format) -> Iterator[None]:
    """Everything that the program does with a file that it wrote, until it trusts the content.

    Raises
    ------
    FileNotFoundError
    StorageError
        If the user may not read the file.
    FormatError
        For any other exception in the block, among them those of libraries.
    """
    try:
        yield
    except (FileNotFoundError, MicError):
        raise
    except PermissionError as problem:
        raise StorageError(f"{path}: cannot be read ({_reason(problem)}); give permission") from problem
    except Exception as problem:
        raise format.damaged(path) from problem


def _content(path: Path, format: Format, document: Any, valid: bool) -> dict[str, Any]:
    """A document without what describes the file."""
    if not valid and isinstance(document, dict) and "checksum" in document:
        raise format.damaged(path)  # first: kind and version may be what was altered
    format.check(path, document)
    if not valid:
        raise format.damaged(path)
    return {key: value for key, value in document.items() if key not in _DESCRIPTION}


def _read_arrays(path: Path) -> tuple[dict[str, Any], dict[str, np.ndarray], bool]:
    """Document, arrays, and whether the checksum is right; nothing is unpickled."""
    with open_regular(path) as file:
        arrays = read_archive(file)
    header = arrays.pop("header")
    if header.nbytes > 4 * JSON_LIMIT:  # numpy stores four bytes for each character
        raise ValueError("the header is too large")
    document = json.loads(str(header))
    if not isinstance(document, dict):
        raise ValueError("the header is no table")
    return document, arrays, document.get("checksum") == _checksum(document, arrays)


def _checksum(document: Mapping[str, Any], arrays: Mapping[str, np.ndarray] = MappingProxyType({})) -> str:
    """SHA-256 of a document, except its own checksum, and of arrays."""
    checked = {key: value for key, value in document.items() if key != "checksum"}
    digest = hashlib.sha256(json.dumps(checked, sort_keys=True).encode())
    for name in sorted(arrays):
        array = np.ascontiguousarray(arrays[name])
        digest.update(repr((name, array.shape, array.dtype.str)).encode())
        digest.update(array.tobytes())
    return digest.hexdigest()
