"""Former module names of the package, importable for one release with a deprecation warning."""

from __future__ import annotations

import importlib
import importlib.abc
import importlib.machinery
import sys
import tomllib
import warnings
from collections.abc import Sequence
from pathlib import Path
from types import ModuleType

__all__ = ["install"]

#: New module by former name.
RENAMED: dict[str, str] = tomllib.loads(Path(__file__).with_suffix(".toml").read_text(encoding="utf-8"))


class _Finder(importlib.abc.MetaPathFinder, importlib.abc.Loader):
    """Load the module under its new name wherever the former one is imported."""

    def find_spec(
        self, fullname: str, path: Sequence[str] | None, target: ModuleType | None = None
    ) -> importlib.machinery.ModuleSpec | None:
        return importlib.machinery.ModuleSpec(fullname, self) if fullname in RENAMED else None

    def create_module(self, spec: importlib.machinery.ModuleSpec) -> ModuleType:
        new = RENAMED[spec.name]
        warnings.warn(f"the module {spec.name} is now {new}", DeprecationWarning, stacklevel=2)
        module = importlib.import_module(new)
        spec.loader_state = module.__spec__  # the import system replaces it
        return module

    def exec_module(self, module: ModuleType) -> None:
        """Nothing to execute: the module was imported under its new name."""
        assert module.__spec__ is not None
        module.__spec__ = module.__spec__.loader_state


def install() -> None:
    """Make the former names importable; first in ``sys.meta_path``, so that submodules are not loaded twice."""
    sys.meta_path.insert(0, _Finder())
