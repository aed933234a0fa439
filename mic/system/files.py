"""Files that survive: written whole or not at all, and read back only as what they are.

Every file that the program reads again goes through here. A reader sees the old content or the new, never a half;
what it meets instead (an older or newer format, a foreign file, one cut short or altered) ends in one sentence that
says so.
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
from dataclasses import dataclass, field
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

PARTIAL = ".partial"  # stands in the name of every file that is being written, and of none that is finished
DAMAGED = ".damaged"  # stands behind the name of a file that could not be read and was set aside

SIDE_BY_SIDE = 16  # files that are brought to disk at a time: it takes hardly longer than one

_HOST = f"{zlib.crc32(socket.gethostname().encode()):08x}"
_PARTIAL_NAME = re.compile(rf"\..+\.([0-9a-f]{{8}})-(\d+){re.escape(PARTIAL)}(\.\w+)?")


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


@dataclass
class Group:
    """Files that wait for each other: their temporary paths, and the places that they shall take, in this order."""

    files: list[tuple[Path, Path]] = field(default_factory=list)


@contextmanager
def replacing(path: Path, lasting: bool = True, group: Group | None = None) -> Iterator[Path]:
    """A temporary path beside `path`, of the same suffix, that takes its place once the block has ended well.

    The content is on disk before the name changes, and the new name is on disk when this ends; after an error the old
    file stands untouched and nothing is left behind.

    Parameters
    ----------
    path : Path
    lasting : bool
        Whether to wait for the name too. Of a file that is made again where it is missing, or that another which
        follows vouches for, a failure of power may else take the name, never a part of the content.
    group : optional
        Of :func:`together`: the file takes its place with the others of it.

    Raises
    ------
    StorageError
        If the file cannot be written.
    """
    path = Path(path)
    temporary = path.with_name(f".{path.stem}.{_HOST}-{os.getpid()}{PARTIAL}{path.suffix}")
    waits = False
    try:
        with _telling(path):
            path.parent.mkdir(parents=True, exist_ok=True)
            yield temporary
            if group is not None:
                group.files.append((temporary, path))
                waits = True
                return
            _to_disk(temporary)
            temporary.replace(path)
            if lasting:
                _to_disk(path.parent)
    finally:
        if not waits:
            with suppress(OSError):
                temporary.unlink(missing_ok=True)


@contextmanager
def together() -> Iterator[Group]:
    """Several files that :func:`replacing` writes, one after the other: each takes its place once all are on disk.

    To wait for many at a time takes hardly longer than for one. They take their places in the order in which they were
    written, and the name of the last is on disk when this ends; so it vouches for the others. After an error all old
    files stand untouched.

    Raises
    ------
    StorageError
        If one of them cannot be written.
    """
    group = Group()
    try:
        yield group
        with ThreadPoolExecutor(SIDE_BY_SIDE) as pool:
            for (_, path), done in zip(group.files, [pool.submit(_to_disk, file) for file, _ in group.files]):
                with _telling(path):
                    done.result()
        for temporary, path in group.files:
            with _telling(path):
                temporary.replace(path)
        if group.files:
            with _telling(path):
                _to_disk(path.parent)
    finally:
        for temporary, _ in group.files:
            with suppress(OSError):
                temporary.unlink(missing_ok=True)


@contextmanager
def _telling(path: Path) -> Iterator[None]:
    """What the system says against a file, in one sentence."""
    try:
        yield
    except OSError as problem:
        raise StorageError(
            f"{path}: cannot be written ({_reason(problem)}); what is finished stays, make room or give permission and "
            "call again"
        ) from problem


def set_aside(path: Path, mark: str = DAMAGED, prefix: str = "") -> Path | None:
    """Give a file a name of its own, `mark` and where that is taken a number behind it; nothing is ever overwritten.

    Parameters
    ----------
    path : Path
    mark : str
    prefix : str
        Stands before the name: readers of a whole dataset pass over files whose names begin with ``_``.

    Returns
    -------
    Path or None
        The new name; None where there is no file.
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
        raise StorageError(f"{path}: cannot be set aside ({_reason(problem)}); remove it and call again") from problem
    return aside


