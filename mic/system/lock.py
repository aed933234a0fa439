"""The lock of a results folder: one run at a time, and what a run that was killed leaves behind holds up nobody.

The file ``.lock`` names its owner: process, the time it started, host, boot of that host, and command. The operating
system's own lock on the file settles who comes first; the owner's name settles the rest where that lock does not reach,
as on some network file systems.
"""

from __future__ import annotations

import fcntl
import json
import os
import shlex
import socket
import sys
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from pathlib import Path
from typing import Any

from mic.errors import RunError, StorageError

__all__ = ["LOCK", "locked"]

LOCK = ".lock"

_held: dict[str, int] = {}  # folders that this process holds, by how many callers


@contextmanager
def locked(folder: Path) -> Iterator[bool]:
    """Hold a results folder, which is made if need be; a process may hold the same folder more than once.

    Yields
    ------
    bool
        Whether the lock was taken over from a process that is gone.

    Raises
    ------
    RunError
        If somebody else holds it.
    StorageError
        If the folder cannot be made or written.
    """
    folder = Path(folder)
    if folder.exists() and not folder.is_dir():
        raise RunError(f"{folder}: is a file; name a folder for the results with --out")
    made = not folder.exists()
    try:
        folder.mkdir(parents=True, exist_ok=True)
        key = os.path.realpath(folder)
        if key in _held:
            descriptor, stale = None, False
        else:
            descriptor, stale = _take(folder)
    except OSError as problem:
        raise StorageError(
            f"{folder}: cannot hold results ({(problem.strerror or str(problem)).lower()}); name another folder with "
            "--out, or give permission"
        ) from problem
    _held[key] = _held.get(key, 0) + 1
    try:
        yield stale
    finally:
        _held[key] -= 1
        if not _held[key]:
            del _held[key]
            if descriptor is not None:
                with suppress(OSError):
                    (folder / LOCK).unlink()
                os.close(descriptor)
            if made:
                with suppress(OSError):  # a run that was refused leaves no empty folder
                    folder.rmdir()


def _take(folder: Path) -> tuple[int, bool]:
    """Descriptor of the lock file, locked and written, and whether a dead process had left it."""
    path = folder / LOCK
    while True:
        descriptor = os.open(path, os.O_RDWR | os.O_CREAT | os.O_CLOEXEC | os.O_NOFOLLOW, 0o644)
        try:
            busy = not _flock(descriptor)
            if not busy and not _same(descriptor, path):
                os.close(descriptor)  # its owner let go, and took the file away, while we waited for it
                continue
            owner = _read(descriptor)
            if busy or _lives(owner):
                raise RunError(_refusal(folder, owner))
            os.ftruncate(descriptor, 0)
            os.pwrite(descriptor, json.dumps(_self(), indent=2).encode() + b"\n", 0)
            os.fsync(descriptor)
        except BaseException:
            with suppress(OSError):
                os.close(descriptor)
            raise
        return descriptor, owner is not None


def _flock(descriptor: int) -> bool:
    try:
        fcntl.flock(descriptor, fcntl.LOCK_EX | fcntl.LOCK_NB)
    except BlockingIOError:
        return False
    except OSError:
        return True  # a file system without locks: the owner's name decides
    return True


def _same(descriptor: int, path: Path) -> bool:
    try:
        return os.path.samestat(os.fstat(descriptor), os.stat(path, follow_symlinks=False))
    except FileNotFoundError:
        return False


def _read(descriptor: int) -> dict[str, Any] | None:
    """The owner that a lock file names; None where it names none, or was cut short while it was written."""
    try:
        owner = json.loads(os.pread(descriptor, 65536, 0))
    except ValueError:
        return None
    return owner if isinstance(owner, dict) else None


def _self() -> dict[str, Any]:
    return {
        "process": os.getpid(),
        "started": _started(os.getpid()),
        "host": socket.gethostname(),
        "boot": _boot(),
        "command": shlex.join(sys.argv),
    }


def _lives(owner: dict[str, Any] | None) -> bool:
    """Whether a lock's owner may still be at work; of another host nobody here can tell, so that one is believed."""
    if owner is None or not isinstance(owner.get("process"), int):
        return False
    if owner.get("host") != socket.gethostname():
        return True
    started = _started(owner["process"])
    return owner.get("boot") == _boot() and started is not None and owner.get("started") == started


def _started(process: int) -> int | None:
    """Start of a process in clock ticks since boot: it tells apart two of the same number; None if gone."""
    try:
        fields = Path(f"/proc/{process}/stat").read_text().rpartition(")")[2].split()
    except OSError:
        return None
    return None if fields[0] in "ZX" else int(fields[19])


def _boot() -> str:
    try:
        return Path("/proc/sys/kernel/random/boot_id").read_text().strip()
    except OSError:
        return ""


def _refusal(folder: Path, owner: dict[str, Any] | None) -> str:
    who = "another process"
    if owner is not None:
        who = f"process {owner.get('process')} on {owner.get('host')} ({owner.get('command')})"
    remedy = "wait until it has ended, or name another folder with --out"
    if owner is not None and owner.get("host") != socket.gethostname():
        remedy += f"; should it be dead, remove {folder / LOCK}"
    return f"{folder}: is in use by {who}; {remedy}"
