"""What is computed once and kept: meshes, contact pairs, influence coefficients, displacement fields,
drawn shapes, assemblies learnt from.

A kept file is believed only where it is whole, of what is asked for, and one's own. It counts as absent, which is said
in one line and mended by the next :meth:`Cache.keep`, where

- it is cut short, altered, or of another format: a checksum covers content and header;
- it was computed from something else: the header names the identity of what it was computed from;
- it, or its folder, belongs to another user, or others may write to it.

The folders are closed to others. What no checksum shows is a file that the user has forged himself, checksum included.
"""

from __future__ import annotations

import logging
import os
import stat
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from mic.errors import FormatError, MicError
from mic.system.files import Format, load_arrays, save_arrays

__all__ = ["ABSENT", "Cache"]

ABSENT = "it counts as absent and is replaced"  #: remedy of every format that a cache keeps
ROOMS = (
    "answers",
    "assemblies",
    "fields",
    "influence",
    "meshes",
    "shapes",
    "warnings",
)  # of a cache folder, and all that it holds

_log = logging.getLogger(__name__)


@dataclass(frozen=True)
class Cache:
    """One room of the cache folder: files of one format, each named by the identity of what it was computed from.

    Attributes
    ----------
    folder : Path
        The cache folder.
    room : str
        Folder in it, one of ``ROOMS``.
    format : Format
        Of its files; the remedy is :data:`ABSENT`.
    most : int, optional
        Files that stay: of more the oldest are removed.
    """

    folder: Path
    room: str
    format: Format
    most: int | None = None

    def path(self, identity: str) -> Path:
        """Where something is kept, whether it is or not."""
        return Path(self.folder) / self.room / f"{identity}.npz"

    def find(self, identity: str) -> tuple[dict[str, Any], dict[str, np.ndarray]] | None:
        """Header and arrays as :meth:`keep` was given them; None where nothing is kept that can be believed.

        Parameters
        ----------
        identity : str
            Hash of everything that the content depends on.
        """
        path = self.path(identity)
        try:
            self._close()
            for place in (path.parent, path):
                if reason := _not_own(place):
                    raise FormatError(f"{place}: this {reason}; {ABSENT}")
            header, arrays = load_arrays(path, self.format)
            if header.pop("identity", None) != identity:
                raise FormatError(f"{path}: this {self.format.kind} was computed from something else; {ABSENT}")
        except FileNotFoundError:
            return None
        except MicError as problem:
            _log.warning("%s", problem)
            return None
        except OSError as problem:
            _log.warning("%s: this %s cannot be read (%s); %s", path, self.format.kind, problem.strerror, ABSENT)
            return None
        return header, arrays

    def keep(self, identity: str, header: Mapping[str, Any], arrays: Mapping[str, np.ndarray]) -> None:
        """Keep header and arrays for the next :meth:`find`; where that cannot be, it is said, and nothing else happens.

        Parameters
        ----------
        identity : str
        header : dict
            JSON-ready; ``"identity"`` is taken.
        arrays : dict of str to array
        """
        path = self.path(identity)
        try:
            for folder in (Path(self.folder), path.parent):
                folder.mkdir(mode=0o700, parents=True, exist_ok=True)
            self._close()
            if reason := _not_own(path.parent):
                raise PermissionError(f"its folder {reason}")
            save_arrays(path, self.format, {**header, "identity": identity}, arrays, lasting=False)
            path.chmod(0o600)  # whatever the user's mask lets others do
            if self.most is not None:
                old = sorted(path.parent.glob("*.npz"), key=lambda one: -one.stat().st_mtime)[self.most :]
                for one in old:
                    one.unlink(missing_ok=True)
        except (MicError, OSError) as problem:
            _log.warning(
                "%s: this %s cannot be kept (%s), it is computed again next time; let MIC_CACHE name a folder of your "
                "own that can be written",
                path,
                self.format.kind,
                problem,
            )

    def _close(self) -> None:
        """Close the room to others, and the cache folder if it holds rooms alone: any folder may have been named."""
        folder = Path(self.folder)
        for place in (folder, folder / self.room):
            try:
                found = place.stat()
                if not _is_own(found) or not stat.S_IMODE(found.st_mode) & 0o077:
                    continue
                if place != folder or all(entry in ROOMS for entry in os.listdir(place)):
                    place.chmod(0o700)
            except OSError:  # absent, or on a file system that is read only: nobody writes there
                continue


def _is_own(found: os.stat_result) -> bool:
    return not hasattr(os, "geteuid") or found.st_uid == os.geteuid()  # where there are no owners, all is one's own


def _not_own(path: Path) -> str | None:
    """Why a file or a folder may be somebody else's doing; None where it cannot.

    Raises
    ------
    FileNotFoundError
    """
    found = path.stat()
    if not _is_own(found):
        return "belongs to another user"
    if hasattr(os, "geteuid") and stat.S_IMODE(found.st_mode) & 0o022:
        return "can be written by other users"
    return None
