"""Lock of a results folder: one run at a time; the lock of a killed run is taken over.

The file ``.lock`` records its owner: process number and start time, host, boot of the host, and command. ``flock``
decides between processes; the recorded owner decides on file systems without locks, such as some network file systems.

Not the library ``filelock``: it records no owner, so it can neither name the owner in its error nor detect that a lock
on a file system without ``flock`` belongs to an ended process.
"""

from __future__ import annotations

import json
import os
import shlex
import socket
import sys
import time
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from pathlib import Path
from typing import Any

from mic.errors import RunError, StorageError

if sys.platform == "win32":
    import msvcrt
else:
    import fcntl

__all__ = ["LOCK", "exclusive", "locked"]

LOCK = ".lock"
WORKERS_END = 60.0  # s within which the worker processes of a killed run end: they end at once, but for compiled code
POLL = 0.05  # s
BEYOND = 1 << 30  # byte that Windows locks: other processes cannot read it, but the content before it

_held: dict[str, int] = {}  # number of holders in this process, by folder


@contextmanager
def locked(folder: Path) -> Iterator[bool]:
    """Hold the lock of a results folder, which is created if necessary; a process may hold it more than once.

    Yields
    ------
    bool
        Whether the lock was taken over from a process that has ended.

    Raises
    ------
    RunError
        If another process holds it.
    StorageError
        If the folder cannot be created or written.
    """
    folder = Path(folder)
    if folder.exists() and not folder.is_dir():
        raise RunError(f"{folder}: is a file; name a folder for the results with --out")
    created = not folder.exists()
    try:
        folder.mkdir(parents=True, exist_ok=True)
        key = os.path.realpath(folder)
        descriptor, stale = (None, False) if key in _held else _acquire(folder)
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
                    os.ftruncate(descriptor, 0)  # Windows does not remove an open file
                    (folder / LOCK).unlink()
                os.close(descriptor)
            if created:
                with suppress(OSError):  # no empty folder after a refused run
                    folder.rmdir()


def _acquire(folder: Path) -> tuple[int, bool]:
    """Descriptor of the lock file, locked and written, and whether it was left by an ended process.

    Forked workers of a killed run hold its lock until they end, which is waited for: they may still write results.
    """
    path, refused = folder / LOCK, time.monotonic() + WORKERS_END
    while True:
        descriptor = os.open(path, os.O_RDWR | os.O_CREAT | getattr(os, "O_NOFOLLOW", 0), 0o644)
        try:
            busy = not _flock(descriptor)
            if not busy and not _is_current(descriptor, path):
                os.close(descriptor)  # its owner released and removed it meanwhile
                continue
            owner = _recorded_owner(descriptor)
            alive = _may_be_alive(owner)
            if busy and owner is not None and not alive and time.monotonic() < refused:
                os.close(descriptor)
                time.sleep(POLL)
                continue
            if busy or alive:
                raise RunError(_refusal(folder, owner))
            os.ftruncate(descriptor, 0)
            os.lseek(descriptor, 0, os.SEEK_SET)
            os.write(descriptor, json.dumps(_this_process(), indent=2).encode() + b"\n")
            os.fsync(descriptor)
        except BaseException:
            with suppress(OSError):
                os.close(descriptor)
            raise
        return descriptor, owner is not None


@contextmanager
def exclusive(descriptor: int) -> Iterator[None]:
    """Within this context, no other process or thread is in one with the same file; it is waited for."""
    _flock(descriptor, wait=True)
    try:
        yield
    finally:  # not by closing the file: a process forked meanwhile has it open, too
        with suppress(OSError):
            if sys.platform == "win32":
                os.lseek(descriptor, BEYOND, os.SEEK_SET)
                msvcrt.locking(descriptor, msvcrt.LK_UNLCK, 1)
            else:
                fcntl.flock(descriptor, fcntl.LOCK_UN)


def _flock(descriptor: int, wait: bool = False) -> bool:
    """Lock an open file; whether no other process holds it. `wait`: until it is free."""
    try:
        if sys.platform == "win32":
            os.lseek(descriptor, BEYOND, os.SEEK_SET)
            msvcrt.locking(descriptor, msvcrt.LK_LOCK if wait else msvcrt.LK_NBLCK, 1)
        else:
            fcntl.flock(descriptor, fcntl.LOCK_EX if wait else fcntl.LOCK_EX | fcntl.LOCK_NB)
    except (BlockingIOError, PermissionError):  # the latter on Windows
        return False
    except OSError:
        return True  # a file system without locks: the recorded owner decides
    return True


def _is_current(descriptor: int, path: Path) -> bool:
    with suppress(FileNotFoundError):
        return os.path.samestat(os.fstat(descriptor), os.stat(path, follow_symlinks=False))
    return False


def _recorded_owner(descriptor: int) -> dict[str, Any] | None:
    """Owner in a lock file; None if there is none or the file is incomplete."""
    with suppress(Exception):
        os.lseek(descriptor, 0, os.SEEK_SET)
        owner = json.loads(os.read(descriptor, 65536))
        return owner if isinstance(owner, dict) else None
    return None


def _this_process() -> dict[str, Any]:
    return {
        "process": os.getpid(),
        "started": _started(os.getpid()),
        "host": socket.gethostname(),
        "boot": _boot(),
        "command": shlex.join(sys.argv),
    }


def _may_be_alive(owner: dict[str, Any] | None) -> bool:
    """Whether the owner of a lock may still be running; an owner on another host is assumed to be."""
    if owner is None or not isinstance(owner.get("process"), int):
        return False
    if owner.get("host") != socket.gethostname():
        return True
    started = _started(owner["process"])
    return owner.get("boot") == _boot() and started is not None and owner.get("started") == started


def _started(process: int) -> int | None:
    """Start time of a process in clock ticks since boot, which identifies reused process numbers; None if ended."""
    try:
        fields = Path(f"/proc/{process}/stat").read_text().rpartition(")")[2].split()
    except OSError:
        return None
    return None if fields[0] in "ZX" else int(fields[19])


def _boot() -> str:
    with suppress(OSError):
        return Path("/proc/sys/kernel/random/boot_id").read_text().strip()
    return ""


def _refusal(folder: Path, owner: dict[str, Any] | None) -> str:
    holder = "another process"
    if owner is not None:
        holder = f"process {owner.get('process')} on {owner.get('host')} ({owner.get('command')})"
    remedy = "wait until it has ended or name another folder with --out"
    if owner is not None and owner.get("host") != socket.gethostname():
        remedy += f"; if that process has ended, remove {folder / LOCK}"
    return f"{folder}: is in use by {holder}; {remedy}"
