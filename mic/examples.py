"""The example scenes that come with the program: list them, find their folders, copy one."""

from __future__ import annotations

import shutil
from pathlib import Path

from mic.errors import RunError, SceneError

__all__ = ["copy", "folder", "names"]

_ROOT = Path(__file__).with_name("example_scenes")  # a link to meshes/ in a checkout
_FILES = ("*.toml", "*.py", "*.md", "*.csv", "*.npz")


def names() -> list[str]:
    """Names of the example scenes, sorted."""
    return sorted(path.parent.name for path in _ROOT.glob("*/scene.toml"))


def folder(name: str) -> Path:
    """Folder of an example scene, as `mic.load_scene` takes it.

    Raises
    ------
    SceneError
        If the example does not exist.
    """
    if name not in names():
        raise SceneError(f"there is no example scene called {name!r}; the examples are {', '.join(names())}")
    return _ROOT / name


def copy(name: str, out: Path | str | None = None) -> Path:
    """Copy an example scene into a new folder.

    Parameters
    ----------
    name : str
    out : path-like, optional
        The new folder; default: `name` in the current folder.

    Returns
    -------
    Path
        The new folder.

    Raises
    ------
    SceneError
        If the example does not exist.
    RunError
        If the new folder already exists or cannot be written.
    """
    source, target = folder(name), Path(out if out is not None else name)
    try:
        target.mkdir(parents=True)
        for path in sorted(path for pattern in _FILES for path in source.glob(pattern)):
            shutil.copyfile(path, target / path.name)
    except FileExistsError as problem:
        raise RunError(f"{target}: this already exists; name another folder with --out") from problem
    except OSError as problem:
        raise RunError(f"{target}: cannot be written ({problem.strerror}); name another folder with --out") from problem
    return target
