"""Open files for reading without trusting their names: a pipe cannot block, and a device cannot be read without end."""

from __future__ import annotations

import errno
import os
import stat
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import BinaryIO

__all__ = ["open_regular", "read_regular"]


@contextmanager
def open_regular(path: Path | str) -> Iterator[BinaryIO]:
    """A regular file, opened for reading.

    Raises
    ------
    OSError
        Also for a folder, pipe, socket or device, which is not waited for.
    """
    # O_NONBLOCK: opening a pipe would wait for its writer. It does not affect regular files.
    descriptor = os.open(path, os.O_RDONLY | getattr(os, "O_NONBLOCK", 0) | getattr(os, "O_BINARY", 0))
    try:
        if not stat.S_ISREG(os.fstat(descriptor).st_mode):
            raise OSError(errno.EINVAL, "not a regular file", str(path))
        file = os.fdopen(descriptor, "rb")
    except BaseException:
        os.close(descriptor)
        raise
    with file:
        yield file


def read_regular(path: Path | str, limit: int | None = None) -> bytes:
    """Content of a regular file.

    Parameters
    ----------
    path : path-like
    limit : int, optional
        Largest size, bytes.

    Raises
    ------
    OSError
        As :func:`open_regular`, and if the file is larger; nothing is read then.
    """
    with open_regular(path) as file:
        size = os.fstat(file.fileno()).st_size
        if limit is not None and size > limit:
            raise OSError(errno.EFBIG, f"larger than {limit / 1e6:.0f} MB", str(path))
        return file.read(size)
