"""Atomic file writes, and readers that verify kind, version and checksum.

All files that the program reads again are written and read by this module. A reader sees the old content or the new,
never a part; a file of another format, or one that is truncated or altered, raises an error of one sentence.

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
from typing import Any

import numpy as np

from mic.errors import FormatError, StorageError

__all__ = [
    "DAMAGED",
    "PARTIAL",
    "Format",
    "Group",
    "append_text",
    "arrays_header",
    "clean",
    "fingerprint",
    "load_arrays",
    "load_json",
    "replacing",
    "save_arrays",
    "save_json",
    "set_aside",
    "together",
    "write_text",
]

PARTIAL = ".partial"  # part of the name of every file that is being written, and of no complete one
DAMAGED = ".damaged"  # suffix of a file that could not be read and was renamed

PARALLEL_SYNCS = 16  # files synchronised to disk at a time: hardly slower than one

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
    descriptor = os.open(path, os.O_RDONLY)
    try:
        os.fsync(descriptor)
    finally:
        os.close(descriptor)


def _alive(process: int) -> bool:
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
    """Append text to a file and synchronise it to disk.

    Raises
    ------
    StorageError
        If the file cannot be written.
    """
    with _storage_error(path):
        path.parent.mkdir(parents=True, exist_ok=True)
        with open(path, "a", encoding="utf-8", newline="") as file:
            file.write(text)
            file.flush()
            os.fsync(file.fileno())


def save_json(path: Path, format: Format, content: Mapping[str, Any]) -> None:
    """Write a dict; the keys ``kind`` and ``format`` are reserved."""
    document = {"kind": format.kind, "format": format.version, **content}
    write_text(path, json.dumps(document, indent=2, allow_nan=False) + "\n")


def load_json(path: Path, format: Format) -> dict[str, Any]:
    """Read a file of :func:`save_json`.

    Raises
    ------
    FileNotFoundError
    FormatError
    """
    with _reading(path, format):
        document = json.loads(Path(path).read_text(encoding="utf-8"))
    format.check(path, document)
    return {key: value for key, value in document.items() if key not in ("kind", "format")}


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
    with _reading(path, format):
        document, arrays, valid = _read_arrays(path)
    format.check(path, document)
    if not valid:
        raise format.damaged(path)
    return {key: value for key, value in document.items() if key not in ("kind", "format", "checksum")}, arrays


def arrays_header(path: Path) -> dict[str, Any]:
    """Header of a file of :func:`save_arrays` of any kind and version; empty if it cannot be read or is invalid."""
    try:
        document, _, valid = _read_arrays(path)
    except _UNREADABLE:
        return {}
    return document if valid else {}


_UNREADABLE = (ValueError, KeyError, OSError, EOFError, TypeError, RuntimeError, zipfile.BadZipFile, zlib.error)


@contextmanager
def _reading(path: Path, format: Format) -> Iterator[None]:
    """Turn errors of reading into those of one sentence, except that the file does not exist."""
    try:
        yield
    except FileNotFoundError:
        raise
    except PermissionError as problem:
        raise StorageError(f"{path}: cannot be read ({_reason(problem)}); give permission") from problem
    except _UNREADABLE:
        raise format.damaged(path) from None


def _read_arrays(path: Path) -> tuple[dict[str, Any], dict[str, np.ndarray], bool]:
    """Document, arrays, and whether the checksum is right; nothing is unpickled."""
    with np.load(Path(path), allow_pickle=False) as data:
        arrays = {name: data[name] for name in data.files}
    document = json.loads(str(arrays.pop("header")))
    if not isinstance(document, dict):
        raise ValueError("the header is no table")
    checked = {key: value for key, value in document.items() if key != "checksum"}
    return document, arrays, document.get("checksum") == _checksum(checked, arrays)


def _checksum(document: Mapping[str, Any], arrays: Mapping[str, np.ndarray]) -> str:
    digest = hashlib.sha256(json.dumps(document, sort_keys=True).encode())
    for name in sorted(arrays):
        array = np.ascontiguousarray(arrays[name])
        digest.update(repr((name, array.shape, array.dtype.str)).encode())
        digest.update(array.tobytes())
    return digest.hexdigest()
