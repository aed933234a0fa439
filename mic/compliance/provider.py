"""Who computes compliance: the border between the production path and any finite-element code."""

from __future__ import annotations

from importlib.metadata import entry_points

from mic.compliance.part import Part
from mic.errors import MissingProvider

__all__ = ["find"]


def find(part: Part):
    """The first installed provider that can be loaded: an entry point of the group ``mic.compliance``.

    Raises
    ------
    MissingProvider
    """
    for point in entry_points(group="mic.compliance"):
        try:
            return point.load()()
        except ImportError:
            continue
    raise MissingProvider(f"part {part.name!r}: no provider of finite elements is installed")
