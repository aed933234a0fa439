"""What a geometry script reads: every file that it opens while it runs, with its content, so that changes are noticed.

Seen is what Python itself opens, with ``open``, `pathlib`, ``np.load`` and their like. Files that a library in C opens
by itself, listings of folders, other programs and the environment are not seen: a script names such files in
``DEPENDS = ["part.step"]``, relative to its own folder.
"""

from __future__ import annotations

import importlib.util
import os
import sys
import sysconfig
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from pathlib import Path
from typing import Any

from mic.system.files import fingerprint

__all__ = ["Dependencies", "opened_files"]

_WRITING = os.O_WRONLY | os.O_RDWR | os.O_CREAT | os.O_TRUNC | os.O_APPEND
_SYSTEM = ("/proc", "/sys", "/dev", "/etc")

_listeners: list[list[tuple[str, bool]]] = []  # of the scripts that run now
_hooked: list[bool] = []  # an audit hook can be added once, and never be removed


@contextmanager
def opened_files() -> Iterator[list[tuple[str, bool]]]:
    """Collect what is opened meanwhile: path as it was given, and whether for writing; in order, and repeated."""
    if not _hooked:
        sys.addaudithook(_hear)
        _hooked.append(True)
    heard: list[tuple[str, bool]] = []
    _listeners.append(heard)
    try:
        yield heard
    finally:
        _listeners.remove(heard)


def _hear(event: str, arguments: tuple) -> None:
    if event != "open" or not _listeners:
        return
    path, mode, flags = arguments
    if isinstance(path, (str, bytes)):  # else a descriptor, of a file that was opened before
        writes = any(letter in mode for letter in "wax+") if isinstance(mode, str) else bool((flags or 0) & _WRITING)
        for heard in _listeners:
            heard.append((os.fsdecode(path), writes))


class Dependencies:
    """The files that a generated mesh was made from.

    Attributes
    ----------
    files : dict of str to str or None
        Hash of each file's content, by its path relative to the script's folder, or whole where it lies far away;
        None for a file that the script looked for in vain.
    place : dict
        Where the script stood and was called from, as far as the paths depend on it.
    """

    def __init__(self, files: Mapping[str, str | None], place: Mapping[str, str]):
        self.files, self.place = dict(files), dict(place)

    @classmethod
    def of(cls, script: Path, declared: list[str], heard: list[tuple[str, bool]]) -> Dependencies:
        """What a script has opened, what it declares, and the modules that it has imported from beside it."""
        folder = script.parent.resolve()
        near, library, here = folder.parent, _library(), os.getcwd()
        written = {os.path.realpath(path) for path, writes in heard if writes}
        files: dict[str, str | None] = {}
        place: dict[str, str] = {}
        modules = [
            getattr(module, "__file__", None) for name, module in sys.modules.copy().items() if name != "__main__"
        ]
        imported = [path for path in modules if isinstance(path, str) and Path(path).is_relative_to(near)]
        paths = [(path, True) for path in [*(str(folder / name) for name in declared), *imported]]
        for given, sure in paths + [(path, False) for path, _ in heard]:
            path = _source(os.path.realpath(given))
            own = Path(path).is_relative_to(folder)
            if path in written or (not sure and not own and path.startswith(library)):
                continue
            if os.path.lexists(path) and not os.path.isfile(path):
                continue  # a folder or a device holds no content
            content = _content(path)
            if content is None and not own and not sure:
                continue  # looked for far away and not found: the search of some library
            files[os.path.relpath(path, folder) if Path(path).is_relative_to(near) else path] = content
            if not (own and path.endswith(".py")):
                place["folder"] = str(folder)  # a copy of the script may read this one's file, or one of its own
            if not os.path.isabs(given):
                place["called_from"] = here
        return cls(files, place)

    def unchanged(self, script: Path) -> bool:
        """Whether a script would find the same files with the same content again."""
        folder = script.parent.resolve()
        if self.place.get("folder", str(folder)) != str(folder):
            return False
        if self.place.get("called_from", os.getcwd()) != os.getcwd():
            return False
        return all(_content(os.path.join(folder, path)) == content for path, content in self.files.items())

    def header(self) -> dict[str, Any]:
        """JSON-ready."""
        return {"files": self.files, "place": self.place}


def _source(path: str) -> str:
    """The source of a compiled module; every other path as it is."""
    if path.endswith(".pyc"):
        try:
            return importlib.util.source_from_cache(path)
        except ValueError:
            pass
    return path


def _content(path: str) -> str | None:
    try:
        with open(path, "rb") as file:
            return fingerprint(file.read())
    except OSError:
        return None


def _library() -> tuple[str, ...]:
    """Where Python, its packages and the system lie; a change there is one of versions, not of a part."""
    places = {*sysconfig.get_paths().values(), sys.prefix, sys.base_prefix, str(Path(__file__).resolve().parents[2])}
    return tuple(os.path.join(os.path.realpath(place), "") for place in places if place) + tuple(
        os.path.join(place, "") for place in _SYSTEM
    )
