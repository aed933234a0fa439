"""Disk cache of meshes, contact pairs, influence coefficients, fields, drawn shapes, checks and emulator data.

A cached file is used only if it is complete, holds the requested content, and belongs to the user. It is ignored, with
a warning of one line, and replaced by the next :meth:`Cache.store` if

- it is truncated, altered, or of another format: a checksum covers content and header;
- it was computed from other inputs: the header holds the hash of the inputs;
- it, or its folder, belongs to another user or is writable by others.

Other users cannot read the folders. Not ``diskcache`` or ``joblib.Memory``: both unpickle what they read, which can
execute code, and neither verifies checksums or owners.
"""

from __future__ import annotations

import logging
import os
import stat
import sys
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from mic.errors import FormatError, MicError, StorageError
from mic.system.files import Format, load_arrays, save_arrays

__all__ = ["ABSENT", "Cache", "cache_folder"]

ABSENT = "it counts as absent and is replaced"  #: remedy of every format in a cache
#: The subfolders of a cache folder.
SECTIONS = ("answers", "assemblies", "checks", "fields", "influence", "meshes", "shapes", "warnings")

_log = logging.getLogger(__name__)


@dataclass(frozen=True)
class Cache:
    """One section of the cache folder: files of one format, each named by the hash of its inputs.

    Attributes
    ----------
    folder : Path
        The cache folder.
    section : str
        Subfolder, one of ``SECTIONS``.
    format : Format
        Format of the files; its remedy is :data:`ABSENT`.
    max_files : int, optional
        Number of files beyond which the oldest are removed.
    """

    folder: Path
    section: str
    format: Format
    max_files: int | None = None

    def path(self, identity: str) -> Path:
        """Path of a cached file, whether it exists or not."""
        return Path(self.folder) / self.section / f"{identity}.npz"

    def load(self, identity: str) -> tuple[dict[str, Any], dict[str, np.ndarray]] | None:
        """Header and arrays as :meth:`store` received them; None if there is no valid file.

        Parameters
        ----------
        identity : str
            Hash of all inputs of the content.
        """
        path = self.path(identity)
        try:
            self._restrict()
            for checked in (path.parent, path):
                if reason := _untrusted(checked):
                    raise FormatError(f"{checked}: this {reason}; {ABSENT}")
            header, arrays = load_arrays(path, self.format)
            if header.pop("identity", None) != identity:
                raise FormatError(f"{path}: this {self.format.kind} was computed from other inputs; {ABSENT}")
        except FileNotFoundError:
            return None
        except MicError as problem:
            _log.warning("%s", problem)
            return None
        except OSError as problem:
            _log.warning("%s: this %s cannot be read (%s); %s", path, self.format.kind, problem.strerror, ABSENT)
            return None
        return header, arrays

    def store(self, identity: str, header: Mapping[str, Any], arrays: Mapping[str, np.ndarray]) -> None:
        """Store header and arrays for :meth:`load`; only warn if that fails.

        Parameters
        ----------
        identity : str
        header : dict
            JSON-ready; the key ``"identity"`` is reserved.
        arrays : dict of str to array
        """
        path = self.path(identity)
        try:
            for folder in (Path(self.folder), path.parent):
                folder.mkdir(mode=0o700, parents=True, exist_ok=True)
            self._restrict()
            if reason := _untrusted(path.parent):
                raise PermissionError(f"its folder {reason}")
            save_arrays(path, self.format, {**header, "identity": identity}, arrays, durable=False)
            path.chmod(0o600)  # independent of the umask
            if self.max_files is not None:
                old = sorted(path.parent.glob("*.npz"), key=lambda file: -file.stat().st_mtime)[self.max_files :]
                for file in old:
                    file.unlink(missing_ok=True)
        except (MicError, OSError) as problem:
            _log.warning(
                "%s: this %s cannot be cached (%s) and will be computed again; set MIC_CACHE to a folder of your own "
                "that can be written",
                path,
                self.format.kind,
                problem,
            )

    def _restrict(self) -> None:
        """Deny others access to the section, and to the cache folder if it holds nothing but sections."""
        folder = Path(self.folder)
        for directory in (folder, folder / self.section):
            try:
                status = directory.stat()
                if not _is_own(status) or not stat.S_IMODE(status.st_mode) & 0o077:
                    continue
                if directory != folder or all(entry in SECTIONS for entry in os.listdir(directory)):
                    directory.chmod(0o700)
            except OSError:  # absent, or on a read-only file system
                continue


def cache_folder() -> Path:
    """Folder of meshes and influence coefficients: ``$MIC_CACHE``, or the user's cache folder.

    Raises
    ------
    StorageError
        If the user has no home.
    """
    if os.environ.get("MIC_CACHE"):
        return Path(os.environ["MIC_CACHE"])
    if sys.platform == "win32":
        place = os.environ.get("LOCALAPPDATA") or "~/AppData/Local"
    else:
        default = "~/Library/Caches" if sys.platform == "darwin" else "~/.cache"
        place = os.environ.get("XDG_CACHE_HOME") or default
    folder = Path(os.path.expanduser(place)) / "mic"
    if not folder.is_absolute():  # "~" that could not be expanded
        raise StorageError("there is no home folder for the cache; set MIC_CACHE to a folder that can be written")
    return folder


def _is_own(status: os.stat_result) -> bool:
    return not hasattr(os, "geteuid") or status.st_uid == os.geteuid()  # True on systems without owners


def _untrusted(path: Path) -> str | None:
    """Why another user may have written a file or folder; None if that is excluded.

    Raises
    ------
    FileNotFoundError
    """
    status = path.stat()
    if not _is_own(status):
        return "belongs to another user"
    if hasattr(os, "geteuid") and stat.S_IMODE(status.st_mode) & 0o022:
        return "can be written by other users"
    return None
