"""Files that a geometry script reads, with their content, so that changes invalidate its cached mesh.

Recorded are the files that Python itself opens: ``open``, `pathlib`, ``np.load`` and the like. Files that a C library
opens, folder listings, other programs and environment variables are not: a script names such files in
``DEPENDS = ["part.step"]``, relative to its folder.
"""

from __future__ import annotations

import importlib.util
import os
import sys
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from dataclasses import dataclass
from pathlib import Path

from mic.system.files import fingerprint
from mic.system.foreign_files import library_folders, opened_file

__all__ = ["Dependencies", "opened_files"]

_PROGRAM = os.path.join(Path(__file__).resolve().parents[1], "")
_SYSTEM = ("/proc", "/sys", "/dev", "/etc")

_recorders: list[list[tuple[str, bool]]] = []  # one per active `opened_files`
_hook_installed: list[bool] = []  # an audit hook cannot be removed


@contextmanager
def opened_files() -> Iterator[list[tuple[str, bool]]]:
    """Record the files opened in the context: path as given, and whether for writing; in order, with repetitions."""
    if not _hook_installed:
        sys.addaudithook(_record)
        _hook_installed.append(True)
    opened: list[tuple[str, bool]] = []
    _recorders.append(opened)
    try:
        yield opened
    finally:
        _recorders.remove(opened)


def _record(event: str, arguments: tuple) -> None:
    """Audit hook: add an opened file to all recorders."""
    if _recorders and (found := opened_file(event, arguments)) is not None:
        for opened in _recorders:
            opened.append(found)


@dataclass
class Dependencies:
    """The files from which a generated mesh was made.

    Attributes
    ----------
    files : dict of str to str or None
        Hash of each file's content, by its path relative to the script's folder, or absolute path if far away; None for
        a file that the script tried to open and did not find.
    place : dict
        Folder of the script and working directory, if the paths depend on them.
    """

    files: dict[str, str | None]
    place: dict[str, str]

    @classmethod
    def of(cls, script: Path, declared: list[str], opened: list[tuple[str, bool]]) -> Dependencies:
        """Files that a script opened or declares, and modules that it imported from its surroundings."""
        folder = script.parent.resolve()
        near, library, here = folder.parent, _library(), os.getcwd()
        written = {os.path.realpath(path) for path, writes in opened if writes}
        files: dict[str, str | None] = {}
        place: dict[str, str] = {}
        modules = [module for name, module in sys.modules.copy().items() if name != "__main__"]
        sources = [path for module in modules if isinstance(path := getattr(module, "__file__", None), str)]
        packages = tuple(one for one in (*library, _PROGRAM) if not f"{folder}{os.sep}".startswith(one))
        surroundings = os.path.join(near, "")
        imported = [path for path in sources if path.startswith(surroundings) and not path.startswith(packages)]
        paths = [(path, True) for path in [*(str(folder / name) for name in declared), *imported]]
        for given, sure in paths + [(path, False) for path, _ in opened]:
            path = _source(os.path.realpath(given))
            in_folder = Path(path).is_relative_to(folder)
            if path in written or (not sure and not in_folder and path.startswith(library)):
                continue
            if os.path.lexists(path) and not os.path.isfile(path):
                continue  # a folder or device
            content = _content(path)
            if content is None and not in_folder and not sure:
                continue  # search path of a library
            files[os.path.relpath(path, folder) if Path(path).is_relative_to(near) else path] = content
            if not (in_folder and path.endswith(".py")):
                place["folder"] = str(folder)  # a copy of the script in another folder may read other files
            if not os.path.isabs(given):
                place["called_from"] = here
        return cls(files, place)

    def unchanged(self, script: Path) -> bool:
        """Whether all files still have the same content."""
        folder = script.parent.resolve()
        if self.place.get("folder", str(folder)) != str(folder):
            return False
        if self.place.get("called_from", os.getcwd()) != os.getcwd():
            return False
        return all(_content(os.path.join(folder, path)) == content for path, content in self.files.items())


def _source(path: str) -> str:
    """The source of a compiled module; any other path unchanged."""
    with suppress(ValueError):  # a path outside of a folder of compiled modules
        return importlib.util.source_from_cache(path) if path.endswith(".pyc") else path
    return path


def _content(path: str) -> str | None:
    """Hash of a file; None if it cannot be read."""
    try:
        with open(path, "rb") as file:
            return fingerprint(file.read())
    except OSError:
        return None


def _library() -> tuple[str, ...]:
    """Folders of Python, its packages and the system, whose changes are changes of versions and not of a part."""
    return library_folders() + tuple(os.path.join(place, "") for place in _SYSTEM)