def clean(folders: Iterable[Path], alone: bool = False) -> None:
    """Remove the partial files that programs which were killed have left in some folders.

    Parameters
    ----------
    folders : iterable of Path
        Looked through one by one, not below. A folder that does not exist, or is a link, is passed over.
    alone : bool
        Whether nobody else writes there now. Else only files of processes of this machine that are gone are removed.
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
    """Hash of bytes, or of anything that JSON can hold, 32 hexadecimal digits."""
    if not isinstance(content, bytes):
        content = json.dumps(content, sort_keys=True).encode()
    return hashlib.sha256(content).hexdigest()[:32]


def _to_disk(path: Path) -> None:
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
    """Why, without the path that the message names already."""
    return (problem.strerror or str(problem)).lower()


def write_text(path: Path, text: str) -> None:
    """Write a text file, UTF-8."""
    with replacing(path) as temporary:
        temporary.write_text(text, encoding="utf-8")


def append_text(path: Path, text: str) -> None:
    """Write text at a file's end; it is on disk when this ends, whatever becomes of the program.

    Raises
    ------
    StorageError
        If the file cannot be written.
    """
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
        with open(path, "a", encoding="utf-8", newline="") as file:
            file.write(text)
            file.flush()
            os.fsync(file.fileno())
    except OSError as problem:
        raise StorageError(f"{path}: cannot be written ({_reason(problem)}); make room and call again") from None


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
    except FileNotFoundError:
        raise
    except PermissionError as problem:
        raise StorageError(f"{path}: cannot be read ({_reason(problem)}); give permission") from problem
    except (ValueError, OSError, RecursionError):
        raise format.damaged(path) from None
    format.check(path, document)
    return {key: value for key, value in document.items() if key not in ("kind", "format")}


def save_arrays(
    path: Path,
    format: Format,
    header: Mapping[str, Any],
    arrays: Mapping[str, np.ndarray],
    lasting: bool = True,
    group: Group | None = None,
) -> None:
    """Write named arrays, and a JSON-ready header beside them, to one ``.npz`` file with a checksum over all of it.

    `lasting` and `group` as :func:`replacing` takes them.
    """
    arrays = {name: np.asarray(array) for name, array in arrays.items()}
    document = {"kind": format.kind, "format": format.version, **header}
    document["checksum"] = _checksum(document, arrays)
    # Not by numpy's savez: on a full disk it leaves its archive to the interpreter to close, who complains aloud. Nor
    # compressed: of compliance and forces that saves 4 %, at 2 s for 100 MB.
    with replacing(path, lasting, group) as temporary, zipfile.ZipFile(temporary, "w") as archive:
        for name, array in ({"header": np.array(json.dumps(document))} | arrays).items():
            with archive.open(f"{name}.npy", "w", force_zip64=True) as member:
                np.lib.format.write_array(member, array, allow_pickle=False)


def load_arrays(path: Path, format: Format) -> tuple[dict[str, Any], dict[str, np.ndarray]]:
    """Header and arrays that :func:`save_arrays` wrote. No content of the file is ever executed.

    Raises
    ------
    FileNotFoundError
    FormatError
    """
    try:
        document, arrays, whole = _read_arrays(path)
    except FileNotFoundError:
        raise
    except PermissionError as problem:
        raise StorageError(f"{path}: cannot be read ({_reason(problem)}); give permission") from problem
    except _UNREADABLE:
        raise format.damaged(path) from None
    format.check(path, document)
    if not whole:
        raise format.damaged(path)
    return {key: value for key, value in document.items() if key not in ("kind", "format", "checksum")}, arrays


def arrays_header(path: Path) -> dict[str, Any]:
    """Header of what :func:`save_arrays` wrote, of whatever kind and version; empty where nothing whole can be read."""
    try:
        document, _, whole = _read_arrays(path)
    except _UNREADABLE:
        return {}
    return document if whole else {}


_UNREADABLE = (
    ValueError, KeyError, OSError, EOFError, TypeError, NotImplementedError, zipfile.BadZipFile, zlib.error,
)  # fmt: skip


def _read_arrays(path: Path) -> tuple[dict[str, Any], dict[str, np.ndarray], bool]:
    """Document, arrays, and whether they are what the checksum was taken over; no object is ever unpickled."""
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
